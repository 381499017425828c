"""Cues next to the place: they count as far as they have stated boxes apart."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.track.methods.jipda.association_features import (
    FEATURE_HALF_WEIGHT_BOXES,
    LOG_RATIO_OTHER_TRACKLET,
    LOG_RATIO_SAME_TRACKLET,
    MAX_LOG_FEATURE_RATIO,
    empty_features,
    log_feature_ratios,
    log_ratio,
    similarity,
    update_features,
)
from occlog.track.methods.jipda.interface import NO_ID, FrameDetections
from occlog.track.methods.jipda.target_set import tentative_targets


def two():
    """Two people."""
    return tentative_targets(np.zeros((2, 6)), np.tile(np.eye(6), (2, 1, 1)), np.ones(2), np.ones(2), 0, 0)


def observation(score: float, hints: list[int], appearance: np.ndarray) -> FrameDetections:
    """Two boxes."""
    return FrameDetections(0, 0, np.zeros((2, 4)), np.full(2, score), np.array(hints), appearance, np.arange(2))


def test_a_cue_that_is_the_same_everywhere_adds_nothing() -> None:
    sums = np.array([[100.0, 50.0, 25.5], [100.0, 50.0, 25.5]])
    np.testing.assert_array_equal(log_ratio(sums, np.array([0.3, 0.5, 0.9])), 0.0)


def test_a_ratio_is_that_of_two_normals_and_counts_half_with_few_boxes() -> None:
    n, a, b, s = FEATURE_HALF_WEIGHT_BOXES, 0.8, 0.5, 0.1
    sums = np.array([[n, n * a, n * (a * a + s * s)], [n, n * b, n * (b * b + s * s)]])
    x = 0.7
    expected = 0.5 * (-((x - a) ** 2) + (x - b) ** 2) / (2 * s * s)
    assert log_ratio(sums, np.array([x]))[0] == pytest.approx(expected)
    assert log_ratio(sums, np.array([5.0]))[0] == MAX_LOG_FEATURE_RATIO
    assert log_ratio(sums, np.array([np.nan]))[0] == 0.0


def test_likeness_is_bhattacharyyas_of_histograms_and_the_cosine_of_vectors() -> None:
    p, q = np.array([[0.5, 0.5, 0.0]]), np.array([[0.5, 0.0, 0.5], [0.5, 0.5, 0.0]])
    np.testing.assert_allclose(similarity(p, q), [[0.5, 1.0]])
    np.testing.assert_allclose(similarity(np.array([[1.0, -1.0]]), np.array([[-2.0, 2.0]])), [[-1.0]])
    # An embedding without negative numbers has length 1, not a sum of 1; a box without any changes nothing
    unit, none = np.array([[0.6, 0.8]]), np.full((1, 2), np.nan)
    np.testing.assert_allclose(similarity(unit, np.concatenate([unit[:, ::-1], none])), [[0.96, np.nan]])
    np.testing.assert_allclose(similarity(np.array([[0.25, 0.75]]), none), [[np.nan]])


def test_hints_go_with_the_person_who_had_them() -> None:
    people, none = two(), np.zeros((2, 0))
    seen = [observation(np.nan, [5, 6], none)]
    cues = update_features(
        empty_features(1), people, seen, 0, beta=np.eye(2), free=np.zeros(2), sure=np.ones(2, dtype=bool)
    )
    added, _ = log_feature_ratios(cues, people, [observation(np.nan, [6, 9], none)], 0)
    np.testing.assert_allclose(added, [[LOG_RATIO_OTHER_TRACKLET, 0.0], [LOG_RATIO_SAME_TRACKLET, 0.0]])
    added, _ = log_feature_ratios(cues, people, [observation(np.nan, [NO_ID, NO_ID], none)], 0)
    np.testing.assert_array_equal(added, 0.0)


def test_appearance_counts_once_it_tells_people_apart() -> None:
    people, cues, rng = two(), empty_features(1), np.random.default_rng(0)
    for _ in range(60):
        colours = np.abs(np.array([[0.8, 0.1, 0.1], [0.1, 0.1, 0.8]]) + rng.normal(0.0, 0.02, (2, 3)))
        seen = [observation(0.9, [NO_ID, NO_ID], colours)]
        added, anybody = log_feature_ratios(cues, people, seen, 3)
        cues = update_features(cues, people, seen, 3, beta=np.eye(2), free=np.zeros(2), sure=np.ones(2, dtype=bool))
    assert added[0, 0] > 1.0
    assert added[0, 1] < -1.0
    np.testing.assert_array_equal(anybody, 0.0)


def test_looks_without_appearance_stand_next_to_those_with() -> None:
    people = two()
    seen = [observation(0.5, [NO_ID] * 2, np.ones((2, 3)) / 3), observation(0.5, [NO_ID] * 2, np.zeros((2, 0)))]
    added, _ = log_feature_ratios(empty_features(1), people, seen, 3)
    assert added.shape == (2, 4)
    assert np.isfinite(added).all()
