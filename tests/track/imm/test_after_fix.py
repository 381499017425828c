from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.geometry.triangulate import triangulate
from occlog.track.methods.imm.camera_requests import PLACE, expected_variance, moved_to, root, updated

PLACE_FOUND = np.array([4.0, -2.0])
R = np.array([[0.5, 0.2], [0.2, 0.3]])


def states(rng, L=20_000):
    A = rng.normal(size=(4, 4))
    return rng.normal(size=(L, 4)) @ A.T + np.array([3.0, 0.2, -1.0, 0.1])


@pytest.mark.parametrize("seed", range(3))
def test_a_measurement_gives_the_moments_of_the_kalman_filter(seed):
    rng = np.random.default_rng(seed)
    x = states(rng)
    m, P = x.mean(axis=0), np.cov(x.T, bias=True)
    H = np.eye(4)[list(PLACE)]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    got = updated(x, PLACE_FOUND, R, rng.normal(size=(len(x), 2)))
    np.testing.assert_allclose(got.mean(axis=0), m + K @ (PLACE_FOUND - H @ m), atol=1e-9)
    # Chance of the draws: about 1 % of each entry
    after = P - K @ H @ P
    scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    np.testing.assert_allclose(np.cov(got.T, bias=True) / scale, after / scale, atol=0.03)


def test_an_exact_measurement_gathers_the_cloud():
    rng = np.random.default_rng(0)
    got = updated(states(rng), PLACE_FOUND, np.zeros((2, 2)), rng.normal(size=(20_000, 2)))
    np.testing.assert_allclose(got[:, PLACE], np.tile(PLACE_FOUND, (20_000, 1)), atol=1e-8)
    point = np.tile([1.0, 0.0, 2.0, 0.0], (10, 1))
    np.testing.assert_array_equal(updated(point, PLACE_FOUND, np.zeros((2, 2)), rng.normal(size=(10, 2))), point)


def test_the_thesis_keeps_velocities():
    rng = np.random.default_rng(0)
    x = states(rng)
    got = moved_to(x, PLACE_FOUND, R, rng.normal(size=(len(x), 2)))
    np.testing.assert_array_equal(got[:, [1, 3]], x[:, [1, 3]])
    np.testing.assert_allclose(got[:, PLACE].mean(axis=0), PLACE_FOUND, atol=4 * 0.7 / math.sqrt(len(x)))
    np.testing.assert_allclose(np.cov(got[:, PLACE].T), R, atol=0.02)


def test_root_of_a_covariance():
    np.testing.assert_allclose(root(R) @ root(R), R, atol=1e-15)
    np.testing.assert_allclose(root(np.diag([4.0, -1e-20])), np.diag([2.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize("place", [(3.0, 4.0), (8.0, 1.0)])
def test_expected_variance_is_that_of_the_crossing(place):
    place, origins, sigmas = np.array(place), np.array([[0.0, 0.0], [10.0, -1.0]]), np.array([0.01, 0.02])
    away = place - origins
    met = triangulate(origins, np.arctan2(away[:, 1], away[:, 0]), sigmas, np.array([0, 2]))
    assert expected_variance(place, origins, sigmas) == pytest.approx(np.trace(met.covariance[0]), rel=1e-9)


def test_lines_that_do_not_cross_tell_nothing():
    assert expected_variance(np.array([5.0, 0.0]), np.array([[0.0, 0.0], [1.0, 0.0]]), np.full(2, 0.01)) == math.inf
