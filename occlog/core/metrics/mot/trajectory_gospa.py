"""Trajectory GOSPA: distance between true trajectories and tracks, with a penalty for every track switch.

Garcia-Fernandez, Rahmathullah and Svensson 2020, "A metric on the space of finite sets of trajectories for evaluation
of multi-target tracking algorithms", IEEE Trans. Signal Processing 68; the relaxation as a linear program, which is a
metric, too, and equal to the combinatorial form if the solution is integral.

The program is decomposed in time and among targets. While a target and a track are near no other for long enough, they
are paired in every integral solution: leaving the pair would save at most three switches of gamma^p, and lose the gain
of the segment. If both the part before and the part after a time step gain as much, the pair is fixed at that time
step, and later steps are independent of earlier ones. The remaining pieces are solved as linear programs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import Sum

from .frame_pairs import MatchedFrames

OPEN = -1
"""The value at an end of a piece that is that of the recording: any."""
FREE, CHANGE, NOTHING = 0, 1, 2
"""Kinds of pieces: weights are to be found; the pair is left or taken at once; there is no frame in it."""


class TrajectoryPairs(NamedTuple):
    """Rows (a target and a track closer than the cutoff in a frame), sorted by target, track and time.

    Columns: target, track, number of the frame, and cost distance^p, below c^p.
    """

    truth: Ints  # target
    track: Ints
    time: Ints  # number of the frame among all
    cost: Floats  # distance^p, below c^p

    def take(self, rows: Ints | Bools) -> TrajectoryPairs:
        """Return the rows selected by a mask or by indices `rows`, as a copy."""
        return TrajectoryPairs._make(column[rows] for column in self)

    def joined(self, more: TrajectoryPairs) -> TrajectoryPairs:
        """Return the rows of both objects, sorted by target, track and time."""
        both = TrajectoryPairs._make(np.concatenate(columns) for columns in zip(self, more, strict=True))
        return both.take(np.lexsort((both.time, both.track, both.truth)))


class TrajectoryPieces(NamedTuple):
    """Pieces of time of target-track pairs: between the frames in which the target or the track is in a fixed pair.

    Attributes:
        truth: (n,) number of the target's piece of time; entries with equal numbers share the capacity of the target.
        track: (n,) number of the track's piece of time.
        begin: (n,) first frame.
        end: (n,) frame after the last.
        before: (n,) weight of the pair before the piece: 0, 1 or `OPEN`.
        behind: (n,) weight of the pair after the piece: 0, 1 or `OPEN`.
        first: (n,) first row of `TrajectoryPairs` in it.
        last: (n,) row after the last.
        pin_before: (n,) index of the fixed segment of the pair itself after which the piece begins; -1: none.
        pin_behind: (n,) index of the fixed segment of the pair itself at which the piece ends; -1: none.
        target: (n,) the target.
        partner: (n,) the track.
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

    def take(self, rows: Ints | Bools) -> TrajectoryPieces:
        """Return the pieces selected by a mask or by indices, as a copy."""
        return TrajectoryPieces._make(column[rows] for column in self)

    def blocks(self) -> Iterator[Ints]:
        """Generate groups of pieces that must be solved together, as indices of the pieces.

        Two pieces are in one group if they share a target's or a track's piece of time, also indirectly.
        """
        if not len(self.truth):
            return
        targets = int(self.truth.max()) + 1
        size = targets + int(self.track.max()) + 1
        edges = coo_array((np.ones(len(self.truth)), (self.truth, targets + self.track)), shape=(size, size))
        label = connected_components(edges, directed=False)[1][self.truth]
        order = np.argsort(label, kind="stable")
        yield from np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


class FixedPairs(NamedTuple):
    """Segments of time in which a pair is fixed (present in every integral solution), in any order.

    Attributes:
        truth: (n,) target.
        track: (n,) track.
        first: (n,) first frame.
        last: (n,) last frame.
        before: (n,) whether the pair's piece of time that ends at this segment has been processed.
        behind: (n,) whether the pair's piece of time that begins after this segment has been processed.
    """

    truth: Ints
    track: Ints
    first: Ints
    last: Ints
    before: Bools
    behind: Bools

    @classmethod
    def of(cls, truth: Ints, track: Ints, first: Ints, last: Ints) -> FixedPairs:
        """Return segments of pairs, with `before` and `behind` False.

        Args:
            truth: (n,) targets.
            track: (n,) tracks.
            first: (n,) first frames.
            last: (n,) last frames.
        """
        no = np.zeros(len(truth), dtype=np.bool_)
        return cls(truth, track, first, last, no, no.copy())

    def by(self, key: Ints) -> dict[int, Ints]:
        """Return the indices of the segments of each target (or track) in the order of time, by number of the target.

        `key` (n,) is the target (or track) of each segment.
        """
        order = np.lexsort((self.first, key))
        who, start = np.unique(key[order], return_index=True)
        return dict(zip(who.tolist(), np.split(order, start)[1:], strict=True))


