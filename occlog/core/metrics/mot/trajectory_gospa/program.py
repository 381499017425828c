"""The linear program of trajectory GOSPA for pieces of time that have to be solved together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array, csr_array

from occlog.array_types import Floats, Ints
from occlog.core.metrics.mot.trajectory_gospa.cuts import OPEN, Pairs, Pieces


class _Program(NamedTuple):
    """Unknowns of one piece after another, in the order of time.

    Each is the weight of the pair in a frame in which the two meet, or over a stretch of other frames.
    """

    piece: Ints  # (n,) place of the piece among those that are solved together
    start: Ints  # (n,) first frame
    meets: Ints  # (n,) row of `Pairs`; -1: a stretch


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


def solve(pairs: Pairs, pieces: Pieces, most: float, switch: float, weights: Floats) -> float:
    """Put in the weights of the meetings, and give the sum of all changes.

    Args:
        pairs: rows that meet.
        pieces: that share targets or tracks.
        most: c^p.
        switch: gamma^p.
        weights: (n,) of all rows, in which those of the pieces are put.

    Raises:
        RuntimeError: the linear program has no solution, which cannot be.
    """
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
