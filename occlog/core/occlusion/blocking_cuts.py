"""Where slices through rectangles change the order of what they cross: at corners and crossings of sides.

Places are (s, t): s along the slices, t across them.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

LEVELS = 9
"""A steep side is cut where it passes -8, -6, .. 8 standard deviations along the slices."""


@kernel
def sides(rows: Floats, polygon: Floats) -> Floats:
    """(4 n + K, 4) sides of n rectangles and a polygon: s, t of one end and of the other.

    Args:
        rows: (n, 6) rectangles, as `blocking_shares._strips` gives them.
        polygon: (K, 2); none: (0, 2).
    """
    n, K = rows.shape[0], polygon.shape[0]
    out = np.empty((4 * n + K, 4))
    for i in range(n):
        d_s, d_t, c_s, c_t, r, radius = rows[i]
        for k in range(4):
            for end in range(2):
                corner = (k + end) % 4
                along = r if corner == 1 or corner == 2 else 0.0
                across = radius if corner >= 2 else -radius
                out[4 * i + k, 2 * end] = c_s + d_s * along - d_t * across
                out[4 * i + k, 2 * end + 1] = c_t + d_t * along + d_s * across
    for k in range(K):
        out[4 * n + k, :2] = polygon[k]
        out[4 * n + k, 2:] = polygon[(k + 1) % K]
    return out


@kernel
def cuts(border: Floats, low: float, high: float, sigma: float, minor: float) -> Floats:
    """Rising t, from low to high, between which the lengths of the pieces change smoothly.

    They are those of corners, of crossings of sides, and, for a normal prior (sigma > 0),
    those at which a side that nearly runs along the slices passes even multiples of sigma.

    Args:
        border: (E, 4) sides.
        low: first slice.
        high: last slice.
        sigma: standard deviation along the slices; 0: not normal.
        minor: standard deviation across them.
    """
    E = border.shape[0]
    out = np.empty(2 + E + E * (E - 1) // 2 + LEVELS * E)
    out[0], out[1] = low, high
    size = 2
    for e in range(E):
        s0, t0, s1, t1 = border[e]
        if low < t0 < high:
            out[size] = t0
            size += 1
        # On a steeper side the mass changes over a stretch of t as wide as a panel: no cuts are needed.
        steep = sigma > 0.0 and abs(s1 - s0) * minor > 2.0 * abs(t1 - t0) * sigma
        for k in range(LEVELS if steep else 0):
            level = 2.0 * (k - LEVELS // 2) * sigma
            if (s0 - level) * (s1 - level) < 0.0:
                t = t0 + (t1 - t0) * (level - s0) / (s1 - s0)
                if low < t < high:
                    out[size] = t
                    size += 1
        for f in range(e):
            t = crossing(border[e], border[f])
            if low < t < high:
                out[size] = t
                size += 1
    return np.sort(out[:size])


@kernel
def crossing(a: Floats, b: Floats) -> float:
    """The t at which two sides cross; NaN if they do not."""
    a_s, a_t, b_s, b_t = a[2] - a[0], a[3] - a[1], b[2] - b[0], b[3] - b[1]
    cross = a_s * b_t - a_t * b_s
    if cross == 0.0:
        return math.nan
    d_s, d_t = b[0] - a[0], b[1] - a[1]
    on_a, on_b = (d_s * b_t - d_t * b_s) / cross, (d_s * a_t - d_t * a_s) / cross
    # One cut too many does no harm, a missed one would: allow for rounding.
    if -1e-9 <= on_a <= 1.0 + 1e-9 and -1e-9 <= on_b <= 1.0 + 1e-9:
        return float(a[1] + on_a * a_t)
    return math.nan


@kernel
def steepest(border: Floats, low: float, high: float) -> float:
    """Greatest |ds/dt| of the sides that pass between the slices at low and high."""
    most = 0.0
    for e in range(border.shape[0]):
        s0, t0, s1, t1 = border[e]
        if t0 != t1 and min(t0, t1) < high and max(t0, t1) > low:
            most = max(most, abs((s1 - s0) / (t1 - t0)))
    return most
