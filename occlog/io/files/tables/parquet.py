"""Tables to Parquet and back, the schema derived from the declared columns.

Files are zstd-compressed, with check sums of every byte that are verified on reading: without
them a damaged page is read as wrong numbers, and a damaged footer as other units and losses.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self, TypedDict, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from occlog.errors import InputError, UsageError
from occlog.io.files.atomic import Together, open_output
from occlog.io.files.guard import check_texts
from occlog.io.files.inputs import check_input
from occlog.io.files.provenance import PROVENANCE_KEY, Provenance, provenance_from_json
from occlog.io.files.tables.arrow_arrays import to_numpy
from occlog.io.files.tables.check_sums import Checked, Summed
from occlog.io.files.tables.salvage.marks import mark_of_group, mark_of_schema
from occlog.records.columns import ANY, Column, Table, check_copies
from occlog.records.tables import TABLES

SCHEMA_KEY = "occlog.schema"
MAGIC = b"PAR1"
ROWS_PER_GROUP = 65_536
BYTES_PER_GROUP = 4 * 1024 * 1024
FREE_ROWS, MAX_ROWS_PER_BYTE = 1_000_000, 20
"""Rows that any file may promise, and above that for each of its bytes: a row of measured numbers takes 2 bytes or
more, however well it is packed."""
FREE_BYTES, MAX_GROWTH = 128 * 1024 * 1024, 1000
"""Unpacked bytes of a group of rows that any file may promise, and above that for each of its bytes."""
WRITTEN: dict[str, Any] = {
    "version": "2.6",
    "compression": "zstd",
    "compression_level": 3,
    "write_page_checksum": True,
}
"""How pages are written."""
NAMED_OTHERWISE = (
    *(".csv", ".tsv", ".txt", ".json", ".jsonl", ".geojson", ".xlsx", ".feather", ".arrow", ".npz", ".mat"),
    *(".yaml", ".yml", ".html", ".png", ".svg", ".mcap", ".mp4", ".gz"),
)
"""Endings of names that promise another format than that of tables."""
T = TypeVar("T", bound=Table)

_ARROW = {
    "i8": pa.int64(),
    "i4": pa.int32(),
    "f8": pa.float64(),
    "f4": pa.float32(),
    "?": pa.bool_(),
    "U": pa.dictionary(pa.int32(), pa.string()),
}


LENGTHS = ("m", "m^2", "m/s", "m^2/s", "m^2/s^2")
"""Units in which m stands for the scene's unit of length."""


def arrow_field(c: Column, unit: str) -> pa.Field:
    """Arrow field of a column with its unit, meaning and the meaning of NaN as metadata."""
    kind = _ARROW[c.kind]
    if c.width:
        kind = pa.list_(kind) if c.width == ANY else pa.list_(kind, c.width)
    metadata = {"unit": unit, "doc": c.doc}
    if c.nan is not None:
        metadata["nan"] = c.nan
    return pa.field(c.name, kind, nullable=False, metadata=metadata)


def arrow_schema(table: type[Table], provenance: Provenance, length_unit: str = "m") -> pa.Schema:
    """Arrow schema of a table; `length_unit` replaces metres in the units."""
    fields = [
        arrow_field(c, c.unit.replace("m", length_unit) if c.unit in LENGTHS else c.unit) for c in table.columns()
    ]
    metadata = {
        SCHEMA_KEY: f"{table.NAME}/{table.VERSION}",
        "occlog.key": ",".join(table.KEY),
        "occlog.length_unit": length_unit,
        PROVENANCE_KEY: provenance.json(),
    }
    return pa.schema(fields).with_metadata(metadata)


def to_arrow(table: Table, schema: pa.Schema) -> pa.Table:
    """Arrow table of a record."""
    arrays = []
    for c, f in zip(table.columns(), schema, strict=True):
        values = getattr(table, c.name)
        if c.width:
            flat = pa.array(np.ascontiguousarray(values).reshape(-1), type=f.type.value_type, from_pandas=False)
            if c.width == ANY:
                starts = pa.array(np.arange(len(values) + 1, dtype=np.int32) * values.shape[1], pa.int32())
                arrays.append(pa.ListArray.from_arrays(starts, flat, type=f.type))
            else:
                arrays.append(pa.FixedSizeListArray.from_arrays(flat, c.width))
        elif c.kind == "U":
            names, codes = np.unique(values, return_inverse=True)
            arrays.append(pa.DictionaryArray.from_arrays(pa.array(codes, pa.int32()), pa.array(names, pa.string())))
        else:
            arrays.append(pa.array(values, type=f.type, from_pandas=False))
    return pa.Table.from_arrays(arrays, schema=schema)


