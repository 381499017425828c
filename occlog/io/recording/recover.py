"""Makes a whole recording of what is whole in one that was cut off or damaged, with a list of what is lost."""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from occlog.errors import InputError
from occlog.io.files.atomic import open_output
from occlog.io.files.provenance import UNKNOWN, Provenance, hash_file, hash_inputs, provenance_from_json
from occlog.io.files.utc import utc
from occlog.records.losses import Loss

from .copy import moved_metadata
from .layout import MESSAGE_HEAD
from .metadata import add_metadata, damaged_metadata
from .reader import sensor_of
from .salvage import (
    FAILURES,
    Record,
    repeated_records,
    whole_records,
)
from .writer import FORMAT, SCENE_ATTACHMENT, VIDEO_FRAME, VIDEO_METADATA, begin_mcap
from .writer import METADATA as OURS


class Recovered(NamedTuple):
    """What a recovered recording holds.

    Attributes:
        messages: how many there are, by topic.
        span: times of the first and the last message [ns]; None: there is none.
        losses: what is lost of the recording, and what had been lost when it was made.
    """

    messages: dict[str, int]
    span: tuple[int, int] | None
    losses: tuple[Loss, ...]


def recover_recording(
    source: Path, path: Path, videos: Mapping[str, Path] | None = None, *, overwrite: bool = False
) -> Recovered:
    """Write `path`, whole or not at all, with every whole message of a damaged recording.

    Messages keep their order, times and numbers.  What was lost is in the provenance, from where all later stages
    carry it on.

    Args:
        source: a recording of occlog.
        path: the recording to write.
        videos: file of the video of a camera, where the link to it is lost.
        overwrite: replace a file that exists.

    Raises:
        InputError: `source` is no recording of occlog, nothing in it is whole, or the link to a video is lost.
    """
    videos = videos or {}
    with open_output(path, overwrite) as file:
        found = _Salvage(source, path, file)
        for record in repeated_records(source):
            found.define(record)
        for record in whole_records(source, found.damaged):
            found.take(record)
        return found.finish(videos)


