"""How a target comes to each place of the floor, and the crowd about it meanwhile.

Both walk as in `occlog simulate`: to random places, around static occluders.  The target walks alone for long, and what
it went before each of its visits to a place is a way; the crowd walks by itself, and each way meets a stretch of that.
That people get out of the target's way is left out, but for those who would stand in it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from occlog.array_types import Floats, Ints
from occlog.core.numerics.seeds import Stage, generator
from occlog.core.plane.floor import make_floor, on_floor
from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import ground, motion_in_a_step
from occlog.simulate.world.waypoints import CANDIDATES, Draws, Ground, populate, walk

from .config import MOST_PEOPLE, PlanConfig

WALKERS, ALONE = 8, 60_000
"""Walks alone from which ways are taken, and the steps of each."""
TINY = 1e-6
"""Diameter of one who walks alone, in sides of a cell."""
CHUNK = 4096
"""Steps for which random numbers are drawn at a time."""
FINE = 2000
"""Cells from which the area of the free floor is counted."""
SETTLE, WALKED = 200, 3000
"""Steps that the crowd walks before it counts, and after that."""


class Cells(NamedTuple):
    """C rectangles of the floor, nearly square."""

    xy: Floats  # (C, 2) their middles
    size: Floats  # (2,) their sides


def cells_of(scene: Scene, count: int) -> Cells:
    """Cells that cover the free floor, about `count` of them; those whose middle is free.

    Raises:
        InputError: the scene has no room.
    """
    if scene.room is None:
        raise InputError("plan: the scene has no room, so that nobody knows where people walk; add `room` to it")
    low, high = scene.room.min(axis=0), scene.room.max(axis=0)
    floor = make_floor(scene.room, [o.polygon for o in scene.occluders])
    size = math.sqrt(float(np.prod(high - low)) / count)
    for _ in range(4):
        xy = _grid(low, high, size)
        xy = xy[on_floor(xy, floor.room, floor.walls, floor.starts)]
        if len(xy) >= 0.7 * count:
            break
        size *= math.sqrt(max(len(xy), 1) / count)
    if not len(xy):
        raise InputError("plan: the room has no free floor; make static occluders smaller")
    return Cells(np.ascontiguousarray(xy), (high - low) / _numbers(low, high, size))


def _grid(low: Floats, high: Floats, size: float) -> Floats:
    """(N, 2) middles of the rectangles, the same from either side; rows from below."""
    numbers = _numbers(low, high, size)
    x, y = (lo + (np.arange(n) + 0.5) * (hi - lo) / n for lo, hi, n in zip(low, high, numbers, strict=True))
    return np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))])


def _numbers(low: Floats, high: Floats, size: float) -> Ints:
    """(2,) how many rectangles there are along x and y."""
    return np.asarray(np.maximum(1, np.rint((high - low) / size)), dtype=np.int64)


def walks_to(cells: Cells, scene: Scene, config: PlanConfig, dt: float, steps: int, seed: int) -> Floats:
    """(C * draws, steps, 2) ways of targets that are in a cell at the last step; draws of a cell in turn.

    They are stretches of one long walk, spread over all visits of the cell.  A cell that the walk never came to takes
    those of the nearest one that it came to, moved there.
    """
    alone = WorldConfig(
        step_s=dt,
        diameter=TINY * float(cells.size.min()),
        speed=config.speed,
        sigma=config.sigma,
        redirect=config.redirect,
    )
    long = np.concatenate(
        [_walk(ground(scene, 0.0), alone, 1, ALONE, seed, walker)[:, 0] for walker in range(1, WALKERS + 1)]
    )
    last = np.arange(len(long))
    last = last[last % ALONE >= steps - 1]
    cell = nearest_cell(cells, long[last])
    order = np.argsort(cell, kind="stable")
    begin = np.searchsorted(cell[order], np.arange(len(cells.xy) + 1))
    visits = np.diff(begin)
    visited = np.flatnonzero(visits)
    ways = np.empty((len(cells.xy), config.draws, steps, 2))
    spread = (np.arange(config.draws) + 0.5) / config.draws
    for k, place in enumerate(cells.xy):
        near = k if visits[k] else visited[np.argmin(np.sum((cells.xy[visited] - place) ** 2, axis=1))]
        ends = last[order[begin[near] + (spread * visits[near]).astype(np.int64)]]
        ways[k] = long[ends[:, None] + np.arange(1 - steps, 1)] + (place - cells.xy[near])
    return np.ascontiguousarray(ways.reshape(-1, steps, 2))


def nearest_cell(cells: Cells, xy: Floats) -> Ints:
    """(P,) number of the cell whose middle is nearest to each place; it holds the place, where a cell does."""
    tree = KDTree(cells.xy)
    return np.asarray(tree.query(xy)[1], dtype=np.int64)


def crowd_size(scene: Scene, config: PlanConfig) -> int:
    """How many people there are beside the target."""
    if config.people is not None:
        return config.people
    if config.density == 0.0:
        return 0
    cells = cells_of(scene, FINE)
    number = round(config.density * len(cells.xy) * float(cells.size.prod()))
    if number > MOST_PEOPLE:
        raise InputError(
            f"plan: density {config.density:g} is {number} people, must be at most {MOST_PEOPLE}; lower it"
        )
    return number


def crowd_walk(scene: Scene, config: PlanConfig, dt: float, steps: int, seed: int) -> Floats:
    """(K, n, 2) places of n people who walk about, K steps of `dt`; K is at least `steps`.

    Raises:
        InputError: they do not fit into the room.
    """
    n = crowd_size(scene, config)
    if n == 0:
        return np.empty((steps, 0, 2))
    world = WorldConfig(
        step_s=dt,
        targets=0,
        occluders=n,
        diameter=config.diameter,
        speed=config.speed,
        sigma=config.sigma,
        redirect=config.redirect,
    )
    floor = ground(scene, 0.0)
    return np.ascontiguousarray(_walk(floor, world, n, SETTLE + steps + WALKED, seed, 0)[SETTLE:])


def _walk(floor: Ground, world: WorldConfig, n: int, steps: int, seed: int, item: int) -> Floats:
    """(steps, n, 2) places of n objects that walk to random places."""
    rng = generator(seed, Stage.PLAN, 0, item)
    try:
        state = populate(n, floor, world.diameter, rng)
    except ValueError as error:
        raise InputError(f"plan: {error}; use fewer or smaller people, or a larger room") from error
    path = np.empty((steps, n, 2))
    for first in range(0, steps, CHUNK):
        shape = (min(CHUNK, steps - first), n)
        draws = Draws(rng.standard_normal((*shape, 2)), rng.random(shape), rng.random((*shape, CANDIDATES, 2)))
        state, path[first : first + CHUNK], _ = walk(state, floor, motion_in_a_step(world), draws)
    return path


def stretches(draws: int, crowd: Floats, steps: int, seed: int) -> Ints:
    """(draws,) first step of a stretch of the crowd's walk for each draw."""
    return generator(seed, Stage.PLAN, 1).integers(0, len(crowd) - steps + 1, draws)


def turns_per_second(cells: Cells, config: PlanConfig) -> float:
    """How often a walker takes a new heading: on arrival, at places spread over the floor, and by chance.

    Random waypoints are the mean distance of two places apart.
    """
    some = cells.xy[:: max(1, len(cells.xy) // 500)]
    apart = np.hypot(*(some[:, None] - some).transpose(2, 0, 1))
    mean = float(apart.sum()) / max(len(some) * (len(some) - 1), 1)
    return -math.log1p(-config.redirect) + config.speed / max(mean, float(cells.size.max()))
