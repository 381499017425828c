"""Drawing particles anew from a kernel density, so that a cloud without process noise does not collapse.

A copy of a particle is pulled towards the mean and then moved by a draw from a Gaussian with
the cloud's own covariance, a x + (1 - a) mean + h B n with a^2 + h^2 = 1 and B B^T the covariance.
Mean and covariance stay what they were; only finer shape is blurred, by h standard deviations.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import array_kernel
from occlog.filtering.backward_simulation import root_of
from occlog.filtering.motion.white_acceleration import half_normals
from occlog.filtering.particles import effective_size, normalise, systematic_ancestors


def weigh(log_prior: Floats, log_likelihood: Floats, least: float) -> tuple[Floats, float]:
    """Weights (L,) of sum 1 after a scan, and the log of their sum before.

    Where fewer than `least` particles would be left with weight, none of them agrees well with
    the scan and the spread of the few says nothing.  Then the likelihood is flattened, to the
    power of what keeps that many: the cloud moves towards the scan and stays wide.

    Args:
        log_prior: (L,) log weights, sum of the weights 1.
        log_likelihood: (L,) of the scan; -inf for none.
        least: effective size that is kept, if the prior has it.
    """
    weights, log_sum = normalise(log_prior + log_likelihood)
    if not math.isfinite(log_sum) or effective_size(weights) >= least:
        return weights, log_sum
    low, high = 0.0, 1.0
    relative = np.maximum(log_likelihood - np.max(log_likelihood), -1e300)
    for _ in range(40):
        power = 0.5 * (low + high)
        low, high = (
            (power, high) if effective_size(normalise(log_prior + power * relative)[0]) >= least else (low, power)
        )
    return normalise(log_prior + low * relative)[0], log_sum


def moments(cloud: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Mean (n,) and covariance (n, n) of an (n, L) cloud with weights that sum to 1."""
    mean = cloud @ weights
    off = cloud - mean[:, None]
    return mean, (off * weights) @ off.T


def redraw(
    cloud: Floats, weights: Floats, mean: Floats, covariance: Floats, n: int, h: float, rng: np.random.Generator
) -> Floats:
    """(d, n) equally weighted particles from (d, L) weighted ones.

    Args:
        cloud: (d, L).
        weights: (L,) of sum 1.
        mean: (d,) and
        covariance: (d, d) of the cloud, see `moments`.
        n: how many are wanted.
        h: width of the kernel in standard deviations of the cloud, in [0, 1); 0 only copies.
        rng: draws.
    """
    rows = systematic_ancestors(weights, n, rng.random())
    if h == 0.0:
        return np.ascontiguousarray(cloud[:, rows])
    shift = h * root_of(covariance) @ half_normals(n, len(cloud), rng)
    return np.asarray(_shifted(cloud, rows, mean, math.sqrt(1.0 - h * h), shift))


@array_kernel
def _shifted(cloud: Floats, rows: Ints, mean: Floats, a: float, shift: Floats) -> Floats:
    """The chosen particles pulled to the mean and moved by (d, H) shifts, the second half with the sign changed."""
    n, H = rows.shape[0], shift.shape[1]
    out = np.empty((cloud.shape[0], n))
    for k in range(cloud.shape[0]):
        x, to, by, rest = cloud[k], out[k], shift[k], (1.0 - a) * mean[k]
        for i in range(H):
            to[i] = a * x[rows[i]] + rest + by[i]
        for i in range(n - H):
            to[H + i] = a * x[rows[H + i]] + rest - by[i]
    return out
