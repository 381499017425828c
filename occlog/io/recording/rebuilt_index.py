"""Rebuilding of a missing or incomplete index of an MCAP file, in one pass.

The format allows files without an index, or without parts of it: attachments and metadata that are not listed, messages
outside chunks. Read by its own index, such a file would seem to hold less. Messages are then read by the rebuilt index,
in the order of time or of the file.
"""

from __future__ import annotations

import heapq
import io
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import IO, NamedTuple, Protocol

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary

from occlog.errors import InputError
from occlog.io.files.limits import RECORDING_MAGIC

from .chunks import (
    CHUNK_HEAD,
    HEAD,
    INDEX_ENTRY,
    INDEX_HEAD,
    MAX_CHUNK_BYTES,
    MESSAGE_HEAD,
    DecompressionCount,
    check_chunk,
    chunk_head,
    damaged_mcap,
    unpacked,
)
from .salvage.ends import PRIVATE, byte_after_end, is_end_mark

_BLOCK = 1 << 20
DATA = frozenset(
    (
        Opcode.HEADER,
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.MESSAGE,
        Opcode.CHUNK,
        Opcode.MESSAGE_INDEX,
        Opcode.ATTACHMENT,
        Opcode.METADATA,
    )
)
"""Kinds of records before the end of the data."""


class UnchunkedMessages(NamedTuple):
    """Positions of the N messages outside of chunks, in file order.

    Attributes:
        at: (N,) byte at which each record begins.
        log_ns: (N,) when it was recorded [ns].
        channel: (N,) number of its channel.
    """

    at: array[int]
    log_ns: array[int]
    channel: array[int]


class RebuiltIndex(NamedTuple):
    """Index of an MCAP file made by a scan: the library's `Summary`, and the messages outside of chunks."""

    summary: Summary
    loose: UnchunkedMessages


def is_index_complete(file: IO[bytes], summary: Summary) -> bool:
    """Whether the index of an MCAP file lists all its messages, attachments and metadata.

    It must agree with its own statistics, and with the message indexes after chunks.
    """
    return _agrees_with_itself(summary) and _agrees_with_chunks(file, summary)


def _agrees_with_itself(summary: Summary) -> bool:
    if summary.statistics is None:
        return False
    statistics, channels = summary.statistics, summary.channels
    counted = {channel for channel, messages in statistics.channel_message_counts.items() if messages}
    return (
        statistics.chunk_count == len(summary.chunk_indexes)
        and statistics.attachment_count == len(summary.attachment_indexes)
        and statistics.metadata_count == len(summary.metadata_indexes)
        and statistics.message_count == sum(statistics.channel_message_counts.values())
        and counted <= channels.keys()
        and all(channel.schema_id in {0, *summary.schemas} for channel in channels.values())
        # Readers omit a chunk with none of their topics
        and all(index.message_index_offsets for index in summary.chunk_indexes)
        and (statistics.chunk_count > 0 or statistics.message_count == 0)
        # One record that is listed a thousand times would be read as often
        and all(
            len(set(groups)) == len(groups)
            for groups in (
                [each.chunk_start_offset for each in summary.chunk_indexes],
                [each.offset for each in summary.attachment_indexes],
                [each.offset for each in summary.metadata_indexes],
            )
        )
    )


def _agrees_with_chunks(file: IO[bytes], summary: Summary) -> bool:
    """Whether the message indexes after the chunks agree with the file's index in channels and numbers of messages.

    Otherwise readers would skip chunks that hold messages of requested topics.
    """
    counts, size = Counter[int](), file.seek(0, io.SEEK_END)
    left = size // (HEAD.size + INDEX_HEAD.size)  # chunks that share their index would be read as often
    for chunk in summary.chunk_indexes:
        at = chunk.chunk_start_offset + chunk.chunk_length
        while at < size:
            file.seek(at)
            head = file.read(HEAD.size + INDEX_HEAD.size)
            if len(head) < HEAD.size + INDEX_HEAD.size or head[0] != Opcode.MESSAGE_INDEX:
                break
            channel, length = INDEX_HEAD.unpack_from(head, HEAD.size)
            left -= 1
            if left < 0 or (length and channel not in chunk.message_index_offsets):
                return False
            counts[channel] += length // INDEX_ENTRY
            at += HEAD.size + HEAD.unpack_from(head)[1]
    declared = summary.statistics.channel_message_counts if summary.statistics else {}
    return +counts == +Counter(declared)


