"""The most probable trajectory: conditions of a minimum, a general solver as reference, the paper's example."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from sparse_example import WALKER, example
from trajectory_reference import PAPER, dense_hessian, plain_cost, random_lines, random_planes, random_steps

from occlog.track.methods.map.kernels.interior_point import (
    MU_LAST,
    Options,
    cost,
    covariance,
    derivatives,
    factor_rows,
    minimise,
    move_inside,
    solve,
)
from occlog.track.methods.map.kernels.problem import (
    NO_PLANES,
    HalfPlanes,
    TrajectoryProblem,
    join_planes,
    slack,
    some_planes,
)
from occlog.track.methods.map.kernels.terms import barrier_cost

FINE = Options(1e-10)


def small(seed: int, T: int = 8, loss: int = 0, k: float = 1.0, kinds=("pixel", "distance", "direction")):
    """A problem of few states and many sight lines, with a start nearby; targets are in front of their sensors."""
    rng = np.random.default_rng(seed)
    steps = random_steps(rng, T)
    X = np.empty((T, 4))
    X[0] = steps.mean
    for t, kind in enumerate(steps.kind):
        X[t + 1] = steps.A[kind] @ X[t] + 0.5 * np.linalg.cholesky(steps.sigma[kind]) @ rng.normal(size=4)
    lines = random_lines(rng, X, 1.5, kinds)
    front = HalfPlanes(lines.step, lines.axis, np.einsum("ni,ni->n", lines.axis, lines.position) + 0.3)
    return TrajectoryProblem(steps, lines, front, loss, k), X


def held_off(seed: int, number: int = 7, **options):
    """A small problem with half-planes in addition that its minimum violates, and a start inside them."""
    p, X = small(seed, **options)
    free = minimise(p, X, FINE).X
    rng = np.random.default_rng(1000 + seed)
    cuts = random_planes(rng, free, number, 1.0)
    cuts = cuts._replace(offset=cuts.offset + rng.uniform(0.2, 1.2, number))
    planes = join_planes(p.planes, cuts)
    start, stuck = move_inside(free, planes, 0.05)
    for t in np.flatnonzero(stuck):  # what leaves no room is no part of the problem
        cuts = some_planes(cuts, cuts.step != t)
        start[t] = free[t]
    return p._replace(planes=join_planes(p.planes, cuts)), start, free


def general(problem: TrajectoryProblem, start):
    """The minimum by a general solver, in coordinates in which the prior is a unit sphere.

    It sees the plain cost and its gradient by central differences, none of the code under test.
    """
    L = np.linalg.inv(np.linalg.cholesky(dense_hessian(problem.steps, np.full((problem.T, 3), [1.0, 0.0, 1.0])))).T

    def value(y):
        return plain_cost(problem, (L @ y).reshape(-1, 4))

    def slope(y):
        h = 1e-4
        out = np.empty(len(y))
        for i in range(len(y)):
            e = np.zeros(len(y))
            e[i] = h
            out[i] = (8 * (value(y + e) - value(y - e)) - (value(y + 2 * e) - value(y - 2 * e))) / (12 * h)
        return out

    C = np.zeros((len(problem.planes.step), start.size))
    for m, t in enumerate(problem.planes.step):
        C[m, [4 * t, 4 * t + 2]] = problem.planes.normal[m]
    rule = {"type": "ineq", "fun": lambda y: C @ L @ y - problem.planes.offset, "jac": lambda y: C @ L}
    y = np.linalg.solve(L, start.ravel())
    for _ in range(3):  # again from where it stopped: its Hessian is only an estimate
        y = minimize(
            value,
            y,
            jac=slope,
            method="SLSQP",
            constraints=rule if len(C) else (),
            options={"maxiter": 500, "ftol": 1e-15},
        ).x
    return (L @ y).reshape(-1, 4)


def check_conditions(problem: TrajectoryProblem, solution, tolerance: float = 1e-6) -> None:
    """Those of Karush, Kuhn and Tucker."""
    g, _ = derivatives(problem, solution.X, 1.0)
    scale = 1.0 + np.abs(solution.multiplier).max(initial=0.0)
    for m, t in enumerate(problem.planes.step):
        g[t, [0, 2]] -= solution.multiplier[m] * problem.planes.normal[m]
    assert_allclose(g, 0.0, rtol=0, atol=tolerance * scale)
    gap = slack(problem.planes, solution.X)
    assert (gap > 0.0).all()
    assert (solution.multiplier >= 0.0).all()
    assert (solution.multiplier * gap <= 1e3 * MU_LAST).all()


@pytest.mark.parametrize(("seed", "loss", "k"), [(0, 0, 1.0), (1, 1, 1.345), (2, 2, 2.385)])
def test_free_minimum_is_that_of_a_general_solver(seed: int, loss: int, k: float) -> None:
    p, X = small(seed, T=5, loss=loss, k=k)
    solution = minimise(p, X, FINE)
    assert solution.converged
    check_conditions(p, solution)
    assert solution.cost == pytest.approx(plain_cost(p, solution.X), rel=1e-10)
    assert_allclose(solution.X[:, ::2], general(p, X)[:, ::2], rtol=0, atol=1e-5)


@pytest.mark.parametrize("seed", range(2))
def test_constrained_minimum_is_that_of_a_general_solver(seed: int) -> None:
    p, start, _ = held_off(seed, T=5, number=5)
    solution = minimise(p, start, FINE)
    assert solution.converged
    check_conditions(p, solution)
    assert (slack(p.planes, solution.X) < 1e-8).any()  # some constraint holds it off
    assert_allclose(solution.X[:, ::2], general(p, start)[:, ::2], rtol=0, atol=1e-5)


@pytest.mark.parametrize(("loss", "k"), [(0, 1.0), (1, 1.345), (2, 2.385)])
@pytest.mark.parametrize("T", [1, 2, 30])
@pytest.mark.parametrize("seed", range(5))
def test_conditions_of_the_minimum(seed: int, T: int, loss: int, k: float) -> None:
    p, start, free = held_off(seed, T=T, number=T, loss=loss, k=k)
    solution = minimise(p, start, FINE)
    assert solution.converged
    check_conditions(p, solution)
    assert solution.cost >= cost(p, free) - 1e-9 or loss == 2  # Cauchy's loss has many minima
    # A minimum, not a saddle: positive curvature where the constraints leave it free
    hessian = dense_hessian(p.steps, derivatives(p, solution.X, 1.0)[1])
    rows = [
        np.concatenate([np.zeros(4 * t), [n[0], 0, n[1], 0], np.zeros(4 * (T - t - 1))])
        for t, n, s in zip(p.planes.step, p.planes.normal, slack(p.planes, solution.X), strict=True)
        if s < 1e-7
    ]
    _, values, basis = np.linalg.svd(np.array(rows).reshape(-1, 4 * T))
    rest = basis[len(values) :]
    assert np.linalg.eigvalsh(rest @ hessian @ rest.T).min(initial=1.0) > 0.0


@pytest.mark.jit
@pytest.mark.parametrize("make", [lambda s: held_off(s)[:2], lambda s: example(s)[:2], lambda s: small(s)])
def test_every_iteration_lowers_the_cost_with_its_barrier(make) -> None:
    for seed in range(5):
        p, start = make(seed)
        seen = []
        solution = minimise(p, start, FINE, seen.append)
        assert [i.number for i in seen] == list(range(solution.iterations + 1))
        assert np.array_equal(seen[0].X, start)
        assert np.array_equal(seen[-1].X, solution.X)
        for before, after in itertools.pairwise(seen):
            a, b = (i.cost + (after.mu and after.mu * barrier_cost(p.planes, i.X)) for i in (before, after))
            assert b <= a + 1e-12 * (1.0 + abs(a))
            assert after.mu <= before.mu
            assert after.moved == pytest.approx(np.abs(after.X - before.X)[:, ::2].max(), rel=1e-6, abs=1e-13)
            assert slack(p.planes, after.X).min(initial=1.0) > 0.0


def test_a_start_outside_is_an_error() -> None:
    p, start, free = held_off(0)
    worst = int(np.argmin(slack(p.planes, free)))
    with pytest.raises(ValueError, match=f"outside constraint {worst} by "):
        minimise(p, free, FINE)
    wall = HalfPlanes(np.array([1]), np.array([[1.0, 0.0]]), start[1, :1].copy())
    with pytest.raises(ValueError, match="outside constraint 0 "):  # on the border is not inside
        minimise(p._replace(planes=wall), start, FINE)
    with pytest.raises(ValueError, match="outside constraint"):
        minimise(p, np.full_like(start, np.nan), FINE)


def test_the_start_is_left_alone_and_runs_are_equal() -> None:
    p, start, _ = held_off(2)
    kept = start.copy()
    a, b = minimise(p, start, FINE), minimise(p, start, FINE)
    assert np.array_equal(start, kept)
    assert np.array_equal(a.X, b.X)
    assert a.iterations == b.iterations


def test_too_few_iterations_are_reported() -> None:
    p, start, _ = example(0)
    solution = minimise(p, start, Options(1e-8, most=3))
    assert not solution.converged
    assert solution.iterations == 3
    assert solution.cost == pytest.approx(cost(p, solution.X), rel=1e-12)


@pytest.mark.jit
@pytest.mark.parametrize("model", [WALKER, PAPER], ids=["walker", "paper"])
def test_all_problems_of_the_papers_kind_converge(model) -> None:
    active = 0
    for seed in range(50):
        p, start, _ = example(seed, model=model)
        solution = minimise(p, start, Options(1e-8))
        assert solution.converged, seed
        # Gradients are of the order of |X| / Sigma: measured by the Newton step that is left, in metres
        g, H = derivatives(p, solution.X, 0.0)
        for m, t in enumerate(p.planes.step):
            force = solution.multiplier[m] * p.planes.normal[m]
            g[t, ::2] -= force
            q = solution.multiplier[m] / slack(p.planes, solution.X)[m]
            n = p.planes.normal[m]
            H[t] += q * np.array([n[0] ** 2, n[0] * n[1], n[1] ** 2])
        R, N, left = np.empty((p.T, 4, 4)), np.empty((p.T, 4, 4)), np.empty((p.T, 4))
        factor_rows(p.steps, H, R, N)
        solve(R, N, g, left)
        assert np.abs(left[:, ::2]).max() < 1e-5, seed
        assert (solution.multiplier * slack(p.planes, solution.X) <= 1e3 * MU_LAST).all()
        active += int((slack(p.planes, solution.X) < 1e-6).any())
    assert active >= 1  # the constraints matter, [Rahimi] Fig. 5


@pytest.mark.jit
def test_without_the_constraints_some_end_behind_a_camera() -> None:
    """[Rahimi] Fig. 5."""
    behind, gross = 0, []
    for seed in range(50):
        p, start, xy = example(seed)
        free, held = (minimise(q, start, Options(1e-8)) for q in (p._replace(planes=NO_PLANES), p))
        behind += int(slack(p.planes, free.X).min() < 0.0)
        gross.append(np.sqrt(np.mean(np.sum((held.X[:, ::2] - xy) ** 2, axis=1))))
    assert behind >= 5
    assert np.median(gross) < 1.5  # "the gross features" of walks through a room of 10 m


@pytest.mark.parametrize("seed", range(3))
def test_covariance_is_the_inverse_of_the_information(seed: int) -> None:
    p, X = small(seed, kinds=("pixel", "direction"))
    P = covariance(p, X)
    inverse = np.linalg.inv(dense_hessian(p.steps, derivatives(p, X, 0.0)[1]))
    for t in range(p.T):
        assert_allclose(P[t], inverse[4 * t : 4 * t + 4, 4 * t : 4 * t + 4], rtol=0, atol=1e-9)
