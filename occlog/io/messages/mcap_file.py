"""One external MCAP file, read record by record; damaged records are losses.

The file may be truncated, e.g. by a power loss: records are read forwards, a chunk at a time, without the index; if
there is one, chunks without the requested topics are skipped. Zstd data in several frames are decompressed here, since
the library decompresses the first one only.
"""

from __future__ import annotations

import io
import struct
import zlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.summary import Summary

from occlog.errors import InputError
from occlog.io.files.limits import RECORDING_MAGIC as MAGIC
from occlog.io.files.limits import is_skipped_zstd
from occlog.io.recording.chunks import HEAD, MAX_CHUNK_BYTES, MESSAGE_HEAD, DecompressionCount, chunk_head, unpacked
from occlog.io.recording.mcap_errors import open_mcap
from occlog.io.recording.salvage.ends import END_BYTES, byte_after_end, is_end_mark
from occlog.records.losses import Loss

READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)
MAX_DEFINITION = 16 * 2**20
OUT_OF_ORDER_NS = 10**9
"""Messages of a topic in one chunk that are earlier than one before by more than this are of a clock that was set."""
_DAMAGE = (McapError, struct.error, ValueError, RuntimeError, EOFError, MemoryError, zstandard.ZstdError)
D = TypeVar("D", Schema, Channel)


class BagTopic(NamedTuple):
    """A topic of a bag file.

    Attributes:
        name: the topic.
        kind: type of its messages, such as `sensor_msgs/msg/Image`; empty: not stated.
        encoding: how they are encoded: cdr, ros1, protobuf, json, ...
        definition: definition of the type; empty: missing.
        language: of the definition: ros2msg, ros2idl, ros1msg, protobuf, jsonschema, ...; empty: missing.
        messages: how many there are; None: not known without reading the file.
    """

    name: str
    kind: str
    encoding: str
    definition: bytes
    language: str
    messages: int | None


class BagMessage(NamedTuple):
    """One message: its topic, time of recording [ns since the Unix epoch], and bytes."""

    topic: str
    log_ns: int
    data: bytes


