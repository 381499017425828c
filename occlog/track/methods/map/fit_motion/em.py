"""Identification of A and Sigma of linear Gaussian motion from trajectories ([Rahimi] Sec. 7).

`fit_em` takes positions as measured, with errors: the likelihood of the measurements is
raised by EM (Shumway & Stoffer 1982) and then, as EM is slow where little is left, by a
quasi-Newton method.  Both need only the E step: the gradient of the log-likelihood is that
of the expected one (Fisher's identity).  `fit_differences` takes positions for exact and
velocities for their central differences, and is a regression.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from occlog.array_types import Floats
from occlog.errors import option

from .parameters import SMALLEST, Shape, build, expected, limits, names, regression, slope, start
from .report import MotionFit, Optimum, at_limit, information, report
from .smoother import CV, MeasuredPath, Nodes, SmootherSums, make_nodes, smooth, split, transitions_by_differences

EM_STEPS = 25
CLOSE = 1e-3
"""Slope of the log-likelihood per standard error at which the search has converged."""
LEAST = 10
"""Measurements (or transitions) that a fit needs, and 3 for each parameter."""


class FitProblem(NamedTuple):
    """Measured positions at K equally spaced nodes, and what is fitted to them.

    Time is in steps of the model and length in units of `scale`; `R` (K, 2, 2) are the given measurement covariances (0
    where the noise is fitted).
    """

    nodes: Nodes
    shape: Shape
    scale: float
    R: Floats  # (K, 2, 2) given; 0 where noise is a parameter


def fit_em(
    paths: Sequence[MeasuredPath],
    step_s: float,
    shape: Shape,
    *,
    longest_gap_s: float,
    noise: float | None = None,
    rounds: int = 200,
) -> MotionFit:
    """Return the maximum-likelihood motion model of positions with measurement errors, by EM and a quasi-Newton method.

    Args:
        paths: positions of each object; their `cov` is the measurement noise if `shape.noise` is false
            and `noise` is None.
        step_s: step of the model [s], > 0.
        shape: which parameters are fitted; with `shape.noise` the standard deviation of positions, too.
        longest_gap_s: trajectories are cut at longer gaps [s].
        noise: standard deviation of the positions' errors, per axis, >= 0; None: fitted, or in the paths.
        rounds: largest number of iterations of the quasi-Newton method.

    Raises:
        ValueError: too few measurements, nothing moves, or no covariance where one is needed.
    """
    problem = prepare(paths, step_s, shape, longest_gap_s, noise)
    best = _maximise(problem, rounds)
    _, sums = e_step(problem, best.theta)
    known = information(lambda theta: _gradient(problem, theta), shape, best.theta)
    nodes = problem.nodes
    counts = (sums.n, int(nodes.seen.sum()), nodes.skipped, int(nodes.first.sum()))
    value = best.value - 2.0 * counts[1] * float(np.log(problem.scale))
    return report(shape, problem.scale, step_s, best._replace(value=value), known, counts)


def fit_differences(paths: Sequence[MeasuredPath], step_s: float, shape: Shape, *, longest_gap_s: float) -> MotionFit:
    """Fit the motion model by regression of each state on the previous one.

    Positions are taken as exact, velocities are central differences; errors of the positions become process noise. The
    log likelihood is that of the states, not comparable with that of `fit_em`; standard errors take residuals as
    independent.

    Args:
        paths: positions of each object.
        step_s: step of the model [s], > 0; positions are interpolated to it.
        shape: which parameters are fitted; all rows of A in the form `full`, and no measurement noise.
        longest_gap_s: trajectories are cut at longer gaps [s].

    Raises:
        ValueError: too few transitions, or nothing moves.
    """
    shape = shape._replace(noise=False, free=(0, 1, 2, 3))
    x, y = transitions_by_differences(paths, step_s, longest_gap_s)
    need(len(x), shape, "transitions")
    scale = _scale(x[:, [1, 3]])
    x, d = x / scale, (y - x @ CV.T) / scale
    sums = SmootherSums(len(x), d.T @ d, d.T @ x, x.T @ x, 0, np.zeros((2, 2)))
    bend = float(np.sqrt(np.mean(d[:, [1, 3]] ** 2)))
    theta, moved = start(shape, max(bend, SMALLEST)), np.inf
    rounds = 0
    while moved > 1e-9 and rounds < 50:
        new = m_step(shape, theta, sums, 200)
        moved, theta, rounds = float(np.abs(new - theta).max()), new, rounds + 1
    value = expected(shape, theta, sums) - 2.0 * len(x) * float(np.log(2.0 * np.pi) + 2.0 * np.log(scale))
    known = information(lambda at: slope(shape, at, sums), shape, theta)
    best = Optimum(theta, value + 2.0 * len(x) * float(np.log(step_s)), rounds, moved <= 1e-6, ())
    pieces = sum(len(split(p, longest_gap_s)) for p in paths)
    return report(shape, scale, step_s, best, known, (len(x), len(x), 0, pieces))


def need(count: int, shape: Shape, what: str) -> None:
    """Raise ValueError if `count` measurements are too few for the parameters of `shape`.

    `what` is their name in the message; `LEAST`, and 3 for each parameter, are needed.
    """
    least = max(LEAST, 3 * len(names(shape)))
    if count < least:
        raise ValueError(
            f"{count} {what} are too few for {len(names(shape))} parameters; at least {least} are "
            "needed: give longer records"
        )


def prepare(
    paths: Sequence[MeasuredPath], step_s: float, shape: Shape, longest_gap_s: float, noise: float | None = None
) -> FitProblem:
    """Return the fit problem of some paths: positions at equally spaced nodes, in units of steps and a length scale.

    Args:
        paths: positions of each object.
        step_s: step of the model [s].
        shape: which parameters are fitted.
        longest_gap_s: trajectories are cut at longer gaps [s].
        noise: standard deviation of the positions' errors, per axis; None: fitted, or in the paths.

    Raises:
        ValueError: too few measurements, nothing moves, or no covariance where one is needed.
    """
    nodes = make_nodes(paths, step_s, longest_gap_s)
    need(int(nodes.seen.sum()), shape, "positions")
    both = nodes.seen[1:] & nodes.seen[:-1] & ~nodes.first[1:]
    scale = _scale(np.diff(nodes.xy, axis=0)[both])
    R = nodes.cov.copy()
    if noise is not None:
        R[:] = noise**2 * np.eye(2)
    elif not shape.noise and not nodes.cov[nodes.seen].any():
        raise ValueError(
            f"the positions have no covariance (missing or 0); give {option('measurement_noise')} "
            "LENGTH, or omit it to have the noise estimated"
        )
    # Limit from below, as for noise that is fitted.
    R = R * (0.0 if shape.noise else scale**-2) + (0.0 if shape.noise else SMALLEST**2) * np.eye(2)
    return FitProblem(nodes._replace(xy=nodes.xy / scale), shape, scale, np.ascontiguousarray(R))


def _scale(steps: Floats) -> float:
    """Return the root mean square of steps (n, 2) as the length scale; ValueError if nothing moves."""
    scale = float(np.sqrt(np.mean(steps**2))) if len(steps) else 0.0
    if not scale > 0.0:
        raise ValueError(
            "nothing moves from one step to the next, so there is no motion to identify; give "
            "positions of objects that move"
        )
    return scale


def e_step(problem: FitProblem, theta: Floats) -> tuple[float, SmootherSums]:
    """Return the log likelihood of the scaled positions for parameters `theta`, and the sums of the E step."""
    A, sigma, noise = build(problem.shape, theta)
    n = problem.nodes
    R = problem.R if noise is None else np.broadcast_to(noise**2 * np.eye(2), problem.R.shape).copy()
    return smooth(first=n.first, seen=n.seen, off=n.off, xy=n.xy, R=R, A=np.ascontiguousarray(A), sigma=sigma)[:2]


def m_step(shape: Shape, theta: Floats, sums: SmootherSums, iterations: int = 15) -> Floats:
    """Return parameters that increase the expected log likelihood (M step), or `theta` if none are found.

    Args:
        shape: which parameters are fitted.
        theta: parameters before, in the order of `names(shape)`.
        sums: smoother sums under these parameters.
        iterations: largest number of iterations of the quasi-Newton method.
    """
    theta = regression(shape, theta, sums)
    size = 1.0 / max(1, sums.n + sums.m)

    def cost(at: Floats) -> tuple[float, Floats]:
        return -size * expected(shape, at, sums), -size * slope(shape, at, sums)

    found = minimize(
        cost,
        theta,
        jac=True,
        method="L-BFGS-B",
        bounds=list(limits(shape)),
        options={"maxiter": iterations, "gtol": 1e-10, "ftol": 1e-14},
    )
    return np.asarray(found.x) if -found.fun / size >= expected(shape, theta, sums) else theta


def em(problem: FitProblem, theta: Floats, steps: int) -> tuple[Floats, list[float]]:
    """Return the parameters after at most `steps` EM iterations from `theta`, and the log likelihood before each.

    The log likelihood never decreases; iterations end early if it hardly rises.
    """
    trace = []
    for _ in range(steps):
        value, sums = e_step(problem, theta)
        trace.append(value)
        if len(trace) > 1 and trace[-1] - trace[-2] < 1e-9 * abs(value):
            break
        theta = m_step(problem.shape, theta, sums)
    return theta, trace


def _gradient(problem: FitProblem, theta: Floats) -> Floats:
    """Return the gradient of the log likelihood by the parameters `theta`, by Fisher's identity."""
    return slope(problem.shape, theta, e_step(problem, theta)[1])


