"""Starts of the search: the paper's, and linear problems."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sparse_example import example
from trajectory_reference import random_lines, random_steps

from occlog.track.methods.map.kernels.interior_point import Options, covariance, derivatives, minimise
from occlog.track.methods.map.kernels.problem import (
    NO_PLANES,
    TrajectoryProblem,
    linear_problem,
    slack,
    some_lines,
    start_on_axes,
)
from occlog.track.methods.map.kernels.terms import residuals


def test_start_of_the_paper() -> None:
    """[Rahimi] Sec. 6: unobserved points at the origin, observed ones one metre along the optical axis."""
    p, start, _ = example(4)
    X = start_on_axes(p.lines, p.T, np.zeros(2), 1.0)
    assert_allclose(X, start, rtol=0, atol=1e-15)
    assert slack(p.planes, X).min() > 0.9
    seen = np.zeros(p.T, bool)
    seen[p.lines.step] = True
    moved = start_on_axes(p.lines, p.T, np.array([3.0, -2.0]), 0.25)
    assert np.array_equal(moved[~seen][:, ::2], np.tile([3.0, -2.0], ((~seen).sum(), 1)))
    assert not moved[:, 1::2].any()
    assert_allclose(np.hypot(*(moved[p.lines.step][:, ::2] - p.lines.position).T), 0.25)


def test_start_without_sight_lines_and_of_one_that_two_saw() -> None:
    p, _, _ = example(0)
    assert np.array_equal(start_on_axes(some_lines(p.lines, slice(0, 0)), 3, np.ones(2), 1.0), [[1, 0, 1, 0]] * 3)
    two = some_lines(p.lines, slice(0, 2))._replace(step=np.zeros(2, np.int64))
    assert_allclose(start_on_axes(two, 1, np.zeros(2), 2.0)[0, ::2], two.position[1] + 2.0 * two.axis[1])


@pytest.mark.parametrize("seed", range(4))
def test_linear_residuals_are_those_of_the_problem_at_their_distance(seed: int) -> None:
    """At the distance that is assumed, (f h - z D) / (sigma D) is the residual itself."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(8, 4))
    lines = random_lines(rng, X, 2.0, ("pixel", "distance"))
    p = TrajectoryProblem(random_steps(rng, 8), lines, NO_PLANES, 2, 0.5)
    d = np.einsum("ni,ni->n", X[lines.step][:, ::2] - lines.position, lines.axis)
    flat = linear_problem(p, d)
    assert flat.loss == 0
    assert_allclose(residuals(flat.lines, X), residuals(lines, X), rtol=1e-10, atol=1e-12)


def test_linear_residual_of_a_direction_is_the_sine_of_its_error_for_the_distance() -> None:
    rng = np.random.default_rng(3)
    X = rng.normal(size=(8, 4))
    lines = random_lines(rng, X, 2.0, ("direction",))
    p = TrajectoryProblem(random_steps(rng, 8), lines, NO_PLANES, 0, 1.0)
    away = X[lines.step][:, ::2] - lines.position
    flat = linear_problem(p, np.hypot(*away.T))
    assert_allclose(
        residuals(flat.lines, X), np.sin(residuals(lines, X) * np.sqrt(lines.c0)) / np.sqrt(lines.c0), atol=1e-10
    )


@pytest.mark.parametrize("seed", range(4))
def test_linear_problems_are_quadratic(seed: int) -> None:
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(8, 4))
    lines = random_lines(rng, X, 2.0)
    p = linear_problem(
        TrajectoryProblem(random_steps(rng, 8), lines, NO_PLANES, 1, 1.3), rng.uniform(0.5, 3.0, len(lines.step))
    )
    Y = 5.0 * rng.normal(size=(8, 4))
    for exact in (0.0, 1.0):
        assert_allclose(derivatives(p, X, exact)[1], derivatives(p, Y, exact)[1], rtol=1e-12)
    assert_allclose(derivatives(p, X, 0.0)[1], derivatives(p, X, 1.0)[1], rtol=1e-12)
    # One minimum from anywhere, in one step and one to see that it is one
    a, b = (minimise(p, start, Options(1e-8)) for start in (X, Y))
    assert_allclose(a.X, b.X, rtol=0, atol=1e-8)
    assert a.iterations <= 3
    assert_allclose(covariance(p, X), covariance(p, Y), rtol=1e-9)
