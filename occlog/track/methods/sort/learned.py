"""What is learned of a detector while tracking: rates of detection, confidences of boxes, likeness of people."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints

VISIBILITY_BINS = 5
"""Equal intervals of the visible share, in which the probability of detection is learned."""
HIDDEN = (0.1, 0.35, 0.65, 0.92, 1.0)
"""Prior of the probability of detection in each, relative to that in plain view."""
PRIOR_FRAMES = 10.0
"""Frames that the prior counts as."""
SCORE_BINS = 10
"""Equal intervals of confidence; one more is for boxes without any."""
TRUE_SHARES = (0.01, 0.02, 0.05, 0.10, 0.14, 0.14, 0.14, 0.14, 0.13, 0.13)
"""Prior shares of the confidences of people's boxes."""
CLUTTER_RATES = (30.0, 10.0, 3.0, 1.0, 0.4, 0.2, 0.15, 0.1, 0.1, 0.1, 0.3)
"""Prior of the clutter in a frame, by confidence; the last: without."""
PRIOR_BOXES = 20.0
"""Boxes of people that the prior counts as."""
MEMORY_FRAMES = 200.0
"""Frames for which clutter counts."""
BIRTHS_PER_FRAME = 0.03
"""People who appear in a frame, expected."""
MIN_BIRTH, MAX_BIRTH = 0.05, 0.5
"""Limits of the existence probability that a track begins with."""
STATE_VOLUME = 0.5
"""Range of the logarithm of heights times that of ratios of width to height, over which clutter spreads."""


class ImageDetectorStatistics:
    """Statistics of the detector of one camera, learned while tracking, with priors.

    They are the probability of detection by visible share, the confidences of true and false boxes, and the appearance
    similarities of equal and different people (`similarities` (2, 3): number, sum and sum of squares of each).
    """

    def __init__(self, detection_probability: float) -> None:
        """Start with the priors; `detection_probability` is that of a person in plain view."""
        self._detected = PRIOR_FRAMES * detection_probability * np.array(HIDDEN)
        self._frames = np.full(VISIBILITY_BINS, PRIOR_FRAMES)
        shares = np.array(TRUE_SHARES)
        self._true = PRIOR_BOXES * shares / shares.sum()
        self._false = 10.0 * np.array(CLUTTER_RATES)
        self._false_frames = 10.0
        self.similarities = np.zeros((2, 3))

    def detection(self, visible: Floats) -> Floats:
        """Return (N,) detection probabilities of people with visible shares `visible` (N,), 0 to 1."""
        return np.asarray((self._detected / self._frames)[_interval(visible, VISIBILITY_BINS)])

    def add_detections(self, visible: Floats, hit: Bools) -> None:
        """Add n people with visible shares `visible` (n,) to the statistics; `hit` (n,): the person was detected."""
        interval = _interval(visible, VISIBILITY_BINS)
        self._frames += np.bincount(interval, minlength=VISIBILITY_BINS)
        self._detected += np.bincount(interval, hit, VISIBILITY_BINS)

    def _shares(self, score: Floats) -> Floats:
        """Return (M,) share of people's boxes in the confidence interval of each box; 1 for NaN (no confidence)."""
        shares = np.append(self._true / self._true.sum(), 1.0)
        return np.asarray(shares[_scores(score)])

    def log_score_ratio(self, score: Floats, area: float) -> Floats:
        """Return (M,) logs of the share of people's boxes with a box's confidence over the density of clutter with it.

        The density is per px^2 of the image and unit of the size.

        Args:
            score: (M,) confidences; NaN: none.
            area: area of the image [px^2].
        """
        density = (self._false / self._false_frames)[_scores(score)] / (area * STATE_VOLUME)
        return np.asarray(np.log(self._shares(score)) - np.log(density))

    def birth_probability(self, score: Floats) -> Floats:
        """Return (n,) probabilities, by the confidences `score` (n,), that unassigned boxes are of new people.

        They lie between `MIN_BIRTH` and `MAX_BIRTH`.
        """
        initiated = BIRTHS_PER_FRAME * self._shares(score)
        return np.clip(
            initiated / (initiated + (self._false / self._false_frames)[_scores(score)]), MIN_BIRTH, MAX_BIRTH
        )

    def add_scores(self, score: Floats, people: Ints, clutter: Ints) -> None:
        """Add the confidences `score` (M,) of a frame's boxes to those of people and of clutter.

        `people` are the indices of boxes of confirmed tracks, `clutter` those of unassigned boxes. Clutter is forgotten
        exponentially, within `MEMORY_FRAMES`.
        """
        kept = 1.0 - 1.0 / MEMORY_FRAMES
        self._false = kept * self._false + np.bincount(_scores(score[clutter]), minlength=SCORE_BINS + 1)
        self._false_frames = kept * self._false_frames + 1.0
        self._true += np.bincount(_scores(score[people]), minlength=SCORE_BINS + 1)[:SCORE_BINS]

    def add_similarity(self, kind: int, values: Floats) -> None:
        """Add appearance similarities `values` of one person (`kind` SAME_TARGET) or of two people (OTHER_TARGET).

        NaN is ignored.
        """
        known = values[np.isfinite(values)]
        self.similarities[kind] += [len(known), known.sum(), (known**2).sum()]


def _interval(share: Floats, count: int) -> Ints:
    """Return, for each `share` (0 to 1), the index of its interval, of `count` equal ones.

    Shares outside are in the first or last interval.
    """
    return np.clip((np.asarray(share) * count).astype(np.int64), 0, count - 1)


def _scores(score: Floats) -> Ints:
    """Return the interval index of each confidence, of `SCORE_BINS`; for NaN it is `SCORE_BINS`."""
    known = np.where(np.isnan(score), 0.0, score)
    return np.where(np.isnan(score), SCORE_BINS, _interval(known, SCORE_BINS))
