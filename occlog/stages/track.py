"""Bearings to tracks: one filter a target, streaming."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from ..core.seeds import Stage, generator
from ..errors import UsageError
from ..records import UNLABELLED, Bearings, Calibration, Diagnostics, Tracks
from ..scene import Scene
from ..trackers import tracker
from ..trackers.method import Estimate, sensor_names
from .scans import Group, Rows, groups, nearest, scan_of

ROWS_PER_CHUNK = 4096
FIRST_TARGET = 0
"""Identity of the track when no measurement carries one."""


class Tracked(NamedTuple):
    """Some more rows of a track and how the filter fared, equal in number, and what it learned of the sensors."""

    tracks: Tracks
    diagnostics: Diagnostics
    calibration: Calibration  # rows of every sensor and scan; none if it is not estimated


class _Filter(NamedTuple):
    state: Any
    rng: Generator


def choose_sensors(scene: Scene, only: Iterable[str] = (), without: Iterable[str] = ()) -> frozenset[str]:
    """Names of the sensors to use; UsageError names one that the scene does not have."""
    names = sensor_names(scene)
    only, without = list(only), list(without)
    for name in (*only, *without):
        if name not in names:
            raise UsageError(f"no sensor {name!r} in the scene; {nearest(name, names)}")
    used = frozenset(only or names) - frozenset(without)
    if not used:
        raise UsageError("no sensor is left to track with; leave out fewer of them")
    return used


def track(
    bearings: Iterable[Bearings],
    scene: Scene,
    config: Any,
    seed: int,
    *,
    method: str = "apf",
    sensors: frozenset[str] | None = None,
    targets: tuple[int, ...] | None = None,
    unlabelled: bool = True,
    window_ns: int = 0,
) -> Iterator[Tracked]:
    """Tracks of all targets, chunk by chunk, in the order of time; memory does not grow with their length.

    Each labelled target has a filter of its own, with its own random numbers, which starts
    with the target's first row; what one target's track is does not depend on the others.
    Unlabelled candidates go to every filter, but not for a sensor that has a labelled row
    for that target.  If no target was met before they start a track themselves, numbered by
    the first of `targets`, or 0.

    Args:
        bearings: chunks in the order of time; where they are cut does not matter.
        scene: the sensors, the room and what stands in it.
        config: settings of the method, see `occlog.trackers`.
        seed: of all random numbers.
        method: a key of `TRACKERS`.
        sensors: names of those to use; None: all.
        targets: identities of those to track; None: all.
        unlabelled: use candidates that are not assigned to a target.
        window_ns: rows at most this far apart form one scan.

    Raises:
        InputError: bearings that do not fit the scene or each other.
        UsageError: a start (`config.start`) for several targets.
    """
    chosen, names = tracker(method), sensor_names(scene)
    use = Rows(frozenset(names) if sensors is None else sensors, targets, unlabelled)
    filters: dict[int, _Filter] = {}
    rows: list[tuple[int, int, Estimate]] = []
    for group in groups(bearings, scene, use, window_ns):
        for target in _targets(group, filters, targets):
            scan = scan_of(group, target)
            if scan is None:
                continue
            if target not in filters:
                _check_start(config, target, filters)
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


def _targets(group: Group, filters: dict[int, _Filter], wanted: tuple[int, ...] | None) -> list[int]:
    """Targets that a scan may be about, rising."""
    labelled = {k for k in group.target.tolist() if k != UNLABELLED}
    return sorted(labelled | set(filters)) or [wanted[0] if wanted else FIRST_TARGET]


def _check_start(config: Any, target: int, filters: dict[int, _Filter]) -> None:
    if filters and getattr(config, "start", None) is not None:
        others = ", ".join(str(k) for k in sorted(filters))
        raise UsageError(
            f"--start says where one target is, but there is target {target} besides {others}; "
            f"choose one, e.g. --target {target}"
        )


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
    return Tracked(tracks, diagnostics, _calibration(rows, names))


def _calibration(rows: list[tuple[int, int, Estimate]], names: tuple[str, ...]) -> Calibration:
    """Errors of all sensors after each scan, where they are estimated."""
    found = [(t_ns, target, e.calibration) for t_ns, target, e in rows if e.calibration is not None]
    if not found:
        return Calibration.empty()
    n, S = len(found), len(names)
    mean = np.array([c.mean for _, _, c in found]).reshape(n * S, 3)
    deviation = np.array([c.deviation for _, _, c in found]).reshape(n * S, 3)
    table = Calibration(
        np.repeat(np.array([f[0] for f in found], dtype=np.int64), S),
        np.repeat(np.array([f[1] for f in found], dtype=np.int32), S),
        np.tile(np.array(names, dtype=np.str_), n),
        *mean.T,
        *deviation.T,
    )
    return Calibration.merge([table])
