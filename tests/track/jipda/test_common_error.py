"""The common error of position: what is learned of it, and what the filter and the smoother make of it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from occlog.track.methods.jipda.batch.positions import DIFFUSE_SIGMA_M, smoothed_positions
from occlog.track.methods.jipda.batch.states import States
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.lasting_errors.common_error import (
    common_error,
    new_variance,
    prior_common_error,
    update_common_error,
)
from occlog.track.methods.jipda.target_set import tentative_targets

pytestmark = pytest.mark.jit


def walks(people: int, steps: int, dt: float, rng: np.random.Generator) -> np.ndarray:
    """(T, n, 2) positions of people of whom half stand, and half walk with a heading that drifts."""
    speed, heading = np.where(np.arange(people) < people // 2, 0.0, 1.2), rng.uniform(-np.pi, np.pi, people)
    out, xy = np.empty((steps, people, 2)), rng.uniform(0.0, 20.0, (people, 2))
    for t in range(steps):
        out[t] = xy
        heading = heading + rng.normal(0.0, 0.1 * np.sqrt(dt), people)
        xy = xy + dt * speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    return out


@pytest.mark.parametrize(
    ("sigma", "tau", "low", "high"), [(0.0, 1.0, 0.0, 0.02), (0.08, 1.0, 0.05, 0.1), (0.12, 3.0, 0.075, 0.15)]
)
def test_standard_deviation_of_the_common_error_is_learned(sigma, tau, low, high):
    """40 people for 60 s.

    Over ten seeds the estimates have means of 0.007, 0.060 and 0.088 m, and standard deviations below 0.005 m: a
    quarter of a lasting error is taken for the walk.
    """
    rng, dt, white = np.random.default_rng(5), 0.5, 0.03
    known, config = prior_common_error(1.0), JipdaConfig()
    error = rng.normal(0.0, sigma, (40, 2)) if sigma else np.zeros((40, 2))
    rho = np.exp(-dt / tau)
    for t, xy in enumerate(walks(40, 120, dt, rng)):
        z = xy + error + rng.normal(0.0, white, xy.shape)
        known = update_common_error(
            known, round(t * dt * 1e9), key=np.arange(40), position=z, noise=np.full(40, white**2), config=config
        )
        if sigma:
            error = rho * error + np.sqrt(1.0 - rho * rho) * rng.normal(0.0, sigma, error.shape)
    square, _ = common_error(known)
    assert low <= np.sqrt(square) <= high


def test_people_who_are_lost_for_long_begin_again_and_the_missing_are_dropped():
    known, config = prior_common_error(1.0), JipdaConfig()
    at = np.array([[0.0, 0.0], [5.0, 5.0]])
    for t_s, key, position in (
        (0.0, [3, 7], at),
        (0.5, [3, 7], np.array([[0.0, 0.0], [np.nan, np.nan]])),
        (1.0, [7], at[1:]),
    ):
        known = update_common_error(
            known, round(t_s * 1e9), key=np.array(key), position=position, noise=np.full(len(key), 1e-3), config=config
        )
    assert known.key.tolist() == [7]
    assert known.t_ns.tolist() == [1_000_000_000]


def test_a_new_track_has_the_common_error_in_its_position_but_not_in_its_body():
    people = tentative_targets(np.zeros((1, 6)), np.eye(6)[None], np.ones(1), np.ones(1), 0, 0, 0.04)
    np.testing.assert_allclose(people.covariance[0, :2, :2], 1.04 * np.eye(2))
    np.testing.assert_allclose(people.body_covariance[0], np.eye(6))


def test_new_part_of_the_error_is_all_of_it_if_it_is_white_and_none_if_it_stays():
    assert new_variance((0.01, 1e-3), 1.0) == pytest.approx(0.01)
    assert new_variance((0.01, 1e6), 1.0) == pytest.approx(1e-8, rel=1e-3)


def test_smoothed_positions_are_those_of_the_dense_posterior():
    """One track over five time steps, without a position at the third, against its joint Gaussian."""
    rng, T = np.random.default_rng(2), 5
    time = np.array([0.0, 0.5, 1.1, 1.4, 2.0])
    node = np.array([0, 1, -1, 2, 3])
    q, prior = np.array([0.2, 1e-4, 1e-4]), np.array([0.0, 0.0, 1.2, 1.2, 70.0, 70.0])
    mean_of_new, own, square = np.array([0.0, 0.0, 0.0, 0.0, 1.7, 0.5]), np.array([0.01, 0.002, 0.02, 0.003]), 0.005
    common, wide = (0.05, 0.8), 1.0
    A = rng.normal(size=(4, 6, 6))
    J = A @ A.transpose(0, 2, 1) * np.array([30.0, 30.0, 0.1, 0.1, 50.0, 50.0]) ** 0.5
    J = 0.5 * (J + J.transpose(0, 2, 1)) + 20.0 * np.eye(6)
    h = np.einsum("nij,nj->ni", J, rng.normal(size=(4, 6)) * 0.2 + np.array([1.0, 2.0, 0.0, 0.0, 1.7, 0.5]))
    at = np.array([1.0, 2.0])
    last = np.array([-1, 0, 1, 1, 2])
    walk = States(
        track=np.zeros(T, np.int64), step=np.arange(T), head=np.zeros(T, np.int64), node=node, last=last,
        next=np.full(T, -1), mean=np.zeros((T, 6)), covariance=np.zeros((T, 6, 6)),
    )  # fmt: skip
    tracks = SimpleNamespace(
        J=J,
        h=h,
        nodes=SimpleNamespace(at=np.tile(at, (4, 1))),
        chain=SimpleNamespace(model=np.zeros(4, np.int64)),
        walk=SimpleNamespace(drift=np.tile(q, (3, 1)), mean=mean_of_new, prior=prior),
    )
    span = SimpleNamespace(time=time, metre=1.0)
    mean, covariance = smoothed_positions(walk, tracks, span, own, square, common, wide)
    # Dense: the states of all time steps, the common errors and the displacements, as one Gaussian
    n = 6 + 2 + 2
    F, Q = np.zeros((T, n, n)), np.zeros((T, n, n))
    for t in range(1, T):
        dt = time[t] - time[t - 1]
        F[t, :6, :6] = np.eye(6)
        F[t, 0, 2] = F[t, 1, 3] = dt
        rho = np.exp(-dt / common[1])
        for a in range(2):
            Q[t, a, a], Q[t, a + 2, a + 2] = q[0] * dt**3 / 3.0, q[0] * dt
            Q[t, a, a + 2] = Q[t, a + 2, a] = q[0] * dt**2 / 2.0
            F[t, 6 + a, 6 + a], Q[t, 6 + a, 6 + a] = rho, common[0] * (1.0 - rho**2)
        Q[t, 4, 4], Q[t, 5, 5] = q[1] * dt, q[2] * dt
    variance = np.concatenate([[DIFFUSE_SIGMA_M**2] * 2, 1.0 / prior[2:], [common[0]] * 2, [0.0] * 2])
    first = np.diag(variance)
    m0 = np.concatenate([at, mean_of_new[2:], np.zeros(4)])
    P, m = np.zeros((T * n, T * n)), np.zeros(T * n)
    for t in range(T):
        here = slice(t * n, (t + 1) * n)
        if t == 0:
            P[here, here], m[here] = first, m0
        else:
            before = slice((t - 1) * n, t * n)
            m[here] = F[t] @ m[before]
            P[here, : t * n] = F[t] @ P[before, : t * n]
            P[: t * n, here] = P[here, : t * n].T
            P[here, here] = F[t] @ P[before, before] @ F[t].T + Q[t]
        spread = own[node[t]] if node[t] >= 0 else square
        P[t * n + 8, t * n + 8] = P[t * n + 9, t * n + 9] = spread
    observed = np.zeros((6, n))
    observed[:, :6] = np.eye(6)
    observed[0, 6] = observed[1, 7] = observed[0, 8] = observed[1, 9] = 1.0
    information, vector = np.zeros_like(P), np.zeros(T * n)
    for t in range(T):
        if node[t] >= 0:
            here = slice(t * n, (t + 1) * n)
            information[here, here] += observed.T @ J[node[t]] @ observed
            vector[here] += observed.T @ h[node[t]]
    post = P @ np.linalg.inv(np.eye(T * n) + information @ P)
    exact = m + post @ (vector - information @ m)
    shown = np.zeros((6, n))
    shown[:, :6] = np.eye(6)
    shown[0, 8] = shown[1, 9] = 1.0
    for t in range(T):
        here = slice(t * n, (t + 1) * n)
        np.testing.assert_allclose(mean[t], shown @ exact[here], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(covariance[t], shown @ post[here, here] @ shown.T, rtol=1e-4, atol=1e-7)
