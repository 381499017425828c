"""Kernels that render balls over a background: visibility first, then colours.

Every pixel has four lines of sight. Positions are in the camera's frame: x to the right, y down, z forward.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bytes, Floats, Floats32, Ints, Ints32
from occlog.core.numerics.jit import array_kernel, kernel

AMBIENT = 0.62
"""Light on a ball that is turned away from the lamp; 1 where it faces it."""


class RenderView(NamedTuple):
    """Camera and light for the rendering kernels.

    Focal length and principal point [px], and the unit vector (3,) to the lamp in the camera's frame.
    """

    focal: float  # [px]
    cx: float
    cy: float
    light: Floats  # (3,) unit vector to the lamp


class Skin(NamedTuple):
    """Surface panels of a football, a spherical truncated icosahedron, with their colours.

    `faces` (F, 3) are normals over their distances from the centre, pentagons first; `seam` is half the width of a
    seam, as a difference of projections on two faces; `colours` (3, 3) are BGR of pentagons, hexagons and seams.
    """

    faces: Floats  # (F, 3) normals, over their distances from the centre, of those near +x, +y, +z; pentagons first
    pentagons: int
    seam: float  # half the width of a seam, in units of the faces
    colours: Floats  # (3, 3) BGR of pentagons, hexagons and seams


@kernel
def trace_balls_into(
    depth: Floats, label: Ints32, covered: Ints, centres: Floats, radius: float, view: RenderView
) -> None:
    """Find the nearest ball on each of four lines of sight per pixel.

    Args:
        depth: (H, W, 4) distance along the optical axis to the nearest ball so far, initially inf; lowered in place.
        label: (H, W, 4) number of that ball, set with `depth`.
        covered: (n, 5) filled for each ball: left, top, right, bottom (half-open) of the part of the image in which
            it can be, and the number of lines of sight that meet it, hidden or not.
        centres: (n, 3) centres in the camera's frame, at a distance of more than `radius`.
        radius: radius of all balls, in the unit of the centres.
        view: camera.
    """
    height, width = depth.shape[:2]
    pixel = 1.0 / view.focal
    for k in range(centres.shape[0]):
        px, py, pz = centres[k, 0], centres[k, 1], centres[k, 2]
        left, right = _limits(px, pz, radius, view.focal, view.cx, width)
        top, bottom = _limits(py, pz, radius, view.focal, view.cy, height)
        count = 0
        for row in range(top, bottom):
            for col in range(left, right):
                for s in range(4):
                    x = pixel * (col + 0.5 * (s & 1) - 0.25 - view.cx)
                    y = pixel * (row + 0.5 * (s >> 1) - 0.25 - view.cy)
                    # The point of the line nearest to the centre: exact for cameras far away, too
                    short = 1.0 / (x * x + y * y + 1.0)
                    along = short * (px * x + py * y + pz)
                    dx, dy, dz = px - along * x, py - along * y, pz - along
                    rest = radius * radius - (dx * dx + dy * dy + dz * dz)
                    if rest < 0.0 or along <= 0.0:
                        continue
                    count += 1
                    t = along - math.sqrt(short * rest)
                    if t < depth[row, col, s]:
                        depth[row, col, s] = t
                        label[row, col, s] = k
        covered[k, 0], covered[k, 1], covered[k, 2], covered[k, 3] = left, top, right, bottom
        covered[k, 4] = count


@kernel
def _limits(p: float, z: float, radius: float, focal: float, middle: float, size: int) -> tuple[int, int]:
    """First pixel, and pixel after the last, that a ball can touch along one image axis, clipped to 0 to `size`.

    Args:
        p: centre of the ball on this axis, in the camera's frame.
        z: its depth along the optical axis.
        radius: radius of the ball, in the unit of `p` and `z`.
        focal: focal length [px].
        middle: principal point on this axis [px].
        size: number of pixels along the axis.
    """
    distance = math.hypot(p, z)
    centre, half = math.atan2(p, z), math.asin(min(radius / max(distance, 1e-300), 1.0))
    if centre - half <= -0.5 * math.pi or centre + half >= 0.5 * math.pi:
        return 0, size
    first = middle + focal * math.tan(centre - half)
    last = middle + focal * math.tan(centre + half)
    first, last = min(max(first, -2.0), size + 2.0), min(max(last, -2.0), size + 2.0)
    return max(math.floor(first), 0), min(math.ceil(last) + 1, size)


@kernel
def paint_balls_into(
    image: Floats32,
    depth: Floats,
    label: Ints32,
    visible: Ints,
    covered: Ints,
    background: Floats32,
    centres: Floats,
    turns: Floats,
    radius: float,
    view: RenderView,
    skin: Skin,
) -> None:
    """Paint the result of `trace_balls_into`, and count the lines of sight that end on each ball.

    Args:
        image: (H, W, 3) BGR, a copy of the background, changed in place.
        depth: (H, W, 4) distances along the optical axis to the nearest ball, inf without one.
        label: (H, W, 4) number of the nearest ball.
        visible: (n,) filled with the counts.
        covered: (n, 5) part of the image in which each ball can be, from `trace_balls_into`.
        background: (H, W, 3) BGR.
        centres: (n, 3) centres in the camera's frame.
        turns: (n, 3, 3) rotations from the ball's frame to the camera's.
        radius: radius of all balls.
        view: camera and lamp.
        skin: pattern of all balls.
    """
    colour = np.zeros(3)
    pixel = 1.0 / view.focal
    for k in range(centres.shape[0]):
        total = 0
        for row in range(covered[k, 1], covered[k, 3]):
            for col in range(covered[k, 0], covered[k, 2]):
                count, first = 0, -1
                for s in range(4):
                    if depth[row, col, s] < np.inf and label[row, col, s] == k:
                        count += 1
                        first = s if first < 0 else first
                if count == 0:
                    continue
                total += count
                t = depth[row, col, first]
                x = t * pixel * (col + 0.5 * (first & 1) - 0.25 - view.cx) - centres[k, 0]
                y = t * pixel * (row + 0.5 * (first >> 1) - 0.25 - view.cy) - centres[k, 1]
                shade_ball_into(colour, x / radius, y / radius, (t - centres[k, 2]) / radius, turns[k], view, skin)
                for b in range(3):
                    image[row, col, b] += 0.25 * count * (colour[b] - background[row, col, b])
        visible[k] = total


@kernel
def shade_ball_into(colour: Floats, x: float, y: float, z: float, turn: Floats, view: RenderView, skin: Skin) -> None:
    """Compute the colour of a ball at one point of its surface, in place.

    Args:
        colour: (3,) filled: blue, green, red.
        x: x of the unit normal of the surface, in the camera's frame.
        y: y of the normal.
        z: z of the normal.
        turn: (3, 3) rotation from the ball's frame to the camera's.
        view: has the direction of the light.
        skin: pattern and colours of the ball.
    """
    qx = turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z
    qy = turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z
    qz = turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z
    # The panels are the same on both sides of the planes x = 0, y = 0 and z = 0.
    qx, qy, qz = abs(qx), abs(qy), abs(qz)
    best, second, face = -1.0, -1.0, 0
    for i in range(skin.faces.shape[0]):
        reach = skin.faces[i, 0] * qx + skin.faces[i, 1] * qy + skin.faces[i, 2] * qz
        if reach > best:
            second, best, face = best, reach, i
        elif reach > second:
            second = reach
    kind = 0 if face < skin.pentagons else 1
    if best - second < skin.seam:
        kind = 2
    light = AMBIENT + (1.0 - AMBIENT) * max(0.0, x * view.light[0] + y * view.light[1] + z * view.light[2])
    for b in range(3):
        colour[b] = light * skin.colours[kind, b]


@kernel
def clear_balls(depth: Floats, covered: Ints) -> None:
    """Reset the depth buffer (H, W, 4) to inf, in place, in the parts of the image where balls can be.

    `covered` (n, 5) has these parts: left, top, right, bottom (half-open), and a count that is not used.
    """
    for k in range(covered.shape[0]):
        for row in range(covered[k, 1], covered[k, 3]):
            for col in range(covered[k, 0], covered[k, 2]):
                for s in range(4):
                    depth[row, col, s] = np.inf


@array_kernel
def deliver_into(out: Bytes, image: Floats32, noise: Floats32, starts: Ints) -> None:
    """Convert light plus noise to the image of a sensor, rounded and clipped to 0-255.

    Args:
        out: (H, 3 W) filled: grey levels of the image's rows, BGR.
        image: (H, 3 W) light in grey levels.
        noise: (N,) values added to colours in sequence, plus 0.5 for rounding; a row takes a section of it.
        starts: (H,) index at which the section of each row starts, at most N - 3 W.
    """
    zero, full = np.float32(0.0), np.float32(255.0)
    for row in range(image.shape[0]):
        first = np.uint64(starts[row])
        for col in range(np.uint64(image.shape[1])):
            value = image[row, col] + noise[first + col]
            value = value if value > zero else zero
            out[row, col] = np.uint8(value if value < full else full)
