"""Bearings to tracks: one filter for each target, fed scan by scan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..core.seeds import Stage, generator
from ..errors import UsageError
from ..records import Bearings, Diagnostics, Tracks
from ..scene import Scene
from ..trackers import tracker
from ..trackers.method import Estimate, Online, sensor_names
from .scan import Choice, Group, groups


@dataclass(frozen=True)
class TrackConfig:
    """What to track with."""

    method: str = "apf"
    settings: Any = None  # of the method, e.g. ApfConfig; None: the defaults for the scene's length unit
    choice: Choice = field(default_factory=Choice)


class Tracked(NamedTuple):
    """Estimates of some scans, in order of time, then target."""

    tracks: Tracks
    diagnostics: Diagnostics


class _Filter(NamedTuple):
    """A target's filter with its own random numbers."""

    state: Any
    rng: np.random.Generator


class _Row(NamedTuple):
    t_ns: int
    target: int
    estimate: Estimate


def track(bearings: Iterable[Bearings], scene: Scene, config: TrackConfig, seed: int) -> Iterator[Tracked]:
    """Track every target through the bearings, chunk by chunk; memory does not grow with their number.

    Each target has a filter of its own, which starts at its first row.  Unlabelled candidates
    go to all filters, but not for a sensor that has a labelled row for the target.  Where
    no target was labelled so far, they start one: the first of `config.choice.targets`, or 0.

    Args:
        bearings: chunks in the order of time; where they are cut does not matter.
        scene: sensors, room, static occluders.
        config: method, settings, which rows to use.
        seed: of all random numbers; each target has its own, so the estimate of one does not
            depend on which others there are.

    Returns:
        Tracks and diagnostics with a row for every scan and target.  UsageError and InputError
        for sensors, targets and rows that cannot be used.
    """
    method = tracker(config.method)
    settings = method.defaults(scene.length_unit) if config.settings is None else config.settings
    names = sensor_names(scene)
    filters: dict[int, _Filter] = {}
    for batch in groups(bearings, scene, config.choice):
        rows: list[_Row] = []
        for group in batch:
            for target in _concerned(group, filters, config.choice):
                scan = group.scan(target)
                if scan is None:
                    continue
                if target not in filters:
                    filters[target] = _start(method, scene, settings, target, filters, seed)
                state, estimate = method.step(filters[target].state, scan, filters[target].rng)
                filters[target] = filters[target]._replace(state=state)
                rows.append(_Row(group.t_ns, target, estimate))
        if rows:
            yield Tracked(_tracks(rows), _diagnostics(rows, names))


def _concerned(group: Group, filters: dict[int, _Filter], choice: Choice) -> list[int]:
    """Targets that the group may say something about, rising."""
    labelled = group.targets()
    if not filters and not labelled:
        return [choice.targets[0] if choice.targets else 0]
    return sorted({*labelled, *filters})


def _start(method: Online, scene: Scene, settings: Any, target: int, filters: dict[int, _Filter], seed: int) -> _Filter:
    if getattr(settings, "start", None) is not None and filters:
        others = ", ".join(str(k) for k in filters)
        raise UsageError(
            f"a start says where one target is, but the bearings are of target {target} too, besides {others}; "
            f"choose one, e.g. --target {target}"
        )
    rng = generator(seed, Stage.TRACK, target)
    return _Filter(method.init(scene, settings, rng), rng)


def _tracks(rows: list[_Row]) -> Tracks:
    xy = np.array([r.estimate.xy for r in rows])
    velocity = np.array([r.estimate.velocity for r in rows])
    covariance = np.array([r.estimate.covariance for r in rows])
    return Tracks.of(
        t_ns=[r.t_ns for r in rows],
        target_id=np.array([r.target for r in rows], dtype=np.int32),
        x=xy[:, 0],
        y=xy[:, 1],
        vx=velocity[:, 0],
        vy=velocity[:, 1],
        cov_xx=covariance[:, 0, 0],
        cov_xy=covariance[:, 0, 1],
        cov_yy=covariance[:, 1, 1],
    )


def _diagnostics(rows: list[_Row], names: tuple[str, ...]) -> Diagnostics:
    estimates = [r.estimate for r in rows]
    return Diagnostics.of(
        t_ns=[r.t_ns for r in rows],
        target_id=np.array([r.target for r in rows], dtype=np.int32),
        ess=[e.ess for e in estimates],
        log_likelihood=[e.log_likelihood for e in estimates],
        n_looked=np.array([e.n_looked for e in estimates], dtype=np.int32),
        n_seen=np.array([e.n_seen for e in estimates], dtype=np.int32),
        fallback=[e.fallback for e in estimates],
        cameras=[",".join(names[i] for i in e.used) for e in estimates],
    )
