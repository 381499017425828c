"""Whether two columns of joined rows are the same, value by value."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..columns import Bools, Column, Floats
from .diff_result import Limit, Tolerances

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