class FixedSegments(NamedTuple):
    """Segments of consecutive rows of `TrajectoryPairs` in which the pair is fixed, and properties of all n rows.

    A run is a sequence of rows of a pair between which neither of the two is within the cutoff of any other.
    """

    first: Ints  # (k,) first row of `TrajectoryPairs`
    last: Ints  # (k,) last row
    rows: Bools  # (n,) whether each row is in one
    alone: Bools  # (n,) mask: the two meet no other in the frame
    begins: Bools  # (n,) mask: a run begins, in which the two meet no other
    gained: Floats  # (n,) what the run of rows of the pair has gained, this row included

    def pins(self, pairs: TrajectoryPairs) -> FixedPairs:
        """Return the segments with targets, tracks and frames in place of indices of rows of `pairs`."""
        return FixedPairs.of(
            pairs.truth[self.first], pairs.track[self.first], pairs.time[self.first], pairs.time[self.last]
        )


def sure_segments(pairs: TrajectoryPairs, most: float, switch: float, known: Ints | None = None) -> FixedSegments:
    """Return the segments of rows in which a pair is fixed, i.e. present in every integral solution.

    A row is fixed if target and track are within the cutoff of no other, and its run gains at least three switches up
    to the row and from the row on.

    Args:
        pairs: n rows within the cutoff, sorted by pair, then by time.
        most: c^p, power of the cutoff.
        switch: gamma^p, price of a change of track.
        known: (n,) 1 or 0 for rows that were decided before (fixed or not), -1 for others; None: -1 for all.
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
    # A run: rows of a pair between which neither of the two meets any other person
    goes_on[1:] &= alone[1:] & alone[:-1]
    goes_on[:1] = False
    run, start = np.cumsum(~goes_on) - 1, np.flatnonzero(~goes_on)
    gain = most - pairs.cost
    so_far = np.cumsum(gain)
    so_far = so_far - (so_far[start] - gain[start])[run]
    rest = np.bincount(run, gain, minlength=len(start))[run] - so_far + gain
    enough = enough_gain(switch)
    sure = alone & (np.minimum(so_far, rest) >= enough)
    sure = sure if known is None else np.where(known < 0, sure, known > 0)
    first = sure & ~(goes_on & np.append(False, sure[:-1])[:n])
    last = sure & ~np.append(goes_on[1:] & sure[1:], False)[:n]
    return FixedSegments(np.flatnonzero(first), np.flatnonzero(last), sure, alone, ~goes_on, so_far)


def enough_gain(switch: float) -> float:
    """Return the gain, a sum of c^p - d^p, that a pair needs before and after a row to be fixed: 3 gamma^p.

    `switch` is gamma^p, the price of a change of track.
    """
    return 3.0 * switch * (1.0 + 1e-9)


def pieces_of(
    pairs: TrajectoryPairs, pins: FixedPairs, frames: int, over: tuple[Bools, Bools] | None = None
) -> TrajectoryPieces:
    """Return the pieces of time of all pairs, between the fixed segments of their targets and tracks.

    Pieces without a row and without weight before or after, and processed pieces, are omitted.

    Args:
        pairs: rows within the cutoff, sorted by pair, then by time; rows within fixed segments may be omitted.
        pins: segments in which pairs are fixed.
        frames: number of all frames.
        over: of each target and of each track whether all its rows have been added; None: all have.
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
        # Between two segments; those of the target and those of the track may overlap
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
    return TrajectoryPieces._make([truth, track, *begin_to_partner, table[14].astype(np.bool_), table[15]])


_BITS = 31


def _code(truth: Ints, track: Ints) -> Ints:
    """Return integers (n,) that represent pairs of target `truth` and track `track`, (n,) each, and sort like them."""
    return (truth << _BITS) | track


