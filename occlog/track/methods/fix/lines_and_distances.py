"""A position from one time step's bearings, ranges, signal strengths and differences, of which some may be false.

The same as `occlog.track.methods.fix.estimators`, with measurements of distances in addition to lines of sight.  Starts
are where each two lines cross, where a line leaves a circle of a range, where circles meet, where on a grid about the
sensors a difference meets another measurement, and the best positions of that grid; from there Gauss and Newton climb
with reweighting.  Several modes are usual: circles of two ranges meet twice, and sensors on a line do not tell one
side from the other.  A room speaks against modes outside of it, as one measurement more.

Blunt measurements (a signal strength has an error of half the distance) leave likelihoods that are no Gaussians.  The
spread about a mode is therefore the second moment of the likelihood itself over a grid of `MODE_GRID_SIZE` x
`MODE_GRID_SIZE` positions that are even in the Gaussian's own coordinates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from occlog.array_types import Bools, Floats, Ints
from occlog.core.plane import distance_to_boundary, inside_polygon
from occlog.filtering.likelihood.distances import (
    DIFFERENCE,
    LOGARITHM,
    MAX_EXPONENT,
    RANGE,
    DistanceErrors,
    RangeMeasurements,
    linearise,
    log_density,
    score_and_information,
    without_detours,
)

from .estimators import (
    EM_TOLERANCE,
    HALVINGS,
    MAX_EM_ITERATIONS,
    MIN_INFORMATION_RATIO,
    MIN_MODE_PROBABILITY,
    MODE_MERGE_DISTANCE,
    Modes,
    crossings,
)

GRID, GRID_REACH_EXTENTS, MAX_STARTS = 24, 1.0, 12
"""Starts on a grid: positions per side, and margin in extents beyond the sensors; the best are
climbed."""
COARSE = (0.5, 0.125, 0.03)
"""Shares of the grid's step that standard deviations hold also, while positions of the grid are climbed."""
PAIRS, START_GATE_SIGMAS = 45, 2.0
"""Maximum number of pairs of measurements that give starts on the grid, and the gate of both measurements there."""
MAX_CROSSED = 24
"""Lines, and circles, of which each two are crossed for starting positions; of more, so many at equal steps."""
MAX_EXACT_STARTS = 128
"""Crossings from which the search begins; of more, those of the largest likelihood."""
MODE_GRID_SIZE, MODE_GRID_SIGMAS = 25, 5.0
"""Places a side of the grid over a mode, and how many standard deviations it reaches."""
MAX_REFINEMENTS = 8
"""How often such a grid is tried, each time with a quarter of the length where it is too coarse."""
MIN_SECOND_MODE_PROBABILITY = 0.05
"""Minimum probability of a second mode that makes a position ambiguous."""
MIN_RIVAL_LIKELIHOOD, MIN_SCATTER_SIGNIFICANCE = 0.005, 0.01
"""Where a measurement is rejected, others may be false, too.  A position is then ambiguous if another one has at least
the first share of its likelihood (where all are accepted: `MIN_SECOND_MODE_PROBABILITY`), or if a sum of squared
residuals as large as that of the accepted measurements has less than the second probability."""


class BearingLines(NamedTuple):
    """n lines of sight: where the bearings were taken, their directions [rad] and standard deviations [rad]."""

    positions: Floats  # (n, 2) where they were taken
    bearings: Floats  # (n,) [rad]
    sigma: Floats  # (n,) standard deviations [rad]
    bend: float  # standard deviations at which one is as likely false as true


class LineAndDistanceResiduals(NamedTuple):
    """Normalised residuals (M, n + m) of n lines of sight, then m distances, at M positions, and their gradients.

    Gradients (M, n + m, 2) are those of the expected values by x and y, in standard deviations per unit of length.
    """

    residual: Floats
    gradient: Floats