def _maximise(problem: FitProblem, rounds: int) -> Optimum:
    """Maximise the likelihood: EM from standard initial parameters, then L-BFGS-B with at most `rounds` iterations."""
    nodes, shape = problem.nodes, problem.shape
    three = nodes.seen[2:] & nodes.seen[1:-1] & nodes.seen[:-2] & ~nodes.first[2:] & ~nodes.first[1:-1]
    bends = np.diff(nodes.xy, n=2, axis=0)[three]
    bend = float(np.sqrt(np.mean(bends**2))) if len(bends) else 0.1
    theta, trace = em(problem, start(shape, max(bend, SMALLEST)), EM_STEPS)
    unit = _unit_sizes(problem, theta)

    def cost(at: Floats) -> tuple[float, Floats]:
        value, sums = e_step(problem, at * unit)
        return -value, -slope(shape, at * unit, sums) * unit

    found = minimize(
        cost,
        theta / unit,
        jac=True,
        method="L-BFGS-B",
        bounds=_scaled(limits(shape), unit),
        options={"maxiter": rounds, "gtol": CLOSE, "ftol": 1e-14, "maxcor": 30},
    )
    value, best = e_step(problem, theta)[0], theta
    if -found.fun >= value:
        value, best = -float(found.fun), np.asarray(found.x) * unit
    left = found.jac[[not at_limit(t, end) for t, end in zip(best, limits(shape), strict=True)]]
    found.success = bool(found.success) or bool(np.abs(left).max(initial=0.0) < 10.0 * CLOSE)
    return Optimum(best, value, len(trace) + int(found.nit), bool(found.success), tuple(trace))


def _unit_sizes(problem: FitProblem, theta: Floats) -> Floats:
    """Return approximate standard errors of the parameters `theta`, at most 1, as scales of the search.

    They are those for known states, at the E step's sums.
    """
    sums = e_step(problem, theta)[1]
    at = np.diag(information(lambda there: slope(problem.shape, there, sums), problem.shape, theta))
    return 1.0 / np.sqrt(np.where(at > 1.0, at, 1.0))


def _scaled(ends: Sequence[tuple[float | None, float | None]], unit: Floats) -> list[tuple[float | None, float | None]]:
    """Return the bounds `ends` (lower, upper; None: unbounded) of each parameter divided by its `unit`."""
    return [
        (None if low is None else low / u, None if high is None else high / u)
        for (low, high), u in zip(ends, unit, strict=True)
    ]