class _Salvage:
    """The recording that is being written, and what is known of what is lost."""

    def __init__(self, source: Path, path: Path, file: IO[bytes]) -> None:
        self._source, self._path = source, path
        self._writer = begin_mcap(file)
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._written: dict[int, int] = {}  # channel of the new recording by that of the old one
        self._written_schemas: dict[int, int] = {0: 0}
        self._counts: dict[int, int] | None = None  # messages by channel, as the index has it
        self._metadata: dict[str, dict[str, str]] = {}
        self._attached: set[str] = set()
        self._losses: dict[Loss, None] = {}
        self._messages: dict[int, int] = {}
        self._last: dict[int, tuple[int, int]] = {}  # number and time of a channel's last message
        self._told: dict[int, int] = {}  # lost messages of a channel that are in the losses
        self._open: set[int] = set()  # channels without a message since the last damage
        self._span: tuple[int, int] | None = None

    def damaged(self, at: int, what: str) -> None:
        """Note damage at a byte of the file."""
        self._lose(f"byte {at}", what)
        self._open = set(self._last)

    def define(self, record: Record) -> None:
        """Take what the index says of schemas, channels and numbers of messages."""
        with suppress(*FAILURES):
            if record.code == Opcode.STATISTICS:
                statistics = records.Statistics.read(_stream(record))
                self._counts = {int(k): int(n) for k, n in statistics.channel_message_counts.items()}
            else:
                self.take(record)

    def take(self, record: Record) -> None:
        """Write a message or an attachment, or keep what others need."""
        try:
            if record.code == Opcode.SCHEMA:
                schema = records.Schema.read(_stream(record))
                self._schemas.setdefault(schema.id, schema)
            elif record.code == Opcode.CHANNEL:
                channel = records.Channel.read(_stream(record))
                self._channels.setdefault(channel.id, channel)
            elif record.code == Opcode.ATTACHMENT:
                self._attach(record)
            elif record.code == Opcode.METADATA:
                metadata = records.Metadata.read(_stream(record))
                self._metadata[metadata.name] = dict(metadata.metadata)
            elif record.code == Opcode.MESSAGE:
                self._message(record)
        except FAILURES as error:
            self._lose(f"byte {record.at}", f"a damaged record is left out ({' '.join(str(error).split())[:80]})")

    def finish(self, videos: Mapping[str, Path]) -> Recovered:
        """Complete the file; InputError where it is none of ours, or nothing is whole."""
        for name in damaged_metadata(self._metadata):
            self._metadata.pop(name, None)
            self._lose(name, "metadata with a wrong digest are left out")
        names = {schema.name for schema in self._schemas.values()}
        ours = OURS in self._metadata or SCENE_ATTACHMENT in self._attached
        if not ours and not any(name.startswith("occlog.") for name in names):
            raise InputError(
                f"{self._source}: not a recording of occlog, as far as it is whole; of a bag of another program "
                "`occlog ingest` takes what is whole, and lists the rest"
            )
        if not self._messages and not self._attached:
            raise InputError(f"{self._source}: nothing is whole before the damage; there is nothing to salvage")
        if SCENE_ATTACHMENT not in self._attached:
            self._lose(SCENE_ATTACHMENT, "the scene is lost; give later stages --scene")
        self._count_missing()
        before = self._provenance_before()
        losses = (*before.losses, *self._losses)
        given = {f"video of {camera}": str(video.name) for camera, video in sorted(videos.items())}
        provenance = Provenance("recover", given, inputs=hash_inputs([self._source, *videos.values()]), losses=losses)
        own = {"format": FORMAT, "provenance": provenance.json()}
        add_metadata(self._writer, {**self._links(videos), OURS: own})
        self._writer.finish()
        messages = {self._channels[k].topic: n for k, n in sorted(self._messages.items())}
        return Recovered(messages, self._span, losses)

    def _message(self, record: Record) -> None:
        channel_id, number, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(record.data)
        if channel_id not in self._channels:
            self._lose(f"channel {channel_id}", "its messages are left out: what they are is lost")
            return
        if channel_id not in self._written:
            self._register(channel_id)
        self._writer.add_message(
            self._written[channel_id], log_ns, record.data[MESSAGE_HEAD.size :], publish_ns, number
        )
        if channel_id in self._open:
            # Numbers of a topic rise by one from message to message
            before, time_ns = self._last[channel_id]
            if number > before + 1:
                self._missing(channel_id, f"{utc(time_ns)} to {utc(log_ns)}", number - before - 1)
            self._open.discard(channel_id)
        self._last[channel_id] = number, log_ns
        self._messages[channel_id] = self._messages.get(channel_id, 0) + 1
        low, high = self._span or (log_ns, log_ns)
        self._span = min(low, log_ns), max(high, log_ns)

    def _register(self, channel_id: int) -> None:
        channel = self._channels[channel_id]
        schema = self._schemas.get(channel.schema_id)
        if channel.schema_id not in self._written_schemas:
            if schema is None:
                raise ValueError(f"the schema of {channel.topic} is lost")
            self._written_schemas[schema.id] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        self._written[channel_id] = self._writer.register_channel(
            channel.topic, channel.message_encoding, self._written_schemas[channel.schema_id], dict(channel.metadata)
        )

    def _attach(self, record: Record) -> None:
        (crc,) = struct.unpack("<I", record.data[-4:])
        if crc and zlib.crc32(record.data[:-4]) != crc:
            self._lose(f"byte {record.at}", "an attached file with a wrong check sum is left out")
            return
        a = records.Attachment.read(_stream(record))
        self._writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
        self._attached.add(a.name)

    def _count_missing(self) -> None:
        """List messages that the index counts and that are neither found nor listed; without it, where each topic ends.

        A topic without a message since the last damage may have had more.
        """
        for channel_id in sorted(self._open if self._counts is None else ()):
            topic = self._channels[channel_id].topic
            place = f"after {utc(self._last[channel_id][1])}"
            self._losses[Loss(_source_of(topic), place, f"messages of {topic}, if there were more")] = None
        for channel_id, count in sorted((self._counts or {}).items()):
            missing = count - self._messages.get(channel_id, 0) - self._told.get(channel_id, 0)
            if missing > 0 and channel_id in self._channels:
                last = self._last.get(channel_id)
                place = "all of it" if last is None else f"from {utc(last[1])} on"
                self._missing(channel_id, place, missing)

    def _provenance_before(self) -> Provenance:
        """How the recording was made, with what was lost then; a loss where that itself is lost."""
        before = UNKNOWN
        with suppress(InputError):
            before = provenance_from_json(self._metadata.get(OURS, {}).get("provenance", ""), self._source)
        if before.command == "unknown":
            self._lose("its end", "how it was made, and what was lost then, is not known any more")
        return before

    def _links(self, videos: Mapping[str, Path]) -> dict[str, dict[str, str]]:
        """Links to videos, as they hold from the new recording."""
        links = {
            name: moved_metadata(name, values, self._source, self._path, Provenance("recover"))
            for name, values in self._metadata.items()
            if name.startswith(VIDEO_METADATA)
        }
        for camera, video in sorted(videos.items()):
            place = Path(os.path.relpath(video.resolve(), self._path.resolve().parent)).as_posix()
            links[VIDEO_METADATA + camera] = {"path": place, "sha256": hash_file(video)}
        for channel_id in self._written:
            channel = self._channels[channel_id]
            camera = sensor_of(channel.topic)
            if self._schemas[channel.schema_id].name == VIDEO_FRAME and VIDEO_METADATA + camera not in links:
                raise InputError(
                    f"{self._source}: camera {camera}: the link to its video is lost; say which file it is: "
                    f"--video {camera}=FILE"
                )
        return links

    def _missing(self, channel_id: int, place: str, count: int) -> None:
        topic = self._channels[channel_id].topic
        self._losses[Loss(_source_of(topic), place, f"messages of {topic} in what is damaged", count)] = None
        self._told[channel_id] = self._told.get(channel_id, 0) + count

    def _lose(self, place: str, what: str) -> None:
        self._losses[Loss(self._source.name, place, what)] = None


def _source_of(topic: str) -> str:
    """What losses call a topic: the camera, or the topic of a table."""
    return sensor_of(topic) if topic.startswith("/camera/") else topic


def _stream(record: Record) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(record.data))
