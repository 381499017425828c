"""Kalman filters in blocks against the textbook's, and what they give in the reference world."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.filtering.motion.white_acceleration import concat, initiate, predict, select, update


def textbook(measurements, noises, steps, q: float, speed: float):
    """State [x y vx vy] with full matrices, one object; means and covariances after each measurement."""
    mean = np.array([*measurements[0], 0.0, 0.0])
    cov = np.zeros((4, 4))
    cov[:2, :2], cov[2:, 2:] = noises[0], speed**2 * np.eye(2)
    C = np.eye(2, 4)
    out = [(mean, cov)]
    for z, R, dt in zip(measurements[1:], noises[1:], steps, strict=True):
        A = np.kron(np.array([[1.0, dt], [0.0, 1.0]]), np.eye(2))
        Q = np.kron(q**2 * np.array([[dt**3 / 4, dt**2 / 2], [dt**2 / 2, dt]]), np.eye(2))
        mean, cov = A @ mean, A @ cov @ A.T + Q
        K = cov @ C.T @ np.linalg.inv(C @ cov @ C.T + R)
        mean, cov = mean + K @ (z - C @ mean), (np.eye(4) - K @ C) @ cov
        out.append((mean, cov))
    return out


@pytest.mark.parametrize("seed", range(5))
def test_blocks_against_textbook(seed: int) -> None:
    rng = np.random.default_rng(seed)
    M, n, q = 3, 20, rng.uniform(0.1, 3.0)
    steps = rng.uniform(0.01, 2.0, n - 1)
    z = rng.normal(0, 10, (n, M, 2))
    half = rng.normal(0, 1, (n, M, 2, 2))
    R = half @ half.swapaxes(2, 3) + 0.1 * np.eye(2)
    walkers = initiate(z[0], R[0], 2.0)
    for k in range(1, n):
        walkers = update(predict(walkers, steps[k - 1], q), z[k], R[k])
        for m in range(M):
            mean, cov = textbook(z[: k + 1, m], R[: k + 1, m], steps[:k], q, 2.0)[-1]
            assert np.allclose([*walkers.xy[m], *walkers.velocity[m]], mean, rtol=1e-9, atol=1e-9)
            got = np.block([[walkers.cov[m], walkers.cross[m]], [walkers.cross[m].T, walkers.cov_velocity[m]]])
            assert np.allclose(got, cov, rtol=1e-8, atol=1e-8)


def test_unit_step_is_the_reference_scenes() -> None:
    """At dt = 1, Q = q^2 [1/4 1/2; 1/2 1] per axis."""
    none = np.zeros((1, 2, 2))
    w = predict(initiate(np.zeros((1, 2)), none, 0.0), 1.0, 1.2)
    for axis in range(2):
        got = [w.cov[0, axis, axis], w.cross[0, axis, axis], w.cov_velocity[0, axis, axis]]
        assert got == pytest.approx([1.44 / 4, 1.44 / 2, 1.44])


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 10.0), st.floats(1e-2, 10.0))
def test_covariances_stay_positive(r: float, dt: float, q: float) -> None:
    rng = np.random.default_rng(0)
    w = initiate(np.zeros((1, 2)), r * np.eye(2)[None], 1.0)
    for _ in range(50):
        w = update(predict(w, dt, q), rng.normal(size=(1, 2)), r * np.eye(2)[None])
        whole = np.block([[w.cov[0], w.cross[0]], [w.cross[0].T, w.cov_velocity[0]]])
        values = np.linalg.eigvalsh(whole)
        assert values[0] > -1e-9 * values[-1]


def test_take_and_join_are_inverse() -> None:
    w = initiate(np.arange(8.0).reshape(4, 2), np.tile(np.eye(2), (4, 1, 1)), 1.0)
    again = concat(select(w, np.array([0, 1])), select(w, np.array([2, 3])))
    assert all(np.array_equal(a, b) for a, b in zip(w, again, strict=True))
