"""Marginal likelihoods of position sequences with a time-correlated position error that all cameras share.

The observed position of a person is z_k = x_k + b_k + v_k on each axis: x the true position, b a first-order
Gauss-Markov process of variance s^2 and correlation time tau common to all cameras, v white noise. Each pair (s, tau)
of a grid has its own filter bank with the motion models standing, straight and manoeuvring, mixed as by an interacting
multiple model estimator (Blom and Bar-Shalom 1988, IEEE T-AC 33(8)). People who stand or go straight distinguish the
error from motion.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.jit import kernel

STAND, STRAIGHT, TURN = 0, 1, 2
MODELS, MOMENTS = 3, 10
"""Motion models, and numbers kept of each: weight, means of x, v and b, and covariances xx, xv, xb, vv, vb, bb."""
SQUARINGS = 4
"""The matrix exponential of the transition rates is (I + A t / 2^k)^(2^k), k squarings."""
OUTLIER_SHARE, OUTLIER_VARIANCE = 0.02, 1.0
"""Share of positions with an additional error, and its variance [m^2]: identity switches and wrong boxes."""
SMALL_VARIANCE = 1e-9
"""Variance of the velocity of who stands."""


@kernel
def initial_moments(moments: Floats, z: float, noise: float, square: float, velocity: float) -> None:
    """Write the model weights, means and covariances (3, 10) of one grid point after the first position of a sequence.

    Args:
        moments: (3, 10) written; rows: standing, straight, manoeuvring; columns: weight, means of x, v, b, and
            covariances xx, xv, xb, vv, vb, bb, with x the position, v the velocity and b the correlated error.
        z: measured position along one axis.
        noise: variance of the position's white error.
        square: s^2, variance of b at the grid point.
        velocity: prior variance of the velocity of a walking person.
    """
    moments[:] = 0.0
    for a in range(MODELS):
        moments[a, 1] = z
        moments[a, 4], moments[a, 6], moments[a, 9] = noise + square, -square, square
        moments[a, 7] = SMALL_VARIANCE if a == STAND else velocity
    moments[STAND, 0], moments[STRAIGHT, 0], moments[TURN, 0] = 0.4, 0.5, 0.1


@kernel
def transition_matrix(rates: Floats, dt: float, out: Floats) -> None:
    """Write the transition probabilities of the three motion models over `dt` [s] from their rates to `out` (3, 3).

    `rates` (3, 3) [1/s]; row: model before, column: model after; the diagonal is ignored.
    """
    step = dt / 2.0**SQUARINGS
    for a in range(MODELS):
        total = 0.0
        for b in range(MODELS):
            if a != b:
                out[a, b] = rates[a, b] * step
                total += out[a, b]
        out[a, a] = max(1.0 - total, 0.0)
    for _ in range(SQUARINGS):
        out[:] = out @ out


@kernel
def advance_moments(
    moments: Floats, to: Floats, dt: float, density: Floats, z: float, noise: float, square: float, rho: float,
    velocity: float, outlier: float,
) -> float:  # fmt: skip
    """Predict and update the three motion models of one grid point and axis in place; return the log likelihood of `z`.

    Args:
        moments: (3, 10) of standing, straight, manoeuvring: weight, means of x, v, b, and covariances xx, xv, xb, vv,
            vb, bb, with x the position, v the velocity and b the correlated error; changed.
        to: (3, 3) transition probabilities over dt, from row to column.
        dt: time since the last position [s].
        density: (3,) spectral density of the random walk of a standing person, and of the acceleration in the others.
        z: measured position along one axis.
        noise: variance of its white error.
        square: s^2, variance of b.
        rho: correlation of b over dt.
        velocity: variance of the velocity of a person who begins to walk.
        outlier: additional variance of outliers.
    """
    mixed = np.zeros((MODELS, MOMENTS))
    for a in range(MODELS):
        total = 0.0
        for o in range(MODELS):
            total += moments[o, 0] * to[o, a]
        mixed[a, 0] = total
        for o in range(MODELS):
            share = moments[o, 0] * to[o, a] / total
            v = 0.0 if a == STAND else moments[o, 2]
            mixed[a, 1] += share * moments[o, 1]
            mixed[a, 2] += share * v
            mixed[a, 3] += share * moments[o, 3]
        for o in range(MODELS):
            share = moments[o, 0] * to[o, a] / total
            x, b = moments[o, 1] - mixed[a, 1], moments[o, 3] - mixed[a, 3]
            v = (0.0 if a == STAND else moments[o, 2]) - mixed[a, 2]
            xv, vv, vb = moments[o, 5], moments[o, 7], moments[o, 8]
            if a == STAND:
                xv, vv, vb = 0.0, SMALL_VARIANCE, 0.0
            elif o == STAND:
                xv, vv, vb = 0.0, velocity, 0.0
            mixed[a, 4] += share * (moments[o, 4] + x * x)
            mixed[a, 5] += share * (xv + x * v)
            mixed[a, 6] += share * (moments[o, 6] + x * b)
            mixed[a, 7] += share * (vv + v * v)
            mixed[a, 8] += share * (vb + v * b)
            mixed[a, 9] += share * (moments[o, 9] + b * b)
    evidence = 0.0
    for a in range(MODELS):
        x, v, b = mixed[a, 1], mixed[a, 2], mixed[a, 3]
        xx, xv, xb, vv, vb, bb = mixed[a, 4], mixed[a, 5], mixed[a, 6], mixed[a, 7], mixed[a, 8], mixed[a, 9]
        q = density[a]
        if a == STAND:
            xx += q * dt
        else:
            x += dt * v
            xx += 2.0 * dt * xv + dt * dt * vv + q * dt * dt * dt / 3.0
            xv += dt * vv + 0.5 * q * dt * dt
            xb += dt * vb
            vv += q * dt
        b, xb, vb = rho * b, rho * xb, rho * vb
        bb = rho * rho * bb + square * (1.0 - rho * rho)
        S = xx + 2.0 * xb + bb + noise
        off = z - x - b
        kx, kv, kb = (xx + xb) / S, (xv + vb) / S, (xb + bb) / S
        inlier = (1.0 - OUTLIER_SHARE) * math.exp(-0.5 * off * off / S) / math.sqrt(S)
        wide = S + outlier
        other = OUTLIER_SHARE * math.exp(-0.5 * off * off / wide) / math.sqrt(wide)
        # An outlier updates nothing: the moments of both cases merged
        p = inlier / (inlier + other) if inlier + other > 0.0 else 0.0
        spread = p * (1.0 - p) * off * off
        moments[a, 0] = mixed[a, 0] * (inlier + other)
        moments[a, 1], moments[a, 2], moments[a, 3] = x + p * kx * off, v + p * kv * off, b + p * kb * off
        moments[a, 4] = xx - kx * kx * (p * S - spread)
        moments[a, 5] = xv - kx * kv * (p * S - spread)
        moments[a, 6] = xb - kx * kb * (p * S - spread)
        moments[a, 7] = vv - kv * kv * (p * S - spread)
        moments[a, 8] = vb - kv * kb * (p * S - spread)
        moments[a, 9] = bb - kb * kb * (p * S - spread)
        evidence += moments[a, 0]
    if not evidence > 0.0:
        evidence = 1e-300
        for a in range(MODELS):
            moments[a, 0] = mixed[a, 0] * evidence
    for a in range(MODELS):
        moments[a, 0] /= evidence
    return math.log(evidence) - 0.5 * math.log(2.0 * math.pi)


@kernel
def advance_bank(
    moments: Floats, fresh: Bools, dt: Floats, z: Floats, noise: Floats, square: Floats, time: Floats, rates: Floats,
    density: Floats, velocity: float, outlier: float,
) -> Floats:  # fmt: skip
    """Advance the filter banks of n people by one position each, in place; return log likelihoods (G,) of the grid.

    A grid point is a standard deviation s and correlation time tau of the position error b; log likelihoods are summed
    over people and axes. A person's first position adds nothing.

    Args:
        moments: (n, 2, G, 3, 10) by person, axis, grid point and motion model: weight, means of x, v, b, and
            covariances xx, xv, xb, vv, vb, bb; changed.
        fresh: (n,) people with a sequence that begins here.
        dt: (n,) time since the last position [s], > 0; ignored where fresh.
        z: (n, 2) measured positions.
        noise: (n,) variances of their white errors, per axis.
        square: (G,) s^2 of the grid points.
        time: (G,) tau of the grid points [s], > 0.
        rates: (3, 3) transition rates of the motion models [1/s], from row to column.
        density: (3,) process noise densities of standing, straight, manoeuvring.
        velocity: variance of the velocity of a person who begins to walk.
        outlier: additional variance of outliers.
    """
    G = square.shape[0]
    out, to = np.zeros(G), np.zeros((MODELS, MODELS))
    for i in range(z.shape[0]):
        if not fresh[i]:
            transition_matrix(rates, dt[i], to)
        for axis in range(2):
            for g in range(G):
                if fresh[i]:
                    initial_moments(moments[i, axis, g], z[i, axis], noise[i], square[g], velocity)
                else:
                    rho = math.exp(-dt[i] / time[g])
                    out[g] += advance_moments(
                        moments[i, axis, g], to, dt[i], density, z[i, axis], noise[i], square[g], rho, velocity, outlier
                    )
    return out
