"""Which sets of cameras one occluder blocks at once, without the assumption that this is rare.

For a place x, camera i is blocked if the occluder's centre is in the rectangle A_i from
the camera to x with the occluder's diameter as its width.  The rectangles of several
cameras meet at x.  The plane is cut into slices y = const; on a slice every rectangle is
an interval, and the prior's weight of each piece between interval ends has a closed form.
Across the slices it is integrated by Gauss-Legendre panels between the heights at which
corners lie or edges cross, where alone the integrand is not smooth.
"""

from __future__ import annotations

import math

import numpy as np

from .geometry import Floats
from .jit import array_kernel
from .priors import Priors
from .rectangle import NODES, ROOT_HALF, WEIGHTS, WIDE


@array_kernel
def pattern_probabilities(x: float, y: float, cameras: Floats, j: int, priors: Priors) -> Floats:
    """(2^m,) probability that occluder j blocks exactly the cameras of each subset, as bits.

    Args:
        x: the place.
        y: the same.
        cameras: (m, 2) positions.
        j: row of the prior; any kind.
        priors: all of them.
    """
    m = cameras.shape[0]
    out = np.zeros(1 << m)
    sigma, minor = priors.sigma[j], priors.minor[j]
    mx, my = priors.mean[j, 0], priors.mean[j, 1]
    polygon = priors.corners[priors.first[j] : priors.first[j + 1]]
    corners = rectangles(x, y, cameras, priors.radius[j])
    if sigma == 0.0:
        out[pattern_at(mx, my, corners)] = 1.0
        return out
    # The slices run along the major axis: turn everything so that this is x, with the mean at the origin.
    c, s = priors.axis[j, 0], priors.axis[j, 1]
    boxes = turned(corners.reshape(4 * m, 2), mx, my, c, s).reshape(m, 4, 2)
    if polygon.shape[0] == 0 and minor == 0.0:
        add_slice(out, 0.0, 1.0, boxes, sigma, np.empty((0, 2)))
        out[0] = max(0.0, 1.0 - out[1:].sum())
        return out
    area = turned(polygon, mx, my, c, s)
    low, high = -WIDE * minor, WIDE * minor
    if area.shape[0]:
        low, high = area[:, 1].min(), area[:, 1].max()
    heights = breaks(boxes, area, low, high)
    for h in range(heights.shape[0] - 1):
        panels, width = 1, heights[h + 1] - heights[h]
        if width <= 0.0:
            continue
        if area.shape[0] == 0:
            panels = max(1, int(math.ceil(width / minor)))
        half = 0.5 * width / panels
        for part in range(panels):
            for k in range(NODES.shape[0]):
                level = heights[h] + half * (2 * part + 1 + NODES[k])
                weight = WEIGHTS[k] * half
                if area.shape[0] == 0:
                    weight *= math.exp(-0.5 * (level / minor) ** 2) / (math.sqrt(2.0 * math.pi) * minor)
                add_slice(out, level, weight, boxes, sigma, area)
    if area.shape[0]:
        out /= area_of(area)
    out[0] = max(0.0, 1.0 - out[1:].sum())
    return out


@array_kernel
def rectangles(x: float, y: float, cameras: Floats, radius: float) -> Floats:
    """(m, 4, 2) corners of the rectangles from the cameras to a place, counter-clockwise."""
    out = np.empty((cameras.shape[0], 4, 2))
    for i in range(cameras.shape[0]):
        dx, dy = x - cameras[i, 0], y - cameras[i, 1]
        r = math.sqrt(dx * dx + dy * dy)
        ux, uy = (dx / r, dy / r) if r > 0.0 else (1.0, 0.0)
        for k in range(4):
            end = 1.0 if k == 1 or k == 2 else 0.0
            side = radius if k >= 2 else -radius
            out[i, k, 0] = cameras[i, 0] + end * dx - side * uy
            out[i, k, 1] = cameras[i, 1] + end * dy + side * ux
    return out


@array_kernel
def turned(points: Floats, mx: float, my: float, c: float, s: float) -> Floats:
    """Points in coordinates with the origin (mx, my) and the x axis (c, s)."""
    out = np.empty_like(points)
    for k in range(points.shape[0]):
        dx, dy = points[k, 0] - mx, points[k, 1] - my
        out[k, 0], out[k, 1] = c * dx + s * dy, c * dy - s * dx
    return out


