"""Bags in an ingest: selected topics, cameras with poses from the bag, and reading of the messages."""

from __future__ import annotations

import heapq
import math
import re
import tempfile
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

from occlog.array_types import Floats
from occlog.consistency.clock_offsets import ReceivedTimes, cause_of, drift_finding
from occlog.console.text import counted
from occlog.errors import InputError, OcclogError, UsageError, abridged, option
from occlog.io.files.timing.frame_times import FrameTimes, to_world_time
from occlog.io.files.timing.utc import utc
from occlog.io.formats.calibration.common import CalibrationOptions, CameraParameters, build_camera
from occlog.io.formats.calibration.readers.ros import region_of, region_text
from occlog.io.frames.camera_source import CameraSource, video_source
from occlog.io.frames.decoders.process import Delivered
from occlog.io.messages.bag import CLOCKS_APART_S, Bag, BagDecoder, BagSurvey, borrowed_lines, survey, topic_lines
from occlog.io.messages.contents import (
    FramePose,
    Intrinsics,
    MessageBoxRows,
    Transforms,
    direction_rows,
    intrinsics,
    stored,
    truth_rows,
)
from occlog.io.messages.kinds import (
    BoxMessage,
    DirectionMessage,
    ImageMessage,
    InfoMessage,
    MessageStamp,
    PoseMessage,
    kind_of,
)
from occlog.io.messages.mcap_file import BagMessage
from occlog.io.messages.topics import is_rectified, read_topic_map
from occlog.io.messages.video_stream import StreamFile, StreamOrderError, StreamReader, is_video
from occlog.io.recording.writer import RecordingWriter
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Clock, Scene
from occlog.records.tables import Boxes, Doa, Truth
from occlog.records.verdicts import Check, finding, outcome

from .box_extent import BoxExtents
from .boxes import beyond_lens, lens_losses, without
from .plan import IngestPlan
from .scene import Turn
from .truth import note_skipped, span_of

