"""Wrapper of the MCAP library that converts every failure to one InputError.

On damaged files the library raises `struct.error`, `KeyError`, misleading size errors and more, checks CRCs only on
request, and trusts the declared size of a chunk.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import IO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.stream_reader import CRCValidationError
from mcap.summary import Summary

from occlog.errors import InputError, OcclogError
from occlog.io.files.limits import RECORDING_MAGIC, check_input, describe_unsupported
from occlog.io.recording.salvage.ends import FOOTER_BYTES, are_records

from .chunks import MAX_CHUNK_BYTES, SALVAGE, ChunkSize, check_chunk, check_growth, damaged_mcap
from .rebuilt_index import (
    McapMessages,
    RebuiltIndex,
    RebuiltIndexReader,
    check_index_statistics,
    is_index_complete,
    rebuild_index,
)

_FAILURES = (
    McapError,
    CRCValidationError,
    struct.error,
    KeyError,
    IndexError,
    ValueError,
    EOFError,
    OSError,
    RuntimeError,
    MemoryError,
    OverflowError,
    zstandard.ZstdError,
    AttributeError,
    TypeError,
)


@contextmanager
def translate_mcap(path: Path, file: IO[bytes] | None = None) -> Iterator[None]:
    """Context manager that converts exceptions of the MCAP library to InputError.

    `path` is the file for the message, `file` the open file, of which the position is stated; None: it is not.
    """
    try:
        yield
    except OcclogError:
        raise
    except _FAILURES as error:
        reason = " ".join(str(error).split())[:140] or "data ends early"
        location = f"near byte {file.tell()}: " if file is not None and not file.closed else ""
        raise InputError(
            f"{path}: {location}damaged MCAP file ({type(error).__name__}: {reason}); "
            f"copy it again, or salvage it: {SALVAGE.format(path=path)}",
            id="damaged-file",
        ) from error


@contextmanager
def open_mcap(path: Path) -> Iterator[tuple[McapMessages, Summary]]:
    """Context manager: reader of an MCAP file with CRC checks, and its index; an incomplete index is rebuilt.

    Raises:
        InputError: the file is damaged, or its chunks decompress to too much.
    """
    check_input(path, "an MCAP recording")
    with path.open("rb") as file, translate_mcap(path, file):
        check_summary(path, file)
        file.seek(0)
        seeking = SeekingReader(file, validate_crcs=True, record_size_limit=MAX_CHUNK_BYTES)
        summary = seeking.get_summary()
        state = _state(os.fstat(file.fileno()))
        if summary is None or not _has_whole_index(path, state):
            made = _made_index(path, state)
            check_index_statistics(path, summary, made.summary)
            yield RebuiltIndexReader(file, made), made.summary
            return
        sizes = [(index.chunk_start_offset, check_chunk(path, file, index)) for index in summary.chunk_indexes]
        _check_growth(path, state, tuple(sizes))
        yield seeking, summary


def _state(stat: os.stat_result) -> tuple[int, ...]:
    """Device, inode, size and modification time of a file: a key of caches that changes with the file."""
    return stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns


@lru_cache(maxsize=4)
def _has_whole_index(path: Path, state: tuple[int, ...]) -> bool:  # noqa: ARG001
    """Whether the index of an MCAP file lists all its content; cached while `state`, that of the file, is unchanged."""
    with path.open("rb") as file, translate_mcap(path, file):
        summary = SeekingReader(file, validate_crcs=True, record_size_limit=MAX_CHUNK_BYTES).get_summary()
        return summary is not None and is_index_complete(file, summary)


@lru_cache(maxsize=4)
def _made_index(path: Path, state: tuple[int, ...]) -> RebuiltIndex:  # noqa: ARG001
    """Index of an MCAP file, rebuilt from its content; cached while `state`, that of the file, is unchanged."""
    with path.open("rb") as file, translate_mcap(path, file):
        return rebuild_index(path, file)


def check_index(path: Path) -> None:
    """InputError if the index of an MCAP file omits messages or has wrong counts; reads the whole file.

    When messages are read, an omission is noticed by the message indexes that follow each chunk, unless these omit the
    same messages; this function detects it then, too.
    """
    with open_mcap(path) as (reader, summary):
        if isinstance(reader, RebuiltIndexReader):
            return
        made = _made_index(path, _state(path.stat())).summary
    assert summary.statistics is not None
    assert made.statistics is not None
    led = {chunk.chunk_start_offset: chunk.message_index_offsets.keys() for chunk in summary.chunk_indexes}
    for number, has in made.statistics.channel_message_counts.items():
        topic, stated = made.channels[number].topic, summary.statistics.channel_message_counts.get(number, 0)
        if stated != has:
            raise damaged_mcap(path, f"its index counts {stated} messages of {topic}, and there are {has}")
        for chunk in made.chunk_indexes:
            at = chunk.chunk_start_offset
            if number in chunk.message_index_offsets and number not in led.get(at, ()):
                raise damaged_mcap(
                    path, f"its index does not lead to the messages of {topic} in the chunk at byte {at}"
                )


@lru_cache(maxsize=4)
def _check_growth(path: Path, state: tuple[int, ...], chunks: tuple[tuple[int, ChunkSize], ...]) -> None:  # noqa: ARG001
    """InputError if the chunks of a file decompress to too much; cached while `state`, that of the file, is unchanged.

    `chunks` has (first byte, sizes) of each chunk.
    """
    with path.open("rb") as file, translate_mcap(path, file):
        check_growth(path, file, chunks)


def check_summary(path: Path, file: IO[bytes]) -> None:
    """InputError unless an MCAP file has its begin and end marks, and its index a valid check sum."""
    _check_ends(path, file)
    _check_summary_crc(path, file)


def _check_ends(path: Path, file: IO[bytes]) -> None:
    if file.read(8) != RECORDING_MAGIC:
        mistaken = describe_unsupported(path)
        what = "not an MCAP file (it does not begin with the MCAP mark)" if mistaken is None else f"is {mistaken}"
        raise InputError(f"{path}: {what}", id="damaged-file")
    size = file.seek(0, io.SEEK_END)
    file.seek(max(size - 8, 0))
    if size < 2 * 8 + FOOTER_BYTES or file.read(8) != RECORDING_MAGIC:
        raise InputError(
            f"{path}: truncated: the MCAP end mark is missing after {size} bytes; "
            f"copy it again, or salvage it: {SALVAGE.format(path=path)}",
            id="damaged-file",
        )


def _check_summary_crc(path: Path, file: IO[bytes]) -> None:
    size = file.seek(0, io.SEEK_END)
    file.seek(size - 8 - FOOTER_BYTES)
    footer = file.read(FOOTER_BYTES)
    start, _, crc = struct.unpack("<QQI", footer[9:])
    if start == 0:
        return
    if start > size:
        raise damaged_mcap(path, f"the index is stated to begin at byte {start} of {size}")
    file.seek(start)
    if crc == 0:
        # Behind another file positions in an index are wrong, and the library would read the index of that one
        if not are_records(file.read(max(size - 8 - FOOTER_BYTES - start, 0))):
            raise damaged_mcap(path, f"the index is stated to begin at byte {start}, and does not")
        return
    found = zlib.crc32(file.read(size - 8 - 4 - start))
    if found != crc:
        raise damaged_mcap(path, f"the index from byte {start} on has a wrong check sum")


def read_attachment(path: Path, file: IO[bytes], offset: int, length: int) -> bytes:
    """Content of an attachment of an MCAP file; InputError for a wrong check sum, or an incomplete record.

    Args:
        path: file, for messages.
        file: the same file, open.
        offset: byte at which the record of the attachment begins.
        length: of the record [bytes].
    """
    file.seek(offset)
    raw = file.read(length)
    crc = struct.unpack("<I", raw[-4:])[0]
    if len(raw) != length or (crc and zlib.crc32(raw[9:-4]) != crc):
        raise InputError(
            f"{path}: attachment at byte {offset}: wrong check sum; copy the file again", id="damaged-file"
        )
    stream = ReadDataStream(io.BytesIO(raw[9:]))
    stream.read8(), stream.read8()
    stream.read_prefixed_string(), stream.read_prefixed_string()
    return bytes(stream.read(stream.read8()))


__all__ = ["check_index", "check_summary", "open_mcap", "read_attachment", "translate_mcap"]
