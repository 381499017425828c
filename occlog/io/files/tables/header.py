"""What the header of a table says without its rows: name, units, columns, times, and how it was made."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import pyarrow as pa

from occlog.io.files.provenance import PROVENANCE_KEY, Provenance, provenance_from_json
from occlog.io.files.tables.arrow_columns import SCHEMA_KEY, UNIT_KEY
from occlog.io.files.tables.parquet import batches, opened_table, schema_name_of, statements_of
from occlog.io.files.tables.sizes import SizedFile
from occlog.io.files.tables.table_writer import ROWS_PER_GROUP


class Header(NamedTuple):
    """What a table says of itself: its name, the unit of its lengths, and how it was made."""

    table: str
    length_unit: str
    provenance: Provenance


def read_header(path: Path) -> Header:
    """The header of a table; InputError for files that occlog did not write."""
    with opened_table(path) as file:
        entries, name = statements_of(file), schema_name_of(path, file.schema_arrow)
        return Header(name, _unit(entries), _provenance(entries, path))


def read_provenance(path: Path) -> Provenance:
    """How the file was made."""
    with opened_table(path) as file:
        return _provenance(statements_of(file), path)


def _provenance(entries: Mapping[bytes, bytes], path: Path) -> Provenance:
    return provenance_from_json(entries.get(PROVENANCE_KEY.encode(), b""), path)


def _unit(entries: Mapping[bytes, bytes]) -> str:
    return entries.get(UNIT_KEY.encode(), b"m").decode(errors="replace")


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
    """The first rows of a Parquet file: values of each column that is no list, as Python has them."""
    with opened_table(path) as file:
        names = [f.name for f in file.schema_arrow if not pa.types.is_nested(f.type)]
        batch = next(batches(file, rows, names), None)
        return {} if batch is None else {name: batch.column(name).to_pylist() for name in names}


def _time_span(file: SizedFile) -> list[int] | None:
    """First and last time: rows stand in the order of time."""
    if not len(file.schema_arrow) or not pa.types.is_int64(file.schema_arrow.field(0).type):
        return None  # times of another program
    groups = [n for n in range(file.num_row_groups) if file.metadata.row_group(n).num_rows]
    ends = [pa.Table.from_batches(_times(file, n)).column(0) for n in groups[:1] + groups[-1:]]
    return [ends[0][0].as_py(), ends[-1][-1].as_py()] if ends else None


def _times(file: SizedFile, group: int) -> list[pa.RecordBatch]:
    return list(file.iter_batches(ROWS_PER_GROUP, [group], file.schema_arrow.names[:1]))
