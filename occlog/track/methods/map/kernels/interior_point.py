"""Newton's method inside constraints: a point to start from, the search, and the system of each step.

Points strictly inside half-planes: where an interior point method can start.

The most probable trajectory, [Rahimi] Sec. 5: Newton's method inside the constraints.

A primal-dual interior point method: the inequalities enter by a logarithmic barrier with
a weight mu that falls to nearly 0, and their multipliers are estimated with the states.  Each
iteration takes time linear in the number of states (`occlog.track.methods.map.kernels.interior_point`).
Steps start with the second derivatives of Gauss and Newton, which always lead downhill;
near the minimum the exact ones are taken where they are positive, so that the last
iterations converge quadratically.  Every step is shortened until it stays inside the
constraints and lowers the cost (without that some problems do not converge).

The Newton system of a trajectory in time and memory linear in its length.

The Hessian of the cost is block-tridiagonal: the chain couples neighbours, all else adds a
2 x 2 block in the position of each state.  It is factored as R' R, R upper block-bidiagonal
with blocks R_t on the diagonal and N_t next to them, in one of two ways:

* `factor_sum` sums the Hessian and takes the Cholesky factor of its blocks: quick, and the
  only way for a Hessian that is the difference of large terms.  It fails where the Hessian is
  not positive definite, or so badly scaled that it cannot be decided (steps far below a millisecond);
* `factor_rows` makes R by Householder reflections of the rows with squares that sum to the Hessian, and
  never forms it, so that twice as many digits are left.  It never fails, and is about three times as slow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.jit import kernel

from .problem import ChainSteps, HalfPlanes, TrajectoryProblem, slack, slack_change, within
from .terms import (
    add_chain,
    add_lines,
    add_planes,
    add_priors,
    barrier_cost,
    chain_cost,
    lines_cost,
    priors_cost,
)

ROUNDS = 200
"""Rounds of projections for one margin; then the corners are tried, which takes time cubic in the constraints."""
THINNEST = 1e-6
"""Margin, as a share of the first one, below which a state's constraints count as contradictory."""


def move_inside(X: Floats, planes: HalfPlanes, margin: float) -> tuple[Floats, Bools]:
    """Move states as little as needed to satisfy all half-planes with a margin, each state separately.

    Args:
        X: (T, 4) states x, vx, y, vy; only positions change, in a copy.
        planes: M half-planes, sorted by state.
        margin: distance to each, > 0; where there is not so much room, less is taken, down to `THINNEST` of it.

    Returns:
        The states, and a mask (T,) of states that cannot satisfy all of theirs.
    """
    out = np.array(X, dtype=np.float64)
    contradictory = np.zeros(len(X), dtype=np.bool_)
    if len(planes.step):
        _project(out, planes, margin, contradictory)
    return out, contradictory


@kernel
def _project(X: Floats, planes: HalfPlanes, margin: float, contradictory: Bools) -> None:
    """Project each state of X (T, 4) repeatedly onto its most violated half-plane, in place, with decreasing margin.

    `contradictory` (T,) is written for states with half-planes: whether not even `THINNEST` of the margin is possible.
    """
    M = planes.step.shape[0]
    first = 0
    while first < M:
        t, last = planes.step[first], first
        while last < M and planes.step[last] == t:
            last += 1
        want = margin
        while want >= margin * THINNEST:
            if _reach(X, planes, first, last, want):
                break
            want *= 0.25
        contradictory[t] = want < margin * THINNEST
        first = last


@kernel
def _reach(X: Floats, planes: HalfPlanes, first: int, last: int, want: float) -> bool:
    """Move one state of X (T, 4) in place until it satisfies its half-planes first .. last - 1 by the distance `want`.

    Return False if no such position is found.
    """
    t = planes.step[first]
    for _ in range(ROUNDS):
        worst, which = 0.0, -1
        for m in range(first, last):
            lack = want + planes.offset[m] - planes.normal[m, 0] * X[t, 0] - planes.normal[m, 1] * X[t, 2]
            if lack > worst:
                worst, which = lack, m
        if which < 0:
            return True
        # A little too far, so that corners are reached in finitely many moves.
        X[t, 0] += 1.1 * worst * planes.normal[which, 0]
        X[t, 2] += 1.1 * worst * planes.normal[which, 1]
    return _corner(X, planes, first, last, want)


