"""People of tracks, or of a truth, as obstacles that move."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import NS, Floats
from occlog.core.navigation.moving import Clock, Moving
from occlog.errors import InputError
from occlog.io.open import Opened, check_unit
from occlog.records.tables import Tracks, Truth

T = TypeVar("T", Tracks, Truth)


class People(NamedTuple):
    """How people are taken as obstacles."""

    radius: float  # of each
    sigmas: float  # standard deviations, along the widest axis of a track's covariance, by which they are larger
    max_gap_s: float  # longest time between two rows of a track that is bridged
    step_s: float  # time between two steps of those who avoid them
    steps: int  # most steps


def moving_people(opened: Opened, length_unit: str, start_s: float, people: People) -> Moving:
    """People of a file from a start to the last possible step.

    Args:
        opened: holds tracks or a truth.
        length_unit: of the scene; the file's must be the same.
        start_s: step 0, after the first row of the file.
        people: how they are taken.

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
        raise InputError(f"{opened.path}: has no rows from {start_s:g} s after its first one on; nobody to avoid")
    return obstacles_of(rows, start_ns, people)


def obstacles_of(rows: Tracks | Truth, start_ns: int, people: People) -> Moving:
    """The people of a table as obstacles; those of a truth have no covariance."""
    places = np.column_stack([rows.x, rows.y, people.radius + people.sigmas * _deviation(rows)])
    clock, limit_ns = Clock(start_ns, people.step_s), round(people.max_gap_s * NS)
    return Moving(rows.t_ns, rows.target_id, places, clock, limit_ns)


def _between(opened: Opened, table: type[T], after_ns: int, people: People) -> tuple[int, T]:
    """Time `after_ns` after the first row, and the rows of all steps from then on, with a gap before and after."""
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
    """(R,) standard deviation along the widest axis of each row's covariance."""
    if isinstance(rows, Truth):
        return np.zeros(len(rows))
    rows = rows.with_covariance()
    middle, half = 0.5 * (rows.cov_xx + rows.cov_yy), 0.5 * (rows.cov_xx - rows.cov_yy)
    return np.asarray(np.sqrt(np.maximum(middle + np.hypot(half, rows.cov_xy), 0.0)))
