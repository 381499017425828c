"""Results of a comparison as text and JSON, and tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from occlog.io.files.timing.utc import time_words

Scalar = str | bool | int | float | None
"""A value as JSON has it."""

RTOL = 1e-9
"""Relative tolerance of golden files: processors differ in the last bits."""

RTOL_SINGLE = 4.8e-7
"""Relative tolerance of 4-byte numbers: four steps of their last bit."""
MAX_SCHEMA_LINES = 12


@dataclass(frozen=True)
class Limit:
    """Tolerance of a number: a and b are equal if |a - b| <= atol + rtol max(|a|, |b|)."""

    atol: float = 0.0
    rtol: float = 0.0


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of a comparison; integers and labels are compared exactly unless their column is named.

    Attributes:
        default: tolerance of every fractional number that no other entry names.
        columns: tolerances by `column` or `table.column` (or the last key of a JSON path).
        units: tolerances by unit, e.g. `rad` or `m`; those of lengths are converted for tables in other length units.
        time_ns: rows with times that differ by at most this are the same row [ns].
    """

    default: Limit = Limit(rtol=RTOL)
    columns: Mapping[str, Limit] = field(default_factory=dict)
    units: Mapping[str, Limit] = field(default_factory=dict)
    time_ns: int = 0

    def named(self, table: str, column: str) -> Limit | None:
        """Return the tolerance given for a column by `table.column` or its name; None without one."""
        return self.columns.get(f"{table}.{column}", self.columns.get(column))

    def of(self, table: str, column: str, unit: str = "1", single: bool = False) -> Limit:
        """Return the tolerance of a column of floats: as given for it or its unit, else the default.

        Args:
            table: name of the table.
            column: name of the column.
            unit: unit of the column.
            single: whether the column has 4-byte floats, for which the default relative tolerance is larger.
        """
        limit = self.named(table, column) or self.units.get(unit)
        if limit is not None:
            return limit
        if single and self.default.rtol == RTOL:
            return Limit(self.default.atol, RTOL_SINGLE)
        return self.default


@dataclass(frozen=True)
class DiffSettings:
    """Tolerances, and the parts of outputs that are compared.

    Attributes:
        tolerances: limits of differences.
        provenance: whether the statements of how outputs were made are compared too.
        pixels: whether frames are compared by their pixels, else by their encoded bytes.
        exclude: glob patterns of files that are skipped.
    """

    tolerances: Tolerances
    provenance: bool = False
    pixels: bool = False
    exclude: tuple[str, ...] = ()


