"""Bearings to tracks by a method with one state for all labelled objects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from occlog.core.numerics.seeds import Stage, generator
from occlog.errors import UsageError
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Hulls, Occluders
from occlog.scans.grouping import scans_of
from occlog.scans.scan import sensor_names
from occlog.track.interface import Config, State, Together

from .rows import ROWS_PER_CHUNK, Row, Tracked, tables
from .tracking import Tracking


def track_together(
    bearings: Iterable[Bearings],
    scene: Scene,
    method: Together[State, Config],
    tracking: Tracking[Config],
    occluders: Iterable[Occluders] | Iterable[Hulls] | None,
) -> Iterator[Tracked]:
    """Tracks of all labelled objects, chunk by chunk; see `occlog.track.drivers.stage.track`.

    Candidates without a label are left out.  UsageError for priors of occluders or a selection of cameras.
    """
    if occluders is not None:
        raise UsageError(f"occluders: method {tracking.method} follows those who hide others itself; leave it out")
    if tracking.selection is not None:
        raise UsageError(f"select: method {tracking.method} cannot predict where one target will be; leave it out")
    names, rng = sensor_names(scene), generator(tracking.seed, Stage.TRACK, 0)
    state, rows = method.init(scene, tracking.config, rng), list[Row]()
    for scan in scans_of(bearings, scene, tracking.rows(scene), tracking.window_ns):
        offered = len(np.unique(scan.sensor))
        state, estimates = method.step(state, scan.take(scan.labelled), rng)
        rows += [Row(target, scan.t_ns, estimate, offered) for target, estimate in estimates]
        if len(rows) >= ROWS_PER_CHUNK:
            yield tables(rows, names)
            rows = []
    if rows:
        yield tables(rows, names)