Note = Callable[[str], None]
COUNTS, STAMPS = "messages of the bag", "header stamps"
"""Names of checks."""
BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""(3, 3) body-from-optical: x forward, y left, z up from x right, y down, z forward (REP 103)."""
MAX_NAMES = 100
"""Frames by which the messages of a topic are counted."""
MIN_OF_FRAME = 3
"""Messages of a second frame in a topic from which they are of another sensor."""
OTHER_START_S = 1e8
"""Header stamps this much before the times of recording do not count from 1970."""
ALIKE = 0.1
"""Relative difference of drifts of clocks up to which they are one, of the clock that they are compared with."""
ROUNDED = 1e-6
"""Calibrations that differ by less than this are the same."""
STEEP = math.cos(math.radians(30))
"""An optical axis this near to straight up is that of a frame with z up, and not forward."""


def asked_topics(plan: IngestPlan) -> list[tuple[str, str]]:
    """(name, topic) pairs that the user gives by the options `topic` and in the YAML files `topics` of the plan.

    Raises:
        UsageError: a topic is given without a name.
    """
    out = [pair for path in plan.topics for pair in read_topic_map(path)]
    for name, topic in plan.topic:
        if name is None:
            raise UsageError(
                f"{option('topic')} {topic}: lacks the name of its camera, array or target; give NAME={topic}",
                id="camera-not-named",
            )
        out.append((name, topic))
    return out


def look_into(bag: Bag, plan: IngestPlan, note: Note) -> BagSurvey:
    """Survey a bag: select its topics by the user's choice and by message types, and note the selected ones.

    `note` is called with each line of text.

    Raises:
        InputError: no topic has images, boxes, true positions or directions that can be used.
    """
    found = survey(bag, asked_topics(plan))
    chosen = found.map
    if not (chosen.cameras or chosen.poses or chosen.directions):
        held = ", ".join(f"{t.name} ({t.kind or 'no type'})" for t in found.topics.values()) or "no topic"
        named = any(kind_of(t.kind) is not None for t in found.topics.values())
        if found.topics and all(t.messages == 0 for t in found.topics.values()):
            raise InputError(
                f"{bag.paths[0]}: has no message ({held}); check that these were published, record again",
                id="empty-input",
            )
        remedy = f"select one: {option('topic')} NAME=TOPIC" if named else "none has a type that is known"
        if (why := next(iter(found.faults.values()), None)) is not None:
            raise InputError(f"{bag.paths[0]}: {why}")
        if bag.losses:
            raise InputError(
                f"{bag.paths[0]}: nothing of it can be used: {bag.losses[0]}; copy it again", id="damaged-file"
            )
        raise InputError(
            f"{bag.paths[0]}: holds no topic of images, boxes or directions that ingest can read: {held}; {remedy}",
            id="wrong-content",
        )
    for line in (*topic_lines(found), *borrowed_lines(found)):
        note(f"bag: {line}")
    return found


class BagCameraPoses(NamedTuple):
    """Cameras of a bag with known poses, and why others have none.

    Attributes:
        cameras: cameras with poses in the world frame.
        reasons: by name of each other camera, why the bag gives no pose.
        world: name of the world frame among the transforms of the bag; None: no camera is connected to one.
        findings: findings of checks of the calibrations.
    """

    cameras: tuple[Camera, ...]
    reasons: dict[str, str]
    world: str | None
    findings: tuple[Check, ...] = ()


def place_cameras(found: BagSurvey, plan: IngestPlan, others: Collection[str], note: Note) -> BagCameraPoses:
    """Cameras of a bag with poses from its camera_info messages and transforms, except those that other files place.

    The world frame is the one that the user names, else the topmost frame in the transform tree relative to which the
    cameras are static.

    Args:
        found: topics, calibrations and transforms of the bag.
        plan: options of the user.
        others: names of cameras with poses from other files.
        note: called with remarks for the user.

    Raises:
        UsageError: the world frame or the axes of a camera's frame are ambiguous, or the named world frame is missing.
    """
    reasons: dict[str, str] = {}
    known = {}
    for camera in found.map.cameras:
        if camera in others:
            note(f"camera {camera}: placed by the scene or calibration file, not by the bag")
            continue
        info = found.infos.get(camera)
        if info is None:
            owned = "images" if camera in found.map.images else f"boxes ({found.map.boxes[camera]})"
            reasons[camera] = f"the bag has no calibration (CameraInfo) next to its {owned}"
            continue
        model = intrinsics(info, rectified=_is_rectified(found, camera), where=f"topic {found.map.infos[camera]}")
        if model is None:
            reasons[camera] = f"{found.map.infos[camera]} states that it is not calibrated (fx is 0)"
            continue
        if model.size != info.size:
            _check_region(camera, found, model.size)
            note(region_text(camera, region_of(info.size, info.binning, info.roi, camera), info.size))
        if camera not in found.map.images and not _is_rectified(found, camera) and np.any(info.distortion):
            note(
                f"camera {camera}: boxes of {found.map.boxes[camera]} are taken to be in the raw image; where the "
                "detector had rectified ones, give a calibration without distortion"
            )
        known[camera] = model
    options = plan.calibration_options()
    world = _world(found, plan, [c for c in known if found.frames.get(c)])
    shared = _shared_frames(found)
    cameras = []
    for camera, model in known.items():
        frame = found.frames.get(camera, "")
        try:
            placed = _placed(found.transforms, frame, world)
            pose = _pose(camera, frame, placed, plan)
        except InputError as error:
            reasons[camera] = str(error)
            continue
        rotation = pose.rotation @ model.turn.T
        shift = model.shift if frame in shared else 0.0
        centre = pose.translation + rotation[:, 0] * shift
        cameras.append(_camera(camera, model, rotation, centre, f"topic {found.map.infos[camera]}", options))
    for reported in options.notes:
        note(f"calibration: {reported}")
    return BagCameraPoses(tuple(cameras), reasons, world, tuple(options.findings))


def _check_region(camera: str, found: BagSurvey, stated: tuple[int, int]) -> None:
    """InputError if images have the full sensor size although the calibration states binning or a region of interest.

    Args:
        camera: name.
        found: has the calibration, and the size of the images.
        stated: width and height [px] of images with this binning and region.
    """
    info, size = found.infos[camera], found.sizes.get(camera)
    if size is not None and size != stated and size == info.size:
        raise InputError(
            f"topic {found.map.infos[camera]}: states binning {info.binning} and roi {info.roi}, so images of "
            f"{stated[0]} x {stated[1]} px, but they have {size[0]} x {size[1]}; give a calibration file or a scene",
            id="image-size-mismatch",
        )


def _camera(
    name: str, model: Intrinsics, rotation: Floats, centre: Floats, where: str, options: CalibrationOptions
) -> Camera:
    """Create a camera of the scene from its intrinsics and pose; further options of the calibration are applied.

    Args:
        name: of the camera.
        model: intrinsics from camera_info.
        rotation: (3, 3) world-from-camera rotation.
        centre: (3,) position of the camera centre in the world [m].
        where: source of the calibration, for messages.
        options: what the user gives for calibrations; notes and findings are added to it.
    """
    pose = CameraParameters(
        name=name,
        focal_px=model.focal_px,
        principal_px=model.principal_px,
        rotation=rotation.T,
        centre=centre,
        image_size=model.size,
        lens=model.lens,
        binned_aspect=model.binned_aspect,
    )
    return build_camera(pose, where, options)


def _is_rectified(found: BagSurvey, camera: str) -> bool:
    """Whether a camera's images, or without images its boxes, are rectified, judged by the name of the topic."""
    boxes = found.map.boxes.get(camera, "")
    return is_rectified(found.map.images[camera]) if camera in found.map.images else "rect" in boxes


