"""The most probable trajectory, [Rahimi] Sec. 5: Newton's method inside the constraints.

A primal-dual interior point method: the inequalities enter by a logarithmic barrier whose
weight mu falls to next to nothing, with multipliers that are estimated alongside.  Each
iteration takes time linear in the number of states (`occlog.track.map.kernels.interior_point.newton_system`).
Steps start with the second derivatives of Gauss and Newton, which always lead downhill;
near the minimum the exact ones are taken where they are positive, so that the last
iterations converge quadratically.  Every step is shortened until it stays inside the
constraints and lowers the cost (without that some problems do not converge).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

from ..problem import Problem, slack, slack_change, within
from ..terms import add_chain, add_hints, add_lines, add_planes, barrier_cost, chain_cost, hints_cost, lines_cost
from .newton_system import factor_rows, factor_sum, inverse_blocks, solve

MU_FIRST, MU_LAST = 1.0, 1e-11
TO_BOUNDARY = 0.995
"""Share of the way to the nearest constraint that a step may take."""
ARMIJO = 1e-4
SHORTEST = 1e-12
"""A step of a smaller share is no step."""
KAPPA = 1e10
"""Multipliers stay within this factor of mu / slack."""
NEAR = 10.0
"""Exact second derivatives are tried once the model promises less than this much."""
LEAST_EXACT = 0.1
"""A smaller share of them is not tried."""


class Iterate(NamedTuple):
    """One iteration of a search."""

    number: int  # 0: the start
    X: Floats  # (T, 4) states after it
    cost: float
    step: float  # share of the Newton step that was taken
    moved: float  # largest change of a position
    mu: float
    exact: float  # share of the exact second derivatives


class Solution(NamedTuple):
    """A minimum, or what was reached."""

    X: Floats  # (T, 4)
    cost: float
    iterations: int
    converged: bool
    multiplier: Floats  # (M,) of the constraints


class Options(NamedTuple):
    """When to stop."""

    tolerance: float  # largest change of a position in the last iteration
    most: int = 200  # iterations
    mu: float = MU_FIRST  # weight of the barrier at first


def cost(problem: Problem, X: Floats) -> float:
    """The negative log posterior of states (T, 4), up to a constant."""
    total: float = chain_cost(problem.steps, X) + lines_cost(problem.lines, X, problem.loss, problem.k)
    return total + hints_cost(problem.hints, X) if len(problem.hints.step) else total


def minimise(
    problem: Problem, start: Floats, options: Options, watch: Callable[[Iterate], None] | None = None
) -> Solution:
    """The local minimum of the cost that the start leads to.

    Args:
        problem: what is minimised.
        start: (T, 4) states, strictly inside all constraints.
        options: when to stop.
        watch: called with the start and after every iteration.

    Raises:
        ValueError: the start is not inside the constraints.
    """
    X = np.array(start, dtype=np.float64)
    gap = slack(problem.planes, X)
    if len(gap) and not gap.min() > 0.0:
        raise ValueError(f"the start is outside constraint {int(np.argmin(gap))} by {-gap.min():g}")
    mu = options.mu if len(gap) else 0.0
    multiplier = mu / gap
    here, promise, exact = cost(problem, X), math.inf, 1.0
    if watch is not None:
        watch(Iterate(0, X.copy(), here, 0.0, 0.0, mu, 0.0))
    for number in range(1, options.most + 1):
        # Newton direction; exact second derivatives are tried near the minimum
        tried = min(1.0, 2.0 * exact + LEAST_EXACT) if promise < NEAR else 0.0
        g, dX, exact = _direction(problem, X, mu, multiplier, tried)
        slope = float(np.vdot(g, dX))
        promise = max(-slope, 0.0)
        # Line search, inside the constraints
        share, here = _search(problem, X, dX, slope, mu, here)
        moved = share * float(np.abs(dX[:, ::2]).max())
        # Multipliers of the constraints
        multiplier = _follow(problem, X, dX, share, mu, multiplier)
        X += share * dX
        if watch is not None:
            watch(Iterate(number, X.copy(), here, share, moved, mu, exact))
        # Converged: the last barrier, and a step that hardly moves anything
        settled = moved <= options.tolerance and (share > 0.5 or promise <= 1e-9 * (1.0 + abs(here)))
        if settled and mu <= MU_LAST:
            return Solution(X, here, number, converged=True, multiplier=multiplier)
        if share == 0.0 and mu <= MU_LAST:
            break
        # Lower the barrier once its problem is solved well enough
        if mu > 0.0 and (promise < 0.1 * mu * len(gap) or promise < 1e-3 * mu or settled or share == 0.0):
            mu = max(MU_LAST, min(0.2 * mu, mu**1.5))
    return Solution(X, here, options.most if share else number, converged=False, multiplier=multiplier)


def _direction(
    problem: Problem, X: Floats, mu: float, multiplier: Floats, exact: float
) -> tuple[Floats, Floats, float]:
    """Gradient of the cost with its barrier, a step downhill, and the share of exact second derivatives in it."""
    R, N = np.empty((len(X), 4, 4)), np.empty((len(X), 4, 4))
    dX = np.empty_like(X)
    # Cholesky of the summed Hessian, with less and less of the exact second derivatives until it is positive definite
    while True:
        g, H = derivatives(problem, X, exact)
        add_planes(problem.planes, X, mu, multiplier, g, H)
        if factor_sum(problem.steps, H, R, N):
            solve(R, N, -g, dX)
            if np.vdot(g, dX) <= 0.0:
                return g, dX, exact
        if exact == 0.0:
            break
        exact = 0.5 * exact if exact > LEAST_EXACT else 0.0
    # Reflections of the rows of Gauss and Newton, which never fail
    factor_rows(problem.steps, H, R, N)
    solve(R, N, -g, dX)
    return g, dX, 0.0


def derivatives(problem: Problem, X: Floats, exact: float) -> tuple[Floats, Floats]:
    """Gradient (T, 4) of the cost, and the Hessian (T, 3) of all but the chain's part, by position; see `add_lines`."""
    g, H = np.zeros((len(X), 4)), np.zeros((len(X), 3))
    add_chain(problem.steps, X, g)
    add_lines(problem.lines, X, problem.loss, problem.k, exact, g, H)
    if len(problem.hints.step):
        add_hints(problem.hints, X, g, H)
    return g, H


