"""Inputs of multi-person trackers: boxes of a recording or a table, cameras of the scene, resumption of a saved state.

The median height of people, by their boxes and the poses of cameras, determines the length unit of the scene, and finds
impossible calibrations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import ClassVar, TypeVar

import numpy as np

from occlog.array_types import NS, Floats
from occlog.errors import InputError, UsageError, did_you_mean, option
from occlog.io.open import Opened, check_unit, input_losses, load_scene, open_input
from occlog.records.frames import gaps_of, inside
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Scene, other_angle_readings
from occlog.records.tables import Bearings, Boxes, Doa, Positions, Views
from occlog.scans.clocks import ClockCorrection, applied_clocks, clock_changes, clocks_of, with_applied_clocks
from occlog.scans.sources import bearings_of_doa
from occlog.settings import LENGTH_POWER, METRES, Settings, configure, declaration, declared
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.interface import DirectionsOfArrival, PositionSource
from occlog.track.request import TrackInImagesRequest, TrackPeopleRequest

from .camera_checks.pair_overlap import BODY_HEADS, person_heights
from .frame_detections import (
    BoxStatistics,
    FrameDetectionsWithIds,
    FrameNumbers,
    RegionFrameTimes,
    frame_detections,
    frames_of_positions,
    frames_without_boxes,
    group_time_steps,
    in_order,
    rows_of_boxes,
    rows_of_views,
)
from .retimed import retimed

S = TypeVar("S", bound=Settings)

HEIGHT_RATIO_LIMIT = 1.6
"""Maximum ratio of the heights of people between a camera and the others; beyond it the calibrations disagree."""
WRONG_UNIT_HEIGHT_RATIO = 2.5
"""Maximum ratio of the heights of people to the stated height; beyond it the unit of the scene is wrong."""


MISREAD_HEIGHT_RATIO = 1.25
"""Maximum ratio of the heights of people to the stated height, if boxes or angles that are read in another way are
named as the cause."""
IMPOSSIBLE_HEIGHT_RATIO = 10.0
"""Maximum ratio of any height to the usual height of people, including children and tall machines."""


def median_height(heights: Floats) -> float:
    """Return the median of the person heights (C,) over the cameras with an estimate; NaN if none has."""
    finite = heights[np.isfinite(heights)]
    return float(np.median(finite)) if len(finite) else float("nan")


def height_readings(boxes: Sequence[Floats], cameras: Sequence[Camera]) -> Iterator[tuple[str, float]]:
    """Generate the median height of people if boxes or angles of all cameras are read in another way, in words.

    Args:
        boxes: (n, 4) left, top, right and bottom edges of each camera [px].
        cameras: as the scene states them.
    """
    sizes = [own[:, 2:] - own[:, :2] for own in boxes]
    across, down = np.median(np.concatenate(sizes), axis=0)
    if across > down:  # as of people on whom the axes are exchanged
        exchanged = [own[:, [1, 0, 3, 2]] for own in boxes]
        yield "boxes have y, x in place of x, y", median_height(person_heights(exchanged, cameras))
        swapped = [np.hstack([own[:, :2], own[:, :2] + size[:, ::-1]]) for own, size in zip(boxes, sizes, strict=True)]
        yield "widths and heights of boxes are exchanged", median_height(person_heights(swapped, cameras))
    bodies = [np.column_stack([own[:, :3], own[:, 1] + BODY_HEADS * (own[:, 3] - own[:, 1])]) for own in boxes]
    yield "boxes are of heads (give boxes of whole bodies)", median_height(person_heights(bodies, cameras))
    by_camera = [dict(other_angle_readings(camera.rotation)) for camera in cameras]
    for words in by_camera[0] if by_camera else ():
        if all(words in each for each in by_camera):
            turned = [replace(c, rotation=each[words]) for c, each in zip(cameras, by_camera, strict=True)]
            yield words, median_height(person_heights(boxes, turned))


def inconsistent_cameras(heights: Floats) -> Mapping[int, float]:
    """Return the cameras with a person height far from the others', as {camera index: height}.

    `heights` (C,) are by the boxes of each camera (NaN: unknown). A height is far if it is at least
    `HEIGHT_RATIO_LIMIT` times above or below the median of the other cameras.
    """
    found = {}
    for c in np.flatnonzero(np.isfinite(heights)).tolist():
        others = median_height(np.delete(heights, c))
        if np.isfinite(others) and not 1.0 / HEIGHT_RATIO_LIMIT < heights[c] / others < HEIGHT_RATIO_LIMIT:
            found[c] = float(heights[c])
    return found


def in_units_of(config: S, metre: float) -> S:
    """Return the settings with all lengths converted from metres to the scene's unit.

    `metre` is the length of a metre in that unit.
    """
    changed = {}
    for f in declared(type(config)):
        power, value = LENGTH_POWER.get(declaration(f).unit, 0), getattr(config, f.name)
        if power and isinstance(value, float):
            changed[f.name] = value * metre**power
    return replace(config, **changed)


FIRST_FRAMES = 64
"""Number of frames of each camera read ahead, to estimate the frame period and the heights of people."""
RAISE = (
    "say how high the cameras are: z of their positions in the scene, or up and ground of `occlog ingest` where the "
    "calibration's world is at a camera"
)
"""What to do about cameras at z = 0."""


class PeopleInput:
    """Input of a multi-person tracker: detections as a stream of time steps, and what is determined before tracking.

    Attributes:
        scene: scene with the sensors, in its own unit.
        cameras: cameras with a pose that are used; `sources` are the names of position sensors, `views` both.
        notes: notes and warnings for the user.
        tally: counts of frames and boxes, updated while time steps are read.
        heights: (C,) median height of people by the first boxes of each camera; NaN: unknown.
        metre: length of a metre in the scene's unit.
        config: settings of the method.
        window_ns: frames this close together are of one time step.
        regions_smoothed: the boxes are regions of video without confidence, with errors that last for many frames,
            and smoothing is requested.
        time_steps: iterator over time steps, each a list of frames.
    """

    COLOURS_OF_BOXES: ClassVar[bool] = False
    """Whether colours in boxes of a detector are used, which have pixels of the background."""
    request: TrackPeopleRequest | TrackInImagesRequest
    _doa: Opened | None

    def __init__(self, request: TrackPeopleRequest) -> None:
        """Open the boxes, and read the first frames for heights of people, length unit, settings and time window.

        Raises:
            InputError: no detections, no camera with a pose, or lengths that contradict the height of people.
            UsageError: a requested camera is not in the scene.
        """
        self.request = request
        try:
            self.opened = open_input(request.bearings)
        except InputError:
            _refuse_positions(request.bearings)
            raise
        self._require_detections()
        self.scene: Scene = load_scene(request.scene, self.opened.scene, request.bearings)
        if self.opened.made_in_a_scene:
            check_unit(self.opened, self.scene.length_unit)
        self.notes: list[str] = []
        self._apply_clocks()
        self._doa = self._directions()
        self.sources = self._sources()
        self.cameras = self._cameras()
        self.views: tuple[Camera | PositionSource, ...] = (*self.cameras, *map(PositionSource, self.sources))
        self.tally = BoxStatistics.of(len(self.views))
        self.numbers: dict[str, FrameNumbers] = {}
        frames = self._frames()
        first = list(islice(frames, FIRST_FRAMES * len(self.views)))
        boxes = [[np.zeros((0, 4))] for _ in self.cameras]
        for each in first:
            if each.detections.camera < len(boxes):
                boxes[each.detections.camera].append(each.detections.boxes)
        by_camera = [np.concatenate(own) for own in boxes]
        self.heights = person_heights(by_camera, self.cameras)
        self.metre, self.config = self._config(any(len(each.detections.boxes) for each in first), by_camera)
        scores = np.concatenate([np.zeros(0), *(each.detections.score for each in first)])
        regions = len(scores) > 0 and bool(np.isnan(scores).all()) and self.opened.has(Views)
        self.regions_smoothed = regions and self.config.smoothed
        self.window_ns = request.window_ns if request.window_ns is not None else default_window(first)
        self.time_steps: Iterator[list[FrameDetectionsWithIds]] = group_time_steps(chain(first, frames), self.window_ns)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses recorded when the input files were made."""
        return input_losses([self.opened, self._doa])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras and position sensors in use, by their index."""
        return tuple(c.name for c in self.views)

    def _apply_clocks(self) -> None:
        """Take the clocks that already correct the input's times into the scene, where the scene states none.

        If it is unknown which clocks were applied and the scene has clocks, a note states that they are not applied.
        """
        applied = applied_clocks(self.opened)
        self._applied = {} if applied is None else applied
        if applied is not None:
            self.scene = with_applied_clocks(self.scene, applied)
        elif any(clock.offset_ns or clock.drift_ppm for clock in clocks_of(self.scene).values()):
            self.notes.append(
                f"note: clocks of the scene are not applied to {self.request.bearings}, which does not state by which "
                "its times were corrected; ingest with this scene"
            )
        self._known = applied is not None

    @property
    def clock_changes(self) -> dict[int, ClockCorrection]:
        """Differences between the scene's clocks and those already applied to the input's times, by camera index.

        Empty if the applied ones are unknown.
        """
        return clock_changes(self.cameras, self.scene, self._applied) if self._known else {}

    def clock_figures(self) -> dict[str, object]:
        """Return the clock corrections [s] added to the input's times, for the summary; {} without any.

        They are by camera name, under the key `clock_corrections_s`.
        """
        changes = self.clock_changes
        added = {self.cameras[c].name: (e.before.offset_ns - e.after.offset_ns) / NS for c, e in changes.items()}
        return {"clock_corrections_s": added} if added else {}

    def _in_world_time(self, frames: Iterator[FrameDetectionsWithIds]) -> Iterator[FrameDetectionsWithIds]:
        """Generate the frames with times corrected by the clocks of the scene, sorted by the corrected times."""
        changes = self.clock_changes
        return retimed(frames, changes, len(self.cameras)) if changes else frames

    def _require_detections(self) -> None:
        """Raise InputError if the input has neither boxes, regions nor positions.

        A table of positions must be ingested into a recording first.
        """
        opened = self.opened
        if opened.recording is None and not any(opened.has(table) for table in (Boxes, Views)):
            _refuse_positions(self.request.bearings)
        opened.require(Boxes, Views, Positions, remedy=_remedy(opened))

    def _sources(self) -> tuple[str, ...]:
        """Return the names of the position sensors in use, sorted."""
        if self.opened.recording is None or not self.opened.has(Positions):
            return ()
        names = self.opened.recording.sensors_of(Positions)
        used = [n for n in sorted(names) if not self.request.cameras or n in self.request.cameras]
        return tuple(n for n in used if n not in self.request.without)

    def _cameras(self) -> tuple[Camera, ...]:
        """Return the cameras in use: those requested that have a pose above the ground; others cause a warning.

        Empty if there are position sensors and no usable camera.

        Raises:
            UsageError: unknown name.
            InputError: neither a camera with a pose nor a position sensor.
        """
        positions = self.opened.recording is not None and self.opened.has(Positions)
        sources = self.opened.recording.sensors_of(Positions) if positions and self.opened.recording else ()
        chosen = self._chosen(sources)
        if not any(self.opened.has(table) for table in (Boxes, Views)) and self.sources:
            return ()
        used = [c for c in chosen if c.has_height]
        low = [c.name for c in chosen if c.placed and not c.has_height]
        left = [c.name for c in chosen if not c.placed]
        if not used and self.sources:
            return ()
        if not used:
            remedy = "give a scene with calibrated cameras, or a calibration to ingest"
            if low:
                which = f"{', '.join(low)} {'is' if len(low) == 1 else 'are'} on the floor (z = 0)"
                which += f", {', '.join(left)} without a pose in space" if left else ""
                remedy = RAISE
            else:
                which = f"of {', '.join(left)} none has" if left else "no camera is left that has"
                which += " a pose in space"
            recording = self.opened.recording
            seen = recording is not None and recording.cameras
            images = ", or track people in the images (method sort)" if seen else ""
            raise InputError(
                f"{self.request.bearings}: {which}, so no position on the floor can be found; {remedy}{images}",
                id="missing-pose",
            )
        if left:
            self.notes.append(
                f"warning: without a pose in space, and not used: {', '.join(left)}; calibrate "
                f"{'it' if len(left) == 1 else 'them'}"
            )
        if low:
            self.notes.append(
                f"warning: on the floor (z = 0), from where no position on it can be seen, and not used: "
                f"{', '.join(low)}; {RAISE}"
            )
        return tuple(used)

    def _chosen(self, others: Iterable[str] = ()) -> list[Camera]:
        """Return the cameras of the scene that the request selects.

        `others` are names of other sensors that the request may select, too.

        Raises:
            UsageError: a requested name is neither a camera of the scene nor in `others`.
        """
        known = (*(c.name for c in self.scene.cameras), *others)
        for name in (*self.request.cameras, *self.request.without):
            if name not in known:
                raise UsageError(
                    f"no camera {name!r} in the scene; {did_you_mean(name, known, 'it has')}", id="unknown-sensor"
                )
        return [
            c
            for c in self.scene.cameras
            if (not self.request.cameras or c.name in self.request.cameras) and c.name not in self.request.without
        ]

    def _frames(self) -> Iterator[FrameDetectionsWithIds]:
        """Generate the frames of all cameras and position sensors in use, sorted by time; `tally` is updated."""
        if not self.sources:
            return self._camera_frames()
        index_of = {name: len(self.cameras) + k for k, name in enumerate(self.sources)}
        found = frames_of_positions(self.opened.rows(Positions), index_of, self.tally)
        return in_order(self._camera_frames(), found) if self.cameras else found

    def _camera_frames(self) -> Iterator[FrameDetectionsWithIds]:
        """Generate the frames of all cameras in use, sorted by time.

        Frames without detections are inserted where the input omits them.
        """
        known = [c.name for c in self.scene.cameras]
        boxes, external_table = self.opened.has(Boxes), self.opened.external_table
        views = () if boxes else self.opened.rows(Views)
        chunks = rows_of_boxes(self.opened.rows(Boxes)) if boxes else rows_of_views(views, self.COLOURS_OF_BOXES)
        found = self._in_world_time(frame_detections(chunks, self.cameras, known, self.tally))
        # Our boxes have a row for each frame without any; others tell of such frames by leaving numbers out
        if boxes and (external_table is None or not external_table.fits(RegionFrameTimes)):
            return found
        index_of = {camera.name: c for c, camera in enumerate(self.cameras)}
        return in_order(found, self._in_world_time(self._empty(index_of)))

    def _empty(self, index_of: Mapping[str, int]) -> Iterator[FrameDetectionsWithIds]:
        """Generate the frames without detections of a table of regions or external boxes, which has no rows for them.

        Nothing is generated for a recording; frames known as lost are omitted. `index_of` is the index of each camera
        in use by name; `numbers` and `tally` are updated.
        """
        if self.opened.recording is not None:
            return
        lost = gaps_of(self.opened.provenance.parameters)
        for each in frames_without_boxes(self.opened.rows(RegionFrameTimes), index_of, self.numbers):
            if not inside(lost.get(self.cameras[each.detections.camera].name, []), each.frame):
                self.tally.saw(each.detections)
                yield each

    def _directions(self) -> Opened | None:
        """Return the input with directions of arrival: the requested one, else the boxes' input if it has some.

        None without any.
        """
        if isinstance(self.request, TrackPeopleRequest) and self.request.doa is not None:
            opened = open_input(self.request.doa, Doa)
            if opened.made_in_a_scene:
                check_unit(opened, self.scene.length_unit)
            return opened
        return self.opened if self.opened.has(Doa) else None

    def heard(self) -> Iterator[DirectionsOfArrival]:
        """Generate directions of arrival in the order of time, those of an array at one time in one item."""
        if self._doa is None:
            return
        index_of = {array.name: k for k, array in enumerate(self.scene.arrays)}
        last: Bearings | None = None
        for chunk in bearings_of_doa(self._doa.rows(Doa), self.scene, recorded=self._doa.scene):
            rows = chunk if last is None else Bearings.concat([last, chunk])
            # The last time may go on in the next chunk
            cut = int(np.searchsorted(rows.t_ns, rows.t_ns[-1])) if len(rows) else 0
            yield from _by_array(rows.take(slice(0, cut)), index_of)
            last = rows.take(slice(cut, None))
        if last is not None:
            yield from _by_array(last, index_of)

    def _config(self, any_boxes: bool, boxes: Sequence[Floats]) -> tuple[float, JipdaConfig]:
        """Return the length of a metre in the scene's unit, and the tracker's settings in this unit.

        If the scene states no unit, the metre follows from the setting `person_height` or from the boxes.

        Args:
            any_boxes: there is a box in the first frames.
            boxes: (n, 4) left, top, right and bottom edges in the first frames of each camera [px].

        Raises:
            InputError: the height of people is impossible in the scene's unit, or the unit cannot be determined.
        """
        unit, given, tall = self.scene.length_unit, self.request.settings, median_height(self.heights)
        defaults = JipdaConfig.in_unit(unit)
        usual = JipdaConfig().person_height
        if unit in METRES:
            config = configure(defaults, given)
            remedy = "state the unit of the calibration (calibration_unit of `occlog ingest`)"
            if (
                not 1.0 / IMPOSSIBLE_HEIGHT_RATIO
                < config.person_height / defaults.person_height
                < IMPOSSIBLE_HEIGHT_RATIO
            ):
                # The other settings would not be in that unit
                raise InputError(
                    f"{self.request.bearings}: no person is {config.person_height:.3g} {unit} tall "
                    "(setting person_height), so the "
                    f"lengths of the scene are not in {unit}; {remedy}",
                    id="unit-mismatch",
                )
            share = tall / config.person_height
            if np.isfinite(share) and not 1.0 / WRONG_UNIT_HEIGHT_RATIO < share < WRONG_UNIT_HEIGHT_RATIO:
                if 1.0 / IMPOSSIBLE_HEIGHT_RATIO < tall / defaults.person_height < IMPOSSIBLE_HEIGHT_RATIO:
                    remedy += f", or else how tall people are (setting person_height, {tall:.3g})"
                # The reading with which people are nearest to the stated height, if any is near to it
                readings = {words: other for words, other in height_readings(boxes, self.cameras) if np.isfinite(other)}
                misfit = {words: abs(math.log(other / config.person_height)) for words, other in readings.items()}
                change = min(misfit, key=misfit.__getitem__, default="")
                if change and misfit[change] < math.log(MISREAD_HEIGHT_RATIO):
                    raise InputError(
                        f"{self.request.bearings}: the boxes imply that people are {tall:.3g} {unit} tall, but "
                        f"{readings[change]:.3g} {unit} if {change}; correct the scene or the boxes",
                        id="unit-mismatch",
                    )
                raise InputError(
                    f"{self.request.bearings}: the boxes imply that people are {tall:.3g} {unit} tall, so the "
                    f"lengths of the scene are not in {unit}, or camera positions or boxes are wrong; {remedy}",
                    id="unit-mismatch",
                )
            return 1.0 / METRES[unit], config
        stated = configure(JipdaConfig(), {k: v for k, v in given.items() if k == "person_height"}).person_height
        if "person_height" in given:
            metre = stated / usual
        elif np.isfinite(tall):
            metre = tall / usual
            self.notes.append(
                f"note: lengths are in a scene-specific unit; by boxes people are {tall:.3g} tall, so {metre:.3g} "
                "are taken for a metre; state another one in the setting person_height"
            )
        elif not any_boxes:
            metre = 1.0
        elif not self.cameras:
            raise InputError(
                f"{self.request.bearings}: the scene states no unit of length ({unit}), and without boxes the height "
                "of people is unknown; state it in the setting person_height",
                id="missing-unit",
            )
        else:
            raise InputError(
                f"{self.request.bearings}: the scene does not state its unit of length ({unit}), and the boxes do not "
                "determine how tall people are; state it in the setting person_height",
                id="missing-unit",
            )
        return metre, configure(in_units_of(JipdaConfig(), metre), given)


class ImageInput(PeopleInput):
    """Input of trackers in the image: boxes of cameras, which need no pose, as a stream of single frames.

    Attributes are those of `PeopleInput` without heights, unit, settings and time steps; `frames` is the iterator.
    """

    COLOURS_OF_BOXES: ClassVar[bool] = True

    def __init__(self, request: TrackInImagesRequest, *, in_world_time: bool = False) -> None:
        """Open the boxes; without a scene the cameras are those that the rows name.

        Args:
            request: request to track in the images.
            in_world_time: correct times by the clocks of the scene; else they are those of the input and its images.

        Raises:
            UsageError: no camera is left, or a requested one is unknown.
            InputError: there are no boxes.
        """
        self.request = request
        self.opened = open_input(request.bearings)
        self.opened.require(Boxes, Views, remedy=_remedy(self.opened))
        stated = self.opened.scene
        has_scene = request.scene is not None or (stated is not None and stated.cameras)
        self.scene = load_scene(request.scene, stated, request.bearings) if has_scene else self._named()
        self.notes = []
        self._known = False
        if in_world_time:
            self._apply_clocks()
        self._doa = None
        self.cameras = tuple(self._chosen())
        if not self.cameras:
            raise UsageError(
                f"no camera is left to track in; exclude fewer ({option('without')}), or give a scene with cameras",
                id="too-few-sensors",
            )
        self.sources, self.views = (), self.cameras
        self.tally = BoxStatistics.of(len(self.cameras))
        self.numbers = {}
        self.frames = self._frames()

    def _named(self) -> Scene:
        """Return a scene of cameras without poses, with the names in the rows of boxes.

        Raises:
            InputError: no row names a camera.
        """
        rows = self.opened.rows(Boxes) if self.opened.has(Boxes) else self.opened.rows(Views)
        names = sorted({name for part in rows for name in np.unique(part.sensor).tolist()})
        if not names:
            raise InputError(
                f"{self.request.bearings}: holds no boxes; give boxes of people (`occlog ingest` or `occlog detect`)",
                id="empty-input",
            )
        pose = np.zeros(3), np.eye(3), np.ones(2), np.zeros(2)
        return Scene(tuple(Camera(name, *pose, placed=False) for name in names))


def _by_array(rows: Bearings, index_of: Mapping[str, int]) -> Iterator[DirectionsOfArrival]:
    """Generate directions of arrival from rows, one item for each time and array.

    `index_of` is the index of each array by name; all rows of a time must be given together.
    """
    table = rows.sorted()
    starts = np.flatnonzero(np.append(True, (np.diff(table.t_ns) != 0) | (table.sensor[1:] != table.sensor[:-1])))
    for first, stop in pairwise([*starts.tolist(), len(table)] if len(table) else []):
        yield DirectionsOfArrival(
            t_ns=int(table.t_ns[first]),
            sensor=index_of[str(table.sensor[first])],
            bearing=table.bearing[first:stop],
            sigma=table.sigma[first:stop],
            row=np.arange(first, stop),
        )


def _refuse_positions(path: Path) -> None:
    """Raise InputError if the file is a table of ground positions: columns x and y, but no boxes.

    Positions must be ingested into a recording first.
    """
    from occlog.io.external.source import find_source

    source = find_source(path)
    names = () if source is None else tuple(name.lower() for name in source.names)
    if {"x", "y"} <= set(names) and not {"left", "x1", "width"} & set(names):
        raise InputError(
            f"{path}: holds positions on the ground; make a recording of them by `occlog ingest --positions "
            f"{path.name}`, and track that",
            id="wrong-content",
        )


def _remedy(opened: Opened) -> str:
    """Return the remedy for an input without boxes, as the end of a message."""
    if opened.recording is not None and opened.recording.cameras:
        return "find people in its images with `occlog detect`, and give the views that it writes"
    return "give a recording with boxes of a detector, made by `occlog ingest`, or views of `occlog detect`"


def default_window(frame_detections: list[FrameDetectionsWithIds]) -> int:
    """Return the widest window [ns] for one time step: below half the shortest frame period of a camera.

    0 if no camera has two frames. The period is by frame numbers, from the first frames given.
    """
    times: dict[int, list[tuple[int, int]]] = {}
    for each in frame_detections:
        times.setdefault(each.detections.camera, []).append((each.detections.t_ns, each.frame))
    periods = []
    for frames in times.values():
        steps = [(b[0] - a[0]) / max(b[1] - a[1], 1) for a, b in pairwise(frames) if b[0] > a[0]]
        if steps:
            periods.append(float(np.median(steps)))
    return max((round(min(periods, default=0.0)) - 1) // 2, 0)