def _shared_frames(found: BagSurvey) -> set[str]:
    """Transform frames that several cameras of the bag state.

    So do stereo pairs in which the pose of the right camera is known only by its projection matrix P.
    """
    return {frame for frame, cameras in Counter(found.frames.values()).items() if cameras > 1}


def _world(found: BagSurvey, plan: IngestPlan, cameras: list[str]) -> str | None:
    """Name of the world frame in which to place `cameras` (names): the user's, or the root in which they are static.

    None if no transform of the bag involves their frames.

    Raises:
        UsageError: the bag lacks the frame that the user names, or the cameras are in unconnected trees of transforms.
    """
    tree = found.transforms
    if plan.world_frame is not None:
        frame = plan.world_frame.lstrip("/")
        if not tree.knows(frame):
            raise UsageError(
                f"{option('world_frame')} {frame!r}: the bag has no such frame; it has: {abridged(tree.frames)}",
                id="unknown-name",
            )
        return frame
    for camera in (c for c in cameras if found.frames[c] in tree.edges):
        for edge in (tree.edges[frame] for frame in tree.chain(found.frames[camera])[:-1]):
            if edge.conflict:
                raise InputError(
                    f"camera {camera}: {edge.conflict}, in /tf_static of the bag; stop one publisher, or give a "
                    f"calibration of the camera ({option('calibration')})",
                    id="invalid-calibration",
                )
    roots = {tree.still_root(found.frames[c]): c for c in cameras if tree.knows(found.frames[c])}
    if len(roots) > 1:
        text = ", ".join(f"{frame} (camera {camera})" for frame, camera in sorted(roots.items()))
        raise UsageError(
            f"camera frames of the bag have several root frames in its transforms (/tf): {text}; name the world "
            f"frame: {option('world_frame')} FRAME",
            id="ambiguous-input",
        )
    return next(iter(roots), None)


def _placed(tree: Transforms, frame: str, world: str | None) -> FramePose:
    if frame in tree.exchanged and frame not in tree.edges:
        raise InputError(
            f"frame {frame!r} is only a parent in the transforms of the bag (of {tree.exchanged[frame]!r}); if parent "
            "and child are exchanged, give a calibration file",
            id="missing-pose",
        )
    if world is None or not tree.knows(frame):
        raise InputError(
            f"the transforms of the bag (/tf, /tf_static) do not give the pose of the camera's frame {frame!r}",
            id="missing-pose",
        )
    return tree.placed(frame, world)


def _pose(camera: str, frame: str, placed: FramePose, plan: IngestPlan) -> FramePose:
    """World-from-camera pose with optical axes (x right, y down, z forward) of a camera's frame.

    A frame that the user states to have body axes (`camera_axes`; x forward, z up) is turned. `frame` is its name,
    `placed` its pose in the world.

    Raises:
        UsageError: the axes are not stated, the name lacks "optical", and z is within 30 degrees of straight up, as in
            a frame with body axes.
    """
    if plan.camera_axes == "body":
        return FramePose(placed.rotation @ BODY, placed.translation)
    if plan.camera_axes is None and "optical" not in frame.lower() and placed.rotation[2, 2] > STEEP:
        raise UsageError(
            f"camera {camera}: the z axis of its frame {frame!r} points up; give {option('camera_axes')} body "
            f"(x forward, z up), or {option('camera_axes')} optical (z forward)",
            id="missing-option",
        )
    return placed


@dataclass
class _CameraState:
    """Counts, first and last times of the messages of one topic so far, and why messages were skipped."""

    sized: tuple[int, int] | None = None
    last: int | None = None
    first: int | None = None
    number: int = 0
    back: int = 0
    first_back: str = ""
    back_ns: int = 0
    repeats: int = 0
    first_repeat: str = ""
    damaged: int = 0
    resized: int = 0
    reason: str = ""
    by_log: bool | None = None
    received: ReceivedTimes = field(default_factory=ReceivedTimes)
    taken: int = 0

    def skip(self, log_ns: int, t_ns: int) -> None:
        """Count a skipped message that is not later than the previous one of its topic.

        It is earlier, or repeats the time. `log_ns` is when it was recorded, `t_ns` its own time [ns].
        """
        back_ns = (self.last or 0) - t_ns
        where = f"the first after message {self.taken - 1}, recorded {utc(log_ns)}; these messages were skipped"
        if back_ns:
            self.first_back, self.back = self.first_back or where, self.back + 1
            self.back_ns = max(self.back_ns, back_ns)
        else:
            self.first_repeat, self.repeats = self.first_repeat or where, self.repeats + 1