def modes_of(lines: BearingLines, distances: RangeMeasurements, room: Floats | None = None) -> Modes | None:
    """Return the modes of the likelihood of a position given lines of sight and distances; None if undetermined.

    Args:
        lines: n lines of sight, none or more.
        distances: m measurements of distances; together with the lines at least two.
        room: (K, 2) corners of the room that the target is in; None: it may be anywhere.
    """
    sights = without_detours(np.full(len(lines.sigma), lines.bend))
    errors = DistanceErrors(*(np.concatenate(both) for both in zip(sights, distances.errors, strict=True)))
    scale = _extent(lines, distances)
    exact, grid, cell, own = _starts(lines, distances, errors, scale)
    for share in COARSE:
        # From the grid with standard deviations that are no narrower than where the search still may be
        grid = _climbed(grid, lines, distances, errors, scale, share * cell, own)
    xy = _climbed(np.concatenate([exact, grid]), lines, distances, errors, scale)
    at = measured_at(lines, distances, xy)
    there = score_and_information(at.residual, errors)
    inlier = there.direct
    information = np.einsum("mn,mni,mnj->mij", there.weight, at.gradient, at.gradient)
    size = np.linalg.eigvalsh(information)
    near = np.abs(xy - _middle(lines, distances)).max(axis=1) < (1.0 + 2.0 * GRID_REACH_EXTENTS) * scale
    good = (
        np.isfinite(xy).all(axis=1)
        & (size[:, 0] > MIN_INFORMATION_RATIO * size[:, 1])
        & (inlier.sum(axis=1) > 1.5)
        & near
    )
    if not good.any():
        return None
    xy, residual, inlier, information = xy[good], at.residual[good], inlier[good], information[good]
    log = log_density(residual, errors).sum(axis=1) + _log_inside(xy, information, room, errors)
    kept: list[int] = []
    for m in np.argsort(-log, kind="stable").tolist():
        if all(np.hypot(*(xy[m] - xy[k])) > MODE_MERGE_DISTANCE * scale for k in kept):
            kept.append(m)
    weight = np.exp(log[kept] - log[kept[0]])
    chosen = np.array(kept)[weight / weight.sum() >= MIN_MODE_PROBABILITY]
    weight = weight[: len(chosen)]
    narrow = np.linalg.inv(information[chosen])
    volume = log[kept] - 0.5 * np.linalg.slogdet(information[kept])[1]
    elsewhere = 1.0 - 1.0 / float(np.exp(np.minimum(volume - volume[0], MAX_EXPONENT)).sum())
    moments = zip(xy[chosen], narrow, strict=True)
    covariance = np.array([_moment(lines, distances, errors, position, c) for position, c in moments])
    return Modes(xy[chosen], covariance, inlier[chosen], residual[chosen], weight / weight.sum(), elsewhere)


def has_rival_mode(found: Modes) -> bool:
    """Return whether a false measurement may be among those that are accepted at the first mode.

    Two tests: whether other positions, at which fewer measurements agree, are possible; and the sum of squared
    residuals, chi-square with a degree of freedom for each measurement accepted but two.
    """
    inlier = found.inlier_probability[0] >= 0.5
    spare = int(np.count_nonzero(inlier)) - 2
    squares = float((found.residual[0, inlier] ** 2).sum())
    most = MIN_SECOND_MODE_PROBABILITY if inlier.all() else MIN_RIVAL_LIKELIHOOD
    return found.elsewhere >= most or (spare > 0 and float(chdtrc(spare, squares)) < MIN_SCATTER_SIGNIFICANCE)


def measured_at(lines: BearingLines, distances: RangeMeasurements, xy: Floats) -> LineAndDistanceResiduals:
    """Return normalised residuals and gradients of lines of sight, then of distances, at M positions `xy` (M, 2)."""
    away = xy[:, None, :] - lines.positions[None]
    off = lines.bearings - np.arctan2(away[..., 1], away[..., 0])
    turned = ((off + np.pi) % (2.0 * np.pi) - np.pi) / lines.sigma
    squared = np.maximum((away**2).sum(axis=2), 1e-24)
    across = np.stack([-away[..., 1], away[..., 0]], axis=2) / (squared * lines.sigma)[..., None]
    linearised = linearise(distances, xy)
    return LineAndDistanceResiduals(
        np.concatenate([turned, linearised.residual], axis=1), np.concatenate([across, linearised.gradient], axis=1)
    )


