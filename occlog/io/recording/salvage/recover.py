"""Salvage of the intact messages of a truncated or damaged recording into a new one, with a list of losses."""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from occlog.errors import InputError, option
from occlog.io.files.atomic import open_output
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.names import RECORDING, check_output_name
from occlog.io.files.provenance import UNKNOWN, Provenance, hash_file, provenance_from_json
from occlog.io.recording.chunks import MESSAGE_HEAD
from occlog.io.recording.copy import moved_metadata
from occlog.io.recording.metadata import add_metadata, damaged_metadata
from occlog.io.recording.reader import sensor_of
from occlog.io.recording.salvage.ends import SalvagedRecording
from occlog.io.recording.salvage.gaps import ChannelTally, Written
from occlog.io.recording.salvage.records import FAILURES, McapRecord, has_right_sum, intact_records, repeated_records
from occlog.io.recording.writer import FORMAT, SCENE_ATTACHMENT, VIDEO_FRAME, VIDEO_METADATA, begin_mcap
from occlog.io.recording.writer import METADATA as OURS
from occlog.records.losses import Loss


class Recovered(NamedTuple):
    """Content of a recovered recording.

    Attributes:
        messages: number of messages by topic.
        span: times of the first and the last message [ns since the Unix epoch]; None: there is none.
        losses: losses recorded before the damage, and those by it.
    """

    messages: dict[str, int]
    span: tuple[int, int] | None
    losses: tuple[Loss, ...]


def recover_recording(
    source: Path, path: Path, videos: Mapping[str, Path] | None = None, *, overwrite: bool = False
) -> Recovered:
    """Write every complete message of a damaged recording to `path`, atomically.

    Messages keep their order, times and numbers. Losses are stored in the provenance. If several recordings are
    concatenated in the file, those of one scene are merged, except for frames of linked videos: their numbers are valid
    in the videos of the first one only.

    Args:
        source: a recording of occlog.
        path: the recording to write.
        videos: file of the video of each camera to which the link is lost.
        overwrite: replace an existing file; else OutputExistsError.

    Raises:
        InputError: `source` is no recording of occlog, nothing in it is intact, or the link to a video is lost.
        UsageError: the name of `path` promises another format.
    """
    videos = videos or {}
    check_output_name(path, RECORDING)
    with open_output(path, overwrite) as file:
        found = _Salvage(source, path, file)
        for record in intact_records(source, found.damaged):
            found.take(record)
        return found.finish(videos)


