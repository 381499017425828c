"""Where a search with measurements of distances begins: on paths through the modes of short windows.

A line of sight meets the circle of a range at two positions, as two circles do, and stations on a line do not tell one
side from the other: what is measured in a second fits several positions.  These modes, each a Gaussian of position and
velocity, are found in every window by itself: from the minima of a grid, and from the mirror images of the best one.
Paths that pass through one mode of each window and turn least are candidates of the whole
(`occlog.track.methods.map.kernels.mode_path`).  Costs are those of the most probable trajectory: where the motion is
smoother than stated, volumes would prefer modes that leave it more room.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.filtering.likelihood.distances import (
    LOGARITHM,
    RANGE,
    DistanceErrors,
    RangeMeasurements,
    linearise,
    log_density,
    residuals_at_own_position,
    score_and_information,
    without_detours,
)
from occlog.track.methods.map.kernels.interior_point import Options, minimise
from occlog.track.methods.map.kernels.mode_path import ModeChain, distinct_paths, pair_costs
from occlog.track.methods.map.kernels.problem import NO_PLANES, QuadraticPriors, TrajectoryProblem, some_lines
from occlog.track.methods.map.record import TargetRecord

from .problem_of_record import BEND, Pending
from .start import ConsensusPath, rays_of

GRID, MAX_MODES = 20, 6
"""Positions a side of the grid on which modes are sought, and modes of a window at most."""
WINDOW_S, MAX_WINDOW_S, MIN_MEASUREMENTS = 1.0, 3.0, 8
"""Least time of a window [s], and longest one where fewer measurements are in it."""
MAX_LOG_GAP = 20.0
"""Modes, and paths, with a log probability below the best one minus this are omitted."""
MERGE_SIGMAS = 1.0
"""Modes nearer to a better one, in its standard deviations, are the same."""
RELATIVE_RIDGE, AXES = 1e-12, np.arange(4)
"""Share by which diagonals of Hessians are enlarged, which are singular by rounding at a sensor; and their indices."""
MAX_SOURCES = 3
"""Sensors and stations of a window, at most, of which mirror images of modes are tried."""
CELLS = (0.5, 0.25, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Errors of the position that standard deviations hold also, in cells of the grid, while modes are climbed."""
MAX_STARTS = 4
"""Number of paths from which the search begins."""
BATCH = 64
"""Windows that are searched at once."""


class WindowMeasurements(NamedTuple):
    """Measurements of a record in W successive short windows: N lines of sight, then m distances.

    `lines` (N, 6) are sensor position, unit direction, and a, b of the variance a d^2 + b across the line at distance
    d; `window` and `seconds` are pairs (for lines, for distances) of the window's index and the time after that of the
    window's state [s]; `state` (W,) is the index of the state in the middle; `noise` the variance that the velocity
    gains in 1 s.
    """

    lines: Floats  # (N, 6) position, direction, a and b of `BearingHalfLines`
    distances: RangeMeasurements  # m, in the coordinates of the search
    window: tuple[Ints, Ints]  # (N,) and (m,), ascending
    seconds: tuple[Floats, Floats]  # (N,) and (m,) after the time of the window's state [s]
    state: Ints  # (W,) state in the middle of each window
    noise: float  # variance that the velocity gathers in a second, on average over the steps, per axis


class WindowModes(NamedTuple):
    """K modes of the likelihood in short windows, sorted by window.

    `window` (K,), state `x` (K, 4) x, vx, y, vy at the window's middle, `covariance` (K, 2, 2) of the position, `cost`
    (K,) the negative log of likelihood and prior.
    """

    window: Ints  # (K,)
    x: Floats  # (K, 4) state at the middle of the window
    covariance: Floats  # (K, 2, 2) of the position
    cost: Floats  # (K,) - log of the likelihood and the prior


