"""Weights of particles: from logarithms to normalised weights, effective sample size, moments."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats


def normalise(log_weights: Floats) -> tuple[Floats, float]:
    """Normalise weights given as logarithms.

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


def effective_size(weights: Floats) -> float:
    """Effective sample size 1 / sum w^2 of weights that sum to 1; between 1 and L."""
    return float(1.0 / np.dot(weights, weights))


def mean_and_covariance(weights: Floats, xy: Floats) -> tuple[Floats, Floats]:
    """Weighted mean (n,) and covariance (n, n) of (L, n) points; the weights sum to 1."""
    mean = weights @ xy
    centred = xy - mean
    return mean, (weights[:, None] * centred).T @ centred


def log_of(weights: Floats) -> Floats:
    """Logarithms of weights; -inf for 0, without a warning."""
    with np.errstate(divide="ignore"):
        return np.log(weights)
