"""Kernels that draw bodies and their shadows over the empty room.

Every pixel has four lines of sight; a body covers a pixel by the share of them it catches.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bytes, Floats, Floats32, Ints, Ints32
from occlog.core.numerics.jit import kernel

from .surfaces import hash_point, light_at


class Bodies(NamedTuple):
    """P painted ellipsoids |A (p - c)| = 1 of n bodies, in the order of the bodies, for the rendering kernels.

    Attributes:
        centre: (P, 3) centres c.
        axes: (P, 3, 3) matrices A.
        half: (P, 3) half lengths of the axes.
        body: (P,) index of the body.
        first, second: (P, 3) BGR colours.
        pattern: (P,) number of the pattern of both colours.
        boxes: (P, 4) left, top, right, bottom of the pixels in which an ellipsoid can be, half-open.
    """

    centre: Floats
    axes: Floats
    half: Floats
    body: Ints
    first: Floats
    second: Floats
    pattern: Ints
    boxes: Ints


class Room(NamedTuple):
    """Camera and lights for the rendering kernels.

    Centre of the camera (3,); lamps (L, 5): x, y, z, power, and half-light distance; ambient brightness; length of
    a metre in scene units; near clipping distance.
    """

    origin: Floats  # (3,) centre of the camera
    lights: Floats  # (L, 5)
    ambient: float
    metre: float  # a metre in scene units
    near: float  # nothing nearer to the camera is drawn


@kernel
def trace_into(
    depth: Floats32,
    label: Ints32,
    stamp: Ints,
    extent: Ints,
    rays: Floats32,
    bodies: Bodies,
    room: Room,
    first_stamp: int,
) -> None:
    """Find the nearest ellipsoid on every line of sight, and the extent of every body in the image.

    Args:
        depth: (H, W, 4) depth of the nearest surface so far; lowered where a body is nearer.
        label: (H, W, 4) index of the nearest ellipsoid, set with `depth`.
        stamp: (H, W, 4) number of the last body that a line of sight met, to count each line once; updated.
        extent: (n, 5) for each body: left, top, right, bottom pixel and number of lines of sight that meet it,
            hidden or not; updated.
        rays: (H, W, 4, 3) directions in the world with unit component along the optical axis.
        bodies: ellipsoids to draw.
        room: camera and lights.
        first_stamp: number above all in `stamp`; body k gets `first_stamp` + k.
    """
    origin = room.origin
    for p in range(bodies.centre.shape[0]):
        a, centre, box = bodies.axes[p], bodies.centre[p], bodies.boxes[p]
        ox, oy, oz = origin[0] - centre[0], origin[1] - centre[1], origin[2] - centre[2]
        ux = a[0, 0] * ox + a[0, 1] * oy + a[0, 2] * oz
        uy = a[1, 0] * ox + a[1, 1] * oy + a[1, 2] * oz
        uz = a[2, 0] * ox + a[2, 1] * oy + a[2, 2] * oz
        c = ux * ux + uy * uy + uz * uz - 1.0
        k = bodies.body[p]
        mine = first_stamp + k
        for row in range(box[1], box[3]):
            for col in range(box[0], box[2]):
                for s in range(4):
                    dx, dy, dz = rays[row, col, s, 0], rays[row, col, s, 1], rays[row, col, s, 2]
                    vx = a[0, 0] * dx + a[0, 1] * dy + a[0, 2] * dz
                    vy = a[1, 0] * dx + a[1, 1] * dy + a[1, 2] * dz
                    vz = a[2, 0] * dx + a[2, 1] * dy + a[2, 2] * dz
                    # |u + t v| = 1: t^2 v.v + 2 t u.v + u.u - 1 = 0
                    vv = vx * vx + vy * vy + vz * vz
                    uv = ux * vx + uy * vy + uz * vz
                    root = uv * uv - vv * c
                    if root < 0.0:
                        continue
                    t = (-uv - math.sqrt(root)) / vv
                    if t < room.near:
                        continue
                    if stamp[row, col, s] != mine:
                        stamp[row, col, s] = mine
                        count_into(extent[k], row, col)
                    if t < depth[row, col, s]:
                        depth[row, col, s] = t
                        label[row, col, s] = p


@kernel
def cloth(qx: float, qy: float, qz: float, half: float, pattern: int, metre: float) -> float:
    """Choose one of two colours of a cloth pattern at a point of the unit sphere: 1 for the first, 0 for the second.

    Args:
        qx: x of the point in the ellipsoid's own axes; positive: at the front.
        qy: y of the point.
        qz: z of the point.
        half: half length of the ellipsoid's third axis, in scene units.
        pattern: `PLAIN` (always 1), `HOOPS`, `STRIPES`, `CHECKS` or `SIDES` (front and back).
        metre: length of a metre in scene units.
    """
    first = True
    if pattern == 1 or pattern == 3:
        first = math.floor(qz * half / (0.06 * metre)) % 2 == 0
    if pattern == 2 or pattern == 3:
        first = first == (math.floor(math.atan2(qy, qx) * 2.5) % 2 == 0)
    if pattern == 4:
        first = qx >= 0.0
    return 1.0 if first else 0.0


@kernel
def shade_body_into(colour: Floats, p: int, t: float, ray: Floats32, bodies: Bodies, room: Room) -> None:
    """Compute the colour of an ellipsoid of a body where a line of sight meets it, in place.

    Args:
        colour: (3,) filled: blue, green, red.
        p: index of the ellipsoid.
        t: distance of the point from the camera, in lengths of `ray`.
        ray: (3,) direction of the line of sight.
        bodies: ellipsoids with their clothes.
        room: position of the camera, and lamps.
    """
    rx, ry, rz = ray[0], ray[1], ray[2]
    x, y, z = room.origin[0] + t * rx, room.origin[1] + t * ry, room.origin[2] + t * rz
    a, centre = bodies.axes[p], bodies.centre[p]
    dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
    qx = a[0, 0] * dx + a[0, 1] * dy + a[0, 2] * dz
    qy = a[1, 0] * dx + a[1, 1] * dy + a[1, 2] * dz
    qz = a[2, 0] * dx + a[2, 1] * dy + a[2, 2] * dz
    nx = a[0, 0] * qx + a[1, 0] * qy + a[2, 0] * qz
    ny = a[0, 1] * qx + a[1, 1] * qy + a[2, 1] * qz
    nz = a[0, 2] * qx + a[1, 2] * qy + a[2, 2] * qz
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    light = light_at(x, y, z, nx / length, ny / length, nz / length, room.lights, room.ambient)
    # The side turned to the camera gets some light thrown back by the room.
    facing = -(nx * rx + ny * ry + nz * rz) / (length * math.sqrt(rx * rx + ry * ry + rz * rz))
    light *= 0.8 + 0.3 * facing
    weave = 0.95 + 0.1 * hash_point(math.floor(qx * 8.0) + 40 * math.floor(qy * 8.0), math.floor(qz * 14.0), p)
    share = cloth(qx, qy, qz, bodies.half[p, 2], bodies.pattern[p], room.metre)
    for b in range(3):
        colour[b] = light * weave * (share * bodies.first[p, b] + (1.0 - share) * bodies.second[p, b])


@kernel
def resolve_into(
    image: Floats32,
    depth: Floats32,
    label: Ints32,
    visible: Ints,
    empty_depth: Floats32,
    rays: Floats32,
    extent: Ints,
    bodies: Bodies,
    room: Room,
) -> None:
    """Paint the result of `trace_into`, count the visible lines of sight of each body, and restore the buffers.

    An ellipsoid is shaded once in a pixel, on the first of its lines of sight.

    Args:
        image: (H, W, 3) BGR, painted in place.
        depth: (H, W, 4) depth of the nearest ellipsoid; reset to `empty_depth`.
        label: (H, W, 4) index of that ellipsoid; reset to -1.
        visible: (n, 5) left, top, right, bottom pixel and number of the lines of sight that end on each body; updated.
        empty_depth: (H, W, 4) depth of the room without people.
        rays: (H, W, 4, 3) directions of the lines of sight.
        extent: (n, 5) left, top, right, bottom pixel of each whole body, and its number of lines of sight.
        bodies: all ellipsoids.
        room: lamps and camera.
    """
    colour = np.zeros(3)
    for k in range(extent.shape[0]):
        for row in range(extent[k, 1], extent[k, 3] + 1):
            for col in range(extent[k, 0], extent[k, 2] + 1):
                labels = label[row, col]
                painted, shaded = 0, -1
                total = (0.0, 0.0, 0.0)
                for s in range(4):
                    p = labels[s]
                    if p < 0:
                        continue
                    if p != shaded:
                        shade_body_into(colour, p, depth[row, col, s], rays[row, col, s], bodies, room)
                        shaded = p
                    count_into(visible[bodies.body[p]], row, col)
                    total = (total[0] + colour[0], total[1] + colour[1], total[2] + colour[2])
                    painted += 1
                    labels[s] = -1
                    depth[row, col, s] = empty_depth[row, col, s]
                if painted > 0:
                    for b in range(3):
                        image[row, col, b] = (1.0 - 0.25 * painted) * image[row, col, b] + 0.25 * total[b]


@kernel
def count_into(bounds: Ints, row: int, col: int) -> None:
    """Extend pixel bounds in place by one line of sight at the pixel (row, col).

    `bounds` (5,) are left, top, right, bottom and number of lines of sight.
    """
    bounds[0] = min(bounds[0], col)
    bounds[1] = min(bounds[1], row)
    bounds[2] = max(bounds[2], col)
    bounds[3] = max(bounds[3], row)
    bounds[4] += 1


@kernel
def step_down(x: float) -> float:
    """Return a smooth step: 1 for x < -1, 0 for x > 1, a cubic in between."""
    u = min(1.0, max(0.0, 0.5 * (1.0 - x)))
    return u * u * (3.0 - 2.0 * u)


@kernel
def shadow_into(
    image: Floats32,
    floor: Floats32,
    lamp: Floats32,
    x: float,
    y: float,
    height: float,
    radius: float,
    box: Ints,
    room: Room,
) -> None:
    """Darken the floor where a body, an upright cylinder at (x, y), blocks the light of the lamps, in place.

    Args:
        image: (H, W, 3) BGR, changed.
        floor: (H, W, 3) x, y on the floor, and the share of the pixel that is floor.
        lamp: (H, W, L) light of each lamp there, without shadow.
        x: x of the cylinder's axis.
        y: y of the cylinder's axis.
        height: height of the cylinder.
        radius: radius of the cylinder.
        box: (4,) left, top, right, bottom (half-open) of the pixels to search.
        room: lamps and ambient light.
    """
    lights = room.lights
    for row in range(box[1], box[3]):
        for col in range(box[0], box[2]):
            share = floor[row, col, 2]
            if share == 0.0:
                continue
            qx, qy = x - floor[row, col, 0], y - floor[row, col, 1]
            near2 = (qx * qx + qy * qy) / (radius * radius)
            lost = room.ambient * 0.4 * math.exp(-0.6 * near2) if near2 < 16.0 else 0.0
            full = room.ambient
            for k in range(lights.shape[0]):
                full += lamp[row, col, k]
                ex, ey = lights[k, 0] - (x - qx), lights[k, 1] - (y - qy)
                length2 = max(ex * ex + ey * ey, 1e-12)
                s = min(1.0, max(0.0, (qx * ex + qy * ey) / length2))
                dx, dy = qx - s * ex, qy - s * ey
                soft = radius * (0.25 + 0.8 * s)  # half the width of the penumbra
                edge = 0.8 * radius + soft
                if dx * dx + dy * dy < edge * edge:
                    hidden = step_down((math.hypot(dx, dy) - 0.8 * radius) / soft)
                    hidden *= step_down((s * lights[k, 2] - height) / (0.1 * height))
                    lost += lamp[row, col, k] * hidden
            if lost > 0.0:
                factor = 1.0 - share * lost / full
                for b in range(3):
                    image[row, col, b] *= factor


@kernel
def finish_into(
    out: Bytes, image: Floats32, noise: Floats32, starts: Ints, gain: float, common: float, single: float
) -> None:
    """Convert light to the image of a sensor: `gain` times the light plus noise, rounded and clipped to 0-255.

    Args:
        out: (H, W, 3) filled: BGR image.
        image: (H, W, 3) light in grey levels.
        noise: (N,) standard normal numbers; a row of the image takes two sections of them.
        starts: (H, 2) indices at which the sections of each row start, at most N - 3 W.
        gain: factor of the light.
        common: standard deviation of the noise common to the three colours [grey levels].
        single: standard deviation of the noise of each colour [grey levels].
    """
    g, sd, sd1 = np.float32(gain), np.float32(common), np.float32(single)
    for row in range(image.shape[0]):
        first, second = starts[row, 0], starts[row, 1]
        for col in range(image.shape[1]):
            shared = sd * noise[first + col] + np.float32(0.5)
            for b in range(3):
                value = g * image[row, col, b] + shared + sd1 * noise[second + 3 * col + b]
                out[row, col, b] = np.uint8(min(np.float32(255.0), max(np.float32(0.0), value)))