class CollectedVideo:
    """Collects the messages of a compressed video stream in a file for the decoder.

    Counts those that cannot be decoded.

    Attributes:
        reason: why the first message that cannot be decoded cannot; empty: all can.
        numbers: message number, from 0, of each picture in the file.
        times: time of each picture in the file [ns].
        file: the file to which the pictures are written.
    """

    def __init__(self, path: Path, encoding: str, size: tuple[int, int]) -> None:
        """Create the file `path` for a stream with an encoding (`h264`, `h265`, ...) and image size (width, height)."""
        self.reason, self.numbers, self.times = "", list[int](), list[int]()
        self.file = StreamFile(path, encoding.lower(), size)
        self._reader = StreamReader(encoding)
        self._count = self._lost = 0
        self._whole = False  # from the last key frame on all messages are there

    def add(self, data: bytes, t_ns: int) -> None:
        """Append the next message, of time `t_ns` [ns], to the file; InputError if it is not a picture of the stream.

        Pictures before the first key frame, or that depend on a missing one, cannot be decoded: they are counted and
        omitted.
        """
        number, self._count = self._count, self._count + 1
        unit = self._reader.read(data)
        if unit.key:
            self._whole = True
        elif self._whole and not unit.follows:
            self._whole = False
            self.reason = self.reason or f"message {number} is built on a picture that is missing"
        if not self._whole:
            self.reason = self.reason or f"message {number} comes before the first key frame"
            self._lost += 1
            return
        self.file.add(data, key=unit.key)
        self.numbers.append(number)
        self.times.append(t_ns)

    def fail(self, reason: str) -> None:
        """Note that a message is unreadable, and why: later pictures up to the next key frame cannot be decoded."""
        self._whole, self.reason = False, self.reason or reason

    def end(self) -> int:
        """Close the file, and return the number of messages that were omitted."""
        self.file.close()
        return self._lost


def _decoding(stream: CollectedVideo, camera: str, plan: IngestPlan) -> CameraSource:
    """Source of the decoded pictures of a collected stream, with their times, for the frames that the plan selects.

    Args:
        stream: closed file with its message numbers and times.
        camera: name, for the selection of frames by message number.
        plan: has the selection and the storage of images.
    """
    times = np.array(stream.times, dtype=np.int64)
    first, stop = plan.frames.of(camera) or (0, None)
    start = bisect_left(stream.numbers, first)
    end = None if stop is None else bisect_left(stream.numbers, stop)
    return video_source(
        stream.file.path.name,
        stream.file.path,
        FrameTimes("messages", table_ns=times),
        start=start,
        stop=end,
        store=plan.store or "jpeg",
        quality=plan.jpeg_quality,
        keys=stream.file.keys,
    )


def _of_messages(loss: Loss, topic: str, numbers: Sequence[int]) -> Loss:
    """Copy of a decoder's loss with the topic as source, and message numbers in place of picture numbers.

    `numbers` has the message number of each picture of the stream.
    """
    return replace(
        loss,
        source=topic,
        place=re.sub(r"\d+", lambda match: str(numbers[min(int(match[0]), len(numbers) - 1)]), loss.place),
    )


def _pictures(topic: str, source: CameraSource) -> Iterator[tuple[int, str, Delivered]]:
    for t_ns, frame in source.frames():
        yield t_ns, topic, frame