class IndexedFile(ABC):
    """Base class of readers of bag files that are read record by record, with or without their index.

    Attributes:
        path: the file.
        name: its name in losses.
        losses: losses found so far, as keys; extended while the file is read.
    """

    def __init__(self, path: Path, name: str) -> None:
        """Begin with a file; `name` is its name in losses."""
        self.path, self.name = path, name
        self.losses: dict[Loss, None] = {}
        self._counts: dict[int, int] | None = None  # messages of each channel; None: not known
        self._span: tuple[int, int] | None = None

    def topics(self) -> list[BagTopic]:
        """Topics of the file, one for each channel, with their numbers of messages; without an index it is read."""
        if self._counts is None:
            counts = Counter[int]()
            for channel, log_ns, _ in self._walk(None):
                counts[channel] += 1
                low, high = self._span or (log_ns, log_ns)
                self._span = (min(low, log_ns), max(high, log_ns))
            self._counts = dict(counts)
        return [topic._replace(messages=self._counts.get(n, 0)) for n, topic in self._defined().items()]

    def span(self) -> tuple[int, int] | None:
        """First and last recording time of the messages [ns since the Unix epoch]; None without messages."""
        self.topics()
        return self._span

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yield the messages of the given topics in file order; of MCAP sorted by time within each chunk.

        A topic that is removed from the collection meanwhile is skipped from the next chunk on. At the end a topic of
        which the index counts more messages than were found is a loss, unless other damage is known.
        """
        found = Counter[int]()
        for channel, log_ns, data in self._walk(topics):
            found[channel] += 1
            yield BagMessage(self._topic_of(channel), log_ns, data)
        if self.losses:
            return
        for number, topic in self._defined().items():
            missing = (self._counts or {}).get(number, 0) - found[number]
            if topic.name in topics and missing > 0:
                self._lose(topic.name, "messages that its index counts were not found; the index is wrong", missing)

    def _lose(self, location: str, what: str, count: int = 0) -> None:
        self.losses[Loss(self.name, location, what, count)] = None

    @abstractmethod
    def _defined(self) -> dict[int, BagTopic]:
        """Topics by channel, as known so far, without numbers of messages."""

    @abstractmethod
    def _topic_of(self, channel: int) -> str:
        """Name of the topic of a channel."""

    @abstractmethod
    def _walk(self, topics: Collection[str] | None) -> Iterator[tuple[int, int, bytes]]:
        """Yield (channel, recording time [ns], data) of the messages of the given topics; None: of all.

        Damage is added to `losses`.
        """


class McapFile(IndexedFile):
    """Reader of an external MCAP file, also a damaged one.

    Attributes:
        path: the file.
        name: its name in losses.
        losses: losses found so far, as keys; extended while the file is read.
        reordered: by topic, number of messages after later ones that were sorted, and by how much at most [ns].
    """

    def __init__(self, path: Path, name: str) -> None:
        """Read the index if there is one; `name` is the file's name in losses.

        InputError if the file does not begin as MCAP does.
        """
        super().__init__(path, name)
        self.reordered: dict[str, tuple[int, int]] = {}  # of topics, messages before earlier ones, and by how much [ns]
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._repeated: list[Schema | Channel] = []  # definitions that a damaged index alone has
        self._contradicted = ""  # the definition that is of another file
        summary: Summary | None = None
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise InputError(
                    f"{path}: not an MCAP file (it does not begin with the MCAP mark)", id="unknown-format"
                )
        try:
            with open_mcap(path) as (_, found):
                summary = found
        except InputError as error:
            reason = str(error).removeprefix(f"{path}: ").split(";")[0]
            self._lose("end", f"{reason}; read without its index")
            self._scan_definitions()
            self._repeated = [*self._schemas.values(), *self._channels.values()]
        if summary is not None:
            if (known := summary.statistics) is not None:
                self._counts = dict(known.channel_message_counts)
                self._span = (known.message_start_time, known.message_end_time) if known.message_count else None
            self._schemas, self._channels = dict(summary.schemas), dict(summary.channels)
        self._chunks = {
            index.chunk_start_offset: set(index.message_index_offsets)
            for index in (summary.chunk_indexes if summary else ())
            if index.message_index_offsets
        }

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yield the messages of the given topics, sorted by time within each chunk unless a clock was set back.

        A topic that is removed from the collection meanwhile is skipped from the next chunk on.
        """
        for topic in topics:
            self.reordered.pop(topic, None)
        yield from super().messages(topics)

    def _defined(self) -> dict[int, BagTopic]:
        return {number: self._topic(channel) for number, channel in self._channels.items()}

    def _topic_of(self, channel: int) -> str:
        return str(self._channels[channel].topic)

    def _topic(self, channel: Channel) -> BagTopic:
        schema = self._schemas.get(channel.schema_id)
        kind, definition, language = (schema.name, schema.data, schema.encoding) if schema else ("", b"", "")
        return BagTopic(channel.topic, kind, channel.message_encoding, definition, language, None)

    def _walk(self, topics: Collection[str] | None) -> Iterator[tuple[int, int, bytes]]:
        size, self._contradicted, growth = self.path.stat().st_size, "", DecompressionCount(self.path)
        with self.path.open("rb") as file:
            at = len(MAGIC)
            while at < size:
                file.seek(at)
                head = file.read(HEAD.size)
                if len(head) < HEAD.size:
                    self._lose(f"byte {at}", "the file ends within a record")
                    return
                code, length = HEAD.unpack(head)
                if is_end_mark(code, length):
                    self._check_end(file, at, size)
                    return
                if at + HEAD.size + length > size:
                    missing = at + HEAD.size + length - size
                    self._lose(f"byte {at}", f"the file ends within a record, {missing} bytes before its end")
                    return
                if code in END_BYTES:
                    self._lose(f"byte {at}", f"a damaged record of {length} bytes was skipped (its kind is damaged)")
                elif code in READ and not self._skipped(code, at, topics):
                    yield from self._record(file, at, code, length, topics, growth)
                if self._contradicted:
                    self._lose(f"byte {at}", f"{self._contradicted}; {size - at} bytes from there on were not read")
                    return
                at += HEAD.size + length
            self._lose(f"byte {at}", "the file ends without its end mark")

    def _check_end(self, file: IO[bytes], at: int, size: int) -> None:
        """Add a loss for data behind the end of the data section that are not a valid index.

        Args:
            file: the open file.
            at: byte at which the data section ends.
            size: of the file [bytes].
        """
        behind = byte_after_end(file, at, size)
        if behind is None:
            self._lose(f"byte {at}", f"the index is damaged; {size - at} bytes from there on were not read")
        elif behind < size:
            left = f"{size - behind} bytes behind the end mark were not read; split the file there if they are a bag"
            self._lose(f"byte {behind}", left)

    def _scan_definitions(self) -> None:
        """Read all schemas and channels outside of chunks, for a file with a damaged index, which may repeat them."""
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            at = len(MAGIC)
            while at + HEAD.size <= size:
                file.seek(at)
                head = file.read(HEAD.size)
                if head.startswith(MAGIC):  # another file, with other meanings of its numbers
                    return
                code, length = HEAD.unpack(head)
                at += HEAD.size + length
                if code in (Opcode.SCHEMA, Opcode.CHANNEL) and at <= size and length <= MAX_DEFINITION:
                    with suppress(*_DAMAGE):
                        self._take(code, file.read(length), None, [])

    def _define(self, found: D, known: dict[int, D]) -> None:
        """Add a schema or channel to `known` (by number); note if it contradicts an earlier one.

        Definitions that only a damaged index has are dropped instead, since the index is then of another file.
        """
        if known.get(found.id, found) != found:
            if known[found.id] not in self._repeated:
                what = type(found).__name__.lower()
                self._contradicted = self._contradicted or f"{what} {found.id} is defined a second time, and otherwise"
                return
            # The index is of another file, and its content does not hold here
            for each in self._repeated:
                (self._schemas if isinstance(each, Schema) else self._channels).pop(each.id, None)
            self._repeated.clear()
        known[found.id] = found
        if found in self._repeated:
            self._repeated.remove(found)

    def _skipped(self, code: int, at: int, topics: Collection[str] | None) -> bool:
        """Whether the record at byte `at` is a chunk without messages of the given topics (None: all), by the index.

        `code` is the record's opcode. False if the index does not list it.
        """
        if code != Opcode.CHUNK or topics is None or at not in self._chunks:
            return False
        return not any(self._channels[c].topic in topics for c in self._chunks[at] if c in self._channels)

    def _record(
        self,
        file: IO[bytes],
        at: int,
        code: int,
        length: int,
        topics: Collection[str] | None,
        growth: DecompressionCount,
    ) -> Iterator[tuple[int, int, bytes]]:
        """Yield (channel, recording time [ns], data) of the messages in one record outside chunks, or in one chunk.

        A damaged record is a loss.

        Args:
            file: the open file, at the content of the record.
            at: first byte of the record.
            code: its opcode.
            length: of its content [bytes].
            topics: topics that are read; None: all.
            growth: counts decompressed bytes.
        """
        if length > MAX_CHUNK_BYTES:
            self._lose(f"byte {at}", f"a record of {length} bytes (limit {MAX_CHUNK_BYTES}) was skipped")
            return
        found: list[tuple[int, int, bytes]] = []
        try:
            data = file.read(length)
            if code == Opcode.CHUNK:
                self._unpack(data, topics, found, growth)
            else:
                self._take(code, data, topics, found)
        except _DAMAGE as error:
            reason = " ".join(str(error).split())[:100] or "data end early"
            what = "chunk" if code == Opcode.CHUNK else "record"
            self._lose(f"byte {at}", f"a damaged {what} of {length} bytes was skipped ({reason})")
            return
        yield from self._in_order(found)

    def _in_order(self, found: list[tuple[int, int, bytes]]) -> list[tuple[int, int, bytes]]:
        """Messages (channel, recording time [ns], data) of a chunk sorted by time.

        Messages of a topic that are up to `OUT_OF_ORDER_NS` too early are counted in `reordered`. If one is earlier
        than that, a clock was set back, and the order is unchanged.
        """
        last, back = dict[int, int](), dict[int, list[int]]()
        for channel, log_ns, _ in found:
            late = last.get(channel, log_ns) - log_ns
            if late > 0:
                back.setdefault(channel, []).append(late)
            last[channel] = max(log_ns, last.get(channel, log_ns))
        if any(max(each) > OUT_OF_ORDER_NS for each in back.values()):
            return found
        for channel, each in back.items():
            if channel in self._channels:
                topic = self._channels[channel].topic
                count, most = self.reordered.get(topic, (0, 0))
                self.reordered[topic] = (count + len(each), max(most, *each))
        return sorted(found, key=lambda message: message[1])

    def _unpack(
        self,
        data: bytes,
        topics: Collection[str] | None,
        found: list[tuple[int, int, bytes]],
        growth: DecompressionCount,
    ) -> None:
        """Append the messages of a chunk to `found`; ValueError for a wrong check sum or a damaged record.

        Args:
            data: content of the chunk record.
            topics: topics that are read; None: all.
            found: (channel, recording time [ns], data) of messages.
            growth: counts decompressed bytes.
        """
        head = chunk_head(data)
        records = unpacked(data[head.begin :], head.compression, head.declared)
        if head.crc and zlib.crc32(records) != head.crc:
            raise ValueError("wrong check sum")
        growth.add(len(data) - head.begin, records)
        at = 0
        while at < len(records):
            code, length = HEAD.unpack_from(records, at)
            at += HEAD.size
            if at + length > len(records):
                raise ValueError("a record is longer than its chunk")
            if code in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                self._take(code, records[at : at + length], topics, found)
            at += length

    def _take(
        self, code: int, data: bytes, topics: Collection[str] | None, found: list[tuple[int, int, bytes]]
    ) -> None:
        """Process a record: keep a schema or channel, or append a message of a requested topic to `found`.

        Args:
            code: opcode.
            data: content.
            topics: topics that are read; None: all.
            found: (channel, recording time [ns], data) of messages.
        """
        if code == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(io.BytesIO(data)))
            self._define(schema, self._schemas)
        elif code == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(io.BytesIO(data)))
            self._define(channel, self._channels)
        else:
            channel_id, _, log_ns, _ = MESSAGE_HEAD.unpack_from(data)
            if self._contradicted:
                return
            if channel_id not in self._channels:
                self._lose(f"channel {channel_id}", "its messages were skipped: the channel's definition is lost")
            elif topics is None or self._channels[channel_id].topic in topics:
                found.append((channel_id, log_ns, data[MESSAGE_HEAD.size :]))