def from_arrow(batch: pa.RecordBatch | pa.Table, table: type[T]) -> T:
    """Record of an Arrow batch whose columns have been checked; optional ones may be left out."""
    told = [c for c in table.columns() if c.name in batch.schema.names]
    return table.of(**{c.name: _column_from_arrow(c, batch.column(c.name)) for c in told})


def _column_from_arrow(c: Column, values: pa.Array | pa.ChunkedArray) -> NDArray[np.generic]:
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    if values.null_count:
        raise InputError(f"column {c.name}: {values.null_count} missing values; none are allowed (NaN is a number)")
    if c.width == ANY:
        return vectors(c, values)
    if c.width:
        return np.array(to_numpy(values.flatten()), c.dtype).reshape(-1, c.width)
    if c.kind == "U":
        if pa.types.is_dictionary(values.type):
            texts = values.dictionary.to_pylist() or [""]
            check_texts(texts, len(values), f"column {c.name}")
            which = to_numpy(values.indices)
            if len(which) and not 0 <= int(which.min()) <= int(which.max()) < len(texts):
                raise InputError(f"column {c.name}: the file is damaged: it refers to a text that is not there")
            return np.asarray(np.asarray(texts, dtype=np.str_)[which])
        texts = values.to_pylist()
        check_texts(texts, len(values), f"column {c.name}")
        return np.asarray(texts, dtype=np.str_) if texts else np.empty(0, "U1")
    return np.array(to_numpy(values), dtype=c.dtype)


def vectors(c: Column, values: pa.Array) -> NDArray[np.generic]:
    """(n, K) numbers of lists, all of K numbers or of none; NaN where a list is empty."""
    lengths, numbers = to_numpy(values.value_lengths()).astype(np.int64), values.flatten()
    (length, *others) = np.unique(lengths[lengths > 0]).tolist() or [0]
    if others or numbers.null_count:
        fault = f"lists of {length} and of {others[0]} numbers; all must be alike" if others else "numbers are missing"
        raise InputError(f"column {c.name}: {fault}")
    out = np.full((len(values), length), np.nan, dtype=c.dtype)
    out[lengths > 0] = to_numpy(numbers).reshape(-1, max(length, 1))
    return out


def check_table_name(path: Path) -> None:
    """UsageError for an output whose name promises another format than Parquet."""
    suffix = Path(path).suffix.lower()
    if suffix in NAMED_OTHERWISE:
        raise UsageError(f"{path}: tables are written as Parquet, not {suffix}; name it {Path(path).stem}.parquet")


class TableWriter:
    """Writes a table chunk by chunk; the file appears when the block ends without an error."""

    def __init__(
        self,
        path: Path,
        table: type[Table],
        provenance: Provenance,
        *,
        overwrite: bool = False,
        length_unit: str = "m",
        together: Together | None = None,
    ) -> None:
        """Prepare to write `table` to `path`; OutputExistsError if it is there and may not be replaced.

        With `together` the file appears at its end.  UsageError for a name that promises another format.
        """
        check_table_name(path)
        self.rows = 0
        self._table = table
        self._schema = arrow_schema(table, provenance, length_unit)
        self._pending: list[Table] = []
        self._pending_rows = self._pending_bytes = 0
        self._output = open_output(Path(path), overwrite, together)
        self._writer: pq.ParquetWriter | None = None
        self._begun = False

    def __enter__(self) -> Self:
        """Open the output."""
        self._summed = Summed(self._output.__enter__())
        self._sink = pa.PythonFile(self._summed, "w")
        try:
            self._writer = pq.ParquetWriter(
                self._sink, self._schema, write_page_index=True, sorting_columns=[pq.SortingColumn(0)], **WRITTEN
            )
        except BaseException as failure:
            self._output.__exit__(type(failure), failure, failure.__traceback__)
            raise
        return self

    def write(self, table: Table) -> None:
        """Append rows; they are written in groups, so many small chunks cost no space."""
        self.rows += len(table)
        self._pending.append(table)
        self._pending_rows += len(table)
        self._pending_bytes += sum(getattr(table, c.name).nbytes for c in table.columns())
        if self._pending_rows >= ROWS_PER_GROUP or self._pending_bytes >= BYTES_PER_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._writer is not None and not self._begun:
            self._sink.write(mark_of_schema(self._schema.serialize().to_pybytes()))
            self._begun = True
        if self._pending_rows and self._writer is not None:
            whole = to_arrow(self._table.concat(self._pending), self._schema)
            for start in range(0, len(whole), ROWS_PER_GROUP):
                self._write_group(self._writer, whole.slice(start, ROWS_PER_GROUP))
        self._pending, self._pending_rows, self._pending_bytes = [], 0, 0

    def _write_group(self, writer: pq.ParquetWriter, rows: pa.Table) -> None:
        """Write a group of rows, and behind it the mark by which it is found if the end of the file is lost."""
        at = self._summed.begin_span()
        writer.write_table(rows, row_group_size=ROWS_PER_GROUP)
        values = [_numbers(column) for column in rows.columns]
        self._sink.write(mark_of_group(at, len(rows), values, self._summed.end_span()))

    def annotate(self, provenance: Provenance) -> None:
        """Replace the provenance by one that is known only after the last row (for example what was lost)."""
        if self._writer is not None:
            self._writer.add_key_value_metadata({PROVENANCE_KEY: provenance.json()})

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        """Complete the file, or drop it after an error."""
        try:
            if kind is None:
                self._flush()
            self._summed.begin_end()
            self._close(kind is not None)
            if kind is None:
                self._summed.finish()
        except BaseException as failure:
            self._close(True)
            if not self._output.__exit__(type(failure), failure, failure.__traceback__):
                raise
        return self._output.__exit__(kind, error, trace)

    def _close(self, abandon: bool) -> None:
        """Close the library's writer; an abandoned one must not try again when it is collected."""
        if self._writer is None:
            return
        try:
            self._writer.close()
        except (pa.ArrowException, OSError, ValueError):
            self._writer.is_open = False
            if not abandon:
                raise


