"""Linear Gaussian motion in the plane for steps of any length ([Rahimi] Eq. 1).

The state is x = [u u' v v']: each coordinate with its velocity.  Over the model's own step
x moves to A x plus noise of covariance Sigma.  Steps of other lengths follow the linear
stochastic differential equation that has this A, and this Sigma as far as there is one:
dx = B x dt + noise of density S per second, with exp(B step) = A and

    Sigma = integral over 0..step of exp(B s) S exp(B s)^T ds.

Some Sigma are of no such equation (that of the paper's example is not: its noise of velocity
leaves no trace in the position of the same step); then the nearest S without negative
eigenvalues is taken.  A step of the model's own length always has A and Sigma themselves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import logm

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

SAME = 1e-9
"""Steps with lengths that differ by a smaller share are of one length."""
SMALL = 0.1
"""Largest norm of B h at which the series of exp is summed; longer steps are made by doubling."""
TERMS = 12
POSITION = (0, 2)
"""Entries of the state that are positions (C of the paper picks them)."""
VELOCITY = (1, 3)


class GaussMarkov(NamedTuple):
    """A linear Gaussian motion model x' = A x + N(0, sigma) of the state x, vx, y, vy over one step of `step_s` [s].

    A is (4, 4); `sigma` (4, 4) is positive definite.
    """

    A: Floats  # (4, 4)
    sigma: Floats  # (4, 4), positive definite
    step_s: float  # > 0


class Diffusion(NamedTuple):
    """Gauss-Markov motion in continuous time: dx = B x dt + noise of covariance S dt, of the state x, vx, y, vy.

    B (4, 4) is per second; S (4, 4) is positive semidefinite.
    """

    B: Floats  # (4, 4) per second
    S: Floats  # (4, 4), positive semi-definite


def constant_velocity(acceleration: float, jitter: float, step_s: float = 1.0) -> GaussMarkov:
    """Return the constant-velocity model with white acceleration and additional white position noise.

    Args:
        acceleration: standard deviation of the velocity accumulated over 1 s, per axis; > 0.
        jitter: standard deviation of the position that is accumulated over 1 s in addition, per axis; >= 0.
        step_s: length of the step [s].
    """
    t = step_s
    A2 = np.array([[1.0, t], [0.0, 1.0]])
    Q2 = acceleration**2 * np.array([[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]])
    Q2[0, 0] += jitter**2 * t
    axes = np.eye(2)
    return GaussMarkov(np.asarray(np.kron(axes, A2)), np.asarray(np.kron(axes, Q2), dtype=np.float64), step_s)


def diffusion(model: GaussMarkov) -> Diffusion:
    """Convert the model to continuous time; S is the nearest one without negative eigenvalues.

    Raises:
        ValueError: A has no real logarithm (an eigenvalue is negative or 0).
    """
    sizes = np.linalg.svd(model.A, compute_uv=False)
    # Of a singular A, logm gives the logarithm of some regular matrix near it.
    singular = not sizes[-1] > 1e-14 * sizes[0]
    B = np.asarray(np.full((4, 4), np.nan) if singular else logm(model.A), dtype=np.complex128) / model.step_s
    if not np.all(np.isfinite(B)) or np.abs(B.imag).max() > 1e-9 * max(1.0, float(np.abs(B).max())):
        raise ValueError("A has no real logarithm, so steps of other lengths than its own are undefined")
    generator = np.ascontiguousarray(B.real)
    basis = np.eye(16).reshape(16, 4, 4)
    # Sigma is linear in S: one column for each entry of S.
    collected = np.column_stack([_step(generator, np.ascontiguousarray(E), model.step_s)[1].ravel() for E in basis])
    S = np.linalg.solve(collected, model.sigma.ravel()).reshape(4, 4)
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    return Diffusion(generator, np.ascontiguousarray((vectors * np.maximum(values, 0.0)) @ vectors.T))


def transitions(model: GaussMarkov, dt: Floats) -> tuple[Floats, Floats]:
    """Return A (K, 4, 4) and Sigma (K, 4, 4) of the motion over steps of lengths `dt` (K,) [s], > 0.

    Raises:
        ValueError: there are steps of other lengths than the model's own, and A has no real logarithm.
    """
    A, sigma = np.tile(model.A, (len(dt), 1, 1)), np.tile(model.sigma, (len(dt), 1, 1))
    other = np.abs(dt - model.step_s) > SAME * model.step_s
    if other.any():
        flow = diffusion(model)
        A[other], sigma[other] = _steps(flow.B, flow.S, np.ascontiguousarray(dt[other], dtype=np.float64))
    return A, sigma


@kernel
def _step(B: Floats, S: Floats, dt: float) -> tuple[Floats, Floats]:
    """Return exp(B dt) (4, 4) and the noise covariance (4, 4) of a step of `dt` [s].

    They are series for a short step, which is doubled repeatedly. B and S are those of `Diffusion`.
    """
    norm = np.abs(B).sum(axis=1).max() * dt
    doublings = max(0, math.ceil(math.log2(norm / SMALL))) if norm > 0.0 else 0
    h = dt / 2.0**doublings
    A, power = np.eye(4), np.eye(4)
    Q, term = np.zeros((4, 4)), S * h
    for n in range(1, TERMS + 1):
        Q = Q + term
        power = power @ B * (h / n)
        A = A + power
        term = (B @ term + term @ B.T) * (h / (n + 1))
    for _ in range(doublings):
        Q = A @ Q @ A.T + Q
        A = A @ A
    return A, Q


@kernel
def _steps(B: Floats, S: Floats, dt: Floats) -> tuple[Floats, Floats]:
    """Return exp(B dt) (K, 4, 4) and the noise covariances (K, 4, 4) of K steps of lengths `dt` (K,) [s].

    B and S are those of `Diffusion`.
    """
    A, Q = np.empty((dt.shape[0], 4, 4)), np.empty((dt.shape[0], 4, 4))
    for k in range(dt.shape[0]):
        A[k], Q[k] = _step(B, S, dt[k])
        Q[k] = 0.5 * (Q[k] + Q[k].T)
    return A, Q
