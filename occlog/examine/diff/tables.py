"""Comparison of two files that hold occlog or external tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from decimal import Decimal
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from occlog.errors import InputError, UsageError, did_you_mean, option
from occlog.io.files.tables.parquet import describe, iter_table
from occlog.io.open import Opened, check_unit, common_unit, open_if_ours
from occlog.records.columns import ColumnTable
from occlog.records.tables import TABLES, table_with

from .content import compare_provenance, compare_verdicts
from .result import DiffResult, DiffSettings, RowDifference, Scalar
from .stage import diff_schemas, diff_tables

if TYPE_CHECKING:
    from occlog.io.external.table import ExternalTable


def compare_tables(
    a: Path, b: Path, name: str, settings: DiffSettings, *, alone: bool = False
) -> list[DiffResult] | None:
    """Compare two tables; None if a file is not a table, or an external table that fits no occlog table.

    Args:
        a: first file.
        b: second file.
        name: name of the two files in the result.
        settings: tolerances, and whether provenance is compared.
        alone: there are no other files, so that tables of two kinds, and tolerances of unknown columns, are refused.
    """
    left, right = open_if_ours(a), open_if_ours(b)
    if left is None or right is None:
        return None
    if left.external_table is not None or right.external_table is not None:
        return [_compare_others(left, right, name, settings, alone)]
    if alone:
        _check_kinds(a, b, settings)
    return _compare_ours(a, b, name, settings)


def _check_kinds(a: Path, b: Path, settings: DiffSettings) -> None:
    """Raise UsageError for tables of two kinds, and for tolerances of columns that they do not have."""
    stated_a, stated_b = describe(a), describe(b)
    if stated_a["schema"] != stated_b["schema"]:
        raise UsageError(
            f"{a} holds {stated_a['schema']} and {b} holds {stated_b['schema']}; give two tables of one kind",
            id="incompatible-inputs",
        )
    names = dict.fromkeys(c["name"] for stated in (stated_a, stated_b) for c in stated["columns"])
    _check_named(stated_a["schema"], list(names), settings)


def _check_named(table: str, names: list[str], settings: DiffSettings) -> None:
    for wanted in settings.tolerances.columns:
        if wanted.rpartition(".")[2] not in names:
            raise UsageError(
                f"{option('tol')} {wanted}: {table} has no such column; {did_you_mean(wanted, names)}",
                id="unknown-column",
            )


def _compare_others(a: Opened, b: Opened, name: str, settings: DiffSettings, alone: bool) -> DiffResult:
    """Compare two tables, of which at least one is external, by common columns in one length unit.

    Args:
        a: first table.
        b: second table.
        name: name of the files in the result.
        settings: tolerances.
        alone: these two files are all that is compared, so that a tolerance of a column that neither has is an error.
    """
    first, second = (b, a) if b.external_table is None else (a, b)
    kind = TABLES[first.table]
    second.require(kind)
    table = max((each.widest(kind) for each in (first, second)), key=lambda wide: len(wide.columns()))
    unit, source = common_unit((first, second))
    for each in (first, second):
        check_unit(each, unit, source, InputError)
    names_a, names_b = _columns(a, table), _columns(b, table)
    if alone:
        _check_named(table.NAME, list(dict.fromkeys([*names_a, *names_b])), settings)
    schema = [RowDifference("schema", name, {}, each, a="column") for each in names_a if each not in names_b]
    schema += [RowDifference("schema", name, {}, each, b="column") for each in names_b if each not in names_a]
    both = frozenset(names_a) & frozenset(names_b)
    found = diff_tables(table, a.rows(table), b.rows(table), settings.tolerances, both, unit)
    if a.external_table is not None and b.external_table is not None:
        schema += _compare_unused(a.external_table, b.external_table, table, name)
    return replace(found, name=name, schema=tuple(schema))


def _compare_unused(a: ExternalTable, b: ExternalTable, table: type[ColumnTable], name: str) -> list[RowDifference]:
    """Return the first difference of each column of two external tables that occlog's `table` does not have.

    A column that only one of them has is a difference too. `name`: name of the files in the result.
    """
    unused_a, unused_b = ([n for n in f.source.names if n not in f.layout_of(table).names] for f in (a, b))
    both = [n for n in unused_a if n in unused_b]
    out = [RowDifference("schema", name, {}, n, a="column") for n in unused_a if n not in both]
    out += [RowDifference("schema", name, {}, n, b="column") for n in unused_b if n not in both]
    open_ = dict.fromkeys(both)
    for row, (left, right) in enumerate(zip_longest(_raw_rows(a, both), _raw_rows(b, both)) if both else ()):
        for n, column in enumerate(both):
            values = (None if cells is None else cells[n] for cells in (left, right))
            value_a, value_b = values
            if column in open_ and value_a != value_b:
                out.append(RowDifference("value", name, {"entry": f"row {row}"}, column, a=value_a, b=value_b))
                del open_[column]
        if not open_:
            break
    return out


def _raw_rows(table: ExternalTable, names: Sequence[str]) -> Iterator[tuple[Scalar, ...]]:
    for cells in table.source.cells(names):
        yield from zip(*([_plain(value) for value in cells.raw(name)] for name in names), strict=True)


def _plain(value: object) -> Scalar:
    """Return a cell of an external table for comparison: a number regardless of its format, else text.

    None is empty text.
    """
    try:
        number = float(value) if isinstance(value, int | float | str | Decimal) else math.nan
    except (ValueError, OverflowError):
        number = math.nan
    exact = not isinstance(value, int) or abs(value) <= 2**53
    return number if math.isfinite(number) and exact else "" if value is None else str(value)


def _columns(opened: Opened, table: type[ColumnTable]) -> list[str]:
    """Return the names of a table's columns that a file has."""
    if opened.external_table is not None:
        return [s.column.name for s in opened.external_table.layout_of(table).columns]
    return [c["name"] for c in describe(opened.path)["columns"]]


def _compare_ours(a: Path, b: Path, name: str, settings: DiffSettings) -> list[DiffResult]:
    """Compare two occlog tables: declarations, rows, verdicts and, if the settings say so, provenance.

    Rows are compared only if the declared columns agree. `name`: name of the files in the results.
    """
    stated_a, stated_b = describe(a), describe(b)
    schema = diff_schemas(name, stated_a, stated_b)
    if stated_a["schema"] not in TABLES:
        raise InputError(
            f"{a}: unknown table {stated_a['schema']!r}; occlog knows {', '.join(TABLES)}", id="unknown-name"
        )
    if any(found.column != "length_unit" and found.key.get("entry") != "unit" for found in schema):
        # Rows of different tables, or with different columns, cannot be joined.
        found = DiffResult(name, "rows", count_a=stated_a["rows"], count_b=stated_b["rows"], schema=schema)
    else:
        # Tables of one name may have more columns than the one that it represents
        table = table_with(stated_a["schema"], [c["name"] for c in stated_a["columns"]])
        unit = stated_a["length_unit"] if stated_a["length_unit"] == stated_b["length_unit"] else ""
        rows = diff_tables(table, iter_table(a, table), iter_table(b, table), settings.tolerances, length_unit=unit)
        found = replace(rows, name=name, schema=schema)
    verdicts = compare_verdicts(name, a, b)
    if not settings.provenance:
        return [found, *verdicts]
    return [found, *verdicts, compare_provenance(name, stated_a["provenance"], stated_b["provenance"])]
