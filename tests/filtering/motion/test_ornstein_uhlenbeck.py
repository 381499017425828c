"""The Ornstein-Uhlenbeck motion against the matrix exponential, and the smoother against the joint Gaussian."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from occlog.filtering.gaussian import Gaussian, PosteriorRecord, predicted, rts_smooth
from occlog.filtering.motion.ornstein_uhlenbeck import SMALL, OrnsteinUhlenbeck

MOTION = OrnsteinUhlenbeck(speed=1.0, turn_s=10.0, sigma_v=0.33)


def van_loan(dt: float, motion: OrnsteinUhlenbeck) -> tuple[np.ndarray, np.ndarray]:
    """F and Q of dx = v dt + sigma_v dw, dv = -v / tau dt + s dw' by the matrix exponential (Van Loan 1978)."""
    A = np.kron(np.array([[0.0, 1.0], [0.0, -1.0 / motion.turn_s]]), np.eye(2))
    noise = np.kron(np.diag([motion.sigma_v**2, motion.speed**2 / motion.turn_s]), np.eye(2))
    whole = expm(np.block([[-A, noise], [np.zeros((4, 4)), A.T]]) * dt)
    F = whole[4:, 4:].T
    return F, F @ whole[:4, 4:]


@pytest.mark.parametrize("share", [0.0, 1e-4, 0.999 * SMALL, 1.001 * SMALL, 0.1, 1.0, 5.0])
def test_the_motion_is_that_of_its_differential_equation_at_any_step(share: float) -> None:
    motion = OrnsteinUhlenbeck(speed=1.3, turn_s=4.0, sigma_v=0.2)
    F, Q = motion.transition(share * motion.turn_s)
    F2, Q2 = van_loan(share * motion.turn_s, motion)
    np.testing.assert_allclose(F, F2, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(Q, Q2, rtol=1e-7, atol=1e-14)


def test_two_steps_are_one_of_their_length() -> None:
    state = Gaussian(np.array([1.0, 2.0, 0.5, -0.2]), np.diag([2.0, 1.0, 0.3, 0.4]))
    once = predicted(state, *MOTION.transition(3.0))
    twice = predicted(predicted(state, *MOTION.transition(1.2)), *MOTION.transition(1.8))
    np.testing.assert_allclose(twice.mean, once.mean)
    np.testing.assert_allclose(twice.covariance, once.covariance)


def test_the_smoother_is_the_joint_gaussian_given_all_measurements() -> None:
    """Four places measured with noise 1: the joint precision of all states, solved at once."""
    motion, times, rng = MOTION._replace(turn_s=3.0), [0.0, 1.0, 1.5, 4.0], np.random.default_rng(0)
    prior = Gaussian(np.zeros(4), np.diag([9.0, 9.0, 0.5, 0.5]))
    z, H = rng.normal(0.0, 3.0, (4, 2)), np.eye(2, 4)
    traces, state = [], prior
    precision, vector = np.zeros((16, 16)), np.zeros(16)
    precision[:4, :4] += np.linalg.inv(prior.covariance)
    for k, t in enumerate(times):
        dt = t - times[k - 1] if k else 0.0
        if k:
            F, Q = motion.transition(dt)
            state = predicted(state, F, Q)
            rows = np.zeros((4, 16))
            rows[:, 4 * k - 4 : 4 * k], rows[:, 4 * k : 4 * k + 4] = F, -np.eye(4)
            precision += rows.T @ np.linalg.inv(Q) @ rows
        gain = state.covariance @ H.T @ np.linalg.inv(H @ state.covariance @ H.T + np.eye(2))
        left = np.eye(4) - gain @ H
        state = Gaussian(state.mean + gain @ (z[k] - H @ state.mean), left @ state.covariance)
        precision[4 * k : 4 * k + 2, 4 * k : 4 * k + 2] += np.eye(2)
        vector[4 * k : 4 * k + 2] += z[k]
        traces.append(PosteriorRecord(state, dt, begun=k == 0))
    covariance = np.linalg.inv(precision)
    mean = (covariance @ vector).reshape(4, 4)
    for k, past in enumerate(rts_smooth(traces, motion.transition)):
        np.testing.assert_allclose(past.mean, mean[k], atol=1e-9)
        np.testing.assert_allclose(past.covariance, covariance[4 * k : 4 * k + 4, 4 * k : 4 * k + 4], atol=1e-9)


def test_nothing_goes_back_beyond_a_new_beginning() -> None:
    one = PosteriorRecord(Gaussian(np.zeros(4), np.eye(4)), 0.0, begun=True)
    other = PosteriorRecord(Gaussian(np.full(4, 50.0), np.eye(4)), 0.0, begun=True)
    assert rts_smooth([one, other], MOTION.transition)[0].mean.tolist() == [0.0] * 4
