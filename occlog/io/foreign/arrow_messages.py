"""Messages of an Arrow file or stream by their heads: how many rows they promise, and what they unpack to.

The library unpacks a batch at once, to the sizes that stand in the batch itself.  So the heads are looked at before: a
small file may promise gigabytes, or rows that take no bytes at all.  Heads are FlatBuffers; only the fields that matter
are read.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

FILE_MAGIC, STREAM_MAGIC = b"ARROW1", b"\xff\xff\xff\xff"
DICTIONARY, BATCH = 2, 3
"""Kinds of messages with a body that may be packed."""
# Fields of the format's tables, by their numbers
HEAD_KIND, HEAD, BODY_LENGTH = 1, 2, 3  # of a message
LENGTH, BUFFERS, COMPRESSION = 0, 2, 3  # of a batch
DATA = 1  # of a dictionary: its batch
DICTIONARIES, BATCHES = 2, 3  # of the footer of a file: where messages are


class Message(NamedTuple):
    """What the head of a message promises.

    Attributes:
        rows: of a batch; of a dictionary none.
        unpacked: what its buffers unpack to [bytes]; those that are not packed do not count.
    """

    rows: int
    unpacked: int


def messages(path: Path) -> Iterator[Message]:
    """The batches and dictionaries of a file or a stream; ValueError for heads that are damaged."""
    with path.open("rb") as file:
        data = _Bytes(file.fileno(), os.fstat(file.fileno()).st_size)
        is_file = file.read(len(FILE_MAGIC)) == FILE_MAGIC
        for at in _places_of_file(data) if is_file else _places_of_stream(data):
            yield _message(data, at)


class _Bytes(NamedTuple):
    """The bytes of a file."""

    file: int
    size: int

    def read(self, at: int, size: int) -> bytes:
        """So many bytes from a place on; ValueError where they are not there."""
        if at < 0 or not 0 <= size <= self.size - at:
            raise ValueError(f"the head of the message at byte {at} is cut")
        return os.pread(self.file, size, at)


class _Table:
    """A table of FlatBuffers: fields by number, each at a place that the table of offsets names."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data, self._at = data, at
        self._offsets = at - self._number("<i", at)
        self._size = self._number("<H", self._offsets)

    def _number(self, form: str, at: int) -> Any:
        if not 0 <= at <= len(self._data) - struct.calcsize(form):
            raise ValueError("an offset leads out of the head of a message")
        return struct.unpack_from(form, self._data, at)[0]

    def _place(self, field: int) -> int:
        """Where a field is; 0: it is not there."""
        entry = 4 + 2 * field
        offset = self._number("<H", self._offsets + entry) if entry + 2 <= self._size else 0
        return self._at + offset if offset else 0

    def number(self, field: int, form: str) -> int:
        """A number, 0 if it is not there."""
        place = self._place(field)
        return int(self._number(form, place)) if place else 0

    def table(self, field: int) -> _Table | None:
        """A table within, None if it is not there."""
        place = self._place(field)
        return _Table(self._data, place + self._number("<I", place)) if place else None

    def structs(self, field: int, form: str) -> list[tuple[int, ...]]:
        """The entries of a list of structures."""
        place = self._place(field)
        if not place:
            return []
        place += self._number("<I", place)
        count, size = self._number("<I", place), struct.calcsize(form)
        if count * size > len(self._data) - place - 4:
            raise ValueError("a list leads out of the head of a message")
        return [struct.unpack_from(form, self._data, place + 4 + size * n) for n in range(count)]


def _root(data: bytes) -> _Table:
    if len(data) < 4:
        raise ValueError("the head of a message is cut")
    return _Table(data, struct.unpack_from("<I", data)[0])


def _head(file: _Bytes, at: int) -> tuple[_Table, int]:
    """The head of the message that begins at a byte, and where its body begins."""
    mark, length = struct.unpack("<4si", file.read(at, 8))
    if mark != STREAM_MAGIC:
        raise ValueError(f"no message begins at byte {at}")
    return _root(file.read(at + 8, length)), at + 8 + length


def _places_of_file(file: _Bytes) -> Iterator[int]:
    """Where the messages of a file begin, as its footer says."""
    end = 4 + len(FILE_MAGIC)
    length, magic = struct.unpack(f"<i{len(FILE_MAGIC)}s", file.read(file.size - end, end))
    if magic != FILE_MAGIC or not 0 <= length <= file.size - end:
        raise ValueError("the file does not end with its footer")
    footer = _root(file.read(file.size - end - length, length))
    for field in (DICTIONARIES, BATCHES):
        for begin, *_ in footer.structs(field, "<qi4xq"):
            yield begin


def _places_of_stream(file: _Bytes) -> Iterator[int]:
    """Where the messages of a stream begin, one behind the other, up to its end mark or the end of the file."""
    at = 0
    while at + 8 <= file.size and file.read(at, 8) != STREAM_MAGIC + bytes(4):
        head, body = _head(file, at)
        yield at
        length = head.number(BODY_LENGTH, "<q")
        if length < 0:
            raise ValueError(f"the message at byte {at} has a body of {length} bytes")
        at = body + length


def _message(file: _Bytes, at: int) -> Message:
    head, body = _head(file, at)
    kind, content = head.number(HEAD_KIND, "<B"), head.table(HEAD)
    batch = content.table(DATA) if content is not None and kind == DICTIONARY else content
    if kind not in (DICTIONARY, BATCH) or batch is None:  # the schema of a stream
        return Message(0, 0)
    unpacked = 0
    if batch.table(COMPRESSION) is not None:
        # The size of each buffer stands before what is packed, -1 where it is not
        places = [body + offset for offset, length in batch.structs(BUFFERS, "<qq") if length]
        unpacked = sum(max(struct.unpack("<q", file.read(place, 8))[0], 0) for place in places)
    rows = batch.number(LENGTH, "<q") if kind == BATCH else 0
    if rows < 0:
        raise ValueError(f"the message at byte {at} has {rows} rows")
    return Message(rows, unpacked)
