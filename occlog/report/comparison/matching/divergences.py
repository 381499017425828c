"""Divergences of two runs: first time step of each kind, frequency, and longest sections.

Two runs diverge in a frame in which a person of one has no partner in the other, or partners are farther apart than a
tolerance; and at a time step from which a person has another partner. Also errors of both runs over time: of targets
that both have found, and number of targets that each misses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.mot.clear_mot import MatchedPairs
from occlog.core.metrics.mot.frame_pairs import MatchedFrames

from .pairs import AlignedEstimates, MatchedRuns, RunPairs

MAX_SEGMENTS = 5
"""Longest sections that are reported."""


class RunComparisonStep(NamedTuple):
    """Divergence of two runs, A and B, at one time for one person.

    Attributes:
        t_ns: time [ns].
        a, b: track of the person in each run; None: the run has no track of the person then.
        distance: between both tracks; of a person without a partner, to the nearest track of the other run; NaN: the
            other run has no track then.
    """

    t_ns: int
    a: int | None
    b: int | None
    distance: float


class DivergenceKind(NamedTuple):
    """A kind of divergence of two runs, and how often it occurs.

    Attributes:
        name: name of the kind.
        first: its first time step; None: it does not occur.
        frames: number of frames in which it occurs.
        rows: number of occurrences, of all people.
    """

    name: str
    first: RunComparisonStep | None
    frames: int
    rows: int


class DivergenceSegment(NamedTuple):
    """Consecutive frames in which two runs diverge.

    Attributes:
        start_ns, end_ns: times of the first and the last frame [ns].
        worst: the worst divergence in them.
    """

    start_ns: int
    end_ns: int
    worst: RunComparisonStep


@dataclass(frozen=True, eq=False)
class Divergences:
    """Divergences of two runs, A and B, in T common frames.

    Attributes:
        kinds: partners beyond the tolerance, a person in A only, a person in B only, and changes of partners.
        frames: number of frames T.
        diverged: number of frames with a divergence of the first three kinds.
        segments: the longest sequences of such frames, the longest first.
        farthest: the pair with the largest distance; None: no pair.
        distance: (T,) largest distance of partners in each frame, 0 without any.
        alone: (T,) number of people without a partner in each frame.
    """

    kinds: tuple[DivergenceKind, ...]
    frames: int
    diverged: int
    segments: tuple[DivergenceSegment, ...]
    farthest: RunComparisonStep | None
    distance: Floats
    alone: Ints

    @property
    def first(self) -> tuple[str, RunComparisonStep] | None:
        """Name of the kind, and time step, of the first divergence; None without divergence."""
        found = [(kind.name, kind.first) for kind in self.kinds if kind.first is not None]
        return min(found, key=lambda each: each[1].t_ns, default=None)


TOO_FAR_APART, ONLY_IN_A, ONLY_B, OTHER = "apart", "a alone", "b alone", "another partner"
"""Names of kinds."""


def divergences_of(
    a: AlignedEstimates,
    b: AlignedEstimates,
    pairs: RunPairs,
    times: Ints,
    tolerance: float,
    partners: tuple[MatchedRuns, MatchedRuns],
) -> Divergences:
    """Find the divergences of two runs.

    Args:
        a: estimates of run A in common frames.
        b: estimates of run B.
        pairs: per-frame pairs of both.
        times: (T,) of the frames [ns].
        tolerance: partners that are farther apart than this diverge.
        partners: tracks of B that are matched to each track of A over time, and tracks of A matched to those of B.
    """
    far = np.flatnonzero(pairs.distance > tolerance)
    kinds = (
        _kind(TOO_FAR_APART, pairs.frame[far], lambda k: _of_pair(a, b, pairs, times, int(far[k]))),
        _kind(ONLY_IN_A, a.frame[pairs.alone_a], lambda k: _of_one(a, b, times, int(pairs.alone_a[k]), first=True)),
        _kind(ONLY_B, b.frame[pairs.alone_b], lambda k: _of_one(b, a, times, int(pairs.alone_b[k]), first=False)),
        _exchanges(a, b, pairs, times, partners),
    )
    count = len(times)
    distance = np.zeros(count)
    np.maximum.at(distance, pairs.frame, pairs.distance)
    alone = np.bincount(a.frame[pairs.alone_a], minlength=count) + np.bincount(b.frame[pairs.alone_b], minlength=count)
    diverged = (distance > tolerance) | (alone > 0)
    farthest = None if not len(pairs.distance) else _of_pair(a, b, pairs, times, int(np.argmax(pairs.distance)))
    segments = tuple(_segment(a, b, pairs, times, each) for each in _longest(diverged, times))
    return Divergences(kinds, count, int(diverged.sum()), segments, farthest, distance, alone)


def _kind(name: str, frames: Ints, step_at: Callable[[int], RunComparisonStep]) -> DivergenceKind:
    """Return the divergence of one kind from its occurrences.

    Args:
        name: name of the kind of divergence.
        frames: (n,) frame of each occurrence.
        step_at: makes the time step of the occurrence with an index below n.
    """
    if not len(frames):
        return DivergenceKind(name, None, 0, 0)
    return DivergenceKind(name, step_at(int(np.argmin(frames))), len(np.unique(frames)), len(frames))


def _exchanges(
    a: AlignedEstimates, b: AlignedEstimates, pairs: RunPairs, times: Ints, partners: tuple[MatchedRuns, MatchedRuns]
) -> DivergenceKind:
    """Return the divergence by times from which a track has another partner in the other run.

    Args:
        a: estimates of run A.
        b: estimates of run B.
        pairs: estimates of the two runs paired in each frame.
        times: (T,) of the frames [ns].
        partners: partners over time of the tracks of A, and of those of B.
    """
    found = [(change.t_ns, change.who, change.after) for change in partners[0].changes]
    found += [(change.t_ns, change.after, change.who) for change in partners[1].changes]
    if not found:
        return DivergenceKind(OTHER, None, 0, 0)
    first = min(found)
    its = (times[pairs.frame] == first[0]) & (a.label[pairs.a] == first[1]) & (b.label[pairs.b] == first[2])
    row = _of_pair(a, b, pairs, times, int(np.argmax(its)))
    return DivergenceKind(OTHER, row, len({t_ns for t_ns, _, _ in found}), sum(len(each.changes) for each in partners))


def _of_pair(a: AlignedEstimates, b: AlignedEstimates, pairs: RunPairs, times: Ints, k: int) -> RunComparisonStep:
    own, other = int(pairs.a[k]), int(pairs.b[k])
    return RunComparisonStep(
        int(times[pairs.frame[k]]), int(a.label[own]), int(b.label[other]), float(pairs.distance[k])
    )


def _of_one(own: AlignedEstimates, other: AlignedEstimates, times: Ints, row: int, *, first: bool) -> RunComparisonStep:
    """Return the time step of a person without a partner, with the distance to the nearest person of the other run.

    Args:
        own: estimates of the person's run.
        other: estimates of the other run.
        times: (T,) of the frames [ns].
        row: row of the person's estimate in `own`.
        first: whether `own` is run A.
    """
    frame, label = int(own.frame[row]), int(own.label[row])
    at = slice(*np.searchsorted(other.frame, [frame, frame + 1]))
    away = np.hypot(*(other.xy[at] - own.xy[row]).T)
    nearest = float(away.min()) if len(away) else float("nan")
    return RunComparisonStep(int(times[frame]), label if first else None, None if first else label, nearest)


def _longest(diverged: Bools, times: Ints) -> list[tuple[int, int]]:
    """Return first and last frame of the longest sequences of frames with divergence, longest first.

    At most `MAX_SEGMENTS` are returned.

    Args:
        diverged: (T,) mask of frames with a divergence.
        times: (T,) of the frames [ns].
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], diverged, [False]]).astype(np.int8)))
    found = list(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))
    found.sort(key=lambda each: (int(times[each[0]] - times[each[1]]), each[0]))
    return found[:MAX_SEGMENTS]