def _moment(
    lines: BearingLines, distances: RangeMeasurements, errors: DistanceErrors, xy: Floats, narrow: Floats
) -> Floats:
    """Return the (2, 2) second moment of the likelihood about a mode, integrated over a grid.

    The grid is regular in the coordinates of the mode's Gaussian. Where circles touch, this Gaussian is much longer
    than the likelihood and is shortened.

    Args:
        lines: lines of sight.
        distances: measurements of distances.
        errors: error model of lines, then distances.
        xy: (2,) the mode.
        narrow: (2, 2) covariance of the mode's Gaussian.
    """
    at_point = measured_at(lines, distances, xy[None]).residual[0]
    inlier = 1.0 - np.exp(np.minimum(-0.5 * errors.bend**2 - log_density(at_point, errors), 0.0))
    true = errors._replace(bend=np.full_like(errors.bend, np.inf))
    size, axes = np.linalg.eigh(narrow)
    reach = np.sqrt(size)
    ticks = np.linspace(-MODE_GRID_SIGMAS, MODE_GRID_SIGMAS, MODE_GRID_SIZE)
    grid = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    for _ in range(MAX_REFINEMENTS):
        away = grid * reach @ axes.T
        log = log_density(measured_at(lines, distances, xy + away).residual, true) @ inlier
        weight = np.exp(log - log.max())
        weight /= weight.sum()
        seen = np.sqrt(weight @ grid**2)
        if (seen >= ticks[1] - ticks[0]).all():
            break
        reach = np.where(seen < ticks[1] - ticks[0], 0.25 * reach, reach)
    return np.asarray((away * weight[:, None]).T @ away)


def _starts(
    lines: BearingLines, distances: RangeMeasurements, errors: DistanceErrors, scale: float
) -> tuple[Floats, Floats, float, Bools]:
    """Return start positions for the search of modes: crossings of measurements, and the best positions of a grid.

    Args:
        lines: lines of sight.
        distances: measurements of distances.
        errors: error model of lines, then distances; n in all.
        scale: length of the problem, from `_extent`.

    Returns:
        (K, 2) positions where two measurements agree, (G, 2) the best positions of a grid, its step, and (G, n) the
        measurements with which each of these is climbed initially: all, or the two that meet there, since the others
        would pull it away.
    """
    radius = np.where(distances.kind == LOGARITHM, np.exp(np.minimum(distances.value, 50.0)), distances.value)
    flat = np.sqrt(np.maximum(radius**2 - distances.rise2, 0.0))
    ring = _evenly(np.flatnonzero(((distances.kind == RANGE) | (distances.kind == LOGARITHM)) & (radius > 0.0)))
    some = _evenly(np.arange(len(lines.sigma)))
    seen = BearingLines(lines.positions[some], lines.bearings[some], lines.sigma[some], lines.bend)
    parts = [
        _line_crossings(seen),
        _circle_crossings(distances.position[ring], flat[ring]),
        _leaving(seen, distances.position[ring], flat[ring]),
    ]
    # A grid, with standard deviations that are no narrower than its cells; the best local minima
    side = np.linspace(-(0.5 + GRID_REACH_EXTENTS), 0.5 + GRID_REACH_EXTENTS, GRID) * scale
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) + _middle(lines, distances)
    at = measured_at(lines, distances, grid)
    cell = side[1] - side[0]
    variance = _widened(at, 0.5 * cell)
    soft = at.residual / np.sqrt(variance)
    best = _local_minima(_cost(soft, errors.widened(variance)).reshape(GRID, GRID), MAX_STARTS)
    differs = np.concatenate([np.zeros(len(lines.sigma), dtype=np.bool_), distances.kind == DIFFERENCE])
    met = [(pair, _intersections(soft[:, pair])) for pair in _pairs(differs)]
    own = np.zeros((len(best) + sum(len(positions) for _, positions in met), len(errors.bend)), dtype=np.bool_)
    own[: len(best)] = True
    first = len(best)
    for pair, positions in met:
        own[first : first + len(positions), pair] = True
        first += len(positions)
    exact = np.concatenate(parts)
    if len(exact) > MAX_EXACT_STARTS:
        cost = _cost(measured_at(lines, distances, exact).residual, errors)
        exact = exact[np.sort(np.argsort(cost, kind="stable")[:MAX_EXACT_STARTS])]
    return exact, grid[np.concatenate([best, *(positions for _, positions in met)])], float(cell), own


def _evenly(rows: Ints) -> Ints:
    """Return at most `MAX_CROSSED` of the rows, at equal intervals."""
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_CROSSED)).round().astype(np.int64)]


