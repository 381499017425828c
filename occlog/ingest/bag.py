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
from occlog.consistency.clock_offsets import ReceivedTimes, cause_of
from occlog.console.text import counted
from occlog.errors import InputError, OcclogError, UsageError, option
from occlog.io.files.timing.frame_times import FrameTimes, to_world_time
from occlog.io.files.timing.utc import utc
from occlog.io.formats.calibration.common import CalibrationOptions, Pose, build_camera
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
OTHER_START_S = 1e8
"""Header stamps this much before the times of recording do not count from 1970."""
ALIKE = 0.1
"""Relative difference of drifts of clocks up to which they are one, of the clock that they are compared with."""
ROUNDED = 1e-6
"""Calibrations that differ by less than this are the same."""
STEEP = math.cos(math.radians(30))
"""An optical axis this near to straight up is that of a frame with z up, and not forward."""


def asked_topics(plan: IngestPlan) -> list[tuple[str, str]]:
    """(name, topic) pairs that the user gives, by options and in files; UsageError for a topic without a name."""
    out = [pair for path in plan.topics for pair in read_topic_map(path)]
    for name, topic in plan.topic:
        if name is None:
            raise UsageError(
                f"topic {topic}: does not state what it is called; give NAME={topic}", id="camera-not-named"
            )
        out.append((name, topic))
    return out


def look_into(bag: Bag, plan: IngestPlan, note: Note) -> BagSurvey:
    """Survey the content of the bag, and note the selected topics; InputError if no topic is usable."""
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
        remedy = f"name the others: {option('topic')} NAME=TOPIC" if named else "no topic has a known type"
        if (why := next(iter(found.faults.values()), None)) is not None:
            raise InputError(f"{bag.paths[0]}: {why}")
        if bag.losses:
            raise InputError(
                f"{bag.paths[0]}: nothing of it can be used: {bag.losses[0]}; copy it again", id="damaged-file"
            )
        raise InputError(
            f"{bag.paths[0]}: holds no images, boxes or directions that can be taken: {held}; {remedy}",
            id="wrong-content",
        )
    for line in (*topic_lines(found), *borrowed_lines(found)):
        note(f"bag: {line}")
    return found


class BagCameraPoses(NamedTuple):
    """Cameras of a bag with known poses, reasons for the others, the world frame, and findings."""

    cameras: tuple[Camera, ...]
    reasons: dict[str, str]
    world: str | None
    findings: tuple[Check, ...] = ()


def place_cameras(found: BagSurvey, plan: IngestPlan, others: Collection[str], note: Note) -> BagCameraPoses:
    """Cameras of a bag with poses from their calibrations and transforms, except those with poses from other files.

    The world frame is the one that the user gives, else the highest one in the transform tree in which no camera moves.

    Args:
        found: topics and calibrations of the bag.
        plan: options of the user.
        others: names of cameras with poses from other files.
        note: called with remarks for the user.
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
    """InputError if images have the full sensor size although the calibration states binning or a region.

    `stated` is the image size that follows from these.
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
    """Create the camera of a pose: `rotation` (3, 3) is world-from-camera, `centre` (3,) the position.

    `where` names the source in messages.
    """
    pose = Pose(
        name=name,
        focal_px=model.focal_px,
        principal_px=model.principal_px,
        rotation=rotation.T,
        centre=centre,
        image_size=model.size,
        lens=model.lens,
    )
    return build_camera(pose, where, options)


def _is_rectified(found: BagSurvey, camera: str) -> bool:
    """Whether a camera has rectified images, by the name of its image topic, or else of its box topic."""
    boxes = found.map.boxes.get(camera, "")
    return is_rectified(found.map.images[camera]) if camera in found.map.images else "rect" in boxes


def _shared_frames(found: BagSurvey) -> set[str]:
    """Frames shared by several cameras, as in stereo pairs with a right camera known by its matrix P only."""
    return {frame for frame, cameras in Counter(found.frames.values()).items() if cameras > 1}


def _world(found: BagSurvey, plan: IngestPlan, cameras: list[str]) -> str | None:
    """World frame in which to place `cameras` (names); None if the bag has no transforms of them.

    UsageError if the frame that the user gives is missing, or the cameras are in unconnected trees.
    """
    tree = found.transforms
    if plan.world_frame is not None:
        frame = plan.world_frame.lstrip("/")
        if not tree.knows(frame):
            raise UsageError(
                f"{option('world_frame')} {frame!r}: the bag has no such frame; it has: {', '.join(tree.frames)}",
                id="unknown-name",
            )
        return frame
    roots = {tree.still_root(found.frames[c]): c for c in cameras if tree.knows(found.frames[c])}
    if len(roots) > 1:
        text = ", ".join(f"{frame} (camera {camera})" for frame, camera in sorted(roots.items()))
        raise UsageError(
            f"the cameras of the bag are fixed in several frames: {text}; name the world frame: "
            f"{option('world_frame')} FRAME",
            id="ambiguous-input",
        )
    return next(iter(roots), None)


