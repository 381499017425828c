"""What the footer of a Parquet file says of its groups of rows: how large they are, and where their columns are.

The library gives this as well, but takes a kilobyte for a column that needs three bytes, and a footer whose statistics
do not fit its columns ends the process there. So the footer is read here first, and refused where it says more than a
file of its size can hold.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from sys import intern
from typing import NamedTuple

from occlog.errors import InputError

from .check_sums import Checked
from .thrift import BINARY, I32, I64, SHORT, STRUCT, VARINT, MalformedError, Reader, from_varint

# Fields of Parquet's structures, by the numbers of its definition
SCHEMA, NUM_ROWS, ROW_GROUPS, ENCRYPTION = 2, 3, 4, 8  # of the footer
COLUMNS, GROUP_BYTES, GROUP_ROWS = 1, 2, 3  # of a group of rows
PLACE, CHUNK = 2, 3  # of a column of a group
PATH, VALUES, UNPACKED, PACKED, DATA_PAGE, DICTIONARY_PAGE, STATISTICS = 3, 5, 6, 7, 9, 11, 12  # of its description
GREATEST, LEAST = 5, 6  # of its statistics
LENGTH = struct.Struct("<I4s")
"""What a file ends with: bytes of the footer, and a mark."""
ENCRYPTED = "is encrypted (Parquet), and occlog takes no keys; write it again without encryption"
UNREAD = {
    b"PARE": ENCRYPTED,
    b"FEA1": "is in version 1 of Feather, which is not read; write it as Parquet, or as version 2 (Arrow)",
}
"""What a file is that ends with another mark, and what to do."""
FREE_CHUNKS, BYTES_PER_CHUNK = 250_000, 1000
"""Columns of all groups of rows together that any file may have, and bytes of the file for each one more."""
FREE_STEPS, BYTES_PER_STEP = 2_000_000, 50
"""Bytes of any footer, without texts and what is described as mostly, and bytes of the file for each one more."""
MAX_PARTS = 50_000
"""Columns and parts of columns that a schema has at most."""


def _usual() -> tuple[re.Pattern[bytes], re.Pattern[bytes]]:
    """How a column is mostly described: what stands before its name, and what behind it."""
    encodings, longs, counted = (
        b"|".join(re.escape(bytes([count << 4 | kind])) + b"(?:%b){%d}" % (item, count) for count in range(1, 15))
        for kind, item in ((I32, VARINT), (I64, VARINT), (STRUCT, rb"(?:\x15%b){3}\x00" % VARINT))
    )
    before = rb"\x26%b\x1c\x15%b\x19(?:%b)\x19\x18([\x00-\x7f])" % (VARINT, VARINT, encodings)
    behind = (
        rb"\x15N(?:\x16N){2}\x16(?P<size>N)\x26(?P<data>N)"  # codec, number of values, sizes, place of the data
        rb"(?:\x26(?P<dictionary>N)(?:\x1cS)?|\x3cS)?"  # place of the dictionary, statistics
        rb"(?:[\x19\x29\x49](?:C))?"  # how many pages there are of each encoding
        rb"(?:[\x3c\x4c\x5c](?:\x16N)?(?:[\x19\x29\x39](?:\x06|L))*\x00)?"  # histograms
        rb"\x00(?:[\x15\x16\x25\x26\x35\x36]N)*\x00"  # the description ends; places of indices; the column ends
    )
    for name, part in ((b"S", SHORT), (b"C", counted), (b"L", longs), (b"N", VARINT)):
        behind = behind.replace(name, part)
    return re.compile(before, re.DOTALL), re.compile(behind, re.DOTALL)


_BEFORE, _BEHIND = _usual()


class Chunk(NamedTuple):
    """A column of a group of rows.

    Attributes:
        path: names of the column and of what is in it, e.g. `("views", "list", "element")`.
        begin: its first byte.
        end: the byte after its last.
    """

    path: tuple[str, ...]
    begin: int
    end: int


class Group(NamedTuple):
    """A group of rows.

    Attributes:
        rows: how many there are.
        unpacked: what they unpack to [bytes].
        chunks: the columns.
        first: where in the footer the first of them is described.
    """

    rows: int
    unpacked: int
    chunks: list[Chunk]
    first: int


def read_groups(source: Checked) -> list[Group]:
    """The groups of rows of a file, of which none share bytes.

    MalformedError for a footer that does not say where they are, or that says more than such a file can hold;
    InputError for a file that is encrypted, or in another format.
    """
    reader, groups, rows = _reader(source), list[Group](), -1
    left, room = FREE_CHUNKS + source.size // BYTES_PER_CHUNK, source.size
    for number, kind in reader.fields():
        if number == NUM_ROWS:
            rows = reader.long(kind)
        elif number == SCHEMA:
            if len(parts := reader.items(kind, STRUCT)) > MAX_PARTS:
                raise MalformedError(f"{len(parts)} columns and parts of columns; at most {MAX_PARTS} are read")
            for _ in parts:
                reader.skip(STRUCT)
        elif number == ROW_GROUPS:
            for _ in reader.items(kind, STRUCT):
                groups.append(group := _group(reader, left))
                left, room = left - len(group.chunks), room - sum(chunk.end - chunk.begin for chunk in group.chunks)
                if any(chunk.end > source.size for chunk in group.chunks):
                    raise MalformedError("a column beyond the end of the file")
                if room < 0:
                    raise MalformedError("its columns have more bytes than the file")
        elif number == ENCRYPTION and kind == STRUCT:
            raise InputError(f"{source.path}: {ENCRYPTED}")
        else:
            reader.skip(kind)
    if rows != sum(group.rows for group in groups):
        raise MalformedError(f"{rows} rows, in groups of {sum(group.rows for group in groups)}")
    return groups


def read_spans(source: Checked) -> Iterator[tuple[bytes, bytes]]:
    """The least and the greatest value of the first column in each group of rows whose statistics have them.

    They are as the column stores them.
    """
    reader = _reader(source)
    for group in read_groups(source):
        if not group.chunks:
            continue
        reader.at = group.first
        described = reader.struct().get(CHUNK)
        told = described.value.get(STATISTICS) if described and described.kind == STRUCT else None
        span = (told.value.get(LEAST), told.value.get(GREATEST)) if told and told.kind == STRUCT else (None, None)
        if span[0] and span[1] and span[0].kind == span[1].kind == BINARY:
            yield span[0].value, span[1].value


def _reader(source: Checked) -> Reader:
    """Reads the footer."""
    length, mark = LENGTH.unpack(source.peek(source.size - LENGTH.size, LENGTH.size))
    if mark in UNREAD:
        raise InputError(f"{source.path}: {UNREAD[mark]}")
    if length > source.size - LENGTH.size:
        raise MalformedError("a footer that is longer than the file")
    data = source.peek(source.size - LENGTH.size - length, length)
    return Reader(data, left=FREE_STEPS + source.size // BYTES_PER_STEP)


def _group(reader: Reader, most: int) -> Group:
    """The group of rows that begins here, of so many columns at most."""
    rows, unpacked, chunks, first = -1, -1, list[Chunk](), -1
    for number, kind in reader.fields():
        if number == COLUMNS:
            if len(columns := reader.items(kind, STRUCT)) > most:
                raise MalformedError("groups of rows with more columns than a file of its size can have")
            first = reader.at
            chunks = [_usual_column(reader) or _column(reader) for _ in columns]
        elif number == GROUP_BYTES:
            unpacked = reader.long(kind)
        elif number == GROUP_ROWS:
            rows = reader.long(kind)
        else:
            reader.skip(kind)
    if min(rows, unpacked) < 0:
        raise MalformedError("a group of rows without its sizes")
    return Group(rows, unpacked, chunks, first)


def _usual_column(reader: Reader) -> Chunk | None:
    """The column that begins here, where it is described as mostly: in a tenth of the time."""
    before = _BEFORE.match(reader.data, reader.at)
    if before is None:
        return None
    name, stop = before.end(), before.end() + before.group(1)[0]
    behind = _BEHIND.match(reader.data, stop)
    if behind is None:
        return None
    reader.at = behind.end()
    size, data, dictionary = (from_varint(n) if n else 0 for n in behind.group("size", "data", "dictionary"))
    return _chunk((intern(str(reader.data[name:stop], errors="replace")),), size, data, dictionary)


def _column(reader: Reader) -> Chunk:
    chunk = None
    for number, kind in reader.fields():
        if number == CHUNK and kind == STRUCT:
            chunk = _described(reader)
        else:
            reader.skip(kind)
    if chunk is None:
        raise MalformedError("a column without a description")
    return chunk


def _described(reader: Reader) -> Chunk:
    path: tuple[str, ...] = ()
    size, data, dictionary = -1, -1, 0
    for number, kind in reader.fields():
        if number == PATH:
            path = tuple(intern(str(reader.text(BINARY), errors="replace")) for _ in reader.items(kind, BINARY))
        elif number == PACKED:
            size = reader.long(kind)
        elif number == DATA_PAGE:
            data = reader.long(kind)
        elif number == DICTIONARY_PAGE:
            dictionary = reader.long(kind)
        else:
            reader.skip(kind)
    return _chunk(path, size, data, dictionary)


def _chunk(path: tuple[str, ...], size: int, data: int, dictionary: int) -> Chunk:
    if min(size, data) < 0 or not path:
        raise MalformedError("a column without its name, its size or its place")
    # Of a column without values there is no page of data, but of its dictionary
    begin = dictionary if dictionary > 0 and (dictionary < data or not data) else data
    return Chunk(path, begin, begin + size)
