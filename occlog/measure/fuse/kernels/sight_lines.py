"""Sight lines on the ground, some with a distance, against a place and its covariance.

What the fusion of detections needs: how far lines pass from a place, where a line or several meet, and a
target's state between its detections.  R lines each start at a sensor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.sight.camera import wrap_angle
from occlog.core.sight.triangulate import MET, sight_lines_meet

NEAREST = 1e-6
"""Places this near to a sensor count as so far off [length]; they have no direction."""


class Sight(NamedTuple):
    """R local detections as directions from sensors."""

    sensor: Ints  # (R,) which sensor
    origin: Floats  # (R, 2)
    azimuth: Floats  # (R,) [rad]
    sigma: Floats  # (R,) [rad], > 0
    distance: Floats  # (R,) along the ground; NaN: not known
    sigma_distance: Floats  # (R,)

    def take(self, rows: Ints | Bools) -> Sight:
        """Some of them."""
        return Sight(
            sensor=self.sensor[rows],
            origin=self.origin[rows],
            azimuth=self.azimuth[rows],
            sigma=self.sigma[rows],
            distance=self.distance[rows],
            sigma_distance=self.sigma_distance[rows],
        )


class Place(NamedTuple):
    """A place with its uncertainty."""

    xy: Floats  # (2,)
    cov: Floats  # (2, 2)


def deviations(sight: Sight, place: Place) -> tuple[Floats, Floats]:
    """How far local detections are from a place, and the variance of that without the place's own.

    Returns:
        (R, 2) offsets across and along each line; across is infinite for a line that looks away, along is 0
        where the distance is not known.  (R, 2) variances of the two.
    """
    away = place.xy - sight.origin
    r = np.maximum(np.hypot(away[:, 0], away[:, 1]), NEAREST)
    residual = wrap_angle(sight.azimuth - np.arctan2(away[:, 1], away[:, 0]))
    ahead = np.abs(residual) < 0.5 * np.pi
    across = np.where(ahead, r * np.sin(residual), np.inf)
    known = np.isfinite(sight.distance)
    along = np.where(known, sight.distance - r * np.cos(residual), 0.0)
    variance = np.column_stack([(r * sight.sigma) ** 2, np.where(known, sight.sigma_distance**2, 0.0)])
    return np.column_stack([across, along]), variance


def misfit(sight: Sight, place: Place, extra: float = 0.0) -> Floats:
    """(R,) squared distance of local detections from a place, in variances of both and `extra` [length^2].

    One degree of freedom for a line, two for one whose distance is known.
    """
    offset, variance = deviations(sight, place)
    c, s = np.cos(sight.azimuth), np.sin(sight.azimuth)
    turn = np.stack([np.column_stack([-s, c]), np.column_stack([c, s])], axis=1)  # rows: across, along
    both = turn @ (place.cov + extra * np.eye(2)) @ turn.transpose(0, 2, 1)
    both[:, 0, 0] += variance[:, 0]
    both[:, 1, 1] += variance[:, 1]
    finite = np.isfinite(offset[:, 0])
    a, b = np.where(finite, offset[:, 0], 0.0), offset[:, 1]
    xx, xy, yy = both[:, 0, 0], both[:, 0, 1], both[:, 1, 1]
    point = (yy * a * a - 2.0 * xy * a * b + xx * b * b) / np.maximum(xx * yy - xy * xy, 1e-300)
    known = np.isfinite(sight.distance)
    line = a * a / np.maximum(xx, 1e-300)
    return np.where(finite, np.where(known, point, line), np.inf)


def meet(sight: Sight, min_crossing: float) -> Place | None:
    """Where lines meet, or else the mean of those with a distance; None if neither is there.

    Args:
        sight: of one object.
        min_crossing: lines that cross at smaller angles do not meet [rad].
    """
    rows = np.array([0, len(sight.azimuth)])
    found = sight_lines_meet(sight.origin, sight.azimuth, sight.sigma, rows, "gauss", min_crossing)
    if found.status[0] == MET:
        return Place(found.xy[0], found.covariance[0])
    known = np.isfinite(sight.distance)
    if not known.any():
        return None
    xy, cov = points(sight.take(known))
    weight = np.linalg.inv(cov)
    total = np.linalg.inv(weight.sum(axis=0))
    return Place(total @ np.einsum("rij,rj->i", weight, xy), total)


def points(sight: Sight) -> tuple[Floats, Floats]:
    """(R, 2) places of local detections with a distance, and (R, 2, 2) their covariances."""
    c, s = np.cos(sight.azimuth), np.sin(sight.azimuth)
    xy = sight.origin + sight.distance[:, None] * np.column_stack([c, s])
    across, along = (sight.distance * sight.sigma) ** 2, sight.sigma_distance**2
    xx, yy = along * c * c + across * s * s, along * s * s + across * c * c
    cross = (along - across) * c * s
    return xy, np.stack([xx, cross, cross, yy], axis=1).reshape(-1, 2, 2)


class MotionEstimate(NamedTuple):
    """A target that moves at nearly constant velocity: x, y, vx, vy and their covariance."""

    t_ns: int
    mean: Floats  # (4,)
    cov: Floats  # (4, 4)

    @property
    def place(self) -> Place:
        """Its position."""
        return Place(self.mean[:2], self.cov[:2, :2])


def begin(t_ns: int, place: Place, speed: float) -> MotionEstimate:
    """A target found at a place; each component of its velocity is 0 with standard deviation `speed`."""
    cov = np.zeros((4, 4))
    cov[:2, :2], cov[2, 2], cov[3, 3] = place.cov, speed**2, speed**2
    return MotionEstimate(t_ns, np.append(place.xy, [0.0, 0.0]), cov)


def ahead(motion: MotionEstimate, t_ns: int, acceleration: float) -> MotionEstimate:
    """The motion at a later time ([Lee] Eq. 4.19), with white acceleration of a density [length^2/s^3]."""
    dt = (t_ns - motion.t_ns) * 1e-9
    step = np.eye(4)
    step[0, 2] = step[1, 3] = dt
    noise = acceleration * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    return MotionEstimate(t_ns, step @ motion.mean, step @ motion.cov @ step.T + np.kron(noise, np.eye(2)))


def corrected_by_place(motion: MotionEstimate, place: Place) -> MotionEstimate:
    """The motion after its position was found by itself."""
    return _corrected(motion, np.eye(2, 4), place.xy - motion.mean[:2], place.cov)


def corrected_by_line(motion: MotionEstimate, sight: Sight) -> MotionEstimate:
    """The motion after one line, or several that are nearly parallel, passed by it; distances are not used."""
    for row in range(len(sight.azimuth)):
        offset, variance = deviations(sight.take(np.array([row])), motion.place)
        away = motion.mean[:2] - sight.origin[row]
        beta = float(np.arctan2(away[1], away[0]))
        H = np.array([[-np.sin(beta), np.cos(beta), 0.0, 0.0]])
        if np.isfinite(offset[0, 0]):
            motion = _corrected(motion, H, offset[0, :1], variance[:1, :1])
    return motion


def _corrected(motion: MotionEstimate, H: Floats, innovation: Floats, R: Floats) -> MotionEstimate:
    """Kalman update in Joseph's form."""
    P = motion.cov
    gain = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    rest = np.eye(4) - gain @ H
    return MotionEstimate(motion.t_ns, motion.mean + gain @ innovation, rest @ P @ rest.T + gain @ R @ gain.T)
