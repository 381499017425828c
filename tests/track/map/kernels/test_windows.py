"""Windows and what one leaves to the next: against the whole problem and dense Gaussians."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sparse_example import example
from trajectory_reference import dense_hessian, random_lines, random_planes, random_steps

from occlog.track.methods.map.kernels.interior_point import (
    MU_LAST,
    Options,
    covariance,
    derivatives,
    minimise,
    move_inside,
)
from occlog.track.methods.map.kernels.problem import NO_PLANES, TrajectoryProblem, linear_problem, slack, some_lines
from occlog.track.methods.map.kernels.windows import StatePrior, minimise_windows, part, summary

FINE = Options(1e-11)


def linear(seed: int, T: int = 12) -> TrajectoryProblem:
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(T, 4))
    lines = random_lines(rng, X, 1.5)
    p = TrajectoryProblem(random_steps(rng, T), lines, NO_PLANES, 1, 1.3)
    return linear_problem(p, rng.uniform(1.0, 4.0, len(lines.step)))


def held(seed: int, T: int = 12):
    """A linear problem with half-planes that cut off its minimum, and a start inside them."""
    p = linear(seed, T)
    free = minimise(p, np.zeros((T, 4)), FINE).X
    rng = np.random.default_rng(1000 + seed)
    planes = random_planes(rng, free, T, 1.0)
    planes = planes._replace(offset=planes.offset + rng.uniform(0.2, 1.2, T))
    start, stuck = move_inside(free, planes, 0.05)
    keep = ~stuck[planes.step]
    start[stuck] = free[stuck]
    return p._replace(planes=type(planes)(planes.step[keep], planes.normal[keep], planes.offset[keep])), start


def filtered(p: TrajectoryProblem, state: int):
    """Mean and covariance of a state given the prior and all sight lines before it, by dense matrices."""
    s = p.steps._replace(kind=p.steps.kind[:state])
    head = TrajectoryProblem(s, some_lines(p.lines, p.lines.step < state), NO_PLANES, 0, 1.0)
    g, H = derivatives(head, np.zeros((state + 1, 4)), 1.0)  # of a quadratic at 0
    inverse = np.linalg.inv(dense_hessian(s, H))
    return -(inverse @ g.ravel())[-4:], inverse[-4:, -4:]


@pytest.mark.parametrize("seed", range(4))
def test_summary_of_a_linear_problem_is_its_marginal(seed: int) -> None:
    p = linear(seed)
    solution = minimise(p, np.zeros((p.T, 4)), FINE)
    for state in (1, 2, 7, p.T - 1):
        mean, spread = filtered(p, state)
        got = summary(p, solution, state)
        assert_allclose(got.mean, mean, rtol=0, atol=1e-8)
        assert_allclose(got.spread, spread, rtol=0, atol=1e-9 * np.abs(spread).max())


@pytest.mark.parametrize("seed", range(4))
def test_what_follows_a_summary_is_the_whole_minimum(seed: int) -> None:
    p = linear(seed)
    solution = minimise(p, np.zeros((p.T, 4)), FINE)
    for state in (1, 5, p.T - 1):
        rest = part(p, state, p.T, summary(p, solution, state))
        assert p.T - state == rest.T
        found = minimise(rest, np.zeros((rest.T, 4)), FINE)
        assert_allclose(found.X, solution.X[state:], rtol=0, atol=1e-8)
        assert_allclose(covariance(rest, found.X), covariance(p, solution.X)[state:], rtol=0, atol=1e-8)


@pytest.mark.parametrize("seed", range(6))
def test_constraints_of_the_past_keep_their_force(seed: int) -> None:
    p, start = held(seed)
    solution = minimise(p, start, FINE)
    assert solution.converged
    assert (slack(p.planes, solution.X)[p.planes.step < p.T - 1] < 1e-7).any()
    for state in (3, 8, p.T - 1):
        rest = part(p, state, p.T, summary(p, solution, state))
        found = minimise(rest, start[state:], FINE)
        assert_allclose(found.X, solution.X[state:], rtol=0, atol=1e-6)


def test_summaries_of_summaries_are_summaries() -> None:
    p = linear(9, 20)
    whole = minimise(p, np.zeros((20, 4)), FINE)
    rest = part(p, 6, 20, summary(p, whole, 6))
    two = summary(rest, minimise(rest, np.zeros((14, 4)), FINE), 5)
    one = summary(p, whole, 11)
    assert_allclose(two.mean, one.mean, rtol=0, atol=1e-8)
    assert_allclose(two.spread, one.spread, rtol=0, atol=1e-8)


def test_a_part_has_its_own_rows() -> None:
    p, _ = held(1)
    here = part(p, 4, 9, StatePrior(np.arange(4.0), 2.0 * np.eye(4)))
    assert here.T == 5
    assert np.array_equal(here.steps.kind, p.steps.kind[4:8])
    assert np.array_equal(here.lines.step + 4, p.lines.step[(p.lines.step >= 4) & (p.lines.step < 9)])
    assert np.array_equal(here.planes.step + 4, p.planes.step[(p.planes.step >= 4) & (p.planes.step < 9)])
    assert np.array_equal(here.lines.reading, p.lines.reading[(p.lines.step >= 4) & (p.lines.step < 9)])
    assert np.array_equal(here.steps.mean, np.arange(4.0))
    assert_allclose(here.steps.whiten_first @ here.steps.spread @ here.steps.whiten_first.T, np.eye(4), atol=1e-14)
    assert part(p, p.T - 1, p.T, StatePrior(np.zeros(4), np.eye(4))).T == 1


@pytest.mark.parametrize("window", [4, 7, 16, 64])
def test_last_window_of_a_linear_problem_is_exact(window: int) -> None:
    p = linear(3, 37)
    whole = minimise(p, np.zeros((37, 4)), FINE).X
    firsts = []

    def search(here, X, first):
        firsts.append(first)
        return here, minimise(here, X, FINE)

    X, iterations = minimise_windows(p, np.zeros((37, 4)), window, search)
    assert_allclose(X[firsts[-1] :], whole[firsts[-1] :], rtol=0, atol=1e-7)
    assert iterations >= len(firsts)
    assert firsts[0] == 0
    assert set(np.diff(firsts)) <= {window - window // 4}
    assert len(firsts) == 1 or window < 37


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(6))
def test_windows_then_the_whole_is_the_whole(seed: int) -> None:
    p, start, _ = example(seed, T=240)
    whole = minimise(p, start, Options(1e-9))
    rough = Options(1e-3)
    X, _ = minimise_windows(p, start, 80, lambda here, X, first: (here, minimise(here, X, rough)))
    assert slack(p.planes, X).min() > 0.0
    found = minimise(p, X, Options(1e-9, mu=MU_LAST))
    assert found.converged
    assert_allclose(found.X[:, ::2], whole.X[:, ::2], rtol=0, atol=1e-5)
