"""Whether a sensor sees points: field of view, range, walls, and the discs of moving objects.

These are functions of arrays for simulated sensors; the particle filters' kernels are in `visibility`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.plane.polygons import sight_blocked


def in_view(h: Floats, d: Floats, fov: float, reach: float) -> Bools:
    """Tell which points are in front of a camera (d > 0), in its field of view and in range, limits included.

    Args:
        h: offset to the left of the optical axis, any shape.
        d: distance along the optical axis, of the same shape.
        fov: full horizontal field of view [rad].
        reach: greatest distance; may be infinite.
    """
    with np.errstate(invalid="ignore"):
        return (d > 0) & (np.abs(np.arctan2(h, d)) <= 0.5 * fov) & (np.hypot(h, d) <= reach)


def behind_walls(origin: Floats, xy: Floats, walls: Sequence[Floats]) -> Bools:
    """(N,) bool: which of the (N, 2) points a polygon hides from the (2,) origin."""
    hidden = np.zeros(len(xy), dtype=np.bool_)
    points = np.ascontiguousarray(xy)
    for wall in walls:
        hidden |= sight_blocked(np.ascontiguousarray(origin[:2]), points, wall)
    return hidden


def behind_objects(origin: Floats, xy: Floats, others: Floats, diameter: float) -> Bools:
    """Tell which points a moving object hides: its centre is inside the rectangle A(x) of [Ercan] Fig. 3.

    The rectangle reaches from the sensor to the point and half a diameter to either side
    of the sight line.

    Args:
        origin: (2,) the sensor.
        xy: (T, 2) points looked at, one a time.
        others: (T, m, 2) centres of the other objects; NaN hides nothing.
        diameter: of the objects.

    Returns:
        (T,) bool.
    """
    ray = xy - origin[:2]
    length = np.hypot(ray[:, 0], ray[:, 1])
    to = others - origin[:2]
    with np.errstate(invalid="ignore", divide="ignore"):
        along = (to[..., 0] * ray[:, None, 0] + to[..., 1] * ray[:, None, 1]) / length[:, None]
        across = (to[..., 1] * ray[:, None, 0] - to[..., 0] * ray[:, None, 1]) / length[:, None]
        inside = (np.abs(across) < 0.5 * diameter) & (along > 0) & (along < length[:, None])
    hidden: Bools = np.logical_or.reduce(inside, axis=1)
    return hidden
