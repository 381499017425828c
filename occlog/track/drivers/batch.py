"""Bearings to tracks by a method that estimates whole segments: one trajectory a target."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Generic, NamedTuple

import numpy as np

from occlog.errors import InputError, option
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Calibration, Diagnostics, Hulls, Occluders, Residuals, Tracks
from occlog.scans.distance_measurements import DistanceMeasurementFeed
from occlog.scans.grouping import Scan, sensor_names
from occlog.track.interface import Batch, Config, SmoothedTrajectory, State

from .rows import Solve, TrackChunk, residual_rows
from .tracking import TrackingTask, check_start, feed_of

FOREVER_NS = 2**62
"""A gap longer than any difference of two times [ns]."""
MAX_PAUSE_LAGS = 4
"""Maximum additional wait of the other targets during a pause of one, in lags."""


class _TargetScans(NamedTuple, Generic[State]):
    """Buffered scans of one target for a batch method, since its last call.

    `state` is the method's state, `due_ns` the time from which the method is called next, `given_ns` the time up to
    which states were output, `scans` the buffered scans.
    """

    state: State
    due_ns: int  # when the method is called next
    given_ns: int  # everything up to here is given out
    scans: list[Scan]


def track_batch(
    bearings: Iterable[Bearings],
    scene: Scene,
    method: Batch[State, Config],
    tracking: TrackingTask[Config],
    occluders: Iterable[Occluders] | Iterable[Hulls] | None = None,
    measured: DistanceMeasurementFeed | None = None,
) -> Iterator[TrackChunk]:
    """Generate the tracks of all labelled targets by a batch method, chunk by chunk, in the order of time.

    Without a lag everything is kept until the end, in memory that grows with the number of rows. With one, a target's
    states are output when this much later data has been seen, or half as much again; memory grows with the number of
    rows in that time. A target without rows for longer than the lag and the step before (at most `MAX_PAUSE_LAGS` lags)
    is ended, and restarts with its next row; a shorter pause adds to the wait. A pause after which the method forgets
    what was before ends a target, too.

    Args:
        bearings: chunks in the order of time.
        scene: scene with the sensors.
        method: the method that `tracking` names.
        tracking: settings of the method and choice of rows.
        occluders: priors of moving occluders in the order of time; None: unknown.
        measured: ranges, signal strengths and time differences; None: missing.

    Raises:
        InputError: no bearing has a label, or one that does not fit the scene.
        UsageError: a start (`config.start`) for several targets, or occluders that the method does not use.
    """
    config, names = tracking.config, sensor_names(scene) if measured is None else measured.names
    feed = feed_of(occluders, method, tracking)
    targets: dict[int, _TargetScans[State]] = {}
    waiting: list[TrackChunk] = []
    given_lag = method.lag_ns(config)
    lag_ns = FOREVER_NS if given_lag is None else given_lag
    hop_ns = max(1, lag_ns // 2)
    forgets_ns = method.forgets_ns(scene, config)
    longest_ns = FOREVER_NS if forgets_ns is None else forgets_ns
    met: dict[int, tuple[int, int]] = {}  # latest time of each target, and the step that led there
    unlabelled, now = 0, 0
    for scan in tracking.scans(bearings, scene, measured):
        # Priors of the moving occluders at the time of the scan
        if feed is not None:
            scan = scan._replace(occluders=feed.at(scan.t_ns))
        now = scan.t_ns
        unlabelled += int(np.count_nonzero(~scan.labelled))
        # End targets that pause.  What ends or settles a target depends on its own rows alone.
        over = [k for k in targets if now - met[k][0] > min(lag_ns + met[k][1], longest_ns)]
        waiting += [_advance(targets.pop(k), k, method, names, last=True)[1] for k in over]
        # Gather the rows of each target; begin those that are new or back after a pause
        due = []
        for target in sorted(scan.targets):
            if target not in met:
                check_start(method.started(config), target, met)
            step_ns = min(now - met[target][0], MAX_PAUSE_LAGS * lag_ns) if target in met else 0
            if target not in targets:
                state = method.begin(scene, config, target in met)
                targets[target] = _TargetScans(state, now + lag_ns + hop_ns, now - 1, [])
            met[target] = (now, step_ns)
            own_measured = None if scan.measured is None else scan.measured.of_target(target)
            own_rows = scan.take(scan.target_id == target)
            targets[target].scans.append(own_rows._replace(measured=own_measured))
            if now >= targets[target].due_ns:
                due.append(target)
        # Settle the states that have seen enough time after them
        for target in due:
            own, out = _advance(targets[target], target, method, names, last=False)
            waiting.append(out)
            targets[target] = own._replace(due_ns=now + hop_ns)
        # Give out what no target can precede any more
        if over or due:
            horizon = min((g.given_ns for g in targets.values()), default=now)
            given, waiting = _until(waiting, horizon)
            yield from given
    if not met:
        if not unlabelled:
            raise InputError(
                "bearings: no row is of the chosen targets and sensors; choose others "
                f"({option('target')}, {option('cameras')}, {option('without')})",
                id="empty-input",
            )
        raise InputError(
            f"bearings: none of {unlabelled} candidates has a label; this method requires labelled bearings: "
            "label them "
            f"with `occlog label`, or use the identities of a DOA log ({option('doa_labels')})",
            id="missing-labels",
        )
    waiting += [_advance(g, k, method, names, last=True)[1] for k, g in sorted(targets.items())]
    yield from _until(waiting, FOREVER_NS)[0]


def _advance(
    own: _TargetScans[State], target: int, method: Batch[State, Config], names: tuple[str, ...], *, last: bool
) -> tuple[_TargetScans[State], TrackChunk]:
    """Call the batch method with a target's buffered scans; return the target with an empty buffer, and the rows.

    Args:
        own: buffered target; not changed.
        target: its identity.
        method: the batch method.
        names: names of the sensors by index.
        last: no scans follow, so that all states are released.
    """
    state, smoothed = method.advance(own.state, own.scans, last)
    given = int(smoothed.t_ns[-1]) if len(smoothed.t_ns) else own.given_ns
    return own._replace(state=state, given_ns=given, scans=[]), as_tables(smoothed, target, names)


def _until(waiting: list[TrackChunk], horizon_ns: int) -> tuple[list[TrackChunk], list[TrackChunk]]:
    """Split the waiting rows of all targets at time `horizon_ns`: return those up to it as chunks, and the rest.

    The former are merged to at most one chunk, sorted by time.
    """
    early, late = [], []
    for part in waiting:
        n = int(np.searchsorted(part.tracks.t_ns, horizon_ns, side="right"))
        early.append(_cut(part, n, first=True))
        if n < len(part.tracks):
            late.append(_cut(part, n, first=False))
    merged = TrackChunk(
        Tracks.merge(p.tracks for p in early),
        Diagnostics.merge(p.diagnostics for p in early),
        Calibration.empty(),
        tuple(s for p in early for s in p.solves),
        residuals=Residuals.merge(p.residuals for p in early if p.residuals is not None),
    )
    return ([merged] if len(merged.tracks) else []), late


def _cut(part: TrackChunk, n: int, *, first: bool) -> TrackChunk:
    """Return the first n rows of a chunk with their diagnostics and residuals, or (`first` False) the remaining ones.

    Records of optimisation runs stay with the first rows.
    """
    rows = slice(None, n) if first else slice(n, None)
    residuals = part.residuals
    if residuals is not None and n < len(part.tracks):
        early = residuals.t_ns < part.tracks.t_ns[n]
        residuals = residuals.take(early if first else ~early)
    elif not first:
        residuals = None
    solves = part.solves if first else ()
    return TrackChunk(
        part.tracks.take(rows), part.diagnostics.take(rows), part.calibration, solves, residuals=residuals
    )


def as_tables(found: SmoothedTrajectory, target: int, names: tuple[str, ...]) -> TrackChunk:
    """Convert the smoothed trajectory of target `target` to output tables; `names` are the sensors' names by index."""
    T, C = len(found.t_ns), found.covariance
    identity = np.full(T, target, dtype=np.int32)
    names4 = ("x", "y", "vx", "vy")
    spread = {f"cov_{names4[i]}_{names4[j]}": C[:, i, j] for i in range(4) for j in range(max(i, 2), 4)}
    tracks = Tracks.of(
        t_ns=found.t_ns,
        target_id=identity,
        x=found.xy[:, 0],
        y=found.xy[:, 1],
        vx=found.velocity[:, 0],
        vy=found.velocity[:, 1],
        cov_xx=C[:, 0, 0],
        cov_xy=C[:, 0, 1],
        cov_yy=C[:, 1, 1],
        **spread,
    )
    nothing = np.full(T, np.nan)
    diagnostics = Diagnostics(
        t_ns=found.t_ns,
        target_id=identity,
        ess=nothing,
        log_likelihood=found.log_likelihood,
        n_observing=found.n_observing.astype(np.int32),
        n_detected=found.n_detected.astype(np.int32),
        fallback=np.array(found.fallback, dtype=np.str_),
        cameras=np.array([",".join(names[i] for i in used) for used in found.used], dtype=np.str_),
        n_available=found.n_observing.astype(np.int32),
        selected=np.full(T, "", dtype="U1"),
        predicted_mse=nothing,
        seen_by=np.array([",".join(names[i] for i in sorted(set(by))) for by in found.seen_by], dtype=np.str_),
    )
    biases = tuple((names[one.station], one.bias, one.error) for one in found.biases)
    solve = Solve(target, found.iterations, found.converged, found.noise, found.rivals, biases)
    residuals = None if found.fit is None else residual_rows(found.fit, found.t_ns, target, names)
    return TrackChunk(tracks, diagnostics, Calibration.empty(), (solve,), residuals=residuals)
