"""The filter banks of the common error against dense Gaussian likelihoods."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from occlog.track.methods.jipda.kernels.lasting_errors.common_error import (
    MODELS,
    MOMENTS,
    OUTLIER_SHARE,
    SMALL_VARIANCE,
    STAND,
    advance_bank,
    advance_moments,
    initial_moments,
    transition_matrix,
)

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


ENTRIES = np.triu_indices(3)
"""Order of the covariances of x, v and b: xx, xv, xb, vv, vb, bb."""


def matrix(entries: np.ndarray) -> np.ndarray:
    """Symmetric (3, 3) matrix of six entries."""
    out = np.zeros((3, 3))
    out[ENTRIES] = entries
    return out + np.triu(out, 1).T


def imm_step(moments: np.ndarray, to: np.ndarray, dt: float, z: float, rho: float, outlier: float) -> tuple:
    """Log likelihood and moments (3, 10) after one step of the interacting multiple model filter, in matrices."""
    weight, means, covariances = moments[:, 0], moments[:, 1:4], [matrix(m[4:]) for m in moments]
    out, evidence, H = np.zeros((3, 10)), np.zeros(3), np.array([1.0, 0.0, 1.0])
    for a in range(3):
        share = weight * to[:, a] / (weight @ to[:, a])
        m, P = means.copy(), [C.copy() for C in covariances]
        for o in range(3):
            # Who stands has no velocity, and who begins to walk any
            if a == STAND or o == STAND:
                P[o][1], P[o][:, 1] = 0.0, 0.0
                P[o][1, 1] = SMALL_VARIANCE if a == STAND else VELOCITY
            m[o, 1] *= a != STAND
        mean = share @ m
        mixed = np.einsum("o,oij->ij", share, np.array(P)) + np.einsum("o,oi,oj->ij", share, m - mean, m - mean)
        F, Q, q = np.diag([1.0, 1.0, rho]), np.diag([DENSITY[a] * dt, 0.0, SQUARE * (1.0 - rho**2)]), DENSITY[a]
        if a != STAND:
            F[0, 1] = dt
            Q[:2, :2] = q * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        mean, P = F @ mean, F @ mixed @ F.T + Q
        S, off = H @ P @ H + NOISE, z - H @ mean
        parts = np.array([1.0 - OUTLIER_SHARE, OUTLIER_SHARE])
        parts *= norm.pdf(off, 0.0, np.sqrt([S, S + outlier]))
        evidence[a] = weight @ to[:, a] * parts.sum()
        p, K = parts[0] / parts.sum(), P @ H / S
        # Mixture of the updated and the predicted Gaussian
        C = P - p * S * np.outer(K, K) + p * (1.0 - p) * off**2 * np.outer(K, K)
        out[a] = [evidence[a], *(mean + p * K * off), *C[ENTRIES]]
    out[:, 0] /= evidence.sum()
    return np.log(evidence.sum()), out


@pytest.mark.parametrize("z", [2.3, 9.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_step_is_that_of_an_interacting_multiple_model_filter(seed: int, z: float) -> None:
    rng = np.random.default_rng(seed)
    half = 0.3 * rng.normal(size=(3, 3, 3))
    covariance = half @ half.transpose(0, 2, 1)
    moments = np.column_stack([rng.dirichlet(np.ones(3)), rng.normal(2.0, 0.3, (3, 3)), covariance[:, *ENTRIES]])
    to = rng.dirichlet(np.ones(3), 3)
    log, wanted = imm_step(moments, to, 0.4, z, 0.7, 1.0)
    got = advance_moments(moments, to, 0.4, DENSITY, z, NOISE, SQUARE, 0.7, VELOCITY, 1.0)
    assert got == pytest.approx(log)
    np.testing.assert_allclose(moments, wanted, rtol=1e-9)


def test_a_position_beyond_all_likelihoods_moves_nothing_and_costs_300_decades() -> None:
    moments, to = np.zeros((MODELS, MOMENTS)), np.full((3, 3), 1.0 / 3.0)
    initial_moments(moments, 1.0, NOISE, SQUARE, VELOCITY)
    np.testing.assert_array_equal(moments[:, 0], [0.4, 0.5, 0.1])
    for a in range(MODELS):
        variance = SMALL_VARIANCE if a == STAND else VELOCITY
        wanted = [1.0, 0.0, 0.0, NOISE + SQUARE, 0.0, -SQUARE, variance, 0.0, SQUARE]
        np.testing.assert_array_equal(moments[a, 1:], wanted)
    got = advance_moments(moments, to, 0.5, DENSITY, 1e9, NOISE, SQUARE, 0.7, VELOCITY, 1.0)
    assert got == pytest.approx(np.log(1e-300) - 0.5 * np.log(2.0 * np.pi))
    np.testing.assert_allclose(moments[:, 0], 1.0 / 3.0)
    assert (moments[:, 1] < 2.0).all()


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
    np.testing.assert_allclose(out, np.linalg.matrix_power(np.eye(3) + generator * 0.5 / 16.0, 16), rtol=1e-12)
    # Rates so fast that a step of a sixteenth would leave a model more often than always
    transition_matrix(100.0 * rates, 10.0, out)
    assert (out >= 0.0).all()


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
