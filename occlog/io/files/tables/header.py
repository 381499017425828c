"""What the header of a table says without its rows: name, units, columns, times, and how it was made."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

import pyarrow as pa
import pyarrow.parquet as pq

from occlog.errors import InputError
from occlog.io.files.provenance import PROVENANCE_KEY, Provenance, provenance_from_json
from occlog.io.files.tables.arrow_columns import SCHEMA_KEY
from occlog.io.files.tables.check_sums import Checked
from occlog.io.files.tables.footer import read_groups, read_spans
from occlog.io.files.tables.pages import PagedFile
from occlog.io.files.tables.parquet import batches, opened_table, schema_name_of, translate_read_errors
from occlog.io.files.untrusted.content import PARQUET_MAGIC

_TIME = struct.Struct("<q")


class Header(NamedTuple):
    """What a table says of itself: its name, the unit of its lengths, and how it was made."""

    table: str
    length_unit: str
    provenance: Provenance


class Footer(NamedTuple):
    """What the footer of a table says: its header, how many rows there should be, and the schema."""

    header: Header
    rows: int
    schema: pa.Schema


def read_header(path: Path) -> Header:
    """The header of a table; InputError for files that occlog did not write."""
    with opened_table(path) as file:
        return header_of(path, file.schema_arrow.with_metadata(_metadata(file)))


def read_footer(path: Path) -> Footer | None:
    """What a table says of itself, by its footer alone; None where that has no check sum.

    InputError for a damaged footer, and for files that occlog did not write.
    """
    with translate_read_errors(path), Checked(path) as source:
        footer = source.footer()
        if footer is None:
            return None
        read_groups(source)  # refuses what would fill the memory
        file = pq.ParquetFile(pa.BufferReader(PARQUET_MAGIC + footer))
        schema = file.schema_arrow.with_metadata(_metadata(file))
        return Footer(header_of(path, schema), file.metadata.num_rows, schema)


def header_of(path: Path, schema: pa.Schema) -> Header:
    """The header in the metadata of a schema; InputError where occlog did not write it."""
    name, metadata = schema_name_of(path, schema), schema.metadata
    unit, made = metadata.get(b"occlog.length_unit", b"m"), metadata.get(PROVENANCE_KEY.encode(), b"")
    return Header(name, unit.decode(), provenance_from_json(made, path))


def read_provenance(path: Path) -> Provenance:
    """How the file was made."""
    with opened_table(path) as file:
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
    with opened_table(path) as file:
        names = [f.name for f in file.schema_arrow if not pa.types.is_nested(f.type)]
        batch = next(batches(file, rows, names), None)
        return {} if batch is None else {name: batch.column(name).to_pylist() for name in names}


def _time_span(file: PagedFile) -> list[int] | None:
    if not pa.types.is_int64(file.schema_arrow.field(0).type):  # times of another program
        return None
    spans = [(_time(least), _time(greatest)) for least, greatest in read_spans(file.checked)]
    return [min(s[0] for s in spans), max(s[1] for s in spans)] if spans else None


def _time(stored: bytes) -> int:
    if len(stored) != _TIME.size:
        raise InputError(f"a time of {len(stored)} bytes in the statistics of its first column")
    return int(_TIME.unpack(stored)[0])
