"""Priors of moving occluders for a filter: the latest ones at the time of a scan.

Also people of tracks or of a truth as moving obstacles.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import NS, Floats
from occlog.core.navigation.obstacles import MovingObstacleTracks, StepClock
from occlog.core.occlusion.priors import Priors, gaussian_priors, no_priors, polygon_priors
from occlog.errors import InputError
from occlog.io.files.timing.utc import time_words
from occlog.io.open import Opened, check_unit
from occlog.records.tables import Hulls, Occluders, Tracks, Truth


class OccluderFeed:
    """Stream of priors of moving occluders, queried at nondecreasing times."""

    def __init__(self, chunks: Iterable[Occluders] | Iterable[Hulls], diameter: float, max_age_ns: int) -> None:
        """Start before the first chunk.

        Args:
            chunks: priors in the order of time; their division does not matter.
            diameter: diameter of every occluder [length], > 0.
            max_age_ns: priors older than this [ns] are not used.
        """
        self._ahead = _by_time(chunks)
        self._next = next(self._ahead, None)
        self._latest: tuple[int, Priors] | None = None
        self._diameter, self._max_age_ns = diameter, max_age_ns
        self.asked = 0
        """How often priors were asked for."""
        self.early = 0
        """How often nothing was known yet: the time was before the first row."""
        self.stale = 0
        """How often the latest priors were too old to be used."""

    def at(self, t_ns: int) -> Priors | None:
        """Return the latest priors at or before `t_ns` [ns]; None if there are none, or if they are too old.

        InputError if times of priors decrease, or a polygon is not valid.
        """
        passed = None
        while self._next is not None and self._next[0] <= t_ns:
            passed, self._next = self._next, next(self._ahead, None)
        if passed is not None:
            self._latest = passed[0], _priors(passed[1], self._diameter)
        self.asked += 1
        if self._latest is None:
            self.early += 1
            return None
        if t_ns - self._latest[0] > self._max_age_ns:
            self.stale += 1
            return None
        return self._latest[1]


def _by_time(chunks: Iterable[Occluders] | Iterable[Hulls]) -> Iterator[tuple[int, Occluders | Hulls]]:
    """Generate (time [ns], rows) of each time, in order; InputError if times go back."""
    rest: Occluders | Hulls | None = None
    for chunk in chunks:
        if not len(chunk):
            continue
        if rest is not None and chunk.t_ns[0] < rest.t_ns[-1]:
            raise InputError(
                f"{chunk.NAME}: time {time_words(chunk.t_ns[0])} is earlier than the preceding "
                f"{time_words(rest.t_ns[-1])}; sort "
                "the rows by t_ns",
                id="unsorted-times",
            )
        table = chunk if rest is None else type(chunk).concat([rest, chunk])  # type: ignore[list-item]
        starts = [0, *(np.flatnonzero(np.diff(table.t_ns)) + 1).tolist()]
        for first, last in pairwise(starts):
            yield int(table.t_ns[first]), table.take(slice(first, last))
        # The last time may go on in the next chunk.
        rest = table.take(slice(starts[-1], None))
    if rest is not None:
        yield int(rest.t_ns[0]), rest


def _priors(table: Occluders | Hulls, diameter: float) -> Priors:
    """Return the priors of moving occluders in the rows of one time; none for a row without occluder (id below 0).

    `diameter` is that of each occluder; InputError for a polygon that is not valid.
    """
    absent = table.occluder_id < 0
    there = table.take(~absent) if absent.any() else table
    if not len(there):
        return no_priors()
    if isinstance(there, Occluders):
        mean = np.column_stack([there.x, there.y])
        xy = there.cov_xy
        covariance = np.stack([there.cov_xx, xy, xy, there.cov_yy], axis=1).reshape(-1, 2, 2)
        return gaussian_priors(mean, covariance, diameter)
    starts = np.flatnonzero(there.corner == 0)
    try:
        return polygon_priors(np.split(np.column_stack([there.x, there.y]), starts[1:]), diameter)
    except ValueError as error:
        raise InputError(f"hulls: time {time_words(there.t_ns[0])}: {error}; omit this polygon") from error


def known_positions(truth: Iterable[Truth]) -> Iterator[Occluders]:
    """Generate priors of moving occluders at their true positions, with covariance 0: the case RMSE_occ = 0 of [Ercan].

    A time without moving occluders has a row without occluder (id -1).
    """
    for chunk in _whole_times(truth):
        there = chunk.take(chunk.role == "occluder")
        n = len(there)
        zero = np.zeros(n)
        rows = Occluders(
            t_ns=there.t_ns, occluder_id=there.target_id, x=there.x, y=there.y, cov_xx=zero, cov_xy=zero, cov_yy=zero
        )
        yield Occluders.merge([rows, none_at(np.setdiff1d(chunk.t_ns, there.t_ns))])


def _whole_times(chunks: Iterable[Truth]) -> Iterator[Truth]:
    """Generate the rows in chunks that do not divide a time."""
    rest = Truth.empty()
    for chunk in chunks:
        table = Truth.concat([rest, chunk])
        cut = int(np.searchsorted(table.t_ns, table.t_ns[-1])) if len(table) else 0
        if cut:
            yield table.take(slice(0, cut))
        rest = table.take(slice(cut, None))
    if len(rest):
        yield rest


def none_at(t_ns: np.ndarray[tuple[int], np.dtype[np.int64]]) -> Occluders:
    """Return rows that state that there is no moving occluder at these times (N,) [ns]."""
    n = len(t_ns)
    nothing = np.full(n, np.nan)
    return Occluders(
        t_ns=t_ns,
        occluder_id=np.full(n, -1, dtype=np.int32),
        x=nothing,
        y=nothing,
        cov_xx=nothing,
        cov_xy=nothing,
        cov_yy=nothing,
    )


T = TypeVar("T", Tracks, Truth)


class PeopleAsObstacles(NamedTuple):
    """Settings by which people of a file become moving obstacles: size, gaps that are bridged, and time steps."""

    radius: float  # of each
    sigmas: float  # standard deviations, along the widest axis of a track's covariance, by which they are larger
    max_gap_s: float  # longest time between two rows of a track that is bridged
    step_s: float  # time between two steps of those who avoid them
    steps: int  # most steps


def moving_people(opened: Opened, length_unit: str, start_s: float, people: PeopleAsObstacles) -> MovingObstacleTracks:
    """Return the people of a file as moving obstacles, from a start to the last possible step.

    Args:
        opened: file with tracks or a truth.
        length_unit: length unit of the scene; the file's must be equal.
        start_s: time of step 0 after the first row of the file [s].
        people: size of people, gaps and time steps.

    Raises:
        InputError: lengths in another unit, or no rows in that time.
    """
    if opened.recording is not None or opened.made_in_a_scene:
        check_unit(opened, length_unit, error=InputError)
    after_ns = round(start_s * NS)
    start_ns, rows = (
        _between(opened, Tracks, after_ns, people) if opened.has(Tracks) else _between(opened, Truth, after_ns, people)
    )
    if not len(rows):
        raise InputError(
            f"{opened.path}: has no rows from {start_s:g} s after its first one on, so no moving obstacle; give an "
            "earlier start",
            id="empty-input",
        )
    return obstacles_of(rows, start_ns, people)


def obstacles_of(rows: Tracks | Truth, start_ns: int, people: PeopleAsObstacles) -> MovingObstacleTracks:
    """Return the people of a table as moving obstacles, in steps from `start_ns` [ns] on.

    Their radius is increased by standard deviations of the track; people of a truth have no covariance.
    """
    positions = np.column_stack([rows.x, rows.y, people.radius + people.sigmas * _deviation(rows)])
    clock, limit_ns = StepClock(start_ns, people.step_s), round(people.max_gap_s * NS)
    return MovingObstacleTracks(rows.t_ns, rows.target_id, positions, clock, limit_ns)


def _between(opened: Opened, table: type[T], after_ns: int, people: PeopleAsObstacles) -> tuple[int, T]:
    """Read the rows of a table that all steps need, with the longest gap (`people.max_gap_s`) before and after.

    Args:
        opened: the file.
        table: kind of table, tracks or truth.
        after_ns: time from the first row to the first step [ns].
        people: gap, number of steps and time between them.

    Returns:
        Time of the first step [ns], 0 if the table is empty; and the rows.
    """
    gap_ns, most_ns = round(people.max_gap_s * NS), round((people.steps + 1) * people.step_s * NS)
    parts: list[T] = []
    start_ns: int | None = None
    for chunk in opened.rows(table):
        if not len(chunk):
            continue
        start_ns = int(chunk.t_ns[0]) + after_ns if start_ns is None else start_ns
        parts.append(chunk.take((chunk.t_ns >= start_ns - gap_ns) & (chunk.t_ns <= start_ns + most_ns + gap_ns)))
        if chunk.t_ns[-1] > start_ns + most_ns + gap_ns:
            break
    return start_ns or 0, table.concat(parts)


def _deviation(rows: Tracks | Truth) -> Floats:
    """Return (R,) standard deviations along the widest axis of each row's position covariance; 0 for a truth."""
    if isinstance(rows, Truth):
        return np.zeros(len(rows))
    rows = rows.with_covariance()
    middle, half = 0.5 * (rows.cov_xx + rows.cov_yy), 0.5 * (rows.cov_xx - rows.cov_yy)
    return np.asarray(np.sqrt(np.maximum(middle + np.hypot(half, rows.cov_xy), 0.0)))
