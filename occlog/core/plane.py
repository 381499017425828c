"""Polygons, the floor of a room and what stands on it.

Polygons on the ground: inside tests, lines of sight through them, distances.

A polygon is a (K, 2) array of the vertices of a simple closed polygon, in order, the
last joined to the first; it need not be convex and its winding does not matter unless
stated otherwise.  The scalar kernels (`point_inside`, `segment_blocked`,
`distance_to_boundary`) are for use in other kernels; lists of polygons go to kernels
packed by `pack_polygons`.

How simple polygons differ from convex ones: the convex pieces of one, the pockets between it and its convex hull.

Lines that separate segments from convex polygons, and ways around a polygon.

Where a target can stand: inside the room and outside all static occluders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints

from .numerics.jit import kernel


@kernel
def point_inside(x: float, y: float, polygon: Floats) -> bool:
    """Return whether (x, y) is inside a polygon (K, 2) of either orientation (even-odd rule).

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
    """Return the orientation of the triangle with the corners (ax, ay), (bx, by), (cx, cy).

    Returns:
        Twice the signed area, > 0 if counter-clockwise; 0 if it is within the rounding error.
    """
    left = (bx - ax) * (cy - ay)
    right = (by - ay) * (cx - ax)
    cross = left - right
    if abs(cross) <= 1e-14 * (abs(left) + abs(right)):
        return 0.0
    return cross


@kernel
def segment_blocked(ax: float, ay: float, bx: float, by: float, polygon: Floats) -> bool:
    """Return whether the open segment from (ax, ay) to (bx, by) passes through the interior of a polygon (K, 2).

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
    """Return whether a segment that touches a polygon's border passes through the interior of the polygon.

    It touches the border only at corners, at end points or along edges, and crosses no edge. The segment from (ax, ay)
    to (bx, by) is cut at every vertex of the polygon (K, 2); it is inside if and only if the middle of one of the parts
    is inside (and not on the border).
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
    """Return the distance from (x, y), inside or outside, to the nearest point of the border of a polygon (K, 2)."""
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
    """Return the (N,) mask of points (N, 2) inside a polygon (K, 2).

    A point on the border is inside on lower and left edges only.
    """
    inside = np.empty(xy.shape[0], dtype=np.bool_)
    for i in range(xy.shape[0]):
        inside[i] = point_inside(xy[i, 0], xy[i, 1], polygon)
    return inside


@kernel
def line_of_sight_blocked(origin: Floats, xy: Floats, polygon: Floats) -> Bools:
    """Return the (N,) mask of points that a polygon hides from the origin.

    Args:
        origin: (2,) where the sensor stands.
        xy: (N, 2) points.
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
    """Return the corners (V, 2) of P polygons, concatenated, and the first corner (P + 1,) of each, then V.

    Polygon p is `vertices[starts[p]:starts[p + 1]]`.
    """
    starts = np.zeros(len(polygons) + 1, dtype=np.int64)
    np.cumsum([len(p) for p in polygons], out=starts[1:])
    if not polygons:
        return np.empty((0, 2)), starts
    return np.ascontiguousarray(np.concatenate(polygons), dtype=np.float64), starts


def signed_area(polygon: Floats) -> float:
    """Return the area of a simple polygon (K, 2), positive if its corners are in counter-clockwise order."""
    x, y = (polygon - polygon[0]).T  # near the origin, so that large coordinates do not cancel
    return 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


def counter_clockwise(polygon: Floats) -> Floats:
    """Return a simple polygon (K, 2) with its corners in counter-clockwise order: itself, or a reversed copy."""
    return polygon if signed_area(polygon) >= 0 else polygon[::-1].copy()


FLAT = 1e-12
"""Corners that turn by less, as a share of the polygon's area, are straight."""


