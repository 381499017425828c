"""Covariance intersection: the weights are the best ones, and the covariance is never too small."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.fuse.tracks.match import intersect, weights


def random_covariances(n: int, k: int, seed: int) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(n, k, k))
    return a @ np.swapaxes(a, 1, 2) + 0.01 * np.eye(k)


def test_weights_make_the_ellipse_smallest() -> None:
    a, b = random_covariances(50, 2, 0), random_covariances(50, 2, 1)
    found = weights(a, b)
    grid = np.linspace(0.0, 1.0, 2001)[:, None, None, None]
    area = np.linalg.det(grid * np.linalg.inv(a) + (1.0 - grid) * np.linalg.inv(b))
    assert found == pytest.approx(grid[np.argmax(area, axis=0), 0, 0, 0], abs=1e-3)
    assert ((found > 0.0) & (found < 1.0)).any()
    assert np.isin(found, (0.0, 1.0)).any()


def test_equal_estimates_stay_as_they_are() -> None:
    a = random_covariances(5, 4, 2)
    mean = np.arange(20.0).reshape(5, 4)
    fused, covariance = intersect((mean, mean), (a, a))
    assert fused == pytest.approx(mean, rel=1e-6)
    assert covariance == pytest.approx(a, rel=1e-6)


@pytest.mark.parametrize("correlation", [-0.9, 0.0, 0.5, 0.99])
def test_errors_of_any_correlation_are_within_the_covariance(correlation: float) -> None:
    a, b = random_covariances(1, 4, 3), random_covariances(1, 4, 4)
    rng = np.random.default_rng(5)
    common, own = rng.normal(size=(2, 4000, 4))
    other = correlation * common + np.sqrt(1.0 - correlation**2) * own
    first = common @ np.linalg.cholesky(a[0]).T
    second = other @ np.linalg.cholesky(b[0]).T
    errors, covariance = intersect((first, second), tuple(np.broadcast_to(c, (4000, 4, 4)) for c in (a, b)))
    nees = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
    assert nees.mean() < 4.2  # 4 numbers


def test_a_place_that_is_known_exactly_counts_alone() -> None:
    exact, rough = np.zeros((1, 2, 2)), np.eye(2)[None]
    fused, covariance = intersect((np.array([[1.0, 2.0]]), np.zeros((1, 2))), (exact, rough))
    assert fused == pytest.approx(np.array([[1.0, 2.0]]), abs=1e-6)
    assert covariance == pytest.approx(np.zeros((1, 2, 2)), abs=1e-6)
