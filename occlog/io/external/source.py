"""Files that may hold an external table: text with a header (also gzip), Parquet (or a folder), Arrow, trajectories.

Headers of Arrow messages are checked first for declared rows and sizes, since the library allocates what a batch
declares, and a small file may declare gigabytes. They are FlatBuffers; only the required fields are parsed.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import pyarrow as pa

from occlog.errors import InputError, abridged
from occlog.io.files.geodetic import begin_positions
from occlog.io.files.limits import PARQUET_MAGIC, STANDARD_INPUT, UTF16_MARKS, check_declared_size, check_input
from occlog.io.files.names import utf8_name
from occlog.io.files.tables.arrow import SCHEMA_KEY
from occlog.io.files.tables.parquet import batches, in_parts, open_parquet
from occlog.io.files.texts.by_reader import table_of
from occlog.io.files.texts.csv_rows import GZIP_MAGIC, commented_header, first_line, is_header, read_rows
from occlog.io.files.timing.times import TIME_COLUMNS
from occlog.io.formats.trajectories import Trajectories, find_trajectories

from .cells import ArrowCells, TableCells, TextCells
from .geodetic import GeodeticCells, GeodeticColumns, geodetic_columns
from .names import plain_name

FILE_MAGIC, STREAM_MAGIC = b"ARROW1", b"\xff\xff\xff\xff"
DICTIONARY, BATCH = 2, 3
"""Kinds of messages with a body that may be packed."""
# Fields of the format's tables, by their numbers
HEAD_KIND, HEAD, BODY_LENGTH = 1, 2, 3  # of a message
LENGTH, BUFFERS, COMPRESSION = 0, 2, 3  # of a batch
DATA = 1  # of a dictionary: its batch
DICTIONARIES, BATCHES = 2, 3  # of the footer of a file: where messages are


class ArrowMessageHeader(NamedTuple):
    """Sizes declared in the header of an Arrow message.

    Attributes:
        rows: number of rows of a record batch; 0 for a dictionary or schema.
        unpacked: size of its compressed buffers after decompression [bytes]; other buffers do not count.
    """

    rows: int
    unpacked: int


def messages(path: Path) -> Iterator[ArrowMessageHeader]:
    """Yield the declared sizes of each message (batch, dictionary, schema) of an Arrow file or stream.

    ValueError for damaged headers.
    """
    with path.open("rb") as file:
        data = _Bytes(file.fileno(), os.fstat(file.fileno()).st_size)
        is_file = file.read(len(FILE_MAGIC)) == FILE_MAGIC
        for at in _places_of_file(data) if is_file else _places_of_stream(data):
            yield _message(data, at)


class _Bytes(NamedTuple):
    """Random access to the bytes of an open file: `file` is its descriptor, `size` its length [bytes]."""

    file: int
    size: int

    def read(self, at: int, size: int) -> bytes:
        """Read `size` bytes at the offset `at`; ValueError beyond the end of the file."""
        if at < 0 or not 0 <= size <= self.size - at:
            raise ValueError(f"the Arrow message at byte {at} is truncated")
        return os.pread(self.file, size, at)


class _Table:
    """A FlatBuffers table in `data` at offset `at`.

    Its fields are found by number through its offset table (vtable).
    """

    def __init__(self, data: bytes, at: int) -> None:
        self._data, self._at = data, at
        self._offsets = at - self._number("<i", at)
        self._size = self._number("<H", self._offsets)

    def _number(self, form: str, at: int) -> Any:
        if not 0 <= at <= len(self._data) - struct.calcsize(form):
            raise ValueError("an offset points outside the header of an Arrow message")
        return struct.unpack_from(form, self._data, at)[0]

    def _offset_of(self, field: int) -> int:
        """Offset in `data` of the field with number `field`; 0 if the table does not store it."""
        entry = 4 + 2 * field
        offset = self._number("<H", self._offsets + entry) if entry + 2 <= self._size else 0
        return self._at + offset if offset else 0

    def number(self, field: int, form: str) -> int:
        """Number in the field with number `field`, of the `struct` format `form`; 0 if the table does not store it."""
        index = self._offset_of(field)
        return int(self._number(form, index)) if index else 0

    def table(self, field: int) -> _Table | None:
        """Nested table in the field with number `field`; None if missing."""
        index = self._offset_of(field)
        return _Table(self._data, index + self._number("<I", index)) if index else None

    def structs(self, field: int, form: str) -> list[tuple[int, ...]]:
        """Entries of a vector of structs in a field; empty if missing.

        Args:
            field: number of the field.
            form: `struct` format of one entry.

        Raises:
            ValueError: the vector is longer than the header.
        """
        index = self._offset_of(field)
        if not index:
            return []
        index += self._number("<I", index)
        count, size = self._number("<I", index), struct.calcsize(form)
        if count * size > len(self._data) - index - 4:
            raise ValueError("a list extends beyond the header of an Arrow message")
        return [struct.unpack_from(form, self._data, index + 4 + size * n) for n in range(count)]


def _root(data: bytes) -> _Table:
    if len(data) < 4:
        raise ValueError("the header of an Arrow message is truncated")
    return _Table(data, struct.unpack_from("<I", data)[0])


def _head(file: _Bytes, at: int) -> tuple[_Table, int]:
    """Header table of the Arrow message at the byte offset `at`, and the offset of the message's body."""
    mark, length = struct.unpack("<4si", file.read(at, 8))
    if mark != STREAM_MAGIC:
        raise ValueError(f"no Arrow message begins at byte {at}")
    return _root(file.read(at + 8, length)), at + 8 + length


