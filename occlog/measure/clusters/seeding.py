"""Seeds of clusters: greedily the places with the most foreground in a person-sized window."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

from .person_prior import Prior, place

MAX_CLUSTERS = 64
SEED_MASS = 0.06  # of a person's foreground in the window of a seed
SEED_REACH2 = 4.0  # squared Mahalanobis distance of the pixels that a seed takes


@kernel
def seeds(cells: Floats, corners: Ints, side: int, prior: Prior) -> Floats:
    """(K, 2) centres of person-sized windows with much foreground, greedily.

    Args:
        cells: (N, 6) cell table.
        corners: (N, 2) its cells' corners.
        side: of the cells [px].
        prior: of the camera.
    """
    rows, columns = (prior.height + side - 1) // side, (prior.width + side - 1) // side
    left = cells[:, 0].copy()
    centres = np.empty((MAX_CLUSTERS, 2))
    integral = np.zeros((rows + 1, columns + 1))
    for k in range(MAX_CLUSTERS):
        _integrate_into(integral, left, corners, side)
        best, best_mass = -1, SEED_MASS
        for i in range(cells.shape[0]):
            if left[i] > 0.0:
                mass = _window_mass(integral, cells[i, 1], cells[i, 2], side, prior)
                if mass > best_mass:
                    best, best_mass = i, mass
        if best < 0:
            return centres[:k].copy()
        _take_into(left, centres[k], cells, cells[best, 1], cells[best, 2], prior)
    return centres


@kernel
def _integrate_into(integral: Floats, counts: Floats, corners: Ints, side: int) -> None:
    """Integral image of the counts: [r, c] is the sum over rows < r and columns < c."""
    integral[:] = 0.0
    for i in range(counts.shape[0]):
        integral[corners[i, 1] // side + 1, corners[i, 0] // side + 1] = counts[i]
    for r in range(1, integral.shape[0]):
        run = 0.0
        for c in range(1, integral.shape[1]):
            run += integral[r, c]
            integral[r, c] = integral[r - 1, c] + run


@kernel
def _window_mass(integral: Floats, x: float, y: float, side: int, prior: Prior) -> float:
    """Foreground within one standard deviation of a person's box around a place, in persons' pixels."""
    at = place(prior, x, y)
    rx, ry = math.sqrt(prior.cov[at, 0]), math.sqrt(prior.cov[at, 2])
    rows, columns = integral.shape[0] - 1, integral.shape[1] - 1
    c0, c1 = max(int((x - rx) / side), 0), min(int((x + rx) / side) + 1, columns)
    r0, r1 = max(int((y - ry) / side), 0), min(int((y + ry) / side) + 1, rows)
    inside = integral[r1, c1] - integral[r0, c1] - integral[r1, c0] + integral[r0, c0]
    return float(inside / prior.mass[at])


@kernel
def _take_into(left: Floats, centre: Floats, cells: Floats, x: float, y: float, prior: Prior) -> None:
    """Take the foreground of a person at (x, y) out of `left`; write its mean to `centre`."""
    xx, xy, yy = prior.cov[place(prior, x, y)]
    det = xx * yy - xy * xy
    n = sx = sy = 0.0
    for i in range(cells.shape[0]):
        dx, dy = cells[i, 1] - x, cells[i, 2] - y
        if (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det <= SEED_REACH2:
            n += left[i]
            sx += left[i] * cells[i, 1]
            sy += left[i] * cells[i, 2]
            left[i] = 0.0
    # The window's own cell is always taken, so n > 0.
    centre[0], centre[1] = sx / n, sy / n
