"""One ROS 1 bag (.bag, format 2.0), read record by record; damaged records are losses.

The library rosbags decodes the messages; its reader of files needs an index, which bags of a recorder that was killed
lack, and keeps an entry of every message in memory. Here records are read forwards, a chunk at a time; the index, if
there is one, is used to skip chunks without the requested topics.

Layout: https://wiki.ros.org/Bags/Format/2.0.  A record is a header of `name=value` fields and data, each after its
length; chunks hold records of messages and connections, packed or not.  There are no check sums.
"""

from __future__ import annotations

import bz2
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import lz4.frame

from occlog.array_types import NS
from occlog.errors import InputError
from occlog.io.files.limits import ROS1_MAGIC
from occlog.io.recording.chunks import MAX_CHUNK_BYTES, DecompressionCount

from .mcap_file import BagTopic, IndexedFile

ENCODING, LANGUAGE = "ros1", "ros1msg"
"""Names that MCAP gives messages and definitions of ROS 1, too."""
VERSION = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
"""Kinds of records."""
MAX_HEADER = 1 << 20
"""Bytes of the header of a record; a connection's, which has its definition, are its data."""
MAX_CONNECTIONS = 100_000
UNPACKERS: dict[bytes, Callable[[], Any]] = {b"bz2": bz2.BZ2Decompressor, b"lz4": lz4.frame.LZ4FrameDecompressor}
_LENGTH, _TIME, _U64 = struct.Struct("<I"), struct.Struct("<II"), struct.Struct("<Q")
_DAMAGE = (struct.error, ValueError, KeyError, OSError, RuntimeError, EOFError, MemoryError)


class _Record(NamedTuple):
    """Parsed header of a record in a ROS 1 bag.

    Attributes:
        fields: of the header, by name.
        begin: first byte of its data.
        length: of its data [bytes].
        open: it is a chunk that was not closed, and does not state its decompressed size.
    """

    fields: dict[bytes, bytes]
    begin: int
    length: int
    open: bool = False

    @property
    def kind(self) -> int:
        """Kind of the record, a number such as `CHUNK`; KeyError if missing."""
        return self.fields[b"op"][0]

    def number(self, name: bytes) -> int:
        """Value of the header field `name`, a 32-bit number; KeyError if missing."""
        return int(_LENGTH.unpack(self.fields[name])[0])