def _places_of_file(file: _Bytes) -> Iterator[int]:
    """Yield the byte offsets of all dictionaries and batches of an Arrow file, as listed in its footer."""
    end = 4 + len(FILE_MAGIC)
    length, magic = struct.unpack(f"<i{len(FILE_MAGIC)}s", file.read(file.size - end, end))
    if magic != FILE_MAGIC or not 0 <= length <= file.size - end:
        raise ValueError("the Arrow file does not end with its footer")
    footer = _root(file.read(file.size - end - length, length))
    for field in (DICTIONARIES, BATCHES):
        for begin, *_ in footer.structs(field, "<qi4xq"):
            yield begin


def _places_of_stream(file: _Bytes) -> Iterator[int]:
    """Yield the byte offsets of all messages of an Arrow stream, up to its end mark or the end of the file."""
    at = 0
    while at + 8 <= file.size and file.read(at, 8) != STREAM_MAGIC + bytes(4):
        head, body = _head(file, at)
        yield at
        length = head.number(BODY_LENGTH, "<q")
        if length < 0:
            raise ValueError(f"the Arrow message at byte {at} has a body of negative size ({length} bytes)")
        at = body + length


def _message(file: _Bytes, at: int) -> ArrowMessageHeader:
    head, body = _head(file, at)
    kind, content = head.number(HEAD_KIND, "<B"), head.table(HEAD)
    batch = content.table(DATA) if content is not None and kind == DICTIONARY else content
    if kind not in (DICTIONARY, BATCH) or batch is None:  # the schema of a stream
        return ArrowMessageHeader(0, 0)
    unpacked = 0
    if batch.table(COMPRESSION) is not None:
        # The size of each buffer precedes the packed data, -1 where it is not
        offsets = [body + offset for offset, length in batch.structs(BUFFERS, "<qq") if length]
        unpacked = sum(max(struct.unpack("<q", file.read(start, 8))[0], 0) for start in offsets)
    rows = batch.number(LENGTH, "<q") if kind == BATCH else 0
    if rows < 0:
        raise ValueError(f"the Arrow message at byte {at} has a negative number of rows ({rows})")
    return ArrowMessageHeader(rows, unpacked)


TABULAR = (".csv", ".tsv", ".csv.gz", ".tsv.gz")
"""Endings of names by which a file requires to be a table, whatever it holds."""
ROWS = 65_536
MAX_PARTS = 10_000
"""Files of a table that is a folder of Parquet, at most."""
PART_SUFFIXES = (".parquet", ".pq", ".parq")
_WHOLE = re.compile(r"-?\d{1,18}")
MAX_COLUMNS = 10_000
"""Columns of a table at most: each of their names is compared with those of ours."""
WHAT = "a table"