def delimiters(pieces: TrajectoryPieces, pins: FixedPairs) -> Bools:
    """Return the (n,) mask of the fixed segments `pins` that are the last before, or the first after, any piece."""
    needed = np.zeros(len(pins.first), dtype=np.bool_)
    for key, owner in ((pins.truth, pieces.target), (pins.track, pieces.partner)):
        own = pins.by(key)
        for who in np.unique(owner).tolist():
            mine = own.get(who)
            if mine is None:
                continue
            at = np.searchsorted(pins.last[mine], pieces.begin[owner == who])
            needed[mine[at[at < len(mine)]]] = True
            needed[mine[at[at > 0] - 1]] = True
    return needed


class _Program(NamedTuple):
    """Unknowns of pieces that are solved together: weights of pairs, piece by piece in the order of time."""

    piece: Ints  # (n,) position of the piece among those that are solved together
    start: Ints  # (n,) first frame
    meets: Ints  # (n,) row of `TrajectoryPairs`; -1: a segment


def _unknowns(pairs: TrajectoryPairs, pieces: TrajectoryPieces) -> _Program:
    """Return the unknowns of pieces that are solved together.

    They are the weights of rows within the cutoff, and of the segments of frames between them.

    Args:
        pairs: rows within the cutoff.
        pieces: pieces to be solved together.
    """
    found: list[tuple[int, int, int]] = []
    for number, (begin, end, first, last) in enumerate(
        zip(*(column.tolist() for column in (pieces.begin, pieces.end, pieces.first, pieces.last)), strict=True)
    ):
        free = begin  # first frame that no unknown of this piece covers yet
        for row, at in enumerate(pairs.time[first:last].tolist(), first):
            if at > free:
                found.append((number, free, -1))
            found.append((number, at, row))
            free = at + 1
        if free < end:
            found.append((number, free, -1))
    return _Program(*np.array(found, dtype=np.int64).T)


def solve(pairs: TrajectoryPairs, pieces: TrajectoryPieces, most: float, switch: float, weights: Floats) -> float:
    """Solve the linear program of pieces: write the weights of the rows, and return the total change of all weights.

    The total is the sum of |W_t+1 - W_t| over pairs and frames; one complete change of track counts 2.

    Args:
        pairs: rows within the cutoff.
        pieces: pieces that share targets or tracks, all of kind `FREE`.
        most: c^p, power of the cutoff.
        switch: gamma^p, price of a change of track.
        weights: (n,) weights of all rows; those of the pieces' rows are set in place.

    Raises:
        RuntimeError: the solver found no solution.
    """
    program = _unknowns(pairs, pieces)
    n = len(program.piece)
    meets = program.meets >= 0
    gain = np.zeros(n)
    gain[meets] = pairs.cost[program.meets[meets]] - most
    # Changes: weight after minus weight before = rise - fall, both >= 0 and at equal cost; at the ends of a piece one
    # of the two weights is known
    new = np.append(True, program.piece[1:] != program.piece[:-1])
    after = np.flatnonzero(~new)
    begins, ends = np.flatnonzero(new), np.flatnonzero(np.append(new[1:], True))
    begins, before = begins[pieces.before != OPEN], pieces.before[pieces.before != OPEN]
    ends, behind = ends[pieces.behind != OPEN], pieces.behind[pieces.behind != OPEN]
    m, last = len(after) + len(begins), len(after) + len(begins) + len(ends)
    k = np.arange(last)
    plus, minus = np.concatenate([after, begins]), np.concatenate([after - 1, ends])
    rows = np.concatenate([k[:m], k[: len(after)], k[m:], k, k])
    columns = np.concatenate([plus, minus, n + k, n + last + k])
    signs = np.concatenate([np.ones(m), -np.ones(len(minus)), -np.ones(last), np.ones(last)])
    change = coo_array((signs, (rows, columns)), shape=(last, n + 2 * last))
    shared = _capacity(program, pieces)
    limit = csr_array((shared.data, shared.indices, shared.indptr), shape=(shared.shape[0], n + 2 * last))
    # In units of c^p: the solver's tolerances are absolute, so that small lengths would all cost it nothing
    price = np.concatenate([gain, np.full(2 * last, 0.5 * switch)]) / most
    found = linprog(  # type: ignore[call-overload]  # the stubs know no sparse matrices
        price,
        A_ub=limit,
        b_ub=np.ones(limit.shape[0]),
        A_eq=change.tocsr() if last else None,
        b_eq=np.concatenate([np.zeros(len(after)), before, -behind]) if last else None,
        bounds=(0.0, None),
        method="highs",
    )
    if found.x is None:
        raise RuntimeError(f"trajectory GOSPA: {found.message}")
    weights[program.meets[meets]] = np.clip(found.x[:n][meets], 0.0, 1.0)
    return float(found.x[n:].sum())


