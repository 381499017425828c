"""Which sensors can see which positions: field of view, range, static polygons, and moving objects in between.

A camera is *assigned* to a particle ([Ercan] Sec. 4.3) if neither field of view, nor range, nor a static polygon keeps
it from seeing the particle: kernels for many particles. Simulated sensors, for which moving objects occlude positions
too, use `in_view`, `behind_walls` and `behind_objects`.

Prior of a target's position without a room, drawn with the lines of sight of a first scan. It is a mixture: for each
sensor a sector in which all directions and all distances up to a limit are equally likely (density proportional to 1 /
distance), and a box around the sensors. With uniform distances, rather than uniform areas, one bearing leaves the
distance uniform, and a limit that is too large does little harm. Since bearings are precise, first positions are drawn
along the lines of sight (`initial_positions`), with importance weights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane import (
    distance_to_boundary,
    inside_polygon,
    line_of_sight_blocked,
    pack_polygons,
    segment_blocked,
)

from .camera import wrap_angle

SLACK = 1e-9
"""The quick test of a wall gives up within this of its border, relative; the exact test then decides."""


class Sensors(NamedTuple):
    """S sensors in the plane (position, axis, field of view, range), and the polygons that occlude the view of each.

    They are packed in arrays for kernels (`make_sensors`).
    """

    xy: Floats  # (S, 2) position
    axis: Floats  # (S, 2) cosine and sine of the yaw
    cos2: Floats  # (S,) square of the cosine of half the field of view, 0 from 180 degrees on; -1: sees all around
    reach2: Floats  # (S,) square of the range
    first: Ints  # (S + 1,) walls of sensor i are first[i] to first[i + 1] - 1
    walls: Floats  # (V, 2) packed polygons
    starts: Ints  # (W + 1,)
    cone: Floats  # (W, 8) of `_cone`: quick tests of whether a wall hides a position


def make_sensors(xy: Floats, yaw: Floats, fov: Floats, reach: Floats, walls: Sequence[Sequence[Floats]]) -> Sensors:
    """Return sensors, with their fields of view and the polygons that occlude their views, packed for kernels.

    Args:
        xy: (S, 2) positions.
        yaw: (S,) azimuth of the axis [rad].
        fov: (S,) full field of view [rad]; NaN for a sensor that sees all around and has no axis.
        reach: (S,) greatest distance; may be infinite.
        walls: for each sensor the polygons (K, 2) that occlude its view.
    """
    with np.errstate(invalid="ignore"):
        cosine = np.where(fov < np.pi, np.cos(0.5 * fov), 0.0)
    cos2 = np.where(np.isnan(fov), -1.0, cosine**2)
    first = np.zeros(len(xy) + 1, dtype=np.int64)
    np.cumsum([len(w) for w in walls], out=first[1:])
    cones = [_cone(xy[i], wall) for i in range(len(xy)) for wall in walls[i]]
    return Sensors(
        np.ascontiguousarray(xy, dtype=np.float64),
        np.column_stack([np.cos(yaw), np.sin(yaw)]),
        cos2,
        np.asarray(reach, dtype=np.float64) ** 2,
        first,
        *pack_polygons([p for own in walls for p in own]),
        np.array(cones, dtype=np.float64).reshape(-1, 8),
    )


def _cone(origin: Floats, wall: Floats) -> Floats:
    """Return the constants of the quick tests of whether a wall occludes a position.

    Args:
        origin: (2,) position of the sensor.
        wall: (K, 2) polygon.

    Returns:
        (8,): right and left ray from the sensor around the wall (unit vectors; 0 where the wall may be in any
        direction), squared distance of the wall, unit normal and offset (relative to the sensor) of a line. All
        positions between the rays and beyond the line are occluded; an infinite offset: this test is not made.
    """
    wall = np.ascontiguousarray(wall, dtype=np.float64)
    rays = wall - origin
    row = np.zeros(8)
    row[7] = np.inf
    near = distance_to_boundary(origin[0], origin[1], wall)
    if near == 0.0 or inside_polygon(np.ascontiguousarray(origin[None, :2]), wall)[0]:
        return row
    row[4] = near**2
    # Angles along the border; outside a polygon the turns add up to 0.
    turns = np.angle(np.exp(1j * np.diff(np.arctan2(rays[:, 1], rays[:, 0]))))
    angle = np.concatenate([[0.0], np.cumsum(turns)])
    right, left = rays[np.argmin(angle)], rays[np.argmax(angle)]
    if angle.max() - angle.min() > 0.99 * np.pi:
        return row
    row[:2], row[2:4] = right / np.hypot(*right), left / np.hypot(*left)
    chord = left - right
    normal = np.array([chord[1], -chord[0]]) / np.hypot(*chord)
    # The chord between the outermost corners is inside a convex wall; behind it nothing is seen.
    # Of any other wall, nothing is seen behind the last of its corners.
    row[5:7], row[7] = normal, normal @ right if _convex(wall) else np.max(rays @ normal)
    return row


def _convex(polygon: Floats) -> bool:
    """Return whether a polygon (K, 2) of either orientation is convex."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    following = np.roll(edges, -1, axis=0)
    cross = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    return bool(np.all(cross >= 0.0) or np.all(cross <= 0.0))