class _Salvage:
    """State of a salvage: the recording being written, the part of the source being read, and the losses so far."""

    def __init__(self, source: Path, path: Path, file: IO[bytes]) -> None:
        self._source, self._path = source, path
        self._writer = begin_mcap(file)
        self._first = self._part = SalvagedRecording(0)
        self._written_schemas: dict[tuple[str, str, bytes], int] = {}
        self._written_channels: dict[tuple[str, str, int, str], int] = {}
        self._attached: dict[str, bytes] = {}  # digests
        self._losses: dict[Loss, None] = {}
        self._before: list[Loss] = []  # earlier losses when the recordings were made
        self._names: set[str] = set()  # of schemas
        self._messages: dict[str, int] = {}
        self._written = Written()
        self._span: tuple[int, int] | None = None

    def damaged(self, at: int, what: str, *, messages: bool = True) -> None:
        """Note damage at byte `at` as a loss; `messages`: messages may be missing there."""
        self._lose(f"byte {at}", what)
        if messages:
            self._part.damage.begin()

    def take(self, record: McapRecord) -> None:
        """Process a record: write a message or attachment, or keep a definition or metadata.

        A record that cannot be parsed is a loss.
        """
        part = self._part
        try:
            if record.code == Opcode.HEADER:
                self._begin(record.at)
            elif record.code == Opcode.SCHEMA:
                self._define(records.Schema.read(_stream(record)), record.at)
            elif record.code == Opcode.CHANNEL:
                self._define(records.Channel.read(_stream(record)), record.at)
            elif record.code == Opcode.ATTACHMENT:
                self._attach(record)
            elif record.code == Opcode.METADATA:
                metadata = records.Metadata.read(_stream(record))
                part.metadata[metadata.name] = dict(metadata.metadata)
            elif record.code == Opcode.MESSAGE_INDEX:
                index = records.MessageIndex.read(_stream(record))
                part.damage.index(index.channel_id, len(index.records))
            elif record.code == Opcode.MESSAGE:
                self._message(record)
        except FAILURES as error:
            self._lose(f"byte {record.at}", f"a damaged record is skipped ({' '.join(str(error).split())[:80]})")

    def _begin(self, at: int) -> None:
        """Begin the recording at byte `at` of the source: close the previous one, and read the indexed definitions."""
        if at:
            self._next(at)
        with suppress(*FAILURES):
            for record in repeated_records(self._source, at):
                if record.code != Opcode.STATISTICS:
                    self.take(record)
                    continue
                declared = records.Statistics.read(_stream(record)).channel_message_counts
                self._part.counts = {int(k): int(n) for k, n in declared.items()}

    def _define(self, found: records.Schema | records.Channel, at: int) -> None:
        if self._part.contradicts(found):  # another recording, with a beginning that is lost
            self._next(at)
        self._part.define(found)

    def _next(self, at: int) -> None:
        """Close the current recording, and go on with another one, which begins at byte `at` of the source."""
        self._close()
        before = self._part.latest() if self._belongs(self._part) else self._part.before
        self._part = SalvagedRecording(at)
        self._part.before = before

    def _close(self) -> None:
        """Add the losses of the current recording.

        These are damaged metadata, duplicates, lost messages, and the losses in its provenance.
        """
        part = self._part
        for name in damaged_metadata(part.metadata):
            part.metadata.pop(name, None)
            self._lose(name, "metadata with a wrong digest are skipped")
        for topic, copies in sorted(part.copies.items()):
            noun = "message that is stored" if copies == 1 else "messages that are stored"
            self._losses[Loss(_source_of(topic), "copies", f"{copies} {noun} in the file twice, and count once")] = None
        if part is not self._first:
            self._tell_of_other(part)
            if not self._belongs(part):
                return
        self._names |= {schema.name for schema in part.schemas.values()}
        for topic, location, count in part.lost():
            what = (
                f"messages of {topic}, if there were more" if count is None else f"messages of {topic} in damaged parts"
            )
            self._losses[Loss(_source_of(topic), location, what, count or 0)] = None
        self._before += self._provenance_before(part).losses

    def _tell_of_other(self, part: SalvagedRecording) -> None:
        """Add a loss for a recording that follows another one in the file, and for its messages that were omitted."""
        location = f"from byte {part.at} on"
        if not self._belongs(part):
            what = "messages of another recording, which has another scene or none, are skipped; split the file there"
            self._losses[Loss(self._source.name, location, what, part.left_out)] = None
            return
        self._lose(location, "another recording, of the same scene; its messages follow those of the first")
        if part.early:
            what = "messages of another recording that are not later than those before it are skipped; split the file"
            self._losses[Loss(self._source.name, location, f"{what} there", part.early)] = None
        if part.left_out:
            what = "frames of linked videos of another recording are skipped; split the file there"
            self._losses[Loss(self._source.name, location, what, part.left_out)] = None

    def _belongs(self, part: SalvagedRecording) -> bool:
        """Whether messages of a recording are merged with those of the first; it is the first or has its scene."""
        return part is self._first or (part.scene is not None and part.scene == self._first.scene)

    def finish(self, videos: Mapping[str, Path]) -> Recovered:
        """Write metadata with all losses, complete the file, and return what was recovered.

        Args:
            videos: file of the video of each camera to which the link is lost.

        Raises:
            InputError: the source is not an occlog recording, nothing is intact, or the link to a video is lost.
        """
        self._close()
        ours = OURS in self._first.metadata or SCENE_ATTACHMENT in self._attached
        if not ours and not any(name.startswith("occlog.") for name in self._names):
            raise InputError(
                f"{self._source}: no occlog recording in its intact part; of a bag of another program "
                "`occlog ingest` takes the intact messages, and lists the rest",
                id="damaged-file",
            )
        if not self._messages and not self._attached:
            raise InputError(
                f"{self._source}: nothing is whole before the damage; there is nothing to salvage", id="damaged-file"
            )
        if SCENE_ATTACHMENT not in self._attached:
            self._lose(SCENE_ATTACHMENT, "the scene is lost; give later stages --scene")
        losses = (*dict.fromkeys(self._before), *self._losses)
        given = {f"video of {camera}": str(video.name) for camera, video in sorted(videos.items())}
        provenance = Provenance("recover", given, inputs=hash_inputs([self._source, *videos.values()]), losses=losses)
        own = {"format": FORMAT, "provenance": provenance.json()}
        add_metadata(self._writer, {**self._links(videos), OURS: own})
        self._writer.finish()
        return Recovered(dict(sorted(self._messages.items())), self._span, losses)

    def _message(self, record: McapRecord) -> None:
        part = self._part
        channel_id, number, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(record.data)
        part.damage.end()
        if channel_id not in part.channels:
            self._lose(f"channel {channel_id}", "its messages are skipped: what they are is lost")
            return
        topic = part.channels[channel_id].topic
        tally = part.tallies.setdefault(channel_id, ChannelTally(channel_id, part.damage))
        if part is not self._first and not (self._belongs(part) and part.schema_of(channel_id) != VIDEO_FRAME):
            part.left_out += 1
            tally.add(number, log_ns)
            return
        if log_ns <= part.before.get(topic, -1):
            if self._written.holds(topic, log_ns, record.data):
                part.copies[topic] = part.copies.get(topic, 0) + 1
            else:
                part.early += 1
            tally.add(number, log_ns)
            return
        if part.is_copy(topic, number, log_ns, record.data):
            return
        if channel_id not in part.written:
            part.written[channel_id] = self._register(part, part.channels[channel_id])
        data: Any = memoryview(record.data)[MESSAGE_HEAD.size :]  # no copy of what may be large
        self._writer.add_message(part.written[channel_id], log_ns, data, publish_ns, number)
        tally.add(number, log_ns)
        self._written.add(topic, log_ns, record.data)
        self._messages[topic] = self._messages.get(topic, 0) + 1
        low, high = self._span or (log_ns, log_ns)
        self._span = min(low, log_ns), max(high, log_ns)

    def _register(self, part: SalvagedRecording, channel: records.Channel) -> int:
        """Number of the channel in the new recording with the same topic, schema and encoding; created if missing.

        ValueError if the schema of the channel is lost.
        """
        number = 0
        if channel.schema_id:
            schema = part.schemas.get(channel.schema_id)
            if schema is None:
                raise ValueError(f"the schema of {channel.topic} is lost")
            described = schema.name, schema.encoding, schema.data
            if described not in self._written_schemas:
                self._written_schemas[described] = self._writer.register_schema(*described)
            number = self._written_schemas[described]
        own = dict(channel.metadata)
        key = channel.topic, channel.message_encoding, number, json.dumps(own, sort_keys=True)
        if key not in self._written_channels:
            self._written_channels[key] = self._writer.register_channel(
                channel.topic, channel.message_encoding, number, own
            )
        return self._written_channels[key]

    def _attach(self, record: McapRecord) -> None:
        # What occlog writes has a check sum: 0, which means none, is damage
        if not has_right_sum(record.data) or not any(record.data[-4:]):
            self._lose(f"byte {record.at}", "an attached file with a wrong check sum is skipped")
            return
        a = records.Attachment.read(_stream(record))
        digest = hashlib.sha256(a.data).digest()
        if a.name == SCENE_ATTACHMENT:
            self._part.scene = digest
        if self._part is not self._first:
            same = self._attached.get(a.name) == digest
            if not same and a.name != SCENE_ATTACHMENT:  # of another scene all is skipped
                self._lose(f"byte {record.at}", f"{a.name}, attached to another recording, is skipped")
            return
        self._writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
        self._attached[a.name] = digest

    def _provenance_before(self, part: SalvagedRecording) -> Provenance:
        """Provenance of a recording in the source; unknown, with a loss, if it is damaged or missing."""
        before = UNKNOWN
        with suppress(InputError):
            before = provenance_from_json(part.metadata.get(OURS, {}).get("provenance", ""), self._source)
        if before.command == "unknown":
            location = "its end" if part is self._first else f"the end of what begins at byte {part.at}"
            self._lose(location, "how it was made, and the losses then, is not known any more")
        return before

    def _links(self, videos: Mapping[str, Path]) -> dict[str, dict[str, str]]:
        """Metadata records of links to videos, relative to the new recording's folder; `videos` replace or add links.

        InputError if a camera has frames of a linked video and no link.
        """
        links = {
            name: moved_metadata(name, values, self._source, self._path, Provenance("recover"))
            for name, values in self._first.metadata.items()
            if name.startswith(VIDEO_METADATA)
        }
        for camera, video in sorted(videos.items()):
            location = Path(os.path.relpath(video.resolve(), self._path.resolve().parent)).as_posix()
            links[VIDEO_METADATA + camera] = {"path": location, "sha256": hash_file(video)}
        for channel_id in self._first.written:
            camera = sensor_of(self._first.channels[channel_id].topic)
            if self._first.schema_of(channel_id) == VIDEO_FRAME and VIDEO_METADATA + camera not in links:
                raise InputError(
                    f"{self._source}: camera {camera}: the link to its video is lost; name its file: "
                    f"{option('video')} {camera}=FILE",
                    id="damaged-file",
                )
        return links

    def _lose(self, location: str, what: str) -> None:
        self._losses[Loss(self._source.name, location, what)] = None


def _source_of(topic: str) -> str:
    """Name of the source in losses of a topic: the camera, or the topic itself if it is of a table."""
    return sensor_of(topic) if topic.startswith("/camera/") else topic


def _stream(record: McapRecord) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(record.data))
