"""Size checks of a Parquet file before the library allocates memory.

The library trusts the footer and page headers: a file of a kilobyte may declare gigabytes, and inconsistent size
statistics crash the process. Both are parsed here first, as far as they declare sizes. Sources: parquet.thrift of the
Parquet format, and the compact protocol of Apache Thrift.
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import IO, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from occlog.errors import InputError
from occlog.io.files.limits import max_decompressed_bytes

TRUE, FALSE, BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, MAP, STRUCT = range(1, 13)  # types of the protocol
SCHEMA, NUM_ROWS, ROW_GROUPS, ENCRYPTION = 2, 3, 4, 8  # fields of FileMetaData
COLUMNS, GROUP_BYTES, GROUP_ROWS = 1, 2, 3  # of RowGroup
CHUNK = 3  # of ColumnChunk: its ColumnMetaData
PATH, PACKED, DATA_PAGE, DICTIONARY_PAGE = 3, 7, 9, 11  # of ColumnMetaData
PAGE_UNPACKED, PAGE_PACKED, PAGE_HEADS, PAGE_VALUES = 2, 3, (5, 8), 1  # of PageHeader, and of its data page headers
MAX_DEPTH = 16
MAX_ITEMS = 1_000_000
MAX_PARTS = 50_000
"""Elements of a schema at most."""
FREE_CHUNKS, BYTES_PER_CHUNK = 250_000, 1000
"""Column chunks that any file may have, and bytes of the file for each one more."""
FREE_STEPS, BYTES_PER_STEP = 2_000_000, 10
"""Bytes of any footer, without texts, and bytes of the file for each one more."""
MAX_KEPT_BYTES = 50_000
"""Length of a footer of which the row groups are kept: a command opens each of its tables many times."""
BYTES_PER_VALUE = 8
HEAD_WINDOWS = (256, 1 << 24)
"""Bytes in which a page header is searched for: most have 40 bytes, some have long statistics."""
END = struct.Struct("<I4s")
"""Last bytes of a file: length of the footer, and a magic number."""
ENCRYPTED = "is encrypted (Parquet), and occlog takes no keys; write it again without encryption"
UNREAD = {
    b"PARE": ENCRYPTED,
    b"FEA1": "is in version 1 of Feather, which is not read; write it as Parquet, or as version 2 (Arrow)",
}
"""Formats with other last bytes, and what to do."""
Columns = frozenset[str] | None
"""Names of the columns that are read; None: all."""


class MalformedError(ValueError):
    """Bytes that are not a valid footer or page header."""


class CompactReader:
    """Cursor over values in Thrift's compact protocol.

    Attributes:
        data: the bytes.
        at: index of the next byte.
        left: bytes that may still be decoded, not counting those of texts; MalformedError for more.
    """

    def __init__(self, data: bytes, left: int) -> None:
        """Start at the first byte of `data`; `left` limits the bytes that are decoded, without those of texts."""
        self.data, self.at, self.left = data, 0, left

    def fields(self) -> Iterator[tuple[int, int]]:
        """Yield number and type of each field of a struct; the caller reads or skips each value before the next.

        MalformedError for numbers that do not ascend, since the meaning of a repeated field is undefined.
        """
        number = 0
        while (head := self._byte()) != 0:
            before, step = number, head >> 4
            number = number + step if step else self._zigzag()
            if number <= before and before:
                raise MalformedError("fields that do not ascend")
            yield number, head & 15

    def integer(self, kind: int, expected: int = I64) -> int:
        """Read an integer; MalformedError if the type of its field, `kind`, is not the one `expected`."""
        if kind != expected:
            raise MalformedError("the metadata has a field of another type where a number is expected")
        return self._zigzag()

    def items(self, kind: int, of: int) -> range:
        """Read the head of a list, and return the indices of its items, each of which the caller reads or skips next.

        MalformedError if the type `kind` of the field is not a list, or its items are not of the type `of`.
        """
        if kind != LIST:
            raise MalformedError("the metadata has a field of another type where a list is expected")
        found, count = self._list_head()
        if found != of and count:
            raise MalformedError("a list with items of another type")
        return range(count)

    def text(self) -> str:
        """Read a text; bytes that are not UTF-8 are replaced."""
        self._pass(size := self._varint())
        return self.data[self.at - size : self.at].decode(errors="replace")

    def skip(self, kind: int, depth: int = 0, *, in_list: bool = False) -> None:
        """Skip a value of the type `kind`; MalformedError for an unknown type, or more than `MAX_DEPTH` nested values.

        Args:
            kind: type of the value.
            depth: how deeply the value is nested.
            in_list: it is an item of a list, in which a Boolean takes a byte; that of a field is part of its type.
        """
        if depth > MAX_DEPTH:
            raise MalformedError("values nested too deeply")
        if kind in (I16, I32, I64):
            self._varint()
        elif kind == BINARY:
            self._pass(self._varint())
        elif kind == STRUCT:
            for _, each in self.fields():
                self.skip(each, depth + 1)
        elif kind in (LIST, SET):
            of, count = self._list_head()
            for _ in range(count):
                self.skip(of, depth + 1, in_list=True)
        elif kind == DOUBLE:
            self._pass(8)
        elif kind == BYTE or (in_list and kind in (TRUE, FALSE)):
            self._pass(1)
        elif kind not in (TRUE, FALSE):
            raise MalformedError(f"a value of the unknown type {kind}")

    def _pass(self, count: int) -> None:
        if count > len(self.data) - self.at:
            raise MalformedError("the bytes end too early")
        self.at += count

    def _list_head(self) -> tuple[int, int]:
        head = self._byte()
        count = head >> 4 if head >> 4 != 15 else self._varint()
        if count > min(MAX_ITEMS, len(self.data) - self.at):
            raise MalformedError("the metadata has a list of more items than it has bytes")
        return head & 15, count

    def _byte(self) -> int:
        if self.at >= len(self.data):
            raise MalformedError("the bytes end too early")
        if self.left <= 0:
            raise MalformedError("the metadata has more values than a file of its size can have")
        self.left -= 1
        self.at += 1
        return self.data[self.at - 1]

    def _varint(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            if byte < 128:
                return value
            shift += 7
            if shift > 63:
                raise MalformedError("a number of more than 64 bits")

    def _zigzag(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)


class Chunk(NamedTuple):
    """A column chunk of a row group: name of its top-level column, and its byte range begin <= n < end in the file."""

    column: str
    begin: int
    end: int


class RowGroupSizes(NamedTuple):
    """Declared sizes of a row group: number of rows, decompressed size [bytes], and column chunks."""

    rows: int
    unpacked: int
    chunks: list[Chunk]


def read_groups(path: Path, file: IO[bytes], size: int) -> list[RowGroupSizes]:
    """Sizes of the row groups as declared in the footer of a Parquet file of `size` bytes.

    Raises:
        MalformedError: the footer is invalid, or declares more than a file of its size can hold.
        InputError: the file is encrypted, or in another format.
    """
    length, magic = END.unpack(os.pread(file.fileno(), END.size, max(size - END.size, 0)).rjust(END.size, b"\0"))
    if magic in UNREAD:
        raise InputError(f"{path}: {UNREAD[magic]}", id="damaged-file")
    if length > size - END.size:
        raise MalformedError("a footer that is longer than the file")
    footer = os.pread(file.fileno(), length, size - END.size - length)
    found = _kept_groups(footer, size) if length <= MAX_KEPT_BYTES else _groups(footer, size)
    if found is None:
        raise InputError(f"{path}: {ENCRYPTED}", id="unsupported-format")
    return found


def _groups(footer: bytes, size: int) -> list[RowGroupSizes] | None:
    """Sizes of the row groups as declared in the footer of a file of `size` bytes; None if the file is encrypted.

    MalformedError if the footer is invalid, or has too many columns.
    """
    reader, groups, rows = CompactReader(footer, FREE_STEPS + size // BYTES_PER_STEP), list[RowGroupSizes](), -1
    left, room = FREE_CHUNKS + size // BYTES_PER_CHUNK, size
    for number, kind in reader.fields():
        if number == NUM_ROWS:
            rows = reader.integer(kind)
        elif number == SCHEMA:
            if len(parts := reader.items(kind, STRUCT)) > MAX_PARTS:
                raise MalformedError(f"{len(parts)} columns, with nested ones; at most {MAX_PARTS} are read")
            for _ in parts:
                reader.skip(STRUCT)
        elif number == ROW_GROUPS:
            for _ in reader.items(kind, STRUCT):
                groups.append(group := _group(reader, left))
                left, room = left - len(group.chunks), room - sum(chunk.end - chunk.begin for chunk in group.chunks)
                if any(chunk.end > size for chunk in group.chunks):
                    raise MalformedError("a column beyond the end of the file")
                if room < 0:
                    raise MalformedError("its columns have more bytes than the file")
        elif number == ENCRYPTION and kind == STRUCT:
            return None
        else:
            reader.skip(kind)
    if rows != sum(group.rows for group in groups):
        raise MalformedError(
            f"the metadata has {rows} rows, but row groups with {sum(group.rows for group in groups)} rows in all"
        )
    return groups


_kept_groups = lru_cache(maxsize=64)(_groups)


def _group(reader: CompactReader, most: int) -> RowGroupSizes:
    rows, unpacked, chunks = -1, -1, list[Chunk]()
    for number, kind in reader.fields():
        if number == COLUMNS:
            if len(columns := reader.items(kind, STRUCT)) > most:
                raise MalformedError("the metadata has row groups with more columns than a file of its size can have")
            chunks = [_chunk(reader) for _ in columns]
        elif number == GROUP_BYTES:
            unpacked = reader.integer(kind)
        elif number == GROUP_ROWS:
            rows = reader.integer(kind)
        else:
            reader.skip(kind)
    if min(rows, unpacked) < 0:
        raise MalformedError("a group of rows without its sizes")
    return RowGroupSizes(rows, unpacked, chunks)


def _chunk(reader: CompactReader) -> Chunk:
    column, found = "", dict.fromkeys((PACKED, DATA_PAGE, DICTIONARY_PAGE), -1)
    for outer, outer_kind in reader.fields():
        if outer != CHUNK or outer_kind != STRUCT:
            reader.skip(outer_kind)
            continue
        for number, kind in reader.fields():
            if number == PATH:
                names = [reader.text() for _ in reader.items(kind, BINARY)]
                column = names[0] if names else ""
            elif number in found:
                found[number] = reader.integer(kind)
            else:
                reader.skip(kind)
    size, data, dictionary = found.values()
    if min(size, data) < 0 or not column:
        raise MalformedError("the metadata has a column without its name, its size or its position")
    # A column without values has no data page, but a dictionary
    begin = dictionary if dictionary > 0 and (dictionary < data or not data) else data
    return Chunk(column, begin, begin + size)


class Page(NamedTuple):
    """Page header: decompressed and compressed size of the data, number of values, and header length [bytes]."""

    unpacked: int
    packed: int
    values: int
    begin: int


def read_page(data: bytes) -> Page:
    """Parse the page header that begins at the first byte of `data`; MalformedError if it is invalid or cut off."""
    reader, found, values = CompactReader(data, len(data)), dict[int, int](), 0
    for number, kind in reader.fields():
        if number in (PAGE_UNPACKED, PAGE_PACKED):
            found[number] = reader.integer(kind, I32)
        elif number in PAGE_HEADS and kind == STRUCT:
            for inner, inner_kind in reader.fields():
                if inner == PAGE_VALUES:
                    values = reader.integer(inner_kind, I32)
                else:
                    reader.skip(inner_kind)
        else:
            reader.skip(kind)
    unpacked, packed = found.get(PAGE_UNPACKED, -1), found.get(PAGE_PACKED, -1)
    if min(unpacked, packed, values) < 0:
        raise MalformedError("a page header without its sizes")
    return Page(unpacked, packed, values, reader.at)


class SizedFile(pq.ParquetFile):  # type: ignore[misc]  # the library has no types
    """A `pyarrow.parquet.ParquetFile` that decompresses a row group only after its page headers have been checked.

    InputError if they declare more than a file of its size can hold; ArrowInvalid if fewer rows are read than declared.
    """

    def __init__(
        self, path: Path, file: IO[bytes], size: int, groups: Sequence[RowGroupSizes], **options: object
    ) -> None:
        """Open a Parquet file.

        Args:
            path: the file, for messages.
            file: the open file.
            size: of the file [bytes].
            groups: sizes of its row groups (`read_groups`).
            **options: of `pyarrow.parquet.ParquetFile`.
        """
        super().__init__(file, **options)
        self._path, self._file, self._size, self._groups = path, file, size, groups
        self._checked: set[tuple[Columns, int]] = set()
        self._unpacked = Counter[Columns]()  # bytes of the row groups that were checked, for each choice of columns

    def iter_batches(  # noqa: D102 - as the library's own
        self, batch_size: int, row_groups: Collection[int] | None = None, columns: Collection[str] | None = None
    ) -> Iterator[pa.RecordBatch]:
        numbers = range(self.num_row_groups) if row_groups is None else row_groups
        for number in numbers:
            self._check(number, columns)
        rows = 0
        for batch in super().iter_batches(batch_size=batch_size, row_groups=row_groups, columns=columns):
            rows += batch.num_rows
            yield batch
        self._check_rows(rows, numbers)

    def read(self, columns: Collection[str] | None = None) -> pa.Table:  # noqa: D102 - as the library's own
        for number in range(self.num_row_groups):
            self._check(number, columns)
        table = super().read(columns=columns)
        self._check_rows(table.num_rows, range(self.num_row_groups))
        return table

    def _check_rows(self, rows: int, numbers: Collection[int]) -> None:
        """ArrowInvalid unless `rows`, the number of rows that were read, is that of the row groups `numbers`.

        On some damage the library ends early, silently.
        """
        stated = sum(self._groups[number].rows for number in numbers)
        if rows != stated:
            raise pa.ArrowInvalid(f"{stated} rows are stated, and {rows} can be read")

    def _check(self, number: int, columns: Collection[str] | None) -> None:
        """InputError if the row groups read so far and this one decompress to more than a file of this size can hold.

        Args:
            number: index of the row group that is read next.
            columns: names of the columns that are read; None: all.
        """
        wanted = None if columns is None else frozenset(columns)
        if (wanted, number) in self._checked:
            return
        most, before, unpacked = max_decompressed_bytes(self._size), self._unpacked[wanted], 0
        group = self._groups[number]
        for column, begin, end in group.chunks:
            if wanted is not None and column not in wanted:
                continue
            values, at = 0, begin
            while at < end:
                page = self._page(at, end)
                values, at = values + page.values, at + page.begin + page.packed
                unpacked += page.unpacked + BYTES_PER_VALUE * min(max(values - group.rows, 0), page.values)  # of lists
                if before + unpacked > most:
                    raise InputError(
                        f"{self._path}: column {column} unpacks to more than {most} bytes in a file of {self._size} "
                        "bytes, more than measurements can; make it again",
                        id="input-too-large",
                    )
        self._checked.add((wanted, number))
        self._unpacked[wanted] += unpacked

    def _page(self, at: int, end: int) -> Page:
        """Page header at byte `at` of a column chunk that ends before byte `end`; MalformedError if invalid."""
        for window in HEAD_WINDOWS:
            try:
                return read_page(os.pread(self._file.fileno(), window, at))
            except MalformedError:
                if window == HEAD_WINDOWS[-1] or at + window >= end:
                    raise
        raise AssertionError