def _pairs(differs: Bools) -> list[list[int]]:
    """Return at most `PAIRS` pairs of indices of measurements that include a range difference.

    Such pairs are intersected on a grid, not in closed form. `differs` (n,): the measurement is a range difference.
    """
    n = len(differs)
    every = ([i, i + offset] for offset in range(1, n) for i in range(n - offset))
    return [pair for pair in every if differs[pair].any()][:PAIRS]


def _intersections(soft: Floats) -> Ints:
    """Return flat indices of grid positions where two measurements intersect.

    `soft` (GRID^2, 2) has the residuals of both at the grid's positions, in standard deviations.
    """
    low = _local_minima((soft**2).sum(axis=1).reshape(GRID, GRID), MAX_STARTS)
    return np.asarray(low[(np.abs(soft[low]) <= START_GATE_SIGMAS).all(axis=1)])


def _widened(at: LineAndDistanceResiduals, wide: float) -> Floats:
    """Return (M, n) variances of normalised residuals with a position error added; 1 for exact positions.

    `wide` is the standard deviation of that error per axis [length].
    """
    return np.asarray(1.0 + wide**2 * np.sum(at.gradient**2, axis=2))


def _local_minima(cost: Floats, most: int) -> Ints:
    """Return flat indices of at most `most` local minima of a square cost grid, lowest first."""
    padded = np.pad(cost, 1, constant_values=np.inf)
    n = len(cost)
    around = [padded[1 + i : 1 + i + n, 1 + j : 1 + j + n] for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    low = np.flatnonzero((cost <= np.min(around, axis=0)).reshape(-1))
    return np.asarray(low[np.argsort(cost.reshape(-1)[low], kind="stable")][:most])


def _line_crossings(lines: BearingLines) -> Floats:
    """Return (K, 2) positions where two lines of sight cross ahead of both sensors."""
    if len(lines.sigma) < 2:
        return np.empty((0, 2))
    points = crossings(lines.positions, lines.bearings)
    both = np.isfinite(points[:, :, 0]) & np.isfinite(points[:, :, 0].T)
    i, j = np.nonzero(np.triu(both))
    return np.asarray(points[i, j])


def _circle_crossings(centre: Floats, radius: Floats) -> Floats:
    """Return (K, 2) intersections of each two of m circles with centres `centre` (m, 2) and radii `radius` (m,).

    Two positions for each pair, which are both the position between them if the circles do not meet; none for circles
    with one centre.
    """
    i, j = np.triu_indices(len(radius), 1)
    to = centre[j] - centre[i]
    distance = np.hypot(*to.T)
    there = distance > 1e-12
    i, j, to, distance = i[there], j[there], to[there], distance[there]
    along = (distance**2 + radius[i] ** 2 - radius[j] ** 2) / (2.0 * distance)
    aside = np.sqrt(np.maximum(radius[i] ** 2 - along**2, 0.0))
    ahead = to / distance[:, None]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    middle = centre[i] + np.clip(along, -radius[i], radius[i])[:, None] * ahead
    return np.concatenate([middle + aside[:, None] * left, middle - aside[:, None] * left])


def _leaving(lines: BearingLines, centre: Floats, radius: Floats) -> Floats:
    """Return (2 n m, 2) intersections of n half-lines with m circles of `centre` (m, 2) and `radius` (m,).

    A half-line that misses a circle gives its point nearest to the centre; one that begins within, its beginning in
    place of the intersection behind it.
    """
    ahead = np.column_stack([np.cos(lines.bearings), np.sin(lines.bearings)])[:, None, :]
    to = centre[None] - lines.positions[:, None, :]
    along = np.einsum("nki,nki->nk", to, np.broadcast_to(ahead, to.shape))
    half = np.sqrt(np.maximum(radius**2 - (to**2).sum(axis=2) + along**2, 0.0))
    reach = np.stack([along - half, along + half])
    points = lines.positions[None, :, None, :] + np.maximum(reach, 0.0)[..., None] * ahead[None]
    return np.asarray(points.reshape(-1, 2))


def _climbed(
    xy: Floats,
    lines: BearingLines,
    distances: RangeMeasurements,
    errors: DistanceErrors,
    scale: float,
    wide: float = 0.0,
    own: Bools | None = None,
) -> Floats:
    """Return (K, 2) modes reached from start positions, by reweighted Gauss-Newton with step halving.

    Args:
        xy: (K, 2) starts, not changed.
        lines: lines of sight.
        distances: measurements of distances.
        errors: error model of all n measurements, lines first.
        scale: length of the problem, from `_extent`, to which the tolerance is relative.
        wide: standard deviation of a position error [length] that is added to all residuals; 0 in the end.
        own: (K, n) which measurements each start uses; None: all.
    """
    xy = xy.copy()
    for _ in range(MAX_EM_ITERATIONS):
        at = measured_at(lines, distances, xy)
        variance = _widened(at, wide)
        soft = 1.0 / np.sqrt(variance) if own is None else own / np.sqrt(variance)
        blunt = errors.widened(variance)
        at = LineAndDistanceResiduals(at.residual * soft, at.gradient * soft[..., None])
        pulled = score_and_information(at.residual, blunt)
        information = np.einsum("mn,mni,mnj->mij", pulled.weight, at.gradient, at.gradient)
        ridge = 1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-300 * np.eye(2)
        slope = np.einsum("mn,mni->mi", pulled.slope, at.gradient)
        step = np.linalg.solve(information + ridge, slope[..., None])[..., 0]
        # No step is longer than the position is wide: far from a station circles are nearly lines
        length = np.hypot(*step.T)
        step *= np.minimum(1.0, 0.5 * scale / np.maximum(length, 1e-300))[:, None]
        here = _cost(at.residual, blunt)
        share = np.ones(len(xy))
        for _ in range(HALVINGS):
            ahead = measured_at(lines, distances, xy + share[:, None] * step).residual
            worse = _cost(ahead * soft, blunt) > here + 1e-12
            if not worse.any():
                break
            share[worse] *= 0.5
        else:
            share[worse] = 0.0
        move = share[:, None] * step
        xy += move
        if np.hypot(*move.T).max() < max(EM_TOLERANCE * scale, 0.1 * wide):
            break
    return xy


def _log_inside(xy: Floats, information: Floats, room: Floats | None, errors: DistanceErrors) -> Floats:
    """Return (M,) log likelihoods of positions being inside the room, treated as one more (possibly false) measurement.

    The residual is the distance outside the room over the largest standard deviation of the position. Without a room
    all are 0.

    Args:
        xy: (M, 2) positions.
        information: (M, 2, 2) inverse covariances of the positions.
        room: (K, 2) corners of the room; None: no room.
        errors: error model of the measurements; its largest `bend` is that of the room.
    """
    if room is None:
        return np.zeros(len(xy))
    narrow = np.sqrt(np.maximum(np.linalg.eigvalsh(information)[:, 0], 1e-300))
    out = ~inside_polygon(xy, room)
    beyond = np.array(
        [distance_to_boundary(x, y, room) if o else 0.0 for (x, y), o in zip(xy.tolist(), out, strict=True)]
    )
    most = float(errors.bend.max())
    return np.asarray(np.logaddexp(-0.5 * np.minimum(beyond * narrow, 1e6) ** 2, -0.5 * most**2))


def _cost(residual: Floats, errors: DistanceErrors) -> Floats:
    """Return (M,) negative log likelihoods of normalised residuals (M, n) under the error model, up to a constant."""
    return np.asarray(-log_density(residual, errors).sum(axis=1))


def _places(lines: BearingLines, distances: RangeMeasurements) -> Floats:
    """Return (n + 2 m, 2) positions of the sensors of n lines, and of stations and references of m distances."""
    return np.concatenate([lines.positions, distances.position, distances.other])


def _middle(lines: BearingLines, distances: RangeMeasurements) -> Floats:
    """Return the middle (2,) of the bounding box of all sensors and stations."""
    positions = _places(lines, distances)
    return np.asarray(0.5 * (positions.min(axis=0) + positions.max(axis=0)))


def _extent(lines: BearingLines, distances: RangeMeasurements) -> float:
    """Return the length scale of the problem.

    It is the larger side of the bounding box of sensors and stations, or the largest range if that is greater.
    """
    positions = _places(lines, distances)
    size = float(np.ptp(positions, axis=0).max())
    ranges = distances.value[distances.kind == RANGE]
    return max(size, float(ranges.max()) if len(ranges) else 0.0, 1e-9)
