"""Decompression limits for the chunks of MCAP files, enforced on actual rather than declared sizes.

Sizes are stated in the index, in the chunk header and in the compressed data; each may be wrong, and LZ4 need not state
any. All chunks together are limited too, since kilobytes may decompress to gigabytes or to millions of records, each of
which takes a microsecond and some hundred bytes of memory. Also: record layout of MCAP files beyond its library, and
messages about damaged ones.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.records import ChunkIndex

from occlog.errors import InputError
from occlog.io.files.limits import RECORDING_MAGIC, max_decompressed_bytes

HEAD = struct.Struct("<BQ")
"""Code and length of a record, before its data."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, number, and times of recording and of publishing [ns] of a message, before its data."""
INDEX_HEAD, INDEX_ENTRY = struct.Struct("<HI"), 16
"""Layout of an MCAP message index: channel and length of its entries, and the length of each."""
SALVAGE = "`occlog recover {path} -o OUT.mcap`"
"""Remedy for a damaged recording that cannot be copied again."""

PROGRAM = "occlog "
"""Beginning of the library entry in the head of occlog recordings."""
_TEXT = struct.Struct("<I")
_LONGEST = 256
"""Bytes of the head that are read."""


def is_of_occlog(path: Path) -> bool:
    """Whether occlog wrote an MCAP file, by its header, which a truncated file has, too."""
    with path.open("rb") as file:
        data = file.read(_LONGEST)
    at = len(RECORDING_MAGIC) + HEAD.size
    for _ in ("profile", "library"):
        if len(data) < at + _TEXT.size:
            return False
        length = _TEXT.unpack_from(data, at)[0]
        text, at = data[at + _TEXT.size : at + _TEXT.size + length], at + _TEXT.size + length
    return data.startswith(RECORDING_MAGIC) and text.startswith(PROGRAM.encode())


def damaged_mcap(path: Path, what: str) -> InputError:
    """InputError, to be raised, for a damaged MCAP file: the fault `what`, and the remedy."""
    return InputError(
        f"{path}: damaged MCAP file: {what}; copy it again, or salvage it: {SALVAGE.format(path=path)}",
        id="damaged-file",
    )


MAX_CHUNK_BYTES = 128 * 1024 * 1024
"""A chunk may not unpack to more than this: ours are 1 MiB plus one image, those of other recorders a few MiB."""
KNOWN_COMPRESSION = ("", "zstd", "lz4")
CHUNK_HEAD = struct.Struct("<QQQI")
"""Times of a chunk, the size of its records and their check sum, before the name of the compression."""
_LENGTH = struct.Struct("<I")
_LZ4_GROWTH = 255
"""LZ4 unpacks to at most this many times its size: a byte represents 255 bytes of a match that goes on."""
_PART = 1 << 16
_FRAME_HEAD = 32
"""Bytes that are enough for the head of packed data."""


class ChunkHead(NamedTuple):
    """Header of an MCAP chunk.

    Attributes:
        declared: size of its records after decompression [bytes].
        crc: CRC-32 of the decompressed records; 0: none.
        compression: one of `KNOWN_COMPRESSION`, or another word.
        begin: offset of the compressed records in the chunk's data.
    """

    declared: int
    crc: int
    compression: str
    begin: int


class ChunkSize(NamedTuple):
    """Sizes of an MCAP chunk.

    Attributes:
        packed: size of its records as stored in the file [bytes].
        unpacked: upper limit of their size after decompression [bytes].
    """

    packed: int
    unpacked: int


def chunk_head(data: bytes) -> ChunkHead:
    """Parse the header at the beginning of an MCAP chunk's data; struct.error or UnicodeDecodeError if invalid."""
    _, _, declared, crc = CHUNK_HEAD.unpack_from(data)
    (n,) = _LENGTH.unpack_from(data, CHUNK_HEAD.size)
    name = CHUNK_HEAD.size + _LENGTH.size
    return ChunkHead(declared, crc, data[name : name + n].decode(), name + n + 8)


def unpacked(data: bytes, compression: str, declared: int) -> bytes:
    """Decompressed records of an MCAP chunk.

    Args:
        data: compressed records.
        compression: `zstd`, `lz4` or empty.
        declared: decompressed size that the chunk declares [bytes].

    Raises:
        ValueError: they are larger than declared or allowed, or the compression is unknown.
        zstandard.ZstdError, RuntimeError: the data are damaged.
    """
    stated = max(declared, stated_size(data, compression))
    if stated > MAX_CHUNK_BYTES:
        raise ValueError(f"chunk unpacks to {stated} bytes; the limit is {MAX_CHUNK_BYTES}")
    if not compression:
        return data
    if compression == "zstd":
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=declared)
    out = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=declared + 1))
    if len(out) > declared:
        raise ValueError(f"chunk unpacks to more than the {declared} bytes that it declares")
    return out


def records_at(file: IO[bytes], at: int) -> bytes:
    """Decompressed records of the chunk record at byte `at`; empty if damaged, which is reported when it is read."""
    file.seek(at)
    _, length = HEAD.unpack(file.read(HEAD.size))
    data = file.read(length)
    try:
        head = chunk_head(data)
        return unpacked(data[head.begin :], head.compression, head.declared)
    except (ValueError, RuntimeError, struct.error, zstandard.ZstdError):
        return b""