class Taking:
    """Writes the messages of the selected topics of a bag to a recording, in one pass, and collects losses and checks.

    Compressed video streams are collected in temporary files, which `write_videos` decodes and `__exit__` deletes.
    """

    def __init__(
        self,
        bag: Bag,
        found: BagSurvey,
        plan: IngestPlan,
        scene: Scene,
        clocks: Mapping[str, Clock],
        placement: BagCameraPoses,
        turn: Turn | None,
    ) -> None:
        """Prepare for the selected topics.

        If frames are selected and there is truth, this reads the bag once for frame times.

        Args:
            bag: open bag.
            found: its selected topics.
            plan: options of the user.
            scene: scene of the recording.
            clocks: clock model by name of the sensor.
            placement: poses of the bag's cameras.
            turn: transform of positions to the levelled world; None: the world is upright.
        """
        self.bag, self.found, self.plan, self.scene = bag, found, plan, scene
        self.frames: dict[str, int] = {}
        self.rows: dict[str, int] = {}
        self.times: dict[str, str] = {}
        self._clocks, self._placement, self._turn = clocks, placement, turn
        self._messages = BagDecoder(found.topics)
        self._states: dict[str, _CameraState] = {}
        chosen = found.map
        self._cameras = {topic: name for name, topic in chosen.images.items()}
        self._arrays = {topic: name for name, topic in chosen.directions.items()}
        self._targets = {topic: target for target, topic in chosen.poses.items()}
        self._owners: dict[int, str] = {}
        self._frames: dict[str, Counter[str]] = {}  # frames of the messages of each topic of a sensor
        placed = {camera.name for camera in placement.cameras}
        self._infos = {topic: name for name, topic in chosen.infos.items() if name in placed}
        self._changed: dict[str, list[str]] = {}
        scale = plan.confidence_scale
        self._boxes = {t: MessageBoxRows(name, plan.classes, scale) for name, t in chosen.boxes.items()}
        frames = self._frame_times() if plan.frames and self._targets else {}
        ranges = {name: range(*own) for name in frames if (own := plan.frames.of(name)) is not None}
        self._span = span_of(ranges, frames)
        self._of_other_times = 0
        self._extents = BoxExtents({c.name: c.image_size for c in scene.cameras if c.image_size is not None})
        self._beyond_lens: Counter[str] = Counter()
        self._streams: dict[str, CollectedVideo] = {}
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._video_losses: list[Loss] = []

    @property
    def count(self) -> int | None:
        """Number of messages of the selected topics; None if the bag does not state it for one of them."""
        counts = [self.found.topics[t].messages for t in self._wanted()]
        return None if None in counts else sum(c or 0 for c in counts)

    def _wanted(self) -> set[str]:
        return {*self._cameras, *self._arrays, *self._targets, *self._boxes, *self._infos}

    def messages(self) -> Iterator[BagMessage]:
        """Iterate over the messages of the selected topics, in the order of the bag."""
        return self.bag.messages(self._wanted())

    def _frame_times(self) -> dict[str, FrameTimes]:
        """World times of the frames of each camera, by its name.

        They are read in a pass over the messages of images or, if the bag has no selected images, of boxes. Messages
        that are damaged or not later than the previous one are omitted.
        """
        topics = self._cameras or {topic: rows.camera for topic, rows in self._boxes.items()}
        states = {topic: _CameraState() for topic in topics}
        times: dict[str, list[int]] = {topic: [] for topic in topics}
        for message in self.bag.messages(set(topics)):
            state = states[message.topic]
            with suppress(InputError):  # damaged ones are reported when they are taken
                read = self._messages.read(message.topic, message.data)
                t_ns = self._time(state, message, read.header)
                if state.last is None or t_ns > state.last:
                    times[message.topic].append(t_ns)
                    state.last = t_ns
        tables = {topic: np.array(each, dtype=np.int64) for topic, each in times.items()}
        return {topics[topic]: FrameTimes(topic, table_ns=table) for topic, table in tables.items() if len(table)}

    def take(self, message: BagMessage, writer: RecordingWriter) -> None:
        """Write the content of a message to the recording.

        Damaged messages, and those that are not later than the previous one of their topic, are counted and skipped;
        pictures of a video stream are collected for `write_videos`; calibrations are compared with the first one of
        their camera.

        Raises:
            InputError: a message of boxes is damaged, or a video stream is not in the order of decoding.
            UsageError: two topics have true positions of the same target, or positions in an unconnected frame.
        """
        if message.topic in self._infos:
            self._compare(message)
            return
        state = self._states.setdefault(message.topic, _CameraState())
        try:
            read = self._messages.read(message.topic, message.data)
            t_ns = self._time(state, message, read.header)
            if not isinstance(read, PoseMessage):
                self._count_frame(message.topic, read.header.frame)
            if isinstance(read, ImageMessage) and is_video(read.encoding):
                self._video(message.topic, read, t_ns)
                return
            if state.last is not None and t_ns <= state.last:
                state.skip(message.log_ns, t_ns)
                return
            self._write(message.topic, read, t_ns, state, writer)
            state.last, state.taken = t_ns, state.taken + 1
        except UsageError:
            raise
        except StreamOrderError as error:
            raise InputError(f"topic {message.topic}: {error}") from None
        except OcclogError as error:
            if message.topic in self._streams:
                self._streams[message.topic].fail(str(error))
            if message.topic in self._boxes:
                raise InputError(f"topic {message.topic}: {error}") from error
            state.damaged += 1
            state.reason = state.reason or str(error)

    def _compare(self, message: BagMessage) -> None:
        """Note a calibration message that differs from the first one of its camera.

        The first is used for all images.
        """
        with suppress(InputError):  # the first one was good
            content = self._messages.read(message.topic, message.data)
            self._count_frame(message.topic, content.header.frame)
            first = self.found.infos[self._infos[message.topic]]
            if not _is_same(first, content):
                sizes = " x ".join(map(str, content.size))
                what = f"fx {first.k[0, 0]:g}, then {content.k[0, 0]:g} px for {sizes} px at {utc(message.log_ns)}"
                self._changed.setdefault(message.topic, []).append(what)

    def _count_frame(self, topic: str, frame: str) -> None:
        """Count a message of a sensor by the frame in its header; messages without one are not counted."""
        frames = self._frames.setdefault(topic, Counter())
        if frame and (frame in frames or len(frames) < MAX_NAMES):
            frames[frame] += 1

    def _time(self, state: _CameraState, message: BagMessage, header: MessageStamp) -> int:
        """World time [ns] of a message: its header stamp or its recording time, corrected by the clock of the sensor.

        The recording time is used if the plan says so, or if the first message of the topic has no stamp. Updates
        `state` with the first time, and with the difference of both times. InputError for a later message without
        stamp.
        """
        if state.by_log is None:
            state.by_log = self.plan.timestamp_source == "log" or header.stamp_ns == 0
        if not header.stamp_ns and not state.by_log:
            raise InputError("its header has no time", id="missing-times")
        if header.stamp_ns:
            state.received.add(header.stamp_ns, message.log_ns)
        t_ns = message.log_ns if state.by_log else header.stamp_ns
        state.first = t_ns if state.first is None else state.first
        clock = self._clocks.get(self._name(message.topic))
        return t_ns if clock is None else int(to_world_time(np.array([t_ns]), clock, state.first)[0])

    def _name(self, topic: str) -> str:
        box = self._boxes.get(topic)
        return self._cameras.get(topic) or self._arrays.get(topic) or (box.camera if box else "")

    def _write(
        self,
        topic: str,
        read: ImageMessage | PoseMessage | BoxMessage | DirectionMessage,
        t_ns: int,
        state: _CameraState,
        writer: RecordingWriter,
    ) -> None:
        if isinstance(read, ImageMessage):
            self._image(topic, read, t_ns, state, writer)
            return
        table: Truth | Boxes | Doa
        if isinstance(read, PoseMessage):
            frame = "" if read.on_earth else read.header.frame
            table = truth_rows(read, t_ns, self._targets[topic], self._frame_of_truth(frame))
            for target in table.target_id.tolist():
                if self._owners.setdefault(target, topic) != topic:
                    raise UsageError(
                        f"topics {self._owners[target]} and {topic} both have true positions of target {target}; "
                        f"number them apart: {option('topic')} NUMBER={topic}",
                        id="duplicate-name",
                    )
            if self._span is not None and not self._span[0] <= t_ns <= self._span[1]:
                self._of_other_times += len(table)
                return
            if self._turn is not None and not read.on_earth:
                table = self._turn.truth(table, self.bag.paths[0])
        elif isinstance(read, BoxMessage):
            number = self._boxes[topic].frames
            table = self._boxes[topic].rows(read, t_ns)
            if not self.plan.frames.takes(self._boxes[topic].camera, number):
                return
            self._extents.add(table)
            unseen = beyond_lens(table, self.scene)
            if unseen.any():
                self._beyond_lens.update(table.sensor[unseen].tolist())
                table = without(table, unseen)
        else:
            name = self._arrays[topic]
            table = direction_rows(read, t_ns, next(a for a in self.scene.arrays if a.name == name))
        writer.table(table)
        self.rows[table.NAME] = self.rows.get(table.NAME, 0) + len(table)

    def _image(self, topic: str, read: ImageMessage, t_ns: int, state: _CameraState, writer: RecordingWriter) -> None:
        camera, number = self._cameras[topic], state.number
        state.number += 1
        if not self.plan.frames.takes(camera, number):
            return
        image = stored(read, f"image {number} of {topic}", self.plan.store, self.plan.jpeg_quality)
        state.sized = state.sized or self.found.sizes[camera]
        if image.size != state.sized:
            state.resized += 1
            return
        writer.image(camera, t_ns, number, image.data, image.kind)
        self.frames[camera] = self.frames.get(camera, 0) + 1

    def _frame_of_truth(self, frame: str) -> FramePose:
        """World-from-frame pose of the transform frame `frame` of true positions.

        The identity if it is the world frame or empty, or if the bag has no world frame; UsageError if no transform
        connects it to the world.
        """
        tree, world = self.found.transforms, self._placement.world
        if world is None or frame in ("", world):
            return FramePose(np.eye(3), np.zeros(3))
        try:
            return tree.placed(frame, world)
        except InputError as error:
            raise UsageError(
                f"true positions of the bag cannot be converted to the world frame: {error}; give another "
                f"{option('world_frame')}, or a bag without their topic"
            ) from error

    def write_videos(self, writer: RecordingWriter) -> None:
        """Decode the collected video streams, and write the selected pictures of all cameras sorted by time.

        Raises:
            InputError: a stream has no picture that can be decoded.
        """
        with ExitStack() as stack:
            started = []
            for topic, stream in self._streams.items():
                self._states[topic].damaged += stream.end()
                if not stream.times:
                    raise InputError(
                        f"topic {topic}: no picture of its video can be decoded: "
                        f"{stream.reason or 'it has no key frame'}; record it again, from a key frame on",
                        id="damaged-file",
                    )
                source = _decoding(stream, self._cameras[topic], self.plan)
                stack.enter_context(source.decoder)
                started.append((topic, source))
            merged = heapq.merge(*(_pictures(topic, source) for topic, source in started), key=lambda item: item[:2])
            for t_ns, topic, frame in merged:
                stream, camera = self._streams[topic], self._cameras[topic]
                writer.image(camera, t_ns, stream.numbers[frame.index], bytes(frame.data), frame.kind)
                self.frames[camera] = self.frames.get(camera, 0) + 1
            for topic, source in started:
                numbers = self._streams[topic].numbers
                self._video_losses += [_of_messages(loss, topic, numbers) for loss in source.losses]

    def __enter__(self) -> Self:
        """Return self."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close and delete the temporary files of video streams."""
        for stream in self._streams.values():
            stream.file.close()
        if self._folder is not None:
            self._folder.cleanup()

    def _video(self, topic: str, read: ImageMessage, t_ns: int) -> None:
        """Append a message of a video stream, of time `t_ns` [ns], to the temporary file of its topic."""
        camera = self._cameras[topic]
        if topic not in self._streams:
            self._folder = self._folder or tempfile.TemporaryDirectory(prefix="occlog-video-")
            path = Path(self._folder.name) / f"{len(self._streams)}.mkv"
            self._streams[topic] = CollectedVideo(path, read.encoding, self.found.sizes[camera])
        self._streams[topic].add(read.data, t_ns)

    def finish(self, note: Note) -> list[Loss]:
        """Note messages that were out of order and true positions that were skipped; return all losses of the bag.

        Also sets `times`, which has by camera whether header stamps or recording times were used.
        """
        losses = lens_losses(self._beyond_lens, self.rows.get(Boxes.NAME, 0))
        if self._of_other_times and self.plan.frames:
            note_skipped(self._of_other_times, self._of_other_times + self.rows.get(Truth.NAME, 0), self.plan, note)
        for file in self.bag.files:
            for topic, (count, most) in getattr(file, "reordered", {}).items():
                if topic in self._states:
                    note(
                        f"warning: {topic}: {counted(count, 'message')} of {file.name} were up to {most / 1e9:.3g} s "
                        "out of order, and were sorted by their times of recording"
                    )
        for topic, state in self._states.items():
            name = self._name(topic)
            clock = "times of recording" if state.by_log else "header stamps"
            if topic in self._cameras:
                self.times[name] = f"{clock} of {topic}"
            reason = state.reason or (self._streams[topic].reason if topic in self._streams else "")
            first = f"; the first: {reason}" if reason else ""
            for count, what in (
                (state.back, f"time stamps go back, by up to {state.back_ns / 1e9:.3g} s, {state.first_back}"),
                (state.repeats, f"time stamps repeat, {state.first_repeat}"),
                (state.damaged, f"messages that cannot be used were skipped{first}"),
                (state.resized, f"images of another size than {state.sized} were skipped"),
            ):
                if count:
                    losses.append(Loss(self.bag.paths[0].name, topic, what, count))
        for topic, changes in self._changed.items():
            what = f"calibrations differ from the first one, which was taken for all images; the first: {changes[0]}"
            losses.append(Loss(self.bag.paths[0].name, topic, what, len(changes)))
        return [*self.bag.losses, *losses, *self._video_losses]

    def checks(self) -> tuple[Check, ...]:
        """Checks of message counts, header stamps and image sizes of boxes; available after the last message."""
        counts = (finding(COUNTS, "bag-count-differs", topic=t, remark=note) for t, note in self.bag.remarks.items())
        several = (
            finding(COUNTS, "topic-frames", topic=t, frames=abridged(f"{name!r} {n}" for name, n in each.most_common()))
            for t, each in self._frames.items()
            if sum(n >= MIN_OF_FRAME for n in each.values()) > 1
        )
        clocks = [check for topic, state in self._states.items() for check in self._topic_clocks(topic, state)]
        given = self.plan.image_size is not None
        extents = self._extents.checks(self._cameras.values(), given=given) if self._boxes else ()
        return (
            *outcome(COUNTS, [*counts, *several]),
            *outcome(STAMPS, _by_recorder(clocks, len(self._states))),
            *extents,
        )

    def _topic_clocks(self, topic: str, state: _CameraState) -> Iterator[Check]:
        """Yield findings on the clock of a topic.

        They are: no header stamps, or stamps that jump, drift or differ from the recording times. Findings about the
        recorder's own clock have the id `recorder-clock`.
        """
        if state.by_log and self.plan.timestamp_source != "log":
            yield finding(STAMPS, "stamps-missing", topic=topic)
        sensors = [self._name(topic) or topic]
        low, high = state.received.range_s
        step_s, before_ns, drift, by_recorder = state.received.change()
        if step_s and by_recorder:
            what = f"jump by {-step_s:.6g} s at {utc(before_ns)}"
            yield finding(STAMPS, "recorder-clock", what=what, size=-step_s)
        elif step_s and not state.by_log:
            time, cause = utc(before_ns), cause_of(step_s)
            yield finding(STAMPS, "clock-jump", "warning", sensors=sensors, jump_s=step_s, time=time, cause=cause)
        if drift and not state.by_log:
            yield drift_finding(STAMPS, sensors[0], drift, "the times of recording")
        if max(abs(low), abs(high)) > CLOCKS_APART_S and not (step_s and min(abs(low), abs(high)) < CLOCKS_APART_S):
            used = "times of recording" if state.by_log else "header stamps"
            kind, cause = "stamps-since-boot" if low > OTHER_START_S else "stamps-late", cause_of(low)
            yield finding(STAMPS, kind, sensors=sensors, topic=topic, low_s=low, high_s=high, used=used, cause=cause)


