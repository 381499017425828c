"""Resampling from a kernel density, so that particles without process noise do not collapse.

A copy of a particle is shrunk towards the mean and moved by a draw from a Gaussian with the particles' covariance, a x
+ (1 - a) mean + h B n with a^2 + h^2 = 1 and B B^T the covariance. Mean and covariance are preserved; finer structure
is smoothed by h standard deviations.

Backward simulation of trajectories through kernel densities of particles.

The particles of a filter at a time represent a density with the width h of a kernel,

    sum_l w_l N(x; c_l, h^2 V),   c_l = a x_l + (1 - a) m,   a^2 + h^2 = 1,

which has their mean m and covariance V.  Given the state x' a step later, of which b is the same state moved back
without noise and B the covariance of the step's noise moved back likewise, the state before it is, by Bayes' rule,

    l ~ w_l P(l to x') N(b; c_l, h^2 V + B),   x | l ~ N(b + G (c_l - b), B - G B),   G = B (h^2 V + B)^-1.

With point masses (Godsill, Doucet and West 2004) a step with noise much smaller than the particle spacing can only
follow the filter's own ancestry. Here all particles within a kernel width contribute, and a step without noise gives x
= b: exactly known motion has one trajectory through each last state. For linear motion and Gaussian densities the
trajectories are those of Rauch, Tung and Striebel's smoother, for any number of particles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import array_kernel

from .motion.white_acceleration import half_normals
from .particles import effective_sample_size, normalise_log_weights, systematic_ancestors

MAX_PARTICLES = 200
"""Particles that are kept of each time at most."""
MIN_VARIANCE, MIN_RELATIVE_VARIANCE = 1e-18, 1e-12
"""Variances below this, and below this share of the largest, count as so much."""
MAX_HALF_CHI2 = 50.0
"""Half the squared distance beyond which a density counts as 0."""


class KernelDensity(NamedTuple):
    """Kernel density of K equally weighted particles with n dimensions, each of a kind (motion model).

    Its kernels are Gaussians about the `centres` with covariance h^2 V, h the `width`, V the `covariance` of the
    density.
    """

    mean: Floats  # (n,)
    covariance: Floats  # (n, n)
    centres: Floats  # (n, K) c_l
    width: float  # h, in (0, 1)
    kinds: Ints  # (K,)


def silverman_bandwidth(particles: int, dimension: int) -> float:
    """Return Silverman's bandwidth of n particles of dimension d, in standard deviations.

    It is (4 / (n (d + 2)))^(1 / (d + 4)), optimal for a Gaussian.
    """
    return float((4.0 / (particles * (dimension + 2.0))) ** (1.0 / (dimension + 4.0)))


def kernel_density(
    cloud: Floats, weights: Floats, kinds: Ints | None = None, kept: int = MAX_PARTICLES
) -> KernelDensity:
    """Return the kernel density of particles, of which at most `kept` are kept.

    These are shifted and scaled so that their mean and covariance are those of all particles.

    Args:
        cloud: (n, L) particles.
        weights: (L,) weights of the particles, sum 1.
        kinds: (L,) kind of each particle (motion model), from 0; None: all are equal.
        kept: largest number of particles.
    """
    mean = cloud @ weights
    off = cloud - mean[:, None]
    covariance = (off * weights) @ off.T
    count = min(kept, cloud.shape[1])
    rows = systematic_ancestors(weights, count, 0.5)
    h = min(silverman_bandwidth(count, len(cloud)), 0.9)
    centres = mean[:, None] + math.sqrt(1.0 - h * h) * _stretched(off[:, rows], covariance)
    own = np.zeros(count, dtype=np.int64) if kinds is None else kinds[rows]
    return KernelDensity(mean, covariance, centres, h, own)


def _stretched(off: Floats, covariance: Floats) -> Floats:
    """Return deviations (n, K), centred and scaled to a given covariance (n, n); only centred if that is impossible.

    `off` (n, K) are the deviations before.
    """
    off = off - off.mean(axis=1)[:, None]
    own = off @ off.T / off.shape[1]
    try:
        return np.asarray(np.linalg.cholesky(covariance) @ np.linalg.solve(np.linalg.cholesky(own), off))
    except np.linalg.LinAlgError:
        return off


def last_states(end: KernelDensity, count: int, rng: Generator) -> tuple[Floats, Ints]:
    """Draw the final states (n, M) of M = `count` trajectories from a kernel density, and their kinds (M,).

    They have exactly the density's mean and covariance.
    """
    rows = systematic_ancestors(np.full(end.centres.shape[1], 1.0 / end.centres.shape[1]), count, rng.random())
    noise = root_of(end.covariance) @ rng.standard_normal((len(end.mean), count))
    drawn = end.centres[:, rows] + end.width * noise
    return end.mean[:, None] + _stretched(drawn - end.mean[:, None], end.covariance), end.kinds[rows]


def states_before(
    before: KernelDensity,
    back: Floats,
    noise: Floats,
    kinds: Ints | None = None,
    chances: Floats | None = None,
    *,
    rng: Generator,
) -> tuple[Floats, Ints]:
    """Draw states (n, M), and their kinds (M,), one step before those of M trajectories (backward simulation).

    Args:
        before: density of the filter before the step.
        back: (n, M) states after the step, moved back over it without noise.
        noise: (n, n) covariance of the step's noise, moved back over the step, positive semi-definite.
        kinds: (M,) kinds of the states after the step; None: all are 0.
        chances: (J, J) probabilities of a kind (columns) given that before it (rows); None: any kind follows any.
        rng: generator of the random numbers drawn.
    """
    M = back.shape[1]
    kinds = np.zeros(M, dtype=np.int64) if kinds is None else kinds
    most = 1 + int(max(kinds.max(), before.kinds.max()))
    chances = np.ones((most, most)) if chances is None else chances
    S = before.width**2 * before.covariance + noise
    S = S + max(MIN_RELATIVE_VARIANCE * float(np.trace(S)), MIN_VARIANCE) * np.eye(len(S))
    root = np.linalg.cholesky(S)
    centres, at = np.linalg.solve(root, before.centres), np.linalg.solve(root, back)
    u = rng.random(size=(M,))
    rows = _chosen(np.ascontiguousarray(centres), np.ascontiguousarray(at), before.kinds, kinds, chances, u)
    gain = np.linalg.solve(S, noise).T
    drawn = back + gain @ (before.centres[:, rows] - back)
    return drawn + root_of(noise - gain @ noise) @ rng.standard_normal(back.shape), before.kinds[rows]


@array_kernel
def _chosen(centres: Floats, at: Floats, before: Ints, after: Ints, chances: Floats, u: Floats) -> Ints:
    """Return (M,) index of a centre drawn for each of M positions, by unit Gaussians around K centres times `chances`.

    It is the nearest centre if all weights are 0.

    Args:
        centres: (n, K) whitened centres.
        at: (n, M) positions, whitened as the centres.
        before: (K,) kind of each centre.
        after: (M,) kind of each position.
        chances: (J, J) probabilities of a kind (columns) given that before it (rows).
        u: (M,) uniform random numbers in [0, 1).
    """
    n, K = centres.shape
    M = at.shape[1]
    half, out = np.empty(K), np.empty(M, dtype=np.int64)
    for j in range(M):
        half[:] = 0.0
        for i in range(n):
            x = at[i, j]
            for k in range(K):
                d = x - centres[i, k]
                half[k] += d * d
        nearest = 0
        for k in range(K):
            if half[k] < half[nearest]:
                nearest = k
        base, total = half[nearest], 0.0
        for k in range(K):
            exponent = 0.5 * (half[k] - base)
            half[k] = chances[before[k], after[j]] * math.exp(-exponent) if exponent < MAX_HALF_CHI2 else 0.0
            total += half[k]
        out[j] = nearest
        point = u[j] * total
        for k in range(K):
            point -= half[k]
            if point < 0.0:
                out[j] = k
                break
    return out


def root_of(covariance: Floats) -> Floats:
    """Return B (n, n) with B B^T = `covariance` (n, n), which may be singular; negative eigenvalues count as 0."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def spread_of(states: Floats) -> tuple[Floats, Floats]:
    """Return mean (n,) and covariance (n, n) of M equally weighted `states` (n, M), with the divisor M - 1."""
    mean = states.mean(axis=1)
    off = states - mean[:, None]
    return mean, off @ off.T / max(states.shape[1] - 1, 1)


