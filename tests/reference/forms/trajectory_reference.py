"""The cost of a trajectory written down plainly, dense matrices, and random problems."""

from __future__ import annotations

import math

import numpy as np

from occlog.track.methods.map.kernels.gauss_markov import GaussMarkov
from occlog.track.methods.map.kernels.problem import (
    BearingLinesByStep,
    ChainSteps,
    HalfPlanes,
    TrajectoryProblem,
    chain,
)

PAPER_A = np.array([[1.0, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]])
PAPER_SIGMA = 1e-6 * np.diag([1e-4, 1.0, 1e-4, 1.0])
PAPER = GaussMarkov(PAPER_A, PAPER_SIGMA, 0.5)
"""The model of [Rahimi] Sec. 3."""


def plain_loss(r: float, loss: int, k: float) -> float:
    if loss == 1:
        return r * r / 2 if abs(r) <= k else k * abs(r) - k * k / 2
    if loss == 2:
        return k * k / 2 * math.log(1 + r * r / (k * k))
    if loss == 3:
        c = math.exp(-k * k / 2)
        return -math.log((math.exp(-r * r / 2) + c) / (1 + c))
    return r * r / 2


def plain_cost(problem: TrajectoryProblem, X) -> float:
    """The negative log posterior up to a constant, term by term as in [Rahimi] Eq. 1, 2, 4 and [Ercan] Eq. 2."""
    s, lines = problem.steps, problem.lines
    e = X[0] - s.mean
    total = 0.5 * e @ np.linalg.inv(s.spread) @ e
    for t, kind in enumerate(s.kind):
        nu = X[t + 1] - s.A[kind] @ X[t]
        total += 0.5 * nu @ np.linalg.inv(s.sigma[kind]) @ nu
    for n, t in enumerate(lines.step):
        along, across = lines.axis[n], np.array([-lines.axis[n, 1], lines.axis[n, 0]])
        away = X[t, [0, 2]] - lines.position[n]
        d, h = along @ away, across @ away
        if lines.direction[n]:
            r = math.atan2(h, d) / math.sqrt(lines.c0[n])
        elif lines.c0[n] == 0.0:  # linear
            r = (lines.focal[n] * h - lines.reading[n] * d) / math.sqrt(lines.c1[n])
        else:
            sigma = math.sqrt(lines.c0[n] + lines.c1[n] / d**2)
            # Behind the camera the residual has the sign of the offset, so that it is smooth there too.
            r = math.copysign(1.0, d) * (lines.focal[n] * h / d - lines.reading[n]) / sigma
            total += math.log(sigma) if lines.c1[n] > 0.0 else 0.0
        total += plain_loss(r, problem.loss, problem.k)
        if lines.volume[n] > 0.0:
            total -= lines.volume[n] * math.log(d) if d > 0.0 else -math.inf
    return total


def dense_chain(steps):
    """(4T, 4T) inverse of the prior covariance of all states."""
    T = len(steps.kind) + 1
    P = np.zeros((4 * T, 4 * T))
    P[:4, :4] = np.linalg.inv(steps.spread)
    for t, kind in enumerate(steps.kind):
        G = np.zeros((4, 4 * T))
        G[:, 4 * t : 4 * t + 4], G[:, 4 * t + 4 : 4 * t + 8] = -steps.A[kind], np.eye(4)
        P += G.T @ np.linalg.inv(steps.sigma[kind]) @ G
    return P


def dense_hessian(steps, H):
    """(4T, 4T) of the chain and of (T, 3) by position: xx, xy, yy."""
    P = dense_chain(steps)
    for t, (xx, xy, yy) in enumerate(H):
        P[np.ix_([4 * t, 4 * t + 2], [4 * t, 4 * t + 2])] += [[xx, xy], [xy, yy]]
    return P


def random_model(rng) -> GaussMarkov:
    """A damped model with noise in everything."""
    A = np.kron(np.eye(2), [[1.0, 0.5], [0.0, 0.9]]) + 0.03 * rng.normal(size=(4, 4))
    M = rng.normal(size=(4, 4))
    return GaussMarkov(A, 0.05 * M @ M.T + 0.05 * np.eye(4), 0.5)


def make_steps(model: GaussMarkov, seconds, mean, spread) -> ChainSteps:
    """The chain of states at (T,) rising times [s]; the rest as in `chain`."""
    return chain(model, np.diff(seconds), mean, spread)


def random_steps(rng, T: int, model: GaussMarkov | None = None):
    """A chain with steps of three lengths."""
    dt = rng.choice([0.5, 0.25, 0.8], T - 1)
    M = rng.normal(size=(4, 4))
    return make_steps(
        model or random_model(rng), np.concatenate([[0.0], np.cumsum(dt)]), rng.normal(size=4), M @ M.T + np.eye(4)
    )


def random_lines(rng, X, per_state: float, kinds=("pixel", "distance", "direction")) -> BearingLinesByStep:
    """Sight lines of random kinds of random sensors around states, with the target in front."""
    step = np.sort(rng.integers(0, len(X), round(per_state * len(X))))
    n = len(step)
    kind = rng.choice(kinds, n)
    angle, off, away = rng.uniform(-np.pi, np.pi, n), rng.uniform(-0.8, 0.8, n), rng.uniform(1.0, 5.0, n)
    axis = np.column_stack([np.cos(angle), np.sin(angle)])
    bearing = np.column_stack([np.cos(angle + off), np.sin(angle + off)])
    direction, linear = kind == "direction", kind == "linear"
    f = np.where(direction, 1.0, rng.uniform(0.5, 3.0, n))
    z = np.where(direction, 0.0, f * np.tan(off + 0.1 * rng.normal(size=n)))
    c1 = np.where((kind == "distance") | linear, rng.uniform(0.01, 0.5, n), 0.0)
    place = X[step][:, [0, 2]] - away[:, None] * bearing
    return BearingLinesByStep(
        step,
        place,
        axis,
        f,
        z,
        np.where(linear, 0.0, rng.uniform(0.01, 0.2, n)),
        c1,
        direction,
        np.zeros(n),
        np.zeros(n),
    )


def random_planes(rng, X, number: int, room: float) -> HalfPlanes:
    """Half-planes that hold at X, by up to `room`."""
    step, angle = np.sort(rng.integers(0, len(X), number)), rng.uniform(-np.pi, np.pi, number)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    at = np.einsum("mi,mi->m", normal, X[step][:, [0, 2]])
    return HalfPlanes(step, normal, at - rng.uniform(0.0, room, number) - 1e-3)
