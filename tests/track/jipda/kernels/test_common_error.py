"""The filter banks of the common error against dense Gaussian likelihoods."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.track.methods.jipda.kernels.lasting_errors.common_error import (
    MODELS,
    MOMENTS,
    OUTLIER_SHARE,
    advance_bank,
    transition_matrix,
)

pytestmark = pytest.mark.jit
TIMES = np.array([0.0, 0.5, 0.9, 1.7, 2.0])
Z = np.array([[0.1, 4.0], [0.5, 4.1], [0.8, 4.0], [1.5, 4.2], [1.6, 4.3]])
NOISE, SQUARE, TAU, VELOCITY = 0.01, 0.08**2, 1.2, 0.7**2
DENSITY = np.array([4e-4, 0.06, 1.0])


def dense_log_likelihood(z: np.ndarray, model: int) -> float:
    """Log density of the positions after the first, given the first, of one motion model, by their joint covariance."""
    t = TIMES - TIMES[0]
    n, q = len(t), DENSITY[model]
    s, m = np.minimum.outer(t, t), np.maximum.outer(t, t)
    # The position is that of the first time step (diffuse) and a random walk, or integrated white acceleration
    walk = q * s if model == 0 else VELOCITY * np.outer(t, t) + q * (s**2 * m / 2.0 - s**3 / 6.0)
    error = SQUARE * np.exp(-np.abs(np.subtract.outer(t, t)) / TAU)
    C = walk + error + NOISE * np.eye(n) + 1e8
    one, rest = C[0, 0], slice(1, n)
    mean = C[rest, 0] / one * z[0]
    S = C[rest, rest] - np.outer(C[rest, 0], C[0, rest]) / one
    off = z[rest] - mean
    return float(-0.5 * (off @ np.linalg.solve(S, off) + np.linalg.slogdet(2.0 * np.pi * S)[1]))


def test_likelihood_without_changes_of_the_model_is_the_mixture_of_dense_ones():
    moments = np.zeros((1, 2, 1, MODELS, MOMENTS))
    total = 0.0
    for k in range(len(TIMES)):
        dt = np.array([TIMES[k] - TIMES[k - 1] if k else 0.0])
        total += advance_bank(
            moments, np.array([k == 0]), dt, Z[k][None], np.array([NOISE]), np.array([SQUARE]), np.array([TAU]),
            np.zeros((3, 3)), DENSITY, VELOCITY, 1e12,
        )[0]  # fmt: skip
    expected = 0.0
    for axis in range(2):
        parts = [np.log(w) + dense_log_likelihood(Z[:, axis], model) for model, w in enumerate((0.4, 0.5, 0.1))]
        expected += np.logaddexp.reduce(parts) + (len(TIMES) - 1) * np.log(1.0 - OUTLIER_SHARE)
    assert total == pytest.approx(expected, abs=2e-3)


def test_transitions_are_the_exponential_of_their_rates():
    rates = np.array([[0.0, 0.1, 0.05], [0.05, 0.0, 0.05], [0.3, 0.7, 0.0]])
    out, exact = np.zeros((3, 3)), np.eye(3)
    generator = rates - np.diag(rates.sum(axis=1))
    term = np.eye(3)
    for k in range(1, 20):
        term = term @ generator * 0.5 / k
        exact = exact + term
    transition_matrix(rates, 0.5, out)
    np.testing.assert_allclose(out, exact, atol=6e-3)
    np.testing.assert_allclose(out.sum(axis=1), 1.0)


def test_an_outlier_changes_little_and_costs_little():
    logs, means = [], []
    for last in (1.6, 9.0):
        moments = np.zeros((1, 2, 1, MODELS, MOMENTS))
        total = 0.0
        for k, z in enumerate((0.0, 0.5, 1.0, last)):
            total += advance_bank(
                moments, np.array([k == 0]), np.array([0.5]), np.array([[z, z]]), np.array([1e-3]), np.array([SQUARE]),
                np.array([TAU]), np.zeros((3, 3)), DENSITY, VELOCITY, 100.0,
            )[0]  # fmt: skip
        logs.append(total)
        means.append(float(moments[0, 0, 0, :, 0] @ moments[0, 0, 0, :, 1]))
    assert logs[0] - logs[1] < 20.0
    assert abs(means[1] - 1.5) < 0.3
