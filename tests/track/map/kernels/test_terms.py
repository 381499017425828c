"""The cost of a trajectory against its textbook form, derivatives against differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from trajectory_reference import dense_hessian, plain_cost, plain_loss, random_lines, random_planes, random_steps

from occlog.track.methods.map.kernels.interior_point import cost, derivatives
from occlog.track.methods.map.kernels.problem import CAUCHY, HUBER, MIXTURE, NO_PLANES, SQUARE, TrajectoryProblem
from occlog.track.methods.map.kernels.terms import (
    add_planes,
    barrier_cost,
    inlier_probability,
    loss_slopes,
    loss_value,
    residuals,
)

LOSSES = [(0, 1.0), (1, 1.345), (2, 2.385), (3, 3.0), (1, 0.3), (2, 0.4), (3, 1.5)]
KINDS = ("pixel", "distance", "direction", "linear")


def problem(seed: int, kinds=KINDS, loss: int = 0, k: float = 1.0, T: int = 6):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(T, 4))
    return TrajectoryProblem(random_steps(rng, T), random_lines(rng, X, 2.5, kinds), NO_PLANES, loss, k), X


def differences(function, X, h: float = 2e-4):
    """Central differences of fourth order of a function of (T, 4) states: a row for each of their numbers."""
    out = []
    for i in range(X.size):
        values = []
        for m in (-2, -1, 1, 2):
            Y = X.copy()
            Y.flat[i] += m * h
            values.append(function(Y))
        a, b, c, d = values
        out.append((a - 8 * b + 8 * c - d) / (12 * h))
    return np.array(out)


def gap_to_bends(p: TrajectoryProblem, X) -> float:
    """Distance of the residuals from the corners of Huber's loss, where there is no second derivative."""
    r = residuals(p.lines, X)
    return float(np.abs(np.abs(r) - p.k).min()) if p.loss == 1 else math.inf


@pytest.mark.parametrize(("loss", "form"), [(SQUARE, 0), (HUBER, 1), (CAUCHY, 2), (MIXTURE, 3)])
def test_losses_are_their_formulas_and_slopes_their_derivatives(loss: int, form: int) -> None:
    k = 1.7
    for r in (-30.0, -3.0, -1.2, 1e-9, 0.4, 2.6, 500.0):
        assert loss_value(r, loss, k) == pytest.approx(plain_loss(r, form, k), rel=1e-13)
        first, second, weight = loss_slopes(r, loss, k)
        h = 1e-4 * max(1.0, abs(r))
        low, mid, high = (plain_loss(r + m * h, form, k) for m in (-1, 0, 1))
        assert first == pytest.approx((high - low) / (2 * h), rel=1e-6, abs=1e-9)
        assert second == pytest.approx((high - 2 * mid + low) / h**2, rel=1e-4, abs=1e-4)
        assert weight * r == pytest.approx(first, rel=1e-12)
    if loss == MIXTURE:
        assert loss_slopes(0.0, loss, k)[1:] == pytest.approx((1.0 / (1.0 + math.exp(-k * k / 2)),) * 2)
    else:
        assert loss_slopes(0.0, loss, k) == (0.0, 1.0, 1.0)


@pytest.mark.parametrize("k", [0.5, 3.7, 60.0])
def test_belief_is_one_half_at_the_bend_and_the_weight_of_the_mixture(k: float) -> None:
    assert inlier_probability(k, k) == 0.5
    for r in (0.0, 0.5 * k, 2.0 * k, 1e3):
        assert inlier_probability(r, k) == loss_slopes(r, MIXTURE, k)[2]
        assert inlier_probability(-r, k) == inlier_probability(r, k)
    assert inlier_probability(k * (1 + 1e-9), k) < 0.5 < inlier_probability(k * (1 - 1e-9), k)
    assert inlier_probability(1e6, k) == 0.0


@pytest.mark.parametrize(("loss", "k"), LOSSES)
@pytest.mark.parametrize("seed", range(5))
def test_cost_is_the_textbook_form(seed: int, loss: int, k: float) -> None:
    p, X = problem(seed, loss=loss, k=k, T=9)
    assert cost(p, X) == pytest.approx(plain_cost(p, X), rel=1e-11)
    far = X + np.random.default_rng(seed).normal(size=X.shape)  # some states behind their cameras
    assert cost(p, far) == pytest.approx(plain_cost(p, far), rel=1e-11)


