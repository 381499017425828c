"""Whole tables as text with a header, and as Parquet with plain columns.

A name of a column ends in its unit: `bearing_rad`, `x_m`, `cov_xx_m2`; those of times and pixels say it already.
What is read again (`occlog.io.foreign`) is the same table.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from occlog.io.files.texts.csv_rows import no_formula
from occlog.io.foreign.names import POWERS, ending
from occlog.records.columns import Column, Table

CELL = '"'


def shown_name(column: Column, length_unit: str) -> str:
    """The name of a column with its unit."""
    if column.unit == "rad":
        return f"{column.name}_rad"
    return column.name + ending(column, length_unit) if column.unit in POWERS else column.name


def write_csv(
    rows: Iterable[Table], table: type[Table], file: IO[bytes], length_unit: str
) -> tuple[int, tuple[str, ...]]:
    """Write text; the number of rows, and the columns that have more than one number a row and are left out."""
    kept = [c for c in table.columns() if not c.width]
    file.write((",".join(shown_name(c, length_unit) for c in kept) + "\n").encode())
    count = 0
    for part in rows:
        cells = [_cells(part, c) for c in kept]
        file.write("".join(",".join(line) + "\n" for line in zip(*cells, strict=True)).encode())
        count += len(part)
    return count, tuple(c.name for c in table.columns() if c.width)


def _cells(part: Table, column: Column) -> Sequence[str]:
    """The values of a column as text; what is not known is empty."""
    values = getattr(part, column.name)
    if column.kind == "U":
        return [_quoted(no_formula(text)) for text in values.tolist()]
    if column.kind == "?":
        return ["true" if value else "false" for value in values.tolist()]
    if values.dtype.kind == "f":
        return ["" if value != value else repr(value) for value in values.tolist()]
    return [str(value) for value in values.tolist()]


def _quoted(text: str) -> str:
    if not any(mark in text for mark in ',"\n\r'):
        return text
    return CELL + text.replace(CELL, CELL + CELL) + CELL


def write_parquet(rows: Iterable[Table], table: type[Table], file: IO[bytes], length_unit: str) -> int:
    """Write Parquet without our keys, with null for what is not known; the number of rows."""
    schema = pa.schema([pa.field(shown_name(c, length_unit), _kind(c)) for c in table.columns()])
    count = 0
    with pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for part in rows:
            arrays = [_array(part, c) for c in table.columns()]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            count += len(part)
    return count


def _kind(column: Column) -> pa.DataType:
    kinds = {"i8": pa.int64(), "i4": pa.int32(), "f8": pa.float64(), "f4": pa.float32(), "?": pa.bool_()}
    kind = kinds.get(column.kind, pa.string())
    return pa.list_(kind) if column.width else kind


def _array(part: Table, column: Column) -> pa.Array:
    values = getattr(part, column.name)
    if column.width:
        flat = pa.array(np.ascontiguousarray(values).reshape(-1), from_pandas=True)
        starts = pa.array(np.arange(len(part) + 1, dtype=np.int32) * values.shape[1])
        return pa.ListArray.from_arrays(starts, flat)
    if column.kind == "U":
        return pa.array(values.tolist(), pa.string())
    return pa.array(values, _kind(column), from_pandas=values.dtype.kind == "f")
