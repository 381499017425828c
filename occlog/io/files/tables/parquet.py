"""Reads tables from Parquet, with the check sums of pages and of what the footer says verified."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.io.files.tables.arrow_columns import SCHEMA_KEY, T, check_schema, check_statements, from_arrow
from occlog.io.files.tables.sizes import SizedFile, read_groups
from occlog.io.files.tables.table_writer import ROWS_PER_GROUP
from occlog.io.files.tables.vectors import in_parts
from occlog.io.files.untrusted.inputs import check_input
from occlog.io.files.untrusted.promises import check_promise, most_unpacked
from occlog.records.columns import Table, check_copies
from occlog.records.tables import has_all


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
def opened_table(path: Path) -> Iterator[SizedFile]:
    """A Parquet file, verified; each failure to read it, also within the block, is one InputError."""
    check_input(path, "a Parquet file")
    with translate_read_errors(path), open_parquet(path) as file:
        yield file


@contextmanager
def open_parquet(path: Path) -> Iterator[SizedFile]:
    """A Parquet file, with the check sums of its pages verified when they are read.

    Raises:
        InputError: the check sum of what its footer says is wrong, or the footer states more than a file of its size
            can hold, so that reading it would fill the memory.
        pyarrow.ArrowException, OSError: it is damaged.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        groups = read_groups(path, file, size)
        rows, unpacked = sum(group.rows for group in groups), max((group.unpacked for group in groups), default=0)
        check_promise(path, size, rows, unpacked)
        metadata = pq.read_metadata(file)
        # Of texts each is unpacked once, not for every row that refers to it
        texts = [field.name for field in metadata.schema.to_arrow_schema() if _is_text(field.type)]
        options = {"metadata": metadata, "read_dictionary": texts, "page_checksum_verification": True}
        opened = SizedFile(path, file, size, groups, **options)
        check_statements(path, statements_of(opened))
        yield opened


def statements_of(file: pq.ParquetFile) -> dict[bytes, bytes]:
    """What a table says of itself: entries of its schema, replaced by those that were added after the last row."""
    return {**(file.schema_arrow.metadata or {}), **(file.metadata.metadata or {})}


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def is_ours(path: Path) -> bool:
    """Whether occlog wrote a Parquet file; InputError for a damaged one."""
    with opened_table(path) as file:
        return SCHEMA_KEY.encode() in (file.schema_arrow.metadata or {})


def schema_name(path: Path) -> str:
    """Name of the table in a Parquet file, e.g. `bearings`; InputError for files that occlog did not write."""
    with opened_table(path) as file:
        return schema_name_of(path, file.schema_arrow)


def schema_name_of(path: Path, schema: pa.Schema) -> str:
    """Name of the table whose Arrow schema it is; InputError for one that occlog did not write."""
    raw = (schema.metadata or {}).get(SCHEMA_KEY.encode())
    if raw is None:
        raise InputError(f"{path}: has no {SCHEMA_KEY} entry, so it is not an occlog table")
    return str(raw.decode()).split("/", maxsplit=1)[0]


def iter_table(path: Path, table: type[T], rows: int = ROWS_PER_GROUP) -> Iterator[T]:
    """Chunks of a table in file order, at most `rows` rows each."""
    with opened_table(path) as file:
        check_schema(path, file.schema_arrow, table)
        names = [c.name for c in table.columns() if c.name in file.schema_arrow.names]
        whole = has_all(table)
        last: T | None = None
        held: T | None = None
        size, texts = path.stat().st_size, 0
        most = most_unpacked(size)
        for batch in in_parts(path, size, batches(file, rows, names)):
            chunk = from_arrow(batch, table)
            if not len(chunk):
                continue
            texts += sum(getattr(chunk, c.name).nbytes for c in table.columns() if c.kind == "U")
            if texts > most:
                raise InputError(
                    f"{path}: texts of more than {most} bytes in a file of {size}, since every row takes "
                    "as much as the longest; shorten it"
                )
            if last is not None and chunk.t_ns[0] < last.t_ns[-1]:  # type: ignore[attr-defined]
                raise InputError(f"{path}: t_ns goes back between two chunks; sort the table by t_ns")
            if whole:
                check_copies(chunk)
                held = _check_beside(held, chunk)
            last = chunk
            yield chunk


def _check_beside(held: T | None, chunk: T) -> T:
    """Look for copies of rows of one time in several chunks; returns those of the last time, for the chunks behind."""
    times: Ints = chunk.t_ns  # type: ignore[attr-defined]
    last = chunk.take(slice(int(np.searchsorted(times, times[-1])), None))
    if held is None or held.t_ns[0] != times[0]:  # type: ignore[attr-defined]
        return last
    first = chunk.take(slice(0, int(np.searchsorted(times, times[0], "right"))))
    both = chunk.concat([held, first])
    check_copies(both)
    return both.take(slice(-ROWS_PER_GROUP, None)) if times[0] == times[-1] else last


def batches(file: pq.ParquetFile, rows: int, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
    """Rows of some columns (None: all) in file order, at most `rows` at a time; memory does not grow with the file.

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
    file: SizedFile
    table: type[Table]
    number: int
    first: int
    rows: int

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Its rows in batches of `from_arrow`; InputError where they are damaged."""
        names = [c.name for c in self.table.columns() if c.name in self.file.schema_arrow.names]
        with translate_read_errors(self.path):
            found = self.file.iter_batches(batch_size=ROWS_PER_GROUP, row_groups=[self.number], columns=names)
            yield from in_parts(self.path, self.path.stat().st_size, found)


def groups_of(path: Path, tables: Mapping[str, type[Table]]) -> Iterator[RowGroup]:
    """The groups of rows of a table; InputError unless it is one of the tables, by their names, and has its columns."""
    with opened_table(path) as file:
        name, first = schema_name_of(path, file.schema_arrow), 0
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
    with opened_table(path) as file:
        return file.schema_arrow


def arrow_batches(path: Path, rows: int = ROWS_PER_GROUP) -> Iterator[pa.RecordBatch]:
    """Chunks of a Parquet file as Arrow has them, unchecked but for check sums, at most `rows` rows each."""
    with opened_table(path) as file:
        yield from batches(file, rows)
