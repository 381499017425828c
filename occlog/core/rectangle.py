"""Shares of priors without area, or with sharp edges, that lie in the rectangle along a sight line.

The rectangle goes from a camera to a place at distance r and has half-width R; it is
written in coordinates (along, across) of the sight line, with the camera at the origin.
"""

from __future__ import annotations

import math

import numpy as np

from .geometry import Floats
from .jit import array_kernel

ROOT_HALF = math.sqrt(0.5)
PARALLEL = 1e-12


@array_kernel
def line_share(a: float, b: float, c: float, s: float, sigma: float, r: float, radius: float) -> float:
    """Probability that a degenerate prior, a normal distribution on a line, is in the rectangle; exact.

    Args:
        a: mean along the sight line.
        b: mean across it.
        c: direction of the line, along.
        s: direction of the line, across.
        sigma: standard deviation along the line, > 0.
        r: distance of the place.
        radius: half-width R.
    """
    low, high = -math.inf, math.inf
    for start, slope, least, most in ((a, c, 0.0, r), (b, s, -radius, radius)):
        if abs(slope) < PARALLEL:
            if start < least or start > most:
                return 0.0
            continue
        first, last = (least - start) / slope, (most - start) / slope
        if first > last:
            first, last = last, first
        low, high = max(low, first), min(high, last)
    if low >= high:
        return 0.0
    low, high = low / sigma * ROOT_HALF, high / sigma * ROOT_HALF
    # In a tail the difference of two small numbers keeps its digits.
    if low > 0.0:
        return 0.5 * (math.erfc(low) - math.erfc(high))
    if high < 0.0:
        return 0.5 * (math.erfc(-high) - math.erfc(-low))
    return 0.5 * (math.erf(high) - math.erf(low))


@array_kernel
def polygon_share(ux: float, uy: float, r: float, radius: float, x0: float, y0: float, corners: Floats) -> float:
    """Share of the area of a simple polygon that is in the rectangle; exact.

    The area under the clipped border is summed edge by edge: with all heights (across)
    cut to [-R, R] and all places (along) to [0, r], the signed area between the border and
    the rectangle's lower side is that of polygon and rectangle together.

    Args:
        ux: unit vector along the sight line.
        uy: the same.
        r: distance of the place.
        radius: half-width R.
        x0: position of the camera.
        y0: the same.
        corners: (K, 2) counter-clockwise.
    """
    whole, inside = 0.0, 0.0
    K = corners.shape[0]
    for k in range(K):
        px, py = corners[k, 0] - x0, corners[k, 1] - y0
        qx, qy = corners[(k + 1) % K, 0] - x0, corners[(k + 1) % K, 1] - y0
        a0, b0 = ux * px + uy * py, ux * py - uy * px
        a1, b1 = ux * qx + uy * qy, ux * qy - uy * qx
        whole += 0.5 * (a0 * b1 - a1 * b0)
        inside -= area_under(a0, b0, a1, b1, r, radius)
    return min(1.0, max(0.0, inside / whole)) if whole > 0.0 else 0.0


@array_kernel
def area_under(a0: float, b0: float, a1: float, b1: float, r: float, radius: float) -> float:
    """Signed area between an edge, cut to the rectangle, and the rectangle's lower side.

    Positive for an edge that goes away from the camera.
    """
    sign = 1.0
    if a0 > a1:
        a0, b0, a1, b1 = a1, b1, a0, b0
        sign = -1.0
    left, right = max(a0, 0.0), min(a1, r)
    if left >= right:
        return 0.0
    slope = (b1 - b0) / (a1 - a0)
    start = b0 + slope * (left - a0) + radius
    end = b0 + slope * (right - a0) + radius
    return sign * clipped_area(start, end, right - left, 2.0 * radius)


@array_kernel
def clipped_area(start: float, end: float, width: float, top: float) -> float:
    """Integral over a width of a height that goes straight from start to end, cut to [0, top]."""
    if start > end:
        start, end = end, start
    if end <= 0.0 or start >= top:
        return 0.0 if end <= 0.0 else top * width
    if end == start:
        return start * width
    per = width / (end - start)
    low, high = max(start, 0.0), min(end, top)
    return 0.5 * (high - low) * (high + low) * per + (end - high) * per * top


_nodes, _weights = np.polynomial.legendre.leggauss(16)
NODES: Floats = np.ascontiguousarray(_nodes)
WEIGHTS: Floats = np.ascontiguousarray(_weights)
WIDE = 8.5
"""Standard deviations integrated; the tail beyond is 1e-17."""
MOST_PANELS = 4096


@array_kernel
def quadrature_share(
    a: float, b: float, c: float, s: float, sigma: float, minor: float, r: float, radius: float
) -> float:
    """Probability that a Gaussian prior is in the rectangle, by quadrature across it; within 1e-12.

    Along the sight line the integral is closed, across it is a sum over Gauss-Legendre
    panels no wider than what the integrand changes over ([Ercan] Eq. 17).

    Args:
        a: mean along the sight line.
        b: mean across it.
        c: direction of the major axis, along.
        s: direction of the major axis, across.
        sigma: standard deviation along the major axis.
        minor: standard deviation across it, > 0.
        r: distance of the place.
        radius: half-width R.
    """
    across2 = (s * sigma) ** 2 + (c * minor) ** 2
    across = math.sqrt(across2)
    rho = c * s * (sigma - minor) * (sigma + minor) / across2
    scale = ROOT_HALF * across / (sigma * minor)
    low, high = max(-radius, b - WIDE * across), min(radius, b + WIDE * across)
    if low >= high:
        return 0.0
    fine = min(across, 1.0 / (scale * abs(rho))) if rho != 0.0 else across
    panels = int(min(max(math.ceil((high - low) / fine), 1.0), MOST_PANELS))
    half = 0.5 * (high - low) / panels
    total = 0.0
    for p in range(panels):
        for k in range(NODES.shape[0]):
            w = low + half * (2 * p + 1 + NODES[k])
            middle = a + rho * (w - b)
            along = 0.5 * (math.erf((r - middle) * scale) + math.erf(middle * scale))
            total += WEIGHTS[k] * along * math.exp(-0.5 * (w - b) * (w - b) / across2)
    return total * half / (math.sqrt(2.0 * math.pi) * across)
