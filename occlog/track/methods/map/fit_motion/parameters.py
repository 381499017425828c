"""Forms of A and Sigma, and what of them data decide: a vector of free parameters each.

Time is in steps and length in a scale of the data, so that parameters are of order 1.

Positions alone do not decide everything.  A velocity is known by what it does to the
position, so that the position's rows of A are fixed: in `cv` [1 1; 0 1] per axis, in `damped`
velocity dies out exponentially at a rate beta (a = exp(-beta), b = (1 - a) / beta), and in `full`
the velocity's two rows are free and the position's are those of `cv`, which is no loss: any
other A is this one with other units of velocity.  Of the 2 x 2 block of Sigma of an axis only
two of three numbers have an influence on positions, hence the structures

    white     acceleration that is white noise of density q^2, and white noise j^2 on the position,
    diagonal  diag(s_u^2, s_v^2), as in [Rahimi] Sec. 6,

and `full` (a 4 x 4 covariance) which leaves some of it to the start of the search.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.track.methods.map.kernels.gauss_markov import VELOCITY

from .smoother import CV, SmootherSums

SMALLEST, LARGEST = 1e-5, 1e3
"""Limits of standard deviations, in scales of the data."""
FASTEST_DECAY = 20.0
SLOWEST_DECAY = -1.0
"""Limits of beta per step; below 0 velocity grows."""
LOWER = np.tril_indices(4)
NODE, WEIGHT = np.polynomial.legendre.leggauss(12)


class Shape(NamedTuple):
    """Structure of the fitted motion model x' = A x + N(0, Sigma) of x, vx, y, vy.

    `form` of A: `cv`, `damped` or `full` (then the rows `free` are fitted); `disturbance`, form of Sigma: `white`,
    `diagonal` or `full`; `similar`: one process noise for both axes; `noise`: the measurement noise is fitted, too.
    """

    form: str = "cv"  # cv, damped or full
    disturbance: str = "white"  # white, diagonal or full
    similar: bool = True  # one disturbance for both axes
    noise: bool = True  # measurement noise is fitted, too
    free: tuple[int, ...] = VELOCITY  # rows of A that `full` fits


class MotionModelParameters(NamedTuple):
    """Transition matrix A (4, 4), process noise covariance `sigma` (4, 4), and measurement noise `noise`.

    The state is x, vx, y, vy in steps and length scales; `noise` is a standard deviation per axis (None: not fitted).
    """

    A: Floats
    sigma: Floats
    noise: float | None


@functools.cache
def names(shape: Shape) -> tuple[str, ...]:
    """Return the names of the free parameters in their order; standard deviations are parametrised by logarithms."""
    out = {"cv": [], "damped": ["decay"], "full": [f"A{i + 1}{j + 1}" for i in shape.free for j in range(4)]}[
        shape.form
    ]
    if shape.disturbance == "full":
        out = out + [f"chol{i + 1}{j + 1}" for i, j in zip(*LOWER, strict=True)]
    else:
        pair = ["jitter", "acceleration"] if shape.disturbance == "white" else ["sd_u", "sd_v"]
        out = out + (pair if shape.similar else [f"{p}_{axis}" for axis in "xy" for p in pair])
    return (*out, *(["noise"] if shape.noise else []))


@functools.cache
def limits(shape: Shape) -> tuple[tuple[float | None, float | None], ...]:
    """Return lower and upper bounds of the free parameters, in the order of `names`; None: unbounded.

    Those of standard deviations are of their logarithms.
    """
    small, large = float(np.log(SMALLEST)), float(np.log(LARGEST))
    out: list[tuple[float | None, float | None]] = []
    for name in names(shape):
        if name == "decay":
            out.append((SLOWEST_DECAY, FASTEST_DECAY))
        elif name.startswith("A") or (name.startswith("chol") and name[4] != name[5]):
            out.append((None, None))
        else:
            out.append((small, large))
    return tuple(out)


def start(shape: Shape, bend: float) -> Floats:
    """Return the initial parameter vector, in the order of `names`.

    Args:
        shape: which parameters are fitted.
        bend: standard deviation of second differences of the positions, in length scales; > 0.
    """
    values = dict.fromkeys(names(shape), np.log(max(0.25 * bend, 10.0 * SMALLEST)))
    for name in values:
        if name.startswith(("acceleration", "sd_v")) or name in ("chol22", "chol44"):
            values[name] = np.log(max(0.7 * bend, 10.0 * SMALLEST))
        elif name == "decay":
            values[name] = 0.05
        elif name.startswith("A"):
            values[name] = float(CV[int(name[1]) - 1, int(name[2]) - 1])
        elif name.startswith("chol") and name[4] != name[5]:
            values[name] = 0.0
    return np.array(list(values.values()))


def build(shape: Shape, theta: Floats) -> MotionModelParameters:
    """Return the model (A, Sigma, noise), in steps and length scales, of the parameter vector `theta`.

    `theta` is in the order of `names`; `noise` is None if it is not fitted.
    """
    known = names(shape)
    if shape.form == "cv":
        A, beta, used = CV, 0.0, 0
    elif shape.form == "damped":
        beta, used = float(theta[0]), 1
        A = np.kron(np.eye(2), np.array([[1.0, _reach(np.array(1.0), beta)], [0.0, np.exp(-beta)]]))
    else:
        beta, used = 0.0, 4 * len(shape.free)
        A = CV.copy()
        A[list(shape.free)] = theta[:used].reshape(-1, 4)
    noise = float(np.exp(theta[-1])) if shape.noise else None
    own = theta[used : len(known) - int(shape.noise)]
    return MotionModelParameters(A, _sigma(shape, own, beta), noise)


def _sigma(shape: Shape, own: Floats, beta: float) -> Floats:
    """Return Sigma (4, 4) of the parameters `own` of the process noise, in the structure of `shape`.

    `beta` is the rate per step at which velocity dies out (form `damped`), 0 otherwise.
    """
    if shape.disturbance == "full":
        L = np.zeros((4, 4))
        L[LOWER] = own
        L[np.diag_indices(4)] = np.exp(np.diag(L))
        # A limit for small eigenvalues, as the other structures have it.
        full: Floats = L @ L.T + SMALLEST**2 * np.eye(4)
        return full
    first, second = (
        (np.diag([1.0, 0.0]), _white(beta))
        if shape.disturbance == "white"
        else (np.diag([1.0, 0.0]), np.diag([0.0, 1.0]))
    )
    sd = np.exp(np.tile(own, 2) if shape.similar else own)
    sigma = np.zeros((4, 4))
    for axis in range(2):
        i = 2 * axis
        sigma[i : i + 2, i : i + 2] = sd[i] ** 2 * first + sd[i + 1] ** 2 * second
    return sigma


def _reach(s: Floats, beta: float) -> Floats:
    """Return the effect of a unit velocity on the position after times s [steps].

    It is (1 - exp(-beta s)) / beta, and s if beta is 0.
    """
    return s.copy() if abs(beta) < 1e-9 else -np.expm1(-beta * s) / beta


def _white(beta: float) -> Floats:
    """Return the process noise covariance (2, 2) of position and velocity of one step, for unit white acceleration.

    `beta` is the rate per step at which velocity dies out; by Gauss-Legendre quadrature unless it is 0.
    """
    if beta == 0.0:
        return np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    s, w = 0.5 * (NODE + 1.0), 0.5 * WEIGHT
    rows = np.stack([_reach(s, beta), np.exp(-beta * s)])
    collected: Floats = (rows * w) @ rows.T
    return collected


def expected(shape: Shape, theta: Floats, sums: SmootherSums) -> float:
    """Return the expected log likelihood of states and measurements (Q of EM) for `theta`, up to a constant.

    `sums` are the smoother's expected sums under the parameters before.
    """
    A, sigma, noise = build(shape, theta)
    B = A - CV
    cross = B @ sums.DX.T
    S = sums.DD - cross - cross.T + B @ sums.XX @ B.T
    L = np.linalg.cholesky(sigma)
    half = np.linalg.solve(L, np.linalg.solve(L, S).T)
    value = -sums.n * float(np.log(np.diag(L)).sum()) - 0.5 * float(np.trace(half))
    if noise is not None:
        value -= sums.m * 2.0 * np.log(noise) + 0.5 * float(np.trace(sums.E)) / noise**2
    return value


def slope(shape: Shape, theta: Floats, sums: SmootherSums, h: float = 1e-5) -> Floats:
    """Return the gradient of the expected log likelihood (`expected`) by the parameters, by central differences.

    Args:
        shape: which parameters are fitted.
        theta: parameters, in the order of `names(shape)`.
        sums: the smoother's expected sums.
        h: step of the differences.
    """
    out = np.empty(len(theta))
    for i in range(len(theta)):
        there, here = theta.copy(), theta.copy()
        there[i] += h
        here[i] -= h
        out[i] = (expected(shape, there, sums) - expected(shape, here, sums)) / (2.0 * h)
    return out


def regression(shape: Shape, theta: Floats, sums: SmootherSums) -> Floats:
    """Return the parameters `theta` with the free rows of A by least squares on the smoother's sums.

    K = CV_f + (W_ff)^-1 W_f. DX XX^-1 with W = Sigma^-1 and f the free rows: the exact maximum for the given Sigma. For
    other forms of A than `full` it is `theta` itself.
    """
    if shape.form != "full":
        return theta
    rows = list(shape.free)
    W = np.linalg.inv(build(shape, theta).sigma)
    K = np.linalg.solve(W[np.ix_(rows, rows)], W[rows] @ sums.DX)
    scale = np.sqrt(np.diag(sums.XX))
    K = np.linalg.solve(sums.XX / np.outer(scale, scale), (K / scale).T).T / scale
    out = theta.copy()
    out[: K.size] = (CV[rows] + K).ravel()
    return out