@kernel
def seen_from(xy: Floats, i: int, sensors: Sensors) -> Bools:
    """Return (N,) booleans: positions are in view and in range of a sensor, and not behind one of its walls.

    A position behind a camera (d <= 0) is never seen, so that h / d may be computed where the mask is True.

    Args:
        xy: (N, 2) positions.
        i: index of the sensor.
        sensors: all sensors, with their walls.
    """
    x0, y0, reach2, cos2 = sensors.xy[i, 0], sensors.xy[i, 1], sensors.reach2[i], sensors.cos2[i]
    c, s = sensors.axis[i, 0], sensors.axis[i, 1]
    seen = np.empty(xy.shape[0], dtype=np.bool_)
    around = cos2 < 0.0
    for p in range(xy.shape[0]):
        dx, dy = xy[p, 0] - x0, xy[p, 1] - y0
        r2 = dx * dx + dy * dy
        d = c * dx + s * dy
        # `&` and `|` evaluate both sides, so that the loop has no branches.
        seen[p] = (r2 <= reach2) & (around | ((d > 0.0) & (d * d >= cos2 * r2)))
    for w in range(sensors.first[i], sensors.first[i + 1]):
        _hide_behind(seen, xy, x0, y0, sensors.walls[sensors.starts[w] : sensors.starts[w + 1]], sensors.cone[w])
    return seen


@kernel
def _hide_behind(seen: Bools, xy: Floats, x0: float, y0: float, wall: Floats, cone: Floats) -> None:
    """Set `seen` to False, in place, at positions that a wall occludes from a sensor at (x0, y0).

    Positions that are clearly nearer than the wall, to its side or behind it are decided by `cone`; only for the others
    the exact test is made.

    Args:
        seen: (L,) mask; positions that are False already are skipped.
        xy: (L, 2) positions.
        x0: position of the sensor.
        y0: position of the sensor.
        wall: (K, 2) polygon.
        cone: (8,) right ray, left ray, squared distance, normal and offset of a line, as `_cone` returns them for this
            wall and sensor.
    """
    rx, ry, lx, ly, near2 = cone[0], cone[1], cone[2], cone[3], cone[4] * (1.0 - SLACK)
    nx, ny, offset = cone[5], cone[6], cone[7]
    for p in range(xy.shape[0]):
        if not seen[p]:
            continue
        dx, dy = xy[p, 0] - x0, xy[p, 1] - y0
        r2 = dx * dx + dy * dy
        if r2 < near2:
            continue
        # To the side of the wall: outside the rays around it
        slack = SLACK * (abs(dx) + abs(dy))
        from_right, from_left = rx * dy - ry * dx, ly * dx - lx * dy
        if from_right < -slack or from_left < -slack:
            continue
        # Behind the wall, clearly or by the exact test
        behind = from_right > slack and from_left > slack and nx * dx + ny * dy > offset + slack
        if behind or segment_blocked(x0, y0, xy[p, 0], xy[p, 1], wall):
            seen[p] = False


def in_view(h: Floats, d: Floats, fov: float, reach: float) -> Bools:
    """Return a mask of points in front of a camera (d > 0), in its field of view and in range (limits included).

    Args:
        h: offset to the left of the optical axis, any shape.
        d: distance along the optical axis, of the same shape.
        fov: full horizontal field of view [rad].
        reach: greatest distance; may be infinite.
    """
    with np.errstate(invalid="ignore"):
        return (d > 0) & (np.abs(np.arctan2(h, d)) <= 0.5 * fov) & (np.hypot(h, d) <= reach)