def stated_size(data: bytes, compression: str) -> int:
    """Decompressed size that compressed data state [bytes], 0 if they state none.

    ValueError for an unknown compression.
    """
    if compression == "zstd":
        return max(int(zstandard.frame_content_size(data)), 0)
    if compression == "lz4":
        return int(lz4.frame.get_frame_info(data)["content_size"])
    if compression:
        raise ValueError(f"unknown compression {compression!r}")
    return len(data)


def check_chunk(path: Path, file: IO[bytes], index: ChunkIndex) -> ChunkSize:
    """Sizes of the chunk that an index entry lists; InputError if it would decompress to more than `MAX_CHUNK_BYTES`.

    The largest of the sizes that index, header and data declare counts. LZ4 data that could exceed the limit are
    decompressed in parts, which are discarded.
    """
    where = f"{path}: chunk at byte {index.chunk_start_offset}"
    file.seek(index.chunk_start_offset + HEAD.size)
    start = file.read(CHUNK_HEAD.size + _LENGTH.size + max(map(len, KNOWN_COMPRESSION)) + 8 + _FRAME_HEAD)
    head = chunk_head(start)
    for name in (index.compression, head.compression):
        if name not in KNOWN_COMPRESSION:
            raise InputError(f"{where}: unknown compression {name!r}", id="unsupported-format")
    (packed,) = struct.unpack_from("<Q", start, head.begin - 8)
    size = max(index.uncompressed_size, head.declared)
    size = max(size, stated_size(start[head.begin :], head.compression) if head.compression else packed)
    if head.compression == "lz4" and size <= MAX_CHUNK_BYTES < packed * _LZ4_GROWTH:
        file.seek(index.chunk_start_offset + HEAD.size + head.begin)
        size = _lz4_size(file, packed)
    if size > MAX_CHUNK_BYTES:
        raise InputError(
            f"{where} unpacks to {size} bytes or more; the limit is {MAX_CHUNK_BYTES}", id="input-too-large"
        )
    return ChunkSize(packed, size)


def _lz4_size(file: IO[bytes], packed: int) -> int:
    """Decompressed size [bytes] of the next `packed` bytes of a file, which are LZ4 data; counted up to the limit."""
    unpacker, size = lz4.frame.LZ4FrameDecompressor(), 0
    while packed > 0 and not unpacker.eof and size <= MAX_CHUNK_BYTES:
        part = file.read(min(_PART, packed))
        if not part:
            break
        packed -= len(part)
        size += len(unpacker.decompress(part))
    return size


FREE_RECORDS, BYTES_PER_RECORD = 250_000, 2
"""Records that the chunks of any file may hold, and above that one for this many packed bytes: a message of valid files
takes some more, since its time and number differ from those before."""


class DecompressionCount:
    """Counts the decompressed bytes and records of all chunks of a file, and limits them by the size of the file."""

    def __init__(self, path: Path) -> None:
        """Start the count for the file `path`."""
        self._path, self._size = path, path.stat().st_size
        self._unpacked, self._free = 0, FREE_RECORDS

    def add(self, packed: int, records: bytes) -> None:
        """Count a chunk of `packed` compressed bytes by its decompressed records.

        Raises:
            InputError: all chunks so far have more bytes or records than a file of its size can hold.
        """
        self.add_bytes(len(records))
        beyond = _most_beyond(ChunkSize(packed, len(records)))
        if beyond > 0:
            allowed = packed // BYTES_PER_RECORD
            self._free -= max(_count(records, allowed + self._free + 1) - allowed, 0)
        if self._free < 0:
            raise InputError(
                f"{self._path}: chunks with more records than {FREE_RECORDS} and one for each {BYTES_PER_RECORD} "
                f"compressed bytes in a file of {self._size} bytes; it is damaged, copy it again",
                id="input-too-large",
            )

    def add_bytes(self, unpacked: int) -> None:
        """Add a number of decompressed bytes; InputError if there are more than a file of its size can hold."""
        self._unpacked += unpacked
        most = max_decompressed_bytes(self._size)
        if self._unpacked > most:
            raise InputError(
                f"{self._path}: the chunks of a file of {self._size} bytes unpack to more than {most} bytes; it is "
                "damaged, copy it again",
                id="input-too-large",
            )


def check_growth(path: Path, file: IO[bytes], chunks: Sequence[tuple[int, ChunkSize]]) -> None:
    """InputError if all chunks together decompress to more bytes or records than a file of its size can hold.

    They are decompressed only if declared sizes do not decide it.

    Args:
        path: the file.
        file: the same file, open.
        chunks: (first byte, sizes) of each chunk.
    """
    promised, growth = DecompressionCount(path), DecompressionCount(path)
    for _, size in chunks:
        promised.add_bytes(size.unpacked)
    if sum(max(_most_beyond(size), 0) for _, size in chunks) <= FREE_RECORDS:
        return
    for at, size in chunks:
        if _most_beyond(size) <= 0:
            continue
        growth.add(size.packed, records_at(file, at))


def _most_beyond(size: ChunkSize) -> int:
    """Upper limit of the number of records in a chunk beyond those that its compressed size allows; may be negative."""
    return size.unpacked // HEAD.size - size.packed // BYTES_PER_RECORD


def _count(records: bytes, most: int) -> int:
    """Number of records in the decompressed bytes of a chunk, counted up to `most`."""
    begin = count = 0
    while count < most and begin + HEAD.size <= len(records):
        begin += HEAD.size + HEAD.unpack_from(records, begin)[1]
        count += 1
    return count
