"""Where a target can stand: inside the room and outside all static occluders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .polygons import inside_polygon, pack_polygons, point_inside

ROUNDS = 200
"""Rounds of random places tried before the floor is called full."""


class Floor(NamedTuple):
    """A room polygon minus the polygons in it."""

    room: Floats  # (K, 2)
    walls: Floats  # (S, 2) packed polygons (`pack_polygons`)
    starts: Ints  # (P + 1,)


def make_floor(room: Floats, walls: Sequence[Floats]) -> Floor:
    """The floor inside `room` (K, 2) and outside the `walls`, each (K_p, 2)."""
    return Floor(np.ascontiguousarray(room, dtype=np.float64), *pack_polygons(walls))


@kernel
def on_floor(xy: Floats, room: Floats, walls: Floats, starts: Ints) -> Bools:
    """(N,) bool: which of the (N, 2) points are on the floor."""
    free = inside_polygon(xy, room)
    for w in range(starts.shape[0] - 1):
        wall = walls[starts[w] : starts[w + 1]]
        for i in range(xy.shape[0]):
            if free[i] and point_inside(xy[i, 0], xy[i, 1], wall):
                free[i] = False
    return free


def sample_floor(n: int, floor: Floor, rng: np.random.Generator) -> Floats:
    """(n, 2) random places, uniform over the floor: rejection sampling from the room's bounding box.

    Raises:
        ValueError: so little of the box is free that `ROUNDS` rounds do not find n places.
    """
    low = floor.room.min(axis=0)
    size = floor.room.max(axis=0) - low
    found, count = [np.empty((0, 2))], 0
    for _ in range(ROUNDS):
        if count >= n:
            break
        # A quarter more than needed, so that one round is enough in a room with a few pillars.
        places = low + size * rng.random((n - count + (n - count) // 4 + 4, 2))
        places = places[on_floor(places, floor.room, floor.walls, floor.starts)]
        found.append(places)
        count += len(places)
    if count < n:
        raise ValueError(f"only {count} of {n} random places were free; static occluders fill the room")
    return np.concatenate(found)[:n]


def sample_near(xy: Floats, reach: float, floor: Floor, rng: np.random.Generator) -> Floats:
    """(N, 2) random places on the floor, each uniform within a distance of one of the (N, 2) points.

    For a point with hardly any floor around it the place is anywhere on the floor.

    Raises:
        ValueError: there is hardly any floor at all; see `sample_floor`.
    """
    out = np.array(xy, dtype=np.float64)
    left = np.arange(len(out))
    for _ in range(ROUNDS):
        if not len(left):
            return out
        r, turn = reach * np.sqrt(rng.random(len(left))), 2.0 * np.pi * rng.random(len(left))
        out[left] = xy[left] + r[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        left = left[~on_floor(out[left], floor.room, floor.walls, floor.starts)]
    out[left] = sample_floor(len(left), floor, rng)
    return out
