"""Fusion of the detections of several cameras: false ones are removed, missed ones recovered ([Lee] Ch. 4).

Of every moment the detections of each target, and the candidates that may be of anybody, are brought together on
the ground; the decision is in `fuse_decide`.  What comes out has the rows that came in, with their cause.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.errors import InputError
from occlog.measure.detections import Detections
from occlog.measure.fuse.kernels.sight_lines import Sight
from occlog.measure.scans.grouping import nearest
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Views

from .cameras import Eyes, open_eyes
from .candidates import fuse_candidates
from .config import FuseConfig
from .decide import Decision, Memory, decide
from .moments import Part, whole_moments
from .rows import CAUSES, Ledger, distances
from .views import feet


class Fused(NamedTuple):
    """What came out of some more of the recording; the first five are those of `Detections`."""

    views: Views
    bearings: Bearings
    losses: tuple[Loss, ...]
    frames: int
    warmup: int
    counts: dict[str, dict[str, int]]  # by camera: detections kept, recovered, removed
    moments: int
    alone: int  # moments in which a single camera delivered a frame
    declared: int  # objects declared, one a moment and object
    absent: int  # moments and objects with detections that were not declared


@dataclass
class _State:
    """What is known from the moments before."""

    targets: dict[int, Memory] = field(default_factory=dict)
    objects: list[Memory] = field(default_factory=list)
    frames: dict[str, int] = field(default_factory=dict)
    moments: int = 0
    alone: int = 0
    declared: int = 0
    absent: int = 0

    def count(self, decision: Decision, detections: int) -> None:
        """Count a decision about some detections."""
        self.declared += decision.declared
        self.absent += not decision.declared and detections > 0


def fuse(parts: Iterable[Detections], scene: Scene, config: FuseConfig | None = None) -> Iterator[Fused]:
    """Views and bearings after the fusion, in the order of time.

    Each target's labelled detections are fused by themselves.  Candidates (target_id -1) are grouped on the ground
    and followed from one moment to the next.  Rows of microphone arrays, and of cameras without a pose, stay as
    they are.  Where the input is cut does not matter; memory does not grow with it.

    Args:
        parts: views and bearings in the order of time; views may be left empty.
        scene: must have the sensors.
        config: settings; None: the defaults for the scene's unit.

    Raises:
        InputError: fewer than two cameras with a pose, a sensor that the scene does not have, times that go back,
            or two rows of a camera for one target and moment.
    """
    config = config or FuseConfig.in_unit(scene.length_unit)
    eyes = open_eyes(scene, config)
    places = {name: i for i, name in enumerate(eyes.names)}
    known = {*(c.name for c in scene.cameras), *(a.name for a in scene.arrays)}
    state = _State()
    for part in whole_moments(parts, round(config.window_s * 1e9)):
        names, inverse = np.unique(part.bearings.sensor, return_inverse=True)
        for name in names.tolist():
            if name not in known:
                raise InputError(f"bearings: no sensor {name!r} in the scene; {nearest(name, tuple(sorted(known)))}")
        eye = np.array([places.get(name, -1) for name in names.tolist()], dtype=np.int64)[inverse]
        yield _fuse_part(part, eye, eyes, state, config)


def _fuse_part(part: Part, eye: Ints, eyes: Eyes, state: _State, config: FuseConfig) -> Fused:
    ledger = Ledger(part, eyes, eye)
    sight = sights_of(part.bearings, eye, eyes, distances(part, feet(part.views, eyes)))
    before = (state.moments, state.alone, state.declared, state.absent)
    for first, last in zip(part.starts[:-1].tolist(), part.starts[1:].tolist(), strict=True):
        _fuse_moment(ledger, sight, first, last, state, config)
    views, bearings = ledger.tables(state.frames)
    rows = ledger.counts().tolist()
    counts = {name: dict(zip(CAUSES, row, strict=True)) for name, row in zip(eyes.names, rows, strict=True)}
    after = (state.moments, state.alone, state.declared, state.absent)
    came = part.losses
    return Fused(
        views,
        bearings,
        came.losses,
        came.frames,
        came.warmup,
        counts,
        *(a - b for a, b in zip(after, before, strict=True)),
    )


def sights_of(bearings: Bearings, eye: Ints, eyes: Eyes, distance: Floats) -> Sight:
    """All rows as sight lines; those of other sensors are of no use."""
    ground = np.array([c.ground for c in eyes.cameras])
    return Sight(eye, ground[eye], bearings.bearing, bearings.sigma, distance[:, 0], distance[:, 1])


def _fuse_moment(ledger: Ledger, sight: Sight, first: int, last: int, state: _State, config: FuseConfig) -> None:
    """All targets and candidates of one moment."""
    rows = np.arange(first, last)[ledger.eye[first:last] >= 0]
    looked = np.unique(ledger.eye[rows])
    if not len(looked):
        return
    state.moments += 1
    state.alone += len(looked) == 1
    t_ns = int(ledger.bearings.t_ns[last - 1])
    target = ledger.bearings.target_id[rows]
    for name in np.unique(target[target != UNLABELLED]).tolist():
        own = rows[target == name]
        _fuse_target(ledger, sight, t_ns, name, own, rows, looked, state, config)
    free = rows[target == UNLABELLED]
    if len(free) or state.objects:
        t_of = {int(ledger.eye[r]): int(ledger.bearings.t_ns[r]) for r in rows.tolist()}
        free = free[ledger.bearings.seen[free]]
        found = fuse_candidates(state.objects, t_ns, sight, free, looked, ledger.eyes, config)
        state.objects = found.objects
        for decision, candidates in found.decisions:
            state.count(decision, len(candidates))
            ledger.keep(candidates[decision.kept])
            for camera in decision.missed.tolist():
                ledger.recover(t_of[camera], camera, UNLABELLED, decision.at, None)
        ledger.remove(found.nobody)
        ledger.tidy_candidates(first, last)


def _fuse_target(
    ledger: Ledger,
    sight: Sight,
    t_ns: int,
    name: int,
    own: Ints,
    rows: Ints,
    looked: Ints,
    state: _State,
    config: FuseConfig,
) -> None:
    """One target of one moment."""
    place = {int(ledger.eye[r]): r for r in own.tolist()}
    if len(place) < len(own):
        twice = ledger.bearings.sensor[own[np.flatnonzero(np.diff(np.sort(ledger.eye[own])) == 0)[0]]]
        raise InputError(
            f"bearings: sensor {str(twice)!r} has two rows for target {name} at {t_ns} ns; a sensor has one row a "
            "target and time (candidates that may be of any object have target_id -1)"
        )
    seen = own[ledger.bearings.seen[own]]
    decision = decide(state.targets.get(name, Memory()), t_ns, sight.take(seen), looked, ledger.eyes, config)
    state.targets[name] = decision.memory
    state.count(decision, len(seen))
    ledger.keep(seen[decision.kept])
    ledger.remove(seen[~decision.kept])
    t_of = {int(ledger.eye[r]): int(ledger.bearings.t_ns[r]) for r in rows.tolist()}
    for camera in decision.missed.tolist():
        ledger.recover(t_of[camera], camera, name, decision.at, place.get(camera))
