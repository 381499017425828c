"""Reading of tables from Parquet, with check sums of pages and footer verified.

Also the header of a table without its rows: name, units, columns, times, provenance. Batches with list columns are
split, since every row takes as much memory as the longest list.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.io.files.limits import check_declared_size, check_input, max_decompressed_bytes
from occlog.io.files.provenance import PROVENANCE_KEY, Provenance, provenance_from_json
from occlog.records.columns import ColumnTable, check_copies
from occlog.records.tables import has_all_columns

from .arrow import SCHEMA_KEY, UNIT_KEY, T, check_schema, check_statements, from_arrow
from .sizes import SizedFile, read_groups
from .table_writer import ROWS_PER_GROUP

NUMBERS_AT_ONCE = 1 << 23
"""Numbers of a column that are made at one time."""
BYTES_PER_NUMBER = 8


def in_parts(path: Path, size: int, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """Split record batches into parts of so few rows that the vectors of a column take limited memory.

    Args:
        path: the file that they are from.
        size: of the file [bytes].
        batches: record batches.

    Raises:
        InputError: the longest vectors, in all rows, take more memory than a file of its size may need.
    """
    total, most = 0, max_decompressed_bytes(size)
    for batch in batches:
        widths = {name: _width(batch.column(name)) for name in batch.schema.names}
        name, width = max(widths.items(), key=lambda item: item[1], default=("", 0))
        total += BYTES_PER_NUMBER * width * batch.num_rows
        if total > most:
            raise InputError(
                f"{path}: column {name}: a list of {width} numbers among {batch.num_rows} rows, each of which takes as "
                "much memory as the longest list; write lists of one length",
                id="input-too-large",
            )
        step = max(NUMBERS_AT_ONCE // max(width, 1), 1)
        for start in range(0, batch.num_rows, step):
            yield batch.slice(start, step)


def _width(column: pa.Array) -> int:
    """Length of the longest list in a column; 0 for a column without lists."""
    kind = column.type
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size)
    if not (pa.types.is_list(kind) or pa.types.is_large_list(kind)):
        return 0
    return int(pc.max(pc.list_value_length(column)).as_py() or 0)


@contextmanager
def translate_read_errors(path: Path) -> Iterator[None]:
    """Context manager that converts exceptions of the Parquet library to InputError that names the file `path`."""
    try:
        yield
    except InputError as error:
        raise error if str(path) in str(error) else InputError(f"{path}: {error}") from error
    except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(
            f"{path}: damaged or not a Parquet file ({reason}); make it again", id="damaged-file"
        ) from error


@contextmanager
def opened_table(path: Path) -> Iterator[SizedFile]:
    """Context manager: opened Parquet file; failures to read it within the block become InputError."""
    check_input(path, "a Parquet file")
    with translate_read_errors(path), open_parquet(path) as file:
        yield file


@contextmanager
def open_parquet(path: Path) -> Iterator[SizedFile]:
    """Context manager: opened Parquet file, with check sums of pages verified on reading.

    Raises:
        InputError: the check sum of its metadata is wrong, or its footer declares more than a file of its size can
            hold, so that reading it would fill the memory.
        pyarrow.ArrowException, OSError: it is damaged.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        groups = read_groups(path, file, size)
        rows, unpacked = sum(group.rows for group in groups), max((group.unpacked for group in groups), default=0)
        check_declared_size(path, size, rows, unpacked)
        metadata = pq.read_metadata(file)
        # Of texts each is unpacked once, not for every row that refers to it
        texts = [field.name for field in metadata.schema.to_arrow_schema() if _is_text(field.type)]
        options = {"metadata": metadata, "read_dictionary": texts, "page_checksum_verification": True}
        opened = SizedFile(path, file, size, groups, **options)
        check_statements(path, statements_of(opened))
        yield opened


def statements_of(file: pq.ParquetFile) -> dict[bytes, bytes]:
    """Metadata of a table file: entries of its schema, replaced by those added to the footer after the last row."""
    return {**(file.schema_arrow.metadata or {}), **(file.metadata.metadata or {})}


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def is_ours(path: Path) -> bool:
    """Whether a Parquet file has the schema metadata of occlog; InputError for a damaged file."""
    with opened_table(path) as file:
        return SCHEMA_KEY.encode() in (file.schema_arrow.metadata or {})


