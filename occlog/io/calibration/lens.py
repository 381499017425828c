"""OpenCV's rational lens, fitted by Brown's, which has fewer coefficients.

The fit is by least squares over the image, and the lens is refused where it is not close enough for measurements.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError

MAX_ERROR_PX = 0.5
"""Largest difference [px] between a lens and its fit anywhere in the image."""
GRID = 41
ITERATIONS = 200


def fit_rational(
    coefficients: Floats, size: tuple[int, int], focal: Floats, principal: Floats, where: str
) -> tuple[Floats, float]:
    """Brown's coefficients (5,) for OpenCV's rational lens k1, k2, p1, p2, k3, k4, k5, k6, and the difference [px].

    Raises:
        InputError: the lens cannot be undone in the image, or the fit is not close.
    """
    distorted = _grid(size, focal, principal)
    ideal = distorted.copy()
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            ideal = ideal + distorted - _rational(ideal, coefficients)
        off = np.abs(_rational(ideal, coefficients) - distorted).max()
    if not off < 1e-6:
        raise InputError(
            f"{where}: the rational lens {coefficients.tolist()} cannot be undone at the edge of the image"
        )
    return _fit(ideal, distorted, focal, where)


def _rational(xy: Floats, coefficients: Floats) -> Floats:
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = xy.T
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    along = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    return np.column_stack([along, y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y])


def _grid(size: tuple[int, int], focal: Floats, principal: Floats) -> Floats:
    """(N, 2) normalised image coordinates of a grid over the image."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, GRID), np.linspace(0, size[1] - 1, GRID))
    return np.asarray((np.column_stack([u.ravel(), v.ravel()]) - principal) / focal)


def _fit(ideal: Floats, distorted: Floats, focal: Floats, where: str) -> tuple[Floats, float]:
    """Brown's coefficients by least squares; InputError where they differ by more than `MAX_ERROR_PX`."""
    x, y = ideal.T
    r2 = x * x + y * y
    across = np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3])
    down = np.column_stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3])
    terms = np.concatenate([across * focal[0], down * focal[1]])
    wanted = ((distorted - ideal) * focal).T.ravel()
    scale = np.abs(terms).max(axis=0)
    found = np.linalg.lstsq(terms / scale, wanted, rcond=None)[0] / scale
    worst = float(np.abs(terms @ found - wanted).max())
    if not worst <= MAX_ERROR_PX:
        raise InputError(
            f"{where}: Brown's lens differs from its rational one by {worst:.2g} px; the limit is {MAX_ERROR_PX:g}: "
            "undistort the images first"
        )
    return found, worst
