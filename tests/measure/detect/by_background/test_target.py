from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.detect.by_background.one_camera import Target, TargetMemory, choose, similarities
from occlog.measure.regions.regions import ForegroundRegions, normalised

SECOND = 1_000_000_000


def regions(*positions: tuple[float, float, float], fill: float = 1.0) -> ForegroundRegions:
    """Regions of x, y, pixels; a person is 10 px wide (standard deviation)."""
    k = len(positions)
    table = np.array(positions, dtype=np.float64).reshape(k, 3)
    person = np.tile([100.0, 0.0, 900.0], (k, 1))
    return ForegroundRegions(
        table[:, :2], person, np.zeros((k, 4)), table[:, 2], np.full(k, fill), person, np.full((k, 72), np.nan)
    )


NOTHING = np.empty((0, 0))
LEAST = 0.6
"""Least likeness to a target."""


def test_without_appearance_the_largest_region_is_the_target() -> None:
    got = choose(0, regions((10, 10, 300), (50, 10, 500)), np.empty((2, 0)), TargetMemory(), LEAST)
    assert got.tolist() == [1]


def test_without_appearance_a_similar_region_does_not_take_over_at_once() -> None:
    memory = TargetMemory()
    assert choose(0, regions((10, 10, 500), (90, 10, 400)), np.empty((2, 0)), memory, LEAST).tolist() == [0]
    later = regions((90, 10, 500), (12, 10, 400))
    assert choose(SECOND // 10, later, np.empty((2, 0)), memory, LEAST).tolist() == [1]
    # After MEMORY_S without a sight it starts again.
    assert choose(5 * SECOND, later, np.empty((2, 0)), memory, LEAST).tolist() == [0]


def test_what_is_much_larger_than_a_person_is_no_target() -> None:
    got = choose(0, regions((10, 10, 9000), fill=8.0), np.empty((1, 0)), TargetMemory(), LEAST)
    assert got.tolist() == [-1]


def test_no_regions_no_target() -> None:
    assert choose(0, regions(), NOTHING, TargetMemory(), LEAST).tolist() == [-1]
    assert choose(0, regions(), np.empty((0, 2)), TargetMemory(), LEAST).tolist() == [-1, -1]


def test_the_region_most_like_the_target_is_it_if_it_is_like_enough() -> None:
    two = regions((10, 10, 300), (50, 10, 300))
    assert choose(0, two, np.array([[0.7], [0.9]]), TargetMemory(), LEAST).tolist() == [1]
    assert choose(0, two, np.array([[0.5], [0.59]]), TargetMemory(), LEAST).tolist() == [-1]
    assert choose(0, two, np.array([[np.nan], [np.nan]]), TargetMemory(), LEAST).tolist() == [-1]


def test_among_equals_the_target_stays_where_it_was_seen() -> None:
    memory = TargetMemory()
    choose(0, regions((50, 10, 300)), np.array([[0.9]]), memory, LEAST)
    two = regions((10, 10, 300), (55, 10, 300))
    assert choose(SECOND // 2, two, np.array([[0.93], [0.9]]), memory, LEAST).tolist() == [1]
    assert choose(SECOND // 2, two, np.array([[0.97], [0.9]]), memory, LEAST).tolist() == [0]
    assert memory.last[0] == (SECOND // 2, 10.0, 10.0)


def test_each_region_is_one_target_at_most_and_the_likest_pair_goes_first() -> None:
    two = regions((10, 10, 300), (50, 10, 300))
    like = np.array([[0.9, 0.95], [0.7, 0.8]])
    assert choose(0, two, like, TargetMemory(), LEAST).tolist() == [1, 0]
    like = np.array([[0.9, 0.95], [0.3, 0.8]])
    assert choose(0, two, like, TargetMemory(), LEAST).tolist() == [-1, 0]


def test_likeness_to_a_target_is_that_to_its_best_appearance() -> None:
    rng = np.random.default_rng(1)
    a, b = normalised(rng.random((2, 72)) ** 4)
    targets = (Target(1, np.stack([a, b])), Target(2, b[None]))
    got = similarities(np.stack([a, b, np.full(72, np.nan)]), targets)
    np.testing.assert_allclose(np.diag(got), 1.0)
    assert got[1, 0] == pytest.approx(1.0)
    assert got[0, 1] == pytest.approx(np.sqrt(a * b).sum())
    assert np.isnan(got[2]).all()
    assert similarities(np.empty((0, 72)), targets).shape == (0, 2)
    assert similarities(np.empty((4, 72)), ()).shape == (4, 0)
