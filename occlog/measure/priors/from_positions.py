"""Priors of moving occluders from measured positions, by a Kalman filter for each occluder.

Measurements are real (of another tracker, of tags that people wear) or virtual: true
positions with noise added, as in [Ercan] Sec. 6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError
from occlog.filtering.motion.white_acceleration import Walkers, concat, initiate, predict, select, update
from occlog.io.files.timing.utc import time_words
from occlog.records.tables import Occluders, Tracks, Truth
from occlog.scans.occluder_priors import known_positions, none_at

from .config import PositionPriorConfig


class _MeasurementStep:
    """Measurements at one time; rows sorted by identity."""

    def __init__(self, t_ns: int, identity: Ints32, xy: Floats, noise: Floats) -> None:
        self.t_ns, self.identity, self.xy, self.noise = t_ns, identity, xy, noise


def virtual_priors(truth: Iterable[Truth], sigma: float, q: float, seed: int, *, run: int = 0) -> Iterator[Occluders]:
    """Generate priors from virtual measurements (true positions with noise) of moving occluders, chunk by chunk.

    The noise of an occluder depends only on seed, run and its identity.

    Args:
        truth: true positions in the order of time; rows of the role `occluder` are used.
        sigma: standard deviation of the measurements, per axis [length]; 0: the true positions, known exactly.
        q: process noise: standard deviation of the velocity per axis, accumulated over 1 s [length/s].
        seed: seed of the noise.
        run: number of the run of a Monte Carlo experiment.
    """
    config = PositionPriorConfig(measurement_noise=sigma, process_noise_velocity=q)
    if sigma == 0.0:
        yield from known_positions(truth)
        return
    generators: dict[int, Generator] = {}
    shared = sigma**2 * np.eye(2)

    def noisy(chunk: Truth) -> tuple[Floats, Floats]:
        xy = np.column_stack([chunk.x, chunk.y])
        for k in np.unique(chunk.target_id).tolist():
            rows = np.flatnonzero(chunk.target_id == k)
            rng = generators.setdefault(k, generator(seed, RandomStream.PRIORS, k, run=run))
            xy[rows] += sigma * rng.standard_normal((len(rows), 2))
        return xy, np.broadcast_to(shared, (len(chunk), 2, 2))

    yield from _filtered(truth, noisy, config)


def kalman_priors(
    positions: Iterable[Truth] | Iterable[Tracks], config: PositionPriorConfig, *, without: Iterable[int] = ()
) -> Iterator[Occluders]:
    """Generate priors from measured positions by a Kalman filter for each occluder, chunk by chunk.

    At every time all occluders that were measured within `max_coasting_s` have a row.

    Args:
        positions: in the order of time.  Of truth the rows of the role `occluder`, measured with the standard deviation
            `config.measurement_noise`; of tracks all rows, with their covariances, to which the variance of
            `config.measurement_noise` is added as independent.
        config: settings; `measurement_noise` must be above 0 for truth.
        without: identities that are skipped, for example the tracked target's.
    """
    left_out, shared = sorted(set(without)), config.measurement_noise**2 * np.eye(2)

    def measured(chunk: Truth | Tracks) -> tuple[Floats, Floats]:
        noise = np.broadcast_to(shared, (len(chunk), 2, 2)).copy()
        if isinstance(chunk, Tracks):
            chunk = chunk.with_covariance()
            own = np.stack([chunk.cov_xx, chunk.cov_xy, chunk.cov_xy, chunk.cov_yy], axis=1)
            noise += own.reshape(-1, 2, 2)
        return np.column_stack([chunk.x, chunk.y]), noise

    kept = (chunk.take(~np.isin(chunk.target_id, left_out)) if left_out else chunk for chunk in positions)
    yield from _filtered(kept, measured, config)


def _filtered(
    chunks: Iterable[Truth] | Iterable[Tracks] | Iterable[Truth | Tracks],
    measure: Callable[..., tuple[Floats, Floats]],
    config: PositionPriorConfig,
) -> Iterator[Occluders]:
    """Generate one table of priors per chunk by Kalman filters; its last time is output with the next chunk.

    `measure` returns measured positions (n, 2) and covariances (n, 2, 2) of n rows of a chunk.
    """
    state = _FilterState()
    held: list[_MeasurementStep] = []
    for chunk in chunks:
        steps = list(_time_steps(chunk, measure))
        if held and steps and held[-1].t_ns == steps[0].t_ns:
            steps[0] = _joined(held.pop(), steps[0])
        # The last time may go on in the next chunk.
        yield _table([*held, *steps[:-1]], state, config)
        held = steps[-1:] if steps else held[:0]
    if held:
        yield _table(held, state, config)


def _joined(a: _MeasurementStep, b: _MeasurementStep) -> _MeasurementStep:
    identity = np.concatenate([a.identity, b.identity])
    order = np.argsort(identity, kind="stable")
    xy, noise = np.concatenate([a.xy, b.xy]), np.concatenate([a.noise, b.noise])
    return _MeasurementStep(a.t_ns, identity[order], xy[order], noise[order])


def _time_steps(chunk: Truth | Tracks, measure: Callable[..., tuple[Floats, Floats]]) -> Iterator[_MeasurementStep]:
    """Generate the measurements of moving occluders by time; empty ones at times without any.

    `measure` returns measured positions (n, 2) and covariances (n, 2, 2) of n rows.
    """
    if not len(chunk):
        return
    times = np.unique(chunk.t_ns)
    rows = chunk.take(chunk.role == "occluder") if isinstance(chunk, Truth) else chunk
    rows = rows.sorted()
    xy, noise = measure(rows)
    first, last = np.searchsorted(rows.t_ns, times, "left"), np.searchsorted(rows.t_ns, times, "right")
    for t_ns, a, b in zip(times.tolist(), first.tolist(), last.tolist(), strict=True):
        yield _MeasurementStep(t_ns, rows.target_id[a:b], xy[a:b], noise[a:b])


class _FilterState:
    """Kalman filters of M occluders at the time step `t_ns` (None: none so far), sorted by identity.

    `measured_ns` (M,) are the times of their last measurements, `walkers` positions and velocities with covariances.
    """

    def __init__(self) -> None:
        self.identity = np.empty(0, dtype=np.int32)
        self.t_ns: int | None = None
        self.measured_ns = np.empty(0, dtype=np.int64)
        self.walkers = initiate(np.empty((0, 2)), np.empty((0, 2, 2)), 1.0)


def _step(state: _FilterState, m: _MeasurementStep, config: PositionPriorConfig) -> None:
    """Predict the filters to the time of some measurements, and update them by these, in place.

    New occluders get a filter; filters without measurements for more than `max_coasting_s` are dropped.

    Args:
        state: Kalman filters of all occluders, updated in place.
        m: measured positions of one time.
        config: settings of the filters.

    Raises:
        InputError: the time is earlier than the last step's, or an occluder has two positions.
    """
    if (same := np.diff(m.identity) == 0).any():
        raise InputError(
            f"priors: occluder {m.identity[1:][same][0]} has two positions at {time_words(m.t_ns)}; leave one out",
            id="duplicate-row",
        )
    if state.t_ns is not None:
        if m.t_ns < state.t_ns:
            raise InputError(
                f"priors: time {time_words(m.t_ns)} is earlier than the preceding "
                f"{time_words(state.t_ns)}; sort the rows by t_ns",
                id="unsorted-times",
            )
        # Drop filters after a long silence: an occluder that comes back starts afresh
        keep = m.t_ns - state.measured_ns <= config.max_coasting_s * 1e9
        _keep(state, keep)
        # Predict
        state.walkers = predict(state.walkers, (m.t_ns - state.t_ns) * 1e-9, config.process_noise_velocity)
    state.t_ns = m.t_ns
    # Update with measurements of known occluders
    known = np.isin(m.identity, state.identity)
    rows = np.searchsorted(state.identity, m.identity[known])
    _measure(state.walkers, rows, m.xy[known], m.noise[known])
    state.measured_ns[rows] = m.t_ns
    # Begin filters for new occluders
    if not known.all():
        _add(state, m, ~known, config.process_noise_velocity)


def _measure(walkers: Walkers, rows: Ints, xy: Floats, noise: Floats) -> None:
    """Update some of the filters by measured positions, in place.

    Args:
        walkers: all filters, updated.
        rows: (n,) indices of the filters that are measured.
        xy: (n, 2) measured positions.
        noise: (n, 2, 2) their covariances.
    """
    if not len(rows):
        return
    updated = update(select(walkers, rows), xy, noise)
    for column, new in zip(walkers, updated, strict=True):
        column[rows] = new


def _keep(state: _FilterState, keep: Bools) -> None:
    if not keep.all():
        state.identity, state.measured_ns = state.identity[keep], state.measured_ns[keep]
        state.walkers = select(state.walkers, keep)


def _add(state: _FilterState, m: _MeasurementStep, new: Bools, speed: float) -> None:
    """Initiate filters at first measurements, in `state`, which stays sorted by identity.

    Args:
        state: filters, updated in place.
        m: n measurements of one time.
        new: (n,) mask of those that begin a filter.
        speed: standard deviation of the initial velocity per axis [length/s].
    """
    walkers = concat(state.walkers, initiate(m.xy[new], m.noise[new], speed))
    identity = np.concatenate([state.identity, m.identity[new]])
    measured = np.concatenate([state.measured_ns, np.full(int(new.sum()), m.t_ns)])
    order = np.argsort(identity)
    state.identity, state.measured_ns, state.walkers = identity[order], measured[order], select(walkers, order)


def _table(steps: list[_MeasurementStep], state: _FilterState, config: PositionPriorConfig) -> Occluders:
    parts: list[tuple[int, Ints32, Floats, Floats]] = []
    empty = []
    for m in steps:
        _step(state, m, config)
        if len(state.identity):
            parts.append((m.t_ns, state.identity, state.walkers.xy.copy(), state.walkers.cov.copy()))
        else:
            empty.append(m.t_ns)
    none = none_at(np.array(empty, dtype=np.int64))
    if not parts:
        return none
    xy, cov = np.concatenate([p[2] for p in parts]), np.concatenate([p[3] for p in parts])
    t_ns = np.repeat(np.array([p[0] for p in parts], dtype=np.int64), [len(p[1]) for p in parts])
    identity = np.concatenate([p[1] for p in parts])
    rows = Occluders(
        t_ns=t_ns,
        occluder_id=identity,
        x=xy[:, 0],
        y=xy[:, 1],
        cov_xx=cov[:, 0, 0],
        cov_xy=cov[:, 0, 1],
        cov_yy=cov[:, 1, 1],
    )
    return Occluders.merge([rows, none])
