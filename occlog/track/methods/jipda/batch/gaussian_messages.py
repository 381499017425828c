"""Messages along a track: Kalman filter forwards, information filter backwards, and the density where they meet.

A track is a chain of nodes: the boxes of one person at one time step, as a factor of their state,

    exp(c + h' s - s' J s / 2),

with the information J (6, 6), the vector h (6,) and the constant c. Between nodes the state has a nearly constant
velocity: s' = F s + w, w ~ N(0, Q). The forward message of a node is the density of the state given it and everything
before it, (mean, covariance, log likelihood); the backward message is the likelihood of it and everything after it as a
function of the state, in information form, because it need not be a density. The marginal likelihood of a whole track
is the integral of their product at any link, which makes an exchange of tails cost two links (the two-filter formula:
Fraser and Potter 1969).
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

from ..interface import STATE_SIZE
from ..kernels.linear import invert

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
MIN_STEP_S = 1e-6
"""Minimum time step [s]: the process noise of a shorter one has no inverse."""


@kernel
def noise_of_walk(dt: float, drift: Floats, Q: Floats) -> None:
    """Write the process noise covariance Q (6, 6) of x, y, vx, vy, height, width over `dt` (white acceleration).

    Args:
        dt: length of the step [s]; at least `MIN_STEP_S` is used.
        drift: (3,) spectral density of the acceleration, and variances that height and width gain in a second, > 0.
        Q: (6, 6) written.
    """
    Q[:] = 0.0
    t, q = max(dt, MIN_STEP_S), drift[0]
    for a in range(2):
        Q[a, a] = q * t * t * t / 3.0
        Q[a, a + 2] = Q[a + 2, a] = 0.5 * q * t * t
        Q[a + 2, a + 2] = q * t
    Q[4, 4], Q[5, 5] = drift[1] * t, drift[2] * t


@kernel
def predict(mean: Floats, covariance: Floats, dt: float, drift: Floats, out_mean: Floats, out: Floats) -> None:
    """Write the predicted mean F m and covariance F P F' + Q of a state with nearly constant velocity, `dt` later.

    Args:
        mean: (6,) m: x, y, vx, vy, height, width.
        covariance: (6, 6) P.
        dt: length of the step [s].
        drift: (3,) spectral density of the acceleration, and variances that height and width gain in a second.
        out_mean: (6,) written.
        out: (6, 6) written.
    """
    t = max(dt, MIN_STEP_S)
    noise_of_walk(t, drift, out)
    for a in range(STATE_SIZE):
        out_mean[a] = mean[a] + (t * mean[a + 2] if a < 2 else 0.0)
    for a in range(STATE_SIZE):
        for b in range(STATE_SIZE):
            value = covariance[a, b]
            if a < 2:
                value += t * covariance[a + 2, b]
            if b < 2:
                value += t * covariance[a, b + 2]
            if a < 2 and b < 2:
                value += t * t * covariance[a + 2, b + 2]
            out[a, b] += value


@kernel
def multiply_factor(mean: Floats, covariance: Floats, J: Floats, h: Floats, c: float) -> float:
    """Update a Gaussian density of s by the factor exp(c + h' s - s' J s / 2), in place.

    Return the log of the integral of the product.

    Args:
        mean: (6,) of the density; changed.
        covariance: (6, 6) of the density; changed.
        J: (6, 6) information matrix of the factor.
        h: (6,) information vector of the factor.
        c: constant of the factor.
    """
    prior, post = np.empty((STATE_SIZE, STATE_SIZE)), np.empty((STATE_SIZE, STATE_SIZE))
    log_det = invert(covariance, prior)
    vector = prior @ mean
    total = c - 0.5 * log_det
    for a in range(STATE_SIZE):
        total -= 0.5 * mean[a] * vector[a]
        vector[a] += h[a]
        for b in range(STATE_SIZE):
            post[a, b] = prior[a, b] + J[a, b]
    total -= 0.5 * invert(post, covariance)
    for a in range(STATE_SIZE):
        mean[a] = 0.0
        for b in range(STATE_SIZE):
            mean[a] += covariance[a, b] * vector[b]
    for a in range(STATE_SIZE):
        total += 0.5 * vector[a] * mean[a]
    return total


@kernel
def initial_density(
    prior: Floats, at: Floats, J: Floats, h: Floats, c: float, mean: Floats, covariance: Floats
) -> float:
    """Write the density of the state after the first node of a track; return the log of its marginal likelihood.

    The prior of a new person's position is 1 per unit of area (the caller divides by the area). The node's factor is
    exp(c + h' s - s' J s / 2).

    Args:
        prior: (6,) precisions of the state of a new target; those of x and y are ignored.
        at: (6,) prior means; those of x and y are ignored.
        J: (6, 6) information matrix of the first node, or of it and all that follow.
        h: (6,) information vector that belongs to J.
        c: constant of the factor.
        mean: (6,) written.
        covariance: (6, 6) written.
    """
    information, vector = np.empty((STATE_SIZE, STATE_SIZE)), np.empty(STATE_SIZE)
    total = c
    for a in range(STATE_SIZE):
        vector[a] = h[a]
        for b in range(STATE_SIZE):
            information[a, b] = J[a, b]
        if a < 2:
            information[a, a] += 1e-9
            total += HALF_LOG_2PI
        else:
            information[a, a] += prior[a]
            vector[a] += prior[a] * at[a]
            total += 0.5 * math.log(prior[a]) - 0.5 * prior[a] * at[a] * at[a]
    total -= 0.5 * invert(information, covariance)
    for a in range(STATE_SIZE):
        mean[a] = 0.0
        for b in range(STATE_SIZE):
            mean[a] += covariance[a, b] * vector[b]
    for a in range(STATE_SIZE):
        total += 0.5 * vector[a] * mean[a]
    return total


@kernel
def log_begun(prior: Floats, at: Floats, J: Floats, h: Floats, c: Floats) -> Floats:
    """Return log marginal likelihoods (n,) of n factors exp(c + h' s - s' J s / 2), each as a track's first node.

    Args:
        prior: (6,) precisions of the state of a new target; those of x and y are ignored (1 per unit of area).
        at: (6,) prior means; those of x and y are ignored.
        J: (n, 6, 6) information matrices.
        h: (n, 6) information vectors.
        c: (n,) constants.
    """
    out, mean, covariance = np.empty(len(c)), np.empty(STATE_SIZE), np.empty((STATE_SIZE, STATE_SIZE))
    for k in range(len(c)):
        out[k] = initial_density(prior, at, J[k], h[k], c[k], mean, covariance)
    return out


@kernel
def log_integral(mean: Floats, covariance: Floats, J: Floats, h: Floats, c: float) -> float:
    """Return the log of the integral of a Gaussian density times the factor exp(c + h' s - s' J s / 2).

    The density has `mean` m (6,) and `covariance` P (6, 6); nothing is changed. With P = L L', A = I + L' J L and
    v = L' (h - J m) it is c + h' m - m' J m / 2 + (v' A^-1 v - log|A|) / 2. NaN if P is not positive definite.
    """
    L, A = np.empty((STATE_SIZE, STATE_SIZE)), np.empty((STATE_SIZE, STATE_SIZE))
    v, off = np.empty(STATE_SIZE), np.empty(STATE_SIZE)
    # Cholesky: P = L L'
    for a in range(STATE_SIZE):
        for b in range(a + 1):
            value = covariance[a, b]
            for k in range(b):
                value -= L[a, k] * L[b, k]
            if a > b:
                L[a, b] = value / L[b, b]
            elif value > 0.0:
                L[a, a] = math.sqrt(value)
            else:
                return math.nan
    total = c
    for a in range(STATE_SIZE):
        value = 0.0
        for b in range(STATE_SIZE):
            value += J[a, b] * mean[b]
        off[a] = h[a] - value
        total += 0.5 * mean[a] * (h[a] + off[a])
    for b in range(STATE_SIZE):
        v[b] = 0.0
        for k in range(b, STATE_SIZE):
            v[b] += L[k, b] * off[k]
    for b in range(STATE_SIZE):
        for a in range(b, STATE_SIZE):
            A[a, b] = 0.0
        for k in range(STATE_SIZE):
            # (J L)_kb
            value = 0.0
            for n in range(b, STATE_SIZE):
                value += J[k, n] * L[n, b]
            for a in range(b, k + 1):
                A[a, b] += L[k, a] * value
        A[b, b] += 1.0
    # Cholesky of A in place, and the solution of its lower triangle for v
    det = 1.0
    for a in range(STATE_SIZE):
        for b in range(a + 1):
            value = A[a, b]
            for k in range(b):
                value -= A[a, k] * A[b, k]
            if a > b:
                A[a, b] = value / A[b, b]
            else:
                det *= value
                A[a, a] = math.sqrt(value)
        for k in range(a):
            v[a] -= A[a, k] * v[k]
        v[a] /= A[a, a]
        total += 0.5 * v[a] * v[a]
    return total - 0.5 * math.log(det)


@kernel
def predict_backwards(J: Floats, h: Floats, c: float, dt: float, drift: Floats, out_J: Floats, out_h: Floats) -> float:
    """Propagate the factor exp(c + h' s - s' J s / 2) of a state to a time `dt` earlier; return its new constant.

    It is convolved with the process noise Q: with C = (Q^-1 + J)^-1 it is J - J C J, h - J C h,
    c + (h' C h + log|C| - log|Q|) / 2, before the transition F is applied.

    Args:
        J: (6, 6) information matrix.
        h: (6,) information vector.
        c: constant.
        dt: length of the step [s].
        drift: (3,) spectral density of the acceleration, and variances that height and width gain in a second.
        out_J: (6, 6) written.
        out_h: (6,) written.
    """
    t = max(dt, MIN_STEP_S)
    Q, inner, C = (
        np.empty((STATE_SIZE, STATE_SIZE)),
        np.empty((STATE_SIZE, STATE_SIZE)),
        np.empty((STATE_SIZE, STATE_SIZE)),
    )
    noise_of_walk(t, drift, Q)
    log_q = invert(Q, inner)
    for a in range(STATE_SIZE):
        for b in range(STATE_SIZE):
            inner[a, b] += J[a, b]
    log_c = -invert(inner, C)
    JC = J @ C
    kept, vector = J - JC @ J, h - JC @ h
    total = c + 0.5 * (log_c - log_q)
    for a in range(STATE_SIZE):
        for b in range(STATE_SIZE):
            total += 0.5 * h[a] * C[a, b] * h[b]
    # F' J F and F' h
    for a in range(STATE_SIZE):
        out_h[a] = vector[a] + (t * vector[a - 2] if 2 <= a < 4 else 0.0)
        for b in range(STATE_SIZE):
            value = 0.5 * (kept[a, b] + kept[b, a])
            if 2 <= a < 4:
                value += t * 0.5 * (kept[a - 2, b] + kept[b, a - 2])
            if 2 <= b < 4:
                value += t * 0.5 * (kept[a, b - 2] + kept[b - 2, a])
            if 2 <= a < 4 and 2 <= b < 4:
                value += t * t * 0.5 * (kept[a - 2, b - 2] + kept[b - 2, a - 2])
            out_J[a, b] = value
    return total
