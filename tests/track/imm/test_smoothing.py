"""Smoothing of several motion models: steps back, and the exact smoother where the models are one and the same."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from heard_scenes import NS

from occlog.filtering.motion.coordinated_turn import acceleration_root, move, three_models
from occlog.track.methods.imm import kernel as imm
from occlog.track.methods.imm.config import ImmConfig
from occlog.track.methods.imm.tracks import Track, moved_back, noise_back, smooth_backwards, trace_of


def trace(t_ns: int, states, models):
    return trace_of(Track(0, -1, imm.ImmParticles(states, models), 1.0, 1.0, 3, t_ns), t_ns)


@pytest.mark.parametrize("dt", [0.1, 1.0, 5.0])
def test_a_step_back_undoes_a_step_under_every_model(dt: float) -> None:
    rng = np.random.default_rng(0)
    models, kinds = three_models(0.4), rng.integers(3, size=60)
    states = rng.standard_normal((60, 4))
    ahead = np.concatenate(
        [move(states[k : k + 1], models[kinds[k]], dt, np.zeros((2, 2)), np.zeros((1, 4))) for k in range(60)]
    )
    np.testing.assert_allclose(moved_back(ahead.T, kinds, models, dt).T, states, atol=1e-9)


def test_noise_moved_back_is_the_steps_noise_moved_back() -> None:
    root, inverse = acceleration_root(0.3, 0.7), np.array([[1.0, -0.7], [0.0, 1.0]])
    expected = inverse @ root @ root.T @ inverse.T
    np.testing.assert_allclose(noise_back(0.3, 0.7), np.kron(np.eye(2), expected), atol=1e-15)


@pytest.mark.jit
@pytest.mark.parametrize("sigma_v", [0.0, 0.1, 1.0])
def test_equal_models_give_the_smoother_of_rauch_tung_and_striebel(sigma_v: float) -> None:
    steps, F = 10, np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
    root = acceleration_root(sigma_v**2, 1.0)
    Q, H = np.kron(np.eye(2), root @ root.T), np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]])
    config = replace(
        ImmConfig.in_unit("m"), turn_acceleration=0.0, process_noise_velocity=sigma_v, smoothing_trajectories=400
    )
    gaps, ratios = [], []
    for seed in range(8):
        rng = np.random.default_rng([seed, round(10 * sigma_v)])
        x, m, P, kept, traces = rng.standard_normal(4), np.zeros(4), np.eye(4), [], []
        for k in range(steps):
            if k:
                x, m, P = F @ x + rng.multivariate_normal(np.zeros(4), Q), F @ m, F @ P @ F.T + Q
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + 0.25 * np.eye(2))
            m, P = m + gain @ (H @ (x - m) + 0.5 * rng.standard_normal(2)), P - gain @ H @ P
            kept.append((m, P))
            traces.append(trace(k * NS, rng.multivariate_normal(m, P, 4000), rng.integers(3, size=4000)))
        found = smooth_backwards(traces, config, rng)
        for k in range(steps - 1, -1, -1):
            if k < steps - 1:
                m0, P0 = kept[k]
                ahead = F @ P0 @ F.T + Q
                G = P0 @ F.T @ np.linalg.inv(ahead)
                m, P = m0 + G @ (m - F @ m0), P0 + G @ (P - ahead) @ G.T
            own = P[::2, ::2]
            gaps.append(np.linalg.solve(np.linalg.cholesky(own), found[k].xy - m[::2]))
            ratios.append(np.trace(np.linalg.solve(own, found[k].covariance)) / 2.0)
    assert np.sqrt(np.mean(np.square(gaps))) < 0.15
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


@pytest.mark.jit
def test_a_turn_that_shows_later_is_known_before() -> None:
    """A model that holds for long is stated by what the target does afterwards, and with it the way there."""
    config = replace(
        ImmConfig.in_unit("m"),
        turn_acceleration=0.5,
        process_noise_velocity=0.01,
        model_sojourn_s=100.0,
        smoothing_trajectories=400,
    )
    rng, models = np.random.default_rng(2), three_models(0.5)
    n, cloud = 6000, []
    states, kinds = np.tile([0.0, 1.0, 0.0, 0.0], (6000, 1)), rng.integers(3, size=n)
    traces = []
    for k in range(6):
        if k:
            for m in range(3):
                own = kinds == m
                normals = rng.standard_normal((own.sum(), 4))
                states[own] = move(states[own], models[m], 1.0, acceleration_root(1e-4, 1.0), normals)
        cloud.append(states.copy())
        traces.append(trace(k * NS, states.copy(), kinds))
    # At the end it is known that it turned to the left
    left = kinds == 2
    traces[-1] = trace(5 * NS, states[left], kinds[left])
    found = smooth_backwards(traces, config, rng)
    for k in (1, 3, 5):
        expected = cloud[k][left][:, ::2].mean(axis=0)
        assert math.dist(found[k].xy, expected) < 0.1 * max(1.0, np.ptp(cloud[k][:, 2]))
