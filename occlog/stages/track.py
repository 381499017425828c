"""Bearings to tracks: one filter a target, streaming."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from ..columns import Floats
from ..core.priors import Priors
from ..core.seeds import Stage, generator
from ..errors import UsageError
from ..records import UNLABELLED, Bearings, Calibration, Diagnostics, Hulls, Occluders, Tracks
from ..scene import Scene
from ..trackers import tracker
from ..trackers.method import Batch, Estimate, Height, Joint, Online, Scan, sensor_names
from ..trackers.select import Choice, SelectConfig, choose, network
from .occluders import OccluderFeed
from .scans import Group, Rows, groups, nearest, scan_of
from .track_batch import track_batch
from .track_joint import track_joint
from .tracked import Tracked, check_start

NS = 1_000_000_000
FOREVER_NS = 2.0**63
"""No two times are further apart."""
ROWS_PER_CHUNK = 4096
FIRST_TARGET = 0
"""Identity of the track when no measurement carries one."""


class _Selected(NamedTuple):
    """Cameras selected for a target."""

    since_ns: int
    choice: Choice


class _Filter(NamedTuple):
    state: Any
    rng: Generator
    selecting: Generator  # draws of the selection, so that it does not change the filter's
    selected: _Selected | None = None
    offered: int = 0  # frames of scans that are in no row yet
    mse: float = math.nan  # metric of a selection that is in no row yet


class _Row(NamedTuple):
    t_ns: int
    target: int
    estimate: Estimate
    n_offered: int
    selected: tuple[int, ...]
    mse: float  # NaN: nothing was selected anew


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
    occluders: Iterable[Occluders] | Iterable[Hulls] | None = None,
    selection: SelectConfig | None = None,
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
        occluders: priors of the moving occluders, in the order of time; None: nothing is known about them.
        selection: how to select cameras; only those selected are used.  None: no selection.

    Raises:
        InputError: bearings that do not fit the scene or each other.
        UsageError: a start (`config.start`) for several targets, or a selection that the
            method or the scene does not allow.
    """
    chosen, names = tracker(method), sensor_names(scene)
    use = Rows(frozenset(names) if sensors is None else sensors, targets, unlabelled)
    if isinstance(chosen, Batch):
        if selection is not None or occluders is not None:
            what = "--select" if selection is not None else "--occluders"
            raise UsageError(f"{what}: method {method} takes all that was recorded at once; leave {what} out")
        yield from track_batch(bearings, scene, config, chosen, use, window_ns)
        return
    if isinstance(chosen, Joint):
        if selection is not None or occluders is not None:
            what = "--select" if selection is not None else "--occluders"
            raise UsageError(f"{what}: method {method} asks cameras itself (--cooperate); leave {what} out")
        yield from track_joint(bearings, scene, config, chosen, seed, use, window_ns)
        return
    feed = None
    if occluders is not None:
        if not hasattr(config, "occluder_diameter"):
            raise UsageError(f"--occluders: method {method} knows nothing of moving occluders; leave --occluders out")
        feed = OccluderFeed(occluders, config.occluder_diameter, round(config.prior_max_age_s * NS))
    selector = None if selection is None else Selector(chosen, scene, selection, frozenset(use.sensors), config)
    filters: dict[int, _Filter] = {}
    rows: list[_Row] = []
    for group in groups(bearings, scene, use, window_ns):
        priors = None if feed is None else feed.at(group.t_ns)
        for target in _targets(group, filters, targets):
            scan = scan_of(group, target)
            if scan is None:
                continue
            if target not in filters:
                check_start(config, target, filters)
                rng = generator(seed, Stage.TRACK, target)
                selecting = generator(seed, Stage.SELECT, target)
                filters[target] = _Filter(chosen.init(scene, config, rng), rng, selecting)
            own = filters[target]
            offered = own.offered + len(np.unique(scan.sensor))
            if selector is not None:
                own = selector.update(own, scan.t_ns, priors)
                scan = selector.asked(own, scan)
            if scan is None:
                # None of the cameras that are asked had a frame; the next row tells of it.
                filters[target] = own._replace(offered=offered)
                continue
            state, estimate = chosen.step(own.state, scan._replace(occluders=priors), own.rng)
            if estimate is None:
                # The scan tells no position; the next row tells that it was there.
                filters[target] = own._replace(state=state, offered=offered)
                continue
            asked = () if own.selected is None else own.selected.choice.cameras
            rows.append(_Row(group.t_ns, target, estimate, offered, asked, own.mse))
            filters[target] = own._replace(state=state, offered=0, mse=math.nan)
        if len(rows) >= ROWS_PER_CHUNK:
            yield _tables(rows, names)
            rows = []
    if rows:
        yield _tables(rows, names)


