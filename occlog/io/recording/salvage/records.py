"""Generation of the intact records of a truncated or damaged recording, without its index.

A chunk is accepted if its check sum is valid. The last chunk of a truncated file cannot be verified; its complete
messages are accepted. If the length of a record is damaged, the search continues at the next chunk with a valid header,
or at the next of several concatenated recordings. For a truncated LZ4 frame, the library returns whole blocks only.
A block is a list of sequences (literal bytes, then a match that repeats earlier output), which are decompressed here up
to the truncation (LZ4 block format, sections "Compressed block format" and "End of block").
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple, Protocol

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from occlog.errors import InputError
from occlog.io.files.limits import PARQUET_MAGIC, RECORDING_MAGIC, check_input
from occlog.io.recording.chunks import (
    CHUNK_HEAD,
    HEAD,
    INDEX_ENTRY,
    INDEX_HEAD,
    KNOWN_COMPRESSION,
    MAX_CHUNK_BYTES,
    ChunkHead,
    DecompressionCount,
    chunk_head,
)

from .ends import BEGIN, END_BYTES, byte_after_end, index_of, is_end_mark

_MAGIC = 0x184D2204
_PLAIN = 1 << 31
"""Bit of a block's size that states that its bytes are not packed."""
_LENGTH = struct.Struct("<I")
_OFFSET = struct.Struct("<H")
_HEAD = 7
"""Bytes of the shortest head of a frame: mark, flags, size of blocks, check sum."""
_SHORTEST_MATCH = 4
_LONG = 15
"""A length of this or more goes on in the bytes that follow."""


def recover_block_tail(frame: bytes, whole: bytes, most: int) -> bytes:
    """Decompressed bytes of the truncated last block of an LZ4 frame; empty if no compressed block is truncated.

    Args:
        frame: the LZ4 frame, possibly truncated.
        whole: decompressed bytes before that block.
        most: limit of the size of `whole` and the result together [bytes].
    """
    block = _cut_block(frame)
    return _sequences(block, whole, most - len(whole)) if block is not None else b""


def _cut_block(frame: bytes) -> bytes | None:
    """Compressed bytes of the last block of an LZ4 frame that ends within it.

    None if that block is not compressed, or the frame is complete or invalid.
    """
    if len(frame) < _HEAD or _LENGTH.unpack_from(frame)[0] != _MAGIC:
        return None
    flags = frame[4]
    at = _HEAD + (8 if flags & 0x08 else 0) + (4 if flags & 0x01 else 0)
    sum_bytes = 4 if flags & 0x10 else 0
    while at + _LENGTH.size <= len(frame):
        (stated,) = _LENGTH.unpack_from(frame, at)
        begin, size = at + _LENGTH.size, stated & ~_PLAIN
        if not size:
            return None
        if begin + size + sum_bytes > len(frame):
            return None if stated & _PLAIN else frame[begin : begin + size]
        at = begin + size + sum_bytes
    return None


