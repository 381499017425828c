from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.core.filter.resampling import systematic_ancestors


def by_searching(weights, n, u):
    """The textbook form: invert the cumulated weights at equally spaced points."""
    points = (np.arange(n) + u) / n
    return np.searchsorted(np.cumsum(weights), points, side="right")


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("size", [1, 2, 17, 500])
def test_ancestors_are_the_inverse_of_the_cumulated_weights(seed, size):
    rng = np.random.default_rng(seed)
    weights = rng.exponential(size=size) ** 3
    weights /= weights.sum()
    u = rng.random()
    for n in (size, 3 * size, max(1, size // 2)):
        np.testing.assert_array_equal(
            systematic_ancestors(weights, n, u), np.minimum(by_searching(weights, n, u), size - 1)
        )


@given(st.lists(st.floats(0, 1), min_size=1, max_size=40), st.floats(0, 1, exclude_max=True), st.integers(1, 60))
def test_every_particle_appears_as_often_as_its_weight_says_give_or_take_one(values, u, n):
    weights = np.array(values) + 1e-6
    weights /= weights.sum()
    counts = np.bincount(systematic_ancestors(weights, n, u), minlength=len(weights))
    assert counts.sum() == n
    assert np.all(np.abs(counts - n * weights) < 1.0 + 1e-9)


def test_counts_are_unbiased():
    rng = np.random.default_rng(4)
    weights = rng.dirichlet(np.full(6, 0.7))
    n, runs = 10, 5_000
    counts = sum(np.bincount(systematic_ancestors(weights, n, u), minlength=6) for u in rng.random(runs))
    # A count differs from n w by less than 1, so its standard deviation is at most 1/2: 4 standard errors.
    np.testing.assert_allclose(counts / runs, n * weights, atol=4 * 0.5 / np.sqrt(runs))


@pytest.mark.parametrize("total", [0.999, 1.0 - 1e-12, 1.001])
def test_weights_that_do_not_quite_sum_to_one_stay_in_bounds(total):
    weights = np.full(1000, total / 1000)
    ancestors = systematic_ancestors(weights, 1000, 0.9999)
    assert ancestors.min() >= 0
    assert ancestors.max() <= 999
    assert np.all(np.diff(ancestors) >= 0)


@pytest.mark.parametrize("u", [0.0, 0.5, 0.9999999])
def test_a_particle_without_weight_is_never_chosen(u):
    weights = np.array([0.0, 0.0, 0.4, 0.0, 0.6 - 1e-9, 0.0, 0.0])
    assert set(systematic_ancestors(weights, 50, u)) == {2, 4}


LAST = np.nextafter(1.0, 0.0)
"""The largest draw from U[0, 1)."""


@pytest.mark.parametrize("behind", [0, 1, 2, 3])
def test_where_the_weights_sum_to_less_than_one_the_last_particle_with_weight_takes_the_rest(behind):
    weights = np.concatenate([[0.5, 0.0, 0.5 - 1e-9], np.zeros(behind)])
    assert systematic_ancestors(weights, 2, LAST).tolist() == [0, 2]
    assert systematic_ancestors(weights, 1, LAST).tolist() == [2]
    assert systematic_ancestors(np.concatenate([[1.0 - 1e-9], np.zeros(behind)]), 2, LAST).tolist() == [0, 0]


def test_a_point_at_a_cumulated_weight_belongs_to_the_next_particle():
    assert systematic_ancestors(np.array([0.25, 0.25, 0.5]), 4, 0.0).tolist() == [0, 1, 2, 2]
    assert systematic_ancestors(np.array([0.0, 1.0]), 1, 0.0).tolist() == [1]
