"""Polygons on the ground: inside tests, sight lines through them, distances.

A polygon is a (K, 2) array of the vertices of a simple closed polygon, in order, the
last joined to the first; it need not be convex and its winding does not matter unless
said otherwise.  The scalar kernels (`point_inside`, `segment_blocked`,
`distance_to_boundary`) are for use in other kernels; lists of polygons go to kernels
packed by `pack_polygons`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel


@kernel
def point_inside(x: float, y: float, polygon: Floats) -> bool:
    """True if (x, y) lies inside the polygon (even-odd rule).

    A point on the border counts as inside on lower and left edges only, so that
    polygons that share an edge never both claim it.
    """
    inside = False
    j = polygon.shape[0] - 1
    for i in range(polygon.shape[0]):
        yi, yj = polygon[i, 1], polygon[j, 1]
        if (yi > y) != (yj > y):
            # Which side of the edge the point is on, by the sign of the cross product.
            cross = (polygon[j, 0] - polygon[i, 0]) * (y - yi) - (yj - yi) * (x - polygon[i, 0])
            if (cross > 0.0) == (yj > yi):
                inside = not inside
        j = i
    return inside


@kernel
def _orientation(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Twice the signed area of triangle abc, set to 0 within rounding of its terms."""
    left = (bx - ax) * (cy - ay)
    right = (by - ay) * (cx - ax)
    cross = left - right
    if abs(cross) <= 1e-14 * (abs(left) + abs(right)):
        return 0.0
    return cross


@kernel
def segment_blocked(ax: float, ay: float, bx: float, by: float, polygon: Floats) -> bool:
    """True if the open segment from a to b passes through the interior of the polygon.

    Touching a corner or running along an edge does not block.
    """
    touches = False
    n = polygon.shape[0]
    j = n - 1
    for i in range(n):
        px, py, qx, qy = polygon[j, 0], polygon[j, 1], polygon[i, 0], polygon[i, 1]
        j = i
        p_side = _orientation(ax, ay, bx, by, px, py)
        q_side = _orientation(ax, ay, bx, by, qx, qy)
        if p_side * q_side > 0.0:
            continue
        a_side = _orientation(px, py, qx, qy, ax, ay)
        b_side = _orientation(px, py, qx, qy, bx, by)
        if a_side * b_side > 0.0:
            continue
        if p_side * q_side < 0.0 and a_side * b_side < 0.0:
            return True  # crosses an edge from one side to the other
        touches = True
    if touches:
        return _touching_segment_blocked(ax, ay, bx, by, polygon)
    return point_inside(0.5 * (ax + bx), 0.5 * (ay + by), polygon)


@kernel
def _touching_segment_blocked(ax: float, ay: float, bx: float, by: float, polygon: Floats) -> bool:
    """`segment_blocked` for a segment that meets the border only in corners, end points or along edges.

    The segment is cut at every vertex and end point; it is inside somewhere if and only if
    it is inside at the middle of one of the pieces (and not on the border there).
    """
    n = polygon.shape[0]
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    cuts = np.empty(n + 2)
    cuts[0], cuts[1] = 0.0, 1.0
    m = 2
    for i in range(n):
        if length2 > 0.0 and _orientation(ax, ay, bx, by, polygon[i, 0], polygon[i, 1]) == 0.0:
            s = ((polygon[i, 0] - ax) * dx + (polygon[i, 1] - ay) * dy) / length2
            if 0.0 < s < 1.0:
                cuts[m] = s
                m += 1
    cuts[:m].sort()
    for k in range(m - 1):
        s = 0.5 * (cuts[k] + cuts[k + 1])
        x, y = ax + s * dx, ay + s * dy
        if point_inside(x, y, polygon):
            size2 = length2 + x * x + y * y
            if distance_to_boundary(x, y, polygon) > 1e-12 * math.sqrt(size2):
                return True
    return False


@kernel
def distance_to_boundary(x: float, y: float, polygon: Floats) -> float:
    """Distance from (x, y) to the nearest point of the polygon's border (also from inside)."""
    best = np.inf
    j = polygon.shape[0] - 1
    for i in range(polygon.shape[0]):
        px, py = polygon[j, 0], polygon[j, 1]
        ex, ey = polygon[i, 0] - px, polygon[i, 1] - py
        j = i
        length2 = ex * ex + ey * ey
        s = 0.0
        if length2 > 0.0:
            s = min(1.0, max(0.0, ((x - px) * ex + (y - py) * ey) / length2))
        dx, dy = x - px - s * ex, y - py - s * ey
        best = min(best, dx * dx + dy * dy)
    return math.sqrt(best)


@kernel
def inside_polygon(xy: Floats, polygon: Floats) -> Bools:
    """(N,) bool: which of the (N, 2) points lie inside the (K, 2) polygon; borders as in `point_inside`."""
    inside = np.empty(xy.shape[0], dtype=np.bool_)
    for i in range(xy.shape[0]):
        inside[i] = point_inside(xy[i, 0], xy[i, 1], polygon)
    return inside


@kernel
def sight_blocked(origin: Floats, xy: Floats, polygon: Floats) -> Bools:
    """(N,) bool: whether the polygon hides each point from the origin.

    Args:
        origin: (2,) where the sensor stands.
        xy: (N, 2) points looked at.
        polygon: (K, 2) vertices.

    Returns:
        True where the open segment from origin to the point passes through the interior;
        a point inside is blocked, one on the near border is not.
    """
    blocked = np.empty(xy.shape[0], dtype=np.bool_)
    for i in range(xy.shape[0]):
        blocked[i] = segment_blocked(origin[0], origin[1], xy[i, 0], xy[i, 1], polygon)
    return blocked


def pack_polygons(polygons: Sequence[Floats]) -> tuple[Floats, Ints]:
    """All vertices (S, 2) in a row, and starts (P + 1,): polygon p is `vertices[starts[p]:starts[p + 1]]`."""
    starts = np.zeros(len(polygons) + 1, dtype=np.int64)
    np.cumsum([len(p) for p in polygons], out=starts[1:])
    if not polygons:
        return np.empty((0, 2)), starts
    return np.ascontiguousarray(np.concatenate(polygons), dtype=np.float64), starts


def signed_area(polygon: Floats) -> float:
    """Area of a simple (K, 2) polygon, positive when its vertices run counter-clockwise."""
    x, y = (polygon - polygon[0]).T  # near the origin, so that large coordinates do not cancel
    return 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def counter_clockwise(polygon: Floats) -> Floats:
    """The same polygon with counter-clockwise winding."""
    return polygon if signed_area(polygon) >= 0 else polygon[::-1].copy()