def _capacity(program: _Program, pieces: TrajectoryPieces) -> csr_array:
    """Return the (R, n) sparse constraints: the weights of a target, or of a track, in one frame sum to at most 1.

    Args:
        program: the n unknowns (weights).
        pieces: the pieces of pairs that they belong to.
    """
    rows: list[Ints] = []
    begins = np.searchsorted(program.piece, np.arange(len(pieces.truth) + 1))
    for side in (pieces.truth, pieces.track):
        for key in np.unique(side).tolist():
            own = np.flatnonzero(side == key)
            spans = [program.start[begins[k] : begins[k + 1]] for k in own.tolist()]
            # The unknowns change at the beginning of one of them only
            times = np.unique(np.concatenate(spans))
            at = np.column_stack([
                np.searchsorted(s, times, side="right") - 1 + begins[k]
                for s, k in zip(spans, own.tolist(), strict=True)
            ])  # fmt: skip
            there = (times[:, None] >= pieces.begin[own]) & (times[:, None] < pieces.end[own])
            rows += [row[row >= 0] for row in np.unique(np.where(there, at, -1), axis=0)]
    sizes = np.array([len(row) for row in rows], dtype=np.int64)
    columns = np.concatenate(rows)
    pointers = np.concatenate([[0], np.cumsum(sizes)])
    return csr_array((np.ones(len(columns)), columns, pointers), shape=(len(rows), len(program.piece)))


class TrajectoryGospa(NamedTuple):
    """Trajectory GOSPA to the power of p, summed over all frames, and the parts that add up to it; unit^p each.

    Attributes:
        total: the sum; the metric is its p-th root.
        localisation: distances of targets from their tracks.
        missed: c^p / 2 for each target in each frame without a track.
        false: c^p / 2 for each track in each frame without a target.
        switch: gamma^p for each change from one track to another, half of it for one from or to none.
        p: exponent.
    """

    total: float
    localisation: float
    missed: float
    false: float
    switch: float
    p: float


