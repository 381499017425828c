"""Association features in addition to position: detection scores, tracklet IDs, appearance.

Each feature is weighted by how well it has discriminated so far: two normal distributions of its values are estimated,
for boxes that were surely the person's and for boxes that surely were not, and its contribution is their log likelihood
ratio. A feature with the same distribution in both cases contributes nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .interface import NO_ID, FrameDetections
from .target_set import TargetSet

SAME_TARGET, OTHER_TARGET = 0, 1
FEATURE_HALF_WEIGHT_BOXES = 30.0
"""A cue counts half when this many boxes of either kind have shown it."""
MAX_LOG_FEATURE_RATIO = 3.0
"""Greatest log of a likelihood ratio of a cue."""
MIN_FEATURE_SIGMA = 0.02
"""Minimum standard deviation of a score or a similarity."""
LOG_RATIO_SAME_TRACKLET, LOG_RATIO_OTHER_TRACKLET = math.log(20.0), math.log(0.3)
"""Log-likelihood ratios of a box with the hint that the person had last in this camera, and of one with the hint that
another person had: trackers of one camera keep an identity mostly, and lose some."""
MIN_ASSOCIATION_TO_LEARN, MIN_CLUTTER_TO_LEARN = 0.9, 0.9
"""Minimum probability of a box of a person, or of clutter, for learning."""
APPEARANCE_LEARNING_RATE = 0.1
"""Weight of a new box in a person's appearance."""


@dataclass(frozen=True)
class AssociationFeatures:
    """Statistics of association features over all boxes so far, and tracklet ids and appearances of N people.

    `score` and `similarities` (2, 3) have count, sum and sum of squares of detector scores (row 0: boxes of people, row
    1: clutter) and of appearance similarities (row 0: to the right person, row 1: to another one). `hint` (N, C) is the
    last tracklet id in each camera, `appearance` (N, K) a running mean (NaN: none), both for the track keys `key` (N,).
    """

    score: Floats  # (2, 3) count, sum, sum of squares: boxes of people, clutter boxes
    similarities: Floats  # (2, 3) sums of similarities: to the same person, to others
    key: Ints  # (N,) people whom the rest is of
    hint: Ints  # (N, C) last tracklet id in each camera; NO_ID: no id
    appearance: Floats  # (N, K) running mean; NaN: none


def empty_features(cameras: int) -> AssociationFeatures:
    """Return association features without people and with zero counts, for `cameras` cameras."""
    none = np.zeros(0, dtype=np.int64)
    return AssociationFeatures(
        np.zeros((2, 3)), np.zeros((2, 3)), none, np.zeros((0, cameras), dtype=np.int64), np.zeros((0, 0))
    )


def log_ratio(sums: Floats, value: Floats) -> Floats:
    """Return log likelihood ratios (correct box against other box) of feature values, with the shape of `value`.

    Each class has a normal distribution. Ratios are limited to +-`MAX_LOG_FEATURE_RATIO`, shrunk towards 0 for small
    counts, and 0 for NaN.

    Args:
        sums: (2, 3) count, sum and sum of squares of the feature; row 0: correct boxes, row 1: other boxes.
        value: feature values, of any shape.
    """
    flat = np.ascontiguousarray(value, dtype=np.float64).reshape(-1)
    return _log_ratios(feature_likelihood(sums), flat).reshape(value.shape)


class FeatureLikelihood(NamedTuple):
    """Normal distributions of one feature: index 0 for correct boxes, 1 for other boxes (clutter or another person).

    `mean`, `deviation` and `log` (log of the deviation) are (2,); `least` is the smaller number of values of the two.
    """

    mean: Floats  # (2,)
    deviation: Floats  # (2,)
    log: Floats  # (2,) of the deviation
    least: float  # values of either kind that are known, at least


def feature_likelihood(sums: Floats) -> FeatureLikelihood:
    """Estimate the two normal distributions of a feature; standard deviations are at least `MIN_FEATURE_SIGMA`.

    `sums` (2, 3) are count, sum and sum of squares of its values; row 0: correct boxes, row 1: other boxes.
    """
    count = np.maximum(sums[:, 0], 1.0)
    mean = sums[:, 1] / count
    deviation = np.sqrt(np.maximum(sums[:, 2] / count - mean**2, MIN_FEATURE_SIGMA**2))
    return FeatureLikelihood(mean, deviation, np.log(deviation), float(sums[:, 0].min()))


