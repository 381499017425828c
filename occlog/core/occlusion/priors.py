"""Priors of the positions of M moving occluders at one time, packed for the kernels.

A prior is Gaussian, degenerate (on a line, or at a point), or uniform over a polygon ([Ercan] Sec. 4.2 and 4.4).
Occluders are upright cylinders on the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.plane import signed_area

MIN_VARIANCE_RATIO = 1e-12
"""A variance below this share of the other counts as 0: the prior is degenerate."""


class Priors(NamedTuple):
    """M priors of occluder positions: normal (also degenerate), or uniform over a polygon, packed for kernels.

    A prior with corners is uniform over them; its mean, axis and standard deviations are those of the uniform
    distribution.
    """

    mean: Floats  # (M, 2)
    axis: Floats  # (M, 2) unit vector along the major axis
    sigma: Floats  # (M,) standard deviation along the major axis; 0: the position is known
    minor: Floats  # (M,) standard deviation across it; 0: degenerate
    radius: Floats  # (M,) half of the occluder's diameter D
    first: Ints  # (M + 1,) corners of prior j are first[j] to first[j + 1] - 1; none: Gaussian
    corners: Floats  # (V, 2) of the polygons, counter-clockwise


def gaussian_priors(mean: Floats, covariance: Floats, diameter: float) -> Priors:
    """Return normal priors of occluder positions, packed for kernels.

    Args:
        mean: (M, 2) means.
        covariance: (M, 2, 2) covariances; all 0: the position is known.
        diameter: diameter of every occluder, > 0.

    Raises:
        ValueError: a covariance is not positive semi-definite.
    """
    M = len(mean)
    covariance = np.asarray(covariance, dtype=np.float64).reshape(M, 2, 2)
    values, vectors = np.linalg.eigh(covariance) if M else (np.empty((0, 2)), np.empty((0, 2, 2)))
    if np.any(values[:, 0] < -1e-9 * np.maximum(values[:, 1], 1e-300)):
        raise ValueError(
            "covariance of a moving occluder is not positive semi-definite; correct its cov_xx, cov_xy and cov_yy"
        )
    values = np.where(values < MIN_VARIANCE_RATIO * values[:, 1:], 0.0, values)
    return Priors(
        mean=np.ascontiguousarray(mean, dtype=np.float64).reshape(M, 2),
        axis=np.ascontiguousarray(vectors[:, :, 1]),
        sigma=np.sqrt(values[:, 1]),
        minor=np.sqrt(values[:, 0]),
        radius=np.full(M, 0.5 * diameter),
        first=np.zeros(M + 1, dtype=np.int64),
        corners=np.empty((0, 2)),
    )


def polygon_priors(polygons: Sequence[Floats], diameter: float) -> Priors:
    """Return priors that are uniform over simple polygons, with their means and covariances, packed for kernels.

    Args:
        polygons: M polygons (K, 2), of either orientation.
        diameter: diameter of every occluder, > 0.

    Raises:
        ValueError: a polygon has no area.
    """
    turned = []
    for polygon in polygons:
        if signed_area(polygon) == 0.0:
            raise ValueError("an occluder's polygon has no area")
        turned.append(polygon if signed_area(polygon) > 0 else polygon[::-1])
    moments = [_moments(p) for p in turned]
    mean = np.array([m for m, _ in moments]).reshape(-1, 2)
    spread = gaussian_priors(mean, np.array([c for _, c in moments]).reshape(-1, 2, 2), diameter)
    first = np.concatenate([[0], np.cumsum([len(p) for p in turned])]).astype(np.int64)
    corners = np.ascontiguousarray(np.concatenate(turned)) if turned else np.empty((0, 2))
    return spread._replace(first=first, corners=corners)


def no_priors() -> Priors:
    """Return an empty set of priors: there is no moving occluder."""
    return gaussian_priors(np.empty((0, 2)), np.empty((0, 2, 2)), 1.0)


def without_own(priors: Priors, mean: Floats, covariance: Floats, gate: float) -> Priors:
    """Return the priors without those that may be of the tracked target itself.

    A prior is removed if the Mahalanobis distance of the two means is at most `gate`; the covariance is the sum of
    both, plus the squared radius of the occluder per axis.

    Args:
        priors: priors of everything that moves.
        mean: (2,) estimated position of the target.
        covariance: (2, 2) covariance of the estimate.
        gate: limit of the distance, in standard deviations.
    """
    if not len(priors.sigma):
        return priors
    axis = priors.axis
    side = np.column_stack([-axis[:, 1], axis[:, 0]])
    spread = np.einsum("mi,mj->mij", axis, axis) * (priors.sigma**2)[:, None, None]
    spread += np.einsum("mi,mj->mij", side, side) * (priors.minor**2)[:, None, None]
    spread += covariance + np.eye(2) * (priors.radius**2)[:, None, None]
    difference = priors.mean - mean
    distance2 = np.einsum("mi,mi->m", difference, np.linalg.solve(spread, difference[:, :, None])[:, :, 0])
    return take_priors(priors, np.flatnonzero(distance2 > gate**2))


def take_priors(priors: Priors, rows: Ints) -> Priors:
    """Return the priors with the indices `rows`, as a copy."""
    corners = [priors.corners[priors.first[j] : priors.first[j + 1]] for j in rows.tolist()]
    first = np.concatenate([[0], np.cumsum([len(c) for c in corners])]).astype(np.int64)
    return Priors(
        mean=priors.mean[rows],
        axis=priors.axis[rows],
        sigma=priors.sigma[rows],
        minor=priors.minor[rows],
        radius=priors.radius[rows],
        first=first,
        corners=np.concatenate([np.empty((0, 2)), *corners]),
    )


def _moments(polygon: Floats) -> tuple[Floats, Floats]:
    """Return mean (2,) and covariance (2, 2) of the uniform distribution over a counter-clockwise polygon (K, 2)."""
    origin = polygon.mean(axis=0)
    a = polygon - origin
    b = np.roll(a, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = 0.5 * cross.sum()
    mean = (cross[:, None] * (a + b)).sum(axis=0) / (6.0 * area)
    sums = a + b
    outer = np.einsum("ki,kj->kij", a, a) + np.einsum("ki,kj->kij", b, b) + np.einsum("ki,kj->kij", sums, sums)
    second = (cross[:, None, None] * outer).sum(axis=0) / (24.0 * area)
    return origin + mean, second - np.outer(mean, mean)
