"""Probability that no moving occluder hides a place, interpolated over a cloud of particles.

Where every prior is Gaussian and wide against the cloud, P (`occlog.core.occlusion.hidden`) is
smooth over the cloud's bounding box.  It is then computed at Chebyshev points of the box
only and interpolated by Chebyshev polynomials.  Their degrees follow from the box and the
narrowest prior; the last coefficients tell the error, and where it is too large, P is
computed place by place.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import array_kernel

from .hidden import unhidden
from .priors import Priors

HIGHEST = 24
"""Polynomials of a higher degree need more points than most clouds have particles."""
WORTH = 0.5
"""Points per place from which on interpolation is not worth its trouble."""
APART = 2.0
"""How far a camera must be from the middle of the box, in half diagonals: P is not smooth at the camera."""


class Grid(NamedTuple):
    """Chebyshev points of the bounding box of a cloud of L places; no points where P is not to be interpolated."""

    points: Floats  # (K, 2), the second coordinate running faster
    first: Floats  # (nx, L) Chebyshev polynomials of the places' first coordinate
    second: Floats  # (ny, L) of the second
    fit_first: Floats  # (nx, nx) coefficients from values at the points
    fit_second: Floats  # (ny, ny)
    x: float  # middle of the box
    y: float
    size: float  # half of its diagonal
    tolerance: float  # greatest error of P, relative to its greatest value


@array_kernel
def make_grid(xy: Floats, free: Bools, priors: Priors, far: float) -> Grid:
    """Points over the box around the places of (L, 2) `xy` that are `free`.

    Args:
        xy: places.
        free: (L,) those that count.
        priors: of the occluders.
        far: standard deviations at which a prior counts as over; the error is to be of the size of that tail.
    """
    # Tolerance: the tail that `far` leaves out
    tolerance = 0.5 * math.erfc(far / math.sqrt(2.0))
    narrowest = np.inf
    for j in range(priors.minor.shape[0]):
        narrowest = min(narrowest, priors.minor[j] if priors.first[j] == priors.first[j + 1] else 0.0)
    # Bounding box of the free places
    low_x, low_y, high_x, high_y, count = np.inf, np.inf, -np.inf, -np.inf, 0
    for p in range(xy.shape[0]):
        if free[p]:
            low_x, high_x = min(low_x, xy[p, 0]), max(high_x, xy[p, 0])
            low_y, high_y = min(low_y, xy[p, 1]), max(high_y, xy[p, 1])
            count += 1
    # Degrees: from the box and the narrowest prior; none where interpolation is not worth it
    nx, ny = 0, 0
    hx, hy = 0.5 * (high_x - low_x), 0.5 * (high_y - low_y)
    if count > 0 and 0.0 < narrowest < np.inf:
        nx, ny = terms(hx / narrowest, tolerance), terms(hy / narrowest, tolerance)
        if max(nx, ny) > HIGHEST or nx * ny > WORTH * count:
            nx, ny = 0, 0
    # Chebyshev points of the first kind
    x, y = low_x + hx, low_y + hy
    hx, hy = max(hx, 1e-300), max(hy, 1e-300)
    points = np.empty((nx * ny, 2))
    for a in range(nx):
        for b in range(ny):
            points[a * ny + b, 0] = x + hx * math.cos(math.pi * (a + 0.5) / nx)
            points[a * ny + b, 1] = y + hy * math.cos(math.pi * (b + 0.5) / ny)
    return Grid(
        points=points,
        first=polynomials(xy[:, 0], x, hx, nx),
        second=polynomials(xy[:, 1], y, hy, ny),
        fit_first=fit(nx),
        fit_second=fit(ny),
        x=x,
        y=y,
        size=math.sqrt(hx * hx + hy * hy),
        tolerance=tolerance,
    )


@array_kernel
def terms(half: float, tolerance: float) -> int:
    """Number of polynomials for an interval of so many standard deviations of the narrowest prior to either side.

    The coefficients of a Gaussian fall as (half / 2)^n / sqrt(n!); products of some of them a little later.
    """
    n, size = 0, 2.0
    while size > tolerance and n <= HIGHEST:
        n += 1
        size *= 0.5 * half / math.sqrt(n)
    return n + 2


@array_kernel
def polynomials(values: Floats, middle: float, half: float, n: int) -> Floats:
    """(n, L) Chebyshev polynomials of degrees 0 to n - 1 at (L,) values of middle +- half."""
    out = np.ones((n, values.shape[0]))
    if n > 1:
        for p in range(values.shape[0]):
            out[1, p] = (values[p] - middle) / half
    for k in range(2, n):
        for p in range(values.shape[0]):
            out[k, p] = 2.0 * out[1, p] * out[k - 1, p] - out[k - 2, p]
    return out


@array_kernel
def fit(n: int) -> Floats:
    """(n, n) matrix from values at n Chebyshev points to coefficients: the discrete cosine transform."""
    out = np.empty((n, n))
    for k in range(n):
        for a in range(n):
            out[k, a] = (1.0 if k == 0 else 2.0) / n * math.cos(math.pi * k * (a + 0.5) / n)
    return out


@array_kernel
def unhidden_over(
    grid: Grid, xy: Floats, rows: Ints, x0: float, y0: float, priors: Priors, form: int, far: float
) -> Floats:
    """As `occlog.core.occlusion.hidden.unhidden`, interpolated over the grid where that is quicker and good enough."""
    nx, ny = grid.first.shape[0], grid.second.shape[0]
    away = math.sqrt((grid.x - x0) ** 2 + (grid.y - y0) ** 2)
    if nx * ny == 0 or nx * ny > WORTH * rows.shape[0] or away < APART * grid.size:
        return unhidden(xy, rows, x0, y0, priors, form, far)
    values = unhidden(grid.points, np.arange(nx * ny), x0, y0, priors, form, far)
    coefficients = coefficients_of(values, grid.fit_first, grid.fit_second)
    largest = 0.0
    for k in range(nx * ny):
        largest = max(largest, values[k])
    if left_over(coefficients) > grid.tolerance * largest:
        return unhidden(xy, rows, x0, y0, priors, form, far)
    return evaluate(coefficients, grid.first, grid.second, rows)


@array_kernel
def coefficients_of(values: Floats, fit_first: Floats, fit_second: Floats) -> Floats:
    """(nx, ny) Chebyshev coefficients of (nx ny,) values at the points of a grid."""
    nx, ny = fit_first.shape[0], fit_second.shape[0]
    half, out = np.zeros((nx, ny)), np.zeros((nx, ny))
    for k in range(nx):
        for a in range(nx):
            for b in range(ny):
                half[k, b] += fit_first[k, a] * values[a * ny + b]
    for k in range(nx):
        for m in range(ny):
            for b in range(ny):
                out[k, m] += fit_second[m, b] * half[k, b]
    return out


@array_kernel
def left_over(coefficients: Floats) -> float:
    """Size of the last two coefficients in either direction: about the error of what was cut off."""
    nx, ny = coefficients.shape
    size = 0.0
    for k in range(nx):
        for m in range(ny):
            if k >= nx - 2 or m >= ny - 2:
                size = max(size, abs(coefficients[k, m]))
    return size


@array_kernel
def evaluate(coefficients: Floats, first: Floats, second: Floats, rows: Ints) -> Floats:
    """(n,) values of the polynomial at some of the places, cut to [0, 1]."""
    nx, ny, L = first.shape[0], second.shape[0], first.shape[1]
    total, inner = np.zeros(L), np.empty(L)
    for k in range(nx):
        inner[:] = coefficients[k, 0]
        m = 1
        while m < ny:  # four at a time: fewer passes over memory
            c0 = coefficients[k, m]
            c1 = coefficients[k, m + 1] if m + 1 < ny else 0.0
            c2 = coefficients[k, m + 2] if m + 2 < ny else 0.0
            c3 = coefficients[k, m + 3] if m + 3 < ny else 0.0
            s0, s1 = second[m], second[min(m + 1, ny - 1)]
            s2, s3 = second[min(m + 2, ny - 1)], second[min(m + 3, ny - 1)]
            for p in range(L):
                inner[p] += c0 * s0[p] + c1 * s1[p] + (c2 * s2[p] + c3 * s3[p])
            m += 4
        for p in range(L):
            total[p] += inner[p] * first[k, p]
    out = np.empty(rows.shape[0])
    for m in range(rows.shape[0]):
        out[m] = min(1.0, max(0.0, total[rows[m]]))
    return out