@kernel
def _corner(X: Floats, planes: HalfPlanes, first: int, last: int, want: float) -> bool:
    """Move one state of X (T, 4) in place to the nearest feasible corner of its half-planes first .. last - 1.

    It satisfies all of them by at least half of `want`; return False if there is none. Used where projections converge
    slowly, in narrow wedges.
    """
    t, n, nearest = planes.step[first], planes.normal, np.inf
    x, y = X[t, 0], X[t, 2]
    for i in range(first, last):
        for j in range(first, i):
            det = n[i, 0] * n[j, 1] - n[i, 1] * n[j, 0]
            if abs(det) < 1e-12:
                continue
            a, b = planes.offset[i] + want, planes.offset[j] + want
            u, v = (a * n[j, 1] - b * n[i, 1]) / det, (b * n[i, 0] - a * n[j, 0]) / det
            away = (u - x) ** 2 + (v - y) ** 2
            if away < nearest and _least(planes, first, last, u, v) > 0.5 * want:  # want, but for rounding
                nearest, X[t, 0], X[t, 2] = away, u, v
    return bool(nearest < np.inf)


@kernel
def _least(planes: HalfPlanes, first: int, last: int, u: float, v: float) -> float:
    """Return the smallest distance of point (u, v) inside half-planes first .. last - 1; negative: outside."""
    least = np.inf
    for m in range(first, last):
        least = min(least, planes.normal[m, 0] * u + planes.normal[m, 1] * v - planes.offset[m])
    return float(least)


@kernel
def _square(U: Floats, out: Floats) -> None:
    """Write U' U to `out` (4, 4), for a lower triangular U (4, 4)."""
    for i in range(4):
        for j in range(i + 1):
            v = 0.0
            for k in range(i, 4):
                v += U[k, i] * U[k, j]
            out[i, j] = v
            out[j, i] = v


@kernel
def _cholesky(S: Floats, R: Floats) -> bool:
    """Write the upper triangular R (4, 4) with S = R' R, the Cholesky factor of a symmetric S (4, 4).

    Return False, with R incomplete, if S is not numerically positive definite.
    """
    for i in range(4):
        v = S[i, i]
        for k in range(i):
            v -= R[k, i] * R[k, i]
        if not v > 1e-15 * S[i, i]:
            return False
        root = math.sqrt(v)
        R[i, i] = root
        for j in range(i):
            R[i, j] = 0.0
        for j in range(i + 1, 4):
            w = S[i, j]
            for k in range(i):
                w -= R[k, i] * R[k, j]
            R[i, j] = w / root
    return True


@kernel
def factor_sum(steps: ChainSteps, H: Floats, R: Floats, N: Floats) -> bool:
    """Factor the Hessian as R' R by Cholesky; return False if it is not numerically positive definite.

    Args:
        steps: the motion chain.
        H: (T, 3) Hessian of all other terms by position: xx, xy, yy.
        R: (T, 4, 4) written: diagonal blocks, upper triangular.
        N: (T, 4, 4) written: blocks to the right of them; the last one is 0.
    """
    T = H.shape[0]
    S, W, B = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    _square(steps.whiten_first, S)
    for t in range(T):
        # S is the block of state t, from which the states before it are eliminated
        S[0, 0] += H[t, 0]
        S[0, 2] += H[t, 1]
        S[2, 0] += H[t, 1]
        S[2, 2] += H[t, 2]
        if t == T - 1:
            N[t] = 0.0
            return _cholesky(S, R[t])
        A = steps.A[steps.kind[t]]
        _square(steps.whiten[steps.kind[t]], W)
        for i in range(4):
            for j in range(4):
                B[i, j] = A[0, i] * W[0, j] + A[1, i] * W[1, j] + A[2, i] * W[2, j] + A[3, i] * W[3, j]
        for i in range(4):
            for j in range(i, 4):
                v = B[i, 0] * A[0, j] + B[i, 1] * A[1, j] + B[i, 2] * A[2, j] + B[i, 3] * A[3, j]
                S[i, j] += v
        if not _cholesky(S, R[t]):
            return False
        for j in range(4):  # N = -R'^-1 A' W
            for i in range(4):
                v = -B[i, j]
                for k in range(i):
                    v -= R[t, k, i] * N[t, k, j]
                N[t, i, j] = v / R[t, i, i]
        for i in range(4):  # Schur complement: the block of the next state
            for j in range(i, 4):
                v = W[i, j]
                for k in range(4):
                    v -= N[t, k, i] * N[t, k, j]
                S[i, j] = v
                S[j, i] = v
    return True


