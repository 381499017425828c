"""Light of the rendered room: an even part and two lamps under the ceiling, with shadows of walls and pillars."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane.polygons import distance_to_boundary, point_inside

AMBIENT = 0.55
POWER = (0.6, 0.4)
LAMP: Floats = np.array([(u, v) for u in (-1.0, -0.33, 0.33, 1.0) for v in (-1.0, -0.33, 0.33, 1.0)])
"""Places of a lamp at which it is sampled."""


def lamps(region: Floats, height: float) -> Floats:
    """(2, 5) lamps: x, y, z, power, and the distance at which the light has fallen to half.

    The first hangs where the room is widest, the second far from the first and from the walls.
    """
    low, high = region.min(axis=0), region.max(axis=0)
    steps = np.linspace(0.08, 0.92, 15)
    grid = np.array([low + (high - low) * (u, v) for u in steps for v in steps])
    clear = np.array([distance_to_boundary(x, y, region) if point_inside(x, y, region) else -1.0 for x, y in grid])
    size = float(np.hypot(*(high - low)))
    clear = np.round(clear / size, 9)  # the first of equally good places, whatever the unit of length
    first = grid[np.argmax(clear)]
    away = np.round(np.hypot(*(grid - first).T) / size, 9)
    second = grid[np.argmax(np.where(clear > 0, np.minimum(away, 3.0 * clear), -1.0))]
    reach = 0.6 * size
    return np.array([[*p, 0.97 * height, w, reach] for p, w in zip((first, second), POWER, strict=True)])


@kernel
def light_at(px: float, py: float, pz: float, nx: float, ny: float, nz: float, lights: Floats, ambient: float) -> float:
    """Brightness factor of a surface at p with unit normal n, without shadows."""
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
    """True if a prism stands between the point p and the lamp l above it."""
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
    """False only if the way from (px, py) to (lx, ly) keeps clear of all circles (P, 3) x, y, radius."""
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
    """Share of a lamp, a square panel that is `spread` from middle to side, that is seen from p."""
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
    """Brightness factors (N,) of points (N, 3) with normals (N, 3), with soft shadows of prisms.

    `reach` (P, 3) are circles around the prisms, wide enough for the size of the lamps.
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
    """(H, W, 3) BGR image without its colours: three equal channels."""
    luma = image @ np.array([0.114, 0.587, 0.299])
    return np.repeat(np.rint(luma).astype(np.uint8)[..., None], 3, axis=2)