class TrajectoryCosts:
    """Accumulates trajectory GOSPA over parts of a recording, in the order of time.

    Fixed pairs are added at once. Others are kept until no later frame can change them: until their targets and tracks
    are fixed again, or have no rows any more.
    """

    def __init__(self, frames: int, targets: int, tracks: int, cutoff: float, switch: float, p: float = 2.0) -> None:
        """Start without frames.

        Args:
            frames: number of all frames.
            targets: number of all targets.
            tracks: number of all tracks.
            cutoff: largest distance that counts, c > 0, unit of the distance.
            switch: price of a change of track, gamma > 0, unit of the distance.
            p: exponent, >= 1.

        Raises:
            ValueError: an option is outside its range.
        """
        if not (0 < cutoff < np.inf and 0 < switch < np.inf and 1 <= p < np.inf):
            raise ValueError(f"cutoff {cutoff:g} and switch {switch:g} must be above 0, p {p:g} at least 1")
        self._frames, self._cutoff, self._p = frames, cutoff, p
        self._most, self._switch = cutoff**p, switch**p
        self._rows = np.zeros(2, dtype=np.int64)  # of the truth, of tracks
        self._over = np.zeros(targets, dtype=np.bool_), np.zeros(tracks, dtype=np.bool_)
        self._cost, self._weight, self._changes = Sum(), Sum(), Sum()
        self._runs = _NO_PAIRS  # for each run that may go on its last row of which it is known whether it is sure
        self._sure = np.zeros(0, dtype=np.int64)  # of these rows: 1 or 0
        self._later = _NO_PAIRS  # rows that are sure if their run goes on
        self._loose = _NO_PAIRS  # rows that are not sure, and not solved
        none = np.zeros(0, dtype=np.int64)
        self._pins = FixedPairs.of(none, none, none, none)
        self._finished = False

    def update(self, frames: MatchedFrames, first: int, over: tuple[Bools, Bools] | None = None) -> None:
        """Add frames, in the order of time; target and track numbers are the same in all parts.

        Args:
            frames: truth and tracks.
            first: number of frames before them.
            over: of each target and of each track whether no row of it is to come; None: that is not known.
        """
        self._rows += [len(frames.truth), len(frames.track)]
        self._over = self._over if over is None else over
        self._tell_sure(rows_within_cutoff(frames, self._cutoff, self._p, first))
        self._solve()

    def merge(self, other: TrajectoryCosts) -> None:
        """Add another recording without common targets or tracks; no frame may be added afterwards."""
        for each in (self, other):
            each._finish()
        self._rows = self._rows + other._rows
        self._cost.merge(other._cost)
        self._weight.merge(other._weight)
        self._changes.merge(other._changes)

    def _finish(self) -> None:
        """Solve all pieces of time that are left, since no frame can be added any more; a second call has no effect."""
        if self._finished:
            return
        targets, tracks = self._over
        self._over, self._finished = (np.ones_like(targets), np.ones_like(tracks)), True
        self._tell_sure(_NO_PAIRS)
        self._solve()

    def result(self) -> TrajectoryGospa:
        """Return the trajectory GOSPA of all frames; none can be added afterwards."""
        self._finish()
        half, weight = 0.5 * self._most, self._weight.value
        n, m = self._rows.tolist()
        parts = self._cost.value, half * (n - weight), half * (m - weight), 0.5 * self._switch * self._changes.value
        return TrajectoryGospa(sum(parts), *parts, self._p)

    def _tell_sure(self, new: TrajectoryPairs) -> None:
        """Classify the rows of further frames: fixed rows, rows that may become fixed later, and rows that will not.

        The costs of fixed rows are added; the others are kept, the last kind for the linear programs.

        Args:
            new: rows within the cutoff of further frames, sorted by pair, then by time.
        """
        rows = TrajectoryPairs._make(
            np.concatenate(column) for column in zip(self._runs, self._later, new, strict=True)
        )
        order = np.lexsort((rows.time, rows.track, rows.truth))
        known = np.append(self._sure, np.full(len(order) - len(self._sure), -1))[order]
        rows, decided = rows.take(order), known >= 0
        sure = sure_segments(rows, self._most, self._switch, known)
        # A segment that begins with a row that was output before goes on with the pin of the pair that is the last one
        goes_on = decided[sure.first]
        found = sure.pins(rows)
        pins = self._pins
        by_pair: dict[tuple[int, int], int] = {}
        if goes_on.any():
            for n in np.argsort(pins.first, kind="stable").tolist():
                by_pair[int(pins.truth[n]), int(pins.track[n])] = n
        for k in np.flatnonzero(goes_on).tolist():
            pins.last[by_pair[int(found.truth[k]), int(found.track[k])]] = found.last[k]
        self._pins = FixedPairs._make(np.concatenate([a, b[~goes_on]]) for a, b in zip(pins, found, strict=True))
        certain = sure.rows & ~decided
        self._cost.add(float(rows.cost[certain].sum()))
        self._weight.add(float(np.count_nonzero(certain)))
        # A run goes on where its last row is the last one of both, which meet no other in it and have rows to come
        latest = sure.alone & ~self._over[0][rows.truth] & ~self._over[1][rows.track]
        for key in (rows.truth, rows.track):
            last = np.full(int(key.max(initial=-1)) + 1, -1, dtype=np.int64)
            np.maximum.at(last, key, rows.time)
            latest &= rows.time == last[key]
        run = np.cumsum(sure.begins) - 1
        may = np.isin(run, run[latest])
        later = may & ~sure.rows & ~decided & (sure.gained >= enough_gain(self._switch))
        self._later = rows.take(later)
        self._loose = self._loose.joined(rows.take(~sure.rows & ~decided & ~later))
        # Of each run that may go on the last row that is output, which represents all before it
        keep = may & ~later
        keep[:-1] &= ~(keep[1:] & (run[1:] == run[:-1])) if len(keep) else True
        kept = rows.take(keep)
        self._runs, self._sure = kept._replace(cost=self._most - sure.gained[keep]), sure.rows[keep].astype(np.int64)

    def _solve(self) -> None:
        """Solve the linear programs of the pieces of time that no later frame can change.

        Their costs are added to the sums, and their rows and fixed segments are dropped.
        """
        pieces = pieces_of(self._loose, self._pins, self._frames, self._over)
        done = np.zeros(len(pieces.final), dtype=np.bool_)
        done[(pieces.kind != FREE) & pieces.final] = True
        self._changes.add(float(np.count_nonzero((pieces.kind == CHANGE) & pieces.final)))
        weights = np.ones(len(self._loose.time))
        free = np.flatnonzero(pieces.kind == FREE)
        for block in pieces.take(free).blocks():
            part = pieces.take(free[block])
            if not part.final.all():
                continue
            done[free[block]] = True
            if len(block) > 1 or 0 in (part.before[0], part.behind[0]):  # else they belong together all the time
                self._changes.add(solve(self._loose, part, self._most, self._switch, weights))
        gone = np.zeros(len(weights) + 1, dtype=np.int64)
        np.add.at(gone, pieces.first[done], 1)
        np.add.at(gone, pieces.last[done], -1)
        solved = np.cumsum(gone)[:-1] > 0
        self._cost.add(float(weights[solved] @ self._loose.cost[solved]))
        self._weight.add(float(weights[solved].sum()))
        self._loose = self._loose.take(~solved)
        self._forget(pieces, done)

    def _forget(self, pieces: TrajectoryPieces, done: Bools) -> None:
        """Drop fixed segments that are processed and delimit no unprocessed piece; updates the segments.

        Args:
            pieces: all pieces of this part.
            done: (n,) pieces that have been processed.
        """
        pins = self._pins
        pins.behind[pieces.pin_before[done & (pieces.pin_before >= 0)]] = True
        pins.before[pieces.pin_behind[done & (pieces.pin_behind >= 0)]] = True
        needed = ~(pins.before & pins.behind) | delimiters(pieces.take(~done), pins)
        for key, over in zip((pins.truth, pins.track), self._over, strict=True):
            for own in pins.by(key).values():
                needed[own[-1]] |= not over[key[own[-1]]]
        self._pins = FixedPairs._make(column[needed] for column in pins)