def mode_starts(
    problem: TrajectoryProblem, record: TargetRecord, pending: Pending, distances: RangeMeasurements
) -> list[ConsensusPath]:
    """Return paths through the modes of short windows, the most probable first; one smooth path without measurements.

    Args:
        problem: cost and constraints of a trajectory of T states.
        record: measurements at these T times.
        pending: unreleased part of the target's record.
        distances: the record's distance measurements in the coordinates of the search.
    """
    rows, steps = _windows(problem, record, pending, distances), problem.steps
    if not len(rows.state):
        nothing = WindowModes(rows.state, np.empty((0, 4)), np.empty((0, 2, 2)), np.empty(0))
        return [_along(problem, rows, nothing, rows.state)]
    modes, seconds = _modes(rows, pending), (record.t_ns[rows.state] - record.t_ns[0]) / NS
    # Prior of the first position
    first = modes.window == 0
    spread = steps.spread[::2, ::2] + modes.covariance[first]
    away = modes.x[first, ::2] - steps.mean[::2] - seconds[0] * steps.mean[1::2]
    modes.cost[first] += 0.5 * np.einsum("ki,kij,kj->k", away, np.linalg.inv(spread), away)
    W = len(rows.state)
    chain = ModeChain(
        np.searchsorted(modes.window, np.arange(W + 1)),
        seconds,
        np.ascontiguousarray(modes.x[:, ::2]),
        modes.covariance,
        modes.cost,
    )
    if W == 1:
        paths = [np.array([k]) for k in np.argsort(modes.cost, kind="stable").tolist()[:MAX_STARTS]]
    else:
        pairs = pair_costs(chain, rows.noise, steps.mean[1::2].copy(), np.ascontiguousarray(steps.spread[1::2, 1::2]))
        paths = distinct_paths(chain, pairs, MAX_STARTS, MAX_LOG_GAP)
    return [_along(problem, rows, modes, path) for path in paths]


def _along(problem: TrajectoryProblem, rows: WindowMeasurements, modes: WindowModes, path: Ints) -> ConsensusPath:
    """Return the most probable path through one mode per window, and the bearings that agree with it.

    The modes' Gaussians replace the measurements.

    Args:
        problem: cost and constraints of a trajectory of T states.
        rows: measurements in W windows.
        modes: modes of the windows.
        path: (W,) index of the mode of each window.
    """
    xy, covariance = np.ascontiguousarray(modes.x[path, ::2]), modes.covariance[path]
    information = np.linalg.inv(covariance)
    bend = np.column_stack([information[:, 0, 0], information[:, 0, 1], information[:, 1, 1]])
    none = np.zeros(len(problem.lines.step), dtype=np.bool_)
    hints = QuadraticPriors(rows.state, xy, np.zeros_like(xy), bend)
    smooth = problem._replace(lines=some_lines(problem.lines, none), planes=NO_PLANES, hints=hints)
    X = minimise(smooth, np.zeros((problem.T, 4)), Options(np.inf)).X
    # Lines of sight that agree with the path, which is smoother than the target's motion in a window
    residual, gradient = lines_at(rows.lines, X[problem.lines.step, ::2])
    moved = rows.noise * np.abs(rows.seconds[0]) ** 3 / 3.0
    spread = covariance[rows.window[0]] + moved[:, None, None] * np.eye(2)
    variance = 1.0 + np.einsum("ni,nij,nj->n", gradient, spread, gradient)
    return ConsensusPath(X, np.abs(residual) < BEND["mixture"] * np.sqrt(variance), 0.0)