class Selector:
    """Selects cameras for each target, every few reference steps ([Ercan] Alg. 3)."""

    def __init__(self, method: Online, scene: Scene, selection: SelectConfig, usable: frozenset[str], config: Any):
        """UsageError for a method that cannot say where a target will be, or for a selection that does not fit."""
        if method.predict is None:
            raise UsageError("select: the method cannot predict where the target will be; leave --select out")
        self._predict = method.predict
        self._selection = selection
        self._every_ns = round(min(selection.every * getattr(config, "reference_s", 1.0) * NS, FOREVER_NS))
        self._net = network(scene, selection, usable, getattr(config, "detection", None))
        self._cameras = len(scene.cameras)

    def update(self, own: _Filter, t_ns: int, priors: Priors | None) -> _Filter:
        """The filter with the cameras to use at a time, selected anew where that is due."""
        if own.selected is not None and t_ns - own.selected.since_ns < self._every_ns:
            return own
        cloud = self._predict(own.state, t_ns, own.selecting)
        choice = choose(cloud, priors, self._net, self._selection, own.selecting)
        return own._replace(selected=_Selected(t_ns, choice), mse=choice.mse)

    def asked(self, own: _Filter, scan: Scan) -> Scan | None:
        """What selected cameras and all microphone arrays say; None if that is nothing."""
        if own.selected is None:
            return scan
        keep = np.isin(scan.sensor, own.selected.choice.cameras) | (scan.sensor >= self._cameras)
        if not keep.any():
            return None
        return Scan(
            scan.t_ns, scan.sensor[keep], scan.labelled[keep], scan.seen[keep], scan.bearing[keep], scan.sigma[keep],
            scan.u_px[keep], scan.sigma_px[keep], scan.score[keep],
            elevation=None if scan.elevation is None else scan.elevation[keep],
            sigma_elevation=None if scan.sigma_elevation is None else scan.sigma_elevation[keep],
        )  # fmt: skip


def _targets(group: Group, filters: dict[int, _Filter], wanted: tuple[int, ...] | None) -> list[int]:
    """Targets that a scan may be about, rising."""
    labelled = {k for k in group.target.tolist() if k != UNLABELLED}
    return sorted(labelled | set(filters)) or [wanted[0] if wanted else FIRST_TARGET]


def _tables(rows: list[_Row], names: tuple[str, ...]) -> Tracked:
    t_ns = np.array([r.t_ns for r in rows], dtype=np.int64)
    target = np.array([r.target for r in rows], dtype=np.int32)
    estimates = [r.estimate for r in rows]
    xy, velocity = np.array([e.xy for e in estimates]), np.array([e.velocity for e in estimates])
    cov = np.array([e.covariance for e in estimates])
    tracks = Tracks.of(
        t_ns=t_ns, target_id=target, x=xy[:, 0], y=xy[:, 1], vx=velocity[:, 0], vy=velocity[:, 1],
        cov_xx=cov[:, 0, 0], cov_xy=cov[:, 0, 1], cov_yy=cov[:, 1, 1], **_heights(estimates),
    )  # fmt: skip
    diagnostics = Diagnostics(
        t_ns=t_ns,
        target_id=target,
        ess=np.array([e.ess for e in estimates], dtype=np.float64),
        log_likelihood=np.array([e.log_likelihood for e in estimates], dtype=np.float64),
        n_looked=np.array([e.n_looked for e in estimates], dtype=np.int32),
        n_seen=np.array([e.n_seen for e in estimates], dtype=np.int32),
        fallback=np.array([e.fallback for e in estimates], dtype=np.str_),
        cameras=np.array([",".join(names[i] for i in e.used) for e in estimates], dtype=np.str_),
        n_offered=np.array([r.n_offered for r in rows], dtype=np.int32),
        selected=np.array([",".join(names[i] for i in r.selected) for r in rows], dtype=np.str_),
        predicted_mse=np.array([r.mse for r in rows], dtype=np.float64),
    )
    return Tracked(tracks, diagnostics, _calibration(rows, names))


def _heights(estimates: list[Estimate]) -> dict[str, Floats]:
    """Columns of estimates in space; none if all are on the ground."""
    if all(e.height is None for e in estimates):
        return {}
    none = Height(math.nan, math.nan, np.full(3, math.nan))
    heights = [none if e.height is None else e.height for e in estimates]
    xz, yz, zz = np.array([h.covariance for h in heights]).T
    z, vz = np.array([[h.z, h.vz] for h in heights]).T
    return {"z": z, "vz": vz, "cov_xz": xz, "cov_yz": yz, "cov_zz": zz}


def _calibration(rows: list[_Row], names: tuple[str, ...]) -> Calibration:
    """Errors of all sensors after each scan, where they are estimated."""
    found = [(r.t_ns, r.target, r.estimate.calibration) for r in rows if r.estimate.calibration is not None]
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