@kernel
def _reflect(M: Floats, rows: int, columns: int, start: int, count: int) -> None:
    """Triangularise `count` columns of M from column `start` by Householder reflections, in place.

    Column start + c becomes 0 below row c; only the first `rows` rows and `columns` columns of M are used.
    """
    for c in range(count):
        j, norm2 = start + c, 0.0
        for i in range(c, rows):
            norm2 += M[i, j] * M[i, j]
        if norm2 == 0.0:
            continue
        alpha = -math.copysign(math.sqrt(norm2), M[c, j])
        head = M[c, j] - alpha
        scale = 1.0 / (alpha * head)  # -2 / |v|^2 with v = (head, rest)
        M[c, j] = alpha
        for k in range(j + 1, columns):
            v = head * M[c, k]
            for i in range(c + 1, rows):
                v += M[i, j] * M[i, k]
            v *= scale
            M[c, k] += v * head
            for i in range(c + 1, rows):
                M[i, k] += v * M[i, j]
        for i in range(c + 1, rows):
            M[i, j] = 0.0


@kernel
def factor_rows(steps: ChainSteps, H: Floats, R: Floats, N: Floats) -> None:
    """Factor a Gauss-Newton Hessian as R' R by Householder reflections, without forming it; never fails.

    Args:
        steps: the motion chain.
        H: (T, 3) Hessian of all other terms by position, positive semidefinite: xx, xy, yy.
        R: (T, 4, 4) written: diagonal blocks, upper triangular.
        N: (T, 4, 4) written: blocks to the right of them; the last one is 0.
    """
    T = H.shape[0]
    M, rest = np.empty((10, 8)), np.empty((6, 4))
    before = steps.whiten_first.copy()
    for t in range(T):
        # Rows: what is known of state t, its measurements as a root of H, and the step to t + 1
        M[:] = 0.0
        M[:4, :4] = before
        M[4, 0] = math.sqrt(max(H[t, 0], 0.0))
        M[4, 2] = H[t, 1] / M[4, 0] if M[4, 0] > 0.0 else 0.0
        M[5, 2] = math.sqrt(max(H[t, 2] - M[4, 2] ** 2, 0.0))
        if t == T - 1:
            _reflect(M, 6, 4, 0, 4)
            R[t] = M[:4, :4]
            N[t] = 0.0
            return
        A, U = steps.A[steps.kind[t]], steps.whiten[steps.kind[t]]
        for i in range(4):
            for j in range(4):
                v = 0.0
                for k in range(i + 1):
                    v += U[i, k] * A[k, j]
                M[6 + i, j] = -v
                M[6 + i, 4 + j] = U[i, j]
        _reflect(M, 10, 8, 0, 4)
        R[t] = M[:4, :4]
        N[t] = M[:4, 4:]
        rest[:] = M[4:, 4:]
        _reflect(rest, 6, 4, 0, 4)
        before[:] = rest[:4]


