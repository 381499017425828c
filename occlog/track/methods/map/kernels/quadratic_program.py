"""The paper's sequence of quadratic programs ([Rahimi] Sec. 5), for comparison with Newton's method.

Each program is the cost with residuals linearised about the last trajectory (Eq. 10) under the
constraints (Eq. 9).  A general solver takes it as sparse matrices; the step to its minimum is shortened
until it lowers the cost, without which some problems do not converge.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse

from occlog.array_types import Floats

from .interior_point import ARMIJO, SHORTEST, Iterate, Options, Solution, cost, derivatives
from .problem import TrajectoryProblem, slack


class Program(NamedTuple):
    """A quadratic program: minimise 1/2 d'P d + q.d over the change d (4 T,) of all states, subject to A d >= -b.

    P (4 T, 4 T) is sparse with both triangles, q (4 T,), A (M, 4 T) sparse, b (M,) the distances inside the
    constraints.
    """

    P: sparse.csc_matrix  # (4 T, 4 T), both triangles
    q: Floats  # (4 T,)
    A: sparse.csc_matrix  # (M, 4 T)
    b: Floats  # (M,) slacks


Solver = Callable[[Program], tuple[Floats, Floats]]
"""Change (4 T,) and multipliers (M,) of a program."""


def program(problem: TrajectoryProblem, X: Floats) -> Program:
    """Return the quadratic program of a change of the states X (T, 4) x, vx, y, vy.

    It has the cost with residuals linearised about X, under the constraints.
    """
    g, H = derivatives(problem, X, 0.0)
    u = 4 * np.arange(len(X))
    rows, columns = np.concatenate([u, u, u + 2, u + 2]), np.concatenate([u, u + 2, u, u + 2])
    blocks = sparse.csc_matrix(
        (np.concatenate([H[:, 0], H[:, 1], H[:, 1], H[:, 2]]), (rows, columns)), (4 * len(X),) * 2
    )
    G = _chain_rows(problem)
    t, M = 4 * problem.planes.step, len(problem.planes.step)
    A = sparse.csc_matrix(
        (problem.planes.normal.T.ravel(), (np.tile(np.arange(M), 2), np.concatenate([t, t + 2]))), (M, 4 * len(X))
    )
    return Program((G.T @ G + blocks).tocsc(), g.ravel(), A, slack(problem.planes, X))


def _chain_rows(problem: TrajectoryProblem) -> sparse.csc_matrix:
    """Return the sparse matrix G (4 T, 4 T) of the motion ([Rahimi] Eq. 3): |G d|^2 / 2 is its cost for a change d."""
    steps, T = problem.steps, problem.T
    after = steps.whiten[steps.kind]
    before = -np.einsum("tij,tjk->tik", after, steps.A[steps.kind])
    own = 4 * np.arange(T)[:, None, None] + np.zeros((4, 4), dtype=np.int64)
    i, j = np.arange(4)[:, None], np.arange(4)[None, :]
    values = np.concatenate([steps.whiten_first.ravel(), before.ravel(), after.ravel()])
    rows = np.concatenate([(own[:1] + i).ravel(), (own[1:] + i).ravel(), (own[1:] + i).ravel()])
    columns = np.concatenate([(own[:1] + j).ravel(), (own[:-1] + j).ravel(), (own[1:] + j).ravel()])
    return sparse.csc_matrix((values, (rows, columns)), (4 * T, 4 * T))


def sequential_programs(
    problem: TrajectoryProblem,
    start: Floats,
    options: Options,
    solver: Solver,
    watch: Callable[[Iterate], None] | None = None,
) -> Solution:
    """Return the local minimum reached from a start by sequential quadratic programs.

    The solution states whether it converged within the iterations.

    Args:
        problem: cost and constraints of the trajectory.
        start: (T, 4) states inside all constraints.
        options: when to stop; the barrier is not used.
        solver: solver of the quadratic programs.
        watch: called with the start and after every program; None: not.
    """
    X, here = np.array(start, dtype=np.float64), cost(problem, start)
    multiplier = np.zeros(len(problem.planes.step))
    if watch is not None:
        watch(Iterate(0, X.copy(), here, 0.0, 0.0, 0.0, 0.0))
    for number in range(1, options.most + 1):
        # Linearise and solve (Eqs. 7, 9 and 10)
        each = program(problem, X)
        change, multiplier = solver(each)
        dX, slope = change.reshape(-1, 4), float(each.q @ change)
        # Line search (Armijo)
        share, then = 1.0, cost(problem, X + dX)
        while not then <= here + ARMIJO * share * slope + 1e-13 * abs(here) and share > SHORTEST:
            share *= 0.5
            then = cost(problem, X + share * dX)
        moved = share * float(np.abs(dX[:, ::2]).max())
        if share > SHORTEST:
            X, here = X + share * dX, then
        if watch is not None:
            watch(Iterate(number, X.copy(), here, share, moved, 0.0, 0.0))
        if moved <= options.tolerance:
            return Solution(X, here, number, converged=share > SHORTEST, multiplier=multiplier)
    return Solution(X, here, options.most, converged=False, multiplier=multiplier)
