"""Gaussian update against the textbook Kalman filter; the smoother is tested with its motion."""

from __future__ import annotations

import numpy as np
from scipy.stats import multivariate_normal

from occlog.filtering.gaussian import Gaussian, updated


def test_the_update_is_that_of_the_information_filter() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(4, 4))
    state = Gaussian(rng.normal(size=4), A @ A.T + np.eye(4))
    H, R, innovation = rng.normal(size=(3, 4)), np.array([0.5, 2.0, 0.1]), rng.normal(size=3)
    after, score = updated(state, H, innovation, R)
    information = np.linalg.inv(state.covariance) + (H.T / R) @ H
    np.testing.assert_allclose(after.covariance, np.linalg.inv(information), rtol=1e-9)
    np.testing.assert_allclose(after.mean, state.mean + np.linalg.solve(information, (H.T / R) @ innovation), rtol=1e-9)
    S = H @ state.covariance @ H.T + np.diag(R)
    np.testing.assert_allclose(score, multivariate_normal(np.zeros(3), S).logpdf(innovation), rtol=1e-9)
