"""Trajectory GOSPA: one distance between the true trajectories and the tracks, with a price for every change of track.

Garcia-Fernandez, Rahmathullah and Svensson 2020, "A metric on the space of finite sets of trajectories for evaluation
of multi-target tracking algorithms", IEEE Trans. Signal Processing 68; its relaxation as a linear program, which is a
metric, too, and equal to the combinatorial form where the program's solution is whole numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array

from occlog.array_types import Floats, Ints

from .frame_pairs import Frames
from .trajectory_cuts import OPEN, Pairs, Pieces, pieces_of, sure_stretches


class TrajectoryGospa(NamedTuple):
    """The metric to the power of p, summed over all frames, and its parts, which add up to it; unit^p each.

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


class _Program(NamedTuple):
    """Unknowns of one piece after another, in the order of time.

    Each is the weight of the pair in a frame in which the two meet, or over a stretch of other frames.
    """

    piece: Ints  # (n,) place of the piece among those that are solved together
    start: Ints  # (n,) first frame
    meets: Ints  # (n,) row of `Pairs`; -1: a stretch


def trajectory_gospa(frames: Frames, cutoff: float, switch: float, p: float = 2.0) -> TrajectoryGospa:
    """Compute trajectory GOSPA of all frames.

    With W_t(i, j) >= 0 the weight with which target i has track j in frame t, sums over j and over i at most 1, it is
    the minimum over W of

        sum over t of [sum over pairs of W_t(i, j) min(d, c)^p + c^p / 2 (weight of targets without a track + weight of
        tracks without a target)] + gamma^p / 2 sum over t, i, j of |W_t+1(i, j) - W_t(i, j)|.

    Pairs that never are nearer than c have no weight.  In frames in which a pair is not nearer than c its weight
    neither costs nor saves anything but the change, so that one unknown serves a whole stretch of them: the weight that
    is least anywhere in it leaves most to others and changes no more.  Pairs that share no target and no track, not
    even by way of others, are solved apart.

    Args:
        frames: truth and tracks.
        cutoff: largest distance that counts, c > 0, unit of the distance.
        switch: price of a change of track, gamma > 0, unit of the distance.
        p: exponent, >= 1.

    Raises:
        ValueError: an option is outside its range.
        RuntimeError: the linear program has no solution, which cannot be.
    """
    if not (0 < cutoff < np.inf and 0 < switch < np.inf and 1 <= p < np.inf):
        raise ValueError(f"cutoff {cutoff:g} and switch {switch:g} must be above 0, p {p:g} at least 1")
    pairs = meetings(frames, cutoff, p)
    sure = sure_stretches(pairs, cutoff**p, switch**p)
    pieces, changes = pieces_of(pairs, sure, len(frames.frame))
    weights = np.ones(len(pairs.time))
    for block in pieces.blocks():
        part = Pieces._make(column[block] for column in pieces)
        if len(block) > 1 or 0 in (part.before[0], part.behind[0]):  # otherwise they belong together all the time
            changes += _solve(pairs, part, cutoff**p, switch**p, weights)
    half, n, m = 0.5 * cutoff**p, len(frames.truth), len(frames.track)
    parts = (
        float(weights @ pairs.cost),
        half * (n - float(weights.sum())),
        half * (m - float(weights.sum())),
        0.5 * switch**p * changes,
    )
    return TrajectoryGospa(sum(parts), *parts, p)


def meetings(frames: Frames, cutoff: float, p: float) -> Pairs:
    """Rows that are nearer than the cutoff."""
    none = np.zeros(0, dtype=np.int64)
    found = [(none, none, none, np.zeros(0))]
    for t in frames.meeting():
        left, right = frames.rows(t)
        distance = frames.compare(t)[0]
        i, j = np.nonzero(distance < cutoff)
        at = np.full(len(i), t, dtype=np.int64)
        found.append((frames.truth[left][i], frames.track[right][j], at, distance[i, j] ** p))
    truth, track, time, cost = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.lexsort((time, track, truth))
    return Pairs(truth[order], track[order], time[order], cost[order])


def _unknowns(pairs: Pairs, pieces: Pieces) -> _Program:
    """The unknowns of pieces that are solved together."""
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


def _solve(pairs: Pairs, pieces: Pieces, most: float, switch: float, weights: Floats) -> float:
    """Put in the weights of the meetings, and give the sum of all changes; `most` is c^p, `switch` gamma^p."""
    program = _unknowns(pairs, pieces)
    n = len(program.piece)
    meets = program.meets >= 0
    gain = np.zeros(n)
    gain[meets] = pairs.cost[program.meets[meets]] - most
    # Changes: weight after minus weight before = rise - fall, both >= 0 and paid alike; at the ends of a piece one of
    # the two weights is known
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
    price = np.concatenate([gain, np.full(2 * last, 0.5 * switch)])
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


def _capacity(program: _Program, pieces: Pieces) -> csr_array:
    """(R, n) rows of ones: weights of a target, or of a track, in one frame, which add up to at most 1."""
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
