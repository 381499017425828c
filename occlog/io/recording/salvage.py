"""What is whole in a recording that was cut off or damaged: records, one after another, without its index.

A chunk counts if its check sum is right.  The last one of a file that was cut has none that could be tried; of
what it holds up to the cut nothing was changed, so its complete messages count.  Where the length of a record is
damaged, the search goes on at the next chunk whose head makes sense.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from occlog.errors import InputError
from occlog.io.files.content import PARQUET_MAGIC, RECORDING_MAGIC
from occlog.io.files.inputs import check_input

from .chunks import CHUNK_HEAD, KNOWN_COMPRESSION, MAX_CHUNK_BYTES, ChunkHead, chunk_head
from .layout import HEAD
from .lz4_blocks import rest_of_block
from .mcap_errors import FOOTER_BYTES, check_summary

LAST_CODE = Opcode.DATA_END
"""Codes of records that the format defines go up to this one."""
_LENGTH = struct.Struct("<I")
_MARKS = tuple(_LENGTH.pack(len(name)) + name.encode() for name in KNOWN_COMPRESSION if name)
"""The name of the compression as it stands in the head of a chunk."""
_BLOCK = 1 << 20
FAILURES = (McapError, struct.error, ValueError, RuntimeError, EOFError, MemoryError, zstandard.ZstdError)
"""What damaged records raise in the libraries that take them apart."""

Tell = Callable[[int, str], None]
"""Is told of damage: where it is [byte of the file], and what it is."""


class Record(NamedTuple):
    """One whole record.

    Attributes:
        code: kind of the record, by the MCAP format.
        data: its bytes, without code and length.
        at: byte of the file at which it begins, or the chunk that holds it.
    """

    code: int
    data: bytes
    at: int


def whole_records(path: Path, damaged: Tell) -> Iterator[Record]:
    """All whole records before the index, those of chunks one by one, in the order of the file.

    Args:
        path: an MCAP file.
        damaged: is called for every damage, before the records that follow it.

    Raises:
        InputError: no MCAP file, or one that cannot be read.
    """
    check_input(path, "an MCAP recording")
    size = path.stat().st_size
    with path.open("rb") as file:
        begin = file.read(len(RECORDING_MAGIC))
        if begin.startswith(PARQUET_MAGIC):
            raise InputError(
                f"{path}: is a table (Parquet); what its columns are and where stands at its end alone, so that "
                "nothing can be salvaged of one that was cut: make it again"
            )
        if begin != RECORDING_MAGIC:
            raise InputError(f"{path}: not an MCAP file (it does not begin with the MCAP mark)")
        at = len(RECORDING_MAGIC)
        while at < size:
            file.seek(at)
            head = file.read(HEAD.size)
            if len(head) < HEAD.size:
                break
            code, length = HEAD.unpack(head)
            if code in (Opcode.DATA_END, Opcode.FOOTER):
                return
            end = at + HEAD.size + length
            if 0 < code <= LAST_CODE and end <= size:
                yield from _one(file, at, code, length, damaged)
                at = end
                continue
            # A record that does not fit: its length is damaged, or the file was cut within it
            found = _next_chunk(file, at + 1, size)
            if found is None and code == Opcode.CHUNK:
                yield from _cut_chunk(file, at, size, damaged)
                return
            damaged(at, "the file is cut within a record" if found is None else "damaged: read on at the next chunk")
            if found is None:
                return
            at = found
        damaged(size, "the file is cut: its end mark is missing")


def repeated_records(path: Path) -> list[Record]:
    """Schemas, channels and statistics in the index at the end of a file; none where it is gone or damaged."""
    found: list[Record] = []
    size = path.stat().st_size
    with path.open("rb") as file, suppress(InputError, *FAILURES):
        check_summary(path, file)
        file.seek(size - len(RECORDING_MAGIC) - FOOTER_BYTES + HEAD.size)
        (start,) = struct.unpack("<Q", file.read(8))
        end = size - len(RECORDING_MAGIC) - FOOTER_BYTES
        if not 0 < start < end or end - start > MAX_CHUNK_BYTES:
            return []
        file.seek(start)
        found = [
            record
            for record in _split(file.read(end - start), start)
            if record.code in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
        ]
    return found


def _one(file: IO[bytes], at: int, code: int, length: int, damaged: Tell) -> Iterator[Record]:
    """A record outside chunks, or those of a chunk."""
    if length > MAX_CHUNK_BYTES:
        damaged(at, f"a record of {length} bytes (limit {MAX_CHUNK_BYTES}) is left out")
        return
    data = file.read(length)
    if code != Opcode.CHUNK:
        yield Record(code, data, at)
        return
    try:
        head = chunk_head(data)
        records = _unpacked(data, head)
        if len(records) != head.declared or (head.crc and zlib.crc32(records) != head.crc):
            raise ValueError("wrong check sum")
    except FAILURES as error:
        reason = " ".join(str(error).split())[:80] or "data end early"
        damaged(at, f"a damaged chunk of {length} bytes is left out ({reason})")
        return
    yield from _split(records, at)


def _cut_chunk(file: IO[bytes], at: int, size: int, damaged: Tell) -> Iterator[Record]:
    """The complete records of a chunk in which the file was cut."""
    file.seek(at + HEAD.size)
    try:
        data = file.read(min(size - at, MAX_CHUNK_BYTES))
        records = _unpacked(data, chunk_head(data))
    except FAILURES:
        records = b""
    yield from _split(records, at)
    damaged(at, "the file is cut within a chunk; what is complete before the cut is kept, without a check sum")


def _unpacked(data: bytes, head: ChunkHead) -> bytes:
    """As much of the declared records as a chunk's data hold, and no more; ValueError: too much is declared."""
    packed, compression, declared = data[head.begin :], head.compression, head.declared
    if compression not in KNOWN_COMPRESSION:
        raise ValueError(f"unknown compression {compression!r}")
    if declared > MAX_CHUNK_BYTES:
        raise ValueError(f"unpacks to {declared} bytes; the limit is {MAX_CHUNK_BYTES}")
    if not compression:
        return packed[:declared]
    if compression == "lz4":
        whole = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=declared))
        return whole + rest_of_block(packed, whole, declared)
    stream, out = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(packed)), bytearray()
    while len(out) < declared:
        try:
            part = stream.read(min(declared - len(out), _BLOCK))
        except zstandard.ZstdError:
            break
        if not part:
            break
        out += part
    return bytes(out)


