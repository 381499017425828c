"""Cuts trajectory GOSPA into programs that can be solved apart, in time as well as among targets.

While a target and a track meet nobody but each other for long enough, they have each other in every solution in whole
numbers: a solution without that for a stretch would save at most three changes of price gamma^p by it, and lose what
the stretch gains.  Where both the part before and the part behind a moment gain as much, the pair is sure of that
moment, and what comes behind it needs to know nothing of what was before.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from occlog.array_types import Bools, Floats, Ints

OPEN = -1
"""The value at an end of a piece that is that of the recording: any."""


class Pairs(NamedTuple):
    """Rows of targets and tracks that meet, sorted by pair, then by time."""

    truth: Ints  # target
    track: Ints
    time: Ints  # place of the frame in `Frames`
    cost: Floats  # distance^p, below c^p


class Pieces(NamedTuple):
    """Pieces of time of pairs, between the moments of which a target or a track of theirs is sure.

    Attributes:
        truth: (n,) number of the target in its piece of time: pieces with the same one share it.
        track: (n,) the same of the track.
        begin: (n,) first frame.
        end: (n,) frame after the last.
        before: (n,) weight of the pair before it: 0, 1 or `OPEN`.
        behind: (n,) weight of the pair behind it.
        first: (n,) first row of `Pairs` in it.
        last: (n,) row after the last.
    """

    truth: Ints
    track: Ints
    begin: Ints
    end: Ints
    before: Ints
    behind: Ints
    first: Ints
    last: Ints

    def blocks(self) -> Iterator[Ints]:
        """Pieces that have to be solved together."""
        if not len(self.truth):
            return
        targets = int(self.truth.max()) + 1
        size = targets + int(self.track.max()) + 1
        edges = coo_array((np.ones(len(self.truth)), (self.truth, targets + self.track)), shape=(size, size))
        label = connected_components(edges, directed=False)[1][self.truth]
        order = np.argsort(label, kind="stable")
        yield from np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


class Sure(NamedTuple):
    """Stretches of rows of a pair in which it is sure."""

    first: Ints  # (k,) first row of `Pairs`
    last: Ints  # (k,) last row
    rows: Bools  # (n,) whether each row is in one


def sure_stretches(pairs: Pairs, most: float, switch: float) -> Sure:
    """Rows in which a pair is sure, in every solution in whole numbers.

    Args:
        pairs: rows that meet.
        most: c^p.
        switch: gamma^p.
    """
    n = len(pairs.time)
    goes_on, alone = np.ones(n, dtype=bool), np.ones(n, dtype=bool)
    for key in (pairs.truth, pairs.track):
        order = np.lexsort((pairs.time, key))
        same = key[order[1:]] == key[order[:-1]]
        previous = np.full(n, -1)
        previous[order[1:]] = np.where(same, order[:-1], -1)
        goes_on &= previous == np.arange(n) - 1
        twice = same & (pairs.time[order[1:]] == pairs.time[order[:-1]])
        alone[order[1:][twice]] = alone[order[:-1][twice]] = False
    # A run: rows of a pair between which neither of the two meets anybody else
    goes_on[1:] &= alone[1:] & alone[:-1]
    goes_on[:1] = False
    run, start = np.cumsum(~goes_on) - 1, np.flatnonzero(~goes_on)
    gain = most - pairs.cost
    so_far = np.cumsum(gain)
    so_far = so_far - (so_far[start] - gain[start])[run]
    rest = np.bincount(run, gain, minlength=len(start))[run] - so_far + gain
    sure = alone & (np.minimum(so_far, rest) >= 3.0 * switch * (1.0 + 1e-9))
    first = sure & ~(goes_on & np.append(False, sure[:-1])[:n])
    last = sure & ~np.append(goes_on[1:] & sure[1:], False)[:n]
    return Sure(np.flatnonzero(first), np.flatnonzero(last), sure)


def pieces_of(pairs: Pairs, sure: Sure, frames: int) -> tuple[Pieces, float]:
    """Pieces of all pairs between their sure stretches, and the changes that are certain, in sums of differences.

    Pieces in which a pair does not meet and has no weight before or behind have none, and are left out.
    """
    pins = _Pins(pairs.truth[sure.first], pairs.track[sure.first], pairs.time[sure.first], pairs.time[sure.last])
    by_truth, by_track = pins.of(pins.truth, pairs.truth), pins.of(pins.track, pairs.track)
    starts = _starts(pairs)
    found, certain = [np.zeros((10, 0), dtype=np.int64)], 0.0
    for start, stop in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        i, j = int(pairs.truth[start]), int(pairs.track[start])
        mine, its = by_truth[i], by_track[j]
        both = np.unique(np.concatenate([mine, its]))
        both = both[np.argsort(pins.first[both], kind="stable")]
        value = ((pins.truth[both] == i) & (pins.track[both] == j)).astype(np.int64)
        # Between two stretches; those of the target and those of the track may overlap
        begin, end = np.append(0, np.maximum.accumulate(pins.last[both]) + 1), np.append(pins.first[both], frames)
        before, behind = np.append(OPEN, value), np.append(value, OPEN)
        low, high = (start + np.searchsorted(pairs.time[start:stop], at) for at in (begin, np.maximum(begin, end)))
        meets = high > low
        # Without a reason to stay, the weight changes at once
        direct = (before + behind == 1) & (before != OPEN) & (behind != OPEN) & ~meets
        certain += float(np.count_nonzero(direct))
        kept = np.flatnonzero((end > begin) & ~direct & (meets | (before == 1) | (behind == 1)))
        columns = (begin, end, before, behind, low, high)
        who = (np.full(len(kept), i), np.searchsorted(pins.last[mine], begin[kept]))
        whom = (np.full(len(kept), j), np.searchsorted(pins.last[its], begin[kept]))
        found.append(np.stack([*who, *whom, *(column[kept] for column in columns)]))
    table = np.concatenate(found, axis=1)
    numbered = (np.unique(table[k : k + 2], axis=1, return_inverse=True)[1].reshape(-1) for k in (0, 2))
    return Pieces(*numbered, *table[4:]), certain


def _starts(pairs: Pairs) -> Ints:
    """First row of each pair, and the number of rows."""
    new = (np.diff(pairs.truth) != 0) | (np.diff(pairs.track) != 0)
    n = len(pairs.time)
    return np.concatenate([np.arange(min(n, 1)), np.flatnonzero(new) + 1, [n]])


class _Pins(NamedTuple):
    """Stretches of time in which a pair is sure."""

    truth: Ints
    track: Ints
    first: Ints  # frame
    last: Ints

    def of(self, key: Ints, among: Ints) -> list[Ints]:
        """Stretches of each target (or track), in the order of time."""
        order = np.lexsort((self.first, key))
        edges = np.searchsorted(key[order], np.arange(int(among.max(initial=-1)) + 2))
        return [order[a:b] for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)]