@kernel
def solve(R: Floats, N: Floats, b: Floats, x: Floats) -> None:
    """Solve R' R x = b for vectors b (T, 4), and write x (T, 4).

    R (T, 4, 4) are upper triangular blocks on the diagonal, N (T, 4, 4) those to the right of them.
    """
    T = R.shape[0]
    for t in range(T):  # forward: R' y = b
        for i in range(4):
            v = b[t, i]
            for k in range(i):
                v -= R[t, k, i] * x[t, k]
            if t > 0:
                for k in range(4):
                    v -= N[t - 1, k, i] * x[t - 1, k]
            x[t, i] = v / R[t, i, i]
    for t in range(T - 1, -1, -1):  # backward: R x = y
        for i in range(3, -1, -1):
            v = x[t, i]
            for k in range(i + 1, 4):
                v -= R[t, i, k] * x[t, k]
            if t < T - 1:
                for k in range(4):
                    v -= N[t, i, k] * x[t + 1, k]
            x[t, i] = v / R[t, i, i]


@kernel
def inverse_blocks(R: Floats, N: Floats, out: Floats) -> None:
    """Write the diagonal blocks (T, 4, 4) of the inverse of R' R to `out`: the covariance of each state.

    R (T, 4, 4) are upper triangular blocks on the diagonal, N (T, 4, 4) those to the right of them.
    """
    T = R.shape[0]
    inverse, E = np.zeros((4, 4)), np.empty((4, 4))
    for t in range(T - 1, -1, -1):
        for j in range(4):
            for i in range(3, -1, -1):
                v = 1.0 if i == j else 0.0
                for k in range(i + 1, 4):
                    v -= R[t, i, k] * inverse[k, j]
                inverse[i, j] = v / R[t, i, i]
        out[t] = inverse @ inverse.T
        if t < T - 1:
            E[:] = inverse @ np.ascontiguousarray(N[t])
            out[t] += E @ out[t + 1] @ E.T
        for i in range(4):
            for j in range(i):
                v = 0.5 * (out[t, i, j] + out[t, j, i])
                out[t, i, j] = v
                out[t, j, i] = v


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
MIN_EXACT = 0.1
"""A smaller share of them is not tried."""


class Iterate(NamedTuple):
    """One iteration of the search: its number (0: the start), the T states after it, and how it went.

    `X` (T, 4) x, vx, y, vy, `cost`, `step` (share of the Newton step taken), `moved` (largest change of a position),
    barrier weight `mu`, and `exact`, the share of exact second derivatives.
    """

    number: int  # 0: the start
    X: Floats  # (T, 4) states after it
    cost: float
    step: float  # share of the Newton step that was taken
    moved: float  # largest change of a position
    mu: float
    exact: float  # share of the exact second derivatives


class Solution(NamedTuple):
    """End of a search for the minimum: states X (T, 4) x, vx, y, vy, cost, iterations, and whether it converged.

    `multiplier` (M,) are the Lagrange multipliers of the M constraints.
    """

    X: Floats  # (T, 4)
    cost: float
    iterations: int
    converged: bool
    multiplier: Floats  # (M,) of the constraints


class Options(NamedTuple):
    """Stopping criteria of a search, and its first barrier weight `mu`.

    `tolerance` is the largest change of a position in the last iteration [scene unit], `most` the number of iterations.
    """

    tolerance: float  # largest change of a position in the last iteration
    most: int = 200  # iterations
    mu: float = MU_FIRST  # weight of the barrier initially


def cost(problem: TrajectoryProblem, X: Floats) -> float:
    """Return the negative log posterior of states X (T, 4) x, vx, y, vy, up to a constant; constraints do not count."""
    total: float = chain_cost(problem.steps, X) + lines_cost(problem.lines, X, problem.loss, problem.k)
    return total + priors_cost(problem.hints, X) if len(problem.hints.step) else total


