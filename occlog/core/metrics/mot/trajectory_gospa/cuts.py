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
FREE, CHANGE, NOTHING = 0, 1, 2
"""Kinds of pieces: weights are to be found; the pair is left or taken at once; there is no frame in it."""


class Pairs(NamedTuple):
    """Rows of targets and tracks that meet, sorted by pair, then by time."""

    truth: Ints  # target
    track: Ints
    time: Ints  # number of the frame among all
    cost: Floats  # distance^p, below c^p

    def take(self, rows: Ints | Bools) -> Pairs:
        """Some of them."""
        return Pairs._make(column[rows] for column in self)

    def joined(self, more: Pairs) -> Pairs:
        """These and others, sorted."""
        both = Pairs._make(np.concatenate(columns) for columns in zip(self, more, strict=True))
        return both.take(np.lexsort((both.time, both.track, both.truth)))


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
        pin_before: (n,) pin of the pair itself that it begins behind; -1: none.
        pin_behind: (n,) pin of the pair itself that it ends at; -1: none.
        target: (n,) the target itself.
        partner: (n,) the track itself.
        final: (n,) whether no row that comes later can be in the target's or in the track's piece of time.
        kind: (n,) `FREE`, `CHANGE` or `NOTHING`.
    """

    truth: Ints
    track: Ints
    begin: Ints
    end: Ints
    before: Ints
    behind: Ints
    first: Ints
    last: Ints
    pin_before: Ints
    pin_behind: Ints
    target: Ints
    partner: Ints
    final: Bools
    kind: Ints

    def take(self, rows: Ints | Bools) -> Pieces:
        """Some of them."""
        return Pieces._make(column[rows] for column in self)

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


class Pins(NamedTuple):
    """Stretches of time in which a pair is sure, in any order.

    Attributes:
        truth: (n,) target.
        track: (n,) track.
        first: (n,) first frame.
        last: (n,) last frame.
        before: (n,) whether the pair's piece of time that ends here is done.
        behind: (n,) whether that which begins here is done.
    """

    truth: Ints
    track: Ints
    first: Ints
    last: Ints
    before: Bools
    behind: Bools

    @classmethod
    def of(cls, truth: Ints, track: Ints, first: Ints, last: Ints) -> Pins:
        """Pins about which nothing is done yet."""
        no = np.zeros(len(truth), dtype=np.bool_)
        return cls(truth, track, first, last, no, no.copy())

    def by(self, key: Ints) -> dict[int, Ints]:
        """Places of the pins of each target (or track), in the order of time."""
        order = np.lexsort((self.first, key))
        who, start = np.unique(key[order], return_index=True)
        return dict(zip(who.tolist(), np.split(order, start)[1:], strict=True))


class Sure(NamedTuple):
    """Stretches of rows of a pair in which it is sure."""

    first: Ints  # (k,) first row of `Pairs`
    last: Ints  # (k,) last row
    rows: Bools  # (n,) whether each row is in one
    alone: Bools  # (n,) whether the two meet nobody else in the frame
    begins: Bools  # (n,) whether a run begins, in which the two meet nobody but each other
    gained: Floats  # (n,) what the run of rows of the pair has gained, this row included

    def pins(self, pairs: Pairs) -> Pins:
        """The stretches as times."""
        return Pins.of(pairs.truth[self.first], pairs.track[self.first], pairs.time[self.first], pairs.time[self.last])


def sure_stretches(pairs: Pairs, most: float, switch: float, told: Ints | None = None) -> Sure:
    """Rows in which a pair is sure, in every solution in whole numbers.

    Args:
        pairs: rows that meet.
        most: c^p.
        switch: gamma^p.
        told: (n,) of rows of which it is known already 1 or 0, of the others -1; None: of all.
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
    enough = enough_gain(switch)
    sure = alone & (np.minimum(so_far, rest) >= enough)
    sure = sure if told is None else np.where(told < 0, sure, told > 0)
    first = sure & ~(goes_on & np.append(False, sure[:-1])[:n])
    last = sure & ~np.append(goes_on[1:] & sure[1:], False)[:n]
    return Sure(np.flatnonzero(first), np.flatnonzero(last), sure, alone, ~goes_on, so_far)


def enough_gain(switch: float) -> float:
    """What a pair must gain before and behind a row to be sure of it: three changes; `switch` is gamma^p."""
    return 3.0 * switch * (1.0 + 1e-9)