def _segment(
    a: AlignedEstimates, b: AlignedEstimates, pairs: RunPairs, times: Ints, frames: tuple[int, int]
) -> DivergenceSegment:
    """Return a sequence of diverged frames with its worst time step.

    That is the first person without a partner, or else the largest distance of partners.

    Args:
        a: estimates of run A.
        b: estimates of run B.
        pairs: estimates of the two runs paired in each frame.
        times: (T,) of the frames [ns].
        frames: first and last frame of the sequence.
    """
    inside = np.flatnonzero((pairs.frame >= frames[0]) & (pairs.frame <= frames[1]))
    lone = [
        _of_one(own, other, times, int(rows[0]), first=is_a)
        for own, other, alone, is_a in ((a, b, pairs.alone_a, True), (b, a, pairs.alone_b, False))
        if len(rows := alone[(own.frame[alone] >= frames[0]) & (own.frame[alone] <= frames[1])])
    ]
    ends = int(times[frames[0]]), int(times[frames[1]])
    if lone:
        return DivergenceSegment(*ends, min(lone, key=lambda each: each.t_ns))
    worst = int(inside[np.argmax(pairs.distance[inside])])
    return DivergenceSegment(*ends, _of_pair(a, b, pairs, times, worst))


Paired = tuple[MatchedFrames, MatchedPairs]


