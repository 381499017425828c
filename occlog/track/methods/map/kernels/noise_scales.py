"""How noisy bearings and motion really are: the scales that make a trajectory's residuals most probable.

Residuals of N lines of sight tell by how much their variances are off, and residuals of the motion by how much its
variance is; both are compared with what is left of each when gamma degrees of freedom have been fitted
(MacKay 1992, Bayesian interpolation, Neural Computation 4(3), Eqs. 4.8 to 4.10):

    s^2 = sum w r^2 / (sum w - gamma),   m^2 = chi^2 of the steps / gamma,   gamma = sum of the leverages.

At the maximum of the evidence both are 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

from .interior_point import covariance
from .problem import BearingLinesByStep, ChainSteps, TrajectoryProblem
from .terms import chain_cost, leverages, log_odds_offset, loss_slopes, residuals

PRIOR_RESIDUALS = 20.0
"""Weight of the stated variances, in residuals."""

STEP = 0.01
"""Step of the finite difference of covariances."""
BEYOND = 0.005
"""Share by which that difference may be more than all of a covariance, or less than nothing: it stays one by far."""
MIN_VARIANCE_SCALE, MAX_VARIANCE_SCALE = 0.2, 20.0
"""Limits of what residuals are taken to say of variances."""


class ResidualEvidence(NamedTuple):
    """Sums of squared normalised residuals of bearings and motion, with their effective degrees of freedom.

    `lines` and `lines_freedom` are of the bearings (weighted by the loss), `steps` and `steps_freedom` of the motion.
    """

    lines: float
    lines_freedom: float
    steps: float
    steps_freedom: float

    @property
    def lines_scale(self) -> float:
        """Factor of the stated variance of bearings that their residuals suggest, shrunk towards 1."""
        return (PRIOR_RESIDUALS + self.lines) / (PRIOR_RESIDUALS + self.lines_freedom)

    @property
    def steps_scale(self) -> float:
        """Factor of the stated variance of the motion that its residuals suggest, shrunk towards 1."""
        return (PRIOR_RESIDUALS + self.steps) / (PRIOR_RESIDUALS + self.steps_freedom)


@kernel
def weights(lines: BearingLinesByStep, X: Floats, loss: int, k: float) -> Floats:
    """Return (N,) weights, 0 to 1, of bearings in iteratively reweighted least squares at states X (T, 4).

    `loss` is SQUARE, HUBER, CAUCHY or MIXTURE, `k` its parameter [standard deviations].
    """
    r = residuals(lines, X)
    out = np.empty(r.shape[0])
    for n in range(out.shape[0]):
        out[n] = loss_slopes(r[n], loss, log_odds_offset(k, lines.lean[n]))[2]
    return out


def evidence(problem: TrajectoryProblem, X: Floats, spread: Floats) -> ResidualEvidence:
    """Return the sums of squared residuals of all bearings and motion steps, with their degrees of freedom.

    Args:
        problem: cost with the stated variances.
        X: (T, 4) states x, vx, y, vy at the minimum of the problem.
        spread: (T, 4, 4) covariances at the minimum.
    """
    lines, steps = problem.lines, problem.steps
    w = weights(lines, X, problem.loss, problem.k)
    r2 = residuals(lines, X) ** 2
    gamma = float(np.clip(leverages(lines, X, problem.loss, problem.k, spread), 0.0, 1.0).sum())
    first = steps.whiten_first @ (X[0] - steps.mean)
    return ResidualEvidence(
        lines=float(w @ r2),
        lines_freedom=max(float(w.sum()) - gamma, 0.0),
        steps=max(2.0 * chain_cost(steps, X) - float(first @ first), 0.0),
        steps_freedom=gamma,
    )


def rescaled(problem: TrajectoryProblem, lines2: float, steps2: float) -> TrajectoryProblem:
    """Return the problem with variances of bearings times `lines2`, and those of motion steps times `steps2`."""
    steps: ChainSteps = problem.steps._replace(
        sigma=problem.steps.sigma * steps2, whiten=problem.steps.whiten / np.sqrt(steps2)
    )
    lines = problem.lines._replace(c0=problem.lines.c0 * lines2, c1=problem.lines.c1 * lines2)
    return problem._replace(steps=steps, lines=lines)


def sandwich(problem: TrajectoryProblem, X: Floats, spread: Floats) -> Floats:
    """Return state covariances (T, 4, 4) with the noise of bearings and motion scaled to their residuals.

    With C the inverse of M + G, M the information of bearings and G that of the motion, the covariance is
    C (s^2 M + m^2 G) C; C M C is the derivative of C by the variance of the bearings.  The motion counts as
    stated at least: a target that stood still may move off.

    Args:
        problem: cost, with the variances of the search.
        X: (T, 4) states at the minimum of the problem.
        spread: (T, 4, 4) C.
    """
    residual_evidence = evidence(problem, X, spread)
    s2, m2 = (
        min(max(residual_evidence.lines_scale, MIN_VARIANCE_SCALE), MAX_VARIANCE_SCALE),
        min(max(residual_evidence.steps_scale, 1.0), MAX_VARIANCE_SCALE),
    )
    by_lines = (covariance(rescaled(problem, 1.0 + STEP, 1.0), X) - spread) / STEP
    by_lines = between(by_lines, spread)
    return np.asarray(spread + (s2 - 1.0) * by_lines + (m2 - 1.0) * (spread - by_lines))


def between(part: Floats, whole: Floats) -> Floats:
    """Return covariances `part` (T, 4, 4) clipped to between 0 and `whole` (T, 4, 4), against rounding errors.

    Relative to `whole`, eigenvalues are limited to 0 to 1 where one exceeds that by more than `BEYOND`.
    """
    size, axes = np.linalg.eigh(whole)
    root = axes * np.sqrt(np.maximum(size, np.finfo(np.float64).tiny))[:, None, :]
    back = np.linalg.pinv(root, rcond=0.0)
    share, directions = np.linalg.eigh(back @ part @ back.transpose(0, 2, 1))
    beyond = ((share < -BEYOND) | (share > 1.0 + BEYOND)).any(axis=1)
    if not beyond.any():
        return part
    axes = root[beyond] @ directions[beyond]
    out = part.copy()
    out[beyond] = (axes * np.clip(share[beyond], 0.0, 1.0)[:, None, :]) @ axes.transpose(0, 2, 1)
    return out