def _sequences(block: bytes, before: bytes, most: int) -> bytes:
    """Decompress the LZ4 sequences of a block up to the end of the data, or to the first invalid one.

    Args:
        block: compressed block, possibly truncated.
        before: decompressed bytes before the block, to which sequences refer.
        most: limit of the result [bytes].
    """
    out, skipped, at = bytearray(before[-65_535:]), len(before[-65_535:]), 0
    while at < len(block) and len(out) - skipped < most:
        token = block[at]
        literals, at = _length(block, at + 1, token >> 4)
        out += block[at : at + literals]
        at += literals
        if at + _OFFSET.size > len(block):
            break
        (offset,) = _OFFSET.unpack_from(block, at)
        if not 0 < offset <= len(out):
            break
        match, at = _length(block, at + _OFFSET.size, token & _LONG)
        match = min(match + _SHORTEST_MATCH, most - (len(out) - skipped))
        part = bytes(out[-offset:])
        out += (part * (match // offset + 1))[: max(match, 0)]
    return bytes(out[skipped : skipped + max(most, 0)])


def _length(block: bytes, at: int, length: int) -> tuple[int, int]:
    """Decode an LZ4 length; return it and the index behind it. It is partial if the block is truncated.

    Args:
        block: compressed block.
        at: index of the byte that may continue the length.
        length: its 4-bit beginning; below 15 it is complete.
    """
    if length < _LONG:
        return length, at
    while at < len(block):
        more = block[at]
        length, at = length + more, at + 1
        if more < 255:
            break
    return length, at


LAST_CODE = Opcode.DATA_END
"""Codes of records that the format defines go up to this one."""
_MARKS = tuple(_LENGTH.pack(len(name)) + name.encode() for name in KNOWN_COMPRESSION if name)
"""The name of the compression as it is in the head of a chunk."""
_SIZES = {1: "<I", 2: "<Q"}
_PARTS: dict[int, tuple[int, ...]] = {
    Opcode.HEADER: (-1, -1),
    Opcode.SCHEMA: (2, -1, -1, -1),
    Opcode.CHANNEL: (4, -1, -1, -1),
    Opcode.CHUNK: (CHUNK_HEAD.size, -1, -2),
    Opcode.MESSAGE_INDEX: (2, -1),
    Opcode.ATTACHMENT: (16, -1, -1, -2, 4),
    Opcode.METADATA: (-1, -1),
}
"""Layout of records in the MCAP format: numbers of bytes; -1, -2: bytes behind a count of 4 or 8 bytes."""
_BLOCK = 1 << 20
_FIRST_BLOCK = 1 << 12
"""Bytes in which the next record is searched for first: after repeated damage it is near."""
_BEGINS = re.compile(b"|".join(map(re.escape, (*_MARKS, BEGIN))))
FAILURES = (McapError, struct.error, ValueError, RuntimeError, EOFError, MemoryError, zstandard.ZstdError)
"""Exceptions of parsing libraries for damaged records."""


class DamageReporter(Protocol):
    """Function that is called for every damage in a file."""

    def __call__(self, at: int, what: str, *, messages: bool = True) -> None:
        """Report damage at byte `at` of the file: its description, and whether messages may be lost."""


class McapRecord(NamedTuple):
    """A complete record of an MCAP file.

    Attributes:
        code: kind of the record (opcode of the MCAP format).
        data: its content, without opcode and length.
        at: byte of the file at which it begins, or at which the chunk that holds it begins.
    """

    code: int
    data: bytes
    at: int


def intact_records(path: Path, damaged: DamageReporter) -> Iterator[McapRecord]:
    """Yield all complete records of a damaged MCAP file before the index, in file order, those of chunks one by one.

    Each recording begins with a record of the kind HEADER, after which earlier definitions are void.

    Args:
        path: an MCAP file, or several one behind another.
        damaged: called for every damage, before the records that follow it.

    Raises:
        InputError: it is not an MCAP file, or it cannot be read.
    """
    check_input(path, "an MCAP recording")
    size = path.stat().st_size
    with path.open("rb") as file:
        begin = file.read(len(RECORDING_MAGIC))
        if begin.startswith(PARQUET_MAGIC):
            raise InputError(
                f"{path}: is a table (Parquet); its columns and layout are described at its end only, so that "
                "nothing can be salvaged of one that was cut: make it again",
                id="wrong-content",
            )
        if begin != RECORDING_MAGIC:
            raise InputError(f"{path}: not an MCAP file (it does not begin with the MCAP mark)", id="unknown-format")
        at, before, growth = 0, 0, DecompressionCount(path)
        while at < size:
            file.seek(at)
            head = file.read(HEAD.size)
            if head.startswith(RECORDING_MAGIC):
                yield McapRecord(Opcode.HEADER, b"", at)
                at += len(RECORDING_MAGIC)
                continue
            if len(head) < HEAD.size:
                break
            code, length = HEAD.unpack(head)
            own = _own_length(file, at, code, size)
            if own is not None and own != length and _begins_at(file, at + HEAD.size + own, size):
                damaged(at, f"the length of a record is damaged ({length}, which must be {own})", messages=False)
                length = own
            file.seek(at + HEAD.size)
            if is_end_mark(code, length):
                behind = _behind(file, at, size, damaged)
                if behind == size:
                    return
                at = behind
            elif at + HEAD.size + length <= size and (kind := _kind(file, code, length, before)):
                if kind != code:
                    what = f"the kind of a record is damaged ({code}, which must be {kind})"
                    damaged(at, what, messages=False)
                file.seek(at + HEAD.size)
                at = yield from _one(file, at, kind, length, damaged, growth)
            else:
                # A record that does not fit: its length is damaged, or the file was cut within it
                begins = _next_begin(file, at + 1, size)
                if code == Opcode.CHUNK and (begins is None or _is_recording(file, begins)):
                    yield from _cut_chunk(file, at, size if begins is None else begins, damaged, growth)
                else:
                    damaged(at, "the file is cut within a record" if begins is None else _read_on(file, begins))
                if begins is None:
                    return
                at = begins
            before = code
        damaged(size, "the file is cut: its end mark is missing")


def repeated_records(path: Path, begin: int = 0) -> list[McapRecord]:
    """Schemas, channels and statistics in the index of the recording that begins at byte `begin`; empty if damaged."""
    with path.open("rb") as file, suppress(*FAILURES):
        found = index_of(file, begin, path.stat().st_size)
        if found is not None:
            start, records = found
            kinds = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
            return [record for record in _split(records, start) if record.code in kinds]
    return []


def _behind(file: IO[bytes], at: int, size: int, damaged: DamageReporter) -> int:
    """Byte after an end mark at byte `at` at which reading goes on: the next recording or chunk; `size` without one.

    Skipped bytes are reported to `damaged`; `size` is that of the file.
    """
    behind = byte_after_end(file, at, size)
    if behind is None:  # the index is damaged, or the mark is none
        begins = _next_begin(file, at + 1, size)
        if begins is not None:
            damaged(at, f"an end mark without its index, or none; {_read_on(file, begins)}")
        return size if begins is None else begins
    if behind == size or _is_recording(file, behind):
        return behind
    begins = _next_begin(file, behind, size)
    stop = size if begins is None else begins
    damaged(behind, f"{stop - behind} bytes behind the end mark are no records, and are skipped")
    return stop


def _read_on(file: IO[bytes], begins: int) -> str:
    return f"records are damaged: read on at the next {'recording' if _is_recording(file, begins) else 'chunk'}"


def _is_recording(file: IO[bytes], at: int) -> bool:
    file.seek(at)
    return file.read(len(RECORDING_MAGIC)) == RECORDING_MAGIC


def _kind(file: IO[bytes], code: int, length: int, before: int) -> int:
    """Kind of a record (opcode), corrected by its content if the stated one may be damaged; 0 if unknown.

    Args:
        file: the file, at the content of the record.
        code: opcode as stated.
        length: size of the content [bytes], all of which is in the file.
        before: opcode of the record before it.
    """
    data = file.read(min(INDEX_HEAD.size, length)) if length <= MAX_CHUNK_BYTES else b""
    if before in (Opcode.CHUNK, Opcode.MESSAGE_INDEX) and len(data) >= INDEX_HEAD.size:
        _, stated = INDEX_HEAD.unpack_from(data)
        if stated == length - INDEX_HEAD.size and stated % INDEX_ENTRY == 0:
            return int(Opcode.MESSAGE_INDEX)
    if code not in (Opcode.CHUNK, Opcode.HEADER) and data and _is_chunk(data + file.read(length - len(data))):
        return int(Opcode.CHUNK)
    return code if 0 < code <= LAST_CODE else 0


def _own_length(file: IO[bytes], at: int, code: int, size: int) -> int | None:
    """Length [bytes] of the record at byte `at` by the sizes in its content, not by its header; None if undetermined.

    `code` is its opcode, `size` the length of the file.
    """
    offset = at + HEAD.size
    for part in _PARTS.get(code, ()):
        if part < 0:
            number = struct.Struct(_SIZES[-part])
            file.seek(offset)
            stated = file.read(number.size)
            if len(stated) < number.size:
                return None
            offset += number.size + number.unpack(stated)[0]
        else:
            offset += part
        if offset > size:
            return None
    return offset - at - HEAD.size if code in _PARTS else None


def _begins_at(file: IO[bytes], at: int, size: int) -> bool:
    """Whether a plausible record or a recording begins at byte `at`, by its header; `size` is that of the file."""
    file.seek(at)
    head = file.read(HEAD.size)
    if head.startswith(RECORDING_MAGIC) or len(head) < HEAD.size:
        return head.startswith(RECORDING_MAGIC)
    code, length = HEAD.unpack(head)
    return bool(0 < code <= LAST_CODE and at + HEAD.size + length <= size)


def _is_chunk(data: bytes) -> bool:
    """Whether bytes are the content of a chunk with a valid check sum, which must not be missing."""
    try:
        head = chunk_head(data)
        records = _unpacked(data, head) if head.crc and head.compression in KNOWN_COMPRESSION else b""
    except FAILURES:
        return False
    return bool(records) and len(records) == head.declared and zlib.crc32(records) == head.crc


def _one(
    file: IO[bytes], at: int, code: int, length: int, damaged: DamageReporter, growth: DecompressionCount
) -> Generator[McapRecord, None, int]:
    """Yield a record outside of chunks, or all records of a chunk; return the byte at which reading goes on.

    Args:
        file: at the content of the record.
        at: its first byte.
        code: its opcode.
        length: size of its content [bytes].
        damaged: called with byte and description of damage.
        growth: counts decompressed bytes.
    """
    end = at + HEAD.size + length
    if code == Opcode.HEADER:
        return end
    if code in END_BYTES:
        damaged(at, f"a damaged record of {length} bytes is skipped: an end mark has {END_BYTES[code]}")
        return end
    if length > MAX_CHUNK_BYTES:
        damaged(at, f"a record of {length} bytes (limit {MAX_CHUNK_BYTES}) is skipped")
        return end
    data = file.read(length)
    cut = data.find(BEGIN)  # before the cut another recording may begin, which the record cannot hold
    if code != Opcode.CHUNK:
        if cut >= 0 and not (code == Opcode.ATTACHMENT and has_right_sum(data)):
            damaged(at, "the file is cut within a record, and another recording follows")
            return at + HEAD.size + cut
        yield McapRecord(code, data, at)
        return end
    try:
        head = chunk_head(data)
        records = _unpacked(data, head)
        if len(records) != head.declared or (head.crc and zlib.crc32(records) != head.crc):
            raise ValueError("wrong check sum")
    except FAILURES as error:
        if cut >= 0:
            yield from _cut_chunk(file, at, at + HEAD.size + cut, damaged, growth)
            return at + HEAD.size + cut
        reason = " ".join(str(error).split())[:80] or "data end early"
        damaged(at, f"a damaged chunk of {length} bytes is skipped ({reason})")
        return end
    growth.add(len(data) - head.begin, records)
    yield from _split(records, at)
    return end


def has_right_sum(attachment: bytes) -> bool:
    """Whether the check sum of an attachment record (its content) is right, or 0, which means missing."""
    (crc,) = struct.unpack("<I", attachment[-4:])
    return not crc or zlib.crc32(attachment[:-4]) == crc


def _cut_chunk(
    file: IO[bytes], at: int, size: int, damaged: DamageReporter, growth: DecompressionCount
) -> Iterator[McapRecord]:
    """Yield the complete records of the chunk at byte `at`, which is cut off at byte `size`.

    Its check sum is not verified.

    Args:
        file: the open file.
        at: first byte of the chunk record.
        size: byte at which it is cut off.
        damaged: the cut is reported to it, after the records.
        growth: counts decompressed bytes.
    """
    file.seek(at + HEAD.size)
    try:
        data = file.read(min(size - at - HEAD.size, MAX_CHUNK_BYTES))
        records = _unpacked(data, chunk_head(data))
    except FAILURES:
        data = records = b""
    growth.add(len(data), records)
    yield from _split(records, at)
    damaged(at, "the file is cut within a chunk; messages before the cut are kept, unchecked")


def _unpacked(data: bytes, head: ChunkHead) -> bytes:
    """Decompressed records of a chunk up to its damage, limited to the size that `head` declares.

    `data` is the content of the chunk record. ValueError if the declared size is above `MAX_CHUNK_BYTES`, or the
    compression unknown.
    """
    packed, compression, declared = data[head.begin :], head.compression, head.declared
    if compression not in KNOWN_COMPRESSION:
        raise ValueError(f"unknown compression {compression!r}")
    if declared > MAX_CHUNK_BYTES:
        raise ValueError(f"chunk unpacks to {declared} bytes; the limit is {MAX_CHUNK_BYTES}")
    if not compression:
        return packed[:declared]
    if compression == "lz4":
        whole = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=declared))
        return whole + recover_block_tail(packed, whole, declared)
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


