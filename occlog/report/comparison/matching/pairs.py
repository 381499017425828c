"""Matching of two runs: per-frame pairs, and tracks of the same people.

Both runs are compared at the times of both, from the later start to the earlier end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.metrics.mot.clear_mot import ClearRule, MatchedPairs, match
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_points
from occlog.core.metrics.mot.hota import identity
from occlog.errors import InputError
from occlog.evaluate.matching.paths import ObjectPath as Way
from occlog.records.tables import Tracks


@dataclass(frozen=True, eq=False)
class AlignedEstimates:
    """Estimates of one run in frames that are common to both runs, sorted by frame and identity.

    Attributes:
        frame: (n,) index of the frame.
        row: (n,) row of the run's table: the estimate, or the latest one before an interpolated position.
        xy: (n, 2) positions on the ground.
        label: (n,) identities of the tracks.
    """

    frame: Ints
    row: Ints
    xy: Floats
    label: Ints

    def objects(self) -> Objects:
        """Return frames, identities and positions in the form used by the matching of MOT metrics."""
        return Objects(self.frame, self.label, self.xy)

    def table(self, tracks: Tracks, times: Ints) -> Tracks:
        """Return rows of `tracks` (the run's whole table) for the common frames, with interpolated positions.

        `times`: (T,) of the frames [ns].
        """
        own = tracks.take(self.row)
        return replace(own, t_ns=times[self.frame], x=self.xy[:, 0], y=self.xy[:, 1])


def common_times(a: Tracks, b: Tracks) -> Ints:
    """Return the times (T,) [ns] at which either run has estimates, in the interval that both cover.

    Raises:
        InputError: they have no time in common.
    """
    spans = [(int(each.t_ns[0]), int(each.t_ns[-1])) for each in (a, b)]
    start, end = max(s for s, _ in spans), min(e for _, e in spans)
    if start > end:
        text = " and ".join(f"{s / NS:.3f} s to {e / NS:.3f} s" for s, e in spans)
        raise InputError(
            f"the runs have no time in common: {text}; name two runs of one recording", id="disjoint-inputs"
        )
    times = np.union1d(a.t_ns, b.t_ns)
    found: Ints = times[(times >= start) & (times <= end)]
    return found


def align_estimates(tracks: Tracks, times: Ints) -> AlignedEstimates:
    """Return the estimates of a run at the times of common frames (T,) [ns].

    At times of the run itself its rows are used. At those of the other run positions are interpolated, over gaps up to
    the usual one of the track's rows.
    """
    index = np.searchsorted(times, tracks.t_ns)
    inside = np.minimum(index, len(times) - 1)
    rows = np.flatnonzero((index < len(times)) & (times[inside] == tracks.t_ns))
    frames, positions = [index[rows]], [np.column_stack([tracks.x, tracks.y])[rows]]
    sources, labels = [rows], [tracks.target_id[rows].astype(np.int64)]
    others = np.flatnonzero(~np.isin(times, tracks.t_ns))
    order = np.argsort(tracks.target_id, kind="stable")
    names, first = np.unique(tracks.target_id[order], return_index=True)
    for name, own in zip(names.tolist(), np.split(order, first[1:]), strict=True):
        if not len(others):
            break
        t_ns = tracks.t_ns[own]
        xy, good = Way(t_ns, np.column_stack([tracks.x[own], tracks.y[own]])).at(times[others], None)
        frames.append(others[good])
        positions.append(xy[good])
        sources.append(own[np.searchsorted(t_ns, times[others[good]], side="right") - 1])
        labels.append(np.full(int(good.sum()), name, dtype=np.int64))
    frame, label = np.concatenate(frames), np.concatenate(labels)
    sort = np.lexsort((label, frame))
    return AlignedEstimates(frame[sort], np.concatenate(sources)[sort], np.concatenate(positions)[sort], label[sort])


EACH_FRAME = ClearRule(memory=0)
"""Pairs of each frame alone: as many as can be, then of least total distance."""


@dataclass(frozen=True)
class PersonPair:
    """Tracks of runs A and B that are of one person; one of both may be empty.

    Attributes:
        a, b: identities, the track with the longest time first.
    """

    a: tuple[int, ...]
    b: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class RunPairs:
    """Pairs of estimates of runs A and B: in each frame one to one, by distance.

    Attributes:
        frame: (n,) index of the frame of each pair.
        a, b: (n,) rows of the runs' `AlignedEstimates` in a pair.
        distance: (n,) between both.
        alone_a, alone_b: rows of `AlignedEstimates` without a partner, ascending.
        people: tracks of all people, those in run A first.
    """

    frame: Ints
    a: Ints
    b: Ints
    distance: Floats
    alone_a: Ints
    alone_b: Ints
    people: tuple[PersonPair, ...]


def pairs_of(a: AlignedEstimates, b: AlignedEstimates, near: float) -> RunPairs:
    """Pair the estimates of two runs in each frame, and their tracks over the whole time, without a truth.

    Args:
        a: run A in common frames.
        b: run B.
        near: largest distance of a pair.
    """
    frames = of_points(a.objects(), b.objects(), near)
    found = match(frames, EACH_FRAME)
    rows_a, rows_b = frames.truth_row[found.truth], frames.track_row[found.track]
    given = identity(frames).track
    one_to_one = {
        int(label): int(frames.track_key[track, 1])
        for label, track in zip(frames.truth_key[:, 1], given, strict=True)
        if track >= 0
    }
    return RunPairs(
        frame=frames.frame[found.frame],
        a=rows_a,
        b=rows_b,
        distance=found.distance,
        alone_a=np.flatnonzero(_lacking(len(a.label), rows_a)),
        alone_b=np.flatnonzero(_lacking(len(b.label), rows_b)),
        people=_people(a, b, one_to_one, a.label[rows_a], b.label[rows_b]),
    )


def _lacking(count: int, rows: Ints) -> Bools:
    out = np.ones(count, dtype=np.bool_)
    out[rows] = False
    return out


def _people(
    a: AlignedEstimates, b: AlignedEstimates, one_to_one: dict[int, int], of_a: Ints, of_b: Ints
) -> tuple[PersonPair, ...]:
    """Return the tracks of each person in both runs.

    Tracks are paired one to one over the whole time; each further track belongs to the person of its most frequent
    partner.

    Args:
        a: estimates of run A.
        b: estimates of run B.
        one_to_one: track of B by track of A.
        of_a: (n,) track of A in each per-frame pair.
        of_b: (n,) track of B in each per-frame pair.
    """
    number: dict[tuple[str, int], int] = {}
    for k, label in enumerate(np.unique(a.label).tolist()):
        partner = one_to_one.get(label)
        if partner is not None:
            number["a", label] = number["b", partner] = k
    first = dict(number)
    for run, own, other_run, other, labels in (("a", of_a, "b", of_b, a.label), ("b", of_b, "a", of_a, b.label)):
        for label in np.unique(labels).tolist():
            if (run, label) in first:
                continue
            met, count = np.unique(other[own == label], return_counts=True)
            usual = None if not len(met) else first.get((other_run, int(met[np.argmax(count)])))
            number[run, label] = 1_000_000 + len(number) if usual is None else usual
    lives = {"a": dict(zip(*np.unique(a.label, return_counts=True), strict=True))}
    lives["b"] = dict(zip(*np.unique(b.label, return_counts=True), strict=True))
    people: dict[int, dict[str, list[int]]] = {}
    for (run, label), k in number.items():
        people.setdefault(k, {"a": [], "b": []})[run].append(label)
    out = [
        PersonPair(*(tuple(sorted(own[run], key=lambda n, run=run: (-lives[run][n], n))) for run in ("a", "b")))  # type: ignore[misc]
        for own in people.values()
    ]
    return tuple(sorted(out, key=lambda p: (not p.a, min(p.a or p.b))))


class Piece(NamedTuple):
    """Interval of time in which one track is matched to a person.

    Attributes:
        who: number of the person.
        track: identity of the track.
        start_ns, end_ns: first and last time step [ns].
    """

    who: int
    track: int
    start_ns: int
    end_ns: int


class TrackChange(NamedTuple):
    """Change of the track that is matched to a person.

    Attributes:
        t_ns: time of the first step with the later track [ns].
        who: number of the person.
        before, after: identities of the earlier and the later track.
    """

    t_ns: int
    who: int
    before: int
    after: int


class MatchedRuns(NamedTuple):
    """Tracks matched to each person over time: intervals, and changes between them.

    Attributes:
        pieces: intervals in which one track is matched, sorted by person and time.
        changes: changes of track that are reported, in the order of time.
        passing: number of changes to tracks that are matched too shortly to be reported.
    """

    pieces: tuple[Piece, ...]
    changes: tuple[TrackChange, ...]
    passing: int

    def of(self, who: int) -> tuple[Piece, ...]:
        """Return the intervals in which a track is on the person `who`, by time."""
        return tuple(piece for piece in self.pieces if piece.who == who)


def tracks_by_target(frames: MatchedFrames, made: MatchedPairs, times: Ints, lasting_ns: int) -> MatchedRuns:
    """Intervals in which a run's tracks are matched to each true target, and the changes of track between them.

    Args:
        frames: truth and tracks in the true frames.
        made: pairs of each frame alone.
        times: (T,) of the frames [ns].
        lasting_ns: shorter intervals are only counted [ns].
    """
    who = frames.truth_key[frames.truth[made.truth], 1]
    track = frames.track_key[frames.track[made.track], 1]
    return pieces_of(who, track, frames.frame[made.frame], times, lasting_ns)


def mutual_matches(
    a: AlignedEstimates, b: AlignedEstimates, pairs: RunPairs, times: Ints, lasting_ns: int
) -> tuple[MatchedRuns, MatchedRuns]:
    """Return the intervals of B's tracks matched to each track of A, and vice versa.

    Args:
        a: run A in common frames.
        b: run B.
        pairs: estimates of A and B paired in each frame.
        times: (T,) of the frames [ns].
        lasting_ns: shorter intervals are only counted [ns].
    """
    of_a, of_b = a.label[pairs.a], b.label[pairs.b]
    return (
        pieces_of(of_a, of_b, pairs.frame, times, lasting_ns),
        pieces_of(of_b, of_a, pairs.frame, times, lasting_ns),
    )


def pieces_of(who: Ints, track: Ints, frame: Ints, times: Ints, lasting_ns: int) -> MatchedRuns:
    """Intervals in which each person has one track.

    Interruptions shorter than `lasting_ns` do not end an interval; shorter intervals are skipped, and intervals of the
    same track on both sides of them are joined.

    Args:
        who: (n,) identities of the other side.
        track: (n,) the track of each.
        frame: (n,) number of the frame.
        times: (T,) of the frames [ns].
        lasting_ns: length of the shortest interval, and of the longest interruption [ns].
    """
    if not len(who):
        return MatchedRuns((), (), 0)
    order = np.lexsort((frame, who))
    who, track, frame = who[order], track[order], frame[order]
    step = int(np.median(np.diff(times))) if len(times) > 1 else 0
    t_ns = times[frame]
    starts = np.concatenate([[True], (np.diff(who) != 0) | (np.diff(track) != 0) | (_gap(t_ns, frame) > lasting_ns)])
    first = np.flatnonzero(starts)
    last = np.append(first[1:], len(who)) - 1
    long = t_ns[last] - t_ns[first] + step >= lasting_ns
    pieces: list[Piece] = []
    for i, j in zip(first[long].tolist(), last[long].tolist(), strict=True):
        piece = Piece(int(who[i]), int(track[i]), int(t_ns[i]), int(t_ns[j]))
        before = pieces[-1] if pieces else None
        if before is not None and before[:2] == piece[:2] and piece.start_ns - before.end_ns <= lasting_ns + 2 * step:
            pieces[-1] = before._replace(end_ns=piece.end_ns)
        else:
            pieces.append(piece)
    changes = [
        TrackChange(after.start_ns, after.who, before.track, after.track)
        for before, after in pairwise(pieces)
        if before.who == after.who and before.track != after.track
    ]
    passing = int(np.count_nonzero(_changed(who, track))) - len(changes)
    return MatchedRuns(tuple(pieces), tuple(sorted(changes)), max(passing, 0))


def _gap(t_ns: Ints, frame: Ints) -> Ints:
    """Return the time [ns] (n - 1,) between successive rows if their frames are not adjacent, else 0.

    `t_ns`: (n,) times; `frame`: (n,) frame numbers.
    """
    return np.where(np.diff(frame) > 1, np.diff(t_ns), 0)


def _changed(who: Ints, track: Ints) -> Bools:
    """Return the mask (n - 1,) of rows with another track than the previous row of the same person.

    `who`: (n,) person, `track`: (n,) track of each row; rows of a person follow each other.
    """
    return np.asarray((np.diff(who) == 0) & (np.diff(track) != 0))


def unmatched_changes(own: MatchedRuns, other: MatchedRuns, within_ns: int) -> tuple[TrackChange, ...]:
    """Return the changes of one run without a change of the same person in the other within `within_ns` [ns]."""
    known: dict[int, list[int]] = {}
    for change in other.changes:
        known.setdefault(change.who, []).append(change.t_ns)
    return tuple(c for c in own.changes if all(abs(c.t_ns - t) > within_ns for t in known.get(c.who, [])))
