"""Leverages against the determinant whose derivative they are; estimates that do not depend on coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from trajectory_reference import dense_hessian, make_steps, plain_cost, random_lines, random_steps

from occlog.track.methods.map.kernels.gauss_markov import constant_velocity
from occlog.track.methods.map.kernels.interior_point import Options, cost, covariance, derivatives, minimise
from occlog.track.methods.map.kernels.invariant import invariant, second_moment
from occlog.track.methods.map.kernels.problem import (
    NO_PLANES,
    BearingLinesByStep,
    HalfPlanes,
    TrajectoryProblem,
    slack,
    some_lines,
)
from occlog.track.methods.map.kernels.terms import in_front, leverages


def problem(seed: int, T: int = 6, kinds=("pixel", "direction")):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(T, 4))
    lines = random_lines(rng, X, 1.5, kinds)
    planes = HalfPlanes(lines.step, lines.axis, np.einsum("ni,ni->n", lines.axis, lines.position) + 0.05)
    return TrajectoryProblem(random_steps(rng, T), lines, planes, 0, 1.0), X


def information(p: TrajectoryProblem, X) -> float:
    """1/2 log det of the Hessian of Gauss and Newton."""
    return 0.5 * float(np.linalg.slogdet(dense_hessian(p.steps, derivatives(p, X, 0.0)[1]))[1])


@pytest.mark.parametrize("seed", range(5))
def test_volume_is_part_of_the_cost_and_its_derivatives(seed: int) -> None:
    p, X = problem(seed)
    volume = np.random.default_rng(seed).uniform(0.0, 1.0, len(p.lines.step))
    q = p._replace(lines=p.lines._replace(volume=volume))
    d = np.einsum("ni,ni->n", X[p.lines.step][:, ::2] - p.lines.position, p.lines.axis)
    assert cost(q, X) == pytest.approx(plain_cost(q, X), rel=1e-11)
    (g0, H0), (g, H) = derivatives(p, X, 1.0), derivatives(q, X, 1.0)
    want_g, want_H = np.zeros_like(g), np.zeros_like(H)
    for n, t in enumerate(p.lines.step):
        c, s = p.lines.axis[n]
        want_g[t, ::2] -= volume[n] / d[n] * np.array([c, s])
        want_H[t] += volume[n] / d[n] ** 2 * np.array([c * c, c * s, s * s])
    assert_allclose(g - g0, want_g, rtol=1e-9, atol=1e-9 * np.abs(g).max())
    assert_allclose(H - H0, want_H, rtol=1e-9, atol=1e-9 * np.abs(H).max())
    behind = X.copy()
    behind[p.lines.step[0], ::2] -= (d[0] + 0.1) * p.lines.axis[0]
    assert cost(q, behind) == np.inf
    assert np.isfinite(cost(p, behind))
    assert in_front(p.lines, X).all()
    assert not in_front(p.lines, behind)[0]


@pytest.mark.parametrize("seed", range(5))
def test_leverages_are_shares_of_the_information(seed: int) -> None:
    """The derivative of 1/2 log det H when a sight line's weight grows by a factor e^2 is its leverage."""
    p, X = problem(seed)
    got = leverages(p.lines, X, p.loss, p.k, covariance(p, X))
    assert ((got > 0.0) & (got < 1.0)).all()
    e = 1e-4
    for n in range(len(got)):
        each = []
        for sign in (-1.0, 1.0):
            c0 = p.lines.c0.copy()
            c0[n] *= np.exp(-2.0 * sign * e)
            each.append(information(p._replace(lines=p.lines._replace(c0=c0)), X))
        assert got[n] == pytest.approx((each[1] - each[0]) / (2 * e), rel=1e-4, abs=1e-7)