class ColumnSource(NamedTuple):
    """A file with named columns that may hold an external table.

    Attributes:
        path: the file.
        kind: `CSV`, `Parquet`, `Arrow`, or a format of trajectories; a file that a plug-in reads is a CSV.
        names: of its columns.
        trajectories: reader of a format of trajectories; None: the file is of another kind.
        table: name of the table that a plug-in states it holds; empty: it is recognised by its columns.
        commented: the names of columns are in a first line that begins with `#`.
        parts: files of a table that is a folder of Parquet, in order; else empty.
        fps: frames per second, if the columns count frames and state no times; None: not stated.
        nested: names of columns of lists or structures.
        geodetic: columns of geodetic positions, which `names` has as scene positions; None: none.
    """

    path: Path
    kind: str
    names: tuple[str, ...]
    trajectories: Trajectories | None = None
    table: str = ""
    commented: bool = False
    parts: tuple[Path, ...] = ()
    fps: Fraction | None = None
    nested: tuple[str, ...] = ()
    geodetic: GeodeticColumns | None = None

    @property
    def size(self) -> int:
        """Size of the file, or of all parts together [bytes]."""
        return sum(part.stat().st_size for part in self.parts or (self.path,))

    @property
    def rows(self) -> int | None:
        """Number of rows of a Parquet file or folder; None for other formats, which do not state it."""
        if self.kind != "Parquet":
            return None
        total = 0
        for part in self.parts or (self.path,):
            with _translated(part, self.kind), open_parquet(part) as file:
                total += int(file.metadata.num_rows)
        return total

    def cells(self, names: Sequence[str]) -> Iterator[TableCells]:
        """Yield the cells of the columns `names` in parts, in file order.

        Geodetic positions are converted to the scene.
        """
        if self.geodetic is None:
            yield from self._plain_cells(names)
            return
        for cells in self._plain_cells(self.geodetic.read(names)):
            yield GeodeticCells(self.path, cells, self.geodetic)

    def _plain_cells(self, names: Sequence[str]) -> Iterator[TableCells]:
        """Yield the cells of the columns `names` as stored in the file, in parts, in file order."""
        if self.trajectories is not None:
            yield from map(TextCells.of, self.trajectories.read(self.path))
            return
        if self.kind == "CSV":
            columns = {name: (name.lower(),) for name in names}
            rows = read_rows(self.path, columns, WHAT, ignore_extra=True, commented=self.commented)
            yield from map(TextCells.of, rows)
            return
        for part in self.parts or (self.path,):
            with _translated(part, self.kind):
                first, of_folders = 0, _values_of_folders(self.path, part)
                for batch in _batches(part, self.kind, [name for name in names if name not in of_folders]):
                    yield ArrowCells(
                        part, _with_constants(batch, {n: of_folders[n] for n in names if n in of_folders}), first
                    )
                    first += batch.num_rows


def find_source(path: Path) -> ColumnSource | None:
    """Recognise the format and columns of a file (or Parquet folder); None if it is not an external table.

    Text is taken for a table if its first line names columns, one of them of times, or if its name ends in `TABULAR`.

    Raises:
        InputError: the file cannot be read, or has more columns than `MAX_COLUMNS`.
    """
    found = _find_source(path)
    if found is not None and len(found.names) > MAX_COLUMNS:
        raise InputError(
            f"{path}: {len(found.names)} columns; at most {MAX_COLUMNS} are read; remove those that are not needed",
            id="input-too-large",
        )
    columns = None if found is None or found.trajectories is not None else geodetic_columns(found.names)
    if found is None or columns is None:
        return found
    begin_positions()
    return found._replace(names=columns.replaced(found.names), geodetic=columns)


def parquet_parts(folder: Path) -> tuple[Path, ...]:
    """Parquet files of a folder that is one table, sorted by path; empty if the folder holds any other file.

    Spark, Dask, DuckDB and pandas write such folders; in a subfolder `id=3` all rows have that value. Files beginning
    with `_` or `.` are metadata of these programs.

    Raises:
        InputError: there are more than `MAX_PARTS` files.
    """
    found = []
    for path in sorted(islice(folder.rglob("*"), MAX_PARTS + 1)):
        if path.is_dir() or path.name.startswith(("_", ".")):
            continue
        if path.suffix.lower() not in PART_SUFFIXES:
            return ()
        found.append(path)
    if len(found) > MAX_PARTS:
        raise InputError(f"{folder}: more than {MAX_PARTS} files; write the table in fewer parts", id="input-too-large")
    return tuple(found)


def _values_of_folders(folder: Path, part: Path) -> dict[str, str]:
    """Values that subfolders state for all rows of a file in a Parquet folder: in `id=3` it is {"id": "3"}."""
    names = part.relative_to(folder).parts[:-1] if part != folder else ()
    pairs = (name.partition("=") for name in names)
    return {key: unquote(value) for key, mark, value in pairs if key and mark}


def _with_constants(batch: pa.RecordBatch, values: Mapping[str, str]) -> pa.RecordBatch:
    """Append constant columns to a batch.

    `values` are texts by column name, which become integers if they are whole numbers.
    """
    for name, text in values.items():
        value: int | str = int(text) if _WHOLE.fullmatch(text) else text
        batch = batch.append_column(name, pa.array([value] * batch.num_rows))
    return batch


def _find_parts(folder: Path) -> ColumnSource | None:
    """Columns of a folder that is a table in Parquet files; None for other folders.

    Raises:
        InputError: the files have different columns.
    """
    parts, first = parquet_parts(folder), None
    for part in parts:
        of_folders = list(_values_of_folders(folder, part))
        with _translated(part, "Parquet"), open_parquet(part) as file:
            names = (*(n for n in file.schema_arrow.names if n not in of_folders), *of_folders)
        if first is not None and set(names) != set(first):
            others = sorted(set(names) ^ set(first))
            raise InputError(
                f"{part}: columns {abridged(others[:5])} are in this file or in {parts[0].name}, but not in both; "
                "write the same columns in all files",
                id="incompatible-inputs",
            )
        first = first or names
    return None if first is None else ColumnSource(folder, "Parquet", first, parts=parts)