def _split(records: bytes, at: int) -> Iterator[Record]:
    """The complete records in the unpacked bytes of a chunk."""
    begin = 0
    while begin + HEAD.size <= len(records):
        code, length = HEAD.unpack_from(records, begin)
        begin += HEAD.size
        if begin + length > len(records):
            return
        yield Record(code, records[begin : begin + length], at)
        begin += length


def _next_chunk(file: IO[bytes], at: int, size: int) -> int | None:
    """Where the next record begins that looks like a whole compressed chunk; None: there is none."""
    before = HEAD.size + CHUNK_HEAD.size  # of the name of the compression
    longest = max(map(len, _MARKS))
    begin = at
    while begin < size:
        file.seek(begin)
        block = file.read(_BLOCK + longest - 1)
        places = sorted(p for mark in _MARKS for p in _all_of(block, mark))
        for start in (begin + p - before for p in places):
            if start < at:
                continue
            file.seek(start)
            head = file.read(before)
            code, length = HEAD.unpack_from(head)
            if code == Opcode.CHUNK and start + HEAD.size + length <= size:
                return start
        begin += _BLOCK
    return None


def _all_of(block: bytes, mark: bytes) -> Iterator[int]:
    """Places of a mark in a block."""
    place = block.find(mark)
    while place >= 0:
        yield place
        place = block.find(mark, place + 1)