def test_without_sight_lines_nothing_moves() -> None:
    p, X = problem(1)
    p = p._replace(lines=some_lines(p.lines, slice(0, 0)), planes=NO_PLANES)
    mode = minimise(p, X, Options(1e-9))
    found = invariant(p, mode, Options(1e-9), 10.0)
    assert_allclose(found.solution.X, mode.X, rtol=0, atol=1e-9)
    assert_allclose(found.covariance, covariance(p, mode.X), rtol=1e-9, atol=1e-12)


def known_velocity(speed_sigma: float, f: float = 1.0):
    """One camera that sees a target cross its axis at distance 5, whose velocity is known about so well."""
    T, v, y = 9, 1.0, 5.0
    t = np.arange(T) * 0.25
    x = v * (t - t.mean())
    n = np.ones(T)
    # axis +y: h is to the left, -x
    lines = BearingLinesByStep(
        np.arange(T),
        np.zeros((T, 2)),
        np.tile([0.0, 1.0], (T, 1)),
        f * n,
        -f * x / y,
        1e-4 * n,
        0 * n,
        n < 0,
        0 * n,
        0 * n,
    )
    steps = make_steps(
        constant_velocity(1e-3, 0.0, 0.25),
        t,
        np.array([x[0], v, y, 0.0]),
        np.diag([400.0, speed_sigma**2, 400.0, speed_sigma**2]),
    )
    planes = HalfPlanes(np.arange(T), np.tile([0.0, 1.0], (T, 1)), np.full(T, 0.01))
    X = np.zeros((T, 4))
    X[:, 2] = 1.0
    return TrajectoryProblem(steps, lines, planes, 0, 1.0), X


@pytest.mark.parametrize("speed_sigma", [0.05, 0.15])
def test_the_invariant_estimate_is_about_the_posterior_mean(speed_sigma: float) -> None:
    """Distance from a known velocity: importance sampling from the prior of the velocity is the reference.

    Given the velocity, the bearings fix the distance; the mode of states is nearer than the mean, for a state farther
    off has a larger volume.
    """
    p, start = known_velocity(speed_sigma)
    mode = minimise(p, start, Options(1e-9))
    assert mode.converged
    found = invariant(p, mode, Options(1e-9), 20.0)
    assert found.solution.converged
    assert slack(p.planes, found.solution.X).min() > 0.0
    # Straight lines by distance, offset and velocity; flat priors of position are as good as those of 20
    rng = np.random.default_rng(0)
    N = 400_000
    vx, vy = 1.0 + speed_sigma * rng.standard_normal(N), speed_sigma * rng.standard_normal(N)
    t = np.arange(9) * 0.25 - 1.0
    y, x = rng.uniform(3.0, 8.0, N), rng.uniform(-0.3, 0.3, N)
    log = np.zeros(N)
    for tau in t:
        log -= 0.5 * ((x + vx * tau) / (y + vy * tau) - tau / 5.0) ** 2 / 1e-4
    w = np.exp(log - log.max())
    w /= w.sum()
    assert 1.0 / (w**2).sum() > 500
    mean = w @ y
    deviation = np.sqrt(w @ (y - mean) ** 2)
    nearer, invariant_y = mode.X[4, 2], found.solution.X[4, 2]
    assert nearer < invariant_y
    assert abs(invariant_y - mean) < abs(nearer - mean)
    assert abs(invariant_y - mean) < 0.3 * deviation
    assert np.sqrt(found.covariance[4, 2, 2]) == pytest.approx(deviation, rel=0.25)


def test_second_moment_is_the_mean_square_about_another_point() -> None:
    rng = np.random.default_rng(2)
    M = rng.normal(size=(3, 4, 4))
    spread, X, centre = M @ M.swapaxes(1, 2), rng.normal(size=(3, 4)), rng.normal(size=(3, 4))
    got = second_moment(X, centre, spread)
    for t in range(3):
        draws = rng.multivariate_normal(centre[t], spread[t], 200_000) - X[t]
        error = 5.0 * np.sqrt(2.0 / 200_000) * np.abs(got[t]).max()
        assert_allclose(draws.T @ draws / len(draws), got[t], rtol=0, atol=error)