def behind_walls(origin: Floats, xy: Floats, walls: Sequence[Floats]) -> Bools:
    """Return (N,) booleans: a polygon is between the sensor and the point, or holds the point.

    Args:
        origin: (2,) or (3,) position of the sensor; z is ignored.
        xy: (N, 2) points.
        walls: polygons (K, 2).
    """
    hidden = np.zeros(len(xy), dtype=np.bool_)
    points = np.ascontiguousarray(xy)
    for wall in walls:
        hidden |= line_of_sight_blocked(np.ascontiguousarray(origin[:2]), points, wall)
    return hidden


def behind_objects(origin: Floats, xy: Floats, others: Floats, diameter: float) -> Bools:
    """Return (T,) booleans: a moving object occludes the point of a time from the sensor.

    Its centre is in the rectangle A(x) of [Ercan] Fig. 3, from the sensor to the point and half a diameter to either
    side of the line of sight.

    Args:
        origin: (2,) position of the sensor.
        xy: (T, 2) points, one for each time.
        others: (T, m, 2) centres of the m other objects; NaN occludes nothing.
        diameter: diameter of the objects.
    """
    ray = xy - origin[:2]
    length = np.hypot(ray[:, 0], ray[:, 1])
    to = others - origin[:2]
    with np.errstate(invalid="ignore", divide="ignore"):
        along = (to[..., 0] * ray[:, None, 0] + to[..., 1] * ray[:, None, 1]) / length[:, None]
        across = (to[..., 1] * ray[:, None, 0] - to[..., 0] * ray[:, None, 1]) / length[:, None]
        inside = (np.abs(across) < 0.5 * diameter) & (along > 0) & (along < length[:, None])
    hidden: Bools = np.logical_or.reduce(inside, axis=1)
    return hidden


AROUND_SENSORS = 0.1
"""Share of the prior that is even in the box around the sensors."""
DEFENSIVE_FRACTION = 0.1
"""Share of initial positions drawn independently of the scan."""
CROSSING = 0.6
"""Share of the other first positions that is drawn where lines of sight cross, if some do."""
CROSSING_INFLATION = 1.5
"""Draws at a crossing are spread wider than the crossing's own errors by this factor."""
MIN_CROSSING_SINE = 0.02
"""Lines of sight that cross at a smaller angle (about 1 degree) have no crossing."""
MAX_CROSSINGS = 200
"""Maximum number of crossings; of more a random subset is used."""
MIN_RELATIVE_DISTANCE = 1e-6
"""Least distance, as a share of the far limit, in densities."""


class ViewPrior(NamedTuple):
    """Prior of a target's position from the views of S sensors: a mixture of sectors and of a box around the sensors.

    In a sector, given by origin, axis, field of view, far limit and share, distance and azimuth are uniform. All
    lengths have one unit.
    """

    origin: Floats  # (S, 2) where they stand
    axis: Floats  # (S,) azimuth of the middle of the view [rad]
    fov: Floats  # (S,) full field of view [rad], up to 2 pi
    far: Floats  # (S,) far limit, > 0, finite
    share: Floats  # (S,) of the sensor in the mixture, sum 1; 0 for one without a pose
    low: Floats  # (2,) of the box around the sensors
    high: Floats  # (2,)


class ScanDirectionsInPlane(NamedTuple):
    """R directions (azimuths) that sensors measured at one time, with their standard deviations.

    Also position, standard deviation of the position, greatest distance of a target and number of the sensor of each.
    """

    origin: Floats  # (R, 2)
    azimuth: Floats  # (R,) [rad]
    sigma: Floats  # (R,) standard deviation of the azimuth, > 0 [rad]
    sigma_origin: Floats  # (R,) standard deviation of the sensor's position, per axis
    far: Floats  # (R,) no target is seen farther off
    sensor: Ints  # (R,) lines of one sensor do not cross

    def sigma_at(self, distance: Floats) -> Floats:
        """Return standard deviations (..., R) [rad] of the azimuths of targets at distances (..., R).

        They include the effect of the position errors of the sensors.
        """
        return np.asarray(
            np.hypot(self.sigma, self.sigma_origin / np.maximum(distance, MIN_RELATIVE_DISTANCE * self.far))
        )


