"""Bearings to tracks by an online method: one filter a target."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from typing import Any

import numpy as np

from occlog.array_types import NS
from occlog.core.numerics.seeds import Stage, generator
from occlog.measure.scans.occluder_priors import OccluderFeed
from occlog.measure.scans.scan import Scan, sensor_names
from occlog.measure.scans.scans import Rows, scans_of
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Hulls, Occluders
from occlog.track.apf.selection_policies import SelectConfig
from occlog.track.apf.selector import Filter, Selector
from occlog.track.interface import Online

from .rows import ROWS_PER_CHUNK, Row, Tracked, check_start, tables

FIRST_TARGET = 0
"""Identity of the track when no measurement carries one."""


def track_online(
    bearings: Iterable[Bearings],
    scene: Scene,
    config: Any,
    method: Online,
    seed: int,
    use: Rows,
    window_ns: int,
    occluders: Iterable[Occluders] | Iterable[Hulls] | None,
    selection: SelectConfig | None,
) -> Iterator[Tracked]:
    """Tracks of all targets, chunk by chunk; see `occlog.track.drivers.stage.track`."""
    feed = _feed(occluders, config)
    selector = None if selection is None else Selector(method, scene, selection, frozenset(use.sensors), config)
    names, filters = sensor_names(scene), dict[int, Filter]()
    rows: list[Row] = []
    for whole in scans_of(bearings, scene, use, window_ns):
        if feed is not None:
            whole = whole._replace(occluders=feed.at(whole.t_ns))
        for target in _targets(whole, filters, use.targets):
            scan = whole.of_target(target)
            if scan is None:
                continue
            if target not in filters:
                check_start(config, target, filters)
                filters[target] = _started(method, scene, config, seed, target)
            filters[target], row = _stepped(filters[target], method, selector, scan, target)
            rows += [] if row is None else [row]
        if len(rows) >= ROWS_PER_CHUNK:
            yield tables(rows, names)
            rows = []
    if rows:
        yield tables(rows, names)


def _feed(occluders: Iterable[Occluders] | Iterable[Hulls] | None, config: Any) -> OccluderFeed | None:
    if occluders is None:
        return None
    return OccluderFeed(occluders, config.occluder_diameter, round(config.prior_max_age_s * NS))


def _started(method: Online, scene: Scene, config: Any, seed: int, target: int) -> Filter:
    rng = generator(seed, Stage.TRACK, target)
    return Filter(method.init(scene, config, rng), rng, generator(seed, Stage.SELECT, target))


def _stepped(
    own: Filter, method: Online, selector: Selector | None, scan: Scan, target: int
) -> tuple[Filter, Row | None]:
    """The filter after a scan, and its row; None where the scan gives none: the next row tells of it."""
    t_ns, offered = scan.t_ns, own.offered + len(np.unique(scan.sensor))
    asked: Scan | None = scan
    if selector is not None:
        own = selector.update(own, t_ns, scan.occluders)
        asked = selector.asked(own, scan)
    if asked is None:  # none of the cameras that are asked had a frame
        return own._replace(offered=offered), None
    state, estimate = method.step(own.state, asked, own.rng)
    if estimate is None:
        return own._replace(state=state, offered=offered), None
    cameras = () if own.selected is None else own.selected.choice.cameras
    row = Row(t_ns, target, estimate, offered, cameras, own.mse)
    return own._replace(state=state, offered=0, mse=math.nan), row


def _targets(scan: Scan, filters: dict[int, Filter], wanted: Collection[int] | None) -> list[int]:
    """Targets that a scan may be about, rising."""
    labelled = {k for k in scan.target_id.tolist() if k != UNLABELLED}
    return sorted(labelled | set(filters)) or [next(iter(wanted)) if wanted else FIRST_TARGET]
