"""Many ways through points at once: dashes of them, and points close together along them.

An image has hundreds of short ways, which one after another would take most of the time of an export.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from occlog.array_types import Floats, Ints

FEWEST_DASHES, MOST_DASHES = 6, 200


def dashes(ways: Sequence[Floats], length: float) -> list[Floats]:
    """(2 n, d) ends of the dashes of each way, of about `length`, with gaps as long between them.

    Args:
        ways: points (k, d), k > 1.
        length: > 0.
    """
    if not ways:
        return []
    totals = _totals(ways)
    counts = np.clip(np.rint(totals / (2.0 * length)), FEWEST_DASHES, MOST_DASHES).astype(np.int64)
    ends, owner = 2 * counts, np.repeat(np.arange(len(ways)), 2 * counts)
    number = _from_zero(ends)
    wanted = (number // 2 + 0.5 * (number % 2)) / counts[owner] * totals[owner]
    return np.split(_at(ways, wanted, ends), np.cumsum(ends)[:-1])


def dense(ways: Sequence[Floats], step: float, most: int) -> tuple[Floats, Ints]:
    """Points along ways, evenly from the first to the last of each, and how many each has.

    Args:
        ways: points (k, d), k > 1, of one d; at least one way.
        step: from one point to the next, at most, > 0.
        most: points of one way; those of a longer one are farther apart.

    Returns:
        (N, d), way after way, and (len(ways),) from 2 to `most`.
    """
    totals = _totals(ways)
    counts = np.clip(np.ceil(totals / step) + 1, 2, most).astype(np.int64)
    wanted = _from_zero(counts) * np.repeat(totals / (counts - 1), counts)
    wanted[np.cumsum(counts) - 1] = totals
    return _at(ways, wanted, counts), counts


def _totals(ways: Sequence[Floats]) -> Floats:
    out = np.empty(len(ways))
    for which, points in _alike(ways):
        out[which] = _along(points)[:, -1]
    return out


def _at(ways: Sequence[Floats], wanted: Floats, counts: Ints) -> Floats:
    """Points (N, d) at distances `wanted` (N,) along the ways, of which each has its count of them, in order."""
    out, begins = np.empty((len(wanted), ways[0].shape[1])), np.cumsum(counts) - counts
    for which, points in _alike(ways):
        own = counts[which]
        place = np.repeat(begins[which], own) + _from_zero(own)
        out[place] = _between(points, np.repeat(np.arange(len(which)), own), wanted[place])
    return out


def _between(points: Floats, owner: Ints, wanted: Floats) -> Floats:
    """(n, d) at distances (n,) along those of the ways (m, k, d) that `owner` (n,) names; as `np.interp` does it."""
    along = _along(points)
    passed = (along[owner, 1:] <= wanted[:, None]).sum(axis=1)
    at_end = passed == along.shape[1] - 1
    before = np.minimum(passed, along.shape[1] - 2)
    low, high = points[owner, before], points[owner, before + 1]
    way = along[owner, before]
    with np.errstate(divide="ignore", invalid="ignore"):  # points that fall together, at the end
        slope = (high - low) / (along[owner, before + 1] - way)[:, None]
        found = slope * (wanted - way)[:, None] + low
    return np.where(at_end[:, None], high, found)


def _along(points: Floats) -> Floats:
    """(m, k) how far each point of the ways (m, k, d) is from their beginning."""
    out = np.zeros(points.shape[:2])
    np.cumsum(np.linalg.norm(np.diff(points, axis=1), axis=2), axis=1, out=out[:, 1:])
    return out


def _alike(ways: Sequence[Floats]) -> Iterator[tuple[Ints, Floats]]:
    """The ways of as many points together: which they are, and their points (m, k, d)."""
    sizes = np.fromiter(map(len, ways), np.int64, len(ways))
    for size in np.unique(sizes).tolist():
        which = np.flatnonzero(sizes == size)
        yield which, np.concatenate([ways[n] for n in which.tolist()]).reshape(len(which), size, -1)


def _from_zero(counts: Ints) -> Ints:
    """0, 1, ... for each count, one after another."""
    return np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
