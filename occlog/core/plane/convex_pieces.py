"""Simple polygons as unions of convex ones."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

from .polygons import counter_clockwise

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
