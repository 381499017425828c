"""Messages of an MCAP file by an index that was made of it, in the order of time or of the file."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterable, Iterator
from typing import IO, Protocol

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary

from .chunks import MAX_CHUNK_BYTES
from .layout import HEAD
from .made_index import MadeIndex

Found = tuple[Schema | None, Channel, Message]


class McapMessages(Protocol):
    """What is read of an MCAP file, whoever reads it."""

    def iter_messages(self, topics: Collection[str] | None = None, *, log_time_order: bool = True) -> Iterator[Found]:
        """Messages of some topics, or of all, in the order of time or of the file."""

    def iter_attachments(self) -> Iterator[Attachment]:
        """All attached files."""

    def iter_metadata(self) -> Iterator[Metadata]:
        """All records of metadata."""


class MadeIndexReader:
    """Reads an MCAP file by an index that was made of it; memory does not grow with the file."""

    def __init__(self, file: IO[bytes], made: MadeIndex) -> None:
        """A reader of `file`, with check sums of chunks tried again."""
        self._file, (self._summary, self._loose) = file, made
        file.seek(0)
        self._chunked = _Given(file, self._summary)

    def iter_messages(self, topics: Collection[str] | None = None, *, log_time_order: bool = True) -> Iterator[Found]:
        """Messages of some topics, or of all; those of one time as they stand in the file, chunks before loose ones."""
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
        """All attached files."""
        yield from self._chunked.iter_attachments()

    def iter_metadata(self) -> Iterator[Metadata]:
        """All records of metadata."""
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
    """The library's reader, whose index is given."""

    def __init__(self, file: IO[bytes], summary: Summary) -> None:
        super().__init__(file, validate_crcs=True, record_size_limit=MAX_CHUNK_BYTES)
        self._told = summary

    def get_summary(self) -> Summary:
        return self._told
