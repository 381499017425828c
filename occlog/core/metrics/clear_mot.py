"""CLEAR-MOT: misses, false positives, identity switches and what follows from them.

Bernardin and Stiefelhagen 2008, "Evaluating multiple object tracking performance: the CLEAR MOT
metrics".  Programs differ in how they pair targets and tracks in a frame; `ClearRule` says how.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Bools, Floats, Ints

from .errors import pair_within, ratio
from .frame_pairs import Frames, reaches

MOSTLY_TRACKED = 0.8
MOSTLY_LOST = 0.2


class ClearRule(NamedTuple):
    """How targets and tracks are paired in a frame.

    A target first keeps the track that it had last, if that one still is similar enough (of two
    targets that had the same one, that of the lower label); the rest is assigned anew.

    Attributes:
        threshold: least similarity of a pair.
        memory: number of frames, back from this one, in which a pair must have been made to be kept.
        most: true: as many pairs as can be, then of least total distance; false: of largest total similarity.
    """

    threshold: float = 0.5
    memory: float = math.inf
    most: bool = True


CLASSIC = ClearRule()
"""Pairs are remembered for ever, as in the paper and in py-motmetrics."""

CHALLENGE = ClearRule(memory=1, most=False)
"""Pairs are remembered from the frame before only, as in the MOTChallenge and in TrackEval."""


class Matches(NamedTuple):
    """The pairs that were made, in order of frames.

    Attributes:
        frame: (n,) place of the frame in `Frames`.
        truth: (n,) true row in `Frames`.
        track: (n,) track row in `Frames`.
        distance: (n,) of the pair.
        similarity: (n,) of the pair.
        switch: (n,) true: the target had another track when it was paired last.
    """

    frame: Ints
    truth: Ints
    track: Ints
    distance: Floats
    similarity: Floats
    switch: Bools


class ClearMot(NamedTuple):
    """Counts and rates; rates are NaN where nothing is there to divide by.

    Attributes:
        objects: number of true rows.
        estimates: number of track rows.
        tp: rows paired, switches included.
        fp: track rows not paired.
        fn: true rows not paired.
        switches: pairs of a target with another track than it had last.
        fragmentations: times that a target, over the frames it is in, is tracked again after a gap.
        mota: 1 - (fn + fp + switches) / objects.
        motp: mean distance of the pairs (1 - IoU, or length).
        motp_similarity: mean similarity of the pairs, which TrackEval calls MOTP.
        recall: tp / objects.
        precision: tp / estimates.
        mostly_tracked: targets paired in at least 80 % of their frames (TrackEval: in more than that).
        partly_tracked: the other ones.
        mostly_lost: targets paired in less than 20 % of their frames.
        tracked: (G,) share of each target's frames in which it is paired.
    """

    objects: int
    estimates: int
    tp: int
    fp: int
    fn: int
    switches: int
    fragmentations: int
    mota: float
    motp: float
    motp_similarity: float
    recall: float
    precision: float
    mostly_tracked: int
    partly_tracked: int
    mostly_lost: int
    tracked: Floats


def match(frames: Frames, rule: ClearRule = CLASSIC) -> Matches:
    """Pair targets and tracks one to one in each frame, in order of frames.

    Args:
        frames: truth and tracks.
        rule: how they are paired.
    """
    held = np.full(len(frames.truth_key), -1, dtype=np.int64)
    when = np.zeros(len(frames.truth_key), dtype=np.int64)
    parts: list[Matches] = []
    for t in frames.meeting():
        left, right = frames.rows(t)
        truth, track = frames.truth[left], frames.track[right]
        distance, similarity = frames.compare(t)
        # Keep: the track that each target had last, if it is remembered and still similar enough
        last = np.where(frames.frame[t] - when[truth] <= rule.memory, held[truth], -1)
        kept = last[:, None] == track[None, :]
        allowed = reaches(similarity, rule.threshold)
        # Assign the rest
        i, j = _pair(allowed, distance if rule.most else similarity, kept, rule.most)
        # Identity switch: a track other than that of the target's last pair
        paired, now = truth[i], track[j]
        switch = (held[paired] >= 0) & (held[paired] != now)
        held[paired], when[paired] = now, frames.frame[t]
        at = np.full(len(i), t, dtype=np.int64)
        parts.append(Matches(at, left.start + i, right.start + j, distance[i, j], similarity[i, j], switch))
    none, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
    parts.append(Matches(none, none, none, nothing, nothing, np.zeros(0, dtype=np.bool_)))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Matches(*columns)


def clear_mot(frames: Frames, rule: ClearRule = CLASSIC, matches: Matches | None = None) -> ClearMot:
    """Compute the CLEAR-MOT figures of tracks.

    Args:
        frames: truth and tracks.
        rule: how they are paired.
        matches: what `match` gave for the same frames and rule; None: it is called.
    """
    made = match(frames, rule) if matches is None else matches
    n, m, tp, switches = len(frames.truth), len(frames.track), len(made.truth), int(np.count_nonzero(made.switch))
    paired = np.zeros(n, dtype=np.bool_)
    paired[made.truth] = True
    # Share of each target's frames in which it is paired
    life = np.bincount(frames.truth, minlength=len(frames.truth_key))
    tracked = np.bincount(frames.truth[made.truth], minlength=len(life)) / life
    most, lost = int(np.sum(tracked >= MOSTLY_TRACKED)), int(np.sum(tracked < MOSTLY_LOST))
    return ClearMot(
        objects=n,
        estimates=m,
        tp=tp,
        fp=m - tp,
        fn=n - tp,
        switches=switches,
        fragmentations=_fragmentations(frames.truth, paired),
        mota=1.0 - ratio(m - tp + n - tp + switches, n),
        motp=ratio(float(np.sum(made.distance)), tp),
        motp_similarity=ratio(float(np.sum(made.similarity)), tp),
        recall=ratio(tp, n),
        precision=ratio(tp, m),
        mostly_tracked=most,
        partly_tracked=len(life) - most - lost,
        mostly_lost=lost,
        tracked=tracked,
    )


def _pair(allowed: Bools, values: Floats, kept: Bools, most: bool) -> tuple[Ints, Ints]:
    """Rows and columns of the pairs of one frame, rows rising.

    Args:
        allowed: (n, m) pairs that are similar enough.
        values: (n, m) distances, or similarities where not `most`.
        kept: (n, m) pairs of each target with the track that it had last.
        most: see `ClearRule`.
    """
    kept = kept & allowed
    columns = np.flatnonzero(kept.any(axis=0))
    rows = np.argmax(kept[:, columns], axis=0) if len(columns) else columns
    # Targets and tracks that keep their partner are left out of the assignment of the rest.
    free = allowed.copy()
    free[rows, :], free[:, columns] = False, False
    left, right = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    if len(left):
        inner, among = free[left[:, None], right[None, :]], values[left[:, None], right[None, :]]
        # With one candidate each there is nothing to choose.
        alone = np.count_nonzero(inner) == len(left) == len(right)
        i, j = np.nonzero(inner) if alone else _assign(inner, among, most)
        rows, columns = np.concatenate([rows, left[i]]), np.concatenate([columns, right[j]])
    order = np.argsort(rows)
    return rows[order].astype(np.int64), columns[order].astype(np.int64)


def _assign(allowed: Bools, values: Floats, most: bool) -> tuple[Ints, Ints]:
    if most:
        pairs = pair_within(np.where(allowed, values, np.inf), float(np.finfo(np.float64).max))
        chosen = np.array(pairs, dtype=np.int64)
        return chosen[:, 0], chosen[:, 1]
    i, j = linear_sum_assignment(np.where(allowed, values, 0.0), maximize=True)
    good = allowed[i, j]
    return i[good].astype(np.int64), j[good].astype(np.int64)


def _fragmentations(target: Ints, paired: Bools) -> int:
    """Number of stretches in which targets are paired, without the first one of each target."""
    order = np.argsort(target, kind="stable")
    who, there = target[order], paired[order]
    starts = there.copy()
    starts[1:] &= ~(there[:-1] & (who[1:] == who[:-1]))
    stretches = np.bincount(who[starts])
    return int(np.sum(stretches[stretches > 0] - 1))
