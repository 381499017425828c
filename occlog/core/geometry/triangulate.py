"""Triangulation of positions from the azimuths of several sensors.

Scans are packed: the lines of scan s are the rows `starts[s]` to `starts[s + 1]`.

Also localisation of sources from unlabelled directions of arrival: with two arrays every direction of one crosses every
direction of the other. Crossings supported by most arrays are taken first, among these the best fitting and those near
known sources; every direction is used at most once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane import inside_polygon

from .camera import wrap_angle

TRIANGULATED = 0
TOO_FEW = 1
NEAR_PARALLEL = 2
DISAGREEING = 3
STATUS = ("met", "fewer than two lines", "lines nearly parallel", "lines meet behind a sensor or not at all")
"""What the status numbers of a `TriangulatedPoint` say."""

LOSSES = {"gauss": 0, "huber": 1, "cauchy": 2}
"""Losses of standardised residuals; the tuning constants below make each 95 % efficient on Gaussian noise."""

HUBER_K = 1.345
CAUCHY_C = 2.385


class TriangulatedPoint(NamedTuple):
    """Result of triangulation: position, covariance and status number of each scan, and the residual of each line.

    Positions, covariances and residuals are NaN where the status is not `TRIANGULATED`.
    """

    xy: Floats  # (S, 2)
    covariance: Floats  # (S, 2, 2)
    status: Ints  # (S,) see STATUS
    residual: Floats  # (R,) azimuth of the line minus that of the meeting point [rad]


def triangulate(
    origins: Floats,
    azimuths: Floats,
    sigmas: Floats,
    starts: Ints,
    loss: str = "gauss",
    min_crossing: float = math.radians(5.0),
) -> TriangulatedPoint:
    """Return the most likely position of a target for each scan, its covariance and status, and the lines' residuals.

    Minimises sum rho(wrap(azimuth - atan2(y - oy, x - ox)) / sigma) by Gauss-Newton with iterative reweighting, from
    the best crossing of two lines. With `gauss` this is the maximum likelihood estimate and the covariance the inverse
    of its Fisher information; the robust losses give outliers less weight, also in the covariance.

    Args:
        origins: (R, 2) sensor positions; the rows of a scan are consecutive.
        azimuths: (R,) of the lines [rad].
        sigmas: (R,) standard deviations [rad], > 0.
        starts: (S + 1,) first row of each scan, then R.
        loss: `gauss`, `huber` or `cauchy`.
        min_crossing: scans with lines that cross at smaller angles than this give no position [rad].

    Raises:
        ValueError: unknown loss.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss {loss!r} must be one of {', '.join(LOSSES)}")
    o, beta, sigma = (np.ascontiguousarray(a, dtype=np.float64) for a in (origins, azimuths, sigmas))
    rows = np.asarray(starts, dtype=np.int64)
    return TriangulatedPoint(*_triangulate_all(o, beta, sigma, rows, LOSSES[loss], math.sin(min_crossing)))