def _windows(
    problem: TrajectoryProblem, record: TargetRecord, pending: Pending, distances: RangeMeasurements
) -> WindowMeasurements:
    """Return the measurements in successive windows of at least `WINDOW_S`, up to `MAX_WINDOW_S` where they are few.

    Args:
        problem: cost of a trajectory of T states, with its lines of sight.
        record: measurements at these T times.
        pending: unreleased part of the target's record.
        distances: the record's distance measurements in the coordinates of the search.
    """
    rays = rays_of(problem.lines, record, pending.at)
    lines = np.column_stack([rays.position, rays.direction, rays.a, rays.b])
    seconds = (record.t_ns - record.t_ns[0]) / NS
    counts = np.bincount(np.concatenate([rays.step, record.measured_state]), minlength=len(seconds))
    window = np.zeros(len(seconds), dtype=np.int64)
    begun, count, number = -np.inf, 0, -1
    for t, (now, more) in enumerate(zip(seconds.tolist(), counts.tolist(), strict=True)):
        if more and (now >= begun + (WINDOW_S if count >= MIN_MEASUREMENTS else MAX_WINDOW_S)):
            begun, count, number = now, 0, number + 1
        window[t], count = number, count + more
    used = np.flatnonzero(counts)
    weight = counts[used].astype(np.float64)
    middle = np.bincount(window[used], weight * seconds[used]) / np.bincount(window[used], weight)
    # The state that is nearest to the mean time
    nearest = used[np.lexsort((np.abs(seconds[used] - middle[window[used]]), window[used]))]
    state = nearest[np.searchsorted(window[nearest], np.arange(number + 1))]
    own = window[rays.step], window[record.measured_state]
    after = (
        seconds[rays.step] - seconds[state[own[0]]],
        seconds[record.measured_state] - seconds[state[own[1]]],
    )
    collected = float(problem.steps.sigma[problem.steps.kind][:, (1, 3), (1, 3)].sum()) / 2.0
    noise = collected / max(float(seconds[-1]), 1e-9)
    return WindowMeasurements(lines, distances, own, after, state, noise)


def _modes(rows: WindowMeasurements, pending: Pending) -> WindowModes:
    """Return the distinct modes of all windows: refined minima of a grid, and mirror images of the best ones.

    `pending` gives settings and room.
    """
    grid, cell = _grid(rows, pending)
    W = len(rows.state)
    speed = max(pending.config.sigma_initial_velocity, pending.config.process_noise_velocity)
    scale = ClimbScale(cell, speed, max(float(np.ptp(grid[:, 0])), pending.extent), pending.at.hull)
    parts = [_grid_minima(rows, grid, cell, speed, slice(w, min(w + BATCH, W))) for w in range(0, W, BATCH)]
    found = _climbed(rows, scale, *(np.concatenate(column) for column in zip(*parts, strict=True)))
    window, images = _mirrored(rows, found)
    if len(window):
        mirrored = _climbed(rows, scale, window, images)
        found = WindowModes._make(np.concatenate(both) for both in zip(found, mirrored, strict=True))
    return _distinct(found)


class ClimbScale(NamedTuple):
    """Scales of length and velocity of the mode search.

    `cell` is the distance of the positions at which climbs begin, `speed` the standard deviation of the velocity per
    axis, `extent` that of the position, `hull` (H, 2) the convex room, counter-clockwise (None: no room).
    """

    cell: float  # distance of positions at which climbs begin
    speed: float  # standard deviation of the velocity, per axis
    extent: float  # of the position
    hull: Floats | None  # (H, 2) the room, convex and counter-clockwise


