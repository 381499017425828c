"""Are two tables the same, and where do they first differ?

Whether two columns of joined rows are the same, value by value.

Two tables side by side in pieces that belong together, so that memory does not grow with their length.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.errors import InputError
from occlog.records.columns import Column, Table

from .join import Join, join
from .result import ColumnDifference, Comparison, Difference, Limit, Tolerances

TURN = 2.0 * np.pi


class Values(NamedTuple):
    """A column of M joined rows compared; for wide columns the worst entry of each row."""

    differ: Bools  # (M,)
    difference: Floats  # (M,) |a - b|; NaN for labels and where just one is NaN
    limit: Floats  # (M,) what it had to stay below
    entry: NDArray[np.int64]  # (M,) which entry of a wide column that is


def is_angle(c: Column) -> bool:
    """Whether a column is an angle, for which a whole turn makes no difference; deviations are not."""
    return c.unit == "rad" and not c.name.startswith("sigma")


def compare_values(a: NDArray[Any], b: NDArray[Any], c: Column, table: str, tolerances: Tolerances) -> Values:
    """Compare two columns of equal length.

    Labels, truth values and whole numbers must be equal, the latter within the limit if
    the column is named in the tolerances.  NaN equals NaN; an infinity only itself.
    """
    if c.kind in ("U", "?"):
        nothing = np.full(len(a), np.nan)
        return Values(np.asarray(a != b), nothing, np.zeros(len(a)), np.zeros(len(a), np.int64))
    if c.dtype.kind in "iu":
        return _whole(a, b, tolerances.named(table, c.name) or Limit())
    limit = tolerances.of(table, c.name, c.unit, single=c.kind == "f4")
    return _worst(*_fractional(a.astype(np.float64), b.astype(np.float64), limit, is_angle(c)))


def _whole(a: NDArray[Any], b: NDArray[Any], limit: Limit) -> Values:
    wide_a, wide_b = a.astype(np.int64), b.astype(np.int64)
    # As unsigned numbers the difference of any two is right.
    with np.errstate(over="ignore"):
        apart = np.where(wide_a > wide_b, wide_a - wide_b, wide_b - wide_a).view(np.uint64).astype(np.float64)
    allowed = limit.atol + limit.rtol * np.maximum(np.abs(wide_a.astype(float)), np.abs(wide_b.astype(float)))
    differ = (wide_a != wide_b) & ~(apart <= allowed)
    return Values(differ, apart, allowed, np.zeros(len(a), np.int64))


def _fractional(a: Floats, b: Floats, limit: Limit, angle: bool) -> tuple[Bools, Floats, Floats]:
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(a - b)
        if angle:
            apart = apart % TURN
            apart = np.minimum(apart, TURN - apart)
        allowed = limit.atol + limit.rtol * np.maximum(np.abs(a), np.abs(b))
        near = np.isfinite(apart) & (apart <= allowed)
    return ~(same | near), np.where(same, 0.0, apart), allowed


def _worst(differ: Bools, apart: Floats, allowed: Floats) -> Values:
    """The entry of each row that is farthest apart, those that differ first."""
    if differ.ndim == 1:
        return Values(differ, apart, allowed, np.zeros(len(differ), np.int64))
    badness = np.where(differ, np.where(np.isnan(apart), np.inf, apart), -1.0)
    entry = np.argmax(badness, axis=1)
    rows = np.arange(len(differ))
    return Values(np.asarray(differ.any(axis=1)), apart[rows, entry], allowed[rows, entry], entry)


T = TypeVar("T", bound=Table)
LAST = np.iinfo(np.int64).max


class _Side:
    """Chunks of one table and the rows that have not been handed out yet."""

    def __init__(self, chunks: Iterable[Table], kind: type[Table], name: str) -> None:
        self._chunks = iter(chunks)
        self._name = name
        self.rows = kind.empty()
        self.until: int = np.iinfo(np.int64).min  # rows before this time have all arrived

    def pull(self) -> None:
        """Read the next chunk that has rows."""
        for chunk in self._chunks:
            if not len(chunk):
                continue
            t_ns = times(chunk)
            if len(self.rows) and t_ns[0] < times(self.rows)[-1]:
                raise InputError(f"{self._name}: t_ns goes back between two chunks ({t_ns[0]}); sort the table by t_ns")
            self.rows = type(chunk).concat([self.rows, chunk])
            self.until = int(t_ns[-1])
            return
        self.until = LAST

    def take_before(self, cut: int) -> Table:
        """Hand out the rows before a time; all of them at the end."""
        n = len(self.rows) if cut == LAST else int(np.searchsorted(times(self.rows), cut))
        out, self.rows = self.rows.take(slice(0, n)), self.rows.take(slice(n, None))
        return out


def times(table: Table) -> Ints:
    """The t_ns column."""
    out: Ints = getattr(table, "t_ns")  # noqa: B009
    return out


def side_by_side(kind: type[T], a: Iterable[T], b: Iterable[T], slack_ns: int = 0) -> Iterator[tuple[T, T]]:
    """Pieces of both tables that cover the same time, one after the other.

    Args:
        kind: the table.
        a: chunks of the first table in the order of time; a time may be split over two chunks.
        b: chunks of the second table, likewise.
        slack_ns: rows up to this far apart are kept in the same piece, whichever table
            they are in.

    Raises:
        InputError: the chunks of a table are not in the order of time.
    """
    left, right = _Side(a, kind, f"{kind.NAME} A"), _Side(b, kind, f"{kind.NAME} B")
    while True:
        # The side that lags behind is read first.
        for side in (left, right):
            if side.until <= min(left.until, right.until) and side.until != LAST:
                side.pull()
        cut = _cut(times(left.rows), times(right.rows), min(left.until, right.until), slack_ns)
        pieces = left.take_before(cut), right.take_before(cut)
        if len(pieces[0]) or len(pieces[1]):
            yield pieces  # type: ignore[misc]
        if left.until == right.until == LAST:
            return


def _cut(t_a: Ints, t_b: Ints, until: int, slack_ns: int) -> int:
    """The latest time up to `until` before which both tables are complete and after a pause longer than the slack."""
    if until == LAST or slack_ns == 0:
        return until
    union = np.union1d(t_a, t_b)
    starts = union[1:][np.diff(union) > slack_ns]
    starts = starts[starts <= until]
    return int(starts[-1]) if len(starts) else int(union[0]) if len(union) else until


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
            self.kind.NAME,
            "rows",
            self.rows_a,
            self.rows_b,
            self.matched,
            self.missing,
            self.added,
            columns,
            first=self.first,
        )


def _size(difference: float | None) -> float:
    return np.inf if difference is None or np.isnan(difference) else difference


def _key(table: Table, row: int) -> dict[str, Any]:
    return {name: getattr(table, name)[row].item() for name in type(table).KEY}