@dataclass(frozen=True, eq=False)
class ErrorsOverTime:
    """Errors of two runs, A and B, at the T times of the truth.

    Attributes:
        t_ns: (T,) times [ns].
        a, b: (T,) root mean square distance from the truth, over the targets that both runs have found; NaN without
            any.
        missed_a, missed_b: (T,) number of targets that a run has not found.
        false_a, false_b: (T,) number of tracks of a run that are on no target.
        objects: number of true targets, summed over all frames.
    """

    t_ns: Ints
    a: Floats
    b: Floats
    missed_a: Ints
    missed_b: Ints
    false_a: Ints
    false_b: Ints
    objects: int

    @property
    def on_unmatched(self) -> tuple[bool, bool]:
        """Whether each run, A and B, has tracks, but none of them is ever on a target."""
        return self._mostly_unmatched(self.missed_a, self.false_a), self._mostly_unmatched(self.missed_b, self.false_b)

    def _mostly_unmatched(self, missed: Ints, false: Ints) -> bool:
        return bool(false.any()) and int(missed.sum()) == self.objects

    @property
    def both(self) -> int:
        """Number of frames with a target that both runs have found."""
        return int(np.isfinite(self.a).sum())


def over_time(a: Paired, b: Paired, t_ns: Ints) -> ErrorsOverTime:
    """Return the errors of two runs over time, from per-frame pairs with the same truth, as in `matched_rmse`.

    Args:
        a: truth and tracks of run A, and their pairs of each frame.
        b: truth and tracks of run B, and their pairs.
        t_ns: (T,) times of the true frames [ns].
    """
    cells, found, missed, false = len(t_ns), [], [], []
    for frames, made in (a, b):
        at = frames.frame[made.frame]
        paired = np.bincount(at, minlength=cells)
        true = np.bincount(np.repeat(frames.frame, np.diff(frames.truth_start)), minlength=cells)
        tracks = np.bincount(np.repeat(frames.frame, np.diff(frames.track_start)), minlength=cells)
        missed.append(true - paired)
        false.append(tracks - paired)
        found.append((at, frames.truth_key[frames.truth[made.truth], 1], made.distance))
    # One number for each frame and target: rows of both runs
    labels = np.unique(np.concatenate([found[0][1], found[1][1]]))
    keys = [at * len(labels) + np.searchsorted(labels, who) for at, who, _ in found]
    both, in_a, in_b = np.intersect1d(*keys, return_indices=True)
    frame = both // max(len(labels), 1)
    count = np.bincount(frame, minlength=cells)
    errors = []
    for (_, _, distance), rows in zip(found, (in_a, in_b), strict=True):
        squares = np.bincount(frame, distance[rows] ** 2, cells)
        with np.errstate(divide="ignore", invalid="ignore"):
            errors.append(np.sqrt(np.where(count > 0, squares / count, np.nan)))
    return ErrorsOverTime(t_ns, errors[0], errors[1], missed[0], missed[1], false[0], false[1], len(a[0].truth))