def trajectory_gospa(frames: MatchedFrames, cutoff: float, switch: float, p: float = 2.0) -> TrajectoryGospa:
    """Return the trajectory GOSPA of all frames.

    With W_t(i, j) >= 0 the weight with which target i has track j in frame t, sums over j and over i at most 1, it is
    the minimum over W of

        sum over t of [sum over pairs of W_t(i, j) min(d, c)^p + c^p / 2 (weight of targets without a track + weight of
        tracks without a target)] + gamma^p / 2 sum over t, i, j of |W_t+1(i, j) - W_t(i, j)|.

    Pairs never within c have no weight. Over a segment of frames in which a pair is not within c its weight costs only
    its changes, so that one unknown suffices for the segment. Pairs without common targets or tracks, also indirectly,
    are solved separately.

    Args:
        frames: truth and tracks.
        cutoff: largest distance that counts, c > 0, unit of the distance.
        switch: price of a change of track, gamma > 0, unit of the distance.
        p: exponent, >= 1.

    Raises:
        ValueError: an option is outside its range.
        RuntimeError: the linear program has no solution, which cannot be.
    """
    sums = TrajectoryCosts(len(frames.frame), len(frames.truth_key), len(frames.track_key), cutoff, switch, p)
    sums.update(frames, 0)
    return sums.result()


def rows_within_cutoff(frames: MatchedFrames, cutoff: float, p: float, first: int = 0) -> TrajectoryPairs:
    """Return the rows of targets and tracks that are closer than the cutoff, sorted by target, track and frame.

    Args:
        frames: truth and tracks.
        cutoff: distance below which a row is included.
        p: the cost of a row is the distance to this power.
        first: number of the first frame, i.e. how many frames came before.
    """
    none = np.zeros(0, dtype=np.int64)
    found = [(none, none, none, np.zeros(0))]
    for t in frames.meeting():
        left, right = frames.rows(t)
        distance = frames.compare(t)[0]
        i, j = np.nonzero(distance < cutoff)
        at = np.full(len(i), first + t, dtype=np.int64)
        found.append((frames.truth[left][i], frames.track[right][j], at, distance[i, j] ** p))
    truth, track, time, cost = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.lexsort((time, track, truth))
    return TrajectoryPairs(truth[order], track[order], time[order], cost[order])


_NONE = np.zeros(0, dtype=np.int64)
_NO_PAIRS = TrajectoryPairs(_NONE, _NONE, _NONE, np.zeros(0))
