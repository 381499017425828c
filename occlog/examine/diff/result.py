"""Results of a comparison, and the tolerances within which values are the same."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Scalar = str | bool | int | float | None
"""A value as JSON has it."""

RTOL = 1e-9
"""Relative tolerance of golden files: processors differ in the last bits."""

RTOL_SINGLE = 4.8e-7
"""The same for 4-byte numbers, whose last bit is larger: four of their steps."""


@dataclass(frozen=True)
class Limit:
    """Two numbers are the same if |a - b| <= atol + rtol max(|a|, |b|)."""

    atol: float = 0.0
    rtol: float = 0.0


@dataclass(frozen=True)
class Tolerances:
    """Limits of differences; integers and labels are compared exactly unless their column is named.

    Attributes:
        default: for every fractional number that no other entry names.
        columns: by `column` or `table.column` (or the last key of a JSON path).
        units: by unit, e.g. `rad` or `m`.
        time_ns: rows whose times differ by at most this are the same row.
    """

    default: Limit = Limit(rtol=RTOL)
    columns: Mapping[str, Limit] = field(default_factory=dict)
    units: Mapping[str, Limit] = field(default_factory=dict)
    time_ns: int = 0

    def named(self, table: str, column: str) -> Limit | None:
        """The tolerance of a column that is named, if it is."""
        return self.columns.get(f"{table}.{column}", self.columns.get(column))

    def of(self, table: str, column: str, unit: str = "1", single: bool = False) -> Limit:
        """The tolerance of a column of fractional numbers; `single` for 4-byte ones."""
        limit = self.named(table, column) or self.units.get(unit)
        if limit is not None:
            return limit
        if single and self.default.rtol == RTOL:
            return Limit(self.default.atol, RTOL_SINGLE)
        return self.default


@dataclass(frozen=True)
class Difference:
    """A row, value or content that is not the same in A and B.

    Attributes:
        kind: `value`, `missing` (only in A), `added` (only in B), `schema` or `content`.
        place: table, JSON path or file.
        key: key of the row, by column.
        column: column of the value, empty for whole rows.
        a, b: both values; None where there is none.
        difference: |a - b| where both are numbers; NaN where one of them is NaN.
        limit: largest difference that counts as the same.
        unit: of both values.
    """

    kind: str
    place: str
    key: Mapping[str, object] = field(default_factory=dict)
    column: str = ""
    a: Scalar = None
    b: Scalar = None
    difference: float | None = None
    limit: float | None = None
    unit: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return the fields as plain values for JSON, without empty ones."""
        out: dict[str, object] = {"kind": self.kind, "place": self.place}
        out |= {"key": dict(self.key)} if self.key else {}
        out |= {"column": self.column} if self.column else {}
        out |= {"a": self.a, "b": self.b} if self.kind not in ("missing", "added") or self.a != self.b else {}
        out |= {"difference": self.difference, "limit": self.limit} if self.difference is not None else {}
        return out | ({"unit": self.unit} if self.unit else {})


@dataclass(frozen=True)
class ColumnDifference:
    """Number of rows in which a column differs, and its largest difference."""

    rows: int
    largest: Difference

    def as_dict(self) -> dict[str, object]:
        """Return the fields as plain values for JSON."""
        return {"rows": self.rows, "largest": self.largest.as_dict()}


@dataclass(frozen=True)
class Comparison:
    """Two tables, JSON values or files compared.

    Attributes:
        name: of the table or file.
        what: unit of the counts: `rows`, `values`, `bytes` or `files`.
        count_a, count_b: their number in each.
        matched: number in both.
        missing, added: number only in A, only in B.
        columns: columns that differ, in the order of the table.
        schema: differences of the declaration: columns, types, units, versions.
        first: the first difference, in the order of time; None if there is none.
    """

    name: str
    what: str = "rows"
    count_a: int = 0
    count_b: int = 0
    matched: int = 0
    missing: int = 0
    added: int = 0
    columns: Mapping[str, ColumnDifference] = field(default_factory=dict)
    schema: tuple[Difference, ...] = ()
    first: Difference | None = None

    @property
    def same(self) -> bool:
        """True if nothing differs."""
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