class Rosbag1File(IndexedFile):
    """Reader of a ROS 1 bag, also a damaged one.

    Attributes:
        path: the file.
        name: its name in losses.
        losses: losses found so far, as keys; extended while the file is read.
    """

    def __init__(self, path: Path, name: str) -> None:
        """Read the index if there is one; `name` is the file's name in losses.

        InputError for another version than 2.0, and for an encrypted bag.
        """
        super().__init__(path, name)
        self._topics: dict[int, BagTopic] = {}
        self._sums: dict[str, tuple[str, str]] = {}  # type and check sum of the definition of each topic
        self._chunks: dict[int, set[int]] = {}  # first byte of each chunk, and the connections in it
        self._size = path.stat().st_size
        with path.open("rb") as file:
            if (head := file.read(len(VERSION))) != VERSION:
                version = head.removeprefix(ROS1_MAGIC).decode("ascii", "replace").strip()
                raise InputError(
                    f"{path}: a bag of ROS 1 of version {version!r}; 2.0 is read; convert it: rosbag fix",
                    id="unsupported-format",
                )
            try:
                self._read_index(file)
            except _DAMAGE as error:
                self._topics.clear()
                self._sums.clear()
                self._chunks.clear()
                self._counts = None
                reason = " ".join(str(error).split())[:100] or "it ends early"
                self._lose("index", f"{reason}; read without its index")

    def _defined(self) -> dict[int, BagTopic]:
        return self._topics

    def _topic_of(self, channel: int) -> str:
        return self._topics[channel].name

    def _read_index(self, file: IO[bytes]) -> None:
        """Read connections, chunk positions and message counts from the index at the end of the file.

        Raises:
            InputError: the bag is encrypted.
            ValueError: the index is missing or damaged; also other errors of `_DAMAGE`.
        """
        header = self._record(file, len(VERSION))
        if header.kind != BAG_HEADER:
            raise ValueError("its first record is not that of a bag")
        if encryptor := header.fields.get(b"encryptor", b""):
            raise InputError(
                f"{self.path}: encrypted by {encryptor.decode('utf-8', 'replace')}; decrypt it: rosbag decrypt",
                id="unsupported-format",
            )
        (at,) = _U64.unpack(header.fields[b"index_pos"])
        if at == 0:
            raise ValueError("the recorder did not close the bag, and messages may be missing")
        if not at < self._size and header.number(b"conn_count"):
            raise ValueError(f"the index should begin at byte {at}, but the file has {self._size} bytes")
        for _ in range(header.number(b"conn_count")):
            record = self._record(file, at)
            self._connect(record, _data(file, record))
            at = record.begin + record.length
        counts = Counter[int]()
        for _ in range(header.number(b"chunk_count")):
            record = self._record(file, at)
            if record.kind != CHUNK_INFO:
                raise ValueError(
                    f"the record at byte {at} is of kind {record.kind}; one of a chunk (kind {CHUNK_INFO}) was expected"
                )
            data = _data(file, record)
            held = {int(connection): int(count) for connection, count in _TIME.iter_unpack(data)}
            counts.update(held)
            self._chunks[_U64.unpack(record.fields[b"chunk_pos"])[0]] = set(held)
            if held:
                low, high = (_time(record.fields[name]) for name in (b"start_time", b"end_time"))
                self._span = (min((self._span or (low, high))[0], low), max((self._span or (low, high))[1], high))
            at = record.begin + record.length
        self._counts = dict(counts)

    def _record(self, file: IO[bytes], at: int) -> _Record:
        """Parse the record header at byte `at`; ValueError if it is invalid."""
        file.seek(at)
        (length,) = _LENGTH.unpack(file.read(_LENGTH.size))
        if length > MAX_HEADER:
            raise ValueError(f"the record at byte {at} has a header of {length} bytes, limit {MAX_HEADER}")
        fields = _fields(file.read(length), length)
        (data,) = _LENGTH.unpack(file.read(_LENGTH.size))
        record = _Record(fields, at + 2 * _LENGTH.size + length, data)
        if not MESSAGE <= record.kind <= CONNECTION:
            raise ValueError(f"the record at byte {at} is of the unknown kind {record.kind}")
        return record

    def _walk(self, topics: Collection[str] | None) -> Iterator[tuple[int, int, bytes]]:
        growth, at = DecompressionCount(self.path), len(VERSION)
        with self.path.open("rb") as file:
            while at < self._size:
                try:
                    record = self._record(file, at)
                except _DAMAGE as error:
                    following = min((begin for begin in self._chunks if begin > at), default=self._size)
                    reason = " ".join(str(error).split())[:80]
                    self._lose(f"byte {at}", f"damaged: {following - at} bytes were not read ({reason})")
                    at = following
                    continue
                if record.kind == CHUNK and record.length == 0 and record.fields.get(b"compression") in UNPACKERS:
                    # The last chunk of a recorder that ended early has no length yet
                    record = record._replace(length=min(self._size - record.begin, MAX_CHUNK_BYTES), open=True)
                end = record.begin + record.length
                if end > self._size:
                    self._lose(f"byte {at}", f"the file ends within a record, {end - self._size} bytes before its end")
                if record.kind == CHUNK and self._is_wanted(at, topics):
                    yield from self._chunk(file, at, record, topics, growth)
                elif record.kind in (CONNECTION, MESSAGE) and end <= self._size:
                    # Of a recorder that ended early the last chunk has no length yet, and its records stand here
                    try:
                        found = self._take(record, _data(file, record), topics)
                    except _DAMAGE as error:
                        self._lose(f"byte {at}", f"a damaged record of {record.length} bytes was skipped ({error})")
                        found = None
                    if found is not None:
                        yield found
                at = end

    def _is_wanted(self, at: int, topics: Collection[str] | None) -> bool:
        """Whether the chunk at byte `at` may, by the index, hold a message of the given topics (None: all)."""
        if topics is None or at not in self._chunks:
            return True
        return any(n not in self._topics or self._topics[n].name in topics for n in self._chunks[at])

    def _chunk(
        self,
        file: IO[bytes],
        at: int,
        record: _Record,
        topics: Collection[str] | None,
        growth: DecompressionCount,
    ) -> Iterator[tuple[int, int, bytes]]:
        """Yield (connection, recording time [ns], data) of the messages in a chunk, up to its damage, which is a loss.

        Args:
            file: the open bag.
            at: first byte of the chunk.
            record: its header.
            topics: topics that are read; None: all.
            growth: counts decompressed bytes.
        """
        if record.length > MAX_CHUNK_BYTES:
            self._lose(f"byte {at}", f"a chunk of {record.length} bytes (limit {MAX_CHUNK_BYTES}) was skipped")
            return
        found: list[tuple[int, int, bytes]] = []
        inner = 0
        try:
            records = _unpacked(_data(file, record), record)
            growth.add_bytes(len(records))
            while inner < len(records):
                (length,) = _LENGTH.unpack_from(records, inner)
                begin = inner + _LENGTH.size
                fields = _fields(records[begin : begin + length], length)
                (size,) = _LENGTH.unpack_from(records, begin + length)
                one = _Record(fields, begin + length + _LENGTH.size, size)
                end = one.begin + size
                if end > len(records):
                    raise ValueError("a record is longer than its chunk")
                if one.kind in (CONNECTION, MESSAGE):
                    taken = self._take(one, records[one.begin : end], topics)
                    if taken is not None:
                        found.append(taken)
                inner = end
            if len(records) < record.number(b"size") and not record.open:
                raise ValueError(f"the chunk unpacks to {len(records)} bytes instead of {record.number(b'size')}")
        except _DAMAGE as error:
            reason = " ".join(str(error).split())[:100] or "data end early"
            self._lose(f"byte {at}", f"a damaged chunk was read up to its unpacked byte {inner} ({reason})")
        yield from found

    def _take(self, record: _Record, data: bytes, topics: Collection[str] | None) -> tuple[int, int, bytes] | None:
        """(connection, recording time [ns], data) of a message record of the given topics (None: all).

        None for other topics, and for a connection record, which is added.
        """
        if record.kind == CONNECTION:
            self._connect(record, data)
            return None
        number = record.number(b"conn")
        if number not in self._topics:
            self._lose(f"connection {number}", "its messages were skipped: the connection's definition is lost")
            return None
        if topics is not None and self._topics[number].name not in topics:
            return None
        return number, _time(record.fields[b"time"]), data

    def _connect(self, record: _Record, data: bytes) -> None:
        """Add a connection (a topic of one publisher) from its record and `data`, the fields of the connection.

        Raises:
            InputError: its message type contradicts that of an earlier connection of the topic.
            ValueError: the record is damaged.
        """
        if record.kind != CONNECTION:
            raise ValueError(f"a record is of kind {record.kind}; a connection (kind {CONNECTION}) was expected")
        number, name = record.number(b"conn"), record.fields[b"topic"].decode("utf-8", "replace")
        stated = _fields(data, len(data))
        kind, md5 = (stated[field].decode("ascii", "replace") for field in (b"type", b"md5sum"))
        old = self._sums.setdefault(name, (kind, md5))
        if old != (kind, md5):
            raise InputError(
                f"{self.path}: topic {name} holds {kind}, but {old[0]} before"
                f"{' of another definition' if old[0] == kind else ''}; write one of the two to its own bag: "
                "rosbag filter",
                id="incompatible-inputs",
            )
        if number not in self._topics:
            if len(self._topics) >= MAX_CONNECTIONS:
                raise ValueError(f"the bag has more connections than the limit, {MAX_CONNECTIONS}")
            self._topics[number] = BagTopic(name, kind, ENCODING, stated[b"message_definition"], LANGUAGE, None)
        elif self._topics[number].name != name:
            raise ValueError(f"connection {number} is of two topics, {self._topics[number].name} and {name}")


