"""The paper's quadratic programs: dense matrices, general solvers, and the same minimum as Newton's method."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sparse_example import example
from trajectory_reference import dense_chain, plain_cost, random_lines, random_planes, random_steps

from occlog.track.methods.map.kernels.interior_point import Options, minimise, move_inside
from occlog.track.methods.map.kernels.problem import HalfPlanes, TrajectoryProblem, join_planes, slack
from occlog.track.methods.map.kernels.quadratic_program import program, sequential_programs
from occlog.track.methods.map.kernels.terms import residuals
from occlog.track.methods.map.qp_solvers import program_solver

FINE = Options(1e-9)


def small(seed: int, kinds, T: int = 6):
    """Few states with sight lines of all kinds and constraints in addition, and states near their targets."""
    rng = np.random.default_rng(seed)
    steps = random_steps(rng, T)
    X = rng.normal(scale=2.0, size=(T, 4))
    lines = random_lines(rng, X, 1.5, kinds)
    front = HalfPlanes(lines.step, lines.axis, np.einsum("ni,ni->n", lines.axis, lines.position) + 0.3)
    return TrajectoryProblem(steps, lines, join_planes(front, random_planes(rng, X, 5, 1.0)), 0, 1.0), X


@pytest.mark.parametrize("kinds", [("pixel", "direction"), ("pixel", "distance", "direction")])
@pytest.mark.parametrize("seed", range(4))
def test_the_program_is_that_of_dense_matrices(seed: int, kinds) -> None:
    """P from the residuals' slopes by central differences, without any of the code's own derivatives."""
    p, X = small(seed, kinds)
    each, n, h = program(p, X), X.size, 1e-6
    J = np.empty((len(p.lines.step), n))
    q = np.empty(n)
    for i in range(n):
        e = np.zeros(n)
        e[i] = h
        up, down = X + e.reshape(-1, 4), X - e.reshape(-1, 4)
        J[:, i] = (residuals(p.lines, up) - residuals(p.lines, down)) / (2 * h)
        q[i] = (plain_cost(p, up) - plain_cost(p, down)) / (2 * h)
    P = dense_chain(p.steps) + J.T @ J
    if "distance" in kinds:  # weights that depend on the distance add to the curvature, never take from it
        assert np.linalg.eigvalsh(each.P.toarray() - P).min() > -1e-6 * np.abs(P).max()
    else:
        assert_allclose(each.P.toarray(), P, rtol=1e-5, atol=1e-6 * np.abs(P).max())
    assert_allclose(each.q, q, rtol=1e-5, atol=1e-6 * (1 + np.abs(q).max()))
    A = np.zeros((len(p.planes.step), n))
    for m, t in enumerate(p.planes.step):
        A[m, [4 * t, 4 * t + 2]] = p.planes.normal[m]
    assert_allclose(each.A.toarray(), A)
    assert_allclose(each.b, A @ X.ravel() - p.planes.offset)


def with_room(problem: TrajectoryProblem, X, half: float) -> tuple[TrajectoryProblem, np.ndarray]:
    """The example in a room so small that its walls hold the trajectory off."""
    T = problem.T
    normal = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    room = HalfPlanes(np.repeat(np.arange(T), 4), np.tile(normal, (T, 1)), np.full(4 * T, -half))
    planes = join_planes(problem.planes, room)
    start, stuck = move_inside(X, planes, 1e-2)
    assert not stuck.any()
    return problem._replace(planes=planes), start


@pytest.mark.parametrize("seed", range(4))
def test_sequential_programs_agree_with_newton(seed: int) -> None:
    """The example of [Rahimi] Sec. 6 by Clarabel: within 1e-5 m."""
    p, X, _ = example(seed, T=60)
    start, _ = move_inside(X, p.planes, 1e-2)
    a, b = sequential_programs(p, start, FINE, program_solver("clarabel")), minimise(p, start, FINE)
    assert a.converged
    assert b.converged
    assert_allclose(a.X[:, ::2], b.X[:, ::2], rtol=0, atol=1e-5)
    assert a.cost == pytest.approx(b.cost, abs=1e-8)


def held_by(seed: int):
    """An example in a room of 0.9 of the extent of its free trajectory."""
    p, X, _ = example(seed, T=60)
    start, _ = move_inside(X, p.planes, 1e-2)
    free = minimise(p, start, FINE).X
    return with_room(p, free, 0.9 * float(np.abs(free[:, ::2]).max()))


@pytest.mark.parametrize("seed", range(4))
def test_sequential_programs_agree_with_newton_where_constraints_hold(seed: int) -> None:
    p, start = held_by(seed)
    a, b = sequential_programs(p, start, FINE, program_solver("clarabel")), minimise(p, start, FINE)
    assert a.converged
    assert b.converged
    active = slack(p.planes, b.X) < 1e-7
    assert active.any()
    assert_allclose(a.X[:, ::2], b.X[:, ::2], rtol=0, atol=1e-5)
    assert slack(p.planes, a.X).min() > -1e-7
    strong = b.multiplier > 1e-3
    assert strong.any()
    assert_allclose(a.multiplier[strong], b.multiplier[strong], rtol=1e-2)


@pytest.mark.jit
def test_osqp_agrees_to_its_own_tolerance() -> None:
    """1e-3 m: a method of first order, asked for residuals of 1e-9, whose polish may fail."""
    p, start = held_by(1)
    a = sequential_programs(p, start, Options(1e-6, 60), program_solver("osqp"))
    assert_allclose(a.X[:, ::2], minimise(p, start, FINE).X[:, ::2], rtol=0, atol=1e-3)


def test_those_who_watch_see_every_program() -> None:
    p, X, _ = example(0, T=30)
    start, _ = move_inside(X, p.planes, 1e-2)
    seen = []
    found = sequential_programs(p, start, FINE, program_solver("clarabel"), seen.append)
    assert [i.number for i in seen] == list(range(found.iterations + 1))
    assert all(b.cost <= a.cost + 1e-9 for a, b in pairwise(seen))
    assert seen[-1].cost == found.cost
    few = sequential_programs(p, start, Options(1e-9, 2), program_solver("clarabel"))
    assert (few.iterations, few.converged) == (2, False)
