"""False position and false label rates of trackers with one assigned target each, [Qu] Eq. 9.

[Qu] does not say when a tracker is on a target. Here: tracker k is on its target k if that is within tau, otherwise on
the nearest target within tau (of two equally near, the one with the lower label), or on none. Several trackers may be
on one target.

    position failure    a target that no tracker is on
    label failure       a tracker that is on another target than its own

Both are divided by frames x views x targets: all true rows, also of targets that are hidden.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints

from ..errors import ratio_or_nan
from .frame_pairs import MatchedFrames, Objects, of_points

NO_TARGET = -1
"""No target: `other` of a position failure, `elsewhere` of a label failure, a tracker without a target of its own."""


class FailureRates(NamedTuple):
    """Position and label failures of trackers as rows, sorted by view, frame and target, and their rates ([Qu] Eq. 9).

    Attributes:
        frame: (n,) number of the frame.
        view: (n,) number of the view; 0 where there is one.
        target: (n,) position failure: label of the target; label failure: the tracker's own target.
        other: (n,) position failure: `NO_TARGET`; label failure: label of the target that the tracker is on.
        label: (n,) true: label failure; false: position failure.
        away: (n,) position failure: distance of the target's own tracker, NaN where it has none in the
            frame; label failure: distance of the tracker from the target that it is on.
        elsewhere: (n,) position failure: label of the target that its own tracker is on; otherwise `NO_TARGET`.
        total: number of true rows.
        fr_p: position failures / total ([Qu] Eq. 9); NaN without true rows.
        fr_l: label failures / total ([Qu] Eq. 9); NaN without true rows.
    """

    frame: Ints
    view: Ints
    target: Ints
    other: Ints
    label: Bools
    away: Floats
    elsewhere: Ints
    total: int
    fr_p: float
    fr_l: float

    def causes(self, unit: str = "px") -> list[str]:
        """Return the cause of each failure as a text, with distances in `unit`."""
        rows = zip(*(column.tolist() for column in (self.label, self.other, self.away, self.elsewhere)), strict=True)
        return [_cause(label, other, away, elsewhere, unit) for label, other, away, elsewhere in rows]


def _cause(label: bool, other: int, away: float, elsewhere: int, unit: str) -> str:
    """Return the cause of a failure as a text.

    Args:
        label: True for a label failure, False for a position failure.
        other: label failure: target that the tracker is on.
        away: position failure: distance of the target from its own tracker; NaN without one.
        elsewhere: position failure: target that its own tracker is on; `NO_TARGET`: none.
        unit: unit of the distance.
    """
    if label:
        return f"tracker on target {other}"
    if elsewhere != NO_TARGET:
        return f"its tracker is on target {elsewhere}"
    return "no tracker" if np.isnan(away) else f"its tracker is {away:.4g} {unit} away"


def failures(truth: Objects, trackers: Objects, tau: Floats | float, own: Ints | None = None) -> FailureRates:
    """Return the position and label failures of trackers, and their rates ([Qu] Eq. 9).

    Args:
        truth: (n, 2) centres of the targets in each frame and view, hidden ones included; labels >= 0.
        trackers: (m, 2) centres of the estimates.  A row with a position that is not finite is a tracker
            without an estimate.
        tau: largest distance from a target at which a tracker is on it, >= 0; (n,) for each true
            row, such as the radius of the target, or one for all.
        own: (m,) label of the target that each row's tracker belongs to; `NO_TARGET`: the tracker has no
            target, so that being on one is a label failure.  None: the tracker's own label.

    Raises:
        ValueError: a label comes twice in a frame of a view, a true position is not finite, tau is not a length.
    """
    lengths = np.asarray(tau, dtype=np.float64)
    reach = np.broadcast_to(lengths, len(truth.frame))
    if not (lengths >= 0).all():
        raise ValueError("tau must be at least 0")
    assigned = trackers.label if own is None else own
    given = np.isfinite(trackers.position).all(axis=1)
    views = None if trackers.view is None else trackers.view[given]
    known = Objects(trackers.frame[given], trackers.label[given], trackers.position[given], views)
    frames = of_points(truth, known, 1.0)
    return _failures(
        frames, _match_frame(frames, reach[frames.truth_row], assigned[given][frames.track_row].astype(np.int64))
    )


class _FrameMatches(NamedTuple):
    """For each tracker row the true row it is on, and for each true row the nearest of its target's own trackers."""

    assigned: Ints  # (M,) label of its own target
    on: Ints  # (M,) true row that it is on; -1: none
    far: Floats  # (M,) distance from there; NaN: on none
    tracker: Ints  # (N,) row of the nearest of the target's own trackers; -1: none in the frame
    away: Floats  # (N,) its distance; NaN: none


