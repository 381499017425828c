"""Covariance intersection of two estimates of one state whose errors have an unknown part in common."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

LEAST = 1e-12
"""Part of the larger variance that the smaller one is taken to be at least: exact places have no inverse."""


def weights(first: Floats, second: Floats) -> Floats:
    """Weights of the first estimate that make the area of the fused place's ellipse smallest.

    With the information matrices A and B and the eigenvalues d of A^-1 B, the determinant of w A + (1 - w) B is
    proportional to the product of w + (1 - w) d, a parabola in w whose vertex is known.

    Args:
        first: (n, 2, 2) covariances of the place.
        second: (n, 2, 2) the same.

    Returns:
        (n,) from 0 to 1.
    """
    # det(A^-1 B - d I) = d^2 - trace d + determinant
    ratio = first @ np.linalg.inv(second)
    trace, determinant = np.trace(ratio, axis1=1, axis2=2), np.linalg.det(ratio)
    # (w + (1 - w) d1) (w + (1 - w) d2) = a w^2 + b w + c
    a, b = 1.0 - trace + determinant, trace - 2.0 * determinant
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = -b / (2.0 * a)
    # The parabola has a maximum inside where a < 0; else, as where it ends first, the end that is higher
    ends = np.where(determinant < 1.0, 1.0, 0.0)
    inside = (a < -1e-12) & (vertex > 0.0) & (vertex < 1.0)
    return np.where(inside, vertex, ends)


def intersect(means: tuple[Floats, Floats], covariances: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Fuse two estimates by covariance intersection (Julier and Uhlmann 1997), whatever their errors have in common.

    P^-1 = w A^-1 + (1 - w) B^-1, P^-1 x = w A^-1 a + (1 - w) B^-1 b; w as `weights` says.

    Args:
        means: two times (n, k) states, the first two numbers the place.
        covariances: two times (n, k, k), finite.

    Returns:
        (n, k) fused states, and (n, k, k) covariances, which are at least those of the errors if both given ones are.
    """
    first, second = (_invertible(c) for c in covariances)
    w = weights(first[:, :2, :2], second[:, :2, :2])[:, None, None]
    of_first, of_second = w * np.linalg.inv(first), (1.0 - w) * np.linalg.inv(second)
    covariance = np.linalg.inv(of_first + of_second)
    mean = covariance @ (of_first @ means[0][..., None] + of_second @ means[1][..., None])
    return mean[..., 0], 0.5 * (covariance + np.swapaxes(covariance, 1, 2))


def _invertible(covariance: Floats) -> Floats:
    k = covariance.shape[-1]
    floor = np.maximum(LEAST * np.trace(covariance, axis1=1, axis2=2), LEAST)
    made: Floats = covariance + floor[:, None, None] * np.eye(k)
    return made