@array_kernel
def pattern_at(x: float, y: float, corners: Floats) -> int:
    """Which of the (m, 4, 2) rectangles, as bits, a point is in."""
    found = 0
    for i in range(corners.shape[0]):
        inside = True
        for k in range(4):
            ax, ay = corners[i, k, 0], corners[i, k, 1]
            bx, by = corners[i, (k + 1) % 4, 0], corners[i, (k + 1) % 4, 1]
            inside = inside and (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0.0
        if inside:
            found |= 1 << i
    return found


@array_kernel
def breaks(boxes: Floats, area: Floats, low: float, high: float) -> Floats:
    """Rising heights between low and high, both included, at which corners lie or edges cross."""
    m, K = boxes.shape[0], area.shape[0]
    edges = np.empty((4 * m + K, 4))
    for i in range(m):
        for k in range(4):
            edges[4 * i + k, :2], edges[4 * i + k, 2:] = boxes[i, k], boxes[i, (k + 1) % 4]
    for k in range(K):
        edges[4 * m + k, :2], edges[4 * m + k, 2:] = area[k], area[(k + 1) % K]
    n = edges.shape[0]
    found = np.empty(n + n * (n - 1) // 2 + 2)
    found[0], found[1], count = low, high, 2
    for e in range(n):
        if low < edges[e, 1] < high:
            found[count] = edges[e, 1]
            count += 1
        for f in range(e):
            level = crossing(edges[e], edges[f])
            if low < level < high:
                found[count] = level
                count += 1
    return np.sort(found[:count])


@array_kernel
def crossing(e: Floats, f: Floats) -> float:
    """Height at which two edges (x, y, x, y) cross; inf if they do not."""
    rx, ry, sx, sy = e[2] - e[0], e[3] - e[1], f[2] - f[0], f[3] - f[1]
    cross = rx * sy - ry * sx
    if cross == 0.0:
        return np.inf
    dx, dy = f[0] - e[0], f[1] - e[1]
    t, u = (dx * sy - dy * sx) / cross, (dx * ry - dy * rx) / cross
    if t < 0.0 or t > 1.0 or u < 0.0 or u > 1.0:
        return np.inf
    level: float = e[1] + t * ry
    return level


@array_kernel
def spans(polygon: Floats, level: float) -> Floats:
    """Rising places at which the border of a polygon crosses y = level; even in number."""
    found, count = np.empty(polygon.shape[0]), 0
    for k in range(polygon.shape[0]):
        ax, ay = polygon[k, 0], polygon[k, 1]
        bx, by = polygon[(k + 1) % polygon.shape[0], 0], polygon[(k + 1) % polygon.shape[0], 1]
        if (ay > level) != (by > level):
            found[count] = ax + (bx - ax) * (level - ay) / (by - ay)
            count += 1
    return np.sort(found[:count])


@array_kernel
def add_slice(out: Floats, level: float, weight: float, boxes: Floats, sigma: float, area: Floats) -> None:
    """Add the prior's weight on one slice to the patterns (2^m,) that it lies in, in place; pattern 0 is left out."""
    m = boxes.shape[0]
    ends = np.empty(2 * m)
    first, last = np.empty(m), np.empty(m)
    count = 0
    for i in range(m):
        found = spans(boxes[i], level)
        if found.shape[0] < 2:
            first[i], last[i] = np.inf, -np.inf
            continue
        first[i], last[i] = found[0], found[1]
        ends[count], ends[count + 1] = found[0], found[1]
        count += 2
    if count == 0:
        return
    stops = np.sort(ends[:count])
    inside = spans(area, level)
    for k in range(count - 1):
        middle, pattern = 0.5 * (stops[k] + stops[k + 1]), 0
        for i in range(m):
            if first[i] < middle < last[i]:
                pattern |= 1 << i
        if pattern and stops[k] < stops[k + 1]:
            out[pattern] += weight * line_weight(stops[k], stops[k + 1], sigma, area.shape[0] > 0, inside)


@array_kernel
def line_weight(low: float, high: float, sigma: float, uniform: bool, inside: Floats) -> float:
    """Weight of a piece of a slice: length within the area, or the probability of a normal distribution."""
    if uniform:
        length = 0.0
        for k in range(0, inside.shape[0] - 1, 2):
            length += max(0.0, min(high, inside[k + 1]) - max(low, inside[k]))
        return length
    low, high = low / sigma * ROOT_HALF, high / sigma * ROOT_HALF
    if low > 0.0:
        return 0.5 * (math.erfc(low) - math.erfc(high))
    if high < 0.0:
        return 0.5 * (math.erfc(-high) - math.erfc(-low))
    return 0.5 * (math.erf(high) - math.erf(low))


@array_kernel
def area_of(polygon: Floats) -> float:
    """Area of a counter-clockwise polygon."""
    total = 0.0
    for k in range(polygon.shape[0]):
        n = (k + 1) % polygon.shape[0]
        total += polygon[k, 0] * polygon[n, 1] - polygon[n, 0] * polygon[k, 1]
    return 0.5 * total

