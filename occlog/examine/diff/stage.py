"""Comparison of two tables: rows, columns of joined rows, and what the tables declare.

Rows are joined by their keys, and columns of joined rows are compared value by value. Both tables are read in parts
that cover the same time, so that memory is bounded. Rows are joined by key, by order among equal keys, and by nearest
time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.records.columns import ANY_WIDTH, LENGTHS, Column, ColumnTable, in_length_unit
from occlog.records.tables import FIRST, LAST, TableBuffer, times
from occlog.settings import METRES

from .result import ColumnDifference, DiffResult, Limit, RowDifference, Tolerances

T = TypeVar("T", bound=ColumnTable)


class Join(NamedTuple):
    """Joined rows of tables A and B, and rows without a counterpart.

    `a`, `b`: (M,) rows of A by ascending key, and their partners in B; `only_a`, `only_b`: rows without a partner, by
    ascending key; `rank_a` (N_a,), `rank_b` (N_b,): ranks of the rows' keys over both tables.
    """

    a: Ints  # (M,) rows of A, by ascending key
    b: Ints  # (M,) their partners in B
    only_a: Ints  # by ascending key
    only_b: Ints
    rank_a: Ints  # (N_a,)
    rank_b: Ints  # (N_b,)


def join(a: T, b: T, time_ns: int = 0) -> Join:
    """Join two tables of one type by their keys.

    Rows with equal keys are paired in order. With `time_ns` > 0, each remaining row is paired with the nearest row in
    time, at most this far away [ns], that has the same other key columns.
    """
    rank_a, rank_b = _ranks(a, b, type(a).KEY)
    unique_a, unique_b = _numbered(rank_a, rank_b)
    _, rows_a, rows_b = np.intersect1d(unique_a, unique_b, assume_unique=True, return_indices=True)
    alone_a, alone_b = _others(rows_a, len(a)), _others(rows_b, len(b))
    if time_ns > 0 and len(alone_a) and len(alone_b):
        more_a, more_b = _nearest(a, b, alone_a, alone_b, time_ns)
        rows_a, rows_b = np.concatenate([rows_a, more_a]), np.concatenate([rows_b, more_b])
        alone_a, alone_b = _others(rows_a, len(a)), _others(rows_b, len(b))
    order = np.argsort(rank_a[rows_a], kind="stable")
    return Join(
        a=rows_a[order],
        b=rows_b[order],
        only_a=alone_a[np.argsort(rank_a[alone_a], kind="stable")],
        only_b=alone_b[np.argsort(rank_b[alone_b], kind="stable")],
        rank_a=rank_a,
        rank_b=rank_b,
    )


def _ranks(a: ColumnTable, b: ColumnTable, names: tuple[str, ...]) -> tuple[Ints, Ints]:
    """Return the rank of each row's key, i.e. the columns `names`, among the keys of both tables: (len(a),), (len(b),).

    Equal keys have equal ranks.
    """
    rank = np.zeros(len(a) + len(b), dtype=np.int64)
    for name in names:
        values: NDArray[np.generic] = np.concatenate([getattr(a, name), getattr(b, name)])
        found, code = np.unique(values, return_inverse=True)
        # Renumber after each column from 0 without gaps, so that the product cannot overflow.
        _, rank = np.unique(rank * max(len(found), 1) + code, return_inverse=True)
    return rank[: len(a)], rank[len(a) :]


def _numbered(rank_a: Ints, rank_b: Ints) -> tuple[Ints, Ints]:
    """Return numbers (n,) and (m,) of rows in the order of their ranks, distinct also for equal ranks within a table.

    The first rows with a rank have equal numbers in both tables, then the second ones, and so on.
    """
    number_a, number_b = _occurrence(rank_a), _occurrence(rank_b)
    most = int(max(number_a.max(initial=0), number_b.max(initial=0))) + 1
    return rank_a * most + number_a, rank_b * most + number_b


def _occurrence(rank: Ints) -> Ints:
    """Return for each value of `rank` (n,) the number of equal values before it (n,)."""
    order = np.argsort(rank, kind="stable")
    ordered = rank[order]
    start = np.flatnonzero(np.concatenate([[True], np.diff(ordered) != 0])) if len(rank) else np.empty(0, np.int64)
    length = np.diff(np.append(start, len(rank)))
    out = np.empty(len(rank), dtype=np.int64)
    out[order] = np.arange(len(rank)) - np.repeat(start, length)
    return out


def _others(rows: Ints, n: int) -> Ints:
    mask: Bools = np.ones(n, dtype=np.bool_)
    mask[rows] = False
    return np.flatnonzero(mask)


def _nearest(a: ColumnTable, b: ColumnTable, rows_a: Ints, rows_b: Ints, time_ns: int) -> tuple[Ints, Ints]:
    """Pair rows that are mutually nearest in time, within groups of otherwise equal keys.

    Args:
        a: first table.
        b: second table.
        rows_a: rows of `a` that have no partner yet.
        rows_b: rows of `b` that have no partner yet.
        time_ns: largest difference in time [ns].

    Returns:
        Paired rows of `a` and of `b`, of equal length.
    """
    t_a, t_b = times(a)[rows_a], times(b)[rows_b]
    rest = tuple(name for name in type(a).KEY if name != "t_ns")
    group_a, group_b = _ranks(a.take(rows_a), b.take(rows_b), rest)
    pairs_a, pairs_b = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for group in np.intersect1d(group_a, group_b):
        own_a, own_b = np.flatnonzero(group_a == group), np.flatnonzero(group_b == group)
        found_a, found_b = _mutual(t_a[own_a], t_b[own_b], time_ns)
        pairs_a.append(rows_a[own_a[found_a]])
        pairs_b.append(rows_b[own_b[found_b]])
    return np.concatenate(pairs_a), np.concatenate(pairs_b)


def _mutual(t_a: Ints, t_b: Ints, time_ns: int) -> tuple[Ints, Ints]:
    """Pair times `t_a` (n,) and `t_b` (m,) [ns] that differ by at most `time_ns`.

    Return the indices into both, (k,) each. Pairs are mutual nearest neighbours, found repeatedly among the times that
    are left.
    """
    left_a, left_b = np.argsort(t_a, kind="stable"), np.argsort(t_b, kind="stable")
    pairs_a, pairs_b = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    while len(left_a) and len(left_b):
        to_b, to_a = _closest(t_a[left_a], t_b[left_b]), _closest(t_b[left_b], t_a[left_a])
        mutual = to_a[to_b] == np.arange(len(left_a))
        mutual &= np.abs(t_a[left_a] - t_b[left_b[to_b]]) <= time_ns
        if not mutual.any():
            break
        found_a, found_b = left_a[mutual], left_b[to_b[mutual]]
        pairs_a.append(found_a)
        pairs_b.append(found_b)
        left_a = left_a[~mutual]
        left_b = left_b[~np.isin(left_b, found_b)]
    return np.concatenate(pairs_a), np.concatenate(pairs_b)


def _closest(t: Ints, known: Ints) -> Ints:
    """Return for each of `t` (n,) the index of the nearest of the sorted times `known` (m,); of two, the earlier."""
    after = np.minimum(np.searchsorted(known, t), len(known) - 1)
    before = np.maximum(after - 1, 0)
    chosen = np.where(np.abs(known[after] - t) < np.abs(t - known[before]), after, before)
    # Take the first of equal times, so that nearest neighbours of duplicates can be mutual.
    return np.searchsorted(known, known[chosen])


TURN = 2.0 * np.pi


class Values(NamedTuple):
    """Comparison of a column over M joined rows; for list columns, of the worst entry in each row.

    `differ`: (M,) mask; `difference`: (M,) |a - b|, NaN for labels and if only one value is NaN; `limit`: (M,) largest
    difference that counts as equal; `entry`: (M,) index of the worst entry of a list column.
    """

    differ: Bools  # (M,)
    difference: Floats  # (M,) |a - b|; NaN for labels and where just one is NaN
    limit: Floats  # (M,) largest difference that counts as the same
    entry: Ints  # (M,) index of the entry of a wide column


def is_angle(c: Column) -> bool:
    """Return whether a column is an angle [rad], to be compared modulo a full turn; standard deviations are not."""
    return c.unit == "rad" and not c.name.startswith(("sigma", "sd_"))


def compare_values(
    a: NDArray[np.generic], b: NDArray[np.generic], c: Column, table: str, tolerances: Tolerances
) -> Values:
    """Compare two columns of equal length, row by row.

    Labels, truth values and whole numbers must be equal, the latter within the limit if the column is named in the
    tolerances. NaN equals NaN; an infinity equals only itself.

    Args:
        a: values of the first table.
        b: values of the second table.
        c: declaration of the column.
        table: name of the table, by which the column has its tolerance.
        tolerances: tolerances of all columns.
    """
    if c.kind in ("U", "?"):
        nothing = np.full(len(a), np.nan)
        return Values(np.asarray(a != b), nothing, np.zeros(len(a)), np.zeros(len(a), np.int64))
    if c.dtype.kind in "iu":
        return _whole(a, b, tolerances.named(table, c.name) or Limit())
    limit = tolerances.of(table, c.name, c.unit, single=c.kind == "f4")
    return _worst(*_fractional(a.astype(np.float64), b.astype(np.float64), limit, is_angle(c)))


def _whole(a: NDArray[np.generic], b: NDArray[np.generic], limit: Limit) -> Values:
    wide_a, wide_b = a.astype(np.int64), b.astype(np.int64)
    # The difference of two 8-byte integers may overflow; taken as an unsigned number it is right.
    with np.errstate(over="ignore"):
        difference = np.where(wide_a > wide_b, wide_a - wide_b, wide_b - wide_a).view(np.uint64).astype(np.float64)
    allowed = limit.atol + limit.rtol * np.maximum(np.abs(wide_a.astype(float)), np.abs(wide_b.astype(float)))
    differ = (wide_a != wide_b) & ~(difference <= allowed)
    return Values(differ, difference, allowed, np.zeros(len(a), np.int64))


def _fractional(a: Floats, b: Floats, limit: Limit, angle: bool) -> tuple[Bools, Floats, Floats]:
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore", over="ignore"):
        difference = np.abs(a - b)
        if angle:
            difference = difference % TURN
            difference = np.minimum(difference, TURN - difference)
        allowed = limit.atol + limit.rtol * np.maximum(np.abs(a), np.abs(b))
        near = np.isfinite(difference) & (difference <= allowed)
    return ~(same | near), np.where(same, 0.0, difference), allowed


def _worst(differ: Bools, difference: Floats, allowed: Floats) -> Values:
    """Return for each row the entry with the largest difference; entries that differ have priority.

    Args:
        differ: (n,) or (n, k) mask of entries that differ.
        difference: of each entry, in that shape.
        allowed: limit of each entry, in that shape.
    """
    if differ.ndim == 1:
        return Values(differ, difference, allowed, np.zeros(len(differ), np.int64))
    badness = np.where(differ, np.where(np.isnan(difference), np.inf, difference), -1.0)
    entry = np.argmax(badness, axis=1)
    rows = np.arange(len(differ))
    return Values(np.asarray(differ.any(axis=1)), difference[rows, entry], allowed[rows, entry], entry)


def _similar(
    c: Column, a: NDArray[np.generic], b: NDArray[np.generic]
) -> tuple[NDArray[np.generic], NDArray[np.generic]]:
    """Return the columns `a` and `b` of two tables; lists of different lengths are padded with NaN."""
    if c.width != ANY_WIDTH or a.shape[1] == b.shape[1]:
        return a, b
    longest = max(a.shape[1], b.shape[1])
    wide = [np.pad(v, ((0, 0), (0, longest - v.shape[1])), constant_values=np.nan) for v in (a, b)]
    return wide[0], wide[1]


def _take_before(side: TableBuffer[T], cut: int) -> T:
    """Remove the rows before the time `cut` [ns] from the buffer, in place, and return them."""
    out = side.between(FIRST, cut)
    side.rows = side.rows.take(slice(len(out), None))
    return out


def side_by_side(kind: type[T], a: Iterable[T], b: Iterable[T], slack_ns: int = 0) -> Iterator[tuple[T, T]]:
    """Generate parts of both tables that cover the same time.

    Args:
        kind: type of both tables.
        a: chunks of the first table in the order of time; rows of one time may be in two chunks.
        b: chunks of the second table, in the order of time.
        slack_ns: rows up to this far apart [ns] are kept in one part, whichever table they are in.

    Raises:
        InputError: the chunks of a table are not in the order of time.
    """
    left, right = TableBuffer(a, kind, f"{kind.NAME} A"), TableBuffer(b, kind, f"{kind.NAME} B")
    while True:
        # The side that lags behind is read first.
        for side in (left, right):
            if side.until <= min(left.until, right.until) and side.until != LAST:
                side.pull()
        cut = _cut(times(left.rows), times(right.rows), min(left.until, right.until), slack_ns)
        pieces = _take_before(left, cut), _take_before(right, cut)
        if len(pieces[0]) or len(pieces[1]):
            yield pieces
        if left.until == right.until == LAST:
            return


def _cut(t_a: Ints, t_b: Ints, until: int, slack_ns: int) -> int:
    """Return the latest time [ns], up to `until`, before which a part may end: after a pause longer than the slack.

    Args:
        t_a: times of the buffered rows of the first table [ns].
        t_b: times of the buffered rows of the second table [ns].
        until: time up to which both are known [ns].
        slack_ns: largest difference in time of a pair [ns].
    """
    if until == LAST or slack_ns == 0:
        return until
    union = np.union1d(t_a, t_b)
    starts = union[1:][np.diff(union) > slack_ns]
    starts = starts[starts <= until]
    return int(starts[-1]) if len(starts) else int(union[0]) if len(union) else until


def diff_tables(
    kind: type[T],
    a: Iterable[T],
    b: Iterable[T],
    tolerances: Tolerances | None = None,
    only: frozenset[str] | None = None,
    length_unit: str = "m",
) -> DiffResult:
    """Compare two tables of one type, given in chunks in the order of time, in bounded memory.

    Rows are joined by the table's key (see `join`); columns of joined rows are compared by `compare_values`.

    Args:
        kind: type of both tables.
        a: chunks of the first table.
        b: chunks of the second table.
        tolerances: limits of differences; None: defaults.
        only: names of the columns to compare; None: all.
        length_unit: unit of both tables; empty: they have different ones.

    Raises:
        InputError: the chunks of a table are not in the order of time.
    """
    limits = _in_unit(tolerances or Tolerances(), length_unit)
    compared = [c for c in kind.columns() if c.name not in kind.KEY and (only is None or c.name in only)]
    tally = _Tally(kind, limits, compared, length_unit)
    for piece_a, piece_b in side_by_side(kind, a, b, limits.time_ns):
        tally.add(piece_a, piece_b)
    return tally.result()


def _in_unit(tolerances: Tolerances, length_unit: str) -> Tolerances:
    """Return the tolerances with those of lengths converted to the length unit of both tables.

    `length_unit`: empty if the tables have two, so that no tolerance of a length applies.
    """
    units = {unit: limit for unit, limit in tolerances.units.items() if unit not in LENGTHS}
    for unit, power in LENGTHS.items():
        for stated in (length_unit, *METRES):
            limit = tolerances.units.get(in_length_unit(unit, stated))
            if limit is None or (stated != length_unit and length_unit not in METRES):
                continue
            scale = 1.0 if stated == length_unit else (METRES[stated] / METRES[length_unit]) ** power
            units[unit] = Limit(limit.atol * scale, limit.rtol)
            break
    return replace(tolerances, units=units)


@dataclass
class _Tally:
    """Accumulated comparison of two tables A and B.

    Attributes:
        kind: class of both tables.
        tolerances: tolerances of all columns.
        compared: declarations of the compared columns.
        length_unit: unit of lengths in both tables; empty: different units.
        rows_a, rows_b: numbers of rows.
        matched: number of paired rows.
        missing, added: numbers of rows in A only and in B only.
        first: first difference in the order of rows; None: none.
        rows: number of rows that differ, by column.
        largest: largest difference, by column.
    """

    kind: type[ColumnTable]
    tolerances: Tolerances
    compared: Sequence[Column]
    length_unit: str
    rows_a: int = 0
    rows_b: int = 0
    matched: int = 0
    missing: int = 0
    added: int = 0
    first: RowDifference | None = None
    rows: dict[str, int] = field(default_factory=dict)
    largest: dict[str, RowDifference] = field(default_factory=dict)

    def add(self, a: ColumnTable, b: ColumnTable) -> None:
        """Compare the rows of both tables in one part of the time, which follows all parts before it."""
        found = join(a, b, self.tolerances.time_ns)
        self.rows_a += len(a)
        self.rows_b += len(b)
        self.matched += len(found.a)
        self.missing += len(found.only_a)
        self.added += len(found.only_b)
        firsts = self._alone(a, b, found)
        for c in self.compared:
            firsts += self._column(c, a, b, found)
        if self.first is None and firsts:
            # At equal keys whole rows go before values, and columns in the table's order: min takes the first.
            self.first = min(firsts, key=lambda item: item[0])[1]

    def _alone(self, a: ColumnTable, b: ColumnTable, found: Join) -> list[tuple[int, RowDifference]]:
        """Return the first row that is only in `a`, and the first that is only in `b`, as (rank, difference).

        Missing: none. `found`: how the rows are paired.
        """
        out = []
        for kind, table, rows, rank in (
            ("missing", a, found.only_a, found.rank_a),
            ("added", b, found.only_b, found.rank_b),
        ):
            if len(rows):
                row = int(rows[0])
                out.append((int(rank[row]), RowDifference(kind, self.kind.NAME, _key(table, row))))
        return out

    def _column(self, c: Column, a: ColumnTable, b: ColumnTable, found: Join) -> list[tuple[int, RowDifference]]:
        """Count the paired rows in which the column differs; return (rank, difference) of the first.

        Empty if none differs.

        Args:
            c: declaration of the column.
            a: part of the first table.
            b: part of the second table.
            found: pairs of row indices of the two parts.
        """
        values_a, values_b = _similar(c, getattr(a, c.name)[found.a], getattr(b, c.name)[found.b])
        if values_a.ndim == 2 and not values_a.shape[1]:
            return []
        values = compare_values(values_a, values_b, c, self.kind.NAME, self.tolerances)
        rows = np.flatnonzero(values.differ)
        if not len(rows):
            return []
        self.rows[c.name] = self.rows.get(c.name, 0) + len(rows)
        self._keep_largest(c, a, b, found, values, rows)
        first = int(rows[0])
        return [(int(found.rank_a[found.a[first]]), self._difference(c, a, b, found, values, first))]

    def _keep_largest(self, c: Column, a: ColumnTable, b: ColumnTable, found: Join, values: Values, rows: Ints) -> None:
        # NaN on one side alone counts as an infinite difference.
        difference = np.where(np.isnan(values.difference[rows]), np.inf, values.difference[rows])
        row = int(rows[np.argmax(difference)])
        before = self.largest.get(c.name)
        if before is None or _size(before.difference) < _size(float(values.difference[row])):
            self.largest[c.name] = self._difference(c, a, b, found, values, row)

    def _difference(
        self, c: Column, a: ColumnTable, b: ColumnTable, found: Join, values: Values, row: int
    ) -> RowDifference:
        row_a, row_b = int(found.a[row]), int(found.b[row])
        value_a, value_b = getattr(a, c.name)[row_a], getattr(b, c.name)[row_b]
        name = c.name
        if c.width:
            entry = int(values.entry[row])
            (value_a,), (value_b,) = _similar(c, value_a[None], value_b[None])
            value_a, value_b, name = value_a[entry], value_b[entry], f"{c.name}[{entry}]"
        labels = c.kind in ("U", "?")
        return RowDifference(
            kind="value",
            location=self.kind.NAME,
            key=_key(a, row_a),
            column=name,
            a=value_a.item(),
            b=value_b.item(),
            difference=None if labels else float(values.difference[row]),
            limit=None if labels else float(values.limit[row]),
            unit=self._unit(c),
        )

    def _unit(self, c: Column) -> str:
        """Return the unit of a column for messages.

        Empty without a unit, or if the tables have different length units.
        """
        if c.unit == "1" or (c.unit in LENGTHS and not self.length_unit):
            return ""
        return in_length_unit(c.unit, self.length_unit)

    def result(self) -> DiffResult:
        """Return the comparison over all parts."""
        order = [c.name for c in self.kind.columns() if c.name in self.rows]
        columns = {name: ColumnDifference(self.rows[name], self.largest[name]) for name in order}
        return DiffResult(
            self.kind.NAME,
            "rows",
            count_a=self.rows_a,
            count_b=self.rows_b,
            matched=self.matched,
            missing=self.missing,
            added=self.added,
            columns=columns,
            first=self.first,
        )


def _size(difference: float | None) -> float:
    return np.inf if difference is None or np.isnan(difference) else difference


def _key(table: ColumnTable, row: int) -> dict[str, object]:
    return {name: getattr(table, name)[row].item() for name in type(table).KEY}


def diff_schemas(name: str, a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[RowDifference, ...]:
    """Compare the declarations of two tables: name, version, length unit, and columns with types and units.

    Args:
        name: name of the table or file.
        a: `schema` (name), `version`, `length_unit` and `columns`, a list of mappings with `name`, `type` and `unit`;
            other entries are not compared.
        b: declaration of the second table, with the same entries.
    """
    out = [
        RowDifference("schema", name, {}, entry, a=a.get(entry), b=b.get(entry))
        for entry in ("schema", "version", "length_unit")
        if a.get(entry) != b.get(entry)
    ]
    columns_a = {c["name"]: c for c in a.get("columns", ())}
    columns_b = {c["name"]: c for c in b.get("columns", ())}
    out += [RowDifference("schema", name, {}, c, a="column") for c in columns_a if c not in columns_b]
    out += [RowDifference("schema", name, {}, c, b="column") for c in columns_b if c not in columns_a]
    lengths = (a["length_unit"], b["length_unit"])
    for column in (c for c in columns_a if c in columns_b):
        for entry in ("type", "unit"):
            left, right = columns_a[column].get(entry), columns_b[column].get(entry)
            # Another unit of length is one difference of the table, not one of each column.
            if left != right and not (entry == "unit" and _swapped(left, lengths) == right):
                out.append(RowDifference("schema", name, {"entry": entry}, column, a=left, b=right))
    return tuple(out)


def _swapped(unit: str | None, lengths: tuple[str, str]) -> str | None:
    """Return a unit with the first of the two length units replaced by the second: `m^2` becomes `cm^2`."""
    old, new = lengths
    return next((in_length_unit(each, new) for each in LENGTHS if in_length_unit(each, old) == unit), unit)
