"""Which tracks follow a person over time, and when one track takes the place of another."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Ints
from occlog.core.metrics.mot.clear_mot import Matches
from occlog.core.metrics.mot.frame_pairs import Frames

from .frames import Laid
from .pairs import Pairs


class Piece(NamedTuple):
    """A stretch of time in which one track follows somebody: first and last moment [ns]."""

    who: int
    track: int
    start_ns: int
    end_ns: int


class Change(NamedTuple):
    """Somebody is followed by another track from a moment on."""

    t_ns: int
    who: int
    before: int
    after: int


class Followed(NamedTuple):
    """Everybody's pieces and changes.

    Attributes:
        pieces: in the order of `who` and time.
        changes: in the order of time.
        passing: changes of track that last less than is told, and are left out of pieces.
    """

    pieces: tuple[Piece, ...]
    changes: tuple[Change, ...]
    passing: int

    def of(self, who: int) -> tuple[Piece, ...]:
        """The pieces of one."""
        return tuple(piece for piece in self.pieces if piece.who == who)


def by_truth(frames: Frames, made: Matches, times: Ints, lasting_ns: int) -> Followed:
    """Tracks of a run that follow each true target.

    Args:
        frames: truth and tracks in the true frames.
        made: pairs of each frame alone.
        times: (T,) of the frames [ns].
        lasting_ns: shorter pieces are left out.
    """
    who = frames.truth_key[frames.truth[made.truth], 1]
    track = frames.track_key[frames.track[made.track], 1]
    return pieces_of(who, track, frames.frame[made.frame], times, lasting_ns)


def by_each_other(a: Laid, b: Laid, pairs: Pairs, times: Ints, lasting_ns: int) -> tuple[Followed, Followed]:
    """Tracks of B that follow each one of A, and the other way round.

    Args:
        a: run A in common frames.
        b: run B.
        pairs: of them.
        times: (T,) of the frames [ns].
        lasting_ns: shorter pieces are left out.
    """
    of_a, of_b = a.label[pairs.a], b.label[pairs.b]
    return (
        pieces_of(of_a, of_b, pairs.frame, times, lasting_ns),
        pieces_of(of_b, of_a, pairs.frame, times, lasting_ns),
    )


def pieces_of(who: Ints, track: Ints, frame: Ints, times: Ints, lasting_ns: int) -> Followed:
    """Stretches of time in which each one has one track.

    Interruptions shorter than `lasting_ns` do not end a stretch; stretches that are shorter are left out, and what is
    left on either side of them becomes one if it is of the same track.

    Args:
        who: (n,) those who are followed.
        track: (n,) the track of each.
        frame: (n,) number of the frame.
        times: (T,) of the frames [ns].
        lasting_ns: the shortest stretch.
    """
    if not len(who):
        return Followed((), (), 0)
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
        Change(after.start_ns, after.who, before.track, after.track)
        for before, after in pairwise(pieces)
        if before.who == after.who and before.track != after.track
    ]
    passing = int(np.count_nonzero(_changed(who, track))) - len(changes)
    return Followed(tuple(pieces), tuple(sorted(changes)), max(passing, 0))


def _gap(t_ns: Ints, frame: Ints) -> Ints:
    """(n - 1,) time between rows that are not of neighbouring frames, else 0."""
    return np.where(np.diff(frame) > 1, np.diff(t_ns), 0)


def _changed(who: Ints, track: Ints) -> Bools:
    """(n - 1,) whether a row's track is another one than that of the row before, of the same one."""
    return np.asarray((np.diff(who) == 0) & (np.diff(track) != 0))


def without_counterpart(own: Followed, other: Followed, within_ns: int) -> tuple[Change, ...]:
    """Changes of one run for which the other run has none of the same person at about the same time."""
    known: dict[int, list[int]] = {}
    for change in other.changes:
        known.setdefault(change.who, []).append(change.t_ns)
    return tuple(c for c in own.changes if all(abs(c.t_ns - t) > within_ns for t in known.get(c.who, [])))
