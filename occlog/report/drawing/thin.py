"""Fewer points for drawing, with the extremes kept: a page must not grow with the recording."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints

GAP = 5.0
"""A line is broken where two samples are further apart than this many usual steps."""


def buckets_of(n: int, buckets: int) -> tuple[int, int]:
    """Rows per bucket and number of buckets for n rows."""
    width = max(1, -(-n // buckets))
    return width, -(-n // width)


def extremes(values: Floats, buckets: int) -> Ints:
    """Ascending indices of the lowest and highest value in each of `buckets` stretches, and both ends.

    Args:
        values: (N,) samples; NaN is never an extreme.
        buckets: number of stretches of equal count; at most 2 * buckets + 2 indices come back.

    Returns:
        (K,) indices; all of them when there are few.
    """
    n = len(values)
    if n <= 2 * buckets:
        return np.arange(n)
    width, rows = buckets_of(n, buckets)
    padded = np.full(rows * width, np.nan)
    padded[:n] = values
    grid = padded.reshape(rows, width)
    start = np.arange(rows) * width
    low = start + np.argmin(np.where(np.isnan(grid), np.inf, grid), axis=1)
    high = start + np.argmax(np.where(np.isnan(grid), -np.inf, grid), axis=1)
    return np.unique(np.concatenate([[0, n - 1], low, high]))


def thin_path(xy: Floats, buckets: int) -> Ints:
    """Ascending indices of points that keep a path's extent: extremes of x and of y in each stretch."""
    return np.union1d(extremes(xy[:, 0], buckets), extremes(xy[:, 1], buckets))


def envelope(t: Floats, low: Floats, high: Floats, buckets: int) -> tuple[Floats, Floats, Floats]:
    """Times, lowest `low` and highest `high` in each stretch: a band that covers the one given."""
    n = len(t)
    if n <= 2 * buckets:
        return t, low, high
    width, rows = buckets_of(n, buckets)
    starts = np.arange(rows) * width
    middle = t[np.minimum(starts + width // 2, n - 1)]
    middle[0], middle[-1] = t[0], t[-1]
    return middle, np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)


def gaps(t_ns: Ints) -> Bools:
    """(N,) true where the time since the row before is unusually long (the line is broken there)."""
    out = np.zeros(len(t_ns), dtype=bool)
    if len(t_ns) > 2:
        steps = np.diff(t_ns)
        out[1:] = steps > GAP * max(float(np.median(steps)), 1.0)
    return out


def broken(t_ns: Ints, keep: Ints, *series: Floats) -> tuple[Floats, ...]:
    """The kept samples of each series with a NaN before each gap, ready for a line plot.

    Args:
        t_ns: (N,) times of all samples.
        keep: (K,) ascending indices of the samples to draw.
        series: arrays (N,) on the same times.

    Returns:
        One array (K + gaps,) a series.
    """
    before = np.concatenate([[0], np.cumsum(gaps(t_ns))])[1:][keep]
    at = np.flatnonzero(np.diff(before) > 0) + 1
    return tuple(np.insert(np.asarray(s, dtype=np.float64)[keep], at, np.nan) for s in series)


def sensible_top(*series: Floats) -> float:
    """Upper limit of an axis that shows nearly everything, whatever a few outliers do.

    The highest value where it is not more than twice the 99th percentile, else 1.3
    times that percentile; at least a tiny positive number.
    """
    values = np.concatenate([s[np.isfinite(s)] for s in series]) if series else np.empty(0)
    if not len(values):
        return 1.0
    high, usual = float(values.max()), float(np.percentile(values, 99))
    top = high * 1.06 if high <= 2.0 * usual else usual * 1.3
    return max(top, 1e-9)
