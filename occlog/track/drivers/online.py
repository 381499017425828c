"""Bearings to tracks by an online method: one filter a target."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator

import numpy as np

from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import UsageError, option
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Hulls, Occluders
from occlog.scans.distance_measurements import DistanceMeasurementFeed
from occlog.scans.grouping import Scan, sensor_names
from occlog.track.backward_smoother import BackwardSmoother, backward_smoother
from occlog.track.interface import Config, Online, State
from occlog.track.methods.apf.selector import Selector, TargetFilter

from .rows import ROWS_PER_CHUNK, EstimateRow, TrackChunk, downsample, tables
from .tracking import TrackingTask, check_start, feed_of

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
    """Generate tracks of all targets by one filter per target, chunk by chunk, in the order of time.

    Args:
        bearings: chunks in the order of time.
        scene: scene with the sensors.
        method: the method that `tracking` names.
        tracking: settings of the method, choice of rows, and selection of cameras.
        occluders: priors of moving occluders in the order of time; None: unknown.
        measured: ranges, signal strengths and time differences; None: missing.

    Raises:
        InputError: bearings that do not fit the scene.
        UsageError: a start (`config.start`) for several targets; occluders or a selection that the method does not
            take.
    """
    config, names = tracking.config, sensor_names(scene) if measured is None else measured.names
    feed = feed_of(occluders, method, tracking)
    selector = _selector(scene, method, tracking)
    filters: dict[int, TargetFilter[State]] = {}
    later: BackwardSmoother[State, Config, EstimateRow] | None
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
    """Return the selector of cameras for the options of `tracking`; None without a selection.

    It uses the method's prediction of a target's position, and the sensors in use with their poses in the scene.

    Raises:
        UsageError: the method cannot predict the target's position.
    """
    if tracking.selection is None:
        return None
    if method.prediction is None:
        raise UsageError(
            f"{option('select')}: method {tracking.method} cannot predict where the target will be; leave select out",
            id="not-applicable",
        )
    usable = frozenset(tracking.rows(scene).sensors)
    return Selector(method.prediction, tracking.config, scene, tracking.selection, usable)


def _stepped(
    own: TargetFilter[State], method: Online[State, Config], selector: Selector[State, Config] | None, scan: Scan
) -> tuple[TargetFilter[State], EstimateRow | None]:
    """Advance one target's filter by a scan; return the filter and an output row.

    The row is None if the scan gives no estimate; its frames then count in the next row. With a `selector`, only rows
    of selected cameras are used.

    Args:
        own: the target's filter state, random numbers and selection; not changed.
        method: the method that filters.
        selector: selects cameras; None: all rows are used.
        scan: rows of this target, and unlabelled ones.
    """
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
    """Return the ascending identities of the targets to which a scan is given.

    They are those that have a filter (the identities `filters`) or a label in the scan. Without any it is the first of
    `wanted` (None: no choice), or else `FIRST_TARGET`.
    """
    return sorted(scan.targets.union(filters)) or [next(iter(wanted)) if wanted else FIRST_TARGET]
