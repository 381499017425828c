from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp

from occlog.core.filter.log_weights import effective_size, log_of, mean_and_covariance, normalise


@pytest.mark.parametrize("shift", [-5000.0, 0.0, 700.0])
@pytest.mark.parametrize("seed", range(5))
def test_normalised_weights_do_not_depend_on_the_scale(shift, seed):
    log_weights = 10.0 * np.random.default_rng(seed).standard_normal(300)
    weights, log_sum = normalise(log_weights + shift)
    np.testing.assert_allclose(weights, np.exp(log_weights - logsumexp(log_weights)), rtol=1e-12)
    assert log_sum == pytest.approx(logsumexp(log_weights) + shift, abs=1e-9)


def test_impossible_particles_get_no_weight():
    weights, log_sum = normalise(np.array([-np.inf, 0.0, -np.inf, np.log(3.0)]))
    np.testing.assert_allclose(weights, [0.0, 0.25, 0.0, 0.75])
    assert log_sum == pytest.approx(np.log(4.0))


def test_no_weight_at_all_is_told_by_the_sum():
    weights, log_sum = normalise(np.full(4, -np.inf))
    assert log_sum == -np.inf
    np.testing.assert_array_equal(weights, 0.25)


@pytest.mark.parametrize(
    ("weights", "size"), [([1.0, 0.0, 0.0], 1.0), ([0.25] * 4, 4.0), ([0.5, 0.5, 0.0], 2.0), ([0.75, 0.25], 1.6)]
)
def test_effective_size_of_known_weights(weights, size):
    assert effective_size(np.array(weights)) == pytest.approx(size)


def test_mean_and_covariance_are_those_of_numpy():
    rng = np.random.default_rng(6)
    xy, counts = rng.standard_normal((50, 2)) @ [[2.0, 1.0], [0.0, 0.5]] + 1e3, rng.integers(0, 5, 50)
    mean, covariance = mean_and_covariance(counts / counts.sum(), xy)
    np.testing.assert_allclose(mean, np.average(xy, axis=0, weights=counts), rtol=1e-12)
    np.testing.assert_allclose(covariance, np.cov(xy.T, fweights=counts, ddof=0), rtol=1e-8)


def test_logarithm_of_no_weight_is_minus_infinity_without_a_warning():
    np.testing.assert_array_equal(log_of(np.array([0.0, 1.0])), [-np.inf, 0.0])
