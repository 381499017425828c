from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import logsumexp

from occlog.filtering.particles import (
    effective_sample_size,
    log_of,
    mean_and_covariance,
    normalise_log_weights,
    systematic_ancestors,
)


@pytest.mark.parametrize("shift", [-5000.0, 0.0, 700.0])
@pytest.mark.parametrize("seed", range(5))
def test_normalised_weights_do_not_depend_on_the_scale(shift, seed):
    log_weights = 10.0 * np.random.default_rng(seed).standard_normal(300)
    weights, log_sum = normalise_log_weights(log_weights + shift)
    np.testing.assert_allclose(weights, np.exp(log_weights - logsumexp(log_weights)), rtol=1e-12)
    assert log_sum == pytest.approx(logsumexp(log_weights) + shift, abs=1e-9)


def test_impossible_particles_get_no_weight():
    weights, log_sum = normalise_log_weights(np.array([-np.inf, 0.0, -np.inf, np.log(3.0)]))
    np.testing.assert_allclose(weights, [0.0, 0.25, 0.0, 0.75])
    assert log_sum == pytest.approx(np.log(4.0))


def test_no_weight_at_all_is_reported_by_the_sum():
    weights, log_sum = normalise_log_weights(np.full(4, -np.inf))
    assert log_sum == -np.inf
    np.testing.assert_array_equal(weights, 0.25)


@pytest.mark.parametrize(
    ("weights", "size"), [([1.0, 0.0, 0.0], 1.0), ([0.25] * 4, 4.0), ([0.5, 0.5, 0.0], 2.0), ([0.75, 0.25], 1.6)]
)
def test_effective_size_of_known_weights(weights, size):
    assert effective_sample_size(np.array(weights)) == pytest.approx(size)


def test_mean_and_covariance_are_those_of_numpy():
    rng = np.random.default_rng(6)
    xy, counts = rng.standard_normal((50, 2)) @ [[2.0, 1.0], [0.0, 0.5]] + 1e3, rng.integers(0, 5, 50)
    mean, covariance = mean_and_covariance(counts / counts.sum(), xy)
    np.testing.assert_allclose(mean, np.average(xy, axis=0, weights=counts), rtol=1e-12)
    np.testing.assert_allclose(covariance, np.cov(xy.T, fweights=counts, ddof=0), rtol=1e-8)


def test_logarithm_of_no_weight_is_minus_infinity_without_a_warning():
    np.testing.assert_array_equal(log_of(np.array([0.0, 1.0])), [-np.inf, 0.0])


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