def _by_recorder(checks: Sequence[Check], topics: int) -> Iterator[Check]:
    """Merge findings on clocks of topics that have the recorder's clock as their common cause.

    If all topics drift from it by about the same rate, their findings are replaced by one on the recorder; of several
    findings on the recorder only the first is kept.

    Args:
        checks: findings of all topics.
        topics: number of topics.
    """
    drifts = [check for check in checks if check.id in ("clock-drift", "clock-rate-differs")]
    ppm = [check.figures["ppm"] for check in drifts]
    similar = topics > 1 and len(ppm) == topics and max(ppm) - min(ppm) < ALIKE * max(map(abs, ppm))
    if similar:
        size = -float(np.median(ppm))
        yield finding(STAMPS, "recorder-clock", what=f"gain {size:+.4g} ppm", size=size)
    others = [check for check in checks if not (similar and check in drifts)]
    first = next((check for check in others if check.id == "recorder-clock"), None)
    yield from (check for check in others if check.id != "recorder-clock" or check is first)


def _is_same(a: InfoMessage, b: InfoMessage) -> bool:
    """Whether two camera_info calibrations are equal up to a relative difference of `ROUNDED`."""
    if (a.size, a.model, a.binning, a.roi) != (b.size, b.model, b.binning, b.roi):
        return False
    if a.distortion.shape != b.distortion.shape:
        return False
    return all(np.allclose(getattr(a, name), getattr(b, name), rtol=ROUNDED) for name in ("distortion", "k", "r", "p"))