def _climbed(rows: WindowMeasurements, scale: ClimbScale, window: Ints, xy: Floats) -> WindowModes:
    """Refine modes from initial positions by reweighted Gauss-Newton steps, with widened measurements at first.

    Unknowns are the position at a window's middle and a constant velocity.

    Args:
        rows: measurements of all windows.
        scale: scales of the search.
        window: (K,) window of each mode.
        xy: (K, 2) initial positions.
    """
    x = np.zeros((len(window), 4))
    x[:, ::2] = xy
    prior = np.diag([scale.extent**-2, scale.speed**-2] * 2)
    pairs = _pairs_of(rows, window)
    for share in CELLS:
        residual, gradient = _seen(pairs, x)
        variance = 1.0 + (share * scale.cell) ** 2 * (gradient[:, ::2] ** 2).sum(axis=1)
        root = np.sqrt(variance)
        pull = score_and_information(residual / root, pairs.errors.widened(variance))
        gradient /= root[:, None]
        H = prior + _sums(pairs.node, pull.weight, gradient, gradient, len(x))
        H[:, AXES, AXES] *= 1.0 + RELATIVE_RIDGE
        g = _sums(pairs.node, pull.slope, gradient, np.ones((len(gradient), 1)), len(x))[..., 0]
        g[:, 1::2] -= x[:, 1::2] * prior[1, 1]
        step = np.linalg.solve(H, g[..., None])[..., 0]
        x += step * np.minimum(1.0, scale.cell / np.maximum(np.hypot(step[:, 0], step[:, 2]), 1e-300))[:, None]
    residual, _ = _seen(pairs, x)
    covariance = np.ascontiguousarray(np.linalg.inv(H)[:, ::2, ::2])
    misfit = np.bincount(pairs.node, -log_density(residual, pairs.errors), minlength=len(x))
    velocity = 0.5 * prior[1, 1] * (x[:, 1::2] ** 2).sum(axis=1)
    cost = np.asarray(misfit + velocity + _outside(x[:, ::2], covariance, scale.hull))
    return WindowModes(window, x, covariance, cost)


def _mirrored(rows: WindowMeasurements, found: WindowModes) -> tuple[Ints, Floats]:
    """Return windows (K,) and positions (K, 2) of the mirror images of each window's best mode.

    A line of sight meets the circle of a range at two positions, one on either side of the foot of the station on it;
    two circles do so on either side of the line through their stations.  A third station distinguishes them, unless
    it is next to that line; so windows with more than `MAX_SOURCES` sensors and stations have no images.
    """
    best = np.lexsort((found.cost, found.window))
    best = best[np.append(True, np.diff(found.window[best]) > 0)]
    ring = (rows.distances.kind == RANGE) | (rows.distances.kind == LOGARITHM)
    lines, circles = rows.lines[:, :2], rows.distances.position
    windows, images = [np.empty(0, dtype=np.int64)], [np.empty((0, 2))]
    for k in best.tolist():
        w, x = int(found.window[k]), found.x[k, ::2]
        own = [slice(*np.searchsorted(column, (w, w + 1)).tolist()) for column in rows.window]
        origins = np.unique(lines[own[0]], axis=0)
        stations = np.unique(circles[own[1]][ring[own[1]]], axis=0)
        if len(origins) + len(stations) > MAX_SOURCES:
            continue
        for i, s in enumerate(stations):
            for at in origins:
                ahead = (x - at) / max(float(np.hypot(*(x - at))), 1e-12)
                images.append((x + 2.0 * float((s - x) @ ahead) * ahead)[None])
            for other in stations[:i]:
                along = (s - other) / float(np.hypot(*(s - other)))
                images.append((2.0 * (other + float((x - other) @ along) * along) - x)[None])
        windows.append(np.full(len(images) - 1 - sum(map(len, windows)), w))
    return np.concatenate(windows), np.concatenate(images)


def _grid(rows: WindowMeasurements, pending: Pending) -> tuple[Floats, float]:
    """Return grid positions (GRID^2, 2) over the room's bounding box, and the larger of the two spacings.

    Without a room the grid is a square around the sensors and stations of the measurements `rows`.
    """
    at = rows.distances
    places = np.concatenate([rows.lines[:, :2], at.position, at.other])
    low, high = places.min(axis=0), places.max(axis=0)
    if pending.at.hull is not None:
        low, high = pending.at.hull.min(axis=0), pending.at.hull.max(axis=0)
    else:
        size = max(float((high - low).max()), pending.extent)
        low, high = 0.5 * (low + high) - size, 0.5 * (low + high) + size
    x, y = np.linspace(low, high, GRID).T
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return grid, float(max(x[1] - x[0], y[1] - y[0]))


