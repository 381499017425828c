"""The posterior bound against independent forms: Kalman filter, batch information, literal recursion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.array_types import Floats
from occlog.core.bounds import in_plane as crlb


def random_problem(seed: int, n: int, steps: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Information, F, Q, P0 of a random system with position-only measurements that are missing at times."""
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(steps, 2, n))
    seen = rng.random((steps, 2)) < 0.6
    information = np.einsum("tki,tkj->tij", H * seen[:, :, None], H * seen[:, :, None])
    F = np.eye(n) + 0.3 * rng.normal(size=(steps, n, n))
    root = rng.normal(size=(steps, n, n))
    Q = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n)
    return information, F, Q, np.eye(n) * rng.uniform(0.5, 5.0)


def kalman_covariances(H: Floats, R: Floats, F: Floats, Q: Floats, P0: Floats) -> Floats:
    """Covariances of the textbook Kalman filter (gain form), an independent path to the linear bound."""
    P, out = P0, []
    for k in range(len(F)):
        P = F[k] @ P @ F[k].T + Q[k]
        S = H[k] @ P @ H[k].T + R[k]
        K = P @ H[k].T @ np.linalg.inv(S)
        A = np.eye(len(P)) - K @ H[k]
        P = A @ P @ A.T + K @ R[k] @ K.T  # Joseph form
        out.append(P)
    return np.array(out)


def batch_bound(information: Floats, F: Floats, Q: Floats, P0: Floats) -> Floats:
    """Last block of the inverse of the information matrix of the whole trajectory, prior point included."""
    steps, n = information.shape[0], P0.shape[0]
    J = np.zeros(((steps + 1) * n,) * 2)
    J[:n, :n] = np.linalg.inv(P0)
    for k in range(steps):
        a, b = slice(k * n, (k + 1) * n), slice((k + 1) * n, (k + 2) * n)
        W = np.linalg.inv(Q[k])
        J[a, a] += F[k].T @ W @ F[k]
        J[a, b] -= F[k].T @ W
        J[b, a] -= W @ F[k]
        J[b, b] += W + information[k]
    return np.linalg.inv(J)[-n:, -n:]


def full_information(information: Floats, F: Floats, Q: Floats, P0: Floats) -> Floats:
    """Diagonal blocks of the inverse of the information matrix of the whole trajectory, without the prior point."""
    steps, n = information.shape[0], P0.shape[0]
    J = np.zeros(((steps + 1) * n,) * 2)
    J[:n, :n] = np.linalg.inv(P0)
    for k in range(steps):
        both = slice(k * n, (k + 2) * n)
        A = np.hstack([-F[k], np.eye(n)])
        J[both, both] += A.T @ np.linalg.inv(Q[k]) @ A
        J[(k + 1) * n : (k + 2) * n, (k + 1) * n : (k + 2) * n] += information[k]
    whole = np.linalg.inv(J)
    return np.array([whole[k * n : (k + 1) * n, k * n : (k + 1) * n] for k in range(1, steps + 1)])


def rts_covariances(filtered: Floats, F: Floats, Q: Floats) -> Floats:
    """Covariances of the textbook Rauch-Tung-Striebel smoother, from those of the Kalman filter."""
    out = filtered.copy()
    for k in range(len(F) - 2, -1, -1):
        M = F[k + 1] @ filtered[k] @ F[k + 1].T + Q[k + 1]
        G = filtered[k] @ F[k + 1].T @ np.linalg.inv(M)
        out[k] = filtered[k] + G @ (out[k + 1] - M) @ G.T
    return out