def _search(problem: Problem, X: Floats, dX: Floats, slope: float, mu: float, here: float) -> tuple[float, float]:
    """Share of the step to take, and the cost after it; 0 if no share lowers the cost with its barrier."""
    # Fraction to the boundary: stay inside the constraints
    share, barrier = 1.0, 0.0
    if len(problem.planes.step):
        share = within(slack_change(problem.planes, dX), slack(problem.planes, X), TO_BOUNDARY)
        barrier = mu * barrier_cost(problem.planes, X)
    # Armijo: halve until the cost with its barrier falls enough; `noise` is the rounding of the cost
    noise = 1e-13 * (1.0 + abs(here) + abs(barrier))
    while share > SHORTEST:
        Y = X + share * dX
        then = cost(problem, Y)
        total = then + (mu * barrier_cost(problem.planes, Y) if mu > 0.0 else 0.0)
        if total <= here + barrier + ARMIJO * share * slope + noise:
            return share, then
        share *= 0.5
    return 0.0, here


def _follow(problem: Problem, X: Floats, dX: Floats, share: float, mu: float, multiplier: Floats) -> Floats:
    """(M,) multipliers after a primal-dual step, before X has moved; see `KAPPA`."""
    if not len(multiplier):
        return multiplier
    gap, change = slack(problem.planes, X), slack_change(problem.planes, dX)
    step = mu / gap - multiplier - multiplier / gap * change
    full = within(step, multiplier, TO_BOUNDARY)
    then = gap + share * change
    return np.asarray(np.clip(multiplier + full * step, mu / (KAPPA * then), KAPPA * mu / then))


def covariance(problem: Problem, X: Floats) -> Floats:
    """(T, 4, 4) covariance of each state: blocks of the inverse Hessian at X, without the constraints.

    The Hessian is that of Gauss and Newton, the information that the measurements have at X.
    """
    R, N, out = (np.empty((len(X), 4, 4)) for _ in range(3))
    factor_rows(problem.steps, derivatives(problem, X, 0.0)[1], R, N)
    inverse_blocks(R, N, out)
    return out