def schema_name_of(path: Path, schema: pa.Schema) -> str:
    """Name of the table in the metadata of an Arrow schema.

    InputError, with the file `path`, if occlog did not write it.
    """
    raw = (schema.metadata or {}).get(SCHEMA_KEY.encode())
    if raw is None:
        raise InputError(
            f"{path}: not an occlog table: no metadata {SCHEMA_KEY!r}; give a file that occlog wrote",
            id="unknown-format",
        )
    return str(raw.decode()).split("/", maxsplit=1)[0]


def iter_table(path: Path, table: type[T], rows: int = ROWS_PER_GROUP) -> Iterator[T]:
    """Yield the chunks of a table in a Parquet file, in file order, of at most `rows` rows each.

    Raises:
        InputError: the file is damaged, holds another table, declares more than a file of its size can hold, is not
            sorted by time, or has duplicate rows.
    """
    with opened_table(path) as file:
        check_schema(path, file.schema_arrow, table)
        names = [c.name for c in table.columns() if c.name in file.schema_arrow.names]
        whole = has_all_columns(table)
        last: T | None = None
        held: T | None = None
        size, texts = path.stat().st_size, 0
        most = max_decompressed_bytes(size)
        for batch in in_parts(path, size, batches(file, rows, names)):
            chunk = from_arrow(batch, table)
            if not len(chunk):
                continue
            texts += sum(getattr(chunk, c.name).nbytes for c in table.columns() if c.kind == "U")
            if texts > most:
                raise InputError(
                    f"{path}: texts need more than {most} bytes in a file of {size}, since every row takes as much as "
                    "the longest; shorten the longest",
                    id="input-too-large",
                )
            if last is not None and chunk.t_ns[0] < last.t_ns[-1]:  # type: ignore[attr-defined]
                raise InputError(f"{path}: t_ns goes back; sort the table by t_ns", id="unsorted-times")
            if whole:
                check_copies(chunk)
                held = _check_beside(held, chunk)
            last = chunk
            yield chunk


def _check_beside(held: T | None, chunk: T) -> T:
    """InputError for duplicate rows of one time that is split over chunks.

    Args:
        held: result of the call for the previous chunk; None: there was none.
        chunk: the next chunk.

    Returns:
        Rows of the last time, for the next call; at most `ROWS_PER_GROUP`.
    """
    times: Ints = chunk.t_ns  # type: ignore[attr-defined]
    last = chunk.take(slice(int(np.searchsorted(times, times[-1])), None))
    if held is None or held.t_ns[0] != times[0]:  # type: ignore[attr-defined]
        return last
    first = chunk.take(slice(0, int(np.searchsorted(times, times[0], "right"))))
    both = chunk.concat([held, first])
    check_copies(both)
    return both.take(slice(-ROWS_PER_GROUP, None)) if times[0] == times[-1] else last


