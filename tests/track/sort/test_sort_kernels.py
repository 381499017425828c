"""Kernels of method `sort` against their textbook forms."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.track.methods.sort.kernels.boxes import (
    boxes_of,
    inside_shares,
    overlaps,
    states_of,
    visible_shares,
)
from occlog.track.methods.sort.kernels.motion import predicted, smooth, updated


def test_states_and_boxes_are_inverse() -> None:
    boxes = np.array([[10.0, 20.0, 30.0, 80.0], [-5.0, 0.0, 45.0, 100.0]])
    np.testing.assert_allclose(boxes_of(states_of(boxes)), boxes, atol=1e-9)
    np.testing.assert_allclose(states_of(boxes)[0], [20.0, 50.0, np.log(60.0), 1.0 / 3.0])


def test_overlaps_by_hand() -> None:
    a = np.array([[0.0, 0.0, 10.0, 10.0]])
    b = np.array([[5.0, 0.0, 15.0, 10.0], [0.0, 0.0, 10.0, 10.0], [20.0, 0.0, 30.0, 10.0]])
    np.testing.assert_allclose(overlaps(a, b), [[1.0 / 3.0, 1.0, 0.0]])


def test_who_stands_nearer_hides_and_is_not_hidden() -> None:
    far, near = [0.0, 0.0, 10.0, 100.0], [5.0, 50.0, 15.0, 200.0]
    visible = visible_shares(np.array([far, near]), np.ones(2))
    np.testing.assert_allclose(visible, [0.75, 1.0], atol=1e-6)
    np.testing.assert_allclose(visible_shares(np.array([far, near]), np.zeros(2)), [1.0, 1.0])


def test_share_in_the_image() -> None:
    boxes = np.array([[-10.0, 0.0, 10.0, 10.0], [0.0, 0.0, 5.0, 5.0], [200.0, 0.0, 210.0, 10.0]])
    np.testing.assert_allclose(inside_shares(boxes, (100.0, 100.0)), [0.5, 1.0, 0.0])


def textbook(
    times: Floats, seen: np.ndarray, z: Floats, noise: Floats, q: float, speed: float
) -> tuple[Floats, Floats]:
    """Posterior of all states at once: the normal equations of the whole path, one coordinate."""
    n = len(times)
    information, vector = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    information[1, 1] += 1.0 / speed
    for k in range(n):
        if seen[k]:
            information[2 * k, 2 * k] += 1.0 / noise[k]
            vector[2 * k] += z[k] / noise[k]
        if k:
            dt = times[k] - times[k - 1]
            weight = np.linalg.inv(q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
            step = np.hstack([-np.array([[1.0, dt], [0.0, 1.0]]), np.eye(2)])
            information[2 * k - 2 : 2 * k + 2, 2 * k - 2 : 2 * k + 2] += step.T @ weight @ step
    cov = np.linalg.inv(information)
    return (cov @ vector).reshape(n, 2), cov


def test_the_smoother_is_the_least_squares_path() -> None:
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.1, 0.4, 9))
    seen = np.array([1, 1, 0, 1, 0, 0, 1, 1, 1], dtype=np.bool_)
    z, noise = rng.normal(size=(9, 2)), rng.uniform(0.1, 0.5, (9, 2))
    q, speed = np.array([0.3, 0.02]), np.array([0.5, 0.1])
    mean, cov = smooth(times, seen, z, noise, q, speed)
    for d in range(2):
        want, full = textbook(times, seen, z[:, d], noise[:, d], q[d], speed[d])
        np.testing.assert_allclose(mean[:, d], want, rtol=1e-7, atol=1e-9)
        for k in range(9):
            block = full[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
            np.testing.assert_allclose(cov[k, d], [block[0, 0], block[0, 1], block[1, 1]], rtol=1e-6)


def test_prediction_and_update_are_those_of_matrices() -> None:
    cov = np.array([[2.0, 0.3, 0.5]])
    full = np.array([[2.0, 0.3], [0.3, 0.5]])
    dt, q = 0.4, 0.2
    step = np.array([[1.0, dt], [0.0, 1.0]])
    want = step @ full @ step.T + q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    got = predicted(cov, np.array([q]), dt)
    np.testing.assert_allclose(got[0], [want[0, 0], want[0, 1], want[1, 1]])
    mean, after = updated(np.array([[1.0, 2.0]]), cov, np.array([1.5]), np.array([0.7]))
    gain = full[:, 0] / (full[0, 0] + 0.7)
    np.testing.assert_allclose(mean[0], np.array([1.0, 2.0]) + gain * 0.5)
    kept = full - np.outer(gain, full[0])
    np.testing.assert_allclose(after[0], [kept[0, 0], kept[0, 1], kept[1, 1]])
