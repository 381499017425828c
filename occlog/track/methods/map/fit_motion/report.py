"""A fitted motion model in the units of the data, and how sure it is.

Standard errors are of the observed information, carried to A and Sigma by the delta method.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.track.methods.map.kernels.gauss_markov import GaussMarkov

from .parameters import MotionModelParameters, Shape, build, limits, names

UNKNOWN = 10.0
"""Variance (of a logarithm, or of an entry of A) from which a parameter counts as not decided by the data."""

LOOSE = 0.1
"""Share of its dependence that makes a quantity undecided, too, where it depends on what is undecided."""


class MotionFit(NamedTuple):
    """A fitted motion model with standard errors; lengths in the unit of the positions, times in seconds.

    `model` has A (4, 4) and Sigma (4, 4), with the standard errors `A_error` and `sigma_error`; `noise` is the fitted
    measurement noise per axis (None: not fitted); `parameters` and `errors` give the named quantities
    (rates, accelerations) with standard errors, NaN if not determined by the data. Further: log likelihood, counts,
    convergence, and the parameters at a limit or undetermined.
    """

    model: GaussMarkov
    noise: float | None  # standard deviation of measured positions; None: not a parameter
    parameters: dict[str, float]  # acceleration, jitter, rate, ...: what was really fitted, where it has a name
    errors: dict[str, float]  # their standard errors; NaN: not decided by the data, or at a limit
    A_error: Floats  # (4, 4) standard errors; NaN: not decided
    sigma_error: Floats  # (4, 4)
    log_likelihood: float
    transitions: int
    measurements: int
    skipped: int
    trajectories: int
    iterations: int
    converged: bool
    at_limit: tuple[str, ...]  # parameters that are as small or large as they may be
    undecided: tuple[str, ...]  # parameters about which the data say nothing
    trace: tuple[float, ...]  # log-likelihood after each step of EM


class Optimum(NamedTuple):
    """Parameters `theta` at the maximum of the likelihood, the log likelihood `value` there, and how the search went.

    `trace` has the log likelihood after each step of EM.
    """

    theta: Floats
    value: float
    iterations: int
    converged: bool
    trace: tuple[float, ...]


def information(gradient: Callable[[Floats], Floats], shape: Shape, theta: Floats, h: float = 1e-3) -> Floats:
    """Return the observed information (n, n): negative second derivatives of the log likelihood at `theta` (n,).

    `gradient` is that of the log likelihood; its differences are over steps `h`. Rows and columns of parameters at a
    bound are NaN.
    """
    n = len(theta)
    out = np.full((n, n), np.nan)
    free = [i for i in range(n) if not at_limit(theta[i], limits(shape)[i])]
    for i in free:
        there, here = theta.copy(), theta.copy()
        there[i] += h
        here[i] -= h
        out[i, free] = -((gradient(there) - gradient(here)) / (2.0 * h))[free]
    symmetric: Floats = 0.5 * (out + out.T)
    return symmetric


def at_limit(value: float, limit: tuple[float | None, float | None]) -> bool:
    """Return whether a parameter with this `value` is within 0.01 of one of its bounds.

    `limit` is (lower, upper); None: unbounded.
    """
    return any(end is not None and abs(value - end) < 1e-2 for end in limit)


def _covariance(information: Floats) -> tuple[Floats, Floats]:
    """Return the covariance (n, n) of the parameters, and a basis (n, k) of k undetermined directions (columns).

    `information` (n, n) is NaN for parameters at a bound, which get zeros in both.
    """
    n = len(information)
    free = np.flatnonzero(np.isfinite(np.diag(information)))
    values, vectors = np.linalg.eigh(information[np.ix_(free, free)])
    weak = values < 1.0 / UNKNOWN
    cov, base = np.zeros((n, n)), np.zeros((n, int(weak.sum())))
    cov[np.ix_(free, free)] = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T
    base[free] = vectors[:, weak]
    return cov, base


def report(
    shape: Shape, scale: float, step_s: float, best: Optimum, known_by: Floats, counts: tuple[int, int, int, int]
) -> MotionFit:
    """Convert the fit to units of the positions and seconds, with standard errors by the delta method.

    Args:
        shape: which parameters were fitted.
        scale: length of one scale in the positions' unit.
        step_s: step of the model [s].
        best: parameters in steps and scales; its log likelihood is in the positions' unit already.
        known_by: (n, n) observed information, NaN for parameters at a limit.
        counts: transitions, measurements, measurements skipped, trajectories.
    """
    theta, known = best.theta, names(shape)
    cov, base = _covariance(known_by)
    stuck = np.isnan(np.diag(known_by))

    def spread(values: Callable[[Floats], Floats]) -> Floats:
        """Return standard errors of the quantities `values(theta)` by the delta method.

        NaN where parameters that the data do not determine, or only those at a bound, have an influence.
        """
        columns = [(values(theta + e) - values(theta - e)) / 2e-5 for e in 1e-5 * np.eye(len(theta))]
        J = np.column_stack(columns)
        error = np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", J, cov, J), 0.0))
        size = np.abs(J).max(axis=1, keepdims=True) + 1e-300
        error = np.hypot(error, np.sqrt(UNKNOWN * np.sum((J @ base) ** 2, axis=1)))
        loose = (np.abs(J @ base) > LOOSE * size).any(axis=1) & (np.abs(J).max(axis=1) > 0)
        moved_only_at_limit = (J != 0).any(axis=1) & ~(J[:, ~stuck] != 0).any(axis=1)
        return np.where(loose | moved_only_at_limit, np.nan, error)

    def matrices(at: Floats) -> Floats:
        model = in_units(build(shape, at), scale, step_s)[0]
        return np.concatenate([model.A.ravel(), model.sigma.ravel()])

    model, noise = in_units(build(shape, theta), scale, step_s)
    units = _units(known, scale, step_s)
    values = {k: _plain(k, v) * u for k, v, u in zip(known, theta, units, strict=True) if u}
    size = spread(lambda at: np.array([_plain(k, v) * u for k, v, u in zip(known, at, units, strict=True)]))
    errors = spread(matrices)
    return MotionFit(
        model=model,
        noise=noise,
        parameters=values,
        errors={k: float(e) for k, e, u in zip(known, size, units, strict=True) if u},
        A_error=errors[:16].reshape(4, 4),
        sigma_error=errors[16:].reshape(4, 4),
        log_likelihood=best.value,
        transitions=counts[0],
        measurements=counts[1],
        skipped=counts[2],
        trajectories=counts[3],
        iterations=best.iterations,
        converged=best.converged,
        at_limit=tuple(k for k, hit in zip(known, stuck, strict=True) if hit),
        undecided=tuple(k for k, row in zip(known, base, strict=True) if (np.abs(row) > 0.3).any()),
        trace=best.trace,
    )


def _plain(name: str, value: float) -> float:
    """Return the value of the parameter `name` without its logarithm.

    It is exp(value), except for `decay`, which has no logarithm.
    """
    return float(value) if name == "decay" else float(np.exp(min(value, 50.0)))


def _units(known: tuple[str, ...], scale: float, step_s: float) -> list[float]:
    """Return factors that convert each named parameter to seconds and length units; 0 for matrix entries.

    `known` are the names, `scale` is the length of one scale, `step_s` the model's step [s].
    """
    unit = {
        "decay": 1.0 / step_s,
        "noise": scale,
        "jitter": scale / step_s**0.5,
        "acceleration": scale / step_s**1.5,
    }
    plain = [k.removesuffix("_x").removesuffix("_y") for k in known]
    unit |= {"sd_u": scale, "sd_v": scale / step_s}
    return [unit.get(k, 0.0) for k in plain]


def in_units(model: MotionModelParameters, scale: float, step_s: float) -> tuple[GaussMarkov, float | None]:
    """Return the motion model and the measurement noise in the positions' unit and seconds.

    `scale` is the length of one scale, `step_s` the model's step [s]; the noise is None if it is not fitted.
    """
    D = scale * np.array([1.0, 1.0 / step_s, 1.0, 1.0 / step_s])
    sigma = model.sigma * np.outer(D, D)
    noise = None if model.noise is None else model.noise * scale
    per_s = np.array([0.0, 1.0, 0.0, 1.0])
    return GaussMarkov(model.A * step_s ** (per_s - per_s[:, None]), sigma, step_s), noise