def rebuild_index(path: Path, file: IO[bytes]) -> RebuiltIndex:
    """Make the index of a complete MCAP file by a scan, in which sizes and check sums are verified.

    Args:
        path: its name, for messages.
        file: the file, opened.

    Raises:
        InputError: it is damaged, or its definitions contradict each other.
        struct.error, ValueError, ...: what damaged records raise; for use within `translate_mcap`.
    """
    return _Pass(path, file).done()


def check_index_statistics(path: Path, declared: Summary | None, made: Summary) -> None:
    """InputError unless a file has as many messages, attachments and metadata as its own index states.

    Args:
        path: file, for messages.
        declared: its index; None: it has none, and passes.
        made: the index rebuilt from its content.
    """
    if declared is None or declared.statistics is None:
        return
    for what in ("message", "attachment", "metadata"):
        stated, has = (getattr(each.statistics, f"{what}_count") for each in (declared, made))
        if stated != has:
            raise damaged_mcap(path, f"its index reports {stated} records of the kind {what}, and there are {has}")


class _Pass:
    """A scan of an MCAP file, record by record, that makes its index; damage is an InputError."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._path, self._file = path, file
        self._summary = Summary()
        self._counts = Counter[int]()
        self._span: tuple[int, int] | None = None
        self._at, self._log_ns, self._channel = array("Q"), array("Q"), array("H")
        self._crc = zlib.crc32(RECORDING_MAGIC)
        self._growth = DecompressionCount(path)

    def done(self) -> RebuiltIndex:
        """Scan the file and return the rebuilt index."""
        summary = self._summary
        for at, code, length in self._records():
            match code:
                case Opcode.CHUNK:
                    self._chunk(at, length)
                case Opcode.MESSAGE:
                    channel, log_ns = self._message(at, self._file.read(MESSAGE_HEAD.size))
                    self._at.append(at)
                    self._log_ns.append(log_ns)
                    self._channel.append(channel)
                case Opcode.SCHEMA | Opcode.CHANNEL:
                    self._define(at, code, self._read(at, length))
                case Opcode.ATTACHMENT:
                    summary.attachment_indexes.append(self._attachment(at, length))
                case Opcode.METADATA:
                    record = Metadata.read(_stream(self._read(at, length)))
                    summary.metadata_indexes.append(MetadataIndex(at, HEAD.size + length, record.name))
        first, last = self._span or (0, 0)
        summary.statistics = Statistics(
            attachment_count=len(summary.attachment_indexes),
            channel_count=len(summary.channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(summary.chunk_indexes),
            message_count=self._counts.total(),
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(summary.metadata_indexes),
            schema_count=len(summary.schemas),
        )
        return RebuiltIndex(summary, UnchunkedMessages(self._at, self._log_ns, self._channel))

    def _records(self) -> Iterator[tuple[int, int, int]]:
        """Yield (byte, opcode, length) of each record before the end of the data; the file is at the record's content.

        The check sum of the data is verified at the end.
        """
        size = self._file.seek(0, io.SEEK_END)
        at = len(RECORDING_MAGIC)
        while at < size:
            self._file.seek(at)
            head = self._file.read(HEAD.size)
            code, length = HEAD.unpack(head)
            end = at + HEAD.size + length
            if end > size:
                raise self._damaged(f"the record at byte {at} is stated to end at byte {end} of {size}")
            if code == Opcode.DATA_END and is_end_mark(code, length):
                (stated,) = struct.unpack_from("<I", self._read(at, length))
                if stated and stated != self._crc:
                    raise self._damaged(f"the data before byte {at} have a wrong check sum")
                self._check_end(at, size)
                return
            # A damaged code would make a chunk one of those records that readers pass over
            if code not in DATA and code < PRIVATE:
                raise self._damaged(f"a record of kind {code} at byte {at}, where there can be none")
            self._sum(head, length)
            self._file.seek(at + HEAD.size)
            yield at, code, length
            at = end
        raise self._damaged("the end of the data is missing")

    def _check_end(self, at: int, size: int) -> None:
        """InputError unless only an index and the end mark follow the end of the data.

        `at` is the byte at which the data end, `size` that of the file.
        """
        behind = byte_after_end(self._file, at, size)
        if behind is None:
            raise self._damaged(f"behind the end of the data at byte {at} are other data than an index")
        if behind < size:
            raise self._damaged(f"{size - behind} bytes follow its end mark at byte {behind}")

    def _sum(self, head: bytes, length: int) -> None:
        """Read the next `length` bytes of the file, and add them, after the record's head, to the running check sum."""
        self._crc = zlib.crc32(head, self._crc)
        while length > 0:
            block = self._file.read(min(length, _BLOCK))
            self._crc = zlib.crc32(block, self._crc)
            length -= len(block) or length

    def _read(self, at: int, length: int) -> bytes:
        if length > MAX_CHUNK_BYTES:
            raise InputError(
                f"{self._path}: record of {length} bytes at byte {at}; the limit is {MAX_CHUNK_BYTES}; it is "
                "damaged, copy it again",
                id="input-too-large",
            )
        return self._file.read(length)

    def _chunk(self, at: int, length: int) -> None:
        data = self._read(at, length)
        head = chunk_head(data)
        first, last = CHUNK_HEAD.unpack_from(data)[:2]
        packed = data[head.begin :]
        index = ChunkIndex(
            chunk_length=HEAD.size + length,
            chunk_start_offset=at,
            compression=head.compression,
            compressed_size=len(packed),
            message_end_time=last,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=first,
            uncompressed_size=head.declared,
        )
        check_chunk(self._path, self._file, index)
        records = unpacked(packed, head.compression, head.declared)
        if len(records) != head.declared or (head.crc and zlib.crc32(records) != head.crc):
            raise self._damaged(f"the chunk at byte {at} has a wrong check sum")
        self._growth.add(len(packed), records)
        begin, times = 0, []
        while begin < len(records):
            code, size = HEAD.unpack_from(records, begin)
            begin += HEAD.size
            if begin + size > len(records):
                raise self._damaged(f"the chunk at byte {at} ends within a record")
            if code == Opcode.MESSAGE:
                channel, log_ns = self._message(at, records[begin : begin + MESSAGE_HEAD.size])
                times.append(log_ns)
                # Where in the chunk is not asked: it is unpacked as a whole
                index.message_index_offsets[channel] = 0
            elif code in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(at, code, records[begin : begin + size])
            begin += size
        if times:  # what the chunk states about them may be wrong, and they are put in order by it
            index.message_start_time, index.message_end_time = min(times), max(times)
            self._summary.chunk_indexes.append(index)

    def _message(self, at: int, head: bytes) -> tuple[int, int]:
        """Count a message, and return its channel and recording time [ns].

        Args:
            at: byte of the record, or of its chunk, for messages.
            head: first bytes of the record's content.
        """
        channel, _, log_ns, _ = MESSAGE_HEAD.unpack(head)
        if channel not in self._summary.channels:
            raise self._damaged(f"a message at byte {at} is of channel {channel}, which is not defined")
        self._counts[channel] += 1
        low, high = self._span or (log_ns, log_ns)
        self._span = (min(low, log_ns), max(high, log_ns))
        return channel, log_ns

    def _define(self, at: int, code: int, data: bytes) -> None:
        found: Schema | Channel
        known: dict[int, Schema] | dict[int, Channel]
        if code == Opcode.SCHEMA:
            found, known = Schema.read(_stream(data)), self._summary.schemas
        else:
            found, known = Channel.read(_stream(data)), self._summary.channels
            if found.schema_id and found.schema_id not in self._summary.schemas:
                raise self._damaged(
                    f"channel {found.id} at byte {at} is of schema {found.schema_id}, which is not defined"
                )
        if known.setdefault(found.id, found) != found:
            what = "schema" if code == Opcode.SCHEMA else "channel"
            raise self._damaged(f"{what} {found.id} is defined a second time, and otherwise, at byte {at}")

    def _attachment(self, at: int, length: int) -> AttachmentIndex:
        """Index entry of an attachment; its data, which may be large, are not read.

        `at` is the first byte of the record, `length` the size of its content [bytes].
        """
        stream = _stream(self._file.read(min(length, _BLOCK)))
        log_time, create_time = stream.read8(), stream.read8()
        name, media_type = stream.read_prefixed_string(), stream.read_prefixed_string()
        return AttachmentIndex(
            offset=at,
            length=HEAD.size + length,
            log_time=log_time,
            create_time=create_time,
            data_size=stream.read8(),
            name=name,
            media_type=media_type,
        )

    def _damaged(self, what: str) -> InputError:
        return damaged_mcap(self._path, what)


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(data))


