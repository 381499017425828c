"""Groups of rows of a file without a footer: each with a footer that is made for it, from its heads of pages.

Which columns there are, and how they are written, is known from the schema alone: a table of one row is written with
it, and its footer is the pattern.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator

import pyarrow as pa
import pyarrow.parquet as pq

from occlog.io.files.tables.footer import (
    CHUNK,
    COLUMNS,
    DATA_PAGE,
    DICTIONARY_PAGE,
    GROUP_BYTES,
    GROUP_ROWS,
    NUM_ROWS,
    PACKED,
    PLACE,
    ROW_GROUPS,
    UNPACKED,
    VALUES,
)
from occlog.io.files.tables.pages import DICTIONARY, Page, read_head
from occlog.io.files.tables.salvage.marks import Group
from occlog.io.files.tables.thrift import I64, LIST, STRUCT, Field, MalformedError, Reader, Struct, written
from occlog.io.files.untrusted.content import PARQUET_MAGIC
from occlog.io.files.untrusted.promises import too_much

NEEDED = (1, 2, 3, 4)  # type, encodings, path and codec, which are those of the pattern


def pattern_of(file: bytes) -> Struct:
    """The footer of a Parquet file that is whole."""
    (length,) = struct.unpack_from("<I", file, len(file) - 8)
    return Reader(file, len(file) - 8 - length).struct()


def rows_of(data: memoryview, group: Group, pattern: Struct) -> pa.Table:
    """Rows of a group.

    Args:
        data: bytes of the group, whose check sum is right.
        group: what its mark says.
        pattern: footer of a file with the same columns and at least one row.

    Raises:
        MalformedError, pyarrow.ArrowException: its pages are not those of these columns.
    """
    _, patterns = pattern[ROW_GROUPS].value
    columns = patterns[0][COLUMNS].value[1]
    if len(columns) != len(group.values):
        raise MalformedError(f"{len(group.values)} columns where there should be {len(columns)}")
    chunks, at = [], 0
    for column, values in zip(columns, group.values, strict=True):
        chunk, at = _chunk(data, at, values, column[CHUNK].value)
        chunks.append(chunk)
    if at != len(data):
        raise MalformedError("more pages than its columns have")
    unpacked = sum(c[CHUNK].value[UNPACKED].value for c in chunks)
    if fault := too_much(len(data), group.rows, unpacked):
        raise MalformedError(fault)
    own: Struct = {
        COLUMNS: Field(LIST, (STRUCT, chunks)),
        GROUP_BYTES: Field(I64, unpacked),
        GROUP_ROWS: Field(I64, group.rows),
    }
    footer = written({**pattern, NUM_ROWS: Field(I64, group.rows), ROW_GROUPS: Field(LIST, (STRUCT, [own]))})
    whole = b"".join([PARQUET_MAGIC, data, footer, struct.pack("<I", len(footer)), PARQUET_MAGIC])
    return pq.ParquetFile(io.BytesIO(whole), page_checksum_verification=True).read()


def _chunk(data: memoryview, begin: int, values: int, pattern: Struct) -> tuple[Struct, int]:
    """The description of a column of a group that begins at a byte, and where it ends."""
    dictionary, first, unpacked, found, at = None, begin, 0, 0, begin
    for stop, page in _pages(data, begin):
        if page.kind == DICTIONARY:
            dictionary, first = at, stop
        unpacked += page.unpacked + (stop - at - page.packed)
        found, at = found + page.values, stop
        if found >= values and page.values:
            break
    if found != values:
        raise MalformedError(f"{found} numbers in a column that should have {values}")
    told: Struct = {number: pattern[number] for number in NEEDED}
    told |= {
        VALUES: Field(I64, values),
        UNPACKED: Field(I64, unpacked),
        PACKED: Field(I64, at - begin),
        DATA_PAGE: Field(I64, len(PARQUET_MAGIC) + first),
    }
    if dictionary is not None:
        told[DICTIONARY_PAGE] = Field(I64, len(PARQUET_MAGIC) + dictionary)
    return {PLACE: Field(I64, 0), CHUNK: Field(STRUCT, told)}, at


def _pages(data: memoryview, at: int) -> Iterator[tuple[int, Page]]:
    """Where each page from a byte on ends, and its head."""
    while at < len(data):
        page = read_head(data, at)
        at = page.begin + page.packed
        if at > len(data):
            raise MalformedError("a page that is longer than its group")
        yield at, page
