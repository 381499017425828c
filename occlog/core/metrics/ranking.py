"""Discrimination of people by similarities: rank-1 and the area under the ROC curve."""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

from occlog.array_types import Floats, Ints


def rank_one(like: Floats, owner: Ints) -> float:
    """Return the rank-1 rate: share of candidates that are most similar to their own person; k ties count 1 / k.

    NaN without candidates.

    Args:
        like: (n, P) similarities of candidates to people; NaN: not compared, which is never the greatest.
        owner: (n,) index, among the P people, of the person that each candidate shows.
    """
    if not len(like):
        return float("nan")
    filled = np.where(np.isnan(like), -np.inf, like)
    best = (filled == filled.max(axis=1, keepdims=True)) & np.isfinite(filled)
    hit = best[np.arange(len(like)), owner]
    return float(np.mean(hit / np.maximum(best.sum(axis=1), 1)))


def area_under_curve(like: Floats, owner: Ints) -> float:
    """Return the area under the ROC curve: probability that a similarity to the own person exceeds one to another.

    Mann-Whitney statistic over all values that are not NaN; ties count half. NaN without values of one kind.

    Args:
        like: (n, K) similarities of n rows to K persons.
        owner: (n,) index of each row's own person.
    """
    same = owner[:, None] == np.arange(like.shape[1])
    known = np.isfinite(like)
    right, wrong = like[same & known], like[~same & known]
    if not len(right) or not len(wrong):
        return float("nan")
    ranks = rankdata(np.concatenate([right, wrong]))[: len(right)]
    return float((ranks.sum() - 0.5 * len(right) * (len(right) + 1)) / (len(right) * len(wrong)))