def minimise(
    problem: TrajectoryProblem, start: Floats, options: Options, watch: Callable[[Iterate], None] | None = None
) -> Solution:
    """Return the local minimum of the cost inside the constraints, reached from a start by the interior point method.

    The solution states whether it converged within the iterations.

    Args:
        problem: cost and constraints of the trajectory.
        start: (T, 4) states x, vx, y, vy, strictly inside all constraints.
        options: when to stop.
        watch: called with the start and after every iteration; None: not.

    Raises:
        ValueError: the start is not inside the constraints.
    """
    X = np.array(start, dtype=np.float64)
    gap = slack(problem.planes, X)
    if len(gap) and not gap.min() > 0.0:
        raise ValueError(
            f"the start of the search is outside constraint {int(np.argmin(gap))} by "
            f"{-gap.min():g}; start inside all half-planes"
        )
    mu = options.mu if len(gap) else 0.0
    multiplier = mu / gap
    here, promise, exact = cost(problem, X), math.inf, 1.0
    if watch is not None:
        watch(Iterate(0, X.copy(), here, 0.0, 0.0, mu, 0.0))
    for number in range(1, options.most + 1):
        # Newton direction; exact second derivatives are tried near the minimum
        tried = min(1.0, 2.0 * exact + MIN_EXACT) if promise < NEAR else 0.0
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
    problem: TrajectoryProblem, X: Floats, mu: float, multiplier: Floats, exact: float
) -> tuple[Floats, Floats, float]:
    """Return the gradient (T, 4) of the barrier cost, a descent step (T, 4), and its share of exact second derivatives.

    Args:
        problem: cost and constraints of the trajectory.
        X: (T, 4) states.
        mu: weight of the barrier.
        multiplier: (M,) of the constraints.
        exact: share of exact second derivatives to begin with, 0 to 1; it is lowered until the Hessian is positive
            definite.
    """
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
        exact = 0.5 * exact if exact > MIN_EXACT else 0.0
    # Reflections of the rows of Gauss and Newton, which never fail
    factor_rows(problem.steps, H, R, N)
    solve(R, N, -g, dX)
    return g, dX, 0.0


def derivatives(problem: TrajectoryProblem, X: Floats, exact: float) -> tuple[Floats, Floats]:
    """Return the gradient (T, 4) of the cost at X (T, 4), and its Hessian (T, 3) by position: xx, xy, yy.

    The Hessian is without the motion chain's part; `exact` is the share of exact second derivatives of bearings, 0:
    those of Gauss and Newton.
    """
    g, H = np.zeros((len(X), 4)), np.zeros((len(X), 3))
    add_chain(problem.steps, X, g)
    add_lines(problem.lines, X, problem.loss, problem.k, exact, g, H)
    if len(problem.hints.step):
        add_priors(problem.hints, X, g, H)
    return g, H


def _search(
    problem: TrajectoryProblem, X: Floats, dX: Floats, slope: float, mu: float, here: float
) -> tuple[float, float]:
    """Return the share, 0 to 1, of a step that lowers the barrier cost enough (Armijo), and the cost there.

    It keeps inside the constraints; 0 if no share lowers it. The cost is without the barrier.

    Args:
        problem: cost and constraints of the trajectory.
        X: (T, 4) states.
        dX: (T, 4) the step.
        slope: derivative of the barrier cost along it, < 0.
        mu: weight of the barrier.
        here: cost at X.
    """
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


def _follow(problem: TrajectoryProblem, X: Floats, dX: Floats, share: float, mu: float, multiplier: Floats) -> Floats:
    """Return the multipliers (M,) of the constraints after a primal-dual step.

    They are kept within the factor `KAPPA` of mu / slack.

    Args:
        problem: cost and constraints of the trajectory.
        X: (T, 4) states before the step.
        dX: (T, 4) the whole step.
        share: share of the step that is taken.
        mu: weight of the barrier.
        multiplier: (M,) multipliers before.
    """
    if not len(multiplier):
        return multiplier
    gap, change = slack(problem.planes, X), slack_change(problem.planes, dX)
    step = mu / gap - multiplier - multiplier / gap * change
    full = within(step, multiplier, TO_BOUNDARY)
    then = gap + share * change
    return np.asarray(np.clip(multiplier + full * step, mu / (KAPPA * then), KAPPA * mu / then))


def covariance(problem: TrajectoryProblem, X: Floats) -> Floats:
    """Return state covariances (T, 4, 4) at X (T, 4): diagonal blocks of the inverse Gauss-Newton Hessian.

    States are x, vx, y, vy; constraints do not count.
    """
    R, N, out = (np.empty((len(X), 4, 4)) for _ in range(3))
    factor_rows(problem.steps, derivatives(problem, X, 0.0)[1], R, N)
    inverse_blocks(R, N, out)
    return out
