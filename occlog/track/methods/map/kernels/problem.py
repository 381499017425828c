"""The trajectory of one target as one problem of optimisation: its cost, its constraints, and their arrays.

The negative log posterior of the states x_1 .. x_T, [u u' v v'] each, is up to a constant

    E(X) = 1/2 |x_1 - m|^2_P0 + 1/2 sum |x_t+1 - A_t x_t|^2_Sigma_t + sum loss(r_n(x_t)) + log w_n

([Rahimi] Sec. 5, with -log J in the cost in place of the constraints), subject to n.(u, v) >= b for
every half-plane.  The residual r of a line of sight of a camera at p with optical axis (c, s) is

    r = (f h - z d) / sqrt(c0 d^2 + c1),  d = c dx + s dy,  h = -s dx + c dy

which is (f h/d - z) / sigma of Eq. 4 with the variance sigma^2 = c0 + c1 / d^2 that the distance
d may have a part in ([Ercan] Eq. 2); log w = 1/2 log(c0 + c1 / d^2) where it does.  The residual
of a direction is atan2(h, d) / sqrt(c0), with (c, s) the measured direction itself.

First guesses of a trajectory: on the cameras' axes ([Rahimi] Sec. 6), or by a linear problem.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .gauss_markov import GaussMarkov, transitions

SQUARE, HUBER, CAUCHY, MIXTURE = 0, 1, 2, 3
"""Loss of a residual r: r^2/2; Huber's, linear beyond k; Cauchy's, k^2/2 log(1 + (r/k)^2); or that of a mixture of
true and false lines of sight, - log((exp(-r^2/2) + c) / (1 + c)) with c = exp(-k^2/2), so that at k both are as
likely."""


class ChainSteps(NamedTuple):
    """Gaussian prior of the first state x, vx, y, vy, and the motion steps of a trajectory of T states.

    `mean` (4,), `spread` (4, 4): the prior; `kind` (T - 1,): kind of each step; `A`, `sigma` (K, 4, 4): transition
    matrix and noise covariance of a kind; `whiten`, `whiten_first`: inverses of the lower Cholesky factors of `sigma`
    and `spread`.
    """

    mean: Floats  # (4,) of x_1
    spread: Floats  # (4, 4) covariance of x_1, P0
    kind: Ints  # (T - 1,) which kind of step leads from x_t to x_t+1
    A: Floats  # (K, 4, 4)
    sigma: Floats  # (K, 4, 4)
    whiten: Floats  # (K, 4, 4) inverse of the lower Cholesky factor of sigma
    whiten_first: Floats  # (4, 4) the same of `spread`


class BearingLinesByStep(NamedTuple):
    """N bearings of a target as lines of sight, sorted by state.

    `step` (N,): index of the state; sensor `position` (N, 2) and unit vector `axis` (N, 2): the optical axis, or the
    measured direction where `direction` is true; focal length `focal` and `reading` to the left of the axis [px];
    variance of the reading at distance d along the axis c0 + c1 / d^2 [px^2] (of a direction c0 [rad^2]); `volume`:
    weight of - log d in the cost; `lean`: added to the log odds that the bearing is true (mixture loss).
    """

    step: Ints  # (N,) which state is seen, from 0
    position: Floats  # (N, 2) of the sensor
    axis: Floats  # (N, 2) unit vector: optical axis, or the measured direction
    focal: Floats  # (N,) f [px]
    reading: Floats  # (N,) z [px], to the left
    c0: Floats  # (N,) variance of the reading [px^2], or of the direction [rad^2]; 0 where the residual is linear
    c1: Floats  # (N,) variance of the reading times distance squared; 0 for directions
    direction: Bools  # (N,) a direction, not a reading
    volume: Floats  # (N,) weight of - log d in the cost, >= 0; see `occlog.track.methods.map.kernels.invariant`
    lean: Floats  # (N,) added to the log odds that a line of sight is true, of the mixture's loss; 0: by its k alone


class HalfPlanes(NamedTuple):
    """M constraints normal . (x, y) >= offset on positions of a trajectory, sorted by state.

    `step` (M,) is the index of the state, `normal` (M, 2) unit vectors, `offset` (M,).
    """

    step: Ints  # (M,)
    normal: Floats  # (M, 2) unit vectors
    offset: Floats  # (M,)


class QuadraticPriors(NamedTuple):
    """K quadratic terms of positions x, sorted by state: g . (x - p) + 1/2 (x - p)' H (x - p), H positive semidefinite.

    `step` (K,) is the index of the state, `position` (K, 2) p, `slope` (K, 2) g, `bend` (K, 3) the entries xx, xy, yy
    of H.
    """

    step: Ints  # (K,) which state
    position: Floats  # (K, 2) p
    slope: Floats  # (K, 2) g
    bend: Floats  # (K, 3) H: xx, xy, yy


class TrajectoryProblem(NamedTuple):
    """Cost and constraints of a trajectory of T states x, vx, y, vy.

    Motion chain `steps`, bearings `lines`, half-planes `planes`, `loss` of residuals (SQUARE, HUBER, CAUCHY or MIXTURE)
    with its parameter `k` [standard deviations], and quadratic terms `hints`.
    """

    steps: ChainSteps
    lines: BearingLinesByStep
    planes: HalfPlanes
    loss: int  # SQUARE, HUBER, CAUCHY or MIXTURE
    k: float  # parameter of the loss, in standard deviations
    hints: QuadraticPriors = QuadraticPriors(
        np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 3))
    )

    @property
    def T(self) -> int:  # noqa: N802
        """Number of states of the trajectory."""
        return len(self.steps.kind) + 1


MAX_GROWTH = 100.0
"""Decimal logarithm of the factor by which a motion may grow over a whole record."""
NO_PLANES = HalfPlanes(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty(0))


def chain(model: GaussMarkov, dt: Floats, mean: Floats, spread: Floats) -> ChainSteps:
    """Return the motion chain of T states with steps of given lengths.

    Args:
        model: how the target moves.
        dt: (T - 1,) lengths of the steps [s], > 0.
        mean: (4,) x, vx, y, vy of the first state.
        spread: (4, 4) covariance of the first state, positive definite.

    Raises:
        ValueError: the model's A has no real logarithm but a step has another length than the model's, or the motion
            grows by more than a factor of 10^100 over all steps.
        numpy.linalg.LinAlgError: a noise or `spread` is not positive definite.
    """
    radius = float(np.abs(np.linalg.eigvals(model.A)).max())
    if not np.log10(max(radius, 1e-300)) * float(dt.sum()) / model.step_s < MAX_GROWTH:
        raise ValueError("the motion grows without bound over these times (spectral radius of A above 1)")
    lengths, kind = np.unique(np.round(dt, 9), return_inverse=True)
    A, sigma = transitions(model, lengths)
    eye = np.broadcast_to(np.eye(4), sigma.shape)
    whiten = np.linalg.solve(np.linalg.cholesky(sigma), eye) if len(sigma) else sigma
    first = np.linalg.solve(np.linalg.cholesky(spread), np.eye(4))
    return ChainSteps(
        mean=np.ascontiguousarray(mean, dtype=np.float64),
        spread=np.ascontiguousarray(spread, dtype=np.float64),
        kind=kind.astype(np.int64),
        A=A,
        sigma=sigma,
        whiten=np.ascontiguousarray(whiten),
        whiten_first=first,
    )


def some_lines(lines: BearingLinesByStep, rows: slice | Bools | Ints) -> BearingLinesByStep:
    """Return the bearing lines at `rows`: a slice, a mask (N,) or indices."""
    return BearingLinesByStep._make(column[rows] for column in lines)


def some_planes(planes: HalfPlanes, rows: slice | Bools) -> HalfPlanes:
    """Return the half-planes at `rows`: a slice or a mask (M,)."""
    return HalfPlanes(planes.step[rows], planes.normal[rows], planes.offset[rows])


def select_priors(hints: QuadraticPriors, rows: slice | Bools) -> QuadraticPriors:
    """Return the quadratic terms `hints` at `rows`: a slice or a mask (K,)."""
    return QuadraticPriors._make(column[rows] for column in hints)


def join_lines(*parts: BearingLinesByStep) -> BearingLinesByStep:
    """Concatenate sets of lines of sight to one, sorted by state."""
    order = np.argsort(np.concatenate([p.step for p in parts]), kind="stable")
    joined = BearingLinesByStep(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    return some_lines(joined, order)


def join_planes(*parts: HalfPlanes) -> HalfPlanes:
    """Concatenate sets of half-planes to one, sorted by state."""
    step = np.concatenate([p.step for p in parts])
    order = np.argsort(step, kind="stable")
    normal, offset = np.concatenate([p.normal for p in parts]), np.concatenate([p.offset for p in parts])
    return HalfPlanes(step[order], np.ascontiguousarray(normal[order]), offset[order])


@kernel
def slack(planes: HalfPlanes, X: Floats) -> Floats:
    """Return (M,) distances of the states X (T, 4) inside their half-planes; negative where violated."""
    out = np.empty(planes.step.shape[0])
    for m in range(out.shape[0]):
        t = planes.step[m]
        out[m] = planes.normal[m, 0] * X[t, 0] + planes.normal[m, 1] * X[t, 2] - planes.offset[m]
    return out


@kernel
def slack_change(planes: HalfPlanes, dX: Floats) -> Floats:
    """Return (M,) changes of the distances to the half-planes for a change dX (T, 4) of the states."""
    out = np.empty(planes.step.shape[0])
    for m in range(out.shape[0]):
        t = planes.step[m]
        out[m] = planes.normal[m, 0] * dX[t, 0] + planes.normal[m, 1] * dX[t, 2]
    return out


@kernel
def within(change: Floats, size: Floats, share: float) -> float:
    """Return the largest share, at most 1, of a step at which no size decreases by more than `share` of itself.

    `size` (M,) are positive, `change` (M,) their changes over the whole step.
    """
    most = 1.0
    for m in range(size.shape[0]):
        if change[m] * most < -share * size[m]:
            most = -share * size[m] / change[m]
    return most


def start_on_axes(lines: BearingLinesByStep, T: int, centre: Floats, depth: float) -> Floats:
    """Return initial states (T, 4) on the axis of a camera that saw them, else in the centre ([Rahimi] Sec. 6).

    A state seen by several cameras is put on the axis of the last, which satisfies the constraints of that camera only.

    Args:
        lines: N lines of sight.
        T: number of states.
        centre: (2,) position of the others.
        depth: distance along the axis, > 0; the paper's is one metre.
    """
    X = np.zeros((T, 4))
    X[:, ::2] = centre
    X[lines.step, ::2] = lines.position + depth * lines.axis
    return X


def linear_problem(problem: TrajectoryProblem, distance: Floats) -> TrajectoryProblem:
    """Return the problem with residuals that are linear in the state, and square loss.

    r = (f h - z d) / (sigma D), with offset h and depth d of the state, focal length f, reading z, and a fixed distance
    D in place of d.

    Args:
        problem: cost and constraints of a trajectory, with any loss.
        distance: (N,) D of every line of sight, > 0.
    """
    lines = problem.lines
    sigma2 = lines.c0 + lines.c1 / distance**2
    flat = lines._replace(
        focal=np.where(lines.direction, 1.0, lines.focal),
        reading=np.where(lines.direction, 0.0, lines.reading),
        c0=np.zeros(len(sigma2)),
        c1=sigma2 * distance**2,
        direction=np.zeros(len(sigma2), dtype=np.bool_),
        volume=np.zeros(len(sigma2)),
    )
    return problem._replace(lines=flat, loss=0)