def _split(records: bytes, at: int) -> Iterator[McapRecord]:
    """Yield the complete records in `records`, decompressed bytes of the chunk (or index) at byte `at`."""
    begin = 0
    while begin + HEAD.size <= len(records):
        code, length = HEAD.unpack_from(records, begin)
        begin += HEAD.size
        if begin + length > len(records):
            return
        yield McapRecord(code, records[begin : begin + length], at)
        begin += length


def _next_begin(file: IO[bytes], at: int, size: int) -> int | None:
    """Search a damaged file for the next plausible compressed chunk, or beginning of a recording.

    Args:
        file: open for reading.
        at: byte at which the search begins.
        size: length of the file [bytes].

    Returns:
        Byte at which it begins, at least `at`; None if there is none.
    """
    before = HEAD.size + CHUNK_HEAD.size  # of the name of the compression
    longest = max(map(len, (*_MARKS, BEGIN)))
    begin, length = at, _FIRST_BLOCK
    while begin < size:
        file.seek(begin)
        block = file.read(length + longest - 1)
        for found in _BEGINS.finditer(block):
            start = begin + found.start() - (0 if found[0] == BEGIN else before)
            if start < at:
                continue
            if found[0] == BEGIN:
                return start
            file.seek(start)
            code, stated = HEAD.unpack(file.read(HEAD.size))
            if code == Opcode.CHUNK and start + HEAD.size + stated <= size:
                return start
        begin += length
        length = min(2 * length, _BLOCK)
    return None
