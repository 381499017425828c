"""How far both runs are from the truth over time: of targets that both have found, and how many each has not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.metrics.mot.clear_mot import Matches
from occlog.core.metrics.mot.frame_pairs import Frames

Paired = tuple[Frames, Matches]


@dataclass(frozen=True, eq=False)
class OverTime:
    """Errors of both runs in the true frames.

    Attributes:
        t_ns: (T,) times of the frames.
        a, b: (T,) root mean square distance from the truth of the targets that both have found; NaN where there are
            none.
        missed_a, missed_b: (T,) targets that a run has not found.
        false_a, false_b: (T,) tracks of a run that are on no target.
        objects: true targets of all frames together.
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
    def on_nobody(self) -> tuple[bool, bool]:
        """Whether a run, A or B, has tracks, but never one that is on a target."""
        return self._nobody(self.missed_a, self.false_a), self._nobody(self.missed_b, self.false_b)

    def _nobody(self, missed: Ints, false: Ints) -> bool:
        return bool(false.any()) and int(missed.sum()) == self.objects

    @property
    def both(self) -> int:
        """How many frames have targets that both have found."""
        return int(np.isfinite(self.a).sum())


def over_time(a: Paired, b: Paired, t_ns: Ints) -> OverTime:
    """Errors over time, in pairs of each frame alone as `pairs_rmse` has them.

    Args:
        a: truth and tracks of run A, and their pairs of each frame alone.
        b: those of run B, of the same truth.
        t_ns: (T,) times of the true frames.
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
    return OverTime(t_ns, errors[0], errors[1], missed[0], missed[1], false[0], false[1], len(a[0].truth))
