"""How simple polygons differ from convex ones: the convex pieces of one, the pockets between it and its convex hull."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

from .polygons import counter_clockwise, signed_area

FLAT = 1e-12
"""Corners that turn by less, as a share of the polygon's area, are straight."""


def convex_pieces(polygon: Floats) -> list[Floats]:
    """Cut a simple polygon into convex counter-clockwise ones: itself if it is convex, else triangles (ear clipping).

    Triangles are cut off at ears: corners whose triangle holds no other corner, nor has one on its border.
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
    """(K,) cross product of the edges before and after each corner; > 0 turns left."""
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    return np.asarray(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])


def _is_ear(corners: Floats, left: list[int], k: int, flat: float, border: float) -> bool:
    """Whether a corner can be cut off; straight ones can.  Others are in its triangle beyond `border`."""
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
    """Polygons between a simple (K, 2) polygon and its convex hull; none for a convex one.

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
    """Rising indices of the corners of a counter-clockwise simple polygon that are corners of its convex hull.

    Andrew's monotone chain; corners on the sides of the hull are left out.
    """
    order = np.lexsort((corners[:, 1], corners[:, 0]))
    lower, upper = _half_hull(corners, order), _half_hull(corners, order[::-1])
    return sorted({*lower[:-1], *upper[:-1]})


def _half_hull(corners: Floats, order: np.ndarray[tuple[int], np.dtype[np.intp]]) -> list[int]:
    hull: list[int] = []
    for i in order.tolist():
        while len(hull) > 1:
            (ax, ay), (bx, by) = corners[hull[-1]] - corners[hull[-2]], corners[i] - corners[hull[-1]]
            if ax * by - ay * bx > 0:
                break
            hull.pop()
        hull.append(i)
    return hull