def _placed(tree: Transforms, frame: str, world: str | None) -> FramePose:
    if world is None or not tree.knows(frame):
        raise InputError(f"no transforms determine where its frame {frame!r} is", id="missing-pose")
    return tree.placed(frame, world)


def _pose(camera: str, frame: str, placed: FramePose, plan: IngestPlan) -> FramePose:
    """World-from-camera pose with optical axes (z forward); a frame stated to have body axes (`camera_axes`) is turned.

    UsageError if the axes are not stated, the name lacks "optical" and z points up, as in a frame with body axes.
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
    """Reading state of a camera's topic: counts and times of messages so far."""

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
        """Count a message with a time that is not after that of the previous one.

        `log_ns` is when it was recorded, `t_ns` its own time [ns].
        """
        back_ns = (self.last or 0) - t_ns
        where = f"the first after message {self.taken - 1}, recorded {utc(log_ns)}; these messages were skipped"
        if back_ns:
            self.first_back, self.back = self.first_back or where, self.back + 1
            self.back_ns = max(self.back_ns, back_ns)
        else:
            self.first_repeat, self.repeats = self.first_repeat or where, self.repeats + 1


class CollectedVideo:
    """Collects the messages of a compressed video stream in a file for the decoder; undecodable messages are counted.

    Attributes:
        reason: why the first of the undecodable messages cannot be decoded; empty: all can.
        numbers: number of the message of each picture that is decoded.
        times: of these [ns].
        file: they.
    """

    def __init__(self, path: Path, encoding: str, size: tuple[int, int]) -> None:
        """Create the file at `path`, without messages, for a stream with an encoding and a size (width, height)."""
        self.reason, self.numbers, self.times = "", list[int](), list[int]()
        self.file = StreamFile(path, encoding.lower(), size)
        self._reader = StreamReader(encoding)
        self._count = self._lost = 0
        self._whole = False  # from the last key frame on all messages are there

    def add(self, data: bytes, t_ns: int) -> None:
        """Add the next message, of time `t_ns` [ns]; InputError if it is not a picture of the stream.

        Pictures that cannot be decoded, before a key frame or after a missing one, are counted and left out.
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
        """Note an unreadable message, with the reason: pictures up to the next key frame depend on it."""
        self._whole, self.reason = False, self.reason or reason

    def end(self) -> int:
        """Close the file; return the number of messages left out because they cannot be decoded."""
        self.file.close()
        return self._lost


def _decoding(stream: CollectedVideo, camera: str, plan: IngestPlan) -> CameraSource:
    """Decoder of a collected stream, with message numbers and times, for the frames that the plan selects."""
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
    """Replace picture numbers in a loss of the decoder by message numbers; `numbers` has that of each picture."""
    return replace(
        loss,
        source=topic,
        place=re.sub(r"\d+", lambda match: str(numbers[min(int(match[0]), len(numbers) - 1)]), loss.place),
    )


def _pictures(topic: str, source: CameraSource) -> Iterator[tuple[int, str, Delivered]]:
    for t_ns, frame in source.frames():
        yield t_ns, topic, frame


class Taking:
    """Writes the messages of a bag to the recording, in one pass."""

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
        """Initialise from the selected topics.

        Args:
            bag: open bag.
            found: its selected topics.
            plan: options of the user.
            scene: scene of the recording.
            clocks: by name of the sensor.
            placement: poses of the bag's cameras.
            turn: transform to the levelled world; None: it is upright.
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
        """Expected number of messages; None if unknown."""
        counts = [self.found.topics[t].messages for t in self._wanted()]
        return None if None in counts else sum(c or 0 for c in counts)

    def _wanted(self) -> set[str]:
        return {*self._cameras, *self._arrays, *self._targets, *self._boxes, *self._infos}

    def messages(self) -> Iterator[BagMessage]:
        """The messages of the topics to be written."""
        return self.bag.messages(self._wanted())

    def _frame_times(self) -> dict[str, FrameTimes]:
        """Frame times of every camera (images, or messages of a detector), by a pass over the bag."""
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
        """Write the content of a message; damaged or out-of-order messages are counted."""
        if message.topic in self._infos:
            self._compare(message)
            return
        state = self._states.setdefault(message.topic, _CameraState())
        try:
            read = self._messages.read(message.topic, message.data)
            t_ns = self._time(state, message, read.header)
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
                raise InputError(f"topic {message.topic}: {error}") from None
            state.damaged += 1
            state.reason = state.reason or str(error)

    def _compare(self, message: BagMessage) -> None:
        """Note a calibration message that differs from the first one of its camera, which is used for all images."""
        with suppress(InputError):  # the first one was good
            content = self._messages.read(message.topic, message.data)
            first = self.found.infos[self._infos[message.topic]]
            if not _is_same(first, content):
                sizes = " x ".join(map(str, content.size))
                what = f"fx {first.k[0, 0]:g}, then {content.k[0, 0]:g} px for {sizes} px at {utc(message.log_ns)}"
                self._changed.setdefault(message.topic, []).append(what)

    def _time(self, state: _CameraState, message: BagMessage, header: MessageStamp) -> int:
        """World time of a message, from its header stamp or its recording time."""
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
                        f"topics {self._owners[target]} and {topic}: both are of target {target}", id="duplicate-name"
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
        """Pose of the frame of true positions in the world; UsageError if no transform connects them."""
        tree, world = self.found.transforms, self._placement.world
        if world is None or frame in ("", world):
            return FramePose(np.eye(3), np.zeros(3))
        try:
            return tree.placed(frame, world)
        except InputError as error:
            raise UsageError(
                f"true positions: {error}; leave their topic out, or give another {option('world_frame')}"
            ) from None

    def write_videos(self, writer: RecordingWriter) -> None:
        """Decode the collected video streams, and write their pictures sorted by time."""
        with ExitStack() as stack:
            started = []
            for topic, stream in self._streams.items():
                self._states[topic].damaged += stream.end()
                if not stream.times:
                    raise InputError(
                        f"topic {topic}: {stream.reason or 'its video has no key frame'}", id="damaged-file"
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
        """Remove the files of video streams."""
        for stream in self._streams.values():
            stream.file.close()
        if self._folder is not None:
            self._folder.cleanup()

    def _video(self, topic: str, read: ImageMessage, t_ns: int) -> None:
        """Collect a message of a video stream, of time `t_ns` [ns], in a file of the topic."""
        camera = self._cameras[topic]
        if topic not in self._streams:
            self._folder = self._folder or tempfile.TemporaryDirectory(prefix="occlog-video-")
            path = Path(self._folder.name) / f"{len(self._streams)}.mkv"
            self._streams[topic] = CollectedVideo(path, read.encoding, self.found.sizes[camera])
        self._streams[topic].add(read.data, t_ns)

    def finish(self, note: Note) -> list[Loss]:
        """Report which clock was used, and return the losses."""
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
        """Checks of the messages, available after the last one."""
        counts = (finding(COUNTS, "bag-count-differs", topic=t, remark=note) for t, note in self.bag.remarks.items())
        clocks = [check for topic, state in self._states.items() for check in self._topic_clocks(topic, state)]
        given = self.plan.image_size is not None
        extents = self._extents.checks(self._cameras.values(), given=given) if self._boxes else ()
        return (*outcome(COUNTS, counts), *outcome(STAMPS, _by_recorder(clocks, len(self._states))), *extents)

    def _topic_clocks(self, topic: str, state: _CameraState) -> Iterator[Check]:
        """Report if header stamps and recording times of a topic differ, or if header stamps are missing."""
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
            yield finding(STAMPS, "clock-drift", sensors=sensors, ppm=1e6 * drift, other="the times of recording")
        if max(abs(low), abs(high)) > CLOCKS_APART_S and not (step_s and min(abs(low), abs(high)) < CLOCKS_APART_S):
            used = "times of recording" if state.by_log else "header stamps"
            kind, cause = "stamps-since-boot" if low > OTHER_START_S else "stamps-late", cause_of(low)
            yield finding(STAMPS, kind, sensors=sensors, topic=topic, low_s=low, high_s=high, used=used, cause=cause)


def _by_recorder(checks: Sequence[Check], topics: int) -> Iterator[Check]:
    """Findings of topics; a clock of the recorder is stated once, also if all topics drift from it alike."""
    drifts = [check for check in checks if check.id == "clock-drift"]
    ppm = [check.figures["ppm"] for check in drifts]
    similar = topics > 1 and len(ppm) == topics and max(ppm) - min(ppm) < ALIKE * max(map(abs, ppm))
    if similar:
        size = -float(np.median(ppm))
        yield finding(STAMPS, "recorder-clock", what=f"gain {size:+.4g} ppm", size=size)
    others = [check for check in checks if not (similar and check.id == "clock-drift")]
    first = next((check for check in others if check.id == "recorder-clock"), None)
    yield from (check for check in others if check.id != "recorder-clock" or check is first)


def _is_same(a: InfoMessage, b: InfoMessage) -> bool:
    """Whether two calibrations are equal up to rounding."""
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
    """Check options against the cameras and arrays of a bag; UsageError for options that it cannot use.

    Directions of an array missing from the scene are an error if their topic was given explicitly, else they are
    removed from `found`, with a note.
    """
    arrays, asked = [a.name for a in scene.arrays], {topic for _, topic in asked_topics(plan)}
    for array, topic in list(found.map.directions.items()):
        if array not in arrays:
            text = (
                f"{topic}: directions of array {array!r}, which is not in the scene ({', '.join(arrays) or 'no array'})"
            )
            if topic in asked:
                raise UsageError(
                    f"topic {text}; add it to the scene, or give ARRAY={topic} with an array of the scene",
                    id="unknown-sensor",
                )
            note(f"bag: not taken: {text}")
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
                raise UsageError(f"{name}: has its times from the bag; omit {key} {name}=...", id="not-applicable")
        if name in plan.video or name in plan.images:
            raise UsageError(
                f"camera {name}: is both in the bag and among the videos and images; give one of them another name",
                id="duplicate-name",
            )