def _data(file: IO[bytes], record: _Record) -> bytes:
    """Data of a record, as far as the file has them; ValueError if they would exceed `MAX_CHUNK_BYTES`."""
    if record.length > MAX_CHUNK_BYTES:
        raise ValueError(f"a record of {record.length} bytes (limit {MAX_CHUNK_BYTES})")
    file.seek(record.begin)
    return file.read(record.length)


def _fields(data: bytes, length: int) -> dict[bytes, bytes]:
    """Parse the `name=value` fields of a record header that should have `length` bytes; ValueError if it is damaged."""
    if len(data) < length:
        raise ValueError("a header ends early")
    out, at = dict[bytes, bytes](), 0
    while at < length:
        (size,) = _LENGTH.unpack_from(data, at)
        begin, at = at + _LENGTH.size, at + _LENGTH.size + size
        name, mark, value = data[begin:at].partition(b"=")
        if at > length or not mark:
            raise ValueError("a header with a damaged field")
        out[name] = value
    return out


def _time(value: bytes) -> int:
    """Time [ns since the Unix epoch] from 8 bytes with seconds and nanoseconds."""
    seconds, rest = _TIME.unpack(value)
    return int(seconds) * NS + int(rest)


def _unpacked(data: bytes, record: _Record) -> bytes:
    """Decompressed records of a chunk, of a truncated one those before its end.

    `data` is the chunk's content, `record` its header. ValueError if it is larger than declared or allowed.
    """
    declared = MAX_CHUNK_BYTES if record.open else record.number(b"size")
    compression = record.fields[b"compression"]
    if declared > MAX_CHUNK_BYTES:
        raise ValueError(f"the chunk unpacks to {declared} bytes, limit {MAX_CHUNK_BYTES}")
    if compression == b"none":
        return data
    if compression not in UNPACKERS:
        raise ValueError(f"the chunk has the unknown compression {compression.decode('ascii', 'replace')!r}")
    out = bytes(UNPACKERS[compression]().decompress(data, declared + 1))
    if len(out) > declared:
        raise ValueError(f"the chunk unpacks to more than the {declared} bytes that it states")
    return out
