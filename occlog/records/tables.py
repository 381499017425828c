"""The tables that pass between stages: frozen column records, NumPy only, no file formats.

Each column states its dtype, unit and meaning once.  `occlog.io.files.tables.arrow` and
`occlog.io.recording.reader` derive their schemas from the same declaration, and
`schemas/` publishes them.

Conventions (all tables)
    * `t_ns` is int64 nanoseconds since the Unix epoch; rows are ordered by it.
    * World frame: x, y on the ground, z up, in the scene's length unit (metres unless
      the scene states otherwise).  Angles are radians from +x towards +y in [-pi, pi).
    * Pixels carry `_px`; x to the right, y down, the centre of the first pixel is (0, 0).
    * NaN is allowed only in columns declared with `nan=...`, which gives the meaning.

Also the processing of tables in parts, so that memory is bounded.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError

from .columns import ColumnTable
from .declared.people import AppearanceMatches, Associations, Events, Gallery, JoinedTracks, PeopleTracks, PeopleViews
from .declared.sensors import (
    APPEARANCE_BINS,
    UNLABELLED,
    Bearings,
    Boxes,
    Doa,
    Measurements,
    Positions,
    Reads,
    TruthBoxes,
    Views,
)
from .declared.tracks import (
    Bound,
    Calibration,
    Cooperation,
    Diagnostics,
    Errors,
    FusedTracks,
    Particles,
    Residuals,
    TagTracks,
    Tracks,
    VirtualSensors,
)
from .declared.views import Counts, Failures, ViewTracks
from .declared.world import Delays, Hulls, Occluders, PlanMap, RobotPath, Truth

TABLES: dict[str, type[ColumnTable]] = {
    table.NAME: table
    for table in (
        Bearings,
        Views,
        Boxes,
        TruthBoxes,
        Doa,
        Positions,
        Reads,
        Measurements,
        Occluders,
        Hulls,
        Truth,
        Tracks,
        Diagnostics,
        Residuals,
        Particles,
        Calibration,
        Errors,
        Bound,
        Cooperation,
        VirtualSensors,
        Delays,
        ViewTracks,
        Failures,
        Counts,
        Associations,
        Events,
        Gallery,
        AppearanceMatches,
        RobotPath,
        PlanMap,
    )
}
"""Every table by the name that its files carry."""
WIDER: tuple[type[ColumnTable], ...] = (FusedTracks, TagTracks, PeopleTracks, JoinedTracks, PeopleViews)
"""Tables that have the name of another one, and more columns."""


def has_all_columns(table: type[ColumnTable]) -> bool:
    """Whether a class is the published table of its `NAME` or a subclass, and so declares all of its columns.

    False for a class that reads a part of the columns only: rows of it may be equal without being duplicates.
    """
    return table.NAME in TABLES and issubclass(table, TABLES[table.NAME])


def table_with(name: str, columns: Collection[str]) -> type[ColumnTable]:
    """Class for a file with these columns: the named table, or a variant with more columns (`WIDER`).

    It is the one that lacks the fewest columns of the file and, among equals, has the fewest that the file lacks.

    Args:
        name: a key of `TABLES`.
        columns: names of the columns in the file.
    """
    names = set(columns)

    def misfit(table: type[ColumnTable]) -> tuple[int, int]:
        own = {c.name for c in table.columns()}
        return len(names - own), len(own - names)

    return min((TABLES[name], *(each for each in WIDER if issubclass(each, TABLES[name]))), key=misfit)


__all__ = [
    "APPEARANCE_BINS",
    "TABLES",
    "UNLABELLED",
    "WIDER",
    "AppearanceMatches",
    "Associations",
    "Bearings",
    "Bound",
    "Boxes",
    "Calibration",
    "Cooperation",
    "Counts",
    "Delays",
    "Diagnostics",
    "Doa",
    "Errors",
    "Events",
    "Failures",
    "FusedTracks",
    "Gallery",
    "Hulls",
    "JoinedTracks",
    "Measurements",
    "Occluders",
    "Particles",
    "PeopleTracks",
    "PeopleViews",
    "Positions",
    "Reads",
    "Residuals",
    "RobotPath",
    "TagTracks",
    "Tracks",
    "Truth",
    "TruthBoxes",
    "ViewTracks",
    "Views",
    "VirtualSensors",
    "has_all_columns",
    "table_with",
]


T = TypeVar("T", bound=ColumnTable)
A = TypeVar("A", bound=ColumnTable)
B = TypeVar("B", bound=ColumnTable)
FIRST, LAST = int(np.iinfo(np.int64).min), int(np.iinfo(np.int64).max)
"""Limits of times."""


def times(table: ColumnTable) -> Ints:
    """(n,) times [ns] of the rows of a table, its column t_ns."""
    out: Ints = getattr(table, "t_ns")  # noqa: B009
    return out


def whole_times(chunks: Iterable[T]) -> Iterator[T]:
    """Rechunk rows so that all rows of one time are in the same chunk; empty chunks are dropped.

    Args:
        chunks: in the order of time; a time may be split over several of them.

    Raises:
        InputError: a chunk begins before the end of the previous one.
    """
    held: T | None = None
    for chunk in chunks:
        if not len(chunk):
            continue
        if held is not None and times(chunk)[0] < times(held)[-1]:
            raise InputError(
                f"{chunk.NAME}: t_ns goes back from {times(held)[-1]} to {times(chunk)[0]}; sort the table by t_ns",
                id="unsorted-times",
            )
        rows = chunk if held is None else type(chunk).concat([held, chunk])
        cut = int(np.searchsorted(times(rows), times(rows)[-1]))
        if cut:
            yield rows.take(slice(0, cut))
        held = rows.take(slice(cut, None))
    if held is not None:
        yield held


class TableWindow(NamedTuple, Generic[A, B]):
    """Rows of two tables in one time segment [begin, end), without and with a margin around it.

    Attributes:
        a: rows of the first table in the segment.
        b: rows of the second table in the segment.
        about_a: rows of the first table in the segment and at most the margin away from it.
        about_b: rows of the second table in the segment and at most the margin away from it.
    """

    a: A
    b: B
    about_a: A
    about_b: B


class TableBuffer(Generic[T]):
    """Buffer of rows of one table that is read chunk by chunk, for reading several tables in parallel.

    Attributes:
        rows: rows that were read and are not yet dropped by the reader.
        until: all rows before this time [ns] are in the buffer; `LAST`: the table is complete.
    """

    def __init__(self, chunks: Iterable[T], kind: type[T], name: str = "") -> None:
        """Prepare to read; nothing is read yet.

        Args:
            chunks: of one table, in the order of time.
            kind: type of the table.
            name: of the table in messages; empty: `kind.NAME`.
        """
        self._chunks = iter(chunks)
        self._kind = kind
        self._name = name or kind.NAME
        self._next: T | None = None
        self._begun = False
        self.rows = kind.empty()
        self.until = FIRST

    def pull(self) -> None:
        """Append the next chunk that has rows to `rows`, and set `until` to its last time.

        With the last chunk `until` becomes `LAST`.

        Raises:
            InputError: the chunk begins before the end of the previous one.
        """
        if not self._begun:
            self._next, self._begun = self._read(), True
        chunk = self._next
        self._next = None if chunk is None else self._read()
        if chunk is not None:
            first, last = int(times(chunk)[0]), int(times(chunk)[-1])
            if first < self.until:
                raise InputError(
                    f"{self._name}: t_ns goes back from {self.until} to {first}; sort the table by t_ns",
                    id="unsorted-times",
                )
            self.rows = self._kind.concat([self.rows, chunk])
            self.until = last
        if self._next is None:
            self.until = LAST

    def _read(self) -> T | None:
        return next((chunk for chunk in self._chunks if len(chunk)), None)

    def between(self, low: int, high: int) -> T:
        """Buffered rows with times in [low, high) [ns]; all from `low` on if `high` is `LAST`."""
        at = times(self.rows)
        stop = len(at) if high >= LAST else int(np.searchsorted(at, high))
        return self.rows.take(slice(int(np.searchsorted(at, max(low, FIRST))), stop))


class Limits(NamedTuple):
    """A time segment [begin, end).

    Attributes:
        begin: first time of the segment [ns].
        end: first time after it [ns]; `LAST`: the segment has no end.
    """

    begin: int
    end: int

    def of(self, side: TableBuffer[T]) -> T:
        """Buffered rows of a table in the segment."""
        return side.between(self.begin, self.end)

    def about(self, side: TableBuffer[T], before_ns: int, after_ns: int | None = None) -> T:
        """Buffered rows of a table in the segment and in margins [ns] before and after it.

        `after_ns` None: as `before_ns`.
        """
        after = before_ns if after_ns is None else after_ns
        return side.between(self.begin - before_ns, LAST if self.end == LAST else self.end + after)


def in_step(sides: Sequence[TableBuffer[Any]], margins_ns: Sequence[int]) -> Iterator[Limits]:
    """Read several tables in parallel and yield time segments that together cover all times once, in order.

    While a segment is processed, each buffer holds the rows of its table in the segment and in the margins around it;
    older rows are dropped afterwards.

    Args:
        sides: buffers of the tables, not yet read.
        margins_ns: margin of each table before and after a segment [ns], >= 0.

    Raises:
        InputError: the chunks of a table are not in the order of time.
    """
    begin = FIRST
    while begin < LAST:
        # The side that lags behind is read first
        arrived = [LAST if s.until == LAST else s.until - m for s, m in zip(sides, margins_ns, strict=True)]
        behind = min(range(len(sides)), key=arrived.__getitem__)
        sides[behind].pull()
        arrived[behind] = LAST if sides[behind].until == LAST else sides[behind].until - margins_ns[behind]
        end = min(arrived)
        if end <= begin:
            continue
        yield Limits(begin, end)
        begin = end
        if end != LAST:
            for side, margin_ns in zip(sides, margins_ns, strict=True):
                side.rows = side.between(end - margin_ns, LAST)


def windows(
    a: Iterable[A], b: Iterable[B], kinds: tuple[type[A], type[B]], margin_ns: int
) -> Iterator[TableWindow[A, B]]:
    """Read two tables in parallel and yield the rows of both for successive time segments, with margins.

    Segments in which neither table has rows are omitted.

    Args:
        a: chunks of the first table in the order of time; a time may be split over two chunks.
        b: chunks of the second table, in the order of time.
        kinds: types of the two tables.
        margin_ns: margin before and after a segment in which rows are also given [ns], >= 0.

    Raises:
        InputError: the chunks of a table are not in the order of time.
    """
    left, right = TableBuffer(a, kinds[0]), TableBuffer(b, kinds[1])
    for part in in_step((left, right), (margin_ns, margin_ns)):
        found = TableWindow(part.of(left), part.of(right), part.about(left, margin_ns), part.about(right, margin_ns))
        if len(found.a) or len(found.b):
            yield found