def convex_pieces(polygon: Floats) -> list[Floats]:
    """Return convex counter-clockwise pieces of a simple polygon (K, 2).

    The polygon itself if it is convex, else triangles (ear clipping); slivers without area are omitted.
    """
    corners = counter_clockwise(polygon)
    flat = FLAT * float(np.ptp(corners, axis=0).prod())
    if np.all(_turns(corners) >= -flat):
        return [corners]
    left, pieces = list(range(len(corners))), []
    while len(left) > 3:
        # Corners on the border of every triangle are left over by rounding only.
        ears = (k for border in (-flat, flat) for k in range(len(left)) if _is_ear(corners, left, k, flat, border))
        ear = next(ears, None)
        if ear is None:  # rounding left nothing but slivers
            break
        triangle = corners[[left[ear - 1], left[ear], left[(ear + 1) % len(left)]]]
        if _turns(triangle)[0] > flat:
            pieces.append(triangle)
        left.pop(ear)
    last = corners[left]
    return [*pieces, last] if len(left) == 3 and _turns(last)[0] > flat else pieces


def _turns(corners: Floats) -> Floats:
    """Return the (K,) cross product of the edges before and after each corner of a polygon (K, 2); > 0 turns left."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    return np.asarray(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])


def _is_ear(corners: Floats, left: list[int], k: int, flat: float, border: float) -> bool:
    """Return whether a corner is an ear of a polygon (can be cut off as a triangle); straight corners are.

    Args:
        corners: (K, 2) counter-clockwise polygon.
        left: indices of the corners that are not cut off.
        k: position of the corner in `left`.
        flat: cross product of two edges up to which a corner is straight.
        border: tolerance for other corners in its triangle, as a cross product.
    """
    own = [left[k - 1], left[k], left[(k + 1) % len(left)]]
    a, b, c = corners[own]
    turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    if turn < -flat:
        return False
    if turn <= flat:
        return True
    others = corners[[i for i in left if i not in own]]
    signs = [
        (q[0] - p[0]) * (others[:, 1] - p[1]) - (q[1] - p[1]) * (others[:, 0] - p[0])
        for p, q in ((a, b), (b, c), (c, a))
    ]
    return not bool(np.any(np.min(signs, axis=0) > border))


def pockets(polygon: Floats) -> list[Floats]:
    """Return the polygons (counter-clockwise) between a simple polygon (K, 2) and its convex hull; none if convex.

    A segment between two points of the polygon leaves the polygon if and only if it
    passes through the interior of a pocket.
    """
    corners = counter_clockwise(polygon)
    hull = _hull_corners(corners)
    found = []
    for start, end in zip(hull, [*hull[1:], hull[0] + len(corners)], strict=True):
        chain = corners[np.arange(start, end + 1) % len(corners)]
        if abs(signed_area(chain)) > 1e-12 * abs(signed_area(corners)):
            found.append(chain[::-1].copy())
    return found


def _hull_corners(corners: Floats) -> list[int]:
    """Return the indices, increasing, of the corners of a simple polygon (K, 2) that are corners of its convex hull.

    Andrew's monotone chain; corners on the sides of the hull are omitted.
    """
    order = np.lexsort((corners[:, 1], corners[:, 0]))
    lower, upper = _half_hull(corners, order), _half_hull(corners, order[::-1])
    return sorted({*lower[:-1], *upper[:-1]})


def _half_hull(corners: Floats, order: np.ndarray[tuple[int], np.dtype[np.intp]]) -> list[int]:
    """Return the indices of the corners of one half of a convex hull (lower or upper), in the given order.

    Args:
        corners: (K, 2) points.
        order: (K,) indices of the points, sorted by x, then y; reversed for the upper half.
    """
    hull: list[int] = []
    for i in order.tolist():
        while len(hull) > 1:
            (ax, ay), (bx, by) = corners[hull[-1]] - corners[hull[-2]], corners[i] - corners[hull[-1]]
            if ax * by - ay * bx > 0:
                break
            hull.pop()
        hull.append(i)
    return hull


class Separation(NamedTuple):
    """The widest gaps between n segments and a convex polygon, with the lines that separate them."""

    gap: Floats  # (n,) distance between two parallel lines that hold them apart; negative: how deep they overlap
    normal: Floats  # (n, 2) of these lines, away from the polygon
    support: Floats  # (n,) largest normal . corner: the line through the polygon


def separate(start: Floats, end: Floats, polygon: Floats) -> Separation:
    """Return the widest gaps between segments and a polygon, by the separating axis theorem.

    Separating lines are parallel to an edge of the polygon or to the segment. Overlapping ones have a negative gap.

    Args:
        start: (n, 2) one end of each segment.
        end: (n, 2) the other one; equal to it for points.
        polygon: (K, 2) convex, counter-clockwise.
    """
    n = len(start)
    out = Separation(np.empty(n), np.empty((n, 2)), np.empty(n))
    _separate(np.ascontiguousarray(start), np.ascontiguousarray(end), np.ascontiguousarray(polygon), out)
    return out


@kernel
def _separate(start: Floats, end: Floats, polygon: Floats, out: Separation) -> None:
    """Write the widest gaps between n segments and a convex counter-clockwise polygon to `out`, in place.

    The kernel of `separate`: `start` (n, 2) and `end` (n, 2) are the ends of the segments, `polygon` is (K, 2).
    """
    K = polygon.shape[0]
    for i in range(start.shape[0]):
        ax, ay, bx, by = start[i, 0], start[i, 1], end[i, 0], end[i, 1]
        best = -math.inf
        for c in range(K + 2):
            if c < K:
                d = (c + 1) % K
                nx, ny = polygon[d, 1] - polygon[c, 1], polygon[c, 0] - polygon[d, 0]
            elif c == K:
                nx, ny = by - ay, ax - bx
            else:
                nx, ny = ay - by, bx - ax
            length = math.hypot(nx, ny)
            if length == 0.0:
                continue
            nx, ny = nx / length, ny / length
            high = -math.inf
            for k in range(K):
                high = max(high, nx * polygon[k, 0] + ny * polygon[k, 1])
            gap = min(nx * ax + ny * ay, nx * bx + ny * by) - high
            if gap > best:
                best = gap
                out.gap[i], out.normal[i, 0], out.normal[i, 1], out.support[i] = gap, nx, ny, high


def route(corners: Floats, a: Floats, b: Floats, away: float, *, ccw: bool) -> Floats:
    """Return the (m, 2) positions of a path from near a around a polygon to near b, at a distance from the polygon.

    It begins and ends at the points of distance `away` that are nearest to a and b, and turns at offset corners.

    Args:
        corners: (K, 2) simple polygon, counter-clockwise.
        a: (2,) start, outside the polygon.
        b: (2,) end, outside the polygon.
        away: distance that is kept, > 0 and small relative to the edges.
        ccw: True for the way around it counter-clockwise, False for clockwise.
    """
    K = len(corners)
    (i, from_a), (j, to_b) = nearest_edge(corners, a, away), nearest_edge(corners, b, away)
    moved = offset(corners, away)
    if ccw:  # along edge i to corner i + 1, ..., to the start of edge j
        count = (j - i) % K
        if count == 0 and _along(corners, i, to_b) < _along(corners, i, from_a):
            count = K
        chain: Ints = (i + 1 + np.arange(count)) % K
    else:
        count = (i - j) % K
        if count == 0 and _along(corners, i, to_b) > _along(corners, i, from_a):
            count = K
        chain = (i - np.arange(count)) % K
    return np.vstack([from_a[None], moved[chain], to_b[None]])


def nearest_edge(corners: Floats, xy: Floats, away: float) -> tuple[int, Floats]:
    """Return the index of a polygon's edge nearest to a position, and the point (2,) outside of it at distance `away`.

    Args:
        corners: (K, 2) counter-clockwise polygon; edge k begins at corner k.
        xy: (2,) position.
        away: distance from the nearest point of the edge.
    """
    ends = np.roll(corners, -1, axis=0)
    edge = ends - corners
    share = np.clip(np.einsum("ki,ki->k", xy - corners, edge) / np.einsum("ki,ki->k", edge, edge), 0.0, 1.0)
    foot = corners + share[:, None] * edge
    k = int(np.argmin(np.hypot(*(xy - foot).T)))
    return k, offset_point(corners, k, foot[k], away)


def offset_point(corners: Floats, k: int, foot: Floats, away: float) -> Floats:
    """Return the point (2,) outside edge k of a polygon, at distance `away` from the point `foot` (2,) of the edge.

    `corners` (K, 2) are counter-clockwise; edge k begins at corner k.
    """
    edge = corners[(k + 1) % len(corners)] - corners[k]
    return np.asarray(foot + away * np.array([edge[1], -edge[0]]) / np.hypot(*edge))


def _along(corners: Floats, k: int, xy: Floats) -> float:
    """Return the distance of `xy` (2,) along edge k from corner k of a polygon (K, 2), times the length of the edge."""
    edge = corners[(k + 1) % len(corners)] - corners[k]
    return float((xy - corners[k]) @ edge)


def offset(corners: Floats, away: float) -> Floats:
    """Return the corners (K, 2) of a counter-clockwise polygon (K, 2) with its edges moved outwards by `away`.

    Very sharp corners move by less.
    """
    edge = np.roll(corners, -1, axis=0) - corners
    normal = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.hypot(*edge.T)[:, None]
    before = np.roll(normal, 1, axis=0)
    both = normal + before
    return np.asarray(corners + 2.0 * away * both / np.maximum(np.sum(both**2, axis=1), 0.1)[:, None])


def spread_along(a: Floats, positions: Floats, b: Floats, steps: int) -> Floats | None:
    """Return positions on the way from a via all of `positions` to b, at nearly equal distances.

    Args:
        a: (2,) start.
        positions: (m, 2) each is one of the positions returned.
        b: (2,) end.
        steps: number of steps from a to b.

    Returns:
        (steps - 1, 2) positions between a and b, which are not included; None if there are fewer steps than legs.
    """
    way = np.vstack([a[None], positions, b[None]])
    leg = np.hypot(*np.diff(way, axis=0).T)
    if steps < len(leg):
        return None
    spare = steps - len(leg)
    total = float(leg.sum())
    wish = spare * (leg / total if total > 0.0 else np.full(len(leg), 1.0 / len(leg)))
    each = np.floor(wish).astype(np.int64)
    rest = np.argsort(each - wish, kind="stable")[: spare - int(each.sum())]
    each[rest] += 1
    each += 1
    share = np.concatenate([(np.arange(n) + 1) / n for n in each])
    first = np.repeat(np.arange(len(leg)), each)
    return np.asarray(way[first] + share[:, None] * (way[first + 1] - way[first]))[:-1]


MAX_SAMPLING_ROUNDS = 200
"""Rounds of random positions tried before the floor is called full."""


class Floor(NamedTuple):
    """A room polygon minus the polygons of walls and obstacles."""

    room: Floats  # (K, 2)
    walls: Floats  # (S, 2) packed polygons (`pack_polygons`)
    starts: Ints  # (P + 1,)


def make_floor(room: Floats, walls: Sequence[Floats]) -> Floor:
    """Return the floor inside `room` (K, 2) and outside the `walls`, each (K_p, 2); walls are packed for kernels."""
    return Floor(np.ascontiguousarray(room, dtype=np.float64), *pack_polygons(walls))


@kernel
def on_floor(xy: Floats, room: Floats, walls: Floats, starts: Ints) -> Bools:
    """Return the (N,) mask of points on the floor: inside the room and outside all walls.

    Args:
        xy: (N, 2) points.
        room: (K, 2) polygon.
        walls: (V, 2) packed polygons.
        starts: (P + 1,) first corner of each.
    """
    free = inside_polygon(xy, room)
    for w in range(starts.shape[0] - 1):
        wall = walls[starts[w] : starts[w + 1]]
        for i in range(xy.shape[0]):
            if free[i] and point_inside(xy[i, 0], xy[i, 1], wall):
                free[i] = False
    return free


def sample_floor(n: int, floor: Floor, rng: np.random.Generator) -> Floats:
    """Return n positions (n, 2) sampled uniformly over the floor, by rejection from the room's bounding box.

    Raises:
        ValueError: so little of the box is free that `MAX_SAMPLING_ROUNDS` rounds do not find n positions.
    """
    low = floor.room.min(axis=0)
    size = floor.room.max(axis=0) - low
    found, count = [np.empty((0, 2))], 0
    for _ in range(MAX_SAMPLING_ROUNDS):
        if count >= n:
            break
        # A quarter more than needed, so that one round is enough in a room with a few pillars.
        positions = low + size * rng.random((n - count + (n - count) // 4 + 4, 2))
        positions = positions[on_floor(positions, floor.room, floor.walls, floor.starts)]
        found.append(positions)
        count += len(positions)
    if count < n:
        raise ValueError(f"only {count} of {n} random positions were free; static occluders fill the room")
    return np.concatenate(found)[:n]


def floor_moments(floor: Floor) -> tuple[Floats, Floats]:
    """Return the mean (2,) and covariance (2, 2) of a uniform distribution over the floor, in closed form.

    The floor is cut into vertical slabs at all corners and at all crossings of edges.  Within a slab no edges cross, so
    that the floor is a set of trapezoids there, the moments of which are those of two triangles each.

    Raises:
        ValueError: no part of the room is free.
    """
    polygons = [floor.room, *(floor.walls[a:b] for a, b in pairwise(floor.starts.tolist()))]
    low = floor.room.min(axis=0)
    size = floor.room.max(axis=0) - low
    # Edges (E, 2, 2) from left to right, in a box of size 1, so that rounding does not depend on the unit
    edges = np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in polygons])
    edges = (edges - low) / size
    edges = np.take_along_axis(edges, np.argsort(edges[..., :1], axis=1, kind="stable"), axis=1)
    cuts = np.unique(np.clip(np.concatenate([edges[..., 0].ravel(), _crossings(edges)]), 0.0, 1.0))
    area, first, second = 0.0, np.zeros(2), np.zeros((2, 2))
    for a, b in pairwise(cuts.tolist()):
        middle = 0.5 * (a + b)
        over = edges[(edges[:, 0, 0] < middle) & (edges[:, 1, 0] > middle)]
        run = over[:, 1] - over[:, 0]
        y = over[:, :1, 1] + (np.array([a, b, middle]) - over[:, :1, 0]) * (run[:, 1:] / run[:, :1])
        y = y[np.argsort(y[:, 2], kind="stable")]
        inner = 0.5 * (y[:-1, 2] + y[1:, 2])
        between = low + size * np.column_stack([np.full(len(inner), middle), inner])
        for k in np.flatnonzero(on_floor(between, floor.room, floor.walls, floor.starts)).tolist():
            corners = np.array([[a, y[k, 0]], [b, y[k, 1]], [b, y[k + 1, 1]], [a, y[k + 1, 0]]])
            for triangle in (corners[[0, 1, 2]], corners[[0, 2, 3]]):
                share, total = abs(signed_area(triangle)), triangle.sum(axis=0)
                area += share
                first += share * total / 3.0
                second += share * (triangle.T @ triangle + np.outer(total, total)) / 12.0
    if not area > FLAT:
        raise ValueError("no position is free; static occluders fill the room")
    mean = first / area
    return low + size * mean, np.outer(size, size) * (second / area - np.outer(mean, mean))


def _crossings(edges: Floats) -> Floats:
    """Return the x coordinates of the crossings of edges (E, 2, 2), given by their ends; each crossing comes twice."""
    run = edges[:, 1] - edges[:, 0]
    base = edges[None, :, 0] - edges[:, None, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = run[:, None, 0] * run[None, :, 1] - run[:, None, 1] * run[None, :, 0]
        along = (base[..., 0] * run[None, :, 1] - base[..., 1] * run[None, :, 0]) / sine
        across = (base[..., 0] * run[:, None, 1] - base[..., 1] * run[:, None, 0]) / sine
        cross = (along > 0.0) & (along < 1.0) & (across > 0.0) & (across < 1.0)
    i, j = np.nonzero(cross)
    return np.asarray(edges[i, 0, 0] + along[i, j] * run[i, 0])


def sample_near(xy: Floats, reach: float, floor: Floor, rng: np.random.Generator) -> Floats:
    """Return positions (N, 2) on the floor, each sampled uniformly within `reach` of one of the points `xy` (N, 2).

    For a point with hardly any floor around it the position is anywhere on the floor.

    Raises:
        ValueError: so little of the room is free that `MAX_SAMPLING_ROUNDS` rounds find too few positions.
    """
    out = np.array(xy, dtype=np.float64)
    left = np.arange(len(out))
    for _ in range(MAX_SAMPLING_ROUNDS):
        if not len(left):
            return out
        r, turn = reach * np.sqrt(rng.random(len(left))), 2.0 * np.pi * rng.random(len(left))
        out[left] = xy[left] + r[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        left = left[~on_floor(out[left], floor.room, floor.walls, floor.starts)]
    out[left] = sample_floor(len(left), floor, rng)
    return out