@kernel
def log_ratio_at(law: FeatureLikelihood, value: float) -> float:
    """Return the log likelihood ratio of one feature value: correct box against other box.

    It is shrunk towards 0 by n / (n + `FEATURE_HALF_WEIGHT_BOXES`), n the smaller of the two sample sizes, limited to
    +-`MAX_LOG_FEATURE_RATIO`, and 0 for NaN.
    """
    same, other = (
        (value - law.mean[SAME_TARGET]) / law.deviation[SAME_TARGET],
        (value - law.mean[OTHER_TARGET]) / law.deviation[OTHER_TARGET],
    )
    out = (-0.5 * same * same - law.log[SAME_TARGET]) - (-0.5 * other * other - law.log[OTHER_TARGET])
    out = out * law.least / (law.least + FEATURE_HALF_WEIGHT_BOXES)
    if math.isnan(out):
        return 0.0
    return float(min(max(out, -MAX_LOG_FEATURE_RATIO), MAX_LOG_FEATURE_RATIO))


@kernel
def _log_ratios(law: FeatureLikelihood, value: Floats) -> Floats:
    """Return (n,) log likelihood ratios of feature values `value` (n,): correct box against other box; 0 for NaN.

    `law` has the two normal distributions; ratios are shrunk for small samples and limited, as by `log_ratio_at`.
    """
    out = np.empty(value.shape[0])
    for k in range(value.shape[0]):
        out[k] = log_ratio_at(law, value[k])
    return out


SUM_SLACK = 0.01
"""Sums of histograms are 1 to this."""


def unit_vectors(appearance: Floats, histograms: bool) -> Floats:
    """Convert appearance vectors (.., K) to unit vectors, so that the scalar product of two is their similarity.

    If `histograms`, the square roots are normalised (Bhattacharyya coefficient), else the vectors (cosine). NaN (no
    appearance) stays NaN, and a zero vector becomes NaN.
    """
    out = np.sqrt(appearance) if histograms else appearance
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))


def are_histograms(*appearance: Floats) -> bool:
    """Return whether all vectors (.., K) are histograms: nonnegative, with sum 1 to `SUM_SLACK`.

    NaN vectors (no appearance) are ignored. Embeddings of networks have norm 1 instead, and may be nonnegative, too.
    """
    for each in appearance:
        sums = each.sum(axis=-1)
        if np.nanmin(each, initial=0.0) < 0.0 or np.nanmax(np.abs(sums - 1.0), initial=0.0) > SUM_SLACK:
            return False
    return True


def similarity(gallery: Floats, boxes: Floats) -> Floats:
    """Return the similarity (N, M), at most 1, of appearances `gallery` (N, K) of people and `boxes` (M, K).

    It is the Bhattacharyya coefficient if all are histograms, else the cosine; NaN if either has no appearance (NaN, or
    K = 0 in the gallery).
    """
    if gallery.shape[1] == 0:
        return np.full((len(gallery), len(boxes)), np.nan)
    histograms = are_histograms(gallery, boxes)
    return np.asarray(unit_vectors(gallery, histograms) @ unit_vectors(boxes, histograms).T)


def log_feature_ratios(
    cues: AssociationFeatures, people: TargetSet, frames: list[FrameDetections], dimension: int
) -> tuple[Floats, Floats]:
    """Return log-likelihood ratios of M boxes: (N, M) of each person against others, (M,) of people against clutter.

    The first sums tracklet ids and appearance, the second is of the detector's score; 0 where a feature is missing.

    Args:
        cues: statistics, and the features of known people by track key.
        people: N tracks; those without known features get 0.
        frames: detections of each frame of the time step; M in all.
        dimension: K of the boxes' appearance; 0: boxes have no appearance.
    """
    M = sum(len(frame.boxes) for frame in frames)
    hint, gallery = _features_of(cues, people, dimension)
    score = np.concatenate([frame.score for frame in frames]) if frames else np.zeros(0)
    out = np.zeros((len(people.key), M))
    start = 0
    for frame in frames:
        stop = start + len(frame.boxes)
        mine = hint[:, frame.camera, None] == frame.tracklet_id
        taken = mine.any(axis=0)
        out[:, start:stop] += np.where(
            frame.tracklet_id < 0,
            0.0,
            np.where(mine, LOG_RATIO_SAME_TRACKLET, np.where(taken, LOG_RATIO_OTHER_TRACKLET, 0.0)),
        )
        if dimension:
            out[:, start:stop] += log_ratio(cues.similarities, similarity(gallery, appearance_of(frame, dimension)))
        start = stop
    return out, log_ratio(cues.score, score)


