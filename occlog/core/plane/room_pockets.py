"""The pockets of a room that is not convex: where its walls come between two places inside it."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

from .polygons import counter_clockwise, signed_area


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
