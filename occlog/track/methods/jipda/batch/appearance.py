"""Appearance likelihood of tracks: similarity of the boxes of one track.

The appearance of a box is a unit vector, so that the similarity of two boxes (Bhattacharyya coefficient or cosine) is
their scalar product. With S the sum of the n vectors of a track, the mean similarity of all pairs is (|S|^2 - n) / (n
(n - 1)). The filter (`AssociationFeatures`) has learned the mean similarity s of boxes to the mean of their own person,
and o to that of other people. Means are less noisy than boxes: a pair of boxes of one person has the similarity s^2, a
pair of two people s o. The position of the observed mean between these determines the share of pairs that are of one
person. This share of n - 1 boxes contributes the log likelihood ratio at s, the rest that at o. Since the result
depends on n and S alone, cumulative sums along each track make a proposal of the Markov chain cost one scalar product,
whatever the length of the tracks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

from ..association_features import OTHER_TARGET, SAME_TARGET, FeatureLikelihood, log_ratio_at

MIN_SIMILARITY_DIFFERENCE = 0.01
"""Minimum difference of the mean similarities to the same person and to others, for appearance to count."""


class AppearanceVectors(NamedTuple):
    """Appearance of n nodes (boxes of one person at one time step): sums of unit vectors of length K.

    `total` (n, K) is the sum over the node's boxes with an appearance, `boxes` (n,) their number, `law` the learned
    distributions of similarities of one person and of different people.
    """

    total: Floats  # (n, K) sum over the boxes of the position
    boxes: Floats  # (n,) boxes with an appearance
    law: FeatureLikelihood  # likelihood of similarities


class AppearanceSums(NamedTuple):
    """Cumulative appearance sums of n nodes along their tracks, with the numbers of boxes; changed in place.

    `earlier` (n, K): from the first node of the track up to and including each node; `later` (n, K): from each node to
    the last.
    """

    earlier: Floats  # (n, K) up to and with the position
    earlier_count: Floats  # (n,)
    later: Floats  # (n, K) from the position on
    later_count: Floats  # (n,)


def no_sums(similar: AppearanceVectors) -> AppearanceSums:
    """Return zero cumulative sums for all nodes, to be filled by `sum_up`."""
    return AppearanceSums(
        np.zeros_like(similar.total),
        np.zeros_like(similar.boxes),
        np.zeros_like(similar.total),
        np.zeros_like(similar.boxes),
    )


@kernel
def log_ratio_of_sum(law: FeatureLikelihood, count: float, square: float) -> float:
    """Return the log likelihood ratio that `count` boxes are of one person, against different people.

    `square` is the squared norm of the sum of their unit appearance vectors; `law` are the learned distributions of
    similarities. 0 for fewer than two boxes, or if the similarities do not discriminate.
    """
    if count < 2.0:
        return 0.0
    same, other = law.mean[SAME_TARGET], law.mean[OTHER_TARGET]
    if same - other < MIN_SIMILARITY_DIFFERENCE:
        return 0.0  # not discriminative
    similar = (square - count) / (count * (count - 1.0))
    share = (similar / same - other) / (same - other)
    return float((count - 1.0) * (share * log_ratio_at(law, same) + (1.0 - share) * log_ratio_at(law, other)))


@kernel
def log_ratio_joined(similar: AppearanceVectors, sums: AppearanceSums, i: int, k: int, j: int) -> float:
    """Return the log likelihood ratio that the boxes of up to three parts of a track are of one person.

    The parts are a track up to and including node `i`, node `k`, and a track from node `j` on; -1 leaves a part out.
    `similar` are the nodes' appearances, `sums` their cumulative sums along the tracks. 0 without appearances.
    """
    if similar.total.shape[1] == 0:
        return 0.0
    count, square = 0.0, 0.0
    for a in range(similar.total.shape[1]):
        value = 0.0
        if i >= 0:
            value += sums.earlier[i, a]
        if k >= 0:
            value += similar.total[k, a]
        if j >= 0:
            value += sums.later[j, a]
        square += value * value
    if i >= 0:
        count += sums.earlier_count[i]
    if k >= 0:
        count += similar.boxes[k]
    if j >= 0:
        count += sums.later_count[j]
    return log_ratio_of_sum(similar.law, count, square)


@kernel
def sum_up(similar: AppearanceVectors, sums: AppearanceSums, before: Ints, after: Ints, k: int) -> None:
    """Recompute the cumulative sums, in both directions, of the track that contains node `k`, in place; -1: no node.

    `before` and `after` (n,) are the previous and the next node of each node in its track, -1 for none.
    """
    if k < 0 or similar.total.shape[1] == 0:
        return
    while before[k] >= 0:
        k = before[k]
    i = -1
    while k >= 0:
        sums.earlier[k], sums.earlier_count[k] = similar.total[k], similar.boxes[k]
        if i >= 0:
            sums.earlier[k] += sums.earlier[i]
            sums.earlier_count[k] += sums.earlier_count[i]
        i, k = k, after[k]
    j, k = -1, i
    while k >= 0:
        sums.later[k], sums.later_count[k] = similar.total[k], similar.boxes[k]
        if j >= 0:
            sums.later[k] += sums.later[j]
            sums.later_count[k] += sums.later_count[j]
        j, k = k, before[k]
