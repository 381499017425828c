"""Estimated positions fed back to the detector: where a target is searched for ([Ercan] Sec. 3).

"The estimated location of the object from the previous time step can be fed back to the cameras to limit the region
where feature detection is performed": a region or bearing counts for a target only within a gate around the direction
in which its track, at the last time before the frame, states that it is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.records.tables import Bearings, Tracks

MAX_AGE_S = 1.0
"""An older position states nothing: the target is searched for everywhere."""


class TargetPath(NamedTuple):
    """Track of a target, sorted by time [ns] (T,): positions and velocities (T, 2), position covariances (T, 2, 2).

    Velocities are 0 where unknown.
    """

    t_ns: Ints  # (T,)
    xy: Floats  # (T, 2)
    velocity: Floats  # (T, 2), 0 where it is not known
    covariance: Floats  # (T, 2, 2)


class TrackFeedback(NamedTuple):
    """Tracks of the targets by identity, and the gate in standard deviations around their predicted directions."""

    paths: dict[int, TargetPath]
    gate: float  # standard deviations


class ExpectedDirections(NamedTuple):
    """Predicted azimuths of a target from a sensor at N times with standard deviations [rad]; NaN: unknown."""

    azimuth: Floats  # (N,) [rad]
    sigma: Floats  # (N,) standard deviation [rad]


def track_feedback(tracks: Tracks, gate: float) -> TrackFeedback:
    """Create track feedback from tracks with covariances; `gate` in standard deviations."""
    paths = {}
    for target in np.unique(tracks.target_id).tolist():
        own = tracks.take(tracks.target_id == target)
        velocity = np.nan_to_num(np.column_stack([own.vx, own.vy]))
        covariance = np.stack([own.cov_xx, own.cov_xy, own.cov_xy, own.cov_yy], axis=1).reshape(-1, 2, 2)
        paths[int(target)] = TargetPath(own.t_ns, np.column_stack([own.x, own.y]), velocity, covariance)
    return TrackFeedback(paths, gate)


def directions(path: TargetPath, origin: Floats, t_ns: Ints) -> ExpectedDirections:
    """Predicted directions of a target from a sensor, by its last position and velocity before each time.

    The uncertainty includes the position's covariance and the predicted displacement. NaN before the first position and
    after `MAX_AGE_S`.

    Args:
        path: track of the target.
        origin: (2,) ground position of the sensor.
        t_ns: (N,) times [ns].
    """
    last = np.searchsorted(path.t_ns, t_ns, side="left") - 1
    k = np.maximum(last, 0)
    dt = (t_ns - path.t_ns[k]) / NS
    away = path.xy[k] + path.velocity[k] * dt[:, None] - origin
    r = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)
    across = np.column_stack([-away[:, 1], away[:, 0]]) / r[:, None]
    variance = np.einsum("ni,nij,nj->n", across, path.covariance[k], across)
    variance += (np.hypot(*path.velocity[k].T) * dt) ** 2
    known = (last >= 0) & (dt <= MAX_AGE_S)
    azimuth = np.where(known, np.arctan2(away[:, 1], away[:, 0]), np.nan)
    return ExpectedDirections(azimuth, np.where(known, np.sqrt(np.maximum(variance, 0.0)) / r, np.nan))


def inside_gate(near: TrackFeedback, target: int, origin: Floats, t_ns: Ints, bearing: Floats, sigma: Floats) -> Bools:
    """(N,) mask of bearings that may be of a target: within the gate, or its direction is unknown.

    Args:
        near: tracks of the targets and gate.
        target: identity of the target.
        origin: (2,) ground position of the sensor.
        t_ns: (N,) times [ns].
        bearing: (N,) azimuths [rad].
        sigma: (N,) their standard deviations [rad].
    """
    if target not in near.paths:
        return np.ones(len(t_ns), dtype=np.bool_)
    there = directions(near.paths[target], origin, t_ns)
    off = np.abs(wrap_angle(bearing - there.azimuth))
    return np.asarray(np.isnan(there.azimuth) | (off <= near.gate * np.hypot(sigma, there.sigma)))


def limited(bearings: Bearings, near: TrackFeedback, positions: dict[str, Floats]) -> Bearings:
    """Return the bearings with labelled ones outside their target's gate marked as not detected.

    Args:
        bearings: bearings; candidates without a label, and rows of sensors without position, are unchanged.
        near: tracks of the targets and gate.
        positions: ground position (2,) of each sensor with a pose, by name.
    """
    keep = np.ones(len(bearings), dtype=np.bool_)
    for sensor in np.unique(bearings.sensor).tolist():
        for target in near.paths:
            own = (bearings.sensor == sensor) & (bearings.target_id == target) & bearings.seen
            if sensor in positions and own.any():
                t_ns, bearing, sigma = bearings.t_ns[own], bearings.bearing[own], bearings.sigma[own]
                keep[own] = inside_gate(near, target, positions[sensor], t_ns, bearing, sigma)
    gone = {name: np.where(keep, getattr(bearings, name), np.nan) for name in MEASURED}
    return replace(bearings, seen=bearings.seen & keep, **gone)


MEASURED = ("bearing", "sigma", "u_px", "sigma_px", "score")
"""Columns that state nothing where nothing was seen."""