def _grid_minima(
    rows: WindowMeasurements, grid: Floats, cell: float, speed: float, windows: slice
) -> tuple[Ints, Floats]:
    """Return windows (K,) and grid positions (K, 2) at local minima of the windows' costs.

    Args:
        rows: measurements of all windows.
        grid: (GRID^2, 2) positions.
        cell: spacing of the grid.
        speed: standard deviation of the velocity, per axis.
        windows: range of the windows to search.

    Returns:
        At most 2 `MAX_MODES` for each window, those of least cost, sorted by window.
    """
    ticks = np.arange(windows.start, windows.stop + 1)
    cost = np.zeros((len(grid), windows.stop - windows.start))
    parts = [slice(*np.searchsorted(own, ticks[[0, -1]]).tolist()) for own in rows.window]
    own = rows.distances.take(parts[1])
    seen = (lines_at(rows.lines[parts[0]], grid[:, None]), tuple(linearise(own, grid)))
    bends = (BEND["mixture"], own.bend)
    for (residual, gradient), bend, part, window, after in zip(
        seen, bends, parts, rows.window, rows.seconds, strict=True
    ):
        # Half a cell, and the motion in the window, widen every measurement; a false one costs k^2 / 2
        wide = 0.5 * cell + speed * np.abs(after[part])
        variance = 1.0 + wide**2 * (gradient**2).sum(axis=2)
        each = np.minimum(0.5 * residual**2 / variance + 0.5 * np.log(variance), 0.5 * bend**2)
        total = np.cumsum(np.pad(each, ((0, 0), (1, 0))), axis=1)
        cost += np.diff(total[:, np.searchsorted(window[part], ticks)], axis=1)
    square = np.pad(cost.T.reshape(-1, GRID, GRID), ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    neighbours = [(i, j) for i in (0, 1, 2) for j in (0, 1, 2) if (i, j) != (1, 1)]
    around = np.min([square[:, i : i + GRID, j : j + GRID] for i, j in neighbours], axis=0).reshape(-1, GRID**2)
    window, place = np.nonzero(around >= cost.T)
    order = np.lexsort((cost[place, window], window))
    window, place = window[order], place[order]
    best = np.arange(len(window)) - np.searchsorted(window, window) < 2 * MAX_MODES
    return windows.start + window[best], grid[place[best]]


class ModePairs(NamedTuple):
    """Each of K modes paired with every measurement of its window: P pairs, lines of sight (L) first.

    `node` (P,) is the mode, `lines` (L, 6) and `distances` (P - L) the measurements, `seconds` (P,) their time after
    the mode's [s], `errors` the error model of all.
    """

    node: Ints  # (P,) mode, for lines of sight first
    lines: Floats  # (L, 6)
    distances: RangeMeasurements  # P - L
    seconds: Floats  # (P,)
    errors: DistanceErrors  # of P


def _pairs_of(rows: WindowMeasurements, mode_window: Ints) -> ModePairs:
    """Return each of K modes paired with all measurements of its window.

    `mode_window` (K,) is the window of each mode.
    """
    nodes, chosen = [], []
    for own in rows.window:
        first = np.searchsorted(own, mode_window)
        count = np.searchsorted(own, mode_window, side="right") - first
        nodes.append(np.repeat(np.arange(len(mode_window)), count))
        chosen.append(np.arange(count.sum()) + np.repeat(first - np.cumsum(count) + count, count))
    distances = rows.distances.take(chosen[1])
    bends = [np.full(len(chosen[0]), BEND["mixture"]), np.full(len(chosen[1]), distances.bend)]
    after = np.concatenate([s[c] for s, c in zip(rows.seconds, chosen, strict=True)])
    return ModePairs(
        np.concatenate(nodes), rows.lines[chosen[0]], distances, after, without_detours(np.concatenate(bends))
    )


def lines_at(lines: Floats, xy: Floats) -> tuple[Floats, Floats]:
    """Return residuals (..., n) [standard deviations] and gradients (..., n, 2) of lines of sight at positions.

    `lines` (n, 6) are sensor position, unit direction, and a, b of the variance a d^2 + b across the line at distance
    d; `xy` (..., n or 1, 2) are positions. A residual is of the measured direction against the position's.
    """
    away = xy - lines[:, :2]
    across = lines[:, 2] * away[..., 1] - lines[:, 3] * away[..., 0]
    along = lines[:, 2] * away[..., 0] + lines[:, 3] * away[..., 1]
    d2 = np.maximum((away**2).sum(axis=-1), 1e-12)
    sigma = np.sqrt(lines[:, 4] + lines[:, 5] / d2)
    gradient = np.stack([-away[..., 1], away[..., 0]], axis=-1) / (d2 * sigma)[..., None]
    return -np.arctan2(across, along) / sigma, gradient


def _seen(pairs: ModePairs, x: Floats) -> tuple[Floats, Floats]:
    """Return normalised residuals (P,) and gradients (P, 4) of paired measurements at the modes' states `x` (K, 4)."""
    own = x[pairs.node]
    xy = own[:, ::2] + pairs.seconds[:, None] * own[:, 1::2]
    L = len(pairs.lines)
    parts = lines_at(pairs.lines, xy[:L]), residuals_at_own_position(pairs.distances, xy[L:])
    residual, gradient = (np.concatenate(both) for both in zip(*parts, strict=True))
    whole = np.empty((len(residual), 4))
    whole[:, ::2], whole[:, 1::2] = gradient, gradient * pairs.seconds[:, None]
    return residual, whole


def _outside(xy: Floats, covariance: Floats, hull: Floats | None) -> Floats:
    """Return (K,) costs of positions outside the room: half the squared distance from it in standard deviations.

    Args:
        xy: (K, 2) positions.
        covariance: (K, 2, 2) of them.
        hull: (H, 2) corners of the room, convex and counter-clockwise; None: no room, costs 0.
    """
    if hull is None:
        return np.zeros(len(xy))
    edge = np.roll(hull, -1, axis=0) - hull
    outward = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.hypot(edge[:, 0], edge[:, 1])[:, None]
    beyond = np.einsum("khj,hj->kh", xy[:, None] - hull, outward)
    variance = np.einsum("hj,kji,hi->kh", outward, covariance, outward)
    return np.asarray(0.5 * (np.maximum(beyond, 0.0) ** 2 / np.maximum(variance, 1e-300)).max(axis=1))


def _distinct(modes: WindowModes) -> WindowModes:
    """Return the probable modes of each window, the best first, without those close to a better one.

    At most `MAX_MODES` per window; modes `MAX_LOG_GAP` above the best one's cost are dropped.
    """
    information = np.linalg.inv(modes.covariance)
    kept: list[int] = []
    own: list[int] = []
    for k in np.lexsort((modes.cost, modes.window)).tolist():
        if own and modes.window[own[0]] != modes.window[k]:
            own = []
        if own and (len(own) == MAX_MODES or modes.cost[k] > modes.cost[own[0]] + MAX_LOG_GAP):
            continue
        away = modes.x[own, ::2] - modes.x[k, ::2]
        if (np.einsum("ni,nij,nj->n", away, information[own], away) > MERGE_SIGMAS**2).all():
            own.append(k)
            kept.append(k)
    return WindowModes._make(column[kept] for column in modes)


def _sums(node: Ints, weight: Floats, left: Floats, right: Floats, K: int) -> Floats:
    """Return (K, a, b) sums over each mode's pairs of weight times the outer product of `left` and `right`.

    `node` (P,) is the mode of each pair; `weight` (P,), `left` (P, a), `right` (P, b).
    """
    out = np.empty((K, left.shape[1], right.shape[1]))
    for i in range(left.shape[1]):
        for j in range(right.shape[1]):
            out[:, i, j] = np.bincount(node, weight * left[:, i] * right[:, j], minlength=K)
    return out
