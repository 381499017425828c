"""Makes a whole table of what is whole in one that was cut off or damaged, with a list of what is lost."""

from __future__ import annotations

import io
import mmap
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from occlog.errors import InputError
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.files.tables.arrow_columns import check_schema, from_arrow
from occlog.io.files.tables.header import Footer, Header, header_of, read_footer, read_header
from occlog.io.files.tables.parquet import arrow_schema_of, groups_of, translate_read_errors
from occlog.io.files.tables.salvage.groups import pattern_of, rows_of
from occlog.io.files.tables.salvage.marks import GROUP, SCHEMA, group_of, marks
from occlog.io.files.tables.table_writer import WRITTEN, TableWriter
from occlog.io.files.tables.thrift import MalformedError, Struct
from occlog.io.files.times.utc import utc
from occlog.io.files.untrusted.content import PARQUET_MAGIC
from occlog.io.files.untrusted.inputs import check_input
from occlog.records.columns import Table
from occlog.records.losses import Loss
from occlog.records.tables import TABLES, table_with


class RecoveredTable(NamedTuple):
    """What a recovered table holds.

    Attributes:
        rows: how many there are.
        span: times of the first and the last row [ns]; None: there is none.
        losses: what is lost of the table, and what had been lost before it was made.
    """

    rows: int
    span: tuple[int, int] | None
    losses: tuple[Loss, ...]


class Lost(NamedTuple):
    """Rows that are lost, between those before and behind them."""

    what: str
    rows: int  # 0: nobody knows


def recover_table(source: Path, path: Path, *, overwrite: bool = False) -> RecoveredTable:
    """Write `path`, whole or not at all, with every group of rows of a damaged table whose check sum is right.

    With its footer, rows of all tables come back; without, those of tables that have marks (see `salvage.marks`).

    Args:
        source: a table of occlog.
        path: the table to write.
        overwrite: replace a file that exists.

    Raises:
        InputError: `source` is no table of occlog, what it holds cannot be known, or no row is whole.
    """
    check_input(source, "a table")
    try:
        header = read_header(source)
    except InputError:
        return _without_footer(source, path, overwrite)
    table, left_out = _table_for(source, header.table, arrow_schema_of(source).names)
    losses = (*header.provenance.losses, *left_out)
    return _write(source, path, header, table, _by_footer(source, table), losses, overwrite)


def _table_for(source: Path, name: str, columns: Collection[str]) -> tuple[type[Table], list[Loss]]:
    """The table of a name that takes a file's columns, and those that it does not take."""
    if name not in TABLES:
        raise InputError(f"{source}: holds {name!r}, which is no table of this version; update occlog")
    table = table_with(name, columns)
    known = {c.name for c in table.columns()}
    what = f"is left out: {name} of this version has no such column"
    return table, [Loss(source.name, f"column {column}", what) for column in columns if column not in known]


def _by_footer(source: Path, table: type[Table]) -> Iterator[Table | Lost]:
    """Groups of rows of a file whose footer is right, or their loss."""
    for group in groups_of(source, {table.NAME: table}):
        try:
            rows = [from_arrow(batch, group.table) for batch in group.batches()]
        except InputError:
            yield Lost("rows with a wrong check sum", group.rows)
        else:
            yield from rows


def _without_footer(source: Path, path: Path, overwrite: bool) -> RecoveredTable:
    """The same for a file that the library cannot open, by its marks."""
    with source.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        footer: Footer | None = None
        with suppress(InputError):
            footer = read_footer(source)
        with translate_read_errors(source):
            schema = _schema_of(data, footer)
            if schema is None:
                raise InputError(
                    f"{source}: neither its end nor its beginning says what it holds (damaged there, not a table, or "
                    "written by another program or before occlog marked groups of rows); make it again"
                )
            header = header_of(source, schema) if footer is None else footer.header
            table, left_out = _table_for(source, header.table, schema.names)
            check_schema(source, schema, table)
            pattern = pattern_of(_row_of(schema))
        before = (*header.provenance.losses, *left_out)
        if footer is None:
            before = (*before, Loss(source.name, "its end", "what was lost while it was made is not known any more"))
        whole = _by_marks(data, pattern, table, None if footer is None else footer.rows)
        return _write(source, path, header, table, whole, before, overwrite)