def draw(n: int, prior: ViewPrior, rng: Generator) -> Floats:
    """Return n positions (n, 2) sampled from the prior, with random numbers of `rng`."""
    which = rng.choice(len(prior.far), size=n, p=prior.share)
    r, turn = prior.far[which] * rng.random(n), prior.axis[which] + prior.fov[which] * (rng.random(n) - 0.5)
    xy = prior.origin[which] + r[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    box = rng.random(n) < AROUND_SENSORS
    anywhere = prior.low + (prior.high - prior.low) * rng.random((n, 2))
    return np.where(box[:, None], anywhere, xy)


def prior_moments(prior: ViewPrior) -> tuple[Floats, Floats]:
    """Return the mean (2,) and the covariance (2, 2) of the prior position, in closed form."""
    # A wedge: distance uniform up to `far`, azimuth uniform within the field of view
    c, s = np.cos(prior.axis), np.sin(prior.axis)
    once, twice = np.sinc(0.5 * prior.fov / np.pi), np.sinc(prior.fov / np.pi)
    away = 0.5 * (prior.far * once)[:, None] * np.column_stack([c, s])
    cos2, sin2 = twice * (c**2 - s**2), twice * 2.0 * s * c
    square = np.stack([1.0 + cos2, sin2, sin2, 1.0 - cos2], axis=1).reshape(-1, 2, 2)
    square *= (prior.far**2 / 6.0)[:, None, None]
    # Second moments about 0, of wedges and box
    centre = prior.origin
    cross = centre[:, :, None] * away[:, None, :]
    wedge = centre[:, :, None] * centre[:, None, :] + cross + cross.swapaxes(1, 2) + square
    middle = 0.5 * (prior.low + prior.high)
    box = np.outer(middle, middle) + np.diag((prior.high - prior.low) ** 2 / 12.0)
    mean = (1.0 - AROUND_SENSORS) * (prior.share @ (centre + away)) + AROUND_SENSORS * middle
    second = (1.0 - AROUND_SENSORS) * np.einsum("s,sij->ij", prior.share, wedge) + AROUND_SENSORS * box
    return mean, np.asarray(second - np.outer(mean, mean))


def log_density(xy: Floats, prior: ViewPrior) -> Floats:
    """Return the (N,) log density of the prior at positions (N, 2); -inf outside all sectors and the box."""
    away = xy[:, None] - prior.origin
    r = np.hypot(away[..., 0], away[..., 1])
    off = np.abs(wrap_angle(np.arctan2(away[..., 1], away[..., 0]) - prior.axis))
    inside = (r <= prior.far) & (off <= 0.5 * prior.fov)
    wedge = np.where(inside, 1.0 / (prior.fov * prior.far * np.maximum(r, MIN_RELATIVE_DISTANCE * prior.far)), 0.0)
    in_box = np.all((xy >= prior.low) & (xy <= prior.high), axis=1)
    box = np.where(in_box, 1.0 / np.prod(prior.high - prior.low), 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log((1.0 - AROUND_SENSORS) * (wedge @ prior.share) + AROUND_SENSORS * box))


def initial_positions(n: int, lines: ScanDirectionsInPlane, prior: ViewPrior, rng: Generator) -> tuple[Floats, Floats]:
    """Return initial positions of a target, sampled from the lines of sight of one scan, with importance weights.

    The proposal is a mixture: along each line, uniform in distance; around crossings of lines of different sensors; and
    the prior itself. With the weights the positions represent the prior; the likelihood of the scan is not included.

    Args:
        n: number of positions.
        lines: directions measured in the scan; without any, positions are sampled from the prior.
        prior: prior of the target's position.
        rng: source of random numbers.

    Returns:
        (n, 2) positions and (n,) log weights: log of the prior's density over the density of the proposal; -inf outside
        the prior.
    """
    centre, covariance = crossings(lines, rng)
    # Shares of the mixture
    R, K = len(lines.azimuth), len(centre)
    blind = math.ceil(DEFENSIVE_FRACTION * n) if R else n
    crossing = round(CROSSING * (n - blind)) if K else 0
    along = n - blind - crossing
    # Propose: prior, lines, crossings
    parts = [draw(blind, prior, rng)]
    if along:
        parts.append(_along(along, lines, rng))
    if crossing:
        which = rng.integers(K, size=crossing)
        root = np.linalg.cholesky(covariance)[which]
        parts.append(centre[which] + np.einsum("nij,nj->ni", root, rng.standard_normal((crossing, 2))))
    xy = np.concatenate(parts)
    # Weigh: prior over the density of the mixture
    log_prior = log_density(xy, prior)
    density = blind / n * np.exp(log_prior)
    if along:
        density += along / n * _density_along(xy, lines)
    if crossing:
        density += crossing / n * _density_at(xy, centre, covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where(np.isneginf(log_prior), -np.inf, log_prior - np.log(density))
    return xy, weights


def crossings(lines: ScanDirectionsInPlane, rng: Generator) -> tuple[Floats, Floats]:
    """Return crossings (K, 2) of lines of different sensors ahead of both, and covariances (K, 2, 2) for sampling.

    The covariances are those of the crossings, enlarged by `CROSSING_INFLATION` squared. Lines that are nearly parallel
    and crossings out of range are omitted; of more than `MAX_CROSSINGS` a random subset is returned.

    Args:
        lines: directions of one scan.
        rng: source of random numbers for the subset.
    """
    pairs = [(i, j) for i, j in combinations(range(len(lines.azimuth)), 2) if lines.sensor[i] != lines.sensor[j]]
    if not pairs:
        return np.empty((0, 2)), np.empty((0, 2, 2))
    i, j = np.array(pairs).T
    e = np.column_stack([np.cos(lines.azimuth), np.sin(lines.azimuth)])
    sine = e[i, 0] * e[j, 1] - e[i, 1] * e[j, 0]
    base = lines.origin[j] - lines.origin[i]
    with np.errstate(divide="ignore", invalid="ignore"):
        ri = (base[:, 0] * e[j, 1] - base[:, 1] * e[j, 0]) / sine
        rj = (base[:, 0] * e[i, 1] - base[:, 1] * e[i, 0]) / sine
        good = (np.abs(sine) >= MIN_CROSSING_SINE) & (ri > 0) & (rj > 0) & (ri <= lines.far[i]) & (rj <= lines.far[j])
    kept = np.flatnonzero(good)
    if len(kept) > MAX_CROSSINGS:
        kept = np.sort(rng.permutation(kept)[:MAX_CROSSINGS])
    information = np.zeros((len(kept), 2, 2))
    for rows, r in ((i[kept], ri[kept]), (j[kept], rj[kept])):
        across = np.column_stack([-e[rows, 1], e[rows, 0]])
        sigma = np.hypot(r * lines.sigma[rows], lines.sigma_origin[rows])
        information += across[:, :, None] * across[:, None, :] / sigma[:, None, None] ** 2
    covariance = np.asarray(CROSSING_INFLATION**2 * np.linalg.inv(information), dtype=np.float64)
    return lines.origin[i[kept]] + ri[kept, None] * e[i[kept]], covariance


def _along(n: int, lines: ScanDirectionsInPlane, rng: Generator) -> Floats:
    """Return positions (n, 2) sampled along random lines of sight: uniform distances, normally distributed azimuths.

    Args:
        n: number of positions.
        lines: directions of one scan.
        rng: source of random numbers.
    """
    which = rng.integers(len(lines.azimuth), size=n)
    r = lines.far[which] * rng.random(n)
    sigma = np.hypot(
        lines.sigma[which], lines.sigma_origin[which] / np.maximum(r, MIN_RELATIVE_DISTANCE * lines.far[which])
    )
    turn = lines.azimuth[which] + np.minimum(sigma, np.pi) * rng.standard_normal(n)
    return np.asarray(lines.origin[which] + r[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]))


def _density_along(xy: Floats, lines: ScanDirectionsInPlane) -> Floats:
    """Return the (N,) probability densities with which `_along` samples positions: the mean over all lines.

    Args:
        xy: (N, 2) positions.
        lines: directions of one scan.
    """
    away = xy[:, None] - lines.origin
    r = np.maximum(np.hypot(away[..., 0], away[..., 1]), MIN_RELATIVE_DISTANCE * lines.far)
    off = wrap_angle(np.arctan2(away[..., 1], away[..., 0]) - lines.azimuth)
    sigma = np.minimum(lines.sigma_at(r), np.pi)
    each = np.exp(-0.5 * (off / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma * lines.far * r)
    return np.asarray(np.where(r <= lines.far, each, 0.0).mean(axis=1))


def _density_at(xy: Floats, centre: Floats, covariance: Floats) -> Floats:
    """Return the (N,) density at positions of an equal mixture of K normal distributions, one around each crossing.

    Args:
        xy: (N, 2) positions.
        centre: (K, 2) means.
        covariance: (K, 2, 2) covariances.
    """
    precision = np.linalg.inv(covariance)
    scale = np.sqrt(np.linalg.det(precision)) / (2.0 * math.pi * len(centre))
    total = np.zeros(len(xy))
    for c, p, s in zip(centre, precision, scale, strict=True):
        d = xy - c
        total += s * np.exp(-0.5 * (p[0, 0] * d[:, 0] ** 2 + 2 * p[0, 1] * d[:, 0] * d[:, 1] + p[1, 1] * d[:, 1] ** 2))
    return total
