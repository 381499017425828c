"""Rank-1 and the area under the ROC curve against definitions pair by pair."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from occlog.core.metrics.ranking import area_under_curve, rank_one

LIKE = np.array([[0.9, 0.8, np.nan], [0.5, 0.5, 0.1], [np.nan, 0.3, 0.2]])


def test_rank_one_counts_those_most_like_their_owner():
    assert rank_one(LIKE, np.array([0, 1, 1])) == pytest.approx((1 + 0.5 + 1) / 3)
    assert rank_one(LIKE, np.array([1, 2, 0])) == 0.0
    assert rank_one(np.full((1, 2), np.nan), np.array([0])) == 0.0
    assert np.isnan(rank_one(np.zeros((0, 3)), np.zeros(0, dtype=np.int64)))


def test_area_is_the_share_of_pairs_in_order():
    rng = np.random.default_rng(0)
    like = np.round(rng.random((12, 4)), 1)
    like[2, 1] = like[5, 3] = np.nan
    owner = rng.integers(0, 4, 12)
    right = [like[k, owner[k]] for k in range(12)]
    wrong = [like[k, j] for k in range(12) for j in range(4) if j != owner[k]]
    pairs = [(a, b) for a, b in itertools.product(right, wrong) if not np.isnan(a + b)]
    slow = np.mean([(a > b) + 0.5 * (a == b) for a, b in pairs])
    assert area_under_curve(like, owner) == pytest.approx(slow)
    assert np.isnan(area_under_curve(np.ones((3, 1)), np.zeros(3, dtype=np.int64)))