@kernel
def _wrap(angle: float) -> float:
    """Return an angle [rad] wrapped to [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@kernel
def _cost(r: float, loss: int) -> float:
    """Return the robust loss rho of a residual r in standard deviations.

    `loss` is 0 for r^2 / 2, 1 for Huber, 2 for Cauchy.
    """
    if loss == 1:
        a = abs(r)
        return 0.5 * r * r if a <= HUBER_K else HUBER_K * (a - 0.5 * HUBER_K)
    if loss == 2:
        return 0.5 * CAUCHY_C**2 * math.log1p((r / CAUCHY_C) ** 2)
    return 0.5 * r * r


@kernel
def _weight(r: float, loss: int) -> float:
    """Return the weight rho'(r) / r, 0 to 1, of a residual r in standard deviations, for reweighted least squares.

    `loss` is 0 for r^2 / 2, 1 for Huber, 2 for Cauchy.
    """
    if loss == 1:
        return min(1.0, HUBER_K / max(abs(r), 1e-300))
    if loss == 2:
        return 1.0 / (1.0 + (r / CAUCHY_C) ** 2)
    return 1.0


@kernel
def _total_cost(x: float, y: float, o: Floats, beta: Floats, sigma: Floats, loss: int) -> float:
    """Return the sum over R lines of the loss of their residuals at the position (x, y).

    Args:
        x: position.
        y: position.
        o: (R, 2) positions of the sensors.
        beta: (R,) azimuths of the lines [rad].
        sigma: (R,) their standard deviations [rad].
        loss: 0 for r^2 / 2, 1 for Huber, 2 for Cauchy.
    """
    total = 0.0
    for i in range(beta.shape[0]):
        total += _cost(_wrap(beta[i] - math.atan2(y - o[i, 1], x - o[i, 0])) / sigma[i], loss)
    return total


@kernel
def _best_crossing(o: Floats, beta: Floats, sigma: Floats, loss: int, min_sine: float) -> tuple[int, float, float]:
    """Return the best crossing of two of R lines: ahead of both sensors, with the least total loss over all lines.

    Args:
        o: (R, 2) positions of the sensors.
        beta: (R,) azimuths of the lines [rad].
        sigma: (R,) their standard deviations [rad].
        loss: number in `LOSSES`.
        min_sine: pairs with a smaller sine of the crossing angle are skipped.

    Returns:
        Status, x and y; `NEAR_PARALLEL` if all pairs are skipped, `DISAGREEING` if no crossing is ahead of its sensors.
    """
    status, best, x, y = NEAR_PARALLEL, np.inf, 0.0, 0.0
    for i in range(beta.shape[0]):
        for j in range(i):
            sine = math.sin(beta[j] - beta[i])
            if abs(sine) < min_sine:
                continue
            # Distances along both lines to their crossing, by Cramer's rule; both must be ahead of their sensors
            dx, dy = o[j, 0] - o[i, 0], o[j, 1] - o[i, 1]
            along_i = (dx * math.sin(beta[j]) - dy * math.cos(beta[j])) / sine
            along_j = (dx * math.sin(beta[i]) - dy * math.cos(beta[i])) / sine
            if along_i <= 0.0 or along_j <= 0.0:
                status = DISAGREEING if status == NEAR_PARALLEL else status
                continue
            px, py = o[i, 0] + along_i * math.cos(beta[i]), o[i, 1] + along_i * math.sin(beta[i])
            cost = _total_cost(px, py, o, beta, sigma, loss)
            if cost < best:
                status, best, x, y = TRIANGULATED, cost, px, py
    return status, x, y


@kernel
def _normal_equations(
    x: float, y: float, o: Floats, beta: Floats, sigma: Floats, loss: int
) -> tuple[float, float, float, float, float]:
    """Return the normal equations of the position at (x, y): the matrix as xx, xy, yy, and the right side as x, y.

    The matrix is A = sum w g g^T / sigma^2, the right side b = sum w g r / sigma, with g the gradient of a line's
    azimuth, r its residual in standard deviations, and w the weight of r by the loss.

    Args:
        x: position.
        y: position.
        o: (R, 2) positions of the sensors.
        beta: (R,) azimuths of the lines [rad].
        sigma: (R,) their standard deviations [rad].
        loss: 0 for r^2 / 2, 1 for Huber, 2 for Cauchy.
    """
    axx = axy = ayy = bx = by = 0.0
    for i in range(beta.shape[0]):
        dx, dy = x - o[i, 0], y - o[i, 1]
        r2 = max(dx * dx + dy * dy, 1e-300)
        gx, gy = -dy / r2 / sigma[i], dx / r2 / sigma[i]
        r = _wrap(beta[i] - math.atan2(dy, dx)) / sigma[i]
        w = _weight(r, loss)
        axx += w * gx * gx
        axy += w * gx * gy
        ayy += w * gy * gy
        bx += w * gx * r
        by += w * gy * r
    return axx, axy, ayy, bx, by


@kernel
def _refine(x: float, y: float, o: Floats, beta: Floats, sigma: Floats, loss: int) -> tuple[float, float]:
    """Return the position x, y of least total loss near (x, y), by Gauss-Newton steps with step halving.

    Args:
        x: start.
        y: start.
        o: (R, 2) positions of the sensors.
        beta: (R,) azimuths of the lines [rad].
        sigma: (R,) their standard deviations [rad].
        loss: number in `LOSSES`.
    """
    cost = _total_cost(x, y, o, beta, sigma, loss)
    for _ in range(60):
        axx, axy, ayy, bx, by = _normal_equations(x, y, o, beta, sigma, loss)
        # Gauss-Newton step: solve A s = b
        det = axx * ayy - axy * axy
        if not det > 1e-14 * axx * ayy:
            break
        sx, sy = (ayy * bx - axy * by) / det, (axx * by - axy * bx) / det
        # Halve the step until the cost does not rise
        step, trial = 1.0, np.inf
        while step > 1e-6:
            trial = _total_cost(x + step * sx, y + step * sy, o, beta, sigma, loss)
            if trial <= cost:
                break
            step *= 0.5
        if not trial <= cost:
            break
        x, y = x + step * sx, y + step * sy
        # Converged: gain below rounding of the cost, and a step far below the accuracy of the lines
        if cost - trial <= 1e-14 * cost and (sx * bx + sy * by) < 1e-14:
            break
        cost = trial
    return x, y


@kernel
def _crossing_sine(x: float, y: float, o: Floats, beta: Floats, sigma: Floats, loss: int) -> float:
    """Return the sine of the widest crossing angle of two lines that point at (x, y) with at least half weight.

    It is 0 if there are no two such lines; with the Gaussian loss, also if one of all lines points away.

    Args:
        x: position.
        y: position.
        o: (R, 2) positions of the sensors.
        beta: (R,) azimuths of the lines [rad].
        sigma: (R,) their standard deviations [rad].
        loss: 0 for r^2 / 2, 1 for Huber, 2 for Cauchy.
    """
    widest = 0.0
    for i in range(beta.shape[0]):
        ri = _wrap(beta[i] - math.atan2(y - o[i, 1], x - o[i, 0]))
        if abs(ri) >= 0.5 * math.pi and loss == 0:
            return 0.0
        if abs(ri) >= 0.5 * math.pi or _weight(ri / sigma[i], loss) < 0.5:
            continue
        for j in range(i):
            rj = _wrap(beta[j] - math.atan2(y - o[j, 1], x - o[j, 0]))
            if abs(rj) < 0.5 * math.pi and _weight(rj / sigma[j], loss) >= 0.5:
                widest = max(widest, abs(math.sin(beta[i] - beta[j])))
    return widest


@kernel
def _triangulate_one(
    o: Floats, beta: Floats, sigma: Floats, loss: int, min_sine: float
) -> tuple[int, float, float, float, float, float]:
    """Return status, x, y and covariance xx, xy, yy of one scan of R lines; NaN unless the status is `TRIANGULATED`.

    Args:
        o: (R, 2) positions of the sensors.
        beta: (R,) azimuths of the lines [rad].
        sigma: (R,) their standard deviations [rad].
        loss: number in `LOSSES`.
        min_sine: least sine of the widest crossing angle.
    """
    nan = np.nan
    if beta.shape[0] < 2:
        return TOO_FEW, nan, nan, nan, nan, nan
    # Start at the best crossing, then refine
    status, x, y = _best_crossing(o, beta, sigma, loss, min_sine)
    if status != TRIANGULATED:
        return status, nan, nan, nan, nan, nan
    x, y = _refine(x, y, o, beta, sigma, loss)
    # Covariance: inverse of the Fisher information, if the lines that count do point and cross there
    axx, axy, ayy, _, _ = _normal_equations(x, y, o, beta, sigma, loss)
    det = axx * ayy - axy * axy
    sine = _crossing_sine(x, y, o, beta, sigma, loss)
    if sine == 0.0 or not det > 0.0:
        return DISAGREEING, nan, nan, nan, nan, nan
    if sine < min_sine:
        return NEAR_PARALLEL, nan, nan, nan, nan, nan
    return TRIANGULATED, x, y, ayy / det, -axy / det, axx / det


@kernel
def _triangulate_all(
    origins: Floats, azimuths: Floats, sigmas: Floats, starts: Ints, loss: int, min_sine: float
) -> tuple[Floats, Floats, Ints, Floats]:
    """Return positions (S, 2), covariances (S, 2, 2), status numbers (S,) and residuals (R,) [rad] of S scans.

    All but the status is NaN where a scan is not `TRIANGULATED`.

    Args:
        origins: (R, 2) sensor positions.
        azimuths: (R,) of the lines [rad].
        sigmas: (R,) standard deviations [rad].
        starts: (S + 1,) first row of each scan, then R.
        loss: 0 for r^2 / 2, 1 for Huber, 2 for Cauchy.
        min_sine: least sine of the widest crossing angle.
    """
    n = starts.shape[0] - 1
    xy, covariance = np.empty((n, 2)), np.empty((n, 2, 2))
    status, residual = np.empty(n, dtype=np.int64), np.empty(azimuths.shape[0])
    for s in range(n):
        a, b = starts[s], starts[s + 1]
        met, x, y, cxx, cxy, cyy = _triangulate_one(origins[a:b], azimuths[a:b], sigmas[a:b], loss, min_sine)
        status[s], xy[s, 0], xy[s, 1] = met, x, y
        covariance[s, 0, 0], covariance[s, 1, 1] = cxx, cyy
        covariance[s, 0, 1] = covariance[s, 1, 0] = cxy
        for i in range(a, b):
            residual[i] = _wrap(azimuths[i] - math.atan2(y - origins[i, 1], x - origins[i, 0]))
    return xy, covariance, status, residual


NO_SOURCE = np.empty((0, 2))


class SourceDirections(NamedTuple):
    """R directions of sound (azimuths) of one time step, with number and position of the array that measured each."""

    array: Ints  # (R,) which array each is of
    origin: Floats  # (R, 2) where that array is
    azimuth: Floats  # (R,) [rad]
    sigma: Floats  # (R,) [rad], > 0


class LocatedSources(NamedTuple):
    """N positions of sources, with their covariances and the number of arrays with directions that support each."""

    xy: Floats  # (N, 2)
    covariance: Floats  # (N, 2, 2)
    arrays: Ints  # (N,)


def localise(
    d: SourceDirections, known: Floats, spread: Floats, region: Floats, gate: float, min_crossing: float
) -> LocatedSources:
    """Return the sources located from unlabelled directions of one time step.

    Directions of two arrays are crossed, those of other arrays near a crossing are added, and of these groups a set is
    chosen in which each direction is used once: larger groups first, then those that fit best and are near a known
    source.

    Args:
        d: directions, of any number of arrays.
        known: (K, 2) positions of the known sources.
        spread: (K, 2, 2) covariances of these positions.
        region: (P, 2) polygon in which sources can be.
        gate: largest residual of a direction that supports a position, in standard deviations.
        min_crossing: directions that cross at a smaller angle give no position [rad].
    """
    # Cross: every two directions of different arrays, inside the region
    i, j = np.triu_indices(len(d.array), 1)
    other = d.array[i] != d.array[j]
    pairs = np.column_stack([i[other], j[other]])
    xy, cov = _triangulate(d, list(pairs), min_crossing)
    good = np.isfinite(xy[:, 0])
    good[good] = inside_polygon(np.ascontiguousarray(xy[good]), region)
    pairs, xy, cov = pairs[good], xy[good], cov[good]
    # Associations: directions of other arrays that pass near a crossing form a group with it
    off = _misfit(d, xy, cov)
    rows = sorted({tuple(_support(d, pair, off[c], gate).tolist()) for c, pair in enumerate(pairs)})
    groups = [np.array(r, dtype=np.int64) for r in rows]
    # Fit: the position of each group, and the squared misfits of its directions
    xy, cov = _triangulate(d, groups, min_crossing)
    residual = _misfit(d, xy, np.zeros_like(cov))
    fit = np.array([np.sum(residual[g, r] ** 2) for g, r in enumerate(groups)])
    cost = fit + _nearest(xy, cov, known, spread, gate)
    # Gate: a group of n directions has n - 2 degrees of freedom
    good = np.isfinite(xy[:, 0]) & (fit <= gate**2 + np.array([len(r) - 2 for r in groups]))
    # Choose: groups that share no direction
    chosen = _choose([r if ok else r[:0] for r, ok in zip(groups, good, strict=True)], cost)
    counts = np.array([len(groups[g]) for g in chosen], dtype=np.int64)
    return LocatedSources(xy[chosen], cov[chosen], counts)


def _choose(groups: list[Ints], cost: Floats) -> list[int]:
    """Return the indices, sorted, of selected groups of directions that have no direction in common.

    The selected set has the largest sum of group sizes less one; of equal sets, the least total cost. Each group is
    tried as the first; the others are added greedily, larger ones first, then cheaper ones.

    Args:
        groups: indices of the directions of each of n groups; a group without directions is not selected.
        cost: (n,) cost of each group.
    """
    order = sorted((g for g in range(len(groups)) if len(groups[g])), key=lambda g: (-len(groups[g]), cost[g], g))
    sets = [frozenset(r.tolist()) for r in groups]
    best: tuple[float, ...] = (0.0,)
    chosen: list[int] = []
    for first in order:
        taken, mine = set(sets[first]), [first]
        for g in order:
            if not taken & sets[g]:
                taken |= sets[g]
                mine.append(g)
        # A group of two directions always fits, so that larger groups go first here as well.
        score = (-sum(len(groups[g]) - 1 for g in mine), float(np.sum(cost[mine])), *sorted(map(float, mine)))
        if score < best or not chosen:
            best, chosen = score, sorted(mine)
    return chosen


def _triangulate(d: SourceDirections, rows: list[Ints], min_crossing: float) -> tuple[Floats, Floats]:
    """Return positions (n, 2) and covariances (n, 2, 2) of n groups of directions; NaN if the lines do not meet.

    Args:
        d: directions of one time step.
        rows: of each group, the indices of its directions in `d`.
        min_crossing: least angle between two lines [rad].
    """
    if not rows:
        return NO_SOURCE, np.empty((0, 2, 2))
    flat = np.concatenate(rows)
    starts = np.concatenate([[0], np.cumsum([len(r) for r in rows])])
    m = triangulate(d.origin[flat], d.azimuth[flat], d.sigma[flat], starts, "gauss", min_crossing)
    return np.where((m.status == TRIANGULATED)[:, None], m.xy, np.nan), m.covariance


def _misfit(d: SourceDirections, xy: Floats, cov: Floats) -> Floats:
    """Return the (C, R) absolute residual of each of R directions at each of C positions, in standard deviations.

    The variance is that of the direction and of the position, projected on the azimuth.

    Args:
        d: R directions of one time step.
        xy: (C, 2) positions.
        cov: (C, 2, 2) covariances of the positions.
    """
    away = xy[:, None] - d.origin[None]
    r2 = np.maximum(np.sum(away**2, axis=2), 1e-300)
    gradient = np.stack([-away[:, :, 1], away[:, :, 0]], axis=2) / r2[:, :, None]
    variance = np.einsum("cri,cij,crj->cr", gradient, cov, gradient) + d.sigma**2
    residual = wrap_angle(d.azimuth - np.arctan2(away[:, :, 1], away[:, :, 0]))
    return np.asarray(np.abs(residual) / np.sqrt(variance))


def _support(d: SourceDirections, pair: Ints, off: Floats, gate: float) -> Ints:
    """Return the sorted indices of directions that support a position.

    They are the two directions that cross there, and of each other array the one with the least residual.

    Args:
        d: R directions of one time step.
        pair: (2,) indices of the two directions that cross at the position.
        off: (R,) absolute residuals at the position, in standard deviations.
        gate: limit of the residual; an array without a direction within it does not contribute.
    """
    rows = pair.tolist()
    for a in np.unique(d.array).tolist():
        if a in d.array[pair]:
            continue
        mine = np.flatnonzero((d.array == a) & (off <= gate))
        rows += [int(mine[np.argmin(off[mine])])] if len(mine) else []
    return np.array(sorted(rows), dtype=np.int64)


def _nearest(xy: Floats, cov: Floats, known: Floats, spread: Floats, gate: float) -> Floats:
    """Return the (C,) squared Mahalanobis distance of each position to the nearest known source, at most gate^2.

    It is gate^2 without known sources.

    Args:
        xy: (C, 2) positions.
        cov: (C, 2, 2) their covariances.
        known: (K, 2) known sources.
        spread: (K, 2, 2) their covariances.
        gate: limit of the distance, in standard deviations.
    """
    if not len(known) or not len(xy):
        return np.full(len(xy), gate**2)
    return np.asarray(np.minimum(distance2(xy, cov, known, spread).min(axis=1), gate**2))


def distance2(xy: Floats, cov: Floats, known: Floats, spread: Floats) -> Floats:
    """Return the (C, K) squared Mahalanobis distances between positions and known sources.

    The covariance of a difference is the sum of both covariances.

    Args:
        xy: (C, 2) positions.
        cov: (C, 2, 2) their covariances.
        known: (K, 2) known sources.
        spread: (K, 2, 2) their covariances.
    """
    away = xy[:, None] - known[None]
    both = cov[:, None] + spread[None]
    return np.asarray(np.einsum("cki,cki->ck", away, np.linalg.solve(both, away[..., None])[..., 0]))
