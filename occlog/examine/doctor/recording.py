"""Checks of occlog recordings (chunks, messages, images, linked videos, scene, clocks), bags, videos and images.

Videos and images: frames that are declared but cannot be decoded, and irregular times.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from occlog.array_types import NS
from occlog.consistency.clock_offsets import ReceivedTimes, cause_of
from occlog.consistency.frozen import FrozenCameras
from occlog.errors import InputError, UsageError
from occlog.io.files.limits import check_input
from occlog.io.files.timing.utc import time_words, utc
from occlog.io.formats.models.fundamental_matrices import attached_epipolar
from occlog.io.frames.decoders.process import DecodingJob, start_decoder
from occlog.io.frames.decoders.subprocess_video import decode_apart
from occlog.io.messages.bag import CLOCKS_APART_S, Bag, BagDecoder, open_bag
from occlog.io.messages.kinds import TopicKind, kind_of
from occlog.io.messages.mcap_file import McapFile
from occlog.io.recording.chunks import MESSAGE_HEAD
from occlog.io.recording.mcap_errors import check_index, open_mcap
from occlog.io.recording.reader import (
    IMAGE_SCHEMA,
    ROWS_PER_CHUNK,
    McapRecording,
    check_recorded,
    open_linked,
    parse_image,
    sensor_of,
)
from occlog.io.recording.rows import RECORDED, RowCollector, schema_of
from occlog.io.recording.salvage.records import FAILURES, intact_records, repeated_records
from occlog.io.recording.writer import VIDEO_FRAME
from occlog.io.video.container import Container
from occlog.io.video.reader import read_container
from occlog.records.columns import ColumnTable
from occlog.records.tables import Truth, TruthBoxes

from .clock import SensorTimes, check_clocks, check_truth_times
from .findings import Findings
from .tables import TableWatch, drop_bad_rows, note_frozen, note_losses

TIMED = (TopicKind.IMAGE, TopicKind.BOX, TopicKind.POSE, TopicKind.DIRECTION)
"""Messages with times that ingest uses."""


def check_bag(path: Path, findings: Findings) -> None:
    """Add findings about a ROS bag: messages with times, indexes, clocks, and data that cannot be read."""
    try:
        with open_bag([path]) as bag:
            topics = bag.topics()
            stamps = {name: _Stamps(name) for name, topic in topics.items() if kind_of(topic.kind) in TIMED}
            for topic, stamp_ns, log_ns in _times(bag, set(stamps), findings):
                stamps[topic].add(stamp_ns, log_ns)
            _check_indexes(bag, findings)
            for loss in bag.losses:
                findings.add("damaged-bag", f"{loss.source}, {loss.place}", loss.what, count=max(loss.count, 1))
            for topic, remark in bag.remarks.items():
                findings.add("message-count-mismatch", topic, remark)
        for each in stamps.values():
            each.finish(findings)
        check_clocks([each.clock for each in stamps.values()], findings)
    except (InputError, UsageError) as error:
        findings.refused("unreadable", error)


def _check_indexes(bag: Bag, findings: Findings) -> None:
    """Add findings about undamaged MCAP files with an index that omits topics, which readers would miss."""
    for file in bag.files:
        if isinstance(file, McapFile) and not file.losses:
            try:
                check_index(file.path)
            except InputError as error:
                what = str(error).removeprefix(f"{file.path}: ").split(";")[0]
                findings.add("damaged-bag", file.name, what)


def _times(bag: Bag, wanted: set[str], findings: Findings) -> Iterator[tuple[str, int, int]]:
    """Generate topic, header stamp (0: none) and time of recording [ns] of each message of the topics `wanted`.

    Messages that cannot be decoded are findings.
    """
    messages, unread = BagDecoder(bag.topics()), set[str]()
    for message in bag.messages(wanted):
        if message.topic in unread:
            yield message.topic, 0, message.log_ns
            continue
        try:
            stamp = messages.read(message.topic, message.data).header.stamp_ns
        except UsageError as error:
            unread.add(message.topic)
            findings.add("undecoded", message.topic, str(error))
            stamp = 0
        except InputError as error:
            findings.refused("lost-message", error, location=message.topic)
            continue
        yield message.topic, stamp, message.log_ns


class _Stamps:
    """Accumulated times of one topic of a bag, and differences between time stamps and times of recording."""

    def __init__(self, topic: str) -> None:
        self.clock = SensorTimes(topic, unique=True, dropped=True)
        self._times: list[int] = []
        self._received = ReceivedTimes()

    def add(self, stamp_ns: int, log_ns: int) -> None:
        self._times.append(stamp_ns or log_ns)
        if stamp_ns:
            self._received.add(stamp_ns, log_ns)
        if len(self._times) >= 4096:
            self._flush()

    def finish(self, findings: Findings) -> None:
        self._flush()
        low, high = self._received.range_s
        step_s, before_ns, drift, by_recorder = self._received.change()
        if step_s:
            where = f"{self.clock.name}: after {utc(before_ns)}"
            value = f"of the times of recording by {-step_s:.6g} s" if by_recorder else f"by {step_s:.6g} s"
            findings.add("jump", where, f"{value}{cause_of(step_s)}")
        if drift:
            findings.add("drift", self.clock.name, f"{1e6 * drift:+.4g} ppm")
        if max(-low, high) > CLOCKS_APART_S and not (step_s and min(abs(low), abs(high)) < CLOCKS_APART_S):
            value = f"{low:.3g} to {high:.3g} s after them{cause_of(low)}"
            findings.add("two-clocks", self.clock.name, value, limit=f"{CLOCKS_APART_S:g} s")

    def _flush(self) -> None:
        self.clock.add(np.array(self._times, dtype=np.int64))
        self._times = []


UNEVEN = 0.1
"""Intervals that differ by more than this share from the usual one are uneven: some files round times to ms."""
UNEVEN_SHARE = 0.05
"""Share of uneven intervals from which a video is reported as uneven."""
MAX_IMAGE_BYTES = 512 * 1024 * 1024


def check_video(path: Path, findings: Findings) -> None:
    """Decode all frames of a video in a separate process; add findings about damage and uneven times."""
    try:
        container = read_container(path)
        with start_decoder(
            DecodingJob(kind="video", path=str(path), start=0, stop=None, store="none", quality=95)
        ) as d:
            for _ in d.delivered():
                pass
    except InputError as error:
        findings.refused("unreadable", error)
        return
    for loss in d.losses:
        findings.add("video-frames", loss.place, loss.what, count=max(loss.count, 1))
    if container is not None:
        _look_at_times(container, findings)


def _look_at_times(container: Container, findings: Findings) -> None:
    if container.pts_ns is None or len(container.pts_ns) < 3:
        return
    steps = np.diff(container.pts_ns).astype(np.float64)
    usual = float(np.median(steps))
    if usual <= 0:
        return
    uneven = int((np.abs(steps - usual) > UNEVEN * usual).sum())
    if uneven > UNEVEN_SHARE * len(steps):
        value = f"{uneven} of {len(steps)} intervals; {steps.min() / NS:.4g} to {steps.max() / NS:.4g} s"
        findings.add("variable-frame-rate", "", value, limit=f"{UNEVEN:.0%} from the usual {usual / NS:.4g} s")


def check_image_file(path: Path, findings: Findings) -> None:
    """Add a finding if an image is too large or cannot be decoded."""
    try:
        size = check_input(path, "an image").stat().st_size
        if size > MAX_IMAGE_BYTES:
            raise InputError(f"{path}: {size} bytes; the limit is {MAX_IMAGE_BYTES}", id="input-too-large")
        decode_apart(path.read_bytes(), str(path))
    except (InputError, OSError) as error:
        findings.refused("image", error)


TRUE: tuple[type[ColumnTable], ...] = (Truth, TruthBoxes)
TABLES = {schema_of(table): table for table in RECORDED}


class _Message(NamedTuple):
    """One message of an MCAP file.

    Attributes:
        topic: topic of its channel.
        schema: name of its schema; empty: none.
        encoding: encoding of its content.
        number: sequence number.
        log_ns: time at which it was logged [ns].
        data: content.
    """

    topic: str
    schema: str
    encoding: str
    number: int
    log_ns: int
    data: bytes


def check_recording(path: Path, recording: McapRecording | None, findings: Findings, seen: set[Path]) -> None:
    """Add findings about every message of an occlog recording: rows, frames, links to videos, clocks.

    Args:
        path: the recording.
        recording: the opened recording; None: it is damaged, and its intact part is checked.
        findings: list that is extended in place.
        seen: videos that have been checked; linked ones are added in place.
    """
    scan, fault = _RecordingScan(path, findings), None
    if recording is not None:
        note_losses(recording.losses, findings)
        if not recording.indexed:
            findings.add("no-index", "", "")
        try:
            attached_epipolar(recording)
        except InputError as error:
            findings.refused("unreadable", error)
        for camera in sorted(recording.videos):
            _look_at_link(recording, camera, findings, seen)
        try:
            check_index(path)
            for message in _in_order(path):
                scan.take(message)
        except InputError as error:
            # Read on without the index, which reports all damage
            recording, fault = None, error
            scan = _RecordingScan(path, findings)
    if recording is None:
        for message in _whole(path, findings):
            scan.take(message)
    if fault is not None and not findings.has("damaged-recording"):
        findings.refused("damaged-recording", InputError(str(fault).split(";")[0]))
    scan.finish()


def _in_order(path: Path) -> Iterator[_Message]:
    with open_mcap(path) as (reader, _):
        for schema, channel, message in reader.iter_messages():
            kind = "" if schema is None else schema.name
            yield _Message(
                channel.topic, kind, channel.message_encoding, message.sequence, message.log_time, message.data
            )


def _whole(path: Path, findings: Findings) -> Iterator[_Message]:
    """Generate the intact messages of a damaged recording in file order; add a finding for each damage."""
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, records.Channel] = {}

    def define(code: int, data: bytes) -> None:
        with suppress(*FAILURES):
            if code == Opcode.SCHEMA:
                schema = records.Schema.read(ReadDataStream(io.BytesIO(data)))
                schemas.setdefault(schema.id, schema)
            elif code == Opcode.CHANNEL:
                channel = records.Channel.read(ReadDataStream(io.BytesIO(data)))
                channels.setdefault(channel.id, channel)

    def damaged(at: int, what: str, *, messages: bool = True) -> None:  # noqa: ARG001
        findings.add("damaged-recording", f"byte {at}", what)

    try:
        for record in intact_records(path, damaged):
            if record.code == Opcode.HEADER:
                if record.at:
                    findings.add("damaged-recording", f"byte {record.at}", "another recording begins here")
                schemas.clear()
                channels.clear()
                for repeated in repeated_records(path, record.at):
                    define(repeated.code, repeated.data)
                continue
            if record.code != Opcode.MESSAGE:
                define(record.code, record.data)
                continue
            channel_id, number, log_ns, _ = MESSAGE_HEAD.unpack_from(record.data)
            channel = channels.get(channel_id)
            if channel is not None:
                schema = schemas.get(channel.schema_id)
                kind = "" if schema is None else str(schema.name)
                yield _Message(
                    channel.topic, kind, channel.message_encoding, number, log_ns, record.data[MESSAGE_HEAD.size :]
                )
    except InputError as error:
        if not findings.has("unreadable"):
            findings.refused("unreadable", error)


def _look_at_link(recording: McapRecording, camera: str, findings: Findings, seen: set[Path]) -> None:
    try:
        video = open_linked(recording.path, camera, recording.videos.get(camera))
    except InputError as error:
        findings.refused("linked-video", error)
        return
    if video.path.resolve() in seen:
        return
    seen.add(video.path.resolve())
    own = Findings(str(video.path))
    check_video(video.path, own)
    findings.join(own)


class _RecordingScan:
    """Checks of the messages of a recording, one after another: table rows, frames and clocks."""

    def __init__(self, path: Path, findings: Findings) -> None:
        self._path, self._findings = path, findings
        self._collectors: dict[type[ColumnTable], RowCollector[Any]] = {}
        self._watches: dict[type[ColumnTable], TableWatch] = {}
        self._clocks: dict[str, SensorTimes] = {}
        self._times: dict[str, list[tuple[int, int]]] = {}  # of frames, with their numbers
        self._frozen = FrozenCameras()

    def take(self, message: _Message) -> None:
        """Check one message, a row of a table or a frame; a fault becomes a finding."""
        table = TABLES.get(message.schema)
        try:
            if table is not None:
                self._rows(table, message)
            elif message.schema in (IMAGE_SCHEMA, VIDEO_FRAME):
                self._frame(message)
        except InputError as error:
            text = str(error).removeprefix(f"{self._path}: ")
            self._findings.refused("message", InputError(text), location=f"{message.topic}, message {message.number}")

    def finish(self) -> None:
        """Add the findings about clocks and frozen cameras after the last message."""
        for table in self._collectors:
            self._sift(table)
        for watch in self._watches.values():
            watch.finish()
        for sensor in self._times:
            self._tell_clock(sensor)
        note_frozen(self._frozen, self._findings)
        check_clocks(list(self._clocks.values()), self._findings)
        truth = [(f"/{t.NAME}, {c.name}", c) for t, watch in self._watches.items() if t in TRUE for c in watch.clocks]
        sensors = [c for table, watch in self._watches.items() if table not in TRUE for c in watch.clocks]
        check_truth_times(truth, [*self._clocks.values(), *sensors], self._findings)

    def _rows(self, table: type[ColumnTable], message: _Message) -> None:
        if table not in self._collectors:
            self._collectors[table] = RowCollector(table, str(self._path))
            self._watches[table] = TableWatch(table, self._findings)
        collector = self._collectors[table]
        collector.add(message.topic, message.data)
        if collector.rows >= ROWS_PER_CHUNK:
            self._sift(table)

    def _sift(self, table: type[ColumnTable]) -> None:
        values = self._collectors[table].columns()
        order = np.lexsort([values[name] for name in reversed(table.KEY)])
        rows = {name: column[order] for name, column in values.items()}
        drop_bad_rows(
            len(order),
            lambda start, stop: table(**{name: column[start:stop] for name, column in rows.items()}),
            self._watches[table],
            lambda row: f"/{table.NAME}, {time_words(rows['t_ns'][row])}",
        )

    def _frame(self, message: _Message) -> None:
        sensor, t_ns = sensor_of(message.topic), message.log_ns
        check_recorded(t_ns, self._path, message.topic, message.number)
        if message.schema == IMAGE_SCHEMA:
            where = f"camera {sensor}: frame {message.number}"
            stamp, image = parse_image(message.encoding, message.data, where)
            t_ns = stamp or t_ns
            self._frozen.add(sensor, t_ns, hash(image))
            try:
                decode_apart(image, where)
            except InputError as error:
                self._findings.refused("image", InputError(str(error).removeprefix(f"{where}: ")), location=where)
        times = self._times.setdefault(sensor, [])
        times.append((t_ns, message.number))
        if len(times) >= ROWS_PER_CHUNK:
            self._tell_clock(sensor)

    def _tell_clock(self, sensor: str) -> None:
        clock = self._clocks.setdefault(sensor, SensorTimes(f"camera {sensor}", unique=True))
        t_ns, number = np.array(self._times[sensor], dtype=np.int64).reshape(-1, 2).T
        clock.add(t_ns, number)
        self._times[sensor] = []
