"""Simulated walks of people in a room, and the paths that lead to each cell of the floor.

All walk as in `occlog simulate`: to random positions, around static occluders and avoiding each other. Any of them may
be the target, occluded by the others, so that close encounters are realistic.

Second moments of a walk: a walker with speed v, r random turns per second and position noise s has steps with, for a =
(1 - exp(-r dt)) / r, E[d_0 . d_k] = v^2 a^2 exp(-r (k - 1) dt), k = 1, 2, ... and E[d_0 . d_0] = 2 v^2 (dt - a) / r + 2
s^2 dt, so that r is determined by where the correlation has fallen to half of its value at k = 1, v by that value, and
s by the steps alone. Turns at walls, and around each other, are included.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from occlog.array_types import Floats, Ints
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.core.plane import make_floor, on_floor
from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import ground, motion_in_a_step
from occlog.simulate.world.waypoints import CANDIDATES, WaypointNoise, populate, walk

from .config import MAX_PEOPLE, PlanConfig
from .filtering import Motion

WALKED = 480_000
"""Steps from which ways are taken, of all people together."""
CROSSINGS = 2
"""Times in which one could cross the room that people walk before it counts, and at least after that."""
MAX_PLACES = 10_000_000
"""Steps that people take before they count, times the number of people, at most."""
CHUNK = 4096
"""Steps for which random numbers are drawn at a time."""
FINE = 2000
"""Cells from which the area of the free floor is counted."""


class Walked(NamedTuple):
    """N targets on their paths of T steps, and all n people at the same times (the targets among them).

    Attributes:
        ways: (N, T, 2) positions of the targets.
        people: (K, n, 2) positions of all people in K steps.
        first: (N,) step among the K at which a target's path begins.
        own: (N,) index of the target among the people; -1: none of them.
        dt: time between steps [s].
    """

    ways: Floats
    people: Floats
    first: Ints
    own: Ints
    dt: float


class Visits(NamedTuple):
    """V visits of people to C floor cells; those of cell k are rows begin[k] to begin[k + 1] - 1.

    `step` (V,) is the step of the walk, `own` (V,) the index of the person.
    """

    step: Ints  # (V,) of the walk
    own: Ints  # (V,) who
    begin: Ints  # (C + 1,)


class FloorCells(NamedTuple):
    """C rectangles, nearly square, that cover the free floor: their centres (C, 2), and the sides of each (2,)."""

    xy: Floats  # (C, 2) their middles
    size: Floats  # (2,) their sides


def cells_of(scene: Scene, count: int) -> FloorCells:
    """Divide the free floor into about `count` cells with free centres.

    Raises:
        InputError: the scene has no room, or no free floor.
    """
    if scene.room is None:
        raise InputError(
            "plan: the scene has no room, so that the walking area is unknown; add `room` to it", id="missing-value"
        )
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
        raise InputError("plan: the room has no free floor; make static occluders smaller", id="no-room")
    return FloorCells(np.ascontiguousarray(xy), (high - low) / _numbers(low, high, size))


def _grid(low: Floats, high: Floats, size: float) -> Floats:
    """Centres (N, 2) of a grid of rectangles with sides of about `size`, row by row from below.

    It fills the rectangle with the corners `low` (2,) and `high` (2,) exactly.
    """
    numbers = _numbers(low, high, size)
    x, y = (lo + (np.arange(n) + 0.5) * (hi - lo) / n for lo, hi, n in zip(low, high, numbers, strict=True))
    return np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))])


def _numbers(low: Floats, high: Floats, size: float) -> Ints:
    """Number (2,) of rectangles with sides of about `size` along x and y, from corner `low` (2,) to `high` (2,)."""
    return np.asarray(np.maximum(1, np.rint((high - low) / size)), dtype=np.int64)


def simulate_crowd(scene: Scene, config: PlanConfig, dt: float, steps: int, seed: int) -> Floats:
    """Simulate positions (K, n, 2) of n people, the target among them, in K steps of `dt` [s].

    At least `WALKED` steps of all people together have `steps` - 1 steps before them.

    Raises:
        InputError: the people do not fit into the room, or crossing it takes too many steps.
    """
    n = crowd_size(scene, config) + 1
    world = WorldConfig(
        step_s=dt,
        targets=0,
        occluders=n,
        diameter=config.person_diameter,
        speed=config.speed,
        process_noise_position=config.process_noise_position,
        redirect_probability=config.redirect_probability,
    )
    floor, motion, rng = ground(scene, 0.0), motion_in_a_step(world), generator(seed, RandomStream.PLAN, 0)
    try:
        state = populate(n, floor, world.diameter, rng)
    except ValueError as error:
        raise InputError(f"plan: {error}; use fewer or smaller people, or a larger room", id="no-room") from error
    crossing = CROSSINGS * float(np.hypot(*np.ptp(floor.room, axis=0))) / (config.speed * dt)
    if crossing * n > MAX_PLACES:
        raise InputError(
            f"plan: at a speed of {config.speed:g} crossing the room takes {crossing:.2g} steps of {dt:g} s, must be "
            f"at most {MAX_PLACES // n} with {n} people; state a higher speed, a lower rate, or fewer people",
            id="problem-too-large",
        )
    across = math.ceil(crossing)
    count = across + steps - 1 + max(-(-WALKED // n), across)
    path = np.empty((count, n, 2))
    for first in range(0, count, CHUNK):
        shape = (min(CHUNK, count - first), n)
        draws = WaypointNoise(rng.standard_normal((*shape, 2)), rng.random(shape), rng.random((*shape, CANDIDATES, 2)))
        state, path[first : first + CHUNK], _ = walk(state, floor, motion, draws)
    return np.ascontiguousarray(path[across:])


def crowd_size(scene: Scene, config: PlanConfig) -> int:
    """Number of people other than the target: as stated, or density times the area of the floor.

    InputError if there are more than `MAX_PEOPLE`.
    """
    if config.people is not None:
        return config.people
    if config.density == 0.0:
        return 0
    cells = cells_of(scene, FINE)
    number = round(config.density * len(cells.xy) * float(cells.size.prod()))
    if number > MAX_PEOPLE:
        raise InputError(
            f"plan: density {config.density:g} is {number} people, must be at most {MAX_PEOPLE}; lower it",
            id="problem-too-large",
        )
    return number


def cell_visits(cells: FloorCells, people: Floats, steps: int) -> Visits:
    """Visits of people who have walked at least `steps` steps to each cell, sorted by time.

    `people` (K, n, 2) are their positions. A cell without visits has those of the nearest cell with visits.
    """
    n = people.shape[1]
    cell = nearest_cell(cells, people[steps - 1 :].reshape(-1, 2))
    order = np.argsort(cell, kind="stable")
    begin = np.searchsorted(cell[order], np.arange(len(cells.xy) + 1))
    visited = np.flatnonzero(np.diff(begin))
    near = visited[KDTree(cells.xy[visited]).query(cells.xy)[1]]
    rows = np.concatenate([order[begin[k] : begin[k + 1]] for k in near])
    counts = np.diff(begin)[near]
    return Visits(rows // n + steps - 1, rows % n, np.concatenate([[0], np.cumsum(counts)]))


def paths_through_cells(visits: Visits, people: Floats, draws: int, steps: int, dt: float) -> Walked:
    """Paths of `steps` steps that end in each cell, `draws` of each, evenly spread over the cell's visits.

    Args:
        visits: visits of people to cells; each is late enough in the walk for a whole path.
        people: (K, n, 2) positions of n people in K steps.
        draws: number of paths for each cell.
        steps: number of steps of a path.
        dt: time between two steps [s].
    """
    spread = (np.arange(draws) + 0.5) / draws
    chosen = (visits.begin[:-1, None] + spread * np.diff(visits.begin)[:, None]).astype(np.int64).ravel()
    own, first = visits.own[chosen], visits.step[chosen] - (steps - 1)
    ways = people[first[:, None] + np.arange(steps), own[:, None]]
    return Walked(np.ascontiguousarray(ways), people, first, own, dt)


def nearest_cell(cells: FloorCells, xy: Floats) -> Ints:
    """Return the index (P,) of the cell with the nearest centre to each position `xy` (P, 2)."""
    tree = KDTree(cells.xy)
    return np.asarray(tree.query(xy)[1], dtype=np.int64)


def moments_of(people: Floats, dt: float) -> Motion:
    """Fit speed, turn rate and position noise of a random walk to the second moments of its steps.

    Args:
        people: (K, n, 2) positions of n people, K >= 3.
        dt: time between two steps [s].
    """
    steps = np.diff(people, axis=0)
    alone, next_one = _agreement(steps, 0), _agreement(steps, 1)
    if next_one <= 0.0:  # no step states anything of the next
        return Motion(speed=0.0, turns=1.0 / dt, sigma=math.sqrt(alone / (2.0 * dt)))
    turns = math.log(2.0) / (_half(steps, next_one) * dt)
    a = -math.expm1(-turns * dt) / turns
    variance = next_one / a**2
    noise = (alone - 2.0 * variance * (dt - a) / turns) / (2.0 * dt)
    return Motion(math.sqrt(variance), turns, math.sqrt(max(noise, 0.0)))


def _agreement(steps: Floats, lag: int) -> float:
    """Mean inner product of steps (K, n, 2) of a walk with those `lag` steps later [length^2]."""
    return float(np.mean(np.einsum("tni,tni->tn", steps[: len(steps) - lag], steps[lag:])))


def _half(steps: Floats, whole: float) -> float:
    """Number of steps after lag 1 at which the autocorrelation of `steps` (K, n, 2) is half of `whole`, that at lag 1.

    Found by doubling and bisection, and interpolated between two lags; extrapolated from the longest lag if the walk is
    too short.
    """
    low, at_low, high, longest = 1, whole, 2, len(steps) - 1
    while (at_high := _agreement(steps, min(high, longest))) > 0.5 * whole:
        if high >= longest:
            return (longest - 1) * math.log(2.0) / max(math.log(whole / at_high), 1e-3)
        low, at_low, high = high, at_high, 2 * high
    high = min(high, longest)
    while high - low > 1:
        middle = (low + high) // 2
        if (at := _agreement(steps, middle)) > 0.5 * whole:
            low, at_low = middle, at
        else:
            high, at_high = middle, at
    return low - 1 + (at_low - 0.5 * whole) / (at_low - at_high)
