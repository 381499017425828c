"""What the chunks of an MCAP file may come to together: well packed, kilobytes are gigabytes or millions of records.

A record takes a microsecond or more and some hundred bytes of memory to read, however small it is: so records count,
and not their bytes alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import IO

from occlog.errors import InputError
from occlog.io.files.untrusted.promises import most_unpacked

from .chunks import ChunkSize, records_at
from .layout import HEAD

FREE_RECORDS, BYTES_PER_RECORD = 250_000, 2
"""Records that the chunks of any file may hold, and above that one for so many packed bytes: a message of honest files
takes some more, since its time and number differ from those before."""


class Growth:
    """What the chunks of a file came to so far."""

    def __init__(self, path: Path) -> None:
        """Nothing yet, of the file `path`."""
        self._path, self._size = path, path.stat().st_size
        self._unpacked, self._free = 0, FREE_RECORDS

    def add(self, packed: int, records: bytes) -> None:
        """Count a chunk of so many packed bytes by its unpacked records; InputError where all come to too much."""
        self.add_bytes(len(records))
        beyond = _most_beyond(ChunkSize(packed, len(records)))
        if beyond > 0:
            allowed = packed // BYTES_PER_RECORD
            self._free -= max(_count(records, allowed + self._free + 1) - allowed, 0)
        if self._free < 0:
            raise InputError(
                f"{self._path}: the chunks of a file of {self._size} bytes hold {FREE_RECORDS} records more than "
                f"one for each {BYTES_PER_RECORD} packed bytes, as those of no recording do"
            )

    def add_bytes(self, unpacked: int) -> None:
        """Count unpacked bytes alone; InputError where all come to too much."""
        self._unpacked += unpacked
        most = most_unpacked(self._size)
        if self._unpacked > most:
            raise InputError(
                f"{self._path}: the chunks of a file of {self._size} bytes unpack to more than {most} bytes, as those "
                "of no recording do"
            )


def check_growth(path: Path, file: IO[bytes], chunks: Sequence[tuple[int, ChunkSize]]) -> None:
    """InputError where chunks, given by their first bytes and sizes, come to too much.

    They are unpacked only where their sizes leave it open.
    """
    promised, growth = Growth(path), Growth(path)
    for _, size in chunks:
        promised.add_bytes(size.unpacked)
    if sum(max(_most_beyond(size), 0) for _, size in chunks) <= FREE_RECORDS:
        return
    for at, size in chunks:
        if _most_beyond(size) <= 0:
            continue
        growth.add(size.packed, records_at(file, at))


def _most_beyond(size: ChunkSize) -> int:
    """How many records a chunk may hold beyond those that its packed bytes allow."""
    return size.unpacked // HEAD.size - size.packed // BYTES_PER_RECORD


def _count(records: bytes, most: int) -> int:
    """How many records a chunk holds; no more than `most` are counted."""
    begin = count = 0
    while count < most and begin + HEAD.size <= len(records):
        begin += HEAD.size + HEAD.unpack_from(records, begin)[1]
        count += 1
    return count
