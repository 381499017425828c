"""Bearings to tracks: one filter a target, streaming."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from ..core.seeds import Stage, generator
from ..errors import UsageError
from ..records import UNLABELLED, Bearings, Diagnostics, Tracks
from ..scene import Scene
from ..trackers import tracker
from ..trackers.method import Estimate, sensor_names
from .scans import groups, scan_of

ROWS_PER_CHUNK = 4096
FIRST_TARGET = 0
"""Identity of the track when no measurement carries one."""


class Tracked(NamedTuple):
    """Some more rows of a track and how the filter fared; equal in number."""

    tracks: Tracks
    diagnostics: Diagnostics


class _Filter(NamedTuple):
    state: Any
    rng: Generator


def choose_sensors(scene: Scene, only: Iterable[str] = (), without: Iterable[str] = ()) -> frozenset[str]:
    """Names of the sensors to use; UsageError names one that the scene does not have."""
    names = sensor_names(scene)
    only, without = list(only), list(without)
    for name in (*only, *without):
        if name not in names:
            raise UsageError(f"no sensor {name!r} in the scene, which has: {', '.join(names)}")
    used = frozenset(only or names) - frozenset(without)
    if not used:
        raise UsageError("no sensor is left to track with")
    return used


def track(
    bearings: Iterable[Bearings],
    scene: Scene,
    config: Any,
    seed: int,
    *,
    method: str = "apf",
    sensors: frozenset[str] | None = None,
    window_ns: int = 0,
) -> Iterator[Tracked]:
    """Tracks of all targets, chunk by chunk, in the order of time.

    Each labelled target has a filter of its own, with its own random numbers, which starts
    with the target's first row.  Unlabelled candidates go to every filter; if nothing is
    labelled they make one track, numbered 0.

    Args:
        bearings: chunks in the order of time.
        scene: the sensors, the room and what stands in it.
        config: settings of the method, see `occlog.trackers`.
        seed: of all random numbers.
        method: a key of `TRACKERS`.
        sensors: names of those to use; None: all.
        window_ns: rows at most this far apart form one scan.

    Raises:
        InputError: bearings that do not fit the scene or each other.
    """
    chosen, names = tracker(method), sensor_names(scene)
    used = frozenset(names) if sensors is None else sensors
    filters: dict[int, _Filter] = {}
    rows: list[tuple[int, int, Estimate]] = []
    for group in groups(bearings, names, used, window_ns):
        for target in _targets(group.rows, filters):
            scan = scan_of(group, target)
            if scan is None:
                continue
            if target not in filters:
                rng = generator(seed, Stage.TRACK, target)
                filters[target] = _Filter(chosen.init(scene, config, rng), rng)
            state, estimate = chosen.step(filters[target].state, scan, filters[target].rng)
            filters[target] = filters[target]._replace(state=state)
            rows.append((group.t_ns, target, estimate))
        if len(rows) >= ROWS_PER_CHUNK:
            yield _tables(rows, names)
            rows = []
    if rows:
        yield _tables(rows, names)


def _targets(rows: Bearings, filters: dict[int, _Filter]) -> list[int]:
    """Targets that a scan may be about, rising."""
    labelled = {int(i) for i in rows.target_id if i != UNLABELLED}
    known = sorted(labelled | set(filters))
    return known or [FIRST_TARGET]


def _tables(rows: list[tuple[int, int, Estimate]], names: tuple[str, ...]) -> Tracked:
    t_ns = np.array([r[0] for r in rows], dtype=np.int64)
    target = np.array([r[1] for r in rows], dtype=np.int32)
    estimates = [r[2] for r in rows]
    xy, velocity = np.array([e.xy for e in estimates]), np.array([e.velocity for e in estimates])
    cov = np.array([e.covariance for e in estimates])
    tracks = Tracks(
        t_ns, target, xy[:, 0], xy[:, 1], velocity[:, 0], velocity[:, 1], cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    )
    diagnostics = Diagnostics(
        t_ns=t_ns,
        target_id=target,
        ess=np.array([e.ess for e in estimates], dtype=np.float64),
        log_likelihood=np.array([e.log_likelihood for e in estimates], dtype=np.float64),
        n_looked=np.array([e.n_looked for e in estimates], dtype=np.int32),
        n_seen=np.array([e.n_seen for e in estimates], dtype=np.int32),
        fallback=np.array([e.fallback for e in estimates], dtype=np.str_),
        cameras=np.array([",".join(names[i] for i in e.used) for e in estimates], dtype=np.str_),
    )
    return Tracked(tracks, diagnostics)
