"""Exact probabilities that an occluder hides a position from each set of cameras, by integration of its prior.

Occluder j hides the position x from camera i if its centre is in A_i(x), the rectangle from the camera to x, as wide as
the occluder's diameter, without end caps ([Ercan] Fig. 3). The rectangles divide the plane into pieces by the set of
rectangles that contain a point; computed is the prior's probability of every piece. In the prior's own axes the plane
is cut into slices along the major axis; a position is (s, t), s along the slices and t across them. On a slice each
rectangle is an interval, and the normal distribution of a piece is a difference of error functions. Across the slices
the integrand is smooth between the corners and crossings of the rectangles' sides, so Gauss-Legendre panels that begin
and end there are accurate to about 1e-12, for any ratio of the axes. A line is one slice. For a uniform prior lengths
are linear between corners and crossings, so one slice each is exact.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

from .priors import Priors

LEVELS = 9
"""A steep side is cut where it passes -8, -6, .. 8 standard deviations along the slices."""


@kernel
def sides(rows: Floats, polygon: Floats) -> Floats:
    """Return the (4 n + K, 4) sides of n rectangles and a polygon: coordinates s, t of both ends of each.

    Args:
        rows: (n, 6) rectangles: unit vector of the long axis (s, t), middle of the first short side (s, t), length,
            half of the width.
        polygon: (K, 2) corners (s, t); (0, 2) for none.
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
    """Return increasing values t, from `low` to `high`, between which the integrand over t is smooth.

    They are at corners, at crossings of sides and, for a normal prior (sigma > 0), where a side nearly parallel to the
    slices passes even multiples of sigma.

    Args:
        border: (E, 4) sides: s, t of both ends.
        low: t of the first slice.
        high: t of the last slice.
        sigma: standard deviation along the slices; 0: the prior is not normal.
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
        # On a steeper side the mass changes over a segment of t as wide as a panel: no cuts are needed.
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
    """Return the coordinate t at which two segments cross; NaN if they do not cross or are parallel.

    Args:
        a: (4,) s, t of one end, s, t of the other.
        b: (4,) the other segment.
    """
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
    """Return the greatest |ds/dt| of the sides that pass between the slices at t = low and t = high; 0 without any.

    `border` (E, 4) has the coordinates s, t of both ends of each side.
    """
    most = 0.0
    for e in range(border.shape[0]):
        s0, t0, s1, t1 = border[e]
        if t0 != t1 and min(t0, t1) < high and max(t0, t1) > low:
            most = max(most, abs((s1 - s0) / (t1 - t0)))
    return most


SUPPORT_SIGMAS = 8.5
"""Standard deviations that count; beyond is 2e-17."""
ROOT_HALF = math.sqrt(0.5)
ROOT_2PI = math.sqrt(2.0 * math.pi)
RULES: Floats = np.zeros((2, 2, 16))
"""Nodes and weights of Gauss-Legendre panels: 16 for those two deviations wide, 8 for those below one."""
RULES[0], RULES[1, :, :8] = np.polynomial.legendre.leggauss(16), np.polynomial.legendre.leggauss(8)


@kernel
def normal_between(low: float, high: float) -> float:
    """Return the probability of a standard normal variable between low and high; 0 if low >= high.

    In a tail the complementary error function avoids cancellation.
    """
    if low >= high:
        return 0.0
    low, high = low * ROOT_HALF, high * ROOT_HALF
    if low > 0.0:
        return 0.5 * (math.erfc(low) - math.erfc(high))
    if high < 0.0:
        return 0.5 * (math.erfc(-high) - math.erfc(-low))
    return 0.5 * (math.erf(high) - math.erf(low))


@kernel
def shares(x: float, y: float, cameras: Floats, priors: Priors, j: int) -> Floats:
    """Return the (2^N,) probabilities that occluder j hides the position (x, y) from exactly a set of N cameras.

    Bit i of an index represents camera i; index 0 is the empty set. They sum to 1. From a camera at (x, y) nothing is
    hidden.

    Args:
        x: position.
        y: position.
        cameras: (N, 2) positions.
        priors: priors of the occluders.
        j: index of the occluder.
    """
    out = np.zeros(1 << cameras.shape[0])
    # Rectangles that the prior reaches, in the prior's axes
    rows, bits = _strips(x, y, cameras, priors, j)
    corners = priors.corners[priors.first[j] : priors.first[j + 1]]
    sigma, minor = priors.sigma[j], priors.minor[j]
    none, ends, flips = np.zeros(0), np.empty(2 * bits.shape[0]), np.empty(2 * bits.shape[0], dtype=np.int64)
    # Integrate the prior over every piece
    if bits.shape[0] > 0:
        if corners.shape[0] > 0:
            _uniform_into(out, rows, bits, _own_axes(corners, priors, j))
        elif sigma == 0.0:
            _slice_into(out, 0.0, rows, bits, none, 0.0, 1.0, ends, flips)
        elif minor == 0.0:
            _slice_into(out, 0.0, rows, bits, none, sigma, 1.0, ends, flips)
        else:
            _normal_into(out, rows, bits, sigma, minor)
    out[0] = max(0.0, 1.0 - np.sum(out[1:]))
    return out


@kernel
def _strips(x: float, y: float, cameras: Floats, priors: Priors, j: int) -> tuple[Floats, Ints]:
    """Return the rectangles of cameras that the prior can reach, in its own axes: s major, t minor, origin at the mean.

    An occluder with its centre in a camera's rectangle hides (x, y) from that camera.

    Args:
        x: position.
        y: position.
        cameras: (N, 2) positions.
        priors: priors of the occluders.
        j: index of the occluder.

    Returns:
        (n, 6) rectangles: unit vector to (x, y) as s and t; the camera's position as s and t; distance; half of the
        width.
        (n,) bits of the cameras: 1 << i for camera i.
    """
    c, s, radius = priors.axis[j, 0], priors.axis[j, 1], priors.radius[j]
    reach = SUPPORT_SIGMAS * priors.sigma[j]
    for k in range(priors.first[j], priors.first[j + 1]):
        reach = max(
            reach, math.hypot(priors.corners[k, 0] - priors.mean[j, 0], priors.corners[k, 1] - priors.mean[j, 1])
        )
    rows, bits = np.empty((cameras.shape[0], 6)), np.empty(cameras.shape[0], dtype=np.int64)
    n = 0
    for i in range(cameras.shape[0]):
        dx, dy = x - cameras[i, 0], y - cameras[i, 1]
        r = math.hypot(dx, dy)
        if r == 0.0:
            continue
        dx, dy = dx / r, dy / r
        px, py = cameras[i, 0] - priors.mean[j, 0], cameras[i, 1] - priors.mean[j, 1]
        along, across = -(px * dx + py * dy), py * dx - px * dy
        if abs(across) <= radius + reach and -reach <= along <= r + reach:
            rows[n, 0], rows[n, 1] = c * dx + s * dy, c * dy - s * dx
            rows[n, 2], rows[n, 3] = c * px + s * py, c * py - s * px
            rows[n, 4], rows[n, 5] = r, radius
            bits[n] = 1 << i
            n += 1
    return rows[:n], bits[:n]


@kernel
def _own_axes(corners: Floats, priors: Priors, j: int) -> Floats:
    """Return points `corners` (K, 2) in the axes of prior j: along its major and minor axis, relative to its mean."""
    c, s = priors.axis[j, 0], priors.axis[j, 1]
    out = np.empty(corners.shape)
    for k in range(corners.shape[0]):
        dx, dy = corners[k, 0] - priors.mean[j, 0], corners[k, 1] - priors.mean[j, 1]
        out[k, 0], out[k, 1] = c * dx + s * dy, c * dy - s * dx
    return out


@kernel
def _interval(row: Floats, t: float) -> tuple[float, float]:
    """Return the interval (low, high) of s in which the slice at t is inside a rectangle; low > high if it is not.

    `row` (6,) is the rectangle: unit vector of its long axis (s, t), middle of its first short side (s, t), length,
    half of the width.
    """
    d_s, d_t, r, radius = row[0], row[1], row[4], row[5]
    start = (t - row[3]) * d_t - row[2] * d_s  # distance along the line of sight at s = 0; it grows by d_s
    side = (t - row[3]) * d_s + row[2] * d_t  # distance across it at s = 0; it grows by -d_t
    low, high = -math.inf, math.inf
    for at, slope, least, most in ((start, d_s, 0.0, r), (side, -d_t, -radius, radius)):
        if slope == 0.0:
            if at < least or at > most:
                return 1.0, -1.0
            continue
        first, last = (least - at) / slope, (most - at) / slope
        low, high = max(low, min(first, last)), min(high, max(first, last))
    return low, high


@kernel
def _slice_into(
    out: Floats,
    t: float,
    rows: Floats,
    bits: Ints,
    inside: Floats,
    sigma: float,
    weight: float,
    ends: Floats,
    flips: Ints,
) -> bool:
    """Add `weight` times the integral of a prior over the slice at t, for each set of cameras, to `out`, in place.

    False, without a change, if the slice meets no rectangle.

    Args:
        out: (2^N,) integrals, by the set of cameras from which the position is hidden.
        t: position of the slice.
        rows: (n, 6) rectangles, as `_strips` returns them.
        bits: (n,) bits of their cameras.
        inside: (2 m,) s at which the slice enters and leaves a uniform prior; empty: the prior is normal.
        sigma: standard deviation along the slice of a normal prior; 0: all of it is at s = 0.
        weight: weight of the slice.
        ends: (2 n + 2 m,) workspace.
        flips: (2 n + 2 m,) workspace.
    """
    n, m = bits.shape[0], inside.shape[0]
    # Ends of the rectangles' intervals, sorted; `mask`: the rectangles that hold the prior's mean
    size, mask = 0, 0
    for i in range(n):
        low, high = _interval(rows[i], t)
        if low > high:
            continue
        if low <= 0.0 <= high:
            mask |= bits[i]
        for end in (low, high):
            _insert(ends, flips, size, end, bits[i])
            size += 1
    if size == 0:
        return False
    if m == 0 and sigma == 0.0:
        out[mask] += weight if mask != 0 else 0.0
        return True
    # Walk along the slice: at every end one rectangle (or the polygon) is entered or left
    polygon = 1 << 62
    for k in range(m):
        _insert(ends, flips, size, inside[k], polygon)
        size += 1
    mask = 0
    for k in range(size - 1):
        mask ^= flips[k]
        piece = mask & ~polygon
        if piece == 0 or ends[k] == ends[k + 1]:
            continue
        if m == 0:
            out[piece] += weight * normal_between(ends[k] / sigma, ends[k + 1] / sigma)
        elif mask & polygon:
            out[piece] += weight * (ends[k + 1] - ends[k])
    return True


@kernel
def _insert(ends: Floats, flips: Ints, size: int, end: float, flip: int) -> None:
    """Insert an end of an interval among the first `size` sorted ends, in place.

    Args:
        ends: ends, with room for one more.
        flips: bit of the rectangle or polygon of each end, in this order.
        size: number of ends so far.
        end: the new end.
        flip: bit of the new end.
    """
    k = size
    while k > 0 and ends[k - 1] > end:
        ends[k], flips[k] = ends[k - 1], flips[k - 1]
        k -= 1
    ends[k], flips[k] = end, flip


@kernel
def _normal_into(out: Floats, rows: Floats, bits: Ints, sigma: float, minor: float) -> None:
    """Add the probabilities of a normal prior to `out`, in place, by Gauss-Legendre quadrature between the cuts.

    Args:
        out: (2^N,) probability that the position is hidden from exactly a set of cameras.
        rows: (n, 6) rectangles, as `_strips` returns them.
        bits: (n,) bits of their cameras.
        sigma: standard deviation along the major axis.
        minor: standard deviation along the minor axis, > 0.
    """
    none, border = np.zeros(0), sides(rows, np.zeros((0, 2)))
    ends, flips = np.empty(2 * bits.shape[0]), np.empty(2 * bits.shape[0], dtype=np.int64)
    at = cuts(border, -SUPPORT_SIGMAS * minor, SUPPORT_SIGMAS * minor, sigma, minor)
    for k in range(at.shape[0] - 1):
        width = at[k + 1] - at[k]
        if width <= 0.0 or not _slice_into(out, at[k] + 0.5 * width, rows, bits, none, sigma, 0.0, ends, flips):
            continue
        slope = steepest(border, at[k], at[k + 1]) * minor / sigma
        small = width * math.sqrt(1.0 + slope * slope) < minor
        # Gauss-Legendre: 8 nodes for a panel narrower than a deviation, else 16 for two deviations
        nodes, weights = RULES[1 if small else 0]
        panels = 1 if small else math.ceil(0.5 * width / minor)
        half = 0.5 * width / panels
        for p in range(panels):
            for g in range(8 if small else 16):
                t = at[k] + half * (2 * p + 1 + nodes[g])
                weight = half * weights[g] * math.exp(-0.5 * (t / minor) ** 2) / (ROOT_2PI * minor)
                _slice_into(out, t, rows, bits, none, sigma, weight, ends, flips)


@kernel
def _uniform_into(out: Floats, rows: Floats, bits: Ints, polygon: Floats) -> None:
    """Add the probabilities of a prior that is uniform over a polygon to `out`, in place.

    The midpoint rule is exact between the cuts.

    Args:
        out: (2^N,) probability that the position is hidden from exactly a set of cameras.
        rows: (n, 6) rectangles, as `_strips` returns them.
        bits: (n,) bits of their cameras.
        polygon: (K, 2) counter-clockwise, in the prior's own axes.
    """
    low, high = np.min(polygon[:, 1]), np.max(polygon[:, 1])
    area, K = 0.0, polygon.shape[0]
    for k in range(K):
        p, q = polygon[k], polygon[(k + 1) % K]
        area += 0.5 * (p[0] * q[1] - p[1] * q[0])
    room = 2 * bits.shape[0] + K
    ends, flips = np.empty(room), np.empty(room, dtype=np.int64)
    at = cuts(sides(rows, polygon), low, high, 0.0, 0.0)
    for k in range(at.shape[0] - 1):
        width = at[k + 1] - at[k]
        if width > 0.0:
            t = at[k] + 0.5 * width
            _slice_into(out, t, rows, bits, _entered(polygon, t), 0.0, width / area, ends, flips)


@kernel
def _entered(polygon: Floats, t: float) -> Floats:
    """Return the values s at which the slice at t crosses the sides of a polygon (K, 2), unsorted and even in number.

    They are where the slice enters and leaves the polygon.
    """
    K, size = polygon.shape[0], 0
    out = np.empty(K)
    for k in range(K):
        s0, t0 = polygon[k]
        s1, t1 = polygon[(k + 1) % K]
        if (t0 <= t) != (t1 <= t):
            out[size] = s0 + (s1 - s0) * (t - t0) / (t1 - t0)
            size += 1
    return out[:size]
