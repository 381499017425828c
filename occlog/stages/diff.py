"""Are two tables the same, and where do they first differ?"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from ..columns import Column, Ints, Table
from .diff_join import Join, join
from .diff_result import ColumnDifference, Comparison, Difference, Tolerances
from .diff_stream import side_by_side
from .diff_values import Values, compare_values

T = TypeVar("T", bound=Table)


def diff_tables(kind: type[T], a: Iterable[T], b: Iterable[T], tolerances: Tolerances | None = None) -> Comparison:
    """Compare two tables of one kind, given in chunks ordered by time.

    Rows are joined by the table's key (see `diff_join.join`); columns of joined rows are
    compared with `diff_values.compare_values`.  Memory does not grow with the length of
    the tables.

    Raises:
        InputError: the chunks of a table are not in the order of time.
    """
    limits = tolerances or Tolerances()
    tally = _Tally(kind, limits)
    for piece_a, piece_b in side_by_side(kind, a, b, limits.time_ns):
        tally.add(piece_a, piece_b)
    return tally.result()


@dataclass
class _Tally:
    """Counts so far."""

    kind: type[Table]
    tolerances: Tolerances
    rows_a: int = 0
    rows_b: int = 0
    matched: int = 0
    missing: int = 0
    added: int = 0
    first: Difference | None = None
    rows: dict[str, int] = field(default_factory=dict)
    largest: dict[str, Difference] = field(default_factory=dict)

    def add(self, a: Table, b: Table) -> None:
        """Compare one piece of both tables, later than all pieces before it."""
        found = join(a, b, self.tolerances.time_ns)
        self.rows_a += len(a)
        self.rows_b += len(b)
        self.matched += len(found.a)
        self.missing += len(found.only_a)
        self.added += len(found.only_b)
        firsts = self._alone(a, b, found)
        for c in self.kind.columns():
            firsts += self._column(c, a, b, found)
        if self.first is None and firsts:
            # Of equal keys whole rows come before values, and columns in the table's order (a stable choice).
            self.first = min(firsts, key=lambda item: item[0])[1]

    def _alone(self, a: Table, b: Table, found: Join) -> list[tuple[int, Difference]]:
        """The first rows that are only in one of the tables, with their rank."""
        out = []
        for kind, table, rows, rank in (
            ("missing", a, found.only_a, found.rank_a),
            ("added", b, found.only_b, found.rank_b),
        ):
            if len(rows):
                row = int(rows[0])
                out.append((int(rank[row]), Difference(kind, self.kind.NAME, _key(table, row))))
        return out

    def _column(self, c: Column, a: Table, b: Table, found: Join) -> list[tuple[int, Difference]]:
        """Count where a column differs; its first difference in this piece with its rank."""
        if c.name in self.kind.KEY:
            return []
        values_a, values_b = getattr(a, c.name)[found.a], getattr(b, c.name)[found.b]
        values = compare_values(values_a, values_b, c, self.kind.NAME, self.tolerances)
        rows = np.flatnonzero(values.differ)
        if not len(rows):
            return []
        self.rows[c.name] = self.rows.get(c.name, 0) + len(rows)
        self._keep_largest(c, a, b, found, values, rows)
        first = int(rows[0])
        return [(int(found.rank_a[found.a[first]]), self._difference(c, a, b, found, values, first))]

    def _keep_largest(self, c: Column, a: Table, b: Table, found: Join, values: Values, rows: Ints) -> None:
        # A NaN on one side only counts as the largest difference there is.
        apart = np.where(np.isnan(values.difference[rows]), np.inf, values.difference[rows])
        row = int(rows[np.argmax(apart)])
        before = self.largest.get(c.name)
        if before is None or _size(before.difference) < _size(float(values.difference[row])):
            self.largest[c.name] = self._difference(c, a, b, found, values, row)

    def _difference(self, c: Column, a: Table, b: Table, found: Join, values: Values, row: int) -> Difference:
        row_a, row_b = int(found.a[row]), int(found.b[row])
        value_a, value_b = getattr(a, c.name)[row_a], getattr(b, c.name)[row_b]
        name = c.name
        if c.width:
            entry = int(values.entry[row])
            value_a, value_b, name = value_a[entry], value_b[entry], f"{c.name}[{entry}]"
        labels = c.kind in ("U", "?")
        return Difference(
            "value",
            self.kind.NAME,
            _key(a, row_a),
            name,
            value_a.item(),
            value_b.item(),
            None if labels else float(values.difference[row]),
            None if labels else float(values.limit[row]),
            "" if c.unit == "1" else c.unit,
        )

    def result(self) -> Comparison:
        """The comparison of all pieces."""
        order = [c.name for c in self.kind.columns() if c.name in self.rows]
        columns = {name: ColumnDifference(self.rows[name], self.largest[name]) for name in order}
        return Comparison(
            self.kind.NAME, "rows", self.rows_a, self.rows_b, self.matched, self.missing, self.added, columns,
            first=self.first,
        )  # fmt: skip


def _size(difference: float | None) -> float:
    return np.inf if difference is None or np.isnan(difference) else difference


def _key(table: Table, row: int) -> dict[str, Any]:
    return {name: getattr(table, name)[row].item() for name in type(table).KEY}
