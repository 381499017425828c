"""Procedural surfaces of the rendered room: floor, walls, ceiling, pillars.

Colours are BGR, 0 to 255, before lighting; places are in metres.  `contrast` scales
everything that makes a surface other than plain: 1 is usual, 0 leaves plain paint.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

WALL_PAINT = np.array([166.0, 178.0, 184.0])
WALL_BASE = np.array([112.0, 126.0, 138.0])
FLOOR = np.array([121.0, 134.0, 145.0])
PILLAR = np.array([142.0, 146.0, 150.0])
CEILING = np.array([225.0, 228.0, 230.0])
POSTERS = np.array(
    [[120.0, 90.0, 70.0], [80.0, 115.0, 95.0], [90.0, 90.0, 130.0], [60.0, 60.0, 62.0], [190.0, 195.0, 200.0]]
)


@kernel
def hash_point(i: int, j: int, seed: int) -> float:
    """A pseudo-random number in [0, 1) that belongs to the integer point (i, j)."""
    h = (i * 0x27D4EB2F + j * 0x165667B1 + seed * 0x1E3779B1) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 0x2C1B3C6D) & 0xFFFFFFFF
    h = ((h ^ (h >> 12)) * 0x297A2D39) & 0xFFFFFFFF
    return (h ^ (h >> 15)) / 4294967296.0


@kernel
def hashed(i: Ints, j: Ints, seed: int) -> Floats:
    """(N,) of `hash_point`."""
    out = np.empty(i.shape[0])
    for n in range(i.shape[0]):
        out[n] = hash_point(i[n], j[n], seed)
    return out


@kernel
def smooth_noise(x: Floats, y: Floats, cell: float, seed: int) -> Floats:
    """(N,) smooth noise in [-1, 1] whose grains are `cell` wide: hashed grid values, blended."""
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
    """(N, 1) brightness factor about 1 with grains from 4 cm to half a metre; `contrast` 1 is usual, 0 none."""
    coarse, fine = smooth_noise(x, y, 0.5, seed), smooth_noise(x, y, 0.04, seed + 1)
    grains = 0.05 * coarse + 0.05 * smooth_noise(x, y, 0.13, seed + 2) + 0.03 * fine
    return (1.0 + contrast * grains)[:, None]


def floor_colour(x: Floats, y: Floats, contrast: float) -> Floats:
    """(N, 3) square tiles of 60 cm in two shades with dark joints."""
    i, j = np.floor(x / 0.6).astype(np.int64), np.floor(y / 0.6).astype(np.int64)
    u, v = x / 0.6 - i, y / 0.6 - j
    dark = ((i + j) % 2 == 0) - 0.5
    shade = 1.0 + contrast * (0.14 * dark + 0.14 * (hashed(i, j, 5) - 0.5))
    joint = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)) < 0.012
    shade *= np.where(joint, 1.0 - 0.4 * min(contrast, 1.0), 1.0)
    return np.asarray(FLOOR * shade[:, None] * grain(x, y, 11, contrast))


def wall_colour(along: Floats, z: Floats, number: int, height: float, contrast: float) -> Floats:
    """(N, 3) painted wall with a darker base, a ledge, and pictures; `along` runs along the wall."""
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
    """(N, 3) bricks of 24 x 8 cm, every second row shifted by half a brick."""
    row = np.floor(z / 0.08).astype(np.int64)
    shifted = along / 0.24 + 0.5 * (row % 2)
    brick = np.floor(shifted).astype(np.int64)
    u, v = shifted - brick, z / 0.08 - row
    shade = 1.0 + 0.3 * contrast * (hashed(brick, row, 300 + number) - 0.5)
    joint = (np.minimum(u, 1 - u) < 0.035) | (np.minimum(v, 1 - v) < 0.08)
    shade = np.where(joint, 1.0 - 0.28 * min(contrast, 1.0), shade)
    return PILLAR * shade[:, None] * grain(along, z, 301 + number, contrast)


def ceiling_colour(x: Floats, y: Floats, contrast: float) -> Floats:
    """(N, 3) pale panels of 1.2 m."""
    u, v = np.mod(x, 1.2) / 1.2, np.mod(y, 1.2) / 1.2
    joint = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v)) < 0.01
    shade = np.where(joint, 1.0 - 0.2 * min(contrast, 1.0), 1.0) * (1 + 0.02 * contrast * smooth_noise(x, y, 0.3, 400))
    return CEILING * shade[:, None]
