"""Where a search begins: on a path on which most lines of sight agree (`occlog.track.methods.map.kernels.ransac_path`).

Where a search with measurements of distances begins: Kalman filters from many positions, the best one smoothed.

A likelihood of ranges has several modes, and the first measurements may leave open which is the target's.  An extended
Kalman filter runs along the record from each position of a grid that the first measurements fit better than positions
next to it.  It passes over measurements that are more probably false; filters that become improbable end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.filtering.likelihood.distances import (
    RANGE,
    DistanceErrors,
    RangeMeasurements,
    inlier_probability,
    linearise,
    log_density,
    without_detours,
)
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.problem import BearingLinesByStep, TrajectoryProblem
from occlog.track.methods.map.kernels.ransac_path import BearingHalfLines, agreed_path
from occlog.track.methods.map.measurements import SensorStations
from occlog.track.methods.map.record import TargetRecord

from .problem_of_record import BEND, Pending


class ConsensusPath(NamedTuple):
    """A path, and the lines of sight that agree with it."""

    X: Floats  # (T, 4) states
    agree: Bools  # (N,) lines of sight that agree with it
    cost: float  # -2 log of the likelihood, up to a constant


def rays_of(lines: BearingLinesByStep, record: TargetRecord, at: SensorStations) -> BearingHalfLines:
    """The lines of sight as half-lines with the variance across them, by [Ercan] Eq. 2."""
    sensor = record.rows.sensor[record.rows.seen]
    left = np.column_stack([-lines.axis[:, 1], lines.axis[:, 0]])
    ratio = np.where(lines.direction, 0.0, lines.reading / lines.focal)
    ratio2 = 1.0 + ratio**2
    direction = (lines.axis + ratio[:, None] * left) / np.sqrt(ratio2)[:, None]
    to_angle = np.where(lines.direction, 1.0, 1.0 / (lines.focal * ratio2)) ** 2
    return BearingHalfLines(
        step=lines.step,
        sensor=sensor,
        position=lines.position,
        direction=np.ascontiguousarray(direction),
        a=lines.c0 * to_angle,
        # c1 belongs to the distance along the axis.
        b=lines.c1 * to_angle * ratio2,
        reach=at.range[sensor],
    )


def ransac_path(
    problem: TrajectoryProblem, record: TargetRecord, at: SensorStations, config: MapConfig, extent: float, bend: float
) -> ConsensusPath:
    """The most probable choice of true lines of sight, and a path along them.

    Args:
        problem: of T states; its lines of sight are of the rows of the record that saw the target.
        record: the same T states.
        at: the sensors.
        config: settings.
        extent: size of the position.
        bend: standard deviations beyond which a line of sight does not agree.
    """
    rays = rays_of(problem.lines, record, at)
    first = np.searchsorted(rays.step, np.arange(len(record.t_ns) + 1))
    seconds = (record.t_ns - record.t_ns[0]) / NS
    ground = np.array(
        [max(config.sigma_initial_velocity, config.process_noise_velocity), config.max_position_sigma * extent, extent]
    )
    return ConsensusPath(*agreed_path(rays, first, seconds, problem.steps, ground, bend))


GRID, MAX_FILTERS, FIRST_S, FIRST = 30, 24, 2.0, 100
"""Places a side, most filters, and the time [s] and the number of measurements that decide where they begin."""
MAX_LOG_GAP, MERGE_DISTANCE_EXTENTS = 20.0, 1e-3
"""Filters that are less probable by so much in the logarithm end, and those nearer to a better one, by the extent."""
MAX_RELATIVE_START_SIGMA = 0.05
"""A start that is known to a smaller share of the extent is the only one."""
MAX_STARTS = 4
"""Number of filters that give initial paths of the search."""
MAX_STATES = 1000
"""Number of states after which the best filter is chosen."""


class SearchMeasurements(NamedTuple):
    """All measurements of a record of T states, in the coordinates of the search."""

    lines: Floats  # (N, 6) position, direction, a and b of `BearingHalfLines`
    line_first: Ints  # (T + 1,) first line of each state
    distances: RangeMeasurements  # m
    distance_first: Ints  # (T + 1,)


class FilterBank(NamedTuple):
    """H filters."""

    x: Floats  # (H, 4)
    P: Floats  # (H, 4, 4)
    log: Floats  # (H,) log-likelihood so far


def filtered_starts(
    problem: TrajectoryProblem, record: TargetRecord, pending: Pending, distances: RangeMeasurements
) -> list[Floats]:
    """(T, 4) states of the most probable filters, smoothed, the most probable one first.

    Args:
        problem: of T states.
        record: the same T states.
        pending: the target.
        distances: the record's measurements in the coordinates of the search.
    """
    T, steps = len(record.t_ns), problem.steps
    rays = rays_of(problem.lines, record, pending.at)
    lines = np.column_stack([rays.position, rays.direction, rays.a, rays.b])
    every = np.arange(T + 1)
    state = record.measured_state
    rows = SearchMeasurements(lines, np.searchsorted(rays.step, every), distances, np.searchsorted(state, every))
    bank = _begun(rows, record, pending)
    # Choose: run all filters until one is left
    hull = pending.at.hull
    first, starts = np.arange(len(bank.log)), _updated(bank, rows, 0)
    bank = _in_room(starts, hull)
    for t in range(1, min(T, MAX_STATES)):
        kept = _kept(bank, pending.extent)
        bank, first = FilterBank(*(column[kept] for column in bank)), first[kept]
        if len(first) == 1:
            break
        bank = _updated(_predicted(bank, steps.A[steps.kind[t - 1]], steps.sigma[steps.kind[t - 1]]), rows, t)
        bank = _in_room(bank, hull)
    order = np.argsort(-bank.log, kind="stable")
    chosen = [first[k] for k in order.tolist() if bank.log[k] >= bank.log[order[0]] - MAX_LOG_GAP][:MAX_STARTS]
    return [_smoothed(FilterBank(*(column[[k]] for column in starts)), rows, problem) for k in chosen]


def _smoothed(one: FilterBank, rows: SearchMeasurements, problem: TrajectoryProblem) -> Floats:
    """(T, 4) states of a filter, given as it is at the first state, by the recursion of Rauch, Tung and Striebel."""
    T, steps = len(rows.line_first) - 1, problem.steps
    found, spread = [one.x[0]], [one.P[0]]
    ahead: list[tuple[Floats, Floats]] = []
    for t in range(1, T):
        one = _predicted(one, steps.A[steps.kind[t - 1]], steps.sigma[steps.kind[t - 1]])
        ahead.append((one.x[0], one.P[0]))
        one = _updated(one, rows, t)
        found.append(one.x[0])
        spread.append(one.P[0])
    X = np.array(found)
    for t in range(T - 2, -1, -1):
        gain = np.linalg.solve(ahead[t][1], steps.A[steps.kind[t]] @ spread[t]).T
        X[t] += gain @ (X[t + 1] - ahead[t][0])
    return X


def _begun(rows: SearchMeasurements, record: TargetRecord, pending: Pending) -> FilterBank:
    """Filters at the positions that the first measurements fit best, or at what is known from before."""
    before, extent = pending.before, pending.extent
    if np.sqrt(np.linalg.eigvalsh(before.spread[::2, ::2])[-1]) < MAX_RELATIVE_START_SIGMA * extent:
        return FilterBank(before.mean[None].copy(), before.spread[None].copy(), np.zeros(1))
    positions = np.concatenate([rows.lines[:, :2], rows.distances.position, rows.distances.other])
    low, high = positions.min(axis=0), positions.max(axis=0)
    size = max(float((high - low).max()), extent)
    side = np.linspace(-1.0, 1.0, GRID) * size
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) + 0.5 * (low + high)
    cell, speed = float(side[1] - side[0]), float(np.sqrt(before.spread[1, 1]))
    # The motion so far, and half a cell, widen every measurement
    cost, counted = np.zeros(len(grid)), 0
    for t, t_ns in enumerate(record.t_ns.tolist()):
        dt = (t_ns - int(record.t_ns[0])) / NS
        if counted and (dt > FIRST_S or counted > FIRST):
            break
        residual, gradient, errors = _seen(rows, t, grid)
        wide = 1.0 + (0.5 * cell + min(speed, pending.config.sigma_initial_velocity) * dt) ** 2 * (gradient**2).sum(
            axis=2
        )
        cost -= log_density(residual / np.sqrt(wide), errors.widened(wide)).sum(axis=1)
        counted += residual.shape[1]
    padded = np.pad(cost.reshape(GRID, GRID), 1, constant_values=np.inf)
    neighbours = [(i, j) for i in (0, 1, 2) for j in (0, 1, 2) if (i, j) != (1, 1)]
    around = np.min([padded[i : i + GRID, j : j + GRID] for i, j in neighbours], axis=0).reshape(-1)
    low_ones = np.flatnonzero(cost <= around)
    chosen = low_ones[np.argsort(cost[low_ones], kind="stable")][:MAX_FILTERS]
    places = np.concatenate([grid[chosen], _crossings(rows)])
    x = np.zeros((len(places), 4))
    x[:, ::2] = places
    spread = np.diag([cell**2, before.spread[1, 1], cell**2, before.spread[3, 3]])
    return FilterBank(x, np.tile(spread, (len(places), 1, 1)), np.zeros(len(places)))


def _crossings(rows: SearchMeasurements) -> Floats:
    """(n, 2) positions at which the first line of sight crosses the circle of the first range: none to two.

    They may be nearer to each other than a cell of the grid, of which only the better one is a minimum.
    """
    ranges = np.flatnonzero(rows.distances.kind == RANGE)
    if not len(ranges) or not len(rows.lines):
        return np.empty((0, 2))
    k, (position, direction) = ranges[0], rows.lines[0, :4].reshape(2, 2)
    towards = rows.distances.position[k] - position
    along = float(towards @ direction)
    across2 = float(towards @ towards) - along**2
    half2 = float(rows.distances.value[k]) ** 2 - float(rows.distances.rise2[k]) - across2
    half = float(np.sqrt(max(half2, 0.0)))
    depth = np.array([along - half, along + half])
    return np.asarray(position + depth[depth > 0.0, None] * direction)


def _seen(rows: SearchMeasurements, t: int, xy: Floats) -> tuple[Floats, Floats, DistanceErrors]:
    """What is measured at a state: residuals (H, n), gradients (H, n, 2) at (H, 2) positions, and how these n err."""
    own = rows.distances.take(slice(*rows.distance_first[t : t + 2].tolist()))
    linearised = linearise(own, xy)
    lines = rows.lines[slice(*rows.line_first[t : t + 2].tolist())]
    if not len(lines):
        return linearised.residual, linearised.gradient, own.errors
    away = xy[:, None] - lines[:, :2]
    across = lines[:, 2] * away[..., 1] - lines[:, 3] * away[..., 0]
    along = lines[:, 2] * away[..., 0] + lines[:, 3] * away[..., 1]
    d2 = np.maximum((away**2).sum(axis=2), 1e-12)
    sigma = np.sqrt(lines[:, 4] + lines[:, 5] / d2)
    gradient = np.stack([-away[..., 1], away[..., 0]], axis=2) / (d2 * sigma)[..., None]
    residual = np.concatenate([-np.arctan2(across, along) / sigma, linearised.residual], axis=1)
    sights = without_detours(np.full(len(lines), BEND["mixture"]))
    errors = DistanceErrors(*(np.concatenate(both) for both in zip(sights, own.errors, strict=True)))
    return residual, np.concatenate([gradient, linearised.gradient], axis=1), errors


def _predicted(bank: FilterBank, A: Floats, sigma: Floats) -> FilterBank:
    return FilterBank(bank.x @ A.T, A @ bank.P @ A.T + sigma, bank.log)


def _updated(bank: FilterBank, rows: SearchMeasurements, t: int) -> FilterBank:
    """The filters with what is measured at a state; what is more probably false than true is passed over."""
    residual, gradient, errors = _seen(rows, t, bank.x[:, ::2])
    n = residual.shape[1]
    if not n:
        return bank
    # Gate, each by the variance that it is expected to have
    cross = gradient @ bank.P[:, ::2, :]  # (H, n, 4)
    whole = cross[..., ::2] @ gradient.transpose(0, 2, 1)
    variance = 1.0 + whole[:, np.arange(n), np.arange(n)]
    log = bank.log + log_density(residual, errors, variance).sum(axis=1)
    used = (inlier_probability(residual / np.sqrt(variance), errors.widened(variance)) > 0.5).astype(np.float64)
    # Kalman update with those that are accepted
    whole = whole * used[:, :, None] * used[:, None, :] + np.eye(n)
    cross = cross * used[..., None]
    gain = np.linalg.solve(whole, cross).transpose(0, 2, 1)
    x = bank.x + (gain @ (used * residual)[..., None])[..., 0]
    P = bank.P - gain @ cross
    return FilterBank(x, 0.5 * (P + P.transpose(0, 2, 1)), log)


def _in_room(bank: FilterBank, hull: Floats | None) -> FilterBank:
    """The filters, less probable where they are outside the room: by as much as a false measurement at most.

    Args:
        bank: H filters.
        hull: (K, 2) convex, counter-clockwise; None: no room.
    """
    if hull is None:
        return bank
    edge = np.roll(hull, -1, axis=0) - hull
    outward = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.hypot(edge[:, 0], edge[:, 1])[:, None]
    beyond = np.einsum("hkj,kj->hk", bank.x[:, None, ::2] - hull, outward)
    variance = np.einsum("kj,hji,ki->hk", outward, bank.P[:, ::2, ::2], outward)
    off = np.clip(beyond / np.sqrt(np.maximum(variance, 1e-300)), 0.0, BEND["mixture"]).max(axis=1)
    return bank._replace(log=bank.log - 0.5 * off**2)


def _kept(bank: FilterBank, extent: float) -> Ints:
    """Which filters go on: those that are probable, and not next to a better one."""
    order = np.argsort(-bank.log, kind="stable")
    kept: list[int] = []
    for k in order.tolist():
        if bank.log[k] < bank.log[order[0]] - MAX_LOG_GAP:
            break
        if all(np.abs(bank.x[k, ::2] - bank.x[j, ::2]).max() > MERGE_DISTANCE_EXTENTS * extent for j in kept):
            kept.append(k)
    return np.array(kept, dtype=np.int64)