@dataclass(frozen=True)
class RowDifference:
    """A row, value or content that differs between A and B.

    Attributes:
        kind: `value`, `missing` (only in A), `added` (only in B), `schema` or `content`.
        location: table, JSON path or file.
        key: key of the row, by column.
        column: column of the value, empty for whole rows.
        a, b: both values; None if missing.
        difference: |a - b| of numbers; NaN if one of them is NaN; None: no numbers.
        limit: largest difference that counts as equal.
        unit: unit of both values.
    """

    kind: str
    location: str
    key: Mapping[str, object] = field(default_factory=dict)
    column: str = ""
    a: Scalar = None
    b: Scalar = None
    difference: float | None = None
    limit: float | None = None
    unit: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return the fields as plain values for JSON, without empty ones."""
        out: dict[str, object] = {"kind": self.kind, "place": self.location}
        out |= {"key": dict(self.key)} if self.key else {}
        out |= {"column": self.column} if self.column else {}
        out |= {"a": self.a, "b": self.b} if self.kind not in ("missing", "added") or self.a != self.b else {}
        out |= {"difference": self.difference, "limit": self.limit} if self.difference is not None else {}
        return out | ({"unit": self.unit} if self.unit else {})


@dataclass(frozen=True)
class ColumnDifference:
    """A column that differs: number of rows in which it does, and the largest difference."""

    rows: int
    largest: RowDifference

    def as_dict(self) -> dict[str, object]:
        """Return the fields as plain values for JSON."""
        return {"rows": self.rows, "largest": self.largest.as_dict()}


@dataclass(frozen=True)
class DiffResult:
    """Result of comparing two tables, JSON values or files.

    Attributes:
        name: name of the table or file.
        what: unit of the counts: `rows`, `values`, `bytes` or `files`.
        count_a, count_b: number in each.
        matched: number in both.
        missing, added: number only in A, only in B.
        columns: columns that differ, in the order of the table.
        schema: differences of the declarations: columns, types, units, versions.
        first: the first difference, in the order of time; None: no difference.
    """

    name: str
    what: str = "rows"
    count_a: int = 0
    count_b: int = 0
    matched: int = 0
    missing: int = 0
    added: int = 0
    columns: Mapping[str, ColumnDifference] = field(default_factory=dict)
    schema: tuple[RowDifference, ...] = ()
    first: RowDifference | None = None

    @property
    def same(self) -> bool:
        """Whether rows and declarations have no difference."""
        return self.first is None and not self.schema

    def as_dict(self) -> dict[str, object]:
        """Return the fields as plain values for JSON."""
        return {
            "name": self.name,
            "same": self.same,
            self.what: {"a": self.count_a, "b": self.count_b, "matched": self.matched},
            "missing": self.missing,
            "added": self.added,
            "columns": {name: found.as_dict() for name, found in self.columns.items()},
            "schema": [found.as_dict() for found in self.schema],
            "first": self.first.as_dict() if self.first is not None else None,
        }


def as_dict(found: Sequence[DiffResult]) -> dict[str, object]:
    """Return all comparisons as plain values for JSON; `first` is that of the first part that differs."""
    different = [part for part in found if not part.same]
    return {
        "same": not different,
        "first": {"name": different[0].name, **_first(different[0])} if different else None,
        "parts": [part.as_dict() for part in found],
    }


def _first(part: DiffResult) -> dict[str, object]:
    first = part.schema[0] if part.schema else part.first
    return first.as_dict() if first is not None else {}


def report_lines(found: Sequence[DiffResult]) -> list[str]:
    """Return all comparisons as lines of text, with a summary at the end."""
    different = [part for part in found if not part.same]
    lines = [line for part in found for line in comparison_lines(part)]
    if not found:
        return ["same: there is nothing to compare"]
    if len(found) == 1:
        return lines
    head = f"{len(different)} of {len(found)} parts differ, first: {different[0].name}" if different else "the same"
    return [*lines, head]


def comparison_lines(found: DiffResult) -> list[str]:
    """Return lines of text on one comparison: counts, differences of declarations, first and largest differences."""
    if found.same:
        return [f"same       {found.name}{_count(found)}"]
    if found.what == "files":
        where = "A" if found.first is not None and found.first.kind == "missing" else "B"
        return [f"different  {found.name}: only in {where}"]
    lines = [f"different  {found.name}: {_counts(found)}"]
    lines += [f"    schema  {_schema(item)}" for item in found.schema[:MAX_SCHEMA_LINES]]
    if len(found.schema) > MAX_SCHEMA_LINES:
        lines.append(f"    schema  and {len(found.schema) - MAX_SCHEMA_LINES} more differences")
    if found.first is not None:
        lines.append(f"    first   {difference_words(found.first)}")
    width = max((len(name) for name in found.columns), default=0)
    for name, column in found.columns.items():
        what = f"{found.what} differ" if column.rows != 1 else f"{found.what.removesuffix('s')} differs"
        lines.append(f"    {name:<{width}}  {column.rows} {what}, most {_most(column.largest)}")
    return lines


def _count(found: DiffResult) -> str:
    return f" ({found.count_a} {found.what})" if found.what != "files" else ""


def _counts(found: DiffResult) -> str:
    if found.what == "bytes":
        return f"{found.count_a} and {found.count_b} bytes"
    if not found.matched and not found.missing and not found.added:
        return f"{found.count_a} and {found.count_b} {found.what}, not compared"
    text = f"{found.count_a} and {found.count_b} {found.what}, {found.matched} in both"
    text += f", {found.missing} only in A" if found.missing else ""
    return text + (f", {found.added} only in B" if found.added else "")


def _schema(found: RowDifference) -> str:
    if found.a == "column" or found.b == "column":
        return f"column {found.column} is only in {'A' if found.a == 'column' else 'B'}"
    what = f"{found.key['entry']} of {found.column}" if found.key else found.column.replace("_", " ")
    return f"{what}: {found.a} in A, {found.b} in B"


def difference_words(found: RowDifference) -> str:
    """Return one difference as text: position, both values, their distance and the limit."""
    location = _key(found.key)
    if found.kind in ("missing", "added"):
        where, value = ("A", found.a) if found.kind == "missing" else ("B", found.b)
        return f"only in {where}: {location}" + (f" = {value!r}" if value is not None else "")
    if found.kind == "content":
        if found.a is None and found.b is None:
            return f"at {location}"
        return f"at {location}: {_line(found.a)} in A, {_line(found.b)} in B"
    column = f": {found.column}" if found.column and "path" not in found.key else ""
    return f"{location}{column} is {found.a!r} in A, {found.b!r} in B{_difference_text(found)}"


def _line(text: Scalar) -> str:
    return "the end" if text is None else repr(text)


def _difference_text(found: RowDifference) -> str:
    if found.difference is None or math.isnan(found.difference):
        return ""
    unit = f" {found.unit}" if found.unit else ""
    return f" ({found.difference:.6g}{unit} apart, limit {found.limit:.3g})"


def _most(found: RowDifference) -> str:
    where = _key(found.key)
    if found.difference is None or math.isnan(found.difference):
        return f"at {where}: {found.a!r} and {found.b!r}"
    unit = f" {found.unit}" if found.unit else ""
    return f"by {found.difference:.6g}{unit} at {where}"


def _key(key: Mapping[str, object]) -> str:
    """Return the key of a row as text, as `time 2023-11-14T22:13:20.000Z, sensor cam1`; of JSON the path."""
    if "path" in key:
        return str(key["path"])
    return ", ".join(_key_part(name, value) for name, value in key.items()) or "the row"


def _key_part(name: str, value: object) -> str:
    return f"time {time_words(value)}" if name == "t_ns" and isinstance(value, int) else f"{name} {value}"