Found = tuple[Schema | None, Channel, Message]


class McapMessages(Protocol):
    """Interface to the messages, attachments and metadata of an MCAP file, as of the library's reader."""

    def iter_messages(self, topics: Collection[str] | None = None, *, log_time_order: bool = True) -> Iterator[Found]:
        """Yield (schema or None, channel, message) of the given topics (None: all), in order of time or of the file."""

    def iter_attachments(self) -> Iterator[Attachment]:
        """Yield all attachments."""

    def iter_metadata(self) -> Iterator[Metadata]:
        """Yield all metadata records."""


class RebuiltIndexReader:
    """Reader of an MCAP file by a rebuilt index, in bounded memory."""

    def __init__(self, file: IO[bytes], made: RebuiltIndex) -> None:
        """Wrap an open file and its rebuilt index; check sums of chunks are verified again on reading."""
        self._file, (self._summary, self._loose) = file, made
        file.seek(0)
        self._chunked = _Given(file, self._summary)

    def iter_messages(self, topics: Collection[str] | None = None, *, log_time_order: bool = True) -> Iterator[Found]:
        """Yield (schema or None, channel, message) of the given topics (None: all), in order of time or of the file.

        Messages of one time are in file order, those in chunks before those outside.
        """
        if not log_time_order:
            yield from self._in_file_order(topics)
            return
        chunked: Iterable[Found] = ()
        if self._summary.chunk_indexes:
            chunked = self._chunked.iter_messages(topics=topics)
        order = np.argsort(np.asarray(self._loose.log_ns, dtype=np.uint64), kind="stable")
        loose = (each for _, each in self._outside(order.tolist(), topics))
        yield from heapq.merge(chunked, loose, key=lambda each: each[2].log_time)

    def iter_attachments(self) -> Iterator[Attachment]:
        """Yield all attachments."""
        yield from self._chunked.iter_attachments()

    def iter_metadata(self) -> Iterator[Metadata]:
        """Yield all metadata records."""
        yield from self._chunked.iter_metadata()

    def _in_file_order(self, topics: Collection[str] | None) -> Iterator[Found]:
        inside, outside = self._inside(topics), self._outside(range(len(self._loose.at)), topics)
        for _, each in heapq.merge(inside, outside, key=lambda pair: pair[0]):
            yield each

    def _inside(self, topics: Collection[str] | None) -> Iterator[tuple[int, Found]]:
        for index in self._summary.chunk_indexes:
            self._file.seek(index.chunk_start_offset + HEAD.size)
            for record in breakup_chunk(Chunk.read(ReadDataStream(self._file)), validate_crc=True):
                if isinstance(record, Message) and self._wanted(record.channel_id, topics):
                    yield index.chunk_start_offset, self._with_channel(record)

    def _outside(self, order: Iterable[int], topics: Collection[str] | None) -> Iterator[tuple[int, Found]]:
        for n in order:
            if not self._wanted(self._loose.channel[n], topics):
                continue
            at = self._loose.at[n]
            self._file.seek(at)
            _, length = HEAD.unpack(self._file.read(HEAD.size))
            yield at, self._with_channel(Message.read(ReadDataStream(self._file), length))

    def _wanted(self, channel: int, topics: Collection[str] | None) -> bool:
        return topics is None or self._summary.channels[channel].topic in topics

    def _with_channel(self, message: Message) -> Found:
        channel = self._summary.channels[message.channel_id]
        return self._summary.schemas.get(channel.schema_id), channel, message


class _Given(SeekingReader):  # type: ignore[misc]
    """The library's reader of MCAP files, which uses a given index instead of the one in the file."""

    def __init__(self, file: IO[bytes], summary: Summary) -> None:
        super().__init__(file, validate_crcs=True, record_size_limit=MAX_CHUNK_BYTES)
        self._declared = summary

    def get_summary(self) -> Summary:
        return self._declared
