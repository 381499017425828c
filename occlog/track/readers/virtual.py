"""Method `virtual`: the virtual sensors that a tag may be in, by the readers that read it in a window.

Nothing is carried from one window to the next.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.filtering.particles import log_of

from .coverage import VirtualSensors


class Coarse(NamedTuple):
    """W coarse positions."""

    xy: Floats  # (W, 2) means
    covariance: Floats  # (W, 2, 2)
    matched: Bools  # (W,) false: the readers that read the tag cover no place together, and others do not


def locate(sensors: VirtualSensors, detected: Bools, detection: float, stray: float) -> Coarse:
    """Find the mean and covariance of a tag's place given which readers read it.

    P(detected | virtual sensor v) = prod over readers of `detection` or 1 - `detection` where v is in their range, and
    of `stray` or 1 - `stray` where it is not; the prior is the area.  With detection 1 and stray 0 the place is the
    reference point of the one virtual sensor of these readers ([Lee] Sec. 5.2.3).  Where no region has a probability
    above 0, those count whose readers differ in the fewest.

    Args:
        sensors: the V virtual sensors of R readers.
        detected: (W, R) which readers read the tag.
        detection: probability that a reader in range reads it, in (0, 1].
        stray: probability that a reader out of range does, in [0, 1).
    """
    inside, seen = sensors.members.astype(np.float64), detected.astype(np.float64)
    # Counts (W, V) of reads and misses in range and out of range
    hit, miss = seen @ inside.T, (1.0 - seen) @ inside.T
    false, quiet = seen @ (1.0 - inside).T, (1.0 - seen) @ (1.0 - inside).T
    terms = ((hit, detection), (miss, 1.0 - detection), (false, stray), (quiet, 1.0 - stray))
    log_posterior = np.broadcast_to(log_of(sensors.area), hit.shape).copy()
    for count, probability in terms:
        with np.errstate(invalid="ignore"):
            log_posterior += np.where(count > 0.0, count * log_of(np.asarray(probability)), 0.0)
    # Fall back on the nearest sets of readers
    matched = np.asarray(np.isfinite(log_posterior).any(axis=1))
    differ = miss + false
    nearest = np.where(differ == differ.min(axis=1, keepdims=True), log_of(sensors.area), -np.inf)
    log_posterior = np.where(matched[:, None], log_posterior, nearest)
    weights = np.exp(log_posterior - log_posterior.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    # Moments of the mixture of regions
    mean = weights @ sensors.centroid
    squares = sensors.covariance + sensors.centroid[:, :, None] * sensors.centroid[:, None, :]
    covariance = np.einsum("wv,vij->wij", weights, squares) - mean[:, :, None] * mean[:, None, :]
    return Coarse(mean, covariance, matched)
