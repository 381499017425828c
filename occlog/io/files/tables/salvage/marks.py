"""Marks between the groups of rows of a table, by which a file that lost its footer is read.

Parquet says at its end alone which columns there are and where.  A mark at the beginning has the schema with its
provenance, one behind each group of rows says where the group begins and has a check sum of it.  Readers of Parquet
pass marks over, since they find pages by their places.

    PAR1 | mark of the schema | pages of a group | mark of the group | pages of a group | ... | footer

A mark is `MARK`, its kind, the length of what it says, the CRC-32 of that, and that: a schema in the form of Arrow's
messages, or the numbers of a `Group`.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from occlog.io.files.untrusted.content import PARQUET_MAGIC

MARK = b"occlogRG"
SCHEMA, GROUP = b"S", b"G"
_HEAD = struct.Struct("<8scII")
_FIRST = 3  # numbers of a group before those of its columns
MAX_BYTES = 1 << 26
"""A mark is not longer: longest are schemas with the provenance of many inputs."""


class Group(NamedTuple):
    """A group of rows."""

    at: int  # byte of the file where it begins
    rows: int
    crc: int  # CRC-32 of its bytes
    values: tuple[int, ...]  # numbers in the pages of each column: those of all lists, or one a row


class Mark(NamedTuple):
    """A mark that was found."""

    at: int
    kind: bytes
    says: bytes

    @property
    def behind(self) -> int:
        """The byte behind it."""
        return self.at + _HEAD.size + len(self.says)


def mark_of_schema(serialized: bytes) -> bytes:
    """The mark with a schema in the form of Arrow's messages."""
    return _mark(SCHEMA, serialized)


def mark_of_group(at: int, rows: int, values: Sequence[int], crc: int) -> bytes:
    """The mark behind a group of rows."""
    return _mark(GROUP, struct.pack(f"<{_FIRST + len(values)}Q", at, rows, crc, *values))


def _mark(kind: bytes, says: bytes) -> bytes:
    return _HEAD.pack(MARK, kind, len(says), zlib.crc32(says)) + says


def marks(data: bytes | mmap.mmap) -> Iterator[Mark]:
    """Every mark of a file whose check sum is right, in order."""
    at = 0
    while (at := data.find(MARK, at)) >= 0:
        stop = at + _HEAD.size
        if stop <= len(data):
            _, kind, length, crc = _HEAD.unpack(data[at:stop])
            says = data[stop : stop + length] if length <= MAX_BYTES else b""
            if kind in (SCHEMA, GROUP) and len(says) == length and zlib.crc32(says) == crc:
                yield Mark(at, kind, says)
                at = stop + length
                continue
        at += 1


def is_marked(path: Path) -> bool:
    """Whether a file begins as a table with marks does, so that it may be read without its footer."""
    with suppress(OSError), path.open("rb") as file:
        return file.read(len(PARQUET_MAGIC) + len(MARK)) == PARQUET_MAGIC + MARK
    return False


def group_of(mark: Mark) -> Group:
    """What the mark of a group says; `struct.error` if it is of no group."""
    at, rows, crc, *values = struct.unpack(f"<{max(len(mark.says) // 8, _FIRST)}Q", mark.says)
    return Group(at, rows, crc, tuple(values))
