"""CLEAR-MOT: misses, false positives, identity switches and what follows from them.

Bernardin and Stiefelhagen 2008, "Evaluating multiple object tracking performance: the CLEAR MOT
metrics".  Programs differ in how they pair targets and tracks in a frame; `ClearRule` states how.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Bools, Floats, Ints

from ..errors import Sum, pair_within, ratio_or_nan
from .frame_pairs import MatchedFrames, reaches

MOSTLY_TRACKED = 0.8
MOSTLY_LOST = 0.2


class ClearRule(NamedTuple):
    """Rule by which targets and tracks are paired in a frame.

    A target first keeps its last track, if this is still similar enough (of two targets with the same last track, the
    one with the lower label); the others are assigned in each frame.

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


class MatchedPairs(NamedTuple):
    """Pairs of targets and tracks, sorted by frame, with distance, similarity and whether the target changed its track.

    Attributes:
        frame: (n,) position of the frame in `MatchedFrames`.
        truth: (n,) true row in `MatchedFrames`.
        track: (n,) track row in `MatchedFrames`.
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
    """CLEAR-MOT counts and rates; rates are NaN if the divisor is 0.

    Attributes:
        objects: number of true rows.
        estimates: number of track rows.
        tp: rows paired, switches included.
        fp: track rows not paired.
        fn: true rows not paired.
        switches: identity switches: pairs of a target with another track than its last one.
        fragmentations: times that a target, over the frames it is in, is tracked again after a gap: segments of frames
            in which it is paired, without the first one of each target.
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


class Matcher:
    """Pairs targets and tracks one to one in each frame, by a `ClearRule`, over parts of a recording in order."""

    def __init__(self, targets: int, rule: ClearRule = CLASSIC) -> None:
        """Start without frames.

        Args:
            targets: number of all targets.
            rule: rule of pairing.
        """
        self._rule = rule
        self._held = np.full(targets, -1, dtype=np.int64)
        self._when = np.zeros(targets, dtype=np.int64)

    def update(self, frames: MatchedFrames) -> MatchedPairs:
        """Return the pairs of further frames.

        Target and track numbers are the same in all parts; rows and frames of the pairs are positions in `frames`.
        """
        rule, held, when = self._rule, self._held, self._when
        parts: list[MatchedPairs] = []
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
            parts.append(MatchedPairs(at, left.start + i, right.start + j, distance[i, j], similarity[i, j], switch))
        none, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
        parts.append(MatchedPairs(none, none, none, nothing, nothing, np.zeros(0, dtype=np.bool_)))
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        return MatchedPairs(*columns)


def match(frames: MatchedFrames, rule: ClearRule = CLASSIC) -> MatchedPairs:
    """Return one-to-one pairs of targets and tracks in each frame, by the rule of CLEAR-MOT.

    Args:
        frames: truth and tracks.
        rule: rule of pairing.
    """
    return Matcher(len(frames.truth_key), rule).update(frames)