def update_features(
    cues: AssociationFeatures,
    people: TargetSet,
    frames: list[FrameDetections],
    dimension: int,
    *,
    beta: Floats,
    free: Floats,
    sure: Bools,
) -> AssociationFeatures:
    """Return the feature statistics, tracklet ids and mean appearances, updated with the associations of one time step.

    Only associations with probability above `MIN_ASSOCIATION_TO_LEARN`, and clutter above `MIN_CLUTTER_TO_LEARN`,
    count.

    Args:
        cues: statistics before the time step; not changed.
        people: N tracks after the update, new ones included.
        frames: detections of each frame of the time step; M in all.
        dimension: K of the boxes' appearance; 0: none.
        beta: (N, M) association probability of person and box.
        free: (M,) probability that a box is of no person.
        sure: (N,) people who surely exist.
    """
    hint, gallery = _features_of(cues, people, dimension)
    score, similar = cues.score.copy(), cues.similarities.copy()
    start = 0
    for frame in frames:
        stop = start + len(frame.boxes)
        mine = (beta[:, start:stop] > MIN_ASSOCIATION_TO_LEARN) & sure[:, None]
        _add(score[SAME_TARGET], frame.score[mine.any(axis=0)])
        _add(score[OTHER_TARGET], frame.score[free[start:stop] > MIN_CLUTTER_TO_LEARN])
        person, box = np.nonzero(mine)
        named = frame.tracklet_id[box] >= 0
        hint[person[named], frame.camera] = frame.tracklet_id[box[named]]
        if dimension:
            seen = appearance_of(frame, dimension)
            like = similarity(gallery, seen)
            _add(similar[SAME_TARGET], like[mine])
            # Others: the boxes that are surely of another person
            _add(similar[OTHER_TARGET], like[(~mine) & mine.any(axis=0) & sure[:, None]])
            new = seen[box]
            old = gallery[person]
            mixed = np.where(
                np.isnan(old), new, (1.0 - APPEARANCE_LEARNING_RATE) * old + APPEARANCE_LEARNING_RATE * new
            )
            gallery[person] = np.where(np.isnan(new), old, mixed)
        start = stop
    return replace(cues, score=score, similarities=similar, key=people.key, hint=hint, appearance=gallery)


def count_clutter_scores(cues: AssociationFeatures, scores: Floats) -> AssociationFeatures:
    """Return the features with detector scores (n,) of clutter detections added to the statistics; NaN is ignored."""
    score = cues.score.copy()
    _add(score[OTHER_TARGET], scores)
    return replace(cues, score=score)


def _features_of(cues: AssociationFeatures, people: TargetSet, dimension: int) -> tuple[Ints, Floats]:
    """Return last tracklet ids (N, C) and mean appearances (N, K = `dimension`) of N people, matched by track key.

    People without an entry have `NO_ID` and NaN; all appearances are NaN if the stored ones have another length.
    """
    hint = np.full((len(people.key), cues.hint.shape[1]), NO_ID, dtype=np.int64)
    appearance = np.full((len(people.key), dimension), np.nan)
    _, mine, theirs = np.intersect1d(people.key, cues.key, assume_unique=True, return_indices=True)
    hint[mine] = cues.hint[theirs]
    if cues.appearance.shape[1] == dimension:
        appearance[mine] = cues.appearance[theirs]
    return hint, appearance


def appearance_of(frame: FrameDetections, dimension: int) -> Floats:
    """Return the appearances (n, K = `dimension`) of a frame's n boxes; all NaN if the frame's have another length."""
    if frame.appearance.shape[1] == dimension:
        return frame.appearance
    return np.full((len(frame.boxes), dimension), np.nan)


def _add(sums: Floats, values: Floats) -> None:
    """Add the finite values of an array to `sums` (3,) = count, sum, sum of squares, in place."""
    values = values[np.isfinite(values)]
    sums += (len(values), values.sum(), (values**2).sum())
