"""Multi-person tracking of a stream of time steps, with output tables in chunks."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.records.scene import SIDE, Camera, CommonNoise, MicrophoneArray, Scene, camera_from, map_origin, scene_from
from occlog.track.methods.jipda import filter as joint_filter
from occlog.track.methods.jipda.batch import smooth as window
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.doa_update import update_by_directions
from occlog.track.methods.jipda.interface import DirectionsOfArrival, FrameDetections, PositionSource, TrackSnapshot

from .camera_checks.agreement import CameraAgreement
from .close_encounters import CloseEncounters
from .frame_detections import FrameDetectionsWithIds
from .rows import SnapshotTables, SnapshotWithDetections, TracksInViews, associations_of, events_of, tracks_of

State = TypeVar("State")
Window = TypeVar("Window")
ROWS_PER_PART = 8192
"""Rows of all tables together, about; a part of one time step may have more."""


class FixedLagSmoother(NamedTuple, Generic[State, Window]):
    """Interface of a fixed-lag smoother, which returns time steps in order after later data has arrived.

    `begin(lag_ns, generator)` creates its state (lag None: whole recording), `add` takes the filter's result of one
    more time step and returns the new state and the smoothed time steps that are ready, `finish` returns the others.
    """

    begin: Callable[[int | None, Generator], Window]
    add: Callable[[Window, State, Sequence[FrameDetections], TrackSnapshot], tuple[Window, list[TrackSnapshot]]]
    finish: Callable[[Window, State], list[TrackSnapshot]]


class PeopleTracker(NamedTuple, Generic[State, Window]):
    """Interface of a multi-person method: functions that begin and advance the filter, and an optional smoother.

    `begin(scene, cameras, config)` creates the filter state, `step` takes the frames of one time step and returns the
    new state and the tracks, `hear` updates the state by directions of arrival (None: not used), `future` is the
    smoother.
    """

    begin: Callable[[Scene, Sequence[Camera | PositionSource], JipdaConfig], State]
    step: Callable[[State, Sequence[FrameDetections]], tuple[State, TrackSnapshot]]
    hear: Callable[[State, DirectionsOfArrival, MicrophoneArray], State] | None = None  # None: it is deaf
    future: FixedLagSmoother[State, Window] | None = None  # None: no smoother


JIPDA: PeopleTracker[joint_filter.JipdaState, window.SmoothingWindow] = PeopleTracker(
    begin=joint_filter.initial_state,
    step=joint_filter.step,
    hear=update_by_directions,
    future=FixedLagSmoother(window.SmoothingWindow, window.add, window.finish),
)
"""Method `jipda`."""


def track_people(
    time_steps: Iterable[Sequence[FrameDetectionsWithIds]],
    scene: Scene,
    cameras: Sequence[Camera | PositionSource],
    config: JipdaConfig,
    follower: PeopleTracker[State, Window],
    seed: int = 0,
    heard: Iterable[DirectionsOfArrival] = (),
    at_end: Callable[[State], None] | None = None,
) -> Iterator[list[SnapshotWithDetections]]:
    """Track all people, and generate the tracked time steps in chunks of bounded size, in the order of time.

    Args:
        time_steps: frames of each time step, in the order of time; none is empty.
        scene: scene with the sensors, in its own unit.
        cameras: cameras, then position sensors; the frames refer to them by index.
        config: settings of the method; with smoothing or a lag, time steps wait for later ones.
        follower: the method: its filter and smoother.
        seed: seed of the smoother's random numbers.
        heard: directions of arrival at the scene's arrays, in the order of time.
        at_end: called with the state after the last time step; None: not.
    """
    held: list[SnapshotWithDetections] = []
    rows = 0
    encounters = CloseEncounters(config)
    time_steps = iter(time_steps)
    first = next(time_steps, None)
    origin = _origin(cameras, first)
    near = scene_from(scene, origin)
    views = [c if isinstance(c, PositionSource) else camera_from(c, origin) for c in cameras]
    state = follower.begin(near, views, config)
    coming = (_shifted(frames, origin) for frames in chain([] if first is None else [first], time_steps))
    steps = _steps(coming, near, state, follower, heard, at_end)
    for report in _reported(steps, follower, config, seed):
        doubts = encounters.add(report.snapshot)
        snapshot = report.snapshot._replace(events=(*report.snapshot.events, *doubts))
        each = report._replace(snapshot=snapshot._replace(mean=snapshot.mean + np.append(origin, np.zeros(4))))
        held.append(each)
        # Even a time step without any person is kept with its frames
        rows += 1 + len(each.snapshot.support.row) + len(each.snapshot.ids) * (1 + len(each.frames))
        if rows >= ROWS_PER_PART:
            yield held
            held, rows = [], 0
    if held:
        yield held


def _origin(cameras: Sequence[Camera | PositionSource], first: Sequence[FrameDetectionsWithIds] | None) -> Floats:
    """Return the origin (2,) of local coordinates: near the cameras, else near the first positions from sensors.

    Without cameras it is the mean of the positions, rounded to a grid of `SIDE`, or (0, 0) if there are none.
    """
    placed = [c for c in cameras if not isinstance(c, PositionSource)]
    if placed:
        return map_origin(placed)
    positions = np.concatenate([np.zeros((0, 2)), *(each.detections.boxes[:, :2] for each in first or ())])
    return np.round(positions.mean(axis=0) / SIDE) * SIDE if len(positions) else np.zeros(2)


def _shifted(frames: Sequence[FrameDetectionsWithIds], origin: Floats) -> Sequence[FrameDetectionsWithIds]:
    """Return the frames with ground positions relative to `origin` (2,); boxes in images are unchanged."""
    if not origin.any():
        return frames
    by = np.tile(origin, 2)
    return [
        each
        if each.detections.covariance is None
        else each._replace(detections=each.detections._replace(boxes=each.detections.boxes - by))
        for each in frames
    ]


def _steps(
    steps: Iterable[Sequence[FrameDetectionsWithIds]],
    scene: Scene,
    state: State,
    follower: PeopleTracker[State, Window],
    heard: Iterable[DirectionsOfArrival],
    at_end: Callable[[State], None] | None = None,
) -> Iterator[tuple[State, SnapshotWithDetections]]:
    """Filter each time step, after an update with the directions of arrival since the previous one.

    Generate the filter state and the tracks after each.

    Args:
        steps: frames of each time step.
        scene: scene with the microphone arrays.
        state: initial state.
        follower: the method.
        heard: directions of arrival in the order of time.
        at_end: called with the last state; None: not.
    """
    sounds = iter(heard)
    sound = next(sounds, None)
    for frames in steps:
        while sound is not None and sound.t_ns <= frames[-1].detections.t_ns:
            if follower.hear is not None:
                state = follower.hear(state, sound, scene.arrays[sound.sensor])
            sound = next(sounds, None)
        state, snapshot = follower.step(state, [each.detections for each in frames])
        yield state, SnapshotWithDetections(snapshot, frames)
    if at_end is not None:
        at_end(state)


def _reported(
    steps: Iterable[tuple[State, SnapshotWithDetections]],
    follower: PeopleTracker[State, Window],
    config: JipdaConfig,
    seed: int,
) -> Iterator[SnapshotWithDetections]:
    """Generate the result of each time step in order: immediately, or after smoothing if `config` requests it.

    Args:
        steps: filter state and tracks after each time step.
        follower: the method, with its smoother.
        config: settings of the method.
        seed: seed of the smoother's random numbers.
    """
    if not config.smoothed or follower.future is None:
        yield from (seen for _, seen in steps)
        return
    window = follower.future.begin(config.lag_ns, generator(seed, RandomStream.SMOOTH))
    waiting: deque[Sequence[FrameDetectionsWithIds]] = deque()
    last: State | None = None
    for last, seen in steps:
        waiting.append(seen.frames)
        bare = [each.detections for each in seen.frames]
        window, ready = follower.future.add(window, last, bare, seen.snapshot)
        yield from (SnapshotWithDetections(found, waiting.popleft()) for found in ready)
    if last is not None:
        yield from (SnapshotWithDetections(found, waiting.popleft()) for found in follower.future.finish(window, last))


class Tabulator:
    """Converts time steps to output tables, and counts the detections that cameras have in common (`agreement`)."""

    def __init__(
        self,
        cameras: Sequence[Camera | PositionSource],
        *,
        in_images: bool,
        person_height: float = 1.7,
        room: Floats | None = None,
        common_noise: CommonNoise | None = None,
    ) -> None:
        """Prepare the tables, with all counts at 0.

        Args:
            cameras: cameras in the order of the frames' indices, then position sensors.
            in_images: project all tracks into every image (table `view_tracks`).
            person_height: mean height of people in the scene's unit.
            room: (K, 2) polygon where people can be; None: not stated.
            common_noise: errors that all cameras have in common, which widen covariances of tracks; None: none.
        """
        self._common_noise = common_noise
        self._names = [c.name for c in cameras]
        self._cameras = sum(not isinstance(c, PositionSource) for c in cameras)
        self._views = TracksInViews([c for c in cameras if not isinstance(c, PositionSource)]) if in_images else None
        self.agreement = CameraAgreement(cameras, person_height, room)

    def tables(self, seen: Sequence[SnapshotWithDetections]) -> SnapshotTables:
        """Return the output tables of some time steps, and count their detections in `agreement`."""
        for each in seen:
            self.agreement.add(each.snapshot, each.frames)
        return SnapshotTables(
            tracks=tracks_of(seen, self._names, self._cameras, self._common_noise),
            support=associations_of(seen, self._names),
            events=events_of(seen),
            views=None if self._views is None else self._views.table(seen),
        )