def update_weights(log_prior: Floats, log_likelihood: Floats, least: float) -> tuple[Floats, float]:
    """Return weights (L,) of sum 1 after a scan, and the log of their sum before normalisation.

    If the effective sample size would fall below `least`, the likelihood is tempered by an exponent that keeps that
    many particles: they move towards the scan and stay spread. The log of the sum is without tempering.

    Args:
        log_prior: (L,) log weights, sum of the weights 1.
        log_likelihood: (L,) log-likelihoods of the scan; -inf for none.
        least: effective sample size that is kept, if the prior has it.
    """
    weights, log_sum = normalise_log_weights(log_prior + log_likelihood)
    if not math.isfinite(log_sum) or effective_sample_size(weights) >= least:
        return weights, log_sum
    low, high = 0.0, 1.0
    relative = np.maximum(log_likelihood - np.max(log_likelihood), -1e300)
    for _ in range(40):
        power = 0.5 * (low + high)
        low, high = (
            (power, high)
            if effective_sample_size(normalise_log_weights(log_prior + power * relative)[0]) >= least
            else (low, power)
        )
    return normalise_log_weights(log_prior + low * relative)[0], log_sum


def moments(cloud: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return weighted mean (n,) and covariance (n, n) of particles `cloud` (n, L); `weights` (L,) sum to 1."""
    mean = cloud @ weights
    off = cloud - mean[:, None]
    return mean, (off * weights) @ off.T


def resample_with_kernel(
    cloud: Floats, weights: Floats, mean: Floats, covariance: Floats, n: int, h: float, rng: np.random.Generator
) -> Floats:
    """Draw (d, n) equally weighted particles from the kernel density of (d, L) weighted ones.

    Mean and covariance are preserved on average.

    Args:
        cloud: (d, L) particles.
        weights: (L,) weights of the particles, sum 1.
        mean: (d,) mean of the particles, from `moments`.
        covariance: (d, d) covariance of the particles, from `moments`.
        n: number of particles to draw.
        h: width of the kernel in standard deviations of the particles, in [0, 1); 0 only copies.
        rng: generator of the random numbers drawn.
    """
    rows = systematic_ancestors(weights, n, rng.random())
    if h == 0.0:
        return np.ascontiguousarray(cloud[:, rows])
    shift = h * root_of(covariance) @ half_normals(n, len(cloud), rng)
    return np.asarray(_shifted(cloud, rows, mean, math.sqrt(1.0 - h * h), shift))


@array_kernel
def _shifted(cloud: Floats, rows: Ints, mean: Floats, a: float, shift: Floats) -> Floats:
    """Return N selected particles (d, N) shrunk towards the mean and shifted, the second half with opposite signs.

    Args:
        cloud: (d, L) particles.
        rows: (N,) indices of the selected ones.
        mean: (d,) mean of the particles.
        a: factor of the distances from the mean.
        shift: (d, H) shifts of the first H particles; the others take the first N - H with opposite sign.
    """
    n, H = rows.shape[0], shift.shape[1]
    out = np.empty((cloud.shape[0], n))
    for k in range(cloud.shape[0]):
        x, to, by, rest = cloud[k], out[k], shift[k], (1.0 - a) * mean[k]
        for i in range(H):
            to[i] = a * x[rows[i]] + rest + by[i]
        for i in range(n - H):
            to[H + i] = a * x[rows[H + i]] + rest - by[i]
    return out
