"""Many ways through points at once: dashes of them, and points close together along them.

An image has hundreds of short ways, which one after another would take most of the time of an export.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints

FEWEST_DASHES, MOST_DASHES = 6, 200


class Alike(NamedTuple):
    """The ways of as many points.

    Attributes:
        which: (m,) they are.
        points: (m, k, d).
        along: (m, k) how far each point is from the beginning of its way.
    """

    which: Ints
    points: Floats
    along: Floats


def dashes(ways: Sequence[Floats], length: float) -> list[Floats]:
    """(2 n, d) ends of the dashes of each way, of about `length`, with gaps as long between them.

    Args:
        ways: points (k, d), k > 1, of one d.
        length: > 0.
    """
    if not ways:
        return []
    groups = _alike(ways)
    totals = _totals(groups, len(ways))
    counts = np.clip(np.rint(totals / (2.0 * length)), FEWEST_DASHES, MOST_DASHES).astype(np.int64)
    ends = 2 * counts
    number = _from_zero(ends)
    wanted = (number // 2 + 0.5 * (number % 2)) / np.repeat(counts, ends) * np.repeat(totals, ends)
    return np.split(_at(groups, wanted, ends), np.cumsum(ends)[:-1])


def dense(ways: Sequence[Floats], step: float, most: int) -> tuple[Floats, Ints]:
    """Points along ways, evenly from the first to the last of each, and how many each has.

    Args:
        ways: points (k, d), k > 1, of one d; at least one way.
        step: from one point to the next, at most, > 0.
        most: points of one way; those of a longer one are farther apart.

    Returns:
        (N, d), way after way, and (len(ways),) from 2 to `most`.
    """
    groups = _alike(ways)
    totals = _totals(groups, len(ways))
    counts = np.clip(np.ceil(totals / step) + 1, 2, most).astype(np.int64)
    wanted = _from_zero(counts) * np.repeat(totals / (counts - 1), counts)
    wanted[np.cumsum(counts) - 1] = totals
    return _at(groups, wanted, counts), counts


def _alike(ways: Sequence[Floats]) -> list[Alike]:
    sizes = np.fromiter(map(len, ways), np.int64, len(ways))
    found = []
    for size in np.unique(sizes).tolist():
        which = np.flatnonzero(sizes == size)
        points = np.concatenate([ways[n] for n in which.tolist()]).reshape(len(which), size, -1)
        along = np.zeros(points.shape[:2])
        np.cumsum(np.linalg.norm(np.diff(points, axis=1), axis=2), axis=1, out=along[:, 1:])
        found.append(Alike(which, points, along))
    return found


def _totals(groups: Sequence[Alike], count: int) -> Floats:
    out = np.empty(count)
    for group in groups:
        out[group.which] = group.along[:, -1]
    return out


def _at(groups: Sequence[Alike], wanted: Floats, counts: Ints) -> Floats:
    """Points (N, d) at distances `wanted` (N,) along all ways, of which each has its count of them, in order."""
    if len(groups) == 1:
        return _between(groups[0], counts, wanted)
    out, begins = np.empty((len(wanted), groups[0].points.shape[2])), np.cumsum(counts) - counts
    for group in groups:
        own = counts[group.which]
        place = np.repeat(begins[group.which], own) + _from_zero(own)
        out[place] = _between(group, own, wanted[place])
    return out


def _between(group: Alike, counts: Ints, wanted: Floats) -> Floats:
    """(n, d) at distances (n,) along the ways of a group, of which each has its count; as `np.interp` does it."""
    points, along = group.points, group.along
    size, axes = points.shape[1:]
    owner = np.repeat(np.arange(len(points)), counts)
    passed = _passed(along, counts, wanted)
    at_end = np.flatnonzero(passed == size - 1)
    before = np.minimum(passed, size - 2)
    with np.errstate(divide="ignore", invalid="ignore"):  # of points that fall together, between which none is
        slope = np.diff(points, axis=1) / np.diff(along, axis=1)[:, :, None]
        first, segment = owner * size + before, owner * (size - 1) + before
        found: Floats = slope.reshape(-1, axes)[segment]
        found *= (wanted - along.reshape(-1)[first])[:, None]
        found += points.reshape(-1, axes)[first]
    found[at_end] = points[owner[at_end], -1]
    return found


def _passed(along: Floats, counts: Ints, wanted: Floats) -> Ints:
    """(n,) how many points of its way lie behind each distance, the first left out."""
    if along.shape[1] == 2:
        return (wanted >= np.repeat(along[:, 1], counts)).astype(np.int64)
    parts = np.split(wanted, np.cumsum(counts)[:-1])
    return np.concatenate([row[1:].searchsorted(part, side="right") for row, part in zip(along, parts, strict=True)])


def _from_zero(counts: Ints) -> Ints:
    """0, 1, ... for each count, one after another."""
    return np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