def _find_source(path: Path) -> ColumnSource | None:
    if path.is_dir():
        return _find_parts(path)
    check_input(path, WHAT)
    table = table_of(path)
    if table:
        return ColumnSource(path, "CSV", tuple(first_line(path, WHAT)), table=table)
    with path.open("rb") as file:
        head = file.read(8)
    if head.startswith(PARQUET_MAGIC):
        with _translated(path, "Parquet"), open_parquet(path) as file:
            schema = file.schema_arrow
            return (
                None
                if SCHEMA_KEY.encode() in (schema.metadata or {})
                else ColumnSource(path, "Parquet", tuple(schema.names), nested=_nested(schema))
            )
    if head.startswith(FILE_MAGIC) or head.startswith(STREAM_MAGIC):
        with _translated(path, "Arrow"):
            schema = _open_arrow(path).schema
            return ColumnSource(path, "Arrow", tuple(schema.names), nested=_nested(schema))
    if head.startswith(b"#") and _names_times(names := commented_header(path, WHAT)):
        return ColumnSource(path, "CSV", tuple(names), commented=True)
    if _may_be_text(head) and (found := find_trajectories(path)) is not None:
        return ColumnSource(path, found.kind, found.names, found)
    named = path.name.lower().endswith(TABULAR) or path.name == STANDARD_INPUT
    if not named and not head.startswith(GZIP_MAGIC) and not _may_be_text(head):
        return None
    try:
        line = first_line(path, WHAT)
    except InputError:
        if named:
            raise
        return None
    if is_header(line) and (named or (len(line) > 1 and _names_times(line))):
        return ColumnSource(path, "CSV", tuple(line))
    return None


def _nested(schema: pa.Schema) -> tuple[str, ...]:
    return tuple(field.name for field in schema if pa.types.is_nested(field.type))


def _names_times(names: Sequence[str]) -> bool:
    """Whether one of the column names of a file is that of times."""
    return any(plain_name(name) in spelled for name in names for spelled in TIME_COLUMNS.values())


def _may_be_text(head: bytes) -> bool:
    return b"\0" not in head or head.startswith(UTF16_MARKS)


def _open_arrow(path: Path) -> pa.ipc.RecordBatchFileReader | pa.ipc.RecordBatchStreamReader:
    with path.open("rb") as file:
        of_file = file.read(len(FILE_MAGIC)) == FILE_MAGIC
    with utf8_name(path) as name:
        source = pa.memory_map(name)
    return pa.ipc.open_file(source) if of_file else pa.ipc.open_stream(source)


def _batches(path: Path, kind: str, names: list[str]) -> Iterator[pa.RecordBatch]:
    """Yield record batches of the columns `names` of a file, of at most `ROWS` rows; `kind` is `Parquet` or `Arrow`."""
    if kind == "Parquet":
        with open_parquet(path) as file:
            found = (_validated(batch) for batch in batches(file, ROWS, names))
            yield from in_parts(path, path.stat().st_size, found)
        return
    yield from in_parts(path, path.stat().st_size, _arrow_batches(path, names))


def _arrow_batches(path: Path, names: list[str]) -> Iterator[pa.RecordBatch]:
    _check_messages(path)
    reader = _open_arrow(path)
    several = (
        (reader.get_batch(n) for n in range(reader.num_record_batches))
        if isinstance(reader, pa.ipc.RecordBatchFileReader)
        else iter(reader)
    )
    for whole in several:
        batch = _validated(whole.select(names))
        for start in range(0, batch.num_rows, ROWS):
            yield batch.slice(start, ROWS)


def _validated(batch: pa.RecordBatch) -> pa.RecordBatch:
    """Return the batch after validation of offsets, dictionary indices and UTF-8.

    pyarrow does not check these on reading. ValueError (ArrowInvalid) if it is invalid.
    """
    batch.validate(full=True)
    return batch


def _check_messages(path: Path) -> None:
    """InputError if all messages of an Arrow file declare more rows or bytes than a file of its size can hold."""
    size, rows, unpacked = path.stat().st_size, 0, 0
    for message in messages(path):
        rows, unpacked = rows + message.rows, unpacked + message.unpacked
        check_declared_size(path, size, rows, unpacked)  # of all together: a footer may list a batch many times


@contextmanager
def _translated(path: Path, kind: str) -> Iterator[None]:
    """Context manager that converts all exceptions of pyarrow to InputError; `kind` is `Parquet` or `Arrow`."""
    try:
        yield
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(
            f"{path}: damaged or not {'an' if kind == 'Arrow' else 'a'} {kind} file ({reason}); make it again",
            id="damaged-file",
        ) from error