def batches(file: pq.ParquetFile, rows: int, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
    """Yield record batches of a Parquet file in file order, of at most `rows` rows; memory does not grow with the file.

    Each call of the library reads the few row groups that have `rows` rows together, since it keeps what it has read
    until the call ends.

    Args:
        file: opened file.
        rows: rows of a batch at most.
        columns: names; None: all.
    """
    groups: list[int] = []
    together = 0
    for number in range(file.num_row_groups):
        groups.append(number)
        together += file.metadata.row_group(number).num_rows
        if together >= rows or number == file.num_row_groups - 1:
            yield from file.iter_batches(batch_size=rows, columns=columns, row_groups=groups)
            groups, together = [], 0


@dataclass(frozen=True)
class RowGroup:
    """A row group of a table in a Parquet file, readable even if others are damaged.

    Attributes:
        path: the file.
        file: the opened file.
        table: type of the table.
        number: index of the group in the file.
        first: number of its first row in the file.
        rows: number of its rows.
    """

    path: Path
    file: SizedFile
    table: type[ColumnTable]
    number: int
    first: int
    rows: int

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows of the group in record batches with the columns of the table; InputError if damaged."""
        names = [c.name for c in self.table.columns() if c.name in self.file.schema_arrow.names]
        with translate_read_errors(self.path):
            found = self.file.iter_batches(batch_size=ROWS_PER_GROUP, row_groups=[self.number], columns=names)
            yield from in_parts(self.path, self.path.stat().st_size, found)


def groups_of(path: Path, tables: Mapping[str, type[ColumnTable]]) -> Iterator[RowGroup]:
    """Yield the row groups of a table in a Parquet file, which stays open until the end.

    `tables` are the known tables by name. InputError if the file holds none of them, or lacks columns.
    """
    with opened_table(path) as file:
        name, first = schema_name_of(path, file.schema_arrow), 0
        if name not in tables:
            raise InputError(
                f"{path}: holds {name!r}, which is no table of this version; update occlog", id="version-mismatch"
            )
        check_schema(path, file.schema_arrow, tables[name])
        for number in range(file.metadata.num_row_groups):
            rows = file.metadata.row_group(number).num_rows
            yield RowGroup(path, file, tables[name], number, first, rows)
            first += rows


def read_table(path: Path, table: type[T]) -> T:
    """Read a whole table from a Parquet file into memory; InputError if it is damaged, unsorted, or another table."""
    return table.concat(iter_table(path, table))


def arrow_schema_of(path: Path) -> pa.Schema:
    """Arrow schema of a Parquet file as written, with its metadata."""
    with opened_table(path) as file:
        return file.schema_arrow


def arrow_batches(path: Path, rows: int = ROWS_PER_GROUP) -> Iterator[pa.RecordBatch]:
    """Yield a Parquet file as record batches of at most `rows` rows; only sizes and check sums are verified."""
    with opened_table(path) as file:
        yield from batches(file, rows)


class TableHeader(NamedTuple):
    """Header of a table file: name of the table, unit of its lengths, and provenance."""

    table: str
    length_unit: str
    provenance: Provenance


def read_header(path: Path) -> TableHeader:
    """Name, length unit and provenance of a table file; InputError if occlog did not write it."""
    with opened_table(path) as file:
        entries, name = statements_of(file), schema_name_of(path, file.schema_arrow)
        return TableHeader(name, _unit(entries), _provenance(entries, path))


def read_provenance(path: Path) -> Provenance:
    """Provenance of a Parquet file; that of external files (`UNKNOWN`) if it has none."""
    with opened_table(path) as file:
        return _provenance(statements_of(file), path)


def _provenance(entries: Mapping[bytes, bytes], path: Path) -> Provenance:
    return provenance_from_json(entries.get(PROVENANCE_KEY.encode(), b""), path)


def _unit(entries: Mapping[bytes, bytes]) -> str:
    return entries.get(UNIT_KEY.encode(), b"m").decode(errors="replace")


class TableDescription(TypedDict):
    """Description of a table file, as JSON-compatible values."""

    schema: str  # name of the table
    version: int  # of the schema; 0: not stated
    rows: int
    length_unit: str
    columns: list[dict[str, str]]  # name, type, and what the file states about it
    time_ns: list[int] | None  # first and last time; None: not stated
    provenance: dict[str, Any]


def describe(path: Path) -> TableDescription:
    """Describe a table file: name, version, rows, columns with units, time span, provenance; rows are not read."""
    with opened_table(path) as file:
        schema, name = file.schema_arrow, schema_name_of(path, file.schema_arrow)
        columns = [
            {
                "name": f.name,
                "type": str(f.type),
                **{k.decode(): v.decode() for k, v in (f.metadata or {}).items()},
            }
            for f in schema
        ]
        entries = statements_of(file)
        _provenance(entries, path)
        made = entries.get(PROVENANCE_KEY.encode(), b"")
        return {
            "schema": name,
            "version": int((schema.metadata or {})[SCHEMA_KEY.encode()].decode().partition("/")[2] or 0),
            "rows": file.metadata.num_rows,
            "length_unit": _unit(entries),
            "columns": columns,
            "time_ns": _time_span(file),
            "provenance": json.loads(made) if made else {},
        }


def first_rows(path: Path, rows: int) -> dict[str, list[object]]:
    """First `rows` rows of a Parquet file, as Python values by column; columns of lists are omitted."""
    with opened_table(path) as file:
        names = [f.name for f in file.schema_arrow if not pa.types.is_nested(f.type)]
        batch = next(batches(file, rows, names), None)
        return {} if batch is None else {name: batch.column(name).to_pylist() for name in names}


def _time_span(file: SizedFile) -> list[int] | None:
    """First and last value of the first column, if it has int64 times [ns]; None otherwise or without rows."""
    if not len(file.schema_arrow) or not pa.types.is_int64(file.schema_arrow.field(0).type):
        return None  # times of another program
    groups = [n for n in range(file.num_row_groups) if file.metadata.row_group(n).num_rows]
    ends = [pa.Table.from_batches(_times(file, n)).column(0) for n in groups[:1] + groups[-1:]]
    first, last = (ends[0][0].as_py(), ends[-1][-1].as_py()) if ends else (None, None)
    return None if first is None or last is None else [first, last]


def _times(file: SizedFile, group: int) -> list[pa.RecordBatch]:
    return list(file.iter_batches(ROWS_PER_GROUP, [group], file.schema_arrow.names[:1]))