_SKIPPED = struct.Struct("<II")
_HEAD = 18
"""Bytes of the head of a frame at most."""
_SUM = 4
_REPEATED = 1
"""Kind of a block that is one byte, repeated."""


def unpack_frames(data: bytes, most: int) -> bytes:
    """Decompress all zstd frames in `data`, one after another.

    ZstdError if damaged or larger than `most` bytes together.
    """
    parts, left = list[bytes](), most
    for frame in _frames(data):
        size = zstandard.frame_content_size(frame)  # -1: whoever packed it did not know
        if size > left or left == 0:
            raise zstandard.ZstdError(f"chunk would unpack to {most - left + max(size, 1)} bytes (limit {most})")
        parts.append(
            zstandard.ZstdDecompressor().decompress(frame, max_output_size=left, allow_extra_data=False)
            if size
            else b""
        )
        left -= len(parts[-1])
    return b"".join(parts)


def _frames(data: bytes) -> Iterator[bytes]:
    """Yield the zstd frames in `data`, still compressed; skippable ones (metadata) are omitted.

    ZstdError if a frame is cut off.
    """
    at = 0
    while at < len(data):
        begin = at
        try:
            if is_skipped_zstd(data[at : at + 4]):
                at += _SKIPPED.size + _SKIPPED.unpack_from(data, at)[1]
                continue
            head = data[at : at + _HEAD]
            at += zstandard.frame_header_size(head)
            last = 0
            while not last:
                block = int.from_bytes(struct.unpack_from("3s", data, at)[0], "little")
                last, kind, size = block & 1, block >> 1 & 3, block >> 3
                at += 3 + (1 if kind == _REPEATED else size)
            at += _SUM * zstandard.get_frame_parameters(head).has_checksum
        except struct.error:
            at = len(data) + 1
        if at > len(data):
            raise zstandard.ZstdError(f"the frame at byte {begin} is cut off")
        yield data[begin:at]
