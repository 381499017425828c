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
    """Whether a class declares all columns of its table (rows of a partial class may be equal)."""
    return table.NAME in TABLES and issubclass(table, TABLES[table.NAME])


def table_with(name: str, columns: Collection[str]) -> type[ColumnTable]:
    """Variant of the named table that has most of a file's columns (of several, the one with fewest others).

    Args:
        name: one of `TABLES`.
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
    """Rechunk rows so that no time is split.

    Args:
        chunks: in the order of time; a time may be split over several of them.

    Raises:
        InputError: a chunk begins before the one ahead of it ends.
    """
    held: T | None = None
    for chunk in chunks:
        if not len(chunk):
            continue
        if held is not None and times(chunk)[0] < times(held)[-1]:
            raise InputError(
                f"{chunk.NAME}: t_ns goes back between two chunks; sort the table by t_ns", id="unsorted-times"
            )
        rows = chunk if held is None else type(chunk).concat([held, chunk])
        cut = int(np.searchsorted(times(rows), times(rows)[-1]))
        if cut:
            yield rows.take(slice(0, cut))
        held = rows.take(slice(cut, None))
    if held is not None:
        yield held


class TableWindow(NamedTuple, Generic[A, B]):
    """Rows of two tables in a time segment, with margins.

    Attributes:
        a: rows of the first table from the beginning of the segment to its end, which is omitted.
        b: rows of the second table, likewise.
        about_a: these rows of the first table and those that are at most the margin away from the segment.
        about_b: of the second table, likewise.
    """

    a: A
    b: B
    about_a: A
    about_b: B


class TableBuffer(Generic[T]):
    """Buffered chunks of one table.

    Attributes:
        rows: those that were read and are still needed.
        until: rows before this time have all arrived; `LAST`: all have.
    """

    def __init__(self, chunks: Iterable[T], kind: type[T], name: str = "") -> None:
        """Start before the first chunk.

        Args:
            chunks: of one table, in the order of time.
            kind: type of the table.
            name: of the table in messages.
        """
        self._chunks = iter(chunks)
        self._kind = kind
        self._name = name or kind.NAME
        self._next: T | None = None
        self._begun = False
        self.rows = kind.empty()
        self.until = FIRST

    def pull(self) -> None:
        """Read the next chunk with rows; with the last one all rows have arrived."""
        if not self._begun:
            self._next, self._begun = self._read(), True
        chunk = self._next
        self._next = None if chunk is None else self._read()
        if chunk is not None:
            first, last = int(times(chunk)[0]), int(times(chunk)[-1])
            if first < self.until:
                raise InputError(
                    f"{self._name}: t_ns goes back between two chunks ({first}); sort the table by t_ns",
                    id="unsorted-times",
                )
            self.rows = self._kind.concat([self.rows, chunk])
            self.until = last
        if self._next is None:
            self.until = LAST

    def _read(self) -> T | None:
        return next((chunk for chunk in self._chunks if len(chunk)), None)

    def between(self, low: int, high: int) -> T:
        """Rows in [low, high); all from `low` on if `high` is `LAST`."""
        at = times(self.rows)
        stop = len(at) if high >= LAST else int(np.searchsorted(at, high))
        return self.rows.take(slice(int(np.searchsorted(at, max(low, FIRST))), stop))


class Limits(NamedTuple):
    """A time segment.

    Attributes:
        begin: its first time step.
        end: that after its last one, which is omitted; `LAST`: missing.
    """

    begin: int
    end: int

    def of(self, side: TableBuffer[T]) -> T:
        """Rows of a table in the segment."""
        return side.between(self.begin, self.end)

    def about(self, side: TableBuffer[T], before_ns: int, after_ns: int | None = None) -> T:
        """Rows of the segment and of margins around it; `after_ns` None: as `before_ns`."""
        after = before_ns if after_ns is None else after_ns
        return side.between(self.begin - before_ns, LAST if self.end == LAST else self.end + after)


def in_step(sides: Sequence[TableBuffer[Any]], margins_ns: Sequence[int]) -> Iterator[Limits]:
    """Generate time segments of tables in parallel, which together cover every row once.

    Within a segment the buffers also hold the rows of the margins.

    Args:
        sides: tables of which nothing is read yet.
        margins_ns: of each how far about a segment rows are there, >= 0.

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
    """Generate the rows of two tables by segments (`in_step`), with margins.

    Args:
        a: chunks of the first table in the order of time; a time may be split over two chunks.
        b: chunks of the second table, likewise.
        kinds: of the tables.
        margin_ns: how far about a segment rows are given along with it, >= 0.

    Raises:
        InputError: the chunks of a table are not in the order of time.
    """
    left, right = TableBuffer(a, kinds[0]), TableBuffer(b, kinds[1])
    for part in in_step((left, right), (margin_ns, margin_ns)):
        found = TableWindow(part.of(left), part.of(right), part.about(left, margin_ns), part.about(right, margin_ns))
        if len(found.a) or len(found.b):
            yield found
