"""Backward simulation against the smoothers that are exact: Rauch, Tung and Striebel's, and forward-backward."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.filtering.kernel_density import (
    MAX_PARTICLES,
    KernelDensity,
    kernel_density,
    last_states,
    silverman_bandwidth,
    spread_of,
    states_before,
)

F = np.array([[1.0, 1.0], [0.0, 1.0]])
"""Place and velocity over a time of 1."""
NOISE = np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
STEPS, PARTICLES = 12, 5000


def kalman(q: float, rng: np.random.Generator) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Means and covariances of a Kalman filter that sees the place with unit noise."""
    x, m, P = np.zeros(2), np.zeros(2), np.diag([4.0, 1.0])
    means, covariances = [], []
    for k in range(STEPS):
        if k:
            x = F @ x + rng.multivariate_normal(np.zeros(2), q * NOISE)
            m, P = F @ m, F @ P @ F.T + q * NOISE
        gain = P[:, :1] / (P[0, 0] + 1.0)
        m, P = m + gain[:, 0] * (x[0] + rng.standard_normal() - m[0]), P - gain @ P[:1]
        means.append(m)
        covariances.append(P)
    return means, covariances


def smoothed(means: list[np.ndarray], covariances: list[np.ndarray], q: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rauch, Tung and Striebel's smoother, last state first."""
    m, P = means[-1], covariances[-1]
    out = [(m, P)]
    for k in range(STEPS - 2, -1, -1):
        ahead = F @ covariances[k] @ F.T + q * NOISE
        G = covariances[k] @ F.T @ np.linalg.inv(ahead)
        m, P = means[k] + G @ (m - F @ means[k]), covariances[k] + G @ (P - ahead) @ G.T
        out.append((m, P))
    return out


@pytest.mark.jit
@pytest.mark.parametrize("q", [0.0, 1e-4, 0.01, 1.0])
def test_trajectories_of_a_linear_gaussian_motion_are_those_of_the_exact_smoother(q: float) -> None:
    """Also where the noise of a step is far below the distance of particles, or nothing."""
    trajectories, seeds = 400, 12
    gap, ratio = np.zeros((seeds, STEPS, 2)), np.zeros((seeds, STEPS))
    for seed in range(seeds):
        rng = np.random.default_rng([seed, round(1e4 * q)])
        means, covariances = kalman(q, rng)
        knots = []
        for m, P in zip(means, covariances, strict=True):
            cloud = rng.multivariate_normal(m, P, PARTICLES).T
            knots.append(kernel_density(cloud, np.full(PARTICLES, 1.0 / PARTICLES)))
        back, B = np.linalg.inv(F), q * np.linalg.inv(F) @ NOISE @ np.linalg.inv(F).T
        states, _ = last_states(knots[-1], trajectories, rng)
        for k, (m, P) in enumerate(smoothed(means, covariances, q)):
            if k:
                states, _ = states_before(knots[STEPS - 1 - k], back @ states, B, rng=rng)
            mean, covariance = spread_of(states)
            gap[seed, k] = np.linalg.solve(np.linalg.cholesky(P), mean - m)
            ratio[seed, k] = np.trace(np.linalg.solve(P, covariance)) / 2.0
    # A mean of 400 trajectories is within 0.05 standard deviations, that of 5000 particles within 0.014
    assert np.sqrt(np.mean(gap**2)) < 0.15
    assert np.abs(gap.mean(axis=0)).max() < 0.15
    assert_allclose(ratio.mean(axis=0), 1.0, atol=0.12)


def test_a_step_without_noise_takes_every_trajectory_straight_back() -> None:
    rng = np.random.default_rng(0)
    before = kernel_density(rng.standard_normal((4, 300)), np.full(300, 1.0 / 300))
    back = rng.standard_normal((4, 50))
    states, _ = states_before(before, back, np.zeros((4, 4)), rng=rng)
    assert_allclose(states, back, atol=1e-9)


@pytest.mark.jit
def test_kinds_are_drawn_as_forward_backward_has_them() -> None:
    """Where states tell nothing, a kind before another has its filter's probability times that of the change."""
    rng, n, M = np.random.default_rng(3), 4000, 20_000
    share, chances = 0.3, np.array([[0.9, 0.1], [0.4, 0.6]])
    kinds = (rng.random(n) < share).astype(np.int64)
    before = kernel_density(rng.standard_normal((2, n)), np.full(n, 1.0 / n), kinds, kept=n)
    after = np.repeat([0, 1], M // 2)
    _, found = states_before(before, rng.standard_normal((2, M)), 1e6 * np.eye(2), after, chances, rng=rng)
    own = np.array([1.0 - kinds.mean(), kinds.mean()])
    for k in range(2):
        expected = own * chances[:, k] / (own @ chances[:, k])
        assert found[after == k].mean() == pytest.approx(expected[1], abs=5.0 * 0.5 / np.sqrt(M / 2))


@pytest.mark.parametrize("scale", [0.05, 1.0])
def test_a_state_before_is_drawn_by_its_density_and_moved_by_the_regression_on_the_state_after(scale: float) -> None:
    """With the random numbers of the same seed: a uniform one for each trajectory, then normal ones."""
    rng, K, M, chances = np.random.default_rng(4), 25, 30, np.array([[0.9, 0.1, 0.3], [0.4, 0.6, 0.0]])
    half, B = rng.standard_normal((3, 3)), rng.standard_normal((3, 3))
    B = scale * B @ B.T
    before = kernel_density(half @ rng.standard_normal((3, K)), np.full(K, 1.0 / K), np.arange(K) % 2)
    back, after = half @ rng.standard_normal((3, M)), np.arange(M) % 3
    found, kinds = states_before(before, back, B, after, chances, rng=np.random.default_rng(9))
    same = np.random.default_rng(9)
    u, normal = same.random(M), same.standard_normal((3, M))
    S = before.width**2 * before.covariance + B
    left = B - B @ np.linalg.solve(S, B)
    values, axes = np.linalg.eigh(left)
    root = axes * np.sqrt(np.maximum(values, 0.0))
    for j in range(M):
        off = before.centres - back[:, [j]]
        half_chi2 = 0.5 * np.einsum("ik,ik->k", off, np.linalg.solve(S, off))
        weights = np.exp(-(half_chi2 - half_chi2.min())) * chances[before.kinds, after[j]]
        k = int(np.searchsorted(np.cumsum(weights) / weights.sum(), u[j], side="right"))
        assert kinds[j] == before.kinds[k]
        # The axes of equal eigenvalues may have either sign
        moved = back[:, j] + B @ np.linalg.solve(S, before.centres[:, k] - back[:, j])
        assert_allclose(np.abs(found[:, j] - moved), np.abs(root @ normal[:, j]), rtol=1e-6, atol=1e-7)


def test_a_kind_that_no_other_leads_to_follows_the_nearest() -> None:
    before = KernelDensity(np.zeros(1), np.eye(1), np.array([[0.0, 1.0, 5.0]]), 0.5, np.arange(3))
    back, after, chances = np.array([[0.9, 4.0, -1.0]]), np.ones(3, dtype=np.int64), np.eye(3)[:, [0, 0]] * [1.0, 0.0]
    assert states_before(before, back, np.eye(1), after, chances, rng=np.random.default_rng(0))[1].tolist() == [1, 2, 0]


@pytest.mark.parametrize("count", [MAX_PARTICLES - 1, MAX_PARTICLES, MAX_PARTICLES + 1, 3000])
def test_particles_that_are_kept_have_mean_and_covariance_of_all(count: int) -> None:
    rng = np.random.default_rng(count)
    weights = rng.random(count) ** 3
    weights /= weights.sum()
    cloud = rng.standard_normal((3, 3)) @ rng.standard_normal((3, count)) + 5.0
    found = kernel_density(cloud, weights)
    kept = found.centres.shape[1]
    assert kept == min(count, MAX_PARTICLES)
    mean = cloud @ weights
    covariance = ((cloud - mean[:, None]) * weights) @ (cloud - mean[:, None]).T
    assert found.width == pytest.approx(silverman_bandwidth(kept, 3))
    assert_allclose(found.centres.mean(axis=1), mean, rtol=1e-9)
    off = found.centres - mean[:, None]
    assert_allclose(off @ off.T / kept + found.width**2 * covariance, covariance, rtol=1e-9, atol=1e-12)


def test_last_states_have_mean_and_covariance_of_the_density() -> None:
    rng = np.random.default_rng(8)
    end = kernel_density(rng.standard_normal((4, 100)), np.full(100, 0.01))
    mean, covariance = spread_of(last_states(end, 200, rng)[0])
    assert_allclose(mean, end.mean, atol=1e-9)
    assert_allclose(covariance * 199 / 200, end.covariance, atol=1e-9)


def test_a_cloud_of_one_place_stays_there() -> None:
    rng = np.random.default_rng(0)
    found = kernel_density(np.full((4, 10), 2.0), np.full(10, 0.1))
    states, _ = states_before(found, np.full((4, 5), 2.0), np.zeros((4, 4)), rng=rng)
    assert_allclose(states, 2.0)
    assert_allclose(last_states(found, 7, rng)[0], 2.0)