@pytest.mark.parametrize(("loss", "k"), LOSSES)
@pytest.mark.parametrize("kinds", [("pixel",), ("distance",), ("direction",), ("linear",), KINDS])
def test_gradient_and_hessian_by_differences(kinds, loss: int, k: float) -> None:
    done = 0
    for seed in range(7):
        p, X = problem(seed, kinds, loss, k, T=2)
        if gap_to_bends(p, X) < 0.05:
            continue
        g, H = derivatives(p, X, 1.0)
        assert_allclose(g.ravel(), differences(lambda Y, p=p: cost(p, Y), X), rtol=1e-6, atol=1e-5)
        numeric = differences(lambda Y, p=p: derivatives(p, Y, 1.0)[0].ravel(), X)
        assert_allclose(dense_hessian(p.steps, H), numeric.T, rtol=1e-6, atol=1e-5)
        done += 1
    assert done >= 2


@pytest.mark.parametrize(("loss", "k"), LOSSES)
def test_gauss_and_newton_is_the_reweighted_square_of_the_slopes(loss: int, k: float) -> None:
    kinds = ("pixel", "direction", "linear")  # no log sigma, whose curvature is kept as it is
    for seed in range(5):
        p, X = problem(seed, kinds, loss, k)
        _, H = derivatives(p, X, 0.0)
        want = np.zeros_like(H)
        slopes = differences(lambda Y, p=p: residuals(p.lines, Y), X).T
        r = residuals(p.lines, X)
        for n, t in enumerate(p.lines.step):
            weight = loss_slopes(r[n], loss, k)[2]
            rx, ry = slopes[n].reshape(X.shape)[t, [0, 2]]
            want[t] += weight * np.array([rx * rx, rx * ry, ry * ry])
        assert_allclose(H, want, rtol=1e-6, atol=1e-6)
        assert (H[:, 0] * H[:, 2] - H[:, 1] ** 2 >= -1e-9 * (1 + H[:, 0] * H[:, 2])).all()


def test_shares_of_the_exact_second_derivatives_are_mixtures() -> None:
    p, X = problem(3, KINDS, 2, 0.8)
    (g0, H0), (g1, H1), (g, H) = (derivatives(p, X, share) for share in (0.0, 1.0, 0.3))
    assert np.array_equal(g0, g1)
    assert np.array_equal(g0, g)
    assert_allclose(H, 0.7 * H0 + 0.3 * H1, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kinds", [("distance",), KINDS])
def test_gauss_and_newton_is_never_negative(kinds) -> None:
    for seed in range(50):
        p, X = problem(seed, kinds)
        _, H = derivatives(p, X, 0.0)
        assert (H[:, [0, 2]] >= 0.0).all()
        assert (H[:, 0] * H[:, 2] - H[:, 1] ** 2 >= -1e-9 * (1 + H[:, 0] * H[:, 2])).all()


def test_barrier_and_its_primal_dual_derivatives() -> None:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(5, 4))
    planes = random_planes(rng, X, 12, 1.0)
    room = np.einsum("mi,mi->m", planes.normal, X[planes.step][:, [0, 2]]) - planes.offset
    assert barrier_cost(planes, X) == pytest.approx(-np.log(room).sum(), rel=1e-12)
    outside = X.copy()
    outside[planes.step[3], [0, 2]] -= (room[3] + 1e-9) * planes.normal[3]
    assert barrier_cost(planes, outside) == math.inf
    mu, g, H = 0.3, np.zeros((5, 4)), np.zeros((5, 3))
    add_planes(planes, X, mu, mu / room, g, H)  # multipliers on the central path: the barrier's own Hessian
    away = room.min() / 20
    assert_allclose(g.ravel(), mu * differences(lambda Y: barrier_cost(planes, Y), X, away), rtol=1e-3, atol=1e-6)
    for m in range(len(room)):
        n = planes.normal[m]
        H[planes.step[m]] -= mu / room[m] ** 2 * np.array([n[0] ** 2, n[0] * n[1], n[1] ** 2])
    assert_allclose(H, 0.0, rtol=0, atol=1e-9 * mu / room.min() ** 2)
