"""Long trajectories in overlapping windows, each with the marginal that the one before leaves of its first state.

What is known of a state from everything before it is summed up as a Gaussian, with the
measurements linearised about the trajectory found so far ("marginalised"); it is the prior
of the first state of the next window.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

from .interior_point import Solution, derivatives, factor_rows, solve
from .problem import ChainSteps, TrajectoryProblem, select_priors, some_lines, some_planes


class StatePrior(NamedTuple):
    """Gaussian prior of one state x, vx, y, vy: mean (4,), and covariance `spread` (4, 4), positive definite."""

    mean: Floats  # (4,)
    spread: Floats  # (4, 4) covariance, positive definite


def part(problem: TrajectoryProblem, first: int, last: int, before: StatePrior) -> TrajectoryProblem:
    """Return the sub-problem of states first .. last - 1, renumbered from 0.

    Args:
        problem: cost and constraints of a trajectory of T states.
        first: first state, >= 0.
        last: one after the last state, <= T.
        before: Gaussian prior of state `first`, from all earlier ones.
    """
    s, lines, planes, hints = problem.steps, problem.lines, problem.planes, problem.hints
    own_lines = some_lines(lines, slice(*np.searchsorted(lines.step, (first, last)).tolist()))
    own_planes = some_planes(planes, slice(*np.searchsorted(planes.step, (first, last)).tolist()))
    own_priors = select_priors(hints, slice(*np.searchsorted(hints.step, (first, last)).tolist()))
    return problem._replace(
        steps=make_first(s._replace(kind=s.kind[first : max(first, last - 1)]), before),
        lines=own_lines._replace(step=own_lines.step - first),
        planes=own_planes._replace(step=own_planes.step - first),
        hints=own_priors._replace(step=own_priors.step - first),
    )


def make_first(steps: ChainSteps, before: StatePrior) -> ChainSteps:
    """Return the motion chain with the Gaussian `before` as the prior of its first state."""
    whiten = np.linalg.solve(np.linalg.cholesky(before.spread), np.eye(4))
    return steps._replace(mean=before.mean, spread=before.spread, whiten_first=np.ascontiguousarray(whiten))


def summary(problem: TrajectoryProblem, solution: Solution, state: int) -> StatePrior:
    """Return the marginal Gaussian of a state given everything before it, with measurements linearised at the solution.

    Measurements at the state itself are omitted; active constraints keep their force.

    Args:
        problem: cost and constraints of a trajectory of T states.
        solution: minimum of the problem.
        state: index of the state, 1 to T - 1.
    """
    # The problem of all states before and this one, without what is measured at this one
    X = solution.X[: state + 1]
    head = part(problem, 0, state + 1, StatePrior(problem.steps.mean, problem.steps.spread))
    lines, planes = some_lines(head.lines, head.lines.step < state), some_planes(head.planes, head.planes.step < state)
    head = head._replace(lines=lines, planes=planes, hints=select_priors(head.hints, head.hints.step < state))
    # Linearise; active constraints keep pulling by their multipliers
    g, H = derivatives(head, X, 0.0)
    force = solution.multiplier[: len(planes.step), None] * planes.normal
    for axis, column in ((0, 0), (1, 2)):
        g[:, column] -= np.bincount(planes.step, weights=force[:, axis], minlength=len(X))
    # Eliminate the states before: the last block of R is the root of the marginal's precision
    R, N, dX = np.empty((len(X), 4, 4)), np.empty((len(X), 4, 4)), np.empty_like(X)
    factor_rows(head.steps, H, R, N)
    solve(R, N, -g, dX)
    inverse = np.linalg.solve(R[-1], np.eye(4))
    return StatePrior(X[-1] + dX[-1], inverse @ inverse.T)


Search = Callable[[TrajectoryProblem, Floats, int], tuple[TrajectoryProblem, Solution]]
"""Finds the minimum of a problem from a start; gets its first state's number, and may add constraints."""


def minimise_windows(problem: TrajectoryProblem, start: Floats, window: int, search: Search) -> tuple[Floats, int]:
    """Return approximate minimising states (T, 4), found in windows that overlap by a quarter, and all iterations.

    Args:
        problem: cost and constraints of a trajectory of T states.
        start: (T, 4) states strictly inside all constraints; not changed.
        window: number of states in a window, at least 4.
        search: returns the minimum of a window's problem from a start; gets the number of the window's first state,
            too.
    """
    X, T = np.array(start), len(start)
    before, first, iterations = StatePrior(problem.steps.mean, problem.steps.spread), 0, 0
    while True:
        last = min(first + window, T)
        # Solve one window with what is known of its first state
        here = part(problem, first, last, before)
        here, found = search(here, X[first:last], first)
        X[first:last] = found.X
        iterations += found.iterations
        if last == T:
            return X, iterations
        # Move on by three quarters; what is left behind is marginalised
        step = window - window // 4
        before, first = summary(here, found, step), first + step
