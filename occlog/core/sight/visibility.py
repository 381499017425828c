"""Which sensors can see which places: field of view, range, static polygons and moving objects in between.

[Ercan] Sec. 4.3 calls a camera *assigned* to a particle that neither field of view, nor range, nor a static
polygon keeps it from seeing: these are kernels for many particles.  Simulated sensors, which moving
objects hide places from too, use `in_view`, `behind_walls` and `behind_objects`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane.polygons import (
    distance_to_boundary,
    inside_polygon,
    pack_polygons,
    segment_blocked,
    sight_blocked,
)

SLACK = 1e-9
"""The quick test of a wall gives up within this of its border, relative; the exact test then decides."""


class Sensors(NamedTuple):
    """S sensors and the polygons that hide things from each of them."""

    xy: Floats  # (S, 2) position
    axis: Floats  # (S, 2) cosine and sine of the yaw
    cos2: Floats  # (S,) square of the cosine of half the field of view, 0 from 180 degrees on; -1: sees all around
    reach2: Floats  # (S,) square of the range
    first: Ints  # (S + 1,) walls of sensor i are first[i] to first[i + 1] - 1
    walls: Floats  # (V, 2) packed polygons
    starts: Ints  # (W + 1,)
    cone: Floats  # (W, 8) of `_cone`: quick tests of whether a wall hides a place


def make_sensors(xy: Floats, yaw: Floats, fov: Floats, reach: Floats, walls: Sequence[Sequence[Floats]]) -> Sensors:
    """Pack sensors for the kernels.

    Args:
        xy: (S, 2) positions.
        yaw: (S,) azimuth of the axis [rad].
        fov: (S,) full field of view [rad]; NaN for a sensor that sees all around and has no axis.
        reach: (S,) greatest distance; may be infinite.
        walls: for each sensor the polygons (K, 2) that hide things from it.
    """
    with np.errstate(invalid="ignore"):
        cosine = np.where(fov < np.pi, np.cos(0.5 * fov), 0.0)
    cos2 = np.where(np.isnan(fov), -1.0, cosine**2)
    first = np.zeros(len(xy) + 1, dtype=np.int64)
    np.cumsum([len(w) for w in walls], out=first[1:])
    cones = [_cone(xy[i], wall) for i in range(len(xy)) for wall in walls[i]]
    return Sensors(
        np.ascontiguousarray(xy, dtype=np.float64),
        np.column_stack([np.cos(yaw), np.sin(yaw)]),
        cos2,
        np.asarray(reach, dtype=np.float64) ** 2,
        first,
        *pack_polygons([p for own in walls for p in own]),
        np.array(cones, dtype=np.float64).reshape(-1, 8),
    )


def _cone(origin: Floats, wall: Floats) -> Floats:
    """Prepare the quick tests of a wall.

    Returns:
        (8,): right ray and left ray from the origin around the wall (unit vectors; 0 where the
        wall may be in any direction), square of its distance, and unit normal and offset of a
        line, relative to the origin: within the rays and beyond the line everything is hidden.
    """
    wall = np.ascontiguousarray(wall, dtype=np.float64)
    rays = wall - origin
    row = np.zeros(8)
    row[7] = np.inf
    near = distance_to_boundary(origin[0], origin[1], wall)
    if near == 0.0 or inside_polygon(np.ascontiguousarray(origin[None, :2]), wall)[0]:
        return row
    row[4] = near**2
    # Angles along the border; outside a polygon the turns add up to 0.
    turns = np.angle(np.exp(1j * np.diff(np.arctan2(rays[:, 1], rays[:, 0]))))
    angle = np.concatenate([[0.0], np.cumsum(turns)])
    right, left = rays[np.argmin(angle)], rays[np.argmax(angle)]
    if angle.max() - angle.min() > 0.99 * np.pi:
        return row
    row[:2], row[2:4] = right / np.hypot(*right), left / np.hypot(*left)
    chord = left - right
    normal = np.array([chord[1], -chord[0]]) / np.hypot(*chord)
    # The chord between the outermost corners is inside a convex wall; behind it nothing is seen.
    # Of any other wall, nothing is seen behind the last of its corners.
    row[5:7], row[7] = normal, normal @ right if _convex(wall) else np.max(rays @ normal)
    return row


def _convex(polygon: Floats) -> bool:
    edges = np.roll(polygon, -1, axis=0) - polygon
    following = np.roll(edges, -1, axis=0)
    cross = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    return bool(np.all(cross >= 0.0) or np.all(cross <= 0.0))


@kernel
def seen_from(xy: Floats, i: int, sensors: Sensors) -> Bools:
    """(L,) bool: which of the (L, 2) places sensor i is assigned to: in view, in range and not behind a wall.

    A place behind a sensor with an axis (d <= 0) is never seen, so h/d may be formed
    where this is true.
    """
    x0, y0, reach2, cos2 = sensors.xy[i, 0], sensors.xy[i, 1], sensors.reach2[i], sensors.cos2[i]
    c, s = sensors.axis[i, 0], sensors.axis[i, 1]
    seen = np.empty(xy.shape[0], dtype=np.bool_)
    around = cos2 < 0.0
    for p in range(xy.shape[0]):
        dx, dy = xy[p, 0] - x0, xy[p, 1] - y0
        r2 = dx * dx + dy * dy
        d = c * dx + s * dy
        # `&` and `|` evaluate both sides, so that the loop has no branches.
        seen[p] = (r2 <= reach2) & (around | ((d > 0.0) & (d * d >= cos2 * r2)))
    for w in range(sensors.first[i], sensors.first[i + 1]):
        _hide_behind(seen, xy, x0, y0, sensors.walls[sensors.starts[w] : sensors.starts[w + 1]], sensors.cone[w])
    return seen


@kernel
def _hide_behind(seen: Bools, xy: Floats, x0: float, y0: float, wall: Floats, cone: Floats) -> None:
    """Set `seen` to false, in place, for places that the wall hides from (x0, y0).

    Most places are clearly nearer than the wall, clearly beside it or clearly behind it;
    the exact test is only for the others.
    """
    rx, ry, lx, ly, near2 = cone[0], cone[1], cone[2], cone[3], cone[4] * (1.0 - SLACK)
    nx, ny, offset = cone[5], cone[6], cone[7]
    for p in range(xy.shape[0]):
        if not seen[p]:
            continue
        dx, dy = xy[p, 0] - x0, xy[p, 1] - y0
        r2 = dx * dx + dy * dy
        if r2 < near2:
            continue
        # Beside the wall: outside the rays around it
        slack = SLACK * (abs(dx) + abs(dy))
        from_right, from_left = rx * dy - ry * dx, ly * dx - lx * dy
        if from_right < -slack or from_left < -slack:
            continue
        # Behind the wall, clearly or by the exact test
        behind = from_right > slack and from_left > slack and nx * dx + ny * dy > offset + slack
        if behind or segment_blocked(x0, y0, xy[p, 0], xy[p, 1], wall):
            seen[p] = False


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
