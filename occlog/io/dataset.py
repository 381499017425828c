"""Tables over many recordings, with a column that names the recording.

`runs` and `metrics` of a batch: the outcome of each recording, and every figure of its evaluation. Schema names differ
from those of single recordings, since a command that took rows of several recordings for one would give wrong results.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from occlog.errors import InputError
from occlog.records.tables import TABLES

from .files.atomic import open_output
from .files.provenance import Provenance
from .files.tables.arrow import SCHEMA_KEY, check_schema, statements
from .files.tables.parquet import arrow_batches, arrow_schema_of, read_header
from .files.tables.table_writer import ROWS_PER_GROUP, WRITTEN

VERSION = 1
COLLECTED = "batch."
"""Beginning of the names of their schemas."""
NAMES = pa.dictionary(pa.int32(), pa.string())
"""Type of columns of names."""
RECORDING = pa.field("recording", NAMES, nullable=False, metadata={"unit": "1", "doc": "name of the run folder"})


def field(name: str, kind: pa.DataType, doc: str, *, unit: str = "1", nullable: bool = False) -> pa.Field:
    """Arrow field of a column `name` of the type `kind`, with unit and description (`doc`) as metadata."""
    return pa.field(name, kind, nullable=nullable, metadata={"unit": unit, "doc": doc})


def dataset_schema(name: str, fields: Iterable[pa.Field], provenance: Provenance, length_unit: str = "") -> pa.Schema:
    """Arrow schema of the table `name` over many recordings: the column `recording`, then `fields`.

    `provenance` and the length unit of the table (empty: it has no lengths) are stored in its metadata.
    """
    entries = {SCHEMA_KEY: f"{COLLECTED}{name}/{VERSION}", **statements(provenance, length_unit)}
    return pa.schema([RECORDING, *fields], metadata=entries)


@contextmanager
def dataset_writer(path: Path, schema: pa.Schema) -> Iterator[pq.ParquetWriter]:
    """Context manager: Parquet writer of a file that appears under its name when the block ends without an error.

    It replaces an older file at `path`.
    """
    with open_output(path, overwrite=True) as file, pq.ParquetWriter(file, schema, **WRITTEN) as writer:
        yield writer


def write_rows(path: Path, schema: pa.Schema, rows: Iterable[dict[str, object]]) -> int:
    """Write rows, given as values by column name, to a Parquet file in groups of limited size.

    Return the number of rows.
    """
    count, kept = 0, list[dict[str, object]]()
    with dataset_writer(path, schema) as writer:
        for row in rows:
            kept.append(row)
            count += 1
            if len(kept) == ROWS_PER_GROUP:
                writer.write_table(pa.Table.from_pylist(kept, schema=schema))
                kept = []
        writer.write_table(pa.Table.from_pylist(kept, schema=schema))
    return count


def join_tables(path: Path, parts: Mapping[str, Path], name: str, provenance: Provenance) -> int:
    """Concatenate the tables of many recordings into one Parquet file; return the number of rows.

    A column that a recording's table lacks is null in its rows. Memory does not grow with the number of recordings.

    Args:
        path: the new table, which replaces an older one.
        parts: file of the table of each recording, by the recording's name.
        name: of the tables, e.g. `tracks`.
        provenance: how the new table is made.

    Raises:
        InputError: a file is of another kind or a newer version, length units differ, a column has several types or is
            named twice, or values are missing.
    """
    fields, unit = _columns(parts, name)
    schema = dataset_schema(name, fields.values(), provenance, unit)
    count, kept, rows = 0, list[pa.Table](), 0
    with dataset_writer(path, schema) as writer:
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
    """Arrow fields of all files by column name, in order of first appearance, and their common length unit.

    A column that some file lacks is nullable.

    Args:
        parts: file of the table of each recording, by the recording's name.
        name: of the table that each file must hold.

    Raises:
        InputError: a file is of another kind or a newer version, length units differ, or a column has several types or
            is named twice.
    """
    fields: dict[str, pa.Field] = {}
    first: dict[str, str] = {}
    held: dict[str, int] = {}
    unit, where = "", ""
    for recording, part in parts.items():
        header = read_header(part)
        if header.table != name:
            raise InputError(
                f"{part}: holds {header.table}, expected {name}; process its recording again", id="wrong-content"
            )
        if where and header.length_unit != unit:
            raise InputError(
                f"{name}: lengths are in {unit} in {where} and in {header.length_unit} in {recording}; a table has one "
                "unit: run one batch for each unit",
                id="unit-mismatch",
            )
        unit, where = header.length_unit, where or recording
        schema = arrow_schema_of(part)
        check_schema(part, schema, TABLES[name])
        twice = [each for each, count in Counter([RECORDING.name, *schema.names]).items() if count > 1]
        if twice:
            raise InputError(
                f"{part}: column {twice[0]} would occur twice in the dataset; process its recording again",
                id="damaged-file",
            )
        for field in schema:
            known = fields.setdefault(field.name, field)
            if known.type != field.type:
                raise InputError(
                    f"{name}: {field.name} is {known.type} in {first[field.name]} and {field.type} in {recording}; "
                    "make both with one version of occlog",
                    id="version-mismatch",
                )
            first.setdefault(field.name, recording)
            held[field.name] = held.get(field.name, 0) + 1
    return {key: field.with_nullable(held[key] < len(parts)) for key, field in fields.items()}, unit


def _batches(parts: Mapping[str, Path], schema: pa.Schema) -> Iterator[pa.Table]:
    """Yield the rows of all files in chunks with the columns of `schema`, the name of the recording first.

    Columns that a file lacks are null. InputError for nulls in a column that all files have.
    """
    for recording, part in parts.items():
        for batch in arrow_batches(part):
            index = pa.repeat(pa.scalar(0, pa.int32()), batch.num_rows)
            columns = [pa.DictionaryArray.from_arrays(index, pa.array([recording], NAMES.value_type))]
            for field in list(schema)[1:]:
                there = field.name in batch.schema.names
                columns.append(batch.column(field.name) if there else pa.nulls(batch.num_rows, field.type))
                if there and (missing := columns[-1].null_count) and not field.nullable:
                    raise InputError(
                        f"{part}: column {field.name}: {missing} missing values; process its recording again",
                        id="damaged-file",
                    )
            yield pa.Table.from_arrays(columns, schema=schema)


_LOSS = pa.struct([("source", pa.string()), ("place", pa.string()), ("what", pa.string()), ("count", pa.int64())])
RUNS = (
    field(
        "source",
        pa.string(),
        "the recording's file, with the folders that distinguish it from the others; a byte that is not UTF-8 as \\xe9",
    ),
    field("sha256", pa.string(), "of the recording's bytes; empty: it could not be read"),
    field("state", NAMES, "done, lossy (input was lost), threshold (not met) or failed"),
    field("exit_code", pa.int32(), "as `occlog run` would have ended"),
    field("stage", NAMES, "the stage that failed; empty: none did"),
    field("message", pa.string(), "why it failed, in one line"),
    field("plausible", pa.bool_(), "whether every stage found its results plausible; null: none judged", nullable=True),
    field("warnings", pa.list_(pa.string()), "why results are not reliable: stage, id and sentence"),
    field("losses", pa.list_(_LOSS), "input that was lost: source, position, what, and how many (0: not known)"),
)
METRICS = (
    field("file", NAMES, "of the run folder that has the figure"),
    field("name", NAMES, "of the figure"),
    field(
        "value",
        pa.float64(),
        "in the unit that the name ends with; null: it is not defined",
        nullable=True,
    ),
)


def write_runs(path: Path, rows: Iterable[dict[str, object]], provenance: Provenance) -> int:
    """Write the table `runs` (outcome of each recording of a batch: a dict per row) as Parquet.

    Return the number of rows.
    """
    return write_rows(path, dataset_schema("runs", RUNS, provenance), rows)


def write_metrics(path: Path, rows: Iterable[dict[str, object]], provenance: Provenance) -> int:
    """Write the table `metrics` (a figure of an evaluation in each row, as a dict) as Parquet.

    Return the number of rows.
    """
    return write_rows(path, dataset_schema("metrics", METRICS, provenance), rows)