def literal_recursion(information: Floats, F: Floats, Q: Floats, P0: Floats) -> Floats:
    """Tichavsky's recursion in the form that it is printed in."""
    J, out = np.linalg.inv(P0), []
    for k in range(len(F)):
        W = np.linalg.inv(Q[k])
        D11, D12, D22 = F[k].T @ W @ F[k], -F[k].T @ W, W
        J = D22 - D12.T @ np.linalg.inv(J + D11) @ D12 + information[k]
        out.append(np.linalg.inv(J))
    return np.array(out)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_equals_the_kalman_filter_when_all_is_linear(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    _, F, Q, P0 = random_problem(seed, n, 30)
    H = rng.normal(size=(30, 3, n))
    R = np.einsum("t,ij->tij", rng.uniform(0.1, 2.0, 30), np.eye(3))
    information = np.einsum("tki,tkl,tlj->tij", H, np.linalg.inv(R), H)
    bound = crlb.posterior_bound(information, F, Q, P0)
    np.testing.assert_allclose(bound, kalman_covariances(H, R, F, Q, P0), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n", [2, 4])
def test_equals_the_printed_recursion_and_the_batch_inverse(seed: int, n: int) -> None:
    problem = random_problem(seed, n, 12)
    bound = crlb.posterior_bound(*problem)
    np.testing.assert_allclose(bound, literal_recursion(*problem), rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(bound[-1], batch_bound(*problem), rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("cut", [1, 5, 11])
@pytest.mark.parametrize("n", [2, 4])
def test_trajectories_in_two_pieces_have_the_bounds_of_whole_ones(n: int, cut: int) -> None:
    information, F, Q, P0 = random_problem(3, n, 12)
    filtered, smoothed = (bound(information, F, Q, P0) for bound in (crlb.posterior_bound, crlb.smoothing_bound))
    (I0, I1), (F0, F1), (Q0, Q1) = ((a[:cut], a[cut:]) for a in (information, F, Q))
    first = crlb.posterior_bound(I0, F0, Q0, P0)
    second = crlb.posterior_bound(I1, F1, Q1, first[-1])
    np.testing.assert_array_equal(np.concatenate([first, second]), filtered)
    after, reported = crlb.smoothing_bound_before(second, I1, F1, Q1, np.zeros((n, n)))
    before, _ = crlb.smoothing_bound_before(first, I0, F0, Q0, reported)
    np.testing.assert_array_equal(np.concatenate([before, after]), smoothed)


def test_arguments_are_not_changed() -> None:
    problem = random_problem(0, 2, 5)
    copies = [a.copy() for a in problem]
    crlb.posterior_bound(*problem)
    for a, b in zip(problem, copies, strict=True):
        np.testing.assert_array_equal(a, b)


def test_no_steps() -> None:
    empty = np.zeros((0, 2, 2))
    assert crlb.posterior_bound(empty, empty, empty, np.eye(2)).shape == (0, 2, 2)


def test_static_target_without_noise_adds_information() -> None:
    # (1 + 3 * 4)^-1: prior 1 and three measurements of information 4; Q = 0 cannot be inverted
    steps = np.broadcast_to(4.0 * np.eye(2), (3, 2, 2))
    F, Q = crlb.known_drift_steps(np.zeros(3), 0.33)
    np.testing.assert_allclose(crlb.posterior_bound(steps, F, Q, np.eye(2))[-1], np.eye(2) / 13.0)


def test_known_start_is_allowed() -> None:
    # P0 = 0: after one step only the noise of the motion, 0.25 * 4 s = 1, then (1 + 1)^-1
    F, Q = crlb.known_drift_steps(np.array([4.0]), 0.5)
    bound = crlb.posterior_bound(np.eye(2)[None], F, Q, np.zeros((2, 2)))
    np.testing.assert_allclose(bound[0], np.eye(2) / 2.0)


def test_without_measurements_the_walk_spreads_by_its_time() -> None:
    dt = np.array([0.5, 0.25, 3.0])
    F, Q = crlb.known_drift_steps(dt, 2.0)
    bound = crlb.posterior_bound(np.zeros((3, 2, 2)), F, Q, np.eye(2))
    np.testing.assert_allclose(bound[:, 0, 0], 1.0 + 4.0 * np.cumsum(dt))


@pytest.mark.parametrize("steps", [crlb.known_drift_steps, crlb.constant_velocity_steps])
def test_two_steps_without_measurement_equal_one(steps) -> None:
    n = 2 if steps is crlb.known_drift_steps else 4
    P0 = np.diag(np.arange(1.0, n + 1))
    two = crlb.posterior_bound(np.zeros((2, n, n)), *steps(np.array([0.3, 1.1]), 0.7), P0)[-1]
    one = crlb.posterior_bound(np.zeros((1, n, n)), *steps(np.array([1.4]), 0.7), P0)[-1]
    np.testing.assert_allclose(two, one, rtol=1e-12)


def test_constant_velocity_moves_each_axis_by_its_own_velocity() -> None:
    F, Q = crlb.constant_velocity_steps(np.array([2.0]), 3.0)
    np.testing.assert_array_equal(F[0] @ [1.0, 10.0, 5.0, -7.0], [11.0, -4.0, 5.0, -7.0])
    np.testing.assert_allclose(Q[0][np.ix_([0, 2], [0, 2])], 3.0 * np.array([[8 / 3, 2], [2, 2]]))
    assert Q[0][0, 1] == Q[0][0, 3] == Q[0][2, 3] == 0.0


@given(st.integers(0, 10_000))
def test_more_information_never_raises_the_bound(seed: int) -> None:
    information, F, Q, P0 = random_problem(seed, 2, 8)
    g = np.random.default_rng(seed + 1).normal(size=2)
    more = information.copy()
    more[seed % 8] += np.outer(g, g)
    gain = crlb.posterior_bound(information, F, Q, P0) - crlb.posterior_bound(more, F, Q, P0)
    assert np.linalg.eigvalsh(gain).min() >= -1e-9


def test_linear_in_time_and_steady_on_long_runs() -> None:
    F, Q = crlb.known_drift_steps(np.ones(20_000), 0.33)
    bound = crlb.posterior_bound(np.broadcast_to(np.eye(2), (20_000, 2, 2)), F, Q, 1e6 * np.eye(2))
    # Steady state of p = (1/(p + q) + 1)^-1
    q = 0.33**2
    p = (-q + np.sqrt(q**2 + 4 * q)) / 2
    np.testing.assert_allclose(bound[-1], p * np.eye(2), rtol=1e-12)


def test_polygon_covariance_of_simple_shapes() -> None:
    square = np.array([[0.0, 0], [100, 0], [100, 100], [0, 100]]) + 500.0
    np.testing.assert_allclose(crlb.polygon_covariance(square), np.eye(2) * 100**2 / 12, atol=1e-9)
    np.testing.assert_allclose(crlb.polygon_covariance(square[::-1]), np.eye(2) * 100**2 / 12, atol=1e-9)
    triangle = np.array([[0.0, 0], [1, 0], [0, 1]])
    np.testing.assert_allclose(crlb.polygon_covariance(triangle), [[1 / 18, -1 / 36], [-1 / 36, 1 / 18]])


def test_polygon_covariance_of_the_l_shaped_room() -> None:
    room = np.array([[0.0, 0], [160, 0], [160, 53], [53, 53], [53, 160], [0, 160]])
    # By parts: the 160 x 53 bar below and the 53 x 107 bar above it
    parts = [(160 * 53, (80, 26.5), (160, 53)), (53 * 107, (26.5, 106.5), (53, 107))]
    weight = np.array([p[0] for p in parts]) / sum(p[0] for p in parts)
    centre = np.array([p[1] for p in parts])
    mean = weight @ centre
    expected = sum(
        w * (np.diag(np.square(size) / 12) + np.outer(c - mean, c - mean))
        for w, c, (_, _, size) in zip(weight, centre, parts, strict=True)
    )
    np.testing.assert_allclose(crlb.polygon_covariance(room), expected, rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_bound_of_smoothing_is_the_rts_smoother_when_all_is_linear(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    _, F, Q, P0 = random_problem(seed, n, 30)
    H = rng.normal(size=(30, 3, n))
    R = np.einsum("t,ij->tij", rng.uniform(0.1, 2.0, 30), np.eye(3))
    information = np.einsum("tki,tkl,tlj->tij", H, np.linalg.inv(R), H)
    expected = rts_covariances(kalman_covariances(H, R, F, Q, P0), F, Q)
    np.testing.assert_allclose(crlb.smoothing_bound(information, F, Q, P0), expected, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("n", [2, 4])
def test_bound_of_smoothing_is_the_inverse_of_the_whole_information(seed: int, n: int) -> None:
    problem = random_problem(seed, n, 12)
    np.testing.assert_allclose(crlb.smoothing_bound(*problem), full_information(*problem), rtol=1e-6, atol=1e-9)


def test_bound_of_smoothing_is_never_above_that_of_filtering_and_ends_with_it() -> None:
    problem = random_problem(3, 4, 40)
    filtered, smoothed = crlb.posterior_bound(*problem), crlb.smoothing_bound(*problem)
    assert np.linalg.eigvalsh(filtered - smoothed).min() > -1e-9
    np.testing.assert_allclose(smoothed[-1], filtered[-1])


def test_a_random_walk_seen_long_enough_has_the_bounds_of_the_textbook() -> None:
    # Scalar: P = M / (1 + M), M = P + q, with q = 2: M = 1 + sqrt(3), P = M - q; smoothed P M / (P + M)
    T = 200
    bound = crlb.smoothing_bound(np.ones((T, 1, 1)), np.ones((T, 1, 1)), np.full((T, 1, 1), 2.0), np.eye(1))
    M = 1.0 + np.sqrt(3.0)
    P = M - 2.0
    # The past tells 1/P, the future 1/M of the state at a step in the middle
    assert bound[T // 2, 0, 0] == pytest.approx(1.0 / (1.0 / P + 1.0 / M))


def test_a_target_that_stands_has_one_bound_at_all_steps_when_it_is_smoothed() -> None:
    reported, none = np.tile(np.diag([4.0, 1.0]), (5, 1, 1)), np.zeros((5, 2, 2))
    F = np.tile(np.eye(2), (5, 1, 1))
    smoothed = crlb.smoothing_bound(reported, F, none, np.eye(2))
    np.testing.assert_allclose(smoothed, np.tile(np.diag([1 / 21, 1 / 6]), (5, 1, 1)))
    # What is known for certain stays so
    np.testing.assert_allclose(crlb.smoothing_bound(reported, F, none, np.diag([1.0, 0.0]))[:, 1, 1], 0.0)


@pytest.mark.parametrize("size", [1e3, 1e18, 1e27])
def test_one_sensor_after_a_gap_of_years_leaves_a_bound(size: float) -> None:
    """A bearing tells one direction of a place that is hardly known; the other stays as it was."""
    along = np.array([0.6, 0.8])
    found = crlb.inverse_of_sum(size * np.eye(2), 1e4 * np.outer(along, along))
    across = np.array([-0.8, 0.6])
    assert along @ found @ along == pytest.approx(1e-4, rel=1e-6)
    assert min(size, 1e6) * 0.999 < across @ found @ across < size * 1.001


def test_a_constant_velocity_after_a_gap_of_years_has_a_bound() -> None:
    """What was seen before the gap tells nothing of the first place after it."""
    dt, one = np.array([0.0, 0.1, 3e8, 0.1, 0.1]), np.outer([1.0, 1.0], [1.0, 1.0])
    F, Q = crlb.constant_velocity_steps(dt, 1.0)
    information = np.zeros((5, 4, 4))
    information[:, :2, :2] = 1e4 * (np.diag([0.5, 1.0]) + 0.4 * one)
    P0 = np.diag([9.0, 9.0, 1.0, 1.0])
    place = np.linalg.inv(information[2, :2, :2])
    for found in (crlb.posterior_bound(information, F, Q, P0), crlb.smoothing_bound(information, F, Q, P0)):
        assert (np.linalg.eigvalsh(found) > 0.0).all()
        assert (np.diagonal(found[2, :2, :2]) <= np.diagonal(place) * 1.001).all()
