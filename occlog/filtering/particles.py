"""Weighted particles: normalised weights, effective sample size, moments, resampling."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel


def normalise_log_weights(log_weights: Floats) -> tuple[Floats, float]:
    """Return weights of sum 1 from logarithms of weights, and the logarithm of their sum before.

    Args:
        log_weights: (L,) unnormalised; -inf for weight 0.

    Returns:
        (L,) weights and log(sum(exp(log_weights))); equal weights and -inf if none is above -inf.
    """
    top = float(np.max(log_weights))
    if not top > -math.inf:
        return np.full(len(log_weights), 1.0 / len(log_weights)), -math.inf
    weights = np.exp(log_weights - top)
    total = float(weights.sum())
    return weights / total, top + math.log(total)


def effective_sample_size(weights: Floats) -> float:
    """Return the effective sample size 1 / sum w^2 of weights (L,) that sum to 1; between 1 and L."""
    return float(1.0 / np.dot(weights, weights))


def mean_and_covariance(weights: Floats, xy: Floats) -> tuple[Floats, Floats]:
    """Return the weighted mean (n,) and covariance (n, n) of points `xy` (L, n); `weights` (L,) sum to 1."""
    mean = weights @ xy
    centred = xy - mean
    return mean, (weights[:, None] * centred).T @ centred


def log_of(weights: Floats) -> Floats:
    """Return logarithms of weights; -inf for 0, without a warning."""
    with np.errstate(divide="ignore"):
        return np.log(weights)


@kernel
def systematic_ancestors(weights: Floats, n: int, u: float) -> Ints:
    """Draw ancestors by systematic resampling: invert the cumulated weights at the points (i + u) / n.

    Args:
        weights: (L,) non-negative, summing to 1 up to rounding.
        n: number of ancestors wanted; need not be L.
        u: one draw from U[0, 1).

    Returns:
        (n,) non-decreasing rows of `weights`; row l appears floor(n w_l) or ceil(n w_l)
        times, n w_l on average.  Where rounding lets the weights sum to less than 1, the
        last particle with weight takes the rest.
    """
    ancestors = np.empty(n, dtype=np.int64)
    # The last particle with weight: no point may fall to one behind it
    last = weights.shape[0] - 1
    while last > 0 and not weights[last] > 0.0:
        last -= 1
    # Walk along the cumulated weights, which end at or above each point
    j = 0
    total = weights[0]
    for i in range(n):
        point = (i + u) / n
        while total <= point and j < last:
            j += 1
            total += weights[j]
        ancestors[i] = j
    return ancestors