def pieces_of(pairs: Pairs, pins: Pins, frames: int, over: tuple[Bools, Bools] | None = None) -> Pieces:
    """Pieces of time of all pairs, between the pins of their targets and tracks.

    Pieces in which a pair does not meet and has no weight before or behind, and those that are done, are left out.

    Args:
        pairs: rows that meet, sorted by pair, then by time; rows within pins may be left out.
        pins: stretches in which pairs are sure.
        frames: number of all frames.
        over: of each target and of each track whether all its rows are there; None: all are.
    """
    by_truth, by_track = pins.by(pins.truth), pins.by(pins.track)
    undone = ~(pins.before & pins.behind)
    none = np.zeros(0, dtype=np.int64)
    key = np.concatenate([_code(pairs.truth, pairs.track), _code(pins.truth[undone], pins.track[undone])])
    codes = np.unique(key)
    mine_from = np.searchsorted(_code(pairs.truth, pairs.track), np.append(codes, np.iinfo(np.int64).max))
    found = [np.zeros((16, 0), dtype=np.int64)]
    for code, start, stop in zip(codes.tolist(), mine_from[:-1].tolist(), mine_from[1:].tolist(), strict=True):
        i, j = code >> _BITS, code & ((1 << _BITS) - 1)
        mine, its = by_truth.get(i, none), by_track.get(j, none)
        both = np.unique(np.concatenate([mine, its]))
        both = both[np.argsort(pins.first[both], kind="stable")]
        own = (pins.truth[both] == i) & (pins.track[both] == j)
        value = own.astype(np.int64)
        # Between two stretches; those of the target and those of the track may overlap
        begin, end = np.append(0, np.maximum.accumulate(pins.last[both]) + 1), np.append(pins.first[both], frames)
        before, behind = np.append(OPEN, value), np.append(value, OPEN)
        low, high = (start + np.searchsorted(pairs.time[start:stop], at) for at in (begin, np.maximum(begin, end)))
        meets = high > low
        after, ahead = np.append(-1, np.where(own, both, -1)), np.append(np.where(own, both, -1), -1)
        left = (after >= 0) & ~np.append(False, pins.behind[both]) | (ahead >= 0) & ~np.append(pins.before[both], False)
        # Without a reason to stay, the weight changes at once
        direct = (before + behind == 1) & (before != OPEN) & (behind != OPEN) & ~meets
        kind = np.where(direct, CHANGE, np.where(end > begin, FREE, NOTHING))
        kept = np.flatnonzero((meets & (end > begin)) | left)
        at_mine, at_its = np.searchsorted(pins.last[mine], begin[kept]), np.searchsorted(pins.last[its], begin[kept])
        final = np.ones(len(kept), dtype=np.bool_)
        if over is not None:
            final = ((at_mine < len(mine)) | over[0][i]) & ((at_its < len(its)) | over[1][j])
        who, whom = np.full(len(kept), i), np.full(len(kept), j)
        columns = (column[kept] for column in (begin, end, before, behind, low, high, after, ahead))
        found.append(np.stack([who, at_mine, whom, at_its, *columns, who, whom, final, kind[kept]]))
    table = np.concatenate(found, axis=1)
    truth, track = (np.unique(table[k : k + 2], axis=1, return_inverse=True)[1].reshape(-1) for k in (0, 2))
    begin_to_partner = table[4:14]
    return Pieces._make([truth, track, *begin_to_partner, table[14].astype(np.bool_), table[15]])


_BITS = 31


def _code(truth: Ints, track: Ints) -> Ints:
    """One number for a pair, in the order of pairs."""
    return (truth << _BITS) | track


def delimiters(pieces: Pieces, pins: Pins) -> Bools:
    """(n,) which pins are the last before pieces or the first behind them, of their targets and tracks."""
    needed = np.zeros(len(pins.first), dtype=np.bool_)
    for key, whose in ((pins.truth, pieces.target), (pins.track, pieces.partner)):
        own = pins.by(key)
        for who in np.unique(whose).tolist():
            mine = own.get(who)
            if mine is None:
                continue
            at = np.searchsorted(pins.last[mine], pieces.begin[whose == who])
            needed[mine[at[at < len(mine)]]] = True
            needed[mine[at[at > 0] - 1]] = True
    return needed