def _numbers(column: pa.ChunkedArray) -> int:
    """How many numbers the pages of a column have: an empty list counts as one."""
    if not pa.types.is_nested(column.type):
        return len(column)
    return max(sum(len(part.flatten()) for part in column.chunks), len(column))


def write_table(
    path: Path, table: Table, provenance: Provenance, *, overwrite: bool = False, length_unit: str = "m"
) -> None:
    """Write a whole table, sorted by its key."""
    with TableWriter(path, type(table), provenance, overwrite=overwrite, length_unit=length_unit) as writer:
        writer.write(table.sorted())


@contextmanager
def translate_read_errors(path: Path) -> Iterator[None]:
    """Turn every failure of the Parquet library into one InputError."""
    try:
        yield
    except InputError as error:
        raise error if str(path) in str(error) else InputError(f"{path}: {error}") from error
    except (pa.ArrowException, OSError, ValueError, KeyError, MemoryError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(f"{path}: damaged or not a Parquet file ({reason}); make it again") from error


@contextmanager
def _open(path: Path) -> Iterator[pq.ParquetFile]:
    check_input(path, "a Parquet file")
    with translate_read_errors(path), open_parquet(path) as file:
        yield file


@contextmanager
def open_parquet(path: Path) -> Iterator[pq.ParquetFile]:
    """A Parquet file with its check sums verified: those of all bytes, or where there are none those of pages.

    Raises:
        InputError: a check sum is wrong, or its footer promises more than a file of its size can hold, so that reading
            it would fill the memory.
        pyarrow.ArrowException, OSError: it is damaged.
    """
    with Checked(path) as source:
        file = pq.ParquetFile(source, page_checksum_verification=source.trailer is None)
        _check_size(path, source.size, file.metadata)
        yield file


def _check_size(path: Path, size: int, told: pq.FileMetaData) -> None:
    fault = too_much(size, told)
    if fault:
        raise InputError(f"{path}: promises {fault} in a file of {size} bytes, which no measurements fit into")


def too_much(size: int, told: pq.FileMetaData) -> str:
    """What a footer promises that no file of so many bytes can hold; empty: nothing."""
    groups = [told.row_group(number) for number in range(told.num_row_groups)]
    rows, large = max(FREE_ROWS, MAX_ROWS_PER_BYTE * size), max(FREE_BYTES, MAX_GROWTH * size)
    unpacked = max((group.total_byte_size for group in groups), default=0)
    return f"{told.num_rows} rows" if told.num_rows > rows else f"{unpacked} bytes at once" if unpacked > large else ""


def is_ours(path: Path) -> bool:
    """Whether occlog wrote a Parquet file; InputError for a damaged one."""
    with _open(path) as file:
        return SCHEMA_KEY.encode() in (file.schema_arrow.metadata or {})


def schema_name(path: Path) -> str:
    """Name of the table in a Parquet file, e.g. `bearings`; InputError for files that occlog did not write."""
    with _open(path) as file:
        return _schema_name(path, file.schema_arrow)


def _schema_name(path: Path, schema: pa.Schema) -> str:
    raw = (schema.metadata or {}).get(SCHEMA_KEY.encode())
    if raw is None:
        raise InputError(f"{path}: has no {SCHEMA_KEY} entry, so it is not an occlog table")
    return str(raw.decode()).split("/", maxsplit=1)[0]


def check_schema(path: Path, schema: pa.Schema, table: type[Table]) -> None:
    """InputError unless a schema is that of a table in its version of today, but for optional columns."""
    found = (schema.metadata or {}).get(SCHEMA_KEY.encode(), b"").decode()
    name, _, version = found.partition("/")
    if name != table.NAME:
        raise InputError(f"{path}: holds {found or 'no occlog table'}, want {table.NAME}/{table.VERSION}")
    if not version.isdigit() or int(version) > table.VERSION:
        raise InputError(f"{path}: holds {found}, which is newer than {name}/{table.VERSION}; update occlog")
    for c in table.columns():
        if schema.get_field_index(c.name) < 0:
            if c.optional:  # a file of an older version
                continue
            raise InputError(f"{path}: column {c.name} is missing; {table.NAME} has {', '.join(schema.names)}")
        have, kind = schema.field(c.name).type, _ARROW[c.kind]
        if c.width == ANY:
            if not (pa.types.is_list(have) and have.value_type == kind):
                raise InputError(f"{path}: column {c.name} is {have}, want lists of {kind}")
            continue
        kind = pa.list_(kind, c.width) if c.width else kind
        same = have == kind or (c.kind == "U" and (pa.types.is_string(have) or pa.types.is_large_string(have)))
        if not same and not (pa.types.is_dictionary(have) and c.kind == "U"):
            raise InputError(f"{path}: column {c.name} is {have}, want {kind}")


def iter_table(path: Path, table: type[T], rows: int = ROWS_PER_GROUP) -> Iterator[T]:
    """Chunks of a table in file order, at most `rows` rows each."""
    with _open(path) as file:
        check_schema(path, file.schema_arrow, table)
        names = [c.name for c in table.columns() if c.name in file.schema_arrow.names]
        # Of a class that asks for some columns only many rows may be alike
        whole = table.NAME in TABLES and issubclass(table, TABLES[table.NAME])
        previous = None
        for batch in batches(file, rows, names):
            chunk = from_arrow(batch, table)
            if len(chunk) and previous is not None and chunk.t_ns[0] < previous:  # type: ignore[attr-defined]
                raise InputError(f"{path}: t_ns goes back between two chunks; sort the table by t_ns")
            previous = int(chunk.t_ns[-1]) if len(chunk) else previous  # type: ignore[attr-defined]
            if whole:
                check_copies(chunk)
            yield chunk


def batches(file: pq.ParquetFile, rows: int, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """Rows of some columns in file order, at most `rows` at a time, in memory that does not grow with the file.

    The library keeps all that it has read for one call until that ends, so that each call is of a few groups of rows:
    as many as have `rows` rows together.
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
    """A group of rows of a table, which can be read though others are damaged.

    Attributes:
        table: the table.
        first: number of its first row in the file.
        rows: number of its rows.
    """

    path: Path
    file: pq.ParquetFile
    table: type[Table]
    number: int
    first: int
    rows: int

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Its rows in batches of `from_arrow`; InputError where they are damaged."""
        names = [c.name for c in self.table.columns() if c.name in self.file.schema_arrow.names]
        with translate_read_errors(self.path):
            yield from self.file.iter_batches(batch_size=ROWS_PER_GROUP, row_groups=[self.number], columns=names)


def groups_of(path: Path, tables: Mapping[str, type[Table]]) -> Iterator[RowGroup]:
    """The groups of rows of a table; InputError unless it is one of the tables, by their names, and has its columns."""
    with _open(path) as file:
        name, first = _schema_name(path, file.schema_arrow), 0
        if name not in tables:
            raise InputError(f"{path}: holds {name!r}, which is no table of this version; update occlog")
        check_schema(path, file.schema_arrow, tables[name])
        for number in range(file.metadata.num_row_groups):
            rows = file.metadata.row_group(number).num_rows
            yield RowGroup(path, file, tables[name], number, first, rows)
            first += rows


def read_table(path: Path, table: type[T]) -> T:
    """The whole table."""
    return table.concat(iter_table(path, table))


def arrow_schema_of(path: Path) -> pa.Schema:
    """The Arrow schema of a Parquet file, as it was written."""
    with _open(path) as file:
        return file.schema_arrow


def arrow_batches(path: Path, rows: int = ROWS_PER_GROUP) -> Iterator[pa.RecordBatch]:
    """Chunks of a Parquet file as Arrow has them, unchecked but for its check sums, at most `rows` rows each."""
    with _open(path) as file:
        yield from file.iter_batches(batch_size=rows)


class Header(NamedTuple):
    """What a table says of itself: its name, the unit of its lengths, and how it was made."""

    table: str
    length_unit: str
    provenance: Provenance


def read_header(path: Path) -> Header:
    """The header of a table; InputError for files that occlog did not write."""
    with _open(path) as file:
        return header_of(path, file.schema_arrow.with_metadata(_metadata(file)))


def header_by_footer(path: Path) -> tuple[Header, int] | None:
    """The header of a table and how many rows it should have, by its footer alone; None where that has no check sum.

    InputError for a damaged footer, and for files that occlog did not write.
    """
    with translate_read_errors(path), Checked(path) as source:
        footer = source.footer()
        if footer is None:
            return None
        file = pq.ParquetFile(pa.BufferReader(MAGIC + footer))
        return header_of(path, file.schema_arrow.with_metadata(_metadata(file))), file.metadata.num_rows


def header_of(path: Path, schema: pa.Schema) -> Header:
    """The header in the metadata of a schema; InputError where occlog did not write it."""
    name, metadata = _schema_name(path, schema), schema.metadata
    unit, made = metadata.get(b"occlog.length_unit", b"m"), metadata.get(PROVENANCE_KEY.encode(), b"")
    return Header(name, unit.decode(), provenance_from_json(made, path))


def read_provenance(path: Path) -> Provenance:
    """How the file was made."""
    with _open(path) as file:
        return provenance_from_json(_metadata(file).get(PROVENANCE_KEY.encode(), b""), path)


def _metadata(file: pq.ParquetFile) -> dict[bytes, bytes]:
    """Entries of the schema, and those that were added at the end, which replace them."""
    return {**(file.schema_arrow.metadata or {}), **(file.metadata.metadata or {})}


class TableDescription(TypedDict):
    """What a Parquet file holds."""

    schema: str  # name of the table
    version: int  # of the schema; 0: not stated
    rows: int
    length_unit: str
    columns: list[dict[str, str]]  # name, type, and what the file says of it
    time_ns: list[int] | None  # first and last time; None: not stated
    provenance: dict[str, Any]


def describe(path: Path) -> TableDescription:
    """What a Parquet file holds: schema, rows, columns with units, time span, provenance."""
    with _open(path) as file:
        schema, name = file.schema_arrow, _schema_name(path, file.schema_arrow)
        columns = [
            {
                "name": f.name,
                "type": str(f.type),
                **{k.decode(): v.decode() for k, v in (f.metadata or {}).items()},
            }
            for f in schema
        ]
        metadata = _metadata(file)
        made = metadata.get(PROVENANCE_KEY.encode(), b"")
        provenance_from_json(made, path)
        return {
            "schema": name,
            "version": int((schema.metadata or {})[SCHEMA_KEY.encode()].decode().partition("/")[2] or 0),
            "rows": file.metadata.num_rows,
            "length_unit": metadata.get(b"occlog.length_unit", b"m").decode(),
            "columns": columns,
            "time_ns": _time_span(file),
            "provenance": json.loads(made) if made else {},
        }


def first_rows(path: Path, rows: int) -> dict[str, list[object]]:
    """The first rows of a Parquet file: values of each column that is no list, as Python has them."""
    with _open(path) as file:
        names = [f.name for f in file.schema_arrow if not pa.types.is_nested(f.type)]
        batch = next(file.iter_batches(batch_size=rows, columns=names), None)
        return {} if batch is None else {name: batch.column(name).to_pylist() for name in names}


def _time_span(file: pq.ParquetFile) -> list[int] | None:
    if not pa.types.is_integer(file.schema_arrow.field(0).type):  # times of another program
        return None
    groups = (file.metadata.row_group(i).column(0).statistics for i in range(file.num_row_groups))
    spans = [(s.min, s.max) for s in groups if s is not None and s.has_min_max]
    return [min(s[0] for s in spans), max(s[1] for s in spans)] if spans else None