def _match_frame(frames: MatchedFrames, reach: Floats, assigned: Ints) -> _FrameMatches:
    """Return the target that each tracker is on, and the nearest assigned tracker of each target, in each frame.

    A tracker is on its own target if that is within tau, else on the nearest target within tau.

    Args:
        frames: N true rows and M rows of trackers.
        reach: (N,) largest distance tau from each true row at which a tracker is on it.
        assigned: (M,) label of each tracker's own target.
    """
    on, far = np.full(len(frames.track), -1, dtype=np.int64), np.full(len(frames.track), np.nan)
    tracker, away = np.full(len(frames.truth), -1, dtype=np.int64), np.full(len(frames.truth), np.nan)
    for t in frames.meeting():
        left, right = frames.rows(t)
        distance = frames.compare(t)[0]
        mine = frames.truth_key[frames.truth[left], 1][:, None] == assigned[right][None, :]
        within = np.where(distance <= reach[left, None], distance, np.inf)
        # A tracker is on its own target if that is within tau, else on the nearest target within tau
        order = np.where(mine & np.isfinite(within), -1.0, within)
        best = np.argmin(order, axis=0)
        there = np.isfinite(order.min(axis=0))
        on[right] = np.where(there, left.start + best, -1)
        far[right] = np.where(there, distance[best, np.arange(len(best))], np.nan)
        # The nearest of each target's own trackers, on it or not
        nearest = np.argmin(np.where(mine, distance, np.inf), axis=1)
        has = mine.any(axis=1)
        tracker[left] = np.where(has, right.start + nearest, -1)
        away[left] = np.where(has, distance[np.arange(len(nearest)), nearest], np.nan)
    return _FrameMatches(assigned, on, far, tracker, away)


def _failures(frames: MatchedFrames, matches: _FrameMatches) -> FailureRates:
    """Return position and label failures as rows, and their numbers divided by the number of true rows.

    Args:
        frames: true rows and rows of trackers, by frame.
        matches: which tracker is on which target.
    """
    # Targets that a tracker is on
    found = np.zeros(len(frames.truth), dtype=np.bool_)
    found[matches.on[matches.on >= 0]] = True
    # One element more at the end, so that index -1 gives no target
    label = np.append(frames.truth_key[frames.truth, 1], NO_TARGET)
    # Position failures (rows of the truth) and label failures (rows of trackers), the numerators of [Qu] Eq. 9
    lost, wrong = np.flatnonzero(~found), np.flatnonzero((matches.on >= 0) & (matches.assigned != label[matches.on]))
    t = np.arange(len(frames.frame))
    of_truth, of_track = np.repeat(t, np.diff(frames.truth_start)), np.repeat(t, np.diff(frames.track_start))
    wrong_label = label[np.append(matches.on, -1)[matches.tracker[lost]]]
    none = np.full(max(len(lost), len(wrong)), NO_TARGET, dtype=np.int64)
    sides = (
        (
            of_truth[lost],
            label[:-1][lost],
            none[: len(lost)],
            np.zeros(len(lost), np.bool_),
            matches.away[lost],
            wrong_label,
        ),
        (
            of_track[wrong],
            matches.assigned[wrong],
            label[matches.on[wrong]],
            np.ones(len(wrong), np.bool_),
            matches.far[wrong],
            none[: len(wrong)],
        ),
    )
    columns = [np.concatenate(pair) for pair in zip(*sides, strict=True)]
    order = np.lexsort((columns[3], columns[1], columns[0]))
    cell, target, other, of_label, away, elsewhere = (column[order] for column in columns)
    total = len(frames.truth)
    return FailureRates(
        frame=frames.frame[cell],
        view=frames.view[cell],
        target=target,
        other=other,
        label=of_label,
        away=away,
        elsewhere=elsewhere,
        total=total,
        fr_p=ratio_or_nan(len(lost), total),
        fr_l=ratio_or_nan(len(wrong), total),
    )
