"""Downsampling of tables for drawing; figures are computed from all rows.

Of a table with more than `MAX_ROWS` rows, every k-th time is kept, with the smallest k that leaves at most this many
rows; also the first and last row of each target, the largest error of each target between kept times, and the rows
needed by the replay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.metrics.errors import Sum
from occlog.evaluate.errors.sums import median_of
from occlog.io.files.spill import Spool
from occlog.records.columns import ColumnTable
from occlog.records.tables import Errors, times, whole_times

T = TypeVar("T", bound=ColumnTable)
MAX_ROWS = 200_000
"""Rows of a table that are drawn whole."""
MAX_TIME_STEPS = 10_000
"""Time steps of a replay."""
MAX_SHOWN = 45_000
"""Estimates of all time steps of a replay, at most, and as many true positions."""
MAX_MOVING = 40
"""Moving objects that are no targets and are drawn."""


@dataclass(frozen=True)
class TableTotals:
    """Number and times of all rows of a table, of which a part may be drawn.

    Attributes:
        rows: number of rows.
        times: number of distinct times.
        every: every k-th of these times is drawn.
        at: (T,) the times [ns] of which all rows are drawn.
        step_ns: median interval of all times [ns]; a second with fewer than two.
        span_ns: first and last of all times [ns].
    """

    rows: int
    times: int
    every: int
    at: Ints = field(default_factory=lambda: np.zeros(0, np.int64), compare=False, repr=False)
    step_ns: float = field(default=float(NS), compare=False)
    span_ns: tuple[int, int] = field(default=(0, 0), compare=False)


@dataclass(frozen=True, eq=False)
class DownsampledTable(Generic[T]):
    """The rows of a table that are kept for drawing.

    Attributes:
        table: these rows.
        rows: (n,) their row numbers in the whole table.
        whole: number and times of all rows.
    """

    table: T
    rows: Ints
    whole: TableTotals


def downsample(
    chunks: Iterable[T], kind: type[T], rows: int, most: int = MAX_ROWS, *, also: Ints | None = None, ends: bool = True
) -> DownsampledTable[T]:
    """Select the rows of a table that are drawn: all rows of every k-th time, and some others.

    The others are those at the times `also`, with `ends` the first and last row of each target, and, in tables of
    errors, the row with the largest error of each target between kept times.

    Args:
        chunks: the table in the order of time.
        kind: its type.
        rows: number of its rows.
        most: approximate number of rows to keep.
        also: (K,) times [ns] with rows that are kept, too.
        ends: whether the first and the last row of each target are kept.
    """
    every = max(-(-rows // most), 1)
    parts, numbers, known = [kind.empty()], [np.zeros(0, np.int64)], np.zeros(0, np.int64)
    last, last_at = kind.empty(), np.zeros(0, np.int64)
    drawn, steps, span = [np.zeros(0, np.int64)], Spool(), (0, 0)
    count = n_steps = 0
    for piece in whole_times(chunks):
        t_ns, at = times(piece), count + np.arange(len(piece))
        first = np.append(True, np.diff(t_ns) != 0)
        step = n_steps - 1 + np.cumsum(first)
        keep = step % every == 0
        drawn.append(t_ns[first & keep])
        steps.add(np.diff(t_ns[first] if not count else np.append(span[1], t_ns[first])).astype(np.float64))
        if also is not None:
            keep |= np.isin(t_ns, also)
        if ends:
            target = _targets(piece)
            keep[_firsts(target, known)] = True
            if isinstance(piece, Errors):
                keep |= largest(piece.error, target, step // every)
            both, both_at = kind.concat([last, piece]), np.concatenate([last_at, at])
            final = np.sort(len(both) - 1 - np.unique(_targets(both)[::-1], return_index=True)[1])
            last, last_at = both.take(final), both_at[final]
            known = np.union1d(known, target)
        parts.append(piece.take(keep))
        numbers.append(at[keep])
        span = int(t_ns[0]) if not count else span[0], int(t_ns[-1])
        count, n_steps = count + len(piece), int(step[-1]) + 1
    whole = TableTotals(
        count, n_steps, every, np.concatenate(drawn), median_of(steps) if steps.count else float(NS), span
    )
    table, found = _in_place(kind, [*parts, last], [*numbers, last_at])
    return DownsampledTable(table, found, whole)


def downsample_with(found: DownsampledTable[T], chunks: Iterable[T], pick: Callable[[T], Ints]) -> DownsampledTable[T]:
    """Return the downsampled table with further rows inserted in their places.

    Args:
        found: table so far.
        chunks: all rows of the whole table, read once more.
        pick: returns the row numbers, within a chunk, of the rows to add.
    """
    parts, numbers, count = [found.table], [found.rows], 0
    for chunk in chunks:
        rows = pick(chunk)
        parts.append(chunk.take(rows))
        numbers.append(count + rows)
        count += len(chunk)
    table, kept = _in_place(type(found.table), parts, numbers)
    return DownsampledTable(table, kept, found.whole)


def kept_steps(times: int, rows: Iterable[int]) -> int:
    """Return the smallest k such that every k-th time step keeps a replay within its limits.

    The limits are `MAX_TIME_STEPS` times, and `MAX_SHOWN` rows of each table. `times`: number of times; `rows`: number
    of rows of each table.
    """
    return max(1, -(-times // MAX_TIME_STEPS), *(-(-n // MAX_SHOWN) for n in rows))


def rows_before(kept: Ints, period_ns: float, t_ns: Ints) -> tuple[Ints, Ints]:
    """Return the rows that a replay shows, and the index of the time step of each.

    A row belongs to the kept time step at its time, or else to the next one less than `period_ns` later; other rows are
    not shown.

    Args:
        kept: (M,) increasing times of the replay [ns].
        period_ns: median interval of all times [ns].
        t_ns: (N,) times of rows [ns].

    Returns:
        (n,) indices of rows, and (n,) indices of their times in `kept`.
    """
    if not len(kept):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    step = np.searchsorted(kept, t_ns)
    inside = np.minimum(step, len(kept) - 1)
    rows = np.flatnonzero((step < len(kept)) & (kept[inside] - t_ns < period_ns))
    return rows, step[rows]


def every_nth(counts: Ints, most: int) -> int:
    """Return the smallest k such that every k-th of the `counts` (n,), from the first on, sums to at most `most`.

    It is at least the sum of all divided by `most`; n or more if no smaller k is sufficient.
    """
    every = max(-(-int(counts.sum()) // max(most, 1)), 1)
    while every < len(counts) and int(counts[::every].sum()) > most:
        every += 1
    return every


def _in_place(kind: type[T], parts: list[T], numbers: list[Ints]) -> tuple[T, Ints]:
    """Join parts of a table that overlap to one without duplicate rows, sorted; also return the row numbers.

    Args:
        kind: type of the table.
        parts: the parts; this list is emptied.
        numbers: row numbers of each part in the whole table.
    """
    found, index = np.unique(np.concatenate(numbers), return_index=True)
    columns = {c.name: [getattr(part, c.name) for part in parts] for c in kind.columns()}
    # Column by column, so that no more than one is in memory twice
    parts.clear()
    return kind(**{name: np.concatenate(columns.pop(name))[index] for name in list(columns)}), found


def _targets(table: ColumnTable) -> Ints:
    found: Ints = getattr(table, "target_id")  # noqa: B009
    return found.astype(np.int64)


def _firsts(target: Ints, known: Ints) -> Ints:
    """Return the index of the first row of each target in `target` (n,) that is not among the targets `known` (k,)."""
    names, first = np.unique(target, return_index=True)
    new: Ints = first[~np.isin(names, known)]
    return new


def largest(values: Floats, target: Ints, segment: Ints) -> Bools:
    """Return the mask (N,) of the rows with the largest value of their target in their section of the table.

    Args:
        values: (N,) values.
        target: (N,) identities.
        segment: (N,) number of the section of each row.
    """
    if not len(values):
        return np.zeros(0, dtype=np.bool_)
    order = np.lexsort((values, target, segment))
    change = (np.diff(target[order]) != 0) | (np.diff(segment[order]) != 0)
    out = np.zeros(len(values), dtype=np.bool_)
    out[order[np.append(change, True)]] = True
    return out


@dataclass
class _ErrorsOfTarget:
    """Running sums of the errors of one target.

    Attributes:
        squares: sum of squared errors on the ground.
        rows: number of these errors.
        worst: largest error on the ground.
        squares_in_space: sum of squared errors in space.
        in_space: number of known errors in space.
    """

    squares: Sum = field(default_factory=Sum)
    rows: int = 0
    worst: float = 0.0
    squares_in_space: Sum = field(default_factory=Sum)
    in_space: int = 0


class ErrorsSoFar:
    """Running RMSE and largest error of each target, over a stream of errors."""

    def __init__(self) -> None:
        """Create sums without errors."""
        self._targets: dict[int, _ErrorsOfTarget] = {}

    def add(self, errors: Errors) -> Floats:
        """Add N errors in the order of time; return, for each, the RMSE of its target over all errors so far (N,)."""
        out = np.zeros(len(errors))
        for k in np.unique(errors.target_id).tolist():
            own = self._targets.setdefault(k, _ErrorsOfTarget())
            rows = errors.target_id == k
            squares = errors.error[rows] ** 2
            count = own.rows + np.arange(1, len(squares) + 1)
            out[rows] = np.sqrt((own.squares.value + np.cumsum(squares)) / count)
            own.squares.add(float(squares.sum()))
            own.rows, own.worst = own.rows + len(squares), max(own.worst, float(errors.error[rows].max()))
            high = errors.error_space[rows]
            high = high[np.isfinite(high)]
            own.squares_in_space.add(float((high**2).sum()))
            own.in_space += len(high)
        return out

    def rmse(self, target: int | None = None) -> float:
        """Return the RMSE of a target on the ground (None: of all); NaN without errors."""
        own = self._of(target)
        return _root(sum(t.squares.value for t in own), sum(t.rows for t in own))

    def rmse_in_space(self) -> float:
        """Return the RMSE in space over all targets; NaN without errors in space."""
        own = self._of(None)
        return _root(sum(t.squares_in_space.value for t in own), sum(t.in_space for t in own))

    def worst(self, target: int) -> float:
        """Largest error of a target on the ground."""
        return self._targets[target].worst

    def _of(self, target: int | None) -> list[_ErrorsOfTarget]:
        return [own for k, own in self._targets.items() if target is None or k == target]


def _root(squares: float, count: int) -> float:
    return float(np.sqrt(squares / count)) if count else float("nan")