def _schema_of(data: mmap.mmap, footer: Footer | None) -> pa.Schema | None:
    """The schema that a file states at its beginning, or in its footer where that is damaged; None: in neither."""
    first = next(marks(data), None)
    if first is not None and first.kind == SCHEMA and data[: len(PARQUET_MAGIC)] == PARQUET_MAGIC:
        return pa.ipc.read_schema(pa.py_buffer(first.says))
    return None if footer is None else footer.schema


def _by_marks(data: mmap.mmap, pattern: Struct, table: type[Table], due: int | None) -> Iterator[Table | Lost]:
    """Groups of rows before their marks, of a table of so many rows if that is known."""
    told = behind = 0
    for mark in marks(data):
        if mark.kind != GROUP:
            behind = behind or mark.behind  # of the schema
            continue
        try:
            group = group_of(mark)
        except struct.error:  # a mark that somebody made
            continue
        if group.at > behind and due is None:
            yield Lost(f"rows of bytes {behind} to {group.at}, whose mark is damaged", 0)
        behind = mark.behind
        told += group.rows
        own = data[group.at : max(mark.at, group.at)]
        if zlib.crc32(own) != group.crc:
            yield Lost("rows with a wrong check sum", group.rows)
            continue
        try:
            rows = from_arrow(rows_of(memoryview(own), group, pattern), table)
        except (MalformedError, InputError, pa.ArrowException, OSError, ValueError):
            yield Lost("rows that are not those of such a table", group.rows)
            continue
        yield rows
    if due is None and behind < len(data):
        yield Lost("rows up to its end, if there were more", 0)
    elif due is not None and due > told:
        yield Lost("rows whose mark is damaged", due - told)


def _row_of(schema: pa.Schema) -> bytes:
    """A file with one row of a schema, written as all tables are."""
    columns = []
    for field in schema:
        kind = field.type
        if pa.types.is_dictionary(kind):
            columns.append(pa.DictionaryArray.from_arrays(pa.array([0], kind.index_type), pa.array(["a"])))
        elif pa.types.is_fixed_size_list(kind) or pa.types.is_list(kind):
            length = kind.list_size if pa.types.is_fixed_size_list(kind) else 1
            columns.append(pa.array([[0] * length], kind))
        else:
            columns.append(pa.array([0], pa.int8()).cast(kind))
    out = io.BytesIO()
    with pq.ParquetWriter(out, schema, **WRITTEN) as writer:
        writer.write_table(pa.Table.from_arrays(columns, schema=schema))
    return out.getvalue()


def _write(
    source: Path,
    path: Path,
    header: Header,
    table: type[Table],
    found: Iterator[Table | Lost],
    before: tuple[Loss, ...],
    overwrite: bool,
) -> RecoveredTable:
    """Write what is whole, and gather what is not with the times of the rows around it."""
    losses, open_losses = list(before), Counter[str]()  # of the latter: rows by what is lost
    last: int | None = None
    span: tuple[int, int] | None = None

    def place(until: int | None) -> str:
        if last is None and until is None:
            return "all of it"
        if last is None:
            return f"before {utc(until or 0)}"
        return f"after {utc(last)}" if until is None else f"{utc(last)} to {utc(until)}"

    def close(until: int | None) -> None:
        losses.extend(Loss(source.name, place(until), what, count) for what, count in open_losses.items())
        open_losses.clear()

    made = Provenance("recover", {}, None, hash_inputs([source]))
    with TableWriter(path, table, made, overwrite=overwrite, length_unit=header.length_unit) as writer:
        for part in found:
            if isinstance(part, Lost):
                open_losses[part.what] += part.rows
            elif len(part):
                times = part.t_ns  # type: ignore[attr-defined]
                close(int(times[0]))
                span = (int(times[0]) if span is None else span[0], int(times[-1]))
                last = int(times[-1])
                writer.write(part)
        if open_losses and not writer.rows:
            raise InputError(f"{source}: no group of rows is whole; copy it again, or make it again")
        close(None)
        told = tuple(losses)
        writer.annotate(Provenance("recover", {}, None, made.inputs, told))
        return RecoveredTable(writer.rows, span, told)
