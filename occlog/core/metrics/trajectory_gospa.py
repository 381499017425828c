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
from scipy.sparse.csgraph import connected_components

from occlog.array_types import Floats, Ints

from .frame_pairs import Frames


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


class _Pairs(NamedTuple):
    """Rows of targets and tracks that meet, sorted by pair, then by time."""

    truth: Ints  # target
    track: Ints
    time: Ints  # place of the frame in `Frames`
    cost: Floats  # distance^p, below c^p


class _Program(NamedTuple):
    """Unknowns of one pair after another, in the order of time.

    Each is the weight of the pair in a frame in which the two meet, or over a stretch of other frames.
    """

    pair: Ints  # (n,) number of the pair
    start: Ints  # (n,) first frame
    meets: Ints  # (n,) row of `_Pairs`; -1: a stretch
    truth: Ints  # (P,) target of each pair
    track: Ints  # (P,) track of each pair


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
    pairs = _meetings(frames, cutoff, p)
    weights, changes = np.ones(len(pairs.time)), 0.0
    for rows, alone in _components(pairs, len(frames.truth_key)):
        if not alone:  # one target and one track: they belong together all the time
            part = _Pairs._make(column[rows] for column in pairs)
            weights[rows], change = _solve(part, cutoff**p, switch**p, len(frames.frame))
            changes += change
    half, n, m = 0.5 * cutoff**p, len(frames.truth), len(frames.track)
    parts = (
        float(weights @ pairs.cost),
        half * (n - float(weights.sum())),
        half * (m - float(weights.sum())),
        0.5 * switch**p * changes,
    )
    return TrajectoryGospa(sum(parts), *parts, p)


def _meetings(frames: Frames, cutoff: float, p: float) -> _Pairs:
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
    return _Pairs(truth[order], track[order], time[order], cost[order])


def _components(pairs: _Pairs, targets: int) -> list[tuple[Ints, bool]]:
    """Rows of the pairs that have to be solved together, and whether they are all of one pair."""
    if not len(pairs.time):
        return []
    tracks = int(pairs.track.max()) + 1
    edges = coo_array((np.ones(len(pairs.time)), (pairs.truth, targets + pairs.track)), shape=(targets + tracks,) * 2)
    label = connected_components(edges, directed=False)[1][pairs.truth]
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    one = [len(np.unique(pairs.truth[g])) == len(np.unique(pairs.track[g])) == 1 for g in groups]
    return list(zip(groups, one, strict=True))


def _unknowns(pairs: _Pairs, frames: int) -> _Program:
    """The unknowns of pairs that are solved together."""
    code = pairs.truth * (int(pairs.track.max()) + 1) + pairs.track
    first = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1])
    found: list[tuple[int, int, int]] = []
    for number, rows in enumerate(np.split(np.arange(len(code)), first[1:])):
        free = 0  # first frame that no unknown of this pair covers yet
        for row in rows.tolist():
            at = int(pairs.time[row])
            if at > free:
                found.append((number, free, -1))
            found.append((number, at, row))
            free = at + 1
        if free < frames:
            found.append((number, free, -1))
    pair, start, meets = np.array(found, dtype=np.int64).T
    return _Program(pair, start, meets, pairs.truth[first], pairs.track[first])


def _solve(pairs: _Pairs, most: float, switch: float, frames: int) -> tuple[Floats, float]:
    """Weights of the meetings, and the sum of all changes of weights; `most` is c^p, `switch` gamma^p."""
    program = _unknowns(pairs, frames)
    n = len(program.pair)
    meets = program.meets >= 0
    gain = np.zeros(n)
    gain[meets] = pairs.cost[program.meets[meets]] - most
    # Changes: weight after minus weight before = rise - fall, both >= 0 and paid alike
    after = np.flatnonzero(program.pair[1:] == program.pair[:-1]) + 1
    k, one = np.arange(len(after)), np.ones(len(after))
    change = coo_array(
        (
            np.concatenate([one, -one, -one, one]),
            (np.tile(k, 4), np.concatenate([after, after - 1, n + k, n + len(after) + k])),
        ),
        shape=(len(after), n + 2 * len(after)),
    )
    shared = _capacity(program)
    limit = csr_array((shared.data, shared.indices, shared.indptr), shape=(shared.shape[0], n + 2 * len(after)))
    price = np.concatenate([gain, np.full(2 * len(after), 0.5 * switch)])
    found = linprog(  # type: ignore[call-overload]  # the stubs know no sparse matrices
        price,
        A_ub=limit,
        b_ub=np.ones(limit.shape[0]),
        A_eq=change.tocsr(),
        b_eq=np.zeros(len(after)),
        bounds=(0.0, None),
        method="highs",
    )
    if found.x is None:
        raise RuntimeError(f"trajectory GOSPA: {found.message}")
    weights = np.zeros(len(pairs.time))
    weights[program.meets[meets]] = np.clip(found.x[:n][meets], 0.0, 1.0)
    return weights, float(found.x[n:].sum())


def _capacity(program: _Program) -> csr_array:
    """(R, n) rows of ones: weights of a target, or of a track, in one frame, which add up to at most 1."""
    rows: list[Ints] = []
    begins = np.searchsorted(program.pair, np.arange(len(program.truth) + 1))
    for side in (program.truth, program.track):
        for key in np.unique(side).tolist():
            own = np.flatnonzero(side == key)
            spans = [program.start[begins[k] : begins[k + 1]] for k in own.tolist()]
            # The unknowns change at the beginning of one of them only
            times = np.unique(np.concatenate(spans))
            at = [
                np.searchsorted(s, times, side="right") - 1 + begins[k]
                for s, k in zip(spans, own.tolist(), strict=True)
            ]
            rows += list(np.unique(np.column_stack(at), axis=0))
    sizes = np.array([len(row) for row in rows], dtype=np.int64)
    columns = np.concatenate(rows)
    pointers = np.concatenate([[0], np.cumsum(sizes)])
    return csr_array((np.ones(len(columns)), columns, pointers), shape=(len(rows), len(program.pair)))
