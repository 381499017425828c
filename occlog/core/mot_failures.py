"""False position and false label rates of trackers that each have a target of their own, [Qu] Eq. 9.

[Qu] does not say when a tracker is on a target.  Here: tracker k is on target k if that is within
tau of it, otherwise on the nearest target within tau (of two as near that of the lower label), and
on none without one.  Several trackers may be on one target.

    position failure    a target that no tracker is on
    label failure       a tracker that is on another target than its own

Both are divided by frames x views x targets: all true rows, also of targets that are hidden.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .metrics import Bools, Floats, Ints, ratio
from .mot_frames import Frames, Objects, of_points

NONE = -1
"""`other` of a position failure."""


class Failures(NamedTuple):
    """A row for each failure, by view, frame and target, and the rates.

    Attributes:
        frame: (n,) number of the frame.
        view: (n,) number of the view; 0 where there is one.
        target: (n,) position failure: label of the target; label failure: label of the tracker.
        other: (n,) position failure: `NONE`; label failure: label of the target that the tracker is on.
        label: (n,) true: label failure; false: position failure.
        total: number of true rows.
        fr_p: position failures / total ([Qu] Eq. 9); NaN without true rows.
        fr_l: label failures / total ([Qu] Eq. 9); NaN without true rows.
    """

    frame: Ints
    view: Ints
    target: Ints
    other: Ints
    label: Bools
    total: int
    fr_p: float
    fr_l: float

    def causes(self) -> list[str]:
        """The cause of each failure in words."""
        pairs = zip(self.label.tolist(), self.other.tolist(), strict=True)
        return [f"tracker on target {other}" if label else "no tracker" for label, other in pairs]


def failures(truth: Objects, trackers: Objects, tau: Floats | float) -> Failures:
    """Failures of trackers, [Qu] Eq. 9.

    Args:
        truth: (n, 2) centres of the targets in each frame and view, hidden ones included.
        trackers: (m, 2) centres of the estimates; tracker and target of one label belong together.
            A row whose place is not finite is a tracker without an estimate.
        tau: largest distance from a target at which a tracker is on it, >= 0; (n,) for each true
            row, such as the radius of the target, or one for all.

    Raises:
        ValueError: a label comes twice in a frame of a view, a true place is not finite, tau is not a length.
    """
    lengths = np.asarray(tau, dtype=np.float64)
    reach = np.broadcast_to(lengths, len(truth.frame))
    if not (lengths >= 0).all():
        raise ValueError("tau must be at least 0")
    given = np.isfinite(trackers.place).all(axis=1)
    views = None if trackers.view is None else trackers.view[given]
    known = Objects(trackers.frame[given], trackers.label[given], trackers.place[given], views)
    frames = of_points(truth, known, 1.0)
    on = _on(frames, reach[frames.truth_row])
    found = np.zeros(len(frames.truth), dtype=np.bool_)
    found[on[on >= 0]] = True
    whose, where = frames.track_key[frames.track, 1], np.append(frames.truth_key[frames.truth, 1], NONE)[on]
    wrong = np.flatnonzero((on >= 0) & (whose != where))
    return _failures(frames, np.flatnonzero(~found), wrong, whose[wrong], where[wrong])


def _on(frames: Frames, reach: Floats) -> Ints:
    """(M,) true row that each tracker's row is on; -1: none."""
    on = np.full(len(frames.track), -1, dtype=np.int64)
    for t in frames.meeting():
        left, right = frames.rows(t)
        targets, trackers = frames.truth_key[frames.truth[left], 1], frames.track_key[frames.track[right], 1]
        distance = frames.compare(t)[0]
        distance = np.where(distance <= reach[left, None], distance, np.inf)
        # On its own target before any other one, however near.
        distance[(targets[:, None] == trackers[None, :]) & np.isfinite(distance)] = -1.0
        best = np.argmin(distance, axis=0)
        on[right] = np.where(np.isfinite(distance.min(axis=0)), left.start + best, -1)
    return on


def _failures(frames: Frames, lost: Ints, wrong: Ints, whose: Ints, where: Ints) -> Failures:
    t = np.arange(len(frames.frame))
    cell = np.concatenate(
        [np.repeat(t, np.diff(frames.truth_start))[lost], np.repeat(t, np.diff(frames.track_start))[wrong]]
    )
    target = np.concatenate([frames.truth_key[frames.truth[lost], 1], whose])
    other = np.concatenate([np.full(len(lost), NONE, dtype=np.int64), where])
    label = np.concatenate([np.zeros(len(lost), dtype=np.bool_), np.ones(len(wrong), dtype=np.bool_)])
    order = np.lexsort((label, target, cell))
    total = len(frames.truth)
    return Failures(
        frames.frame[cell][order], frames.view[cell][order], target[order], other[order], label[order],
        total, ratio(len(lost), total), ratio(len(wrong), total),
    )  # fmt: skip
