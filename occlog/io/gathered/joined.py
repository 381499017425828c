"""Tables of one kind, one of each recording, as one table with a column that names the recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow as pa

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.tables.arrow_columns import check_schema
from occlog.io.files.tables.header import read_header
from occlog.io.files.tables.parquet import arrow_batches, arrow_schema_of
from occlog.io.files.tables.table_writer import ROWS_PER_GROUP
from occlog.records.tables import TABLES

from .schema import NAMES, RECORDING, gathered_schema, gathered_writer


def join_tables(path: Path, parts: Mapping[str, Path], name: str, provenance: Provenance) -> int:
    """Write the rows of all parts, one part after another; the number of rows.

    A column that a part does not have has no value (null) in its rows.  Memory does not grow with the number of parts.

    Args:
        path: the new table, which replaces an older one.
        parts: a table of each recording, by the recording's name.
        name: of the tables, e.g. `tracks`.
        provenance: how the new table is made.

    Raises:
        InputError: parts are of another kind or a newer version, in different units of length, or a column has
            different types, values that are missing, or the name of another.
    """
    fields, unit = _columns(parts, name)
    schema = gathered_schema(name, fields.values(), provenance, unit)
    count, kept, rows = 0, list[pa.Table](), 0
    with gathered_writer(path, schema) as writer:
        for batch in _batches(parts, schema):
            kept.append(batch)
            rows, count = rows + batch.num_rows, count + batch.num_rows
            if rows >= ROWS_PER_GROUP:
                writer.write_table(pa.concat_tables(kept).unify_dictionaries())
                kept, rows = [], 0
        if kept:
            writer.write_table(pa.concat_tables(kept).unify_dictionaries())
    return count


def _columns(parts: Mapping[str, Path], name: str) -> tuple[dict[str, pa.Field], str]:
    """Columns of all parts by their names, in the order in which they come up, and the unit of lengths."""
    fields: dict[str, pa.Field] = {}
    first: dict[str, str] = {}
    held: dict[str, int] = {}
    unit, where = "", ""
    for recording, part in parts.items():
        header = read_header(part)
        if header.table != name:
            raise InputError(f"{part}: holds {header.table}, want {name}")
        if where and header.length_unit != unit:
            raise InputError(
                f"{name}: lengths are in {unit} in {where} and in {header.length_unit} in {recording}; a table has one "
                "unit: make a batch of the recordings of each"
            )
        unit, where = header.length_unit, where or recording
        schema = arrow_schema_of(part)
        check_schema(part, schema, TABLES[name])
        twice = [each for each, count in Counter([RECORDING.name, *schema.names]).items() if count > 1]
        if twice:
            raise InputError(f"{part}: column {twice[0]} would be there twice; make it again")
        for field in schema:
            known = fields.setdefault(field.name, field)
            if known.type != field.type:
                raise InputError(
                    f"{name}: {field.name} is {known.type} in {first[field.name]} and {field.type} in {recording}; "
                    "make both with one version of occlog"
                )
            first.setdefault(field.name, recording)
            held[field.name] = held.get(field.name, 0) + 1
    return {key: field.with_nullable(held[key] < len(parts)) for key, field in fields.items()}, unit


def _batches(parts: Mapping[str, Path], schema: pa.Schema) -> Iterator[pa.Table]:
    """Rows of all parts in chunks, with all columns."""
    for recording, part in parts.items():
        for batch in arrow_batches(part):
            index = pa.repeat(pa.scalar(0, pa.int32()), batch.num_rows)
            columns = [pa.DictionaryArray.from_arrays(index, pa.array([recording], NAMES.value_type))]
            for field in list(schema)[1:]:
                there = field.name in batch.schema.names
                columns.append(batch.column(field.name) if there else pa.nulls(batch.num_rows, field.type))
                if there and (missing := columns[-1].null_count) and not field.nullable:
                    raise InputError(f"{part}: column {field.name}: {missing} missing values; make it again")
            yield pa.Table.from_arrays(columns, schema=schema)
