"""Procedural surfaces of the rendered room: floor, walls, ceiling, pillars.

Colours are BGR, 0 to 255, before lighting; positions are in metres.  `contrast` scales
everything that makes a surface other than plain: 1 is usual, 0 leaves plain paint.

Light of the rendered room: an even part and two lamps under the ceiling, with shadows of walls and pillars.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane import distance_to_boundary, point_inside

WALL_PAINT = np.array([166.0, 178.0, 184.0])
WALL_BASE = np.array([112.0, 126.0, 138.0])
FLOOR_COLOUR = np.array([121.0, 134.0, 145.0])
PILLAR = np.array([142.0, 146.0, 150.0])
CEILING_COLOUR = np.array([225.0, 228.0, 230.0])
POSTERS = np.array(
    [[120.0, 90.0, 70.0], [80.0, 115.0, 95.0], [90.0, 90.0, 130.0], [60.0, 60.0, 62.0], [190.0, 195.0, 200.0]]
)


@kernel
def hash_point(i: int, j: int, seed: int) -> float:
    """Pseudo-random number in [0, 1) for an integer point (i, j) and a seed."""
    h = (i * 0x27D4EB2F + j * 0x165667B1 + seed * 0x1E3779B1) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    h = ((h ^ (h >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    return (h ^ (h >> 15)) / 4294967296.0


@kernel
def hashed(i: Ints, j: Ints, seed: int) -> Floats:
    """Return (N,) pseudo-random numbers in [0, 1) of integer points (i, j), each (N,): `hash_point` for arrays."""
    out = np.empty(i.shape[0])
    for n in range(i.shape[0]):
        out[n] = hash_point(i[n], j[n], seed)
    return out


@kernel
def smooth_noise(x: Floats, y: Floats, cell: float, seed: int) -> Floats:
    """Return (N,) smooth noise in [-1, 1] at the points (x, y), each (N,), with the correlation length `cell`.

    Value noise on a grid of hashed numbers; `seed` selects it.
    """
    out = np.empty(x.shape[0])
    for n in range(x.shape[0]):
        i, j = math.floor(x[n] / cell), math.floor(y[n] / cell)
        u, v = x[n] / cell - i, y[n] / cell - j
        u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
        low = (1 - u) * hash_point(i, j, seed) + u * hash_point(i + 1, j, seed)
        high = (1 - u) * hash_point(i, j + 1, seed) + u * hash_point(i + 1, j + 1, seed)
        out[n] = 2.0 * ((1 - v) * low + v * high) - 1.0
    return out


def grain(x: Floats, y: Floats, seed: int, contrast: float) -> Floats:
    """Return (N, 1) brightness factors around 1 at the points (x, y) [m], each (N,), with a texture of 4 cm to 50 cm.

    `contrast` scales the deviation from 1.
    """
    coarse, fine = smooth_noise(x, y, 0.5, seed), smooth_noise(x, y, 0.04, seed + 1)
    grains = 0.05 * coarse + 0.05 * smooth_noise(x, y, 0.13, seed + 2) + 0.03 * fine
    return (1.0 + contrast * grains)[:, None]


def floor_colour(x: Floats, y: Floats, contrast: float) -> Floats:
    """(N, 3) BGR colours of the floor at (x, y) [m], each (N,): 60 cm tiles in two shades with dark joints.

    `contrast` is a factor of the texture; 0: plain.
    """
    i, j = np.floor(x / 0.6).astype(np.int64), np.floor(y / 0.6).astype(np.int64)
    u, v = x / 0.6 - i, y / 0.6 - j
    dark = ((i + j) % 2 == 0) - 0.5
    shade = 1.0 + contrast * (0.14 * dark + 0.14 * (hashed(i, j, 5) - 0.5))
    joint = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)) < 0.012
    shade *= np.where(joint, 1.0 - 0.4 * min(contrast, 1.0), 1.0)
    return np.asarray(FLOOR_COLOUR * shade[:, None] * grain(x, y, 11, contrast))


def wall_colour(along: Floats, z: Floats, number: int, height: float, contrast: float) -> Floats:
    """(N, 3) BGR colours of a painted wall with a darker base, a ledge and pictures.

    Args:
        along: (N,) positions along the wall [m].
        z: (N,) heights [m].
        number: number of the wall, by which walls differ.
        height: height of the wall [m].
        contrast: factor of the texture; 0: plain.
    """
    base = (z < 0.42 * height)[:, None]
    colour = np.where(base, WALL_BASE, WALL_PAINT) * grain(along, z, 101 + number, contrast)
    ledge = (np.abs(z - 0.42 * height) < 0.012 * height) | (z < 0.04 * height)
    colour = np.where(ledge[:, None], np.array([70.0, 84.0, 98.0]), colour)
    cell = np.floor(along / 1.9).astype(np.int64)
    left = along - 1.9 * cell
    kind = hashed(cell, np.full_like(cell, number), 7)
    width, low = 0.5 + 0.6 * kind, height * (0.52 + 0.06 * hashed(cell, np.full_like(cell, number), 8))
    inside = (np.abs(left - 0.95) < 0.5 * width) & (z > low) & (z < low + 0.28 * height) & (kind > 0.3)
    frame = inside & ((np.abs(left - 0.95) > 0.5 * width - 0.03) | (z < low + 0.03) | (z > low + 0.28 * height - 0.03))
    picture = POSTERS[(hashed(cell, np.full_like(cell, number), 9) * len(POSTERS)).astype(np.int64)]
    picture = picture * (1.0 + 0.35 * contrast * smooth_noise(along, z, 0.12, 200 + number))[:, None]
    colour = np.where(inside[:, None], picture, colour)
    return np.where(frame[:, None], np.array([45.0, 48.0, 52.0]), colour)


def pillar_colour(along: Floats, z: Floats, number: int, contrast: float) -> Floats:
    """(N, 3) BGR colours of a pillar: bricks of 24 x 8 cm, every second row shifted by half a brick.

    Args:
        along: (N,) positions along the face [m].
        z: (N,) heights [m].
        number: number of the face, by which faces differ.
        contrast: factor of the texture; 0: plain.
    """
    row = np.floor(z / 0.08).astype(np.int64)
    shifted = along / 0.24 + 0.5 * (row % 2)
    brick = np.floor(shifted).astype(np.int64)
    u, v = shifted - brick, z / 0.08 - row
    shade = 1.0 + 0.3 * contrast * (hashed(brick, row, 300 + number) - 0.5)
    joint = (np.minimum(u, 1 - u) < 0.035) | (np.minimum(v, 1 - v) < 0.08)
    shade = np.where(joint, 1.0 - 0.28 * min(contrast, 1.0), shade)
    return PILLAR * shade[:, None] * grain(along, z, 301 + number, contrast)


def ceiling_colour(x: Floats, y: Floats, contrast: float) -> Floats:
    """(N, 3) BGR colours of the ceiling at (x, y) [m], each (N,): pale panels of 1.2 m.

    `contrast` is a factor of the texture; 0: plain.
    """
    u, v = np.mod(x, 1.2) / 1.2, np.mod(y, 1.2) / 1.2
    joint = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)) < 0.01
    shade = np.where(joint, 1.0 - 0.2 * min(contrast, 1.0), 1.0) * (1 + 0.02 * contrast * smooth_noise(x, y, 0.3, 400))
    return CEILING_COLOUR * shade[:, None]


AMBIENT = 0.55
POWER = (0.6, 0.4)
LAMP: Floats = np.array([(u, v) for u in (-1.0, -0.33, 0.33, 1.0) for v in (-1.0, -0.33, 0.33, 1.0)])
"""Positions of a lamp at which it is sampled."""


def lamps(region: Floats, height: float) -> Floats:
    """(2, 5) lamps of a room with the outline `region` (n, 2) and the ceiling at `height`, in scene units.

    Columns: x, y, z, power, and the distance at which the light has fallen to half (half-light distance). The first
    hangs where the room is widest, the second far from the first and from the walls.
    """
    low, high = region.min(axis=0), region.max(axis=0)
    steps = np.linspace(0.08, 0.92, 15)
    grid = np.array([low + (high - low) * (u, v) for u in steps for v in steps])
    clear = np.array([distance_to_boundary(x, y, region) if point_inside(x, y, region) else -1.0 for x, y in grid])
    size = float(np.hypot(*(high - low)))
    clear = np.round(clear / size, 9)  # the first of equally good positions, whatever the unit of length
    first = grid[np.argmax(clear)]
    away = np.round(np.hypot(*(grid - first).T) / size, 9)
    second = grid[np.argmax(np.where(clear > 0, np.minimum(away, 3.0 * clear), -1.0))]
    reach = 0.6 * size
    return np.array([[*p, 0.97 * height, w, reach] for p, w in zip((first, second), POWER, strict=True)])


@kernel
def light_at(px: float, py: float, pz: float, nx: float, ny: float, nz: float, lights: Floats, ambient: float) -> float:
    """Brightness of a surface, by all lamps on its front and the ambient light, as if there were no shadows.

    Args:
        px: x of the point on the surface.
        py: y of the point.
        pz: z of the point.
        nx: x of the unit normal.
        ny: y of the unit normal.
        nz: z of the unit normal.
        lights: (L, 5) x, y, z, power, and the distance at which the light has fallen to half.
        ambient: brightness without lamps.
    """
    total = ambient
    for k in range(lights.shape[0]):
        lx, ly, lz = lights[k, 0] - px, lights[k, 1] - py, lights[k, 2] - pz
        r2 = lx * lx + ly * ly + lz * lz
        across = nx * lx + ny * ly + nz * lz
        if across > 0.0:
            total += lights[k, 3] * across / math.sqrt(r2) / (1.0 + r2 / (lights[k, 4] * lights[k, 4]))
    return total


@kernel
def in_shadow(
    px: float, py: float, pz: float, lx: float, ly: float, lz: float, walls: Floats, starts: Ints, heights: Floats
) -> bool:
    """Whether a wall or pillar (vertical prism) lies between a point and a lamp above it.

    Args:
        px: x of the point.
        py: y of the point.
        pz: z of the point.
        lx: x of the lamp.
        ly: y of the lamp.
        lz: z of the lamp.
        walls: (V, 2) corners of the outlines, one after the other.
        starts: (P + 1,) index of the first corner of each of P prisms; V at the end.
        heights: (P,) of the prisms, which stand on the floor.
    """
    ex, ey = lx - px, ly - py
    for w in range(starts.shape[0] - 1):
        first, last = starts[w], starts[w + 1]
        j = last - 1
        for i in range(first, last):
            ax, ay = walls[j, 0], walls[j, 1]
            fx, fy = walls[i, 0] - ax, walls[i, 1] - ay
            j = i
            cross = ex * fy - ey * fx
            if cross == 0.0:
                continue
            s = ((ax - px) * fy - (ay - py) * fx) / cross  # along the way to the lamp
            u = ((ax - px) * ey - (ay - py) * ex) / cross  # along the edge
            if 1e-6 < s < 1.0 and 0.0 <= u <= 1.0 and pz + s * (lz - pz) < heights[w]:
                return True
    return False


@kernel
def may_be_shadowed(px: float, py: float, lx: float, ly: float, reach: Floats) -> bool:
    """Whether the way from a point to a lamp, seen from above, enters a circle around any prism.

    A fast test before `in_shadow`.

    Args:
        px: x of the point.
        py: y of the point.
        lx: x of the lamp.
        ly: y of the lamp.
        reach: (P, 3) circles: x, y, radius.
    """
    ex, ey = lx - px, ly - py
    length2 = max(ex * ex + ey * ey, 1e-12)
    for w in range(reach.shape[0]):
        qx, qy = reach[w, 0] - px, reach[w, 1] - py
        s = min(1.0, max(0.0, (qx * ex + qy * ey) / length2))
        dx, dy = qx - s * ex, qy - s * ey
        if dx * dx + dy * dy < reach[w, 2] * reach[w, 2]:
            return True
    return False


@kernel
def lit_share(
    px: float, py: float, pz: float, lamp: Floats, spread: float, walls: Floats, starts: Ints, heights: Floats
) -> float:
    """Visible share, 0 to 1, of a square lamp as seen from a point.

    Args:
        px: x of the point.
        py: y of the point.
        pz: z of the point.
        lamp: (5,) x, y, z of the lamp's centre; the rest is not used.
        spread: half width of the lamp.
        walls: (V, 2) outlines of P prisms on the floor, one after the other.
        starts: (P + 1,) index of the first corner of each, then V.
        heights: (P,) heights of the prisms.
    """
    lit = 0
    for corner in range(LAMP.shape[0]):
        lx = lamp[0] + spread * LAMP[corner, 0]
        ly = lamp[1] + spread * LAMP[corner, 1]
        if not in_shadow(px, py, pz, lx, ly, lamp[2], walls, starts, heights):
            lit += 1
    return float(lit / LAMP.shape[0])


@kernel
def shade_into(
    out: Floats,
    points: Floats,
    normals: Floats,
    lights: Floats,
    spread: float,
    walls: Floats,
    starts: Ints,
    heights: Floats,
    reach: Floats,
    ambient: float,
) -> None:
    """Write the brightness (N,) of surface points to `out`, with soft shadows of P prisms.

    Args:
        out: (N,) filled.
        points: (N, 3) points.
        normals: (N, 3) unit normals of the surfaces.
        lights: (L, 5) lamps: x, y, z, power, and half-light distance.
        spread: half width of the lamps.
        walls: (V, 2) outlines of the prisms, one after the other.
        starts: (P + 1,) index of the first corner of each, then V.
        heights: (P,) heights of the prisms.
        reach: (P, 3) circles x, y, radius around the prisms, wide enough for the size of the lamps.
        ambient: brightness without any lamp.
    """
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        total = ambient
        for k in range(lights.shape[0]):
            light = light_at(px, py, pz, nx, ny, nz, lights[k : k + 1], 0.0)
            if light > 0.0 and may_be_shadowed(px, py, lights[k, 0], lights[k, 1], reach):
                light *= lit_share(px, py, pz, lights[k], spread, walls, starts, heights)
            total += light
        out[i] = total


def grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert a BGR image (H, W, 3) to grey levels in three equal channels."""
    luma = image @ np.array([0.114, 0.587, 0.299])
    return np.repeat(np.rint(luma).astype(np.uint8)[..., None], 3, axis=2)
