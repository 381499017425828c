"""Comparison of two files that hold tables: of occlog, or of other programs."""

from __future__ import annotations

import difflib
from dataclasses import replace
from pathlib import Path

from occlog.errors import InputError, UsageError
from occlog.io.files.tables.parquet import describe, iter_table
from occlog.io.open import Opened, check_unit, open_if_ours
from occlog.records.columns import Table
from occlog.records.tables import TABLES, table_with

from .json import compare_provenance
from .result import Comparison, Difference, DiffSettings
from .stage import diff_schemas, diff_tables


def compare_tables(
    a: Path, b: Path, name: str, settings: DiffSettings, *, alone: bool = False
) -> list[Comparison] | None:
    """Compare two tables; None where a file is none, or was made by another program and fits none of our tables.

    Args:
        a: first file.
        b: second file.
        name: of both in a folder.
        settings: tolerances, and whether it counts how the files were made.
        alone: there are no other files, so that tables of two kinds, and tolerances of unknown columns, are refused.
    """
    left, right = open_if_ours(a), open_if_ours(b)
    if left is None or right is None:
        return None
    if left.foreign is not None or right.foreign is not None:
        return [_compare_others(left, right, name, settings, alone)]
    if alone:
        _check_kinds(a, b, settings)
    return _compare_ours(a, b, name, settings)


def _check_kinds(a: Path, b: Path, settings: DiffSettings) -> None:
    """Raise UsageError for tables of two kinds, and for tolerances of columns that they do not have."""
    said_a, said_b = describe(a), describe(b)
    if said_a["schema"] != said_b["schema"]:
        raise UsageError(f"{a} holds {said_a['schema']} and {b} holds {said_b['schema']}; give two tables of one kind")
    _check_named(said_a["schema"], [c["name"] for c in said_a["columns"]], settings)


def _check_named(table: str, names: list[str], settings: DiffSettings) -> None:
    for wanted in settings.tolerances.columns:
        if wanted.rpartition(".")[2] not in names:
            near = difflib.get_close_matches(wanted, names, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"columns: {', '.join(names)}"
            raise UsageError(f"--tol {wanted}: {table} has no such column; {hint}")


def _compare_others(a: Opened, b: Opened, name: str, settings: DiffSettings, alone: bool) -> Comparison:
    """Compare two tables, of which others made one or both: by the columns that both have, in one unit of length."""
    first, second = (b, a) if b.foreign is None else (a, b)
    table = TABLES[first.table]
    second.require(table)
    if first.length_unit is not None:
        check_unit(second, first.length_unit, str(first.path), InputError)
    names_a, names_b = _columns(a, table), _columns(b, table)
    if alone:
        _check_named(table.NAME, names_a, settings)
    schema = [Difference("schema", name, {}, each, a="column") for each in names_a if each not in names_b]
    schema += [Difference("schema", name, {}, each, b="column") for each in names_b if each not in names_a]
    both = frozenset(names_a) & frozenset(names_b)
    found = diff_tables(table, a.rows(table), b.rows(table), settings.tolerances, both)
    return replace(found, name=name, schema=tuple(schema))


def _columns(opened: Opened, table: type[Table]) -> list[str]:
    """Names of the columns of a table that a file has."""
    if opened.foreign is not None:
        return [s.column.name for s in opened.foreign.layout_of(table).columns]
    return [c["name"] for c in describe(opened.path)["columns"]]


def _compare_ours(a: Path, b: Path, name: str, settings: DiffSettings) -> list[Comparison]:
    """Compare what two tables declare, their rows, and with `provenance` how they were made."""
    said_a, said_b = describe(a), describe(b)
    schema = diff_schemas(name, said_a, said_b)
    if said_a["schema"] not in TABLES:
        raise InputError(f"{a}: unknown table {said_a['schema']!r}; occlog knows {', '.join(TABLES)}")
    if any(found.column != "length_unit" and found.key.get("entry") != "unit" for found in schema):
        # Rows of different tables, or with different columns, cannot be joined.
        found = Comparison(name, "rows", count_a=said_a["rows"], count_b=said_b["rows"], schema=schema)
    else:
        # Tables of one name may have more columns than the one that it stands for
        table = table_with(said_a["schema"], [c["name"] for c in said_a["columns"]])
        rows = diff_tables(table, iter_table(a, table), iter_table(b, table), settings.tolerances)
        found = replace(rows, name=name, schema=schema)
    if not settings.provenance:
        return [found]
    return [found, compare_provenance(name, said_a["provenance"], said_b["provenance"])]