def check_truth_frames(found: BagSurvey, placement: BagCameraPoses, note: Note) -> None:
    """Note that true positions are used unchanged, if no transforms of the bag relate them to the scene.

    Args:
        found: topics of the bag; without true positions there is no note.
        placement: poses by the transforms of the bag, and their world frame.
        note: called with the text of the note.
    """
    if found.map.poses and placement.world is None:
        note("bag: no transforms give poses of the cameras: true positions are taken to be in the scene's world")


def check_plan(plan: IngestPlan, found: BagSurvey, scene: Scene, note: Note) -> None:
    """Check options against the cameras and arrays of a bag.

    Directions of an array that the scene lacks are an error if their topic was given explicitly; otherwise they are
    removed from `found`, with a note.

    Args:
        plan: options of the user.
        found: selected topics; changed in place.
        scene: has the arrays.
        note: called with remarks for the user.

    Raises:
        UsageError: the options link to videos, give times for sensors of the bag, or give a camera of the bag a second
            time.
    """
    arrays, asked = [a.name for a in scene.arrays], {topic for _, topic in asked_topics(plan)}
    for array, topic in list(found.map.directions.items()):
        if array not in arrays:
            known = ", ".join(arrays) or "no array"
            if topic in asked:
                raise UsageError(
                    f"{option('topic')} {topic}: the scene lacks its array {array!r} (it has: {known}); add it "
                    f"({option('scene')}, {option('arrays')}), or give ARRAY={topic} with an array of the scene",
                    id="unknown-sensor",
                )
            note(f"bag: skipped: {topic}: directions of array {array!r}, which is not in the scene ({known})")
            del found.map.directions[array]
    if plan.store == "link":
        raise UsageError(
            f"{option('store')} link: only videos can be linked to; give png or jpeg for a bag", id="not-applicable"
        )
    others = plan.video or plan.images or plan.boxes or plan.doa or plan.reads or plan.truth
    times = tuple((option(key), getattr(plan, key)) for key in ("start_time", "fps", "timestamps"))
    for key, pairs in times:
        if any(name is None for name, _ in pairs):
            if not others:
                raise UsageError(
                    f"a bag has its own times, and there is nothing else to ingest; omit {key}", id="not-applicable"
                )
            note(f"bag: has its own times; {key} is that of the other inputs")
    for name in (*found.map.cameras, *found.map.directions):
        for key, pairs in times:
            if any(camera == name for camera, _ in pairs):
                raise UsageError(
                    f"{name}: camera or array of the bag, which has its times; omit {key} {name}=...",
                    id="not-applicable",
                )
        if name in plan.video or name in plan.images:
            raise UsageError(
                f"camera {name}: is both in the bag and among the videos and images; give one of them another name",
                id="duplicate-name",
            )
