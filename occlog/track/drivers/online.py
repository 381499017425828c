"""Bearings to tracks by an online method: one filter a target.

Rows of filters that wait for what comes after them, to be smoothed.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Iterable, Iterator
from typing import Any, Generic, NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import UsageError
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Hulls, Occluders
from occlog.scans.distance_measurements import DistanceMeasurementFeed
from occlog.scans.grouping import Scan, sensor_names
from occlog.track.interface import Config, Online, Smoothing, State
from occlog.track.methods.apf.selector import Selector, TargetFilter
from occlog.track.smoothing_and_lag import MAX_SMOOTHING_STEPS

from .rows import ROWS_PER_CHUNK, EstimateRow, TrackChunk, downsample, tables
from .tracking import TrackingTask, check_start, feed_of

WINDOW_LAGS = 3
"""Lags that a target's rows span when they are smoothed: each row is smoothed SPAN / (SPAN - 1) times on average."""


class PendingRows(NamedTuple):
    """The rows of one target that wait, each with what its step left for the way back."""

    rows: list[EstimateRow]
    traces: list[Any]
    rng: Generator


class BackwardSmoother(Generic[State, Config]):
    """Holds the rows of all targets until enough was seen after them, and smooths them then."""

    def __init__(self, smoothing: Smoothing[State, Config], config: Config, seed: int) -> None:
        """Start without buffered rows.

        Args:
            smoothing: the method's.
            config: settings of the method.
            seed: of all random numbers.
        """
        self._smoothing, self._config, self._seed = smoothing, config, seed
        self._lag_ns = smoothing.wanted(config).lag_ns
        self._waiting: dict[int, PendingRows] = {}
        self._ready: list[EstimateRow] = []

    def add(self, row: EstimateRow, state: State) -> None:
        """Add a row of a target, and its filter's state after it."""
        if row.target not in self._waiting:
            rng = generator(self._seed, RandomStream.SMOOTH, row.target)
            self._waiting[row.target] = PendingRows([], [], rng)
        own = self._waiting[row.target]
        own.rows.append(row)
        own.traces.append(self._smoothing.trace(state))

    def settled(self, now_ns: int) -> list[EstimateRow]:
        """Rows that need not wait any longer, of all targets, in the order of time.

        With a lag a target's rows are smoothed whenever they span `WINDOW_LAGS` lags, and those older than one are
        given out; all of them when the target was not met for longer than that.
        """
        for target, own in list(self._waiting.items()):
            first, last = own.rows[0].t_ns, own.rows[-1].t_ns
            if self._lag_ns is not None and now_ns - last > WINDOW_LAGS * self._lag_ns:
                self._release(target, len(own.rows))
            elif self._lag_ns is not None and last - first >= WINDOW_LAGS * self._lag_ns:
                self._release(target, sum(row.t_ns <= last - self._lag_ns for row in own.rows))
            elif len(own.rows) >= MAX_SMOOTHING_STEPS:
                self._release(target, MAX_SMOOTHING_STEPS // 2)
        horizon = min((own.rows[0].t_ns for own in self._waiting.values()), default=now_ns + 1)
        return self._until(horizon)

    @property
    def held(self) -> int:
        """How many rows wait, or are ready and wait for an earlier one of another target."""
        return len(self._ready) + sum(len(own.rows) for own in self._waiting.values())

    def rest(self) -> list[EstimateRow]:
        """All rows that still wait, in the order of time."""
        for target, own in list(self._waiting.items()):
            self._release(target, len(own.rows))
        return self._until(None)

    def _release(self, target: int, count: int) -> None:
        """Smooth all rows of a target, and give the first ones out."""
        own = self._waiting[target]
        found = self._smoothing.back(own.traces, self._config, own.rng)
        for row, past in zip(own.rows[:count], found[:count], strict=True):
            better = row.estimate._replace(
                xy=past.xy, velocity=past.velocity, covariance=past.covariance, height=past.height
            )
            self._ready.append(row._replace(estimate=better))
        self._ready.sort(key=lambda row: (row.t_ns, row.target))
        if count == len(own.rows):
            del self._waiting[target]
        else:
            del own.rows[:count], own.traces[:count]

    def _until(self, horizon_ns: int | None) -> list[EstimateRow]:
        """Ready rows before a time; None: all.  They are in the order of time and target."""
        count = (
            len(self._ready) if horizon_ns is None else bisect_left(self._ready, horizon_ns, key=lambda row: row.t_ns)
        )
        early = self._ready[:count]
        del self._ready[:count]
        return early


def backward_smoother(
    smoothing: Smoothing[State, Config] | None, config: Config, seed: int
) -> BackwardSmoother[State, Config] | None:
    """What holds the rows back; None where the method cannot smooth or the settings want none."""
    if smoothing is None or not smoothing.wanted(config).smoothed:
        return None
    return BackwardSmoother(smoothing, config, seed)


FIRST_TARGET = 0
"""Identity of the track when no measurement carries one."""


def track_online(
    bearings: Iterable[Bearings],
    scene: Scene,
    method: Online[State, Config],
    tracking: TrackingTask[Config],
    occluders: Iterable[Occluders] | Iterable[Hulls] | None = None,
    measured: DistanceMeasurementFeed | None = None,
) -> Iterator[TrackChunk]:
    """Tracks of all targets, chunk by chunk; see `occlog.track.drivers.stage.track`."""
    config, names = tracking.config, sensor_names(scene) if measured is None else measured.names
    feed = feed_of(occluders, method, tracking)
    selector = _selector(scene, method, tracking)
    filters: dict[int, TargetFilter[State]] = {}
    later = backward_smoother(method.smoothing, config, tracking.seed)
    clouds = method.prediction.cloud if tracking.particles and method.prediction is not None else None
    drawn = generator(tracking.seed, RandomStream.SELECT)  # nothing is drawn at the time of the scan itself
    rows: list[EstimateRow] = []
    for everything in tracking.scans(bearings, scene, measured):
        # Priors of the moving occluders at the time of the scan
        if feed is not None:
            everything = everything._replace(occluders=feed.at(everything.t_ns))
        for target in _targets(everything, filters, tracking.targets):
            scan = everything.of_target(target)
            if scan is None:
                continue
            # Start: a target's filter begins with its first scan
            if target not in filters:
                check_start(method.started(config), target, filters)
                rng = generator(tracking.seed, RandomStream.TRACK, target)
                state = method.init(scene, config, rng)
                filters[target] = TargetFilter(
                    target, state, rng, generator(tracking.seed, RandomStream.SELECT, target)
                )
            # Step: select cameras, take their rows in, estimate
            filters[target], row = _stepped(filters[target], method, selector, scan)
            if row is not None and clouds is not None:
                row = row._replace(cloud=downsample(clouds(filters[target].state, scan.t_ns, drawn)))
            if row is not None and later is not None:
                later.add(row, filters[target].state)
            elif row is not None:
                rows.append(row)
        # Smooth: rows that have seen enough of what comes after them
        if later is not None:
            rows += later.settled(everything.t_ns)
        if len(rows) >= ROWS_PER_CHUNK:
            yield tables(rows, names)
            rows = []
    if later is not None:
        rows += later.rest()
    if rows:
        yield tables(rows, names)


def _selector(
    scene: Scene, method: Online[State, Config], tracking: TrackingTask[Config]
) -> Selector[State, Config] | None:
    """The selection of cameras, if there is one; UsageError for a method that cannot say where a target will be."""
    if tracking.selection is None:
        return None
    if method.prediction is None:
        raise UsageError(
            f"select: method {tracking.method} cannot predict where the target will be; leave the selection out"
        )
    usable = frozenset(tracking.rows(scene).sensors)
    return Selector(method.prediction, tracking.config, scene, tracking.selection, usable)


def _stepped(
    own: TargetFilter[State], method: Online[State, Config], selector: Selector[State, Config] | None, scan: Scan
) -> tuple[TargetFilter[State], EstimateRow | None]:
    """The filter after a scan, and its row; None where the scan gives none: the next row counts its frames, too."""
    offered = own.offered + len(np.unique(scan.sensor))
    asked: Scan | None = scan
    if selector is not None:
        own = selector.update(own, scan.t_ns, scan.occluders)
        asked = selector.asked(own, scan)
    if asked is None:  # none of the cameras that are asked had a frame
        return own._replace(offered=offered), None
    state, estimate = method.step(own.state, asked, own.rng)
    if selector is not None and estimate is not None:
        own = selector.learned(own, asked, estimate)
    if estimate is None:
        return own._replace(state=state, offered=offered), None
    cameras = () if own.selected is None else own.selected.choice.cameras
    row = EstimateRow(own.target, scan.t_ns, estimate, offered, cameras, own.mse)
    return own._replace(state=state, offered=0, mse=math.nan), row


def _targets(scan: Scan, filters: Collection[int], wanted: Collection[int] | None) -> list[int]:
    """Targets that a scan may be about, rising."""
    return sorted(scan.targets.union(filters)) or [next(iter(wanted)) if wanted else FIRST_TARGET]
