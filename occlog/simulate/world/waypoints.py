"""The world of [Ercan] Sec. 6: objects that walk to random waypoints and go around each other.

Every object walks straight towards its destination with constant speed plus noise
(regime MTD, Eq. 5).  It takes a new destination, uniform over the free floor (regime
CD), when it has arrived (the destination is less than a step away), when its next step
without noise would end in a static occluder or outside the room, and - the variant
"waypoints+" - with a fixed probability in every step.

The paper leaves open how objects go around each other.  Here the objects of a step move
one after another, each in turn first; an object with a step that would bring its centre
closer than one diameter to another's, into a wall or out of the room turns its step by
15, 30, ... 180 degrees to either side and takes the first that is free, or stays.  So
objects never overlap, never leave the room and never enter a static occluder.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane import distance_to_boundary, point_inside, segment_blocked


class Ground(NamedTuple):
    """Free ground on which objects move: the room without walls and occluders.

    Attributes:
        room: (K, 2) outline of the room.
        walls: (S, 2) corners of P polygons, one after the other: static occluders and pockets of the room.
        starts: (P + 1,) index of the first corner of each polygon, then S.
        clearance: minimum distance of a centre from walls and room.
    """

    room: Floats
    walls: Floats
    starts: Ints
    clearance: float


class WaypointMotion(NamedTuple):
    """Motion of simulated objects per step: length without noise, noise per axis, and probability of a new destination.

    `sigma` is the standard deviation of the noise; `diameter` is the minimum distance of centres.
    """

    step: float  # speed: length of a step without noise
    sigma: float  # standard deviation of the noise of a step, per axis
    redirect: float  # probability of a new destination, 0 to 1
    diameter: float  # of an object: centres keep this distance


TURN = math.radians(15.0)
"""Directions tried by an object that goes around another have this angle between them."""
TURNS = 12


@kernel
def place_free(x: float, y: float, ground: Ground) -> bool:
    """Whether a centre at (x, y) is in the room, in no wall, and at least the clearance from all of them."""
    room, walls, starts, clearance = ground.room, ground.walls, ground.starts, ground.clearance
    if not point_inside(x, y, room):
        return False
    if clearance > 0.0 and distance_to_boundary(x, y, room) < clearance:
        return False
    for p in range(starts.shape[0] - 1):
        wall = walls[starts[p] : starts[p + 1]]
        if point_inside(x, y, wall):
            return False
        if clearance > 0.0 and distance_to_boundary(x, y, wall) < clearance:
            return False
    return True


@kernel
def step_free(ax: float, ay: float, bx: float, by: float, ground: Ground) -> bool:
    """Whether a centre may go straight from (ax, ay) to (bx, by): the end is free and no wall is crossed."""
    if not place_free(bx, by, ground):
        return False
    walls, starts = ground.walls, ground.starts
    for p in range(starts.shape[0] - 1):  # noqa: SIM110 - numba compiles no generator
        if segment_blocked(ax, ay, bx, by, walls[starts[p] : starts[p + 1]]):
            return False
    return True


@kernel
def first_hit(xy: Floats, i: int, bx: float, by: float, diameter: float) -> int:
    """Index of the object that object i comes closest to on its straight way to (bx, by), if nearer than `diameter`.

    -1 if it keeps that distance from all. `xy` (n, 2) are the positions.
    """
    hit, nearest = -1, diameter * diameter
    ax, ay = xy[i, 0], xy[i, 1]
    ex, ey = bx - ax, by - ay
    length2 = ex * ex + ey * ey
    for j in range(xy.shape[0]):
        if j == i:
            continue
        px, py = xy[j, 0] - ax, xy[j, 1] - ay
        s = 0.0
        if length2 > 0.0:
            s = min(1.0, max(0.0, (px * ex + py * ey) / length2))
        dx, dy = px - s * ex, py - s * ey
        gap2 = dx * dx + dy * dy
        if gap2 < nearest:
            hit, nearest = j, gap2
    return hit


@kernel
def try_into(
    xy: Floats,
    i: int,
    ux: float,
    uy: float,
    ground: Ground,
    diameter: float,
) -> bool:
    """Move an object by a step, in place, if the way is free and the object keeps `diameter` from all others on it.

    Args:
        xy: (n, 2) positions; row `i` is changed.
        i: index of the object.
        ux: step along x.
        uy: step along y.
        ground: room and walls.
        diameter: minimum distance of centres.

    Returns:
        Whether it moved.
    """
    bx, by = xy[i, 0] + ux, xy[i, 1] + uy
    if first_hit(xy, i, bx, by, diameter) >= 0:
        return False
    if not step_free(xy[i, 0], xy[i, 1], bx, by, ground):
        return False
    xy[i, 0], xy[i, 1] = bx, by
    return True


@kernel
def move_into(
    xy: Floats,
    i: int,
    ux: float,
    uy: float,
    ground: Ground,
    diameter: float,
) -> None:
    """Move object i of `xy` (n, 2) by (ux, uy), in place; where that is not free, turn away step by step, or stay.

    First the requested step is tried, then turned directions in the order of their angle to it, each with a whole step,
    then half a step. Of two equal angles, the one that leads away from the object in the way comes first (to the right
    if that is straight ahead), so that two objects that meet pass each other.

    Args:
        xy: (n, 2) positions of all objects, updated in place.
        i: index of the object.
        ux: x of the requested step.
        uy: y of the requested step.
        ground: room and walls.
        diameter: minimum distance of the centres of two objects.
    """
    if try_into(xy, i, ux, uy, ground, diameter):
        return
    side = -1.0
    hit = first_hit(xy, i, xy[i, 0] + ux, xy[i, 1] + uy, diameter)
    if hit >= 0 and ux * (xy[hit, 1] - xy[i, 1]) - uy * (xy[hit, 0] - xy[i, 0]) < 0.0:
        side = 1.0
    for attempt in range(2 * TURNS):
        turn = side * TURN * (attempt // 2 + 1)
        if attempt % 2 == 1:
            turn = -turn
        c, s = math.cos(turn), math.sin(turn)
        vx, vy = c * ux - s * uy, s * ux + c * uy
        if try_into(xy, i, vx, vy, ground, diameter):
            return
        if try_into(xy, i, 0.5 * vx, 0.5 * vy, ground, diameter):
            return


@kernel
def new_destination_into(
    xy: Floats,
    destination: Floats,
    i: int,
    candidates: Floats,
    step: float,
    ground: Ground,
) -> bool:
    """Give object i the first candidate destination that is free and towards which the next step is free, in place.

    Args:
        xy: (n, 2) positions.
        destination: (n, 2) destinations; that of object i is set.
        i: index of the object.
        candidates: (K, 2) possible destinations.
        step: length of a step.
        ground: room and walls.

    Returns:
        False if no candidate is suitable; the old destination stays.
    """
    for k in range(candidates.shape[0]):
        tx, ty = candidates[k, 0], candidates[k, 1]
        if place_free(tx, ty, ground) and heads_free(xy[i, 0], xy[i, 1], tx, ty, step, ground):
            destination[i, 0], destination[i, 1] = tx, ty
            return True
    return False


@kernel
def heads_free(x: float, y: float, tx: float, ty: float, step: float, ground: Ground) -> bool:
    """Whether one step from (x, y) towards (tx, ty), without noise, stays in the room and out of walls."""
    distance = math.hypot(tx - x, ty - y)
    if distance == 0.0:
        return True
    scale = step / distance
    return step_free(x, y, x + scale * (tx - x), y + scale * (ty - y), ground)


@kernel
def walk_into(
    path: Floats,
    changed: Bools,
    xy: Floats,
    destination: Floats,
    noise: Floats,
    chance: Floats,
    candidates: Floats,
    first_step: int,
    ground: Ground,
    motion: WaypointMotion,
) -> None:
    """Move n objects by C steps between random destinations ([Ercan] Sec. 6), in place.

    Args:
        path: (C, n, 2) filled: positions after each step.
        changed: (C, n) filled: whether an object took a new destination in a step.
        xy: (n, 2) positions; those after the last step at the end.
        destination: (n, 2) destinations; those after the last step at the end.
        noise: (C, n, 2) noise added to the steps.
        chance: (C, n) uniform random numbers in [0, 1).
        candidates: (C, n, K, 2) possible new destinations.
        first_step: number of the first step, which decides who moves first.
        ground: room and walls.
        motion: step length, probability of a new destination, and diameter.
    """
    n, step = xy.shape[0], motion.step
    for t in range(path.shape[0]):
        for m in range(n):
            i = (m + first_step + t) % n  # each in turn moves first
            tx, ty = destination[i, 0], destination[i, 1]
            arrived = math.hypot(tx - xy[i, 0], ty - xy[i, 1]) < step
            changed[t, i] = False
            # Regime CD (change destination, [Ercan] Sec. 6): it has arrived, or heads into a wall, or (the variant
            # waypoints+) by chance
            if arrived or chance[t, i] < motion.redirect or not heads_free(xy[i, 0], xy[i, 1], tx, ty, step, ground):
                changed[t, i] = new_destination_into(xy, destination, i, candidates[t, i], step, ground)
            # Regime MTD (move toward destination, [Ercan] Eq. 5): constant speed plus noise
            dx, dy = destination[i, 0] - xy[i, 0], destination[i, 1] - xy[i, 1]
            distance = math.hypot(dx, dy)
            scale = step / distance if distance > 0.0 else 0.0
            ux, uy = scale * dx + noise[t, i, 0], scale * dy + noise[t, i, 1]
            move_into(xy, i, ux, uy, ground, motion.diameter)
        path[t] = xy


CANDIDATES = 8
"""Destinations drawn for each object and step; the first one that is free is taken if one is needed."""

ATTEMPTS = 20_000
"""Positions tried for each object before the room is called full."""


class WaypointState(NamedTuple):
    """State of n walking objects, in scene units.

    Attributes:
        xy: (n, 2) positions.
        destination: (n, 2) positions that they walk to.
        step: number of steps done.
    """

    xy: Floats
    destination: Floats
    step: int


class WaypointNoise(NamedTuple):
    """Random numbers for C steps of n objects.

    Standard normal `noise` (C, n, 2); `chance` (C, n) uniform in [0, 1), for new destinations; `positions`
    (C, n, CANDIDATES, 2) uniform in [0, 1), for the destinations.
    """

    noise: Floats  # (C, n, 2) standard normal
    chance: Floats  # (C, n) uniform in [0, 1)
    positions: Floats  # (C, n, CANDIDATES, 2) uniform in [0, 1)


def populate(n: int, ground: Ground, diameter: float, rng: np.random.Generator) -> WaypointState:
    """Put objects at random free positions, at least a diameter apart, each with a random free destination.

    Args:
        n: number of objects.
        ground: room and walls.
        diameter: minimum distance of centres.
        rng: random generator.

    Raises:
        ValueError: the room is too full; the message has the number of objects that were placed.
    """
    xy = np.empty((n, 2))
    for i in range(n):
        xy[i] = _free_place(ground, xy[:i], diameter, rng)
    none = np.empty((0, 2))
    destination = np.array([_free_place(ground, none, diameter, rng) for _ in range(n)]).reshape(n, 2)
    return WaypointState(xy, destination, 0)


def _free_place(ground: Ground, taken: Floats, diameter: float, rng: np.random.Generator) -> Floats:
    low, size = _bounds(ground.room)
    for _ in range(ATTEMPTS):
        position: Floats = low + size * rng.random(2)
        far = not len(taken) or bool(np.min(np.sum((taken - position) ** 2, axis=1)) >= diameter**2)
        if far and place_free(position[0], position[1], ground):
            return position
    raise ValueError(f"no free position found after {len(taken)} objects of diameter {diameter:g}")


def _bounds(room: Floats) -> tuple[Floats, Floats]:
    low = room.min(axis=0)
    return low, room.max(axis=0) - low


def walk(
    world: WaypointState, ground: Ground, motion: WaypointMotion, draws: WaypointNoise
) -> tuple[WaypointState, Floats, Bools]:
    """Move n objects by C steps between random destinations ([Ercan] Sec. 6), as many steps as there are draws.

    Args:
        world: state before the first step, unchanged.
        ground: room and walls.
        motion: step length, noise and diameter.
        draws: random numbers (C, n, ...).

    Returns:
        State after the last step, positions after each step (C, n, 2), and the mask (C, n) of objects that took a new
        destination in a step.
    """
    low, size = _bounds(ground.room)
    path = np.empty(draws.noise.shape)
    changed = np.zeros(draws.chance.shape, dtype=np.bool_)
    xy, destination = world.xy.copy(), world.destination.copy()
    walk_into(
        path=path,
        changed=changed,
        xy=xy,
        destination=destination,
        noise=motion.sigma * draws.noise,
        chance=draws.chance,
        candidates=low + size * draws.positions,
        first_step=world.step,
        ground=ground,
        motion=motion,
    )
    return WaypointState(xy, destination, world.step + len(path)), path, changed