class ClearCounts:
    """CLEAR-MOT counts (rows, pairs, switches, segments) and sums of distances, accumulated in the order of time."""

    def __init__(self, targets: int) -> None:
        """Start without frames; `targets` is the number of all targets."""
        self._objects = self._estimates = self._tp = self._switches = 0
        self._distance, self._similarity = Sum(), Sum()
        self._life, self._paired, self._segments = np.zeros((3, targets), dtype=np.int64)
        self._goes_on = np.zeros(targets, dtype=np.bool_)  # the target was paired when it was there last

    def update(self, frames: MatchedFrames, made: MatchedPairs) -> None:
        """Add the counts of frames.

        Args:
            frames: truth and tracks; target numbers are the same in all parts.
            made: pairs of these frames.
        """
        size = len(self._life)
        self._objects, self._estimates = self._objects + len(frames.truth), self._estimates + len(frames.track)
        self._tp, self._switches = self._tp + len(made.truth), self._switches + int(np.count_nonzero(made.switch))
        self._distance.add(float(np.sum(made.distance)))
        self._similarity.add(float(np.sum(made.similarity)))
        self._life += np.bincount(frames.truth, minlength=size)
        self._paired += np.bincount(frames.truth[made.truth], minlength=size)
        # Segments of frames of a target in which it is paired
        paired = np.zeros(len(frames.truth), dtype=np.bool_)
        paired[made.truth] = True
        order = np.argsort(frames.truth, kind="stable")
        who, there = frames.truth[order], paired[order]
        same = np.append(False, who[1:] == who[:-1])[: len(who)]
        before = np.where(same, np.append(False, there[:-1])[: len(who)], self._goes_on[who])
        self._segments += np.bincount(who[there & ~before], minlength=size)
        last = np.append(~same[1:], True)[: len(who)]
        self._goes_on[who[last]] = there[last]

    def merge(self, other: ClearCounts) -> None:
        """Add another recording, with its targets numbered after these; no frame may be added afterwards."""
        self._objects, self._estimates = self._objects + other._objects, self._estimates + other._estimates
        self._tp, self._switches = self._tp + other._tp, self._switches + other._switches
        self._distance.merge(other._distance)
        self._similarity.merge(other._similarity)
        self._life = np.concatenate([self._life, other._life])
        self._paired = np.concatenate([self._paired, other._paired])
        self._segments = np.concatenate([self._segments, other._segments])

    def result(self) -> ClearMot:
        """Return the CLEAR-MOT figures over all frames added."""
        n, m, tp = self._objects, self._estimates, self._tp
        known = self._life > 0
        # Share of each target's frames in which it is paired
        tracked = self._paired[known] / self._life[known]
        most, lost = int(np.sum(tracked >= MOSTLY_TRACKED)), int(np.sum(tracked < MOSTLY_LOST))
        return ClearMot(
            objects=n,
            estimates=m,
            tp=tp,
            fp=m - tp,
            fn=n - tp,
            switches=self._switches,
            fragmentations=int(np.sum(self._segments[self._segments > 0] - 1)),
            mota=1.0 - ratio_or_nan(m - tp + n - tp + self._switches, n),
            motp=ratio_or_nan(self._distance.value, tp),
            motp_similarity=ratio_or_nan(self._similarity.value, tp),
            recall=ratio_or_nan(tp, n),
            precision=ratio_or_nan(tp, m),
            mostly_tracked=most,
            partly_tracked=len(tracked) - most - lost,
            mostly_lost=lost,
            tracked=tracked,
        )


def clear_mot(frames: MatchedFrames, rule: ClearRule = CLASSIC, matches: MatchedPairs | None = None) -> ClearMot:
    """Return the CLEAR-MOT figures of tracks.

    Args:
        frames: truth and tracks.
        rule: rule of pairing.
        matches: pairs of `frames` by this rule, as `match` returns them; None: they are computed.
    """
    counts = ClearCounts(len(frames.truth_key))
    counts.update(frames, match(frames, rule) if matches is None else matches)
    return counts.result()


def _pair(allowed: Bools, values: Floats, kept: Bools, most: bool) -> tuple[Ints, Ints]:
    """Return rows (k,) and columns (k,) of the pairs of one frame, sorted by row: first kept pairs, then assigned ones.

    Args:
        allowed: (n, m) pairs that are similar enough.
        values: (n, m) distances, or similarities if not `most`.
        kept: (n, m) pairs of each target with the track that it had last.
        most: True: as many pairs as possible, then least total distance; False: largest total similarity.
    """
    kept = kept & allowed
    columns = np.flatnonzero(kept.any(axis=0))
    rows = np.argmax(kept[:, columns], axis=0) if len(columns) else columns
    # Targets and tracks that keep their partner are excluded from the assignment of the rest.
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
    """Return rows (k,) and columns (k,) of a one-to-one assignment among the allowed pairs.

    Args:
        allowed: (n, m) pairs that are similar enough.
        values: (n, m) distances, or similarities if not `most`.
        most: True: as many pairs as possible, then least total distance; False: largest total similarity.
    """
    if most:
        pairs = pair_within(np.where(allowed, values, np.inf), float(np.finfo(np.float64).max))
        chosen = np.array(pairs, dtype=np.int64)
        return chosen[:, 0], chosen[:, 1]
    i, j = linear_sum_assignment(np.where(allowed, values, 0.0), maximize=True)
    good = allowed[i, j]
    return i[good].astype(np.int64), j[good].astype(np.int64)
