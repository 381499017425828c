"""Fusion of the detections of several cameras: false ones are removed, missed ones recovered ([Lee] Ch. 4).

At each time step the detections of each target, and unlabelled candidates, are grouped on the ground; `decide` decides
about each object. The output has the rows of the input with their causes, and rows for recovered detections.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.errors import InputError, did_you_mean
from occlog.io.files.timing.utc import time_words
from occlog.measure.detections import Detections
from occlog.measure.fuse.kernels import LocalDirections
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Views

from .config import FuseConfig
from .object_decision import Decision, ObjectMemory, decide, fuse_candidates
from .rows import CAUSES, FusionPart, FusionRows, distances, whole_time_steps
from .views import PlacedCameras, feet, placed_cameras


class FusedPart(NamedTuple):
    """Part of a recording after the fusion, with counts of decisions.

    Attributes:
        views, bearings: rows after the fusion.
        losses: losses of the input.
        frames, warmup: numbers of frames, and of those at the start of a background model.
        counts: by camera, the numbers of detections kept, recovered and removed.
        targets: by camera, the numbers of labelled detections kept and removed.
        moments: number of time steps with a camera frame.
        alone: number of those in which a single camera delivered a frame.
        declared: number of declared objects, counted at each time step.
        absent: number of objects with detections that were not declared, counted at each time step.
    """

    views: Views
    bearings: Bearings
    losses: tuple[Loss, ...]
    frames: int
    warmup: int
    counts: dict[str, dict[str, int]]
    targets: dict[str, tuple[int, ...]]
    moments: int
    alone: int
    declared: int
    absent: int

    @property
    def detections(self) -> Detections:
        """The part without the counts of the fusion."""
        return Detections(self.views, self.bearings, self.losses, self.frames, self.warmup)


@dataclass
class _FusionState:
    """State of the fusion after previous time steps, updated in place.

    Attributes:
        targets: memories of labelled targets by identity.
        objects: memories of tracked objects without a label.
        frames: last frame number of each camera.
        moments: number of time steps.
        alone: number of time steps with a frame of a single camera.
        declared, absent: numbers of decisions with a declared object, and with detections but without one.
    """

    targets: dict[int, ObjectMemory] = field(default_factory=dict)
    objects: list[ObjectMemory] = field(default_factory=list)
    frames: dict[str, int] = field(default_factory=dict)
    moments: int = 0
    alone: int = 0
    declared: int = 0
    absent: int = 0

    def count(self, decision: Decision, detections: int) -> None:
        """Add a decision about a number of detections to the counts; with neither object nor detections do nothing."""
        self.declared += decision.declared
        self.absent += not decision.declared and detections > 0


def fuse(parts: Iterable[Detections], scene: Scene, config: FuseConfig | None = None) -> Iterator[FusedPart]:
    """Generate views and bearings after the fusion of several cameras ([Lee] Ch. 4), sorted by time.

    Labelled detections are fused by target. Candidates (target_id -1) are grouped on the ground and tracked over time
    steps. Rows of microphone arrays, and of cameras without a pose, are unchanged. The result is independent of chunk
    borders; memory is bounded.

    Args:
        parts: views and bearings in the order of time; views may be empty.
        scene: has all sensors of the bearings.
        config: settings; None: the defaults for the scene's unit.

    Raises:
        InputError: fewer than two cameras with a pose, a sensor that the scene does not have, times that go back,
            or two rows of a camera for one target and time step.
    """
    config = config or FuseConfig.in_unit(scene.length_unit)
    cameras = placed_cameras(scene, config)
    index_of = {name: i for i, name in enumerate(cameras.names)}
    known = {*(c.name for c in scene.cameras), *(a.name for a in scene.arrays)}
    state = _FusionState()
    for part in whole_time_steps(parts, round(config.window_s * 1e9)):
        names, inverse = np.unique(part.bearings.sensor, return_inverse=True)
        for name in names.tolist():
            if name not in known:
                raise InputError(
                    f"bearings: no sensor {name!r} in the scene; {did_you_mean(name, tuple(sorted(known)), 'it has')}",
                    id="unknown-sensor",
                )
        camera_of = np.array([index_of.get(name, -1) for name in names.tolist()], dtype=np.int64)[inverse]
        yield _fuse_part(part, camera_of, cameras, state, config)


def _fuse_part(
    part: FusionPart, camera_of: Ints, cameras: PlacedCameras, state: _FusionState, config: FuseConfig
) -> FusedPart:
    ledger = FusionRows(part, cameras, camera_of)
    sight = sights_of(part.bearings, camera_of, cameras, distances(part, feet(part.views, cameras)))
    before = (state.moments, state.alone, state.declared, state.absent)
    for first, last in zip(part.starts[:-1].tolist(), part.starts[1:].tolist(), strict=True):
        _fuse_step(ledger, sight, first, last, state, config)
    views, bearings = ledger.tables(state.frames)
    rows = ledger.counts().tolist()
    counts = {name: dict(zip(CAUSES, row, strict=True)) for name, row in zip(cameras.names, rows, strict=True)}
    targets = dict(zip(cameras.names, map(tuple, ledger.of_targets().tolist()), strict=True))
    after = (state.moments, state.alone, state.declared, state.absent)
    more = dict(zip(("moments", "alone", "declared", "absent"), np.subtract(after, before).tolist(), strict=True))
    came = part.losses
    return FusedPart(
        views=views,
        bearings=bearings,
        losses=came.losses,
        frames=came.frames,
        warmup=came.warmup,
        counts=counts,
        targets=targets,
        **more,
    )


def sights_of(bearings: Bearings, camera_of: Ints, cameras: PlacedCameras, distance: Floats) -> LocalDirections:
    """Convert N bearings to lines of sight from their cameras.

    Rows of other sensors get the ground position of the last camera as a placeholder; they are not to be used.

    Args:
        bearings: N rows.
        camera_of: (N,) index of the camera; -1: another sensor.
        cameras: calibrated cameras with ground positions.
        distance: (N, 2) distance of the feet and its standard deviation [length]; NaN: unknown.
    """
    ground = np.array([c.ground for c in cameras.placed])
    return LocalDirections(
        sensor=camera_of,
        origin=ground[camera_of],
        azimuth=bearings.bearing,
        sigma=bearings.sigma,
        distance=distance[:, 0],
        sigma_distance=distance[:, 1],
    )


class _FusionStep(NamedTuple):
    """One time step: its time, the rows of its camera bearings, and the cameras that have a frame.

    `observing` has sorted indices of the cameras; `t_of` the time [ns] of each of their frames.
    """

    t_ns: int
    rows: Ints  # of the bearings of cameras
    observing: Ints  # cameras that delivered a frame, ascending
    t_of: dict[int, int]  # camera to the time of its frame [ns]


def _fuse_step(
    ledger: FusionRows, sight: LocalDirections, first: int, last: int, state: _FusionState, config: FuseConfig
) -> None:
    """Decide about all targets and candidates of one time step; updates `ledger` and `state` in place.

    Args:
        ledger: collects the decisions about the rows of the part.
        sight: lines of sight of all bearings of the part.
        first: first row of the time step.
        last: row after the last one of the time step.
        state: targets and objects after earlier time steps.
        config: settings in the scene's unit.
    """
    rows = np.arange(first, last)[ledger.camera_of[first:last] >= 0]
    observing = np.unique(ledger.camera_of[rows])
    if not len(observing):
        return
    state.moments += 1
    state.alone += len(observing) == 1
    t_of = {int(ledger.camera_of[r]): int(ledger.bearings.t_ns[r]) for r in rows.tolist()}
    step = _FusionStep(int(ledger.bearings.t_ns[last - 1]), rows, observing, t_of)
    target = ledger.bearings.target_id[rows]
    # Labelled detections: one decision a target.
    for name in np.unique(target[target != UNLABELLED]).tolist():
        _fuse_target(ledger, sight, step, name, state, config)
    # Candidates: group them on the ground, then one decision an object.
    free = rows[target == UNLABELLED]
    if len(free) or state.objects:
        free = free[ledger.bearings.seen[free]]
        found = fuse_candidates(state.objects, step.t_ns, sight, free, observing, ledger.cameras, config)
        state.objects = found.objects
        for decision, candidates in found.decisions:
            state.count(decision, len(candidates))
            ledger.keep(candidates[decision.kept])
            for camera in decision.missed.tolist():
                ledger.recover(step.t_of[camera], camera, UNLABELLED, decision.at, None)
        ledger.remove(found.unassigned)
        ledger.tidy_candidates(first, last)


def _fuse_target(
    ledger: FusionRows,
    sight: LocalDirections,
    step: _FusionStep,
    target: int,
    state: _FusionState,
    config: FuseConfig,
) -> None:
    """Decide about one labelled target at one time step; updates `ledger` and `state` in place.

    InputError if a camera has two rows for the target in this step. `target` is its identity, `sight` has the lines of
    sight of all bearings of the part.
    """
    own = step.rows[ledger.bearings.target_id[step.rows] == target]
    row_of = {int(ledger.camera_of[r]): r for r in own.tolist()}
    if len(row_of) < len(own):
        twice = ledger.bearings.sensor[own[np.flatnonzero(np.diff(np.sort(ledger.camera_of[own])) == 0)[0]]]
        raise InputError(
            f"bearings: sensor {str(twice)!r} has two rows for target {target} at {time_words(step.t_ns)}; a "
            "sensor has one row a target and time (candidates of any object: target_id -1)",
            id="duplicate-row",
        )
    seen = own[ledger.bearings.seen[own]]
    memory = state.targets.get(target, ObjectMemory())
    decision = decide(memory, step.t_ns, sight.take(seen), step.observing, ledger.cameras, config)
    state.targets[target] = decision.memory
    state.count(decision, len(seen))
    ledger.keep(seen[decision.kept])
    ledger.remove(seen[~decision.kept])
    for camera in decision.missed.tolist():
        ledger.recover(step.t_of[camera], camera, target, decision.at, row_of.get(camera))
