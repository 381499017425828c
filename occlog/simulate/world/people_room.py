"""A room in which people of identical appearance walk and occlude one another, seen by two to six cameras.

The cameras are at such a distance from the walking area that all views hold them whole,
and not in one line: then the views of any three of them state where a point is in the third.

Objects that walk to random positions by potential fields: around each other, walls and people ([Lee] Sec. 5.2.2).

The total force gives the direction of a step, its length is constant, and noise is added as for `waypoints`.  The
thesis turns away from obstacles straight ahead only; here a step that would bring an object closer than a diameter
to another one, into a wall or out of the room is turned or skipped, as `waypoints` does it.  So objects never overlap,
never leave the room and never enter a static occluder.

People of a recording walk where they walked.  An object does not step into them, but they may walk into it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import rotation_from_angles
from occlog.core.navigation.forces import Field, distance
from occlog.core.navigation.obstacles import (
    MovingObstacles,
    MovingObstacleTracks,
    edges,
    nearest_on_discs,
    nearest_on_polygons,
    nearest_on_segments,
)
from occlog.core.navigation.steering import NearbyObstacles, StepRules, steer
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError
from occlog.records.scene import Camera, Scene, camera_fov

from .waypoints import Ground, WaypointMotion, WaypointNoise, WaypointState, move_into, place_free

SIDE = 14.0
"""Side of the square room [m]."""
CLEARANCE = 4.5
"""People keep this distance from the walls [m]."""
CAMERAS = (
    (0.1, 0.1, 2.8, 500.0),
    (13.9, 0.1, 2.8, 500.0),
    (7.0, 13.9, 3.2, 390.0),
    (0.1, 13.9, 2.6, 500.0),
    (13.9, 13.9, 3.0, 500.0),
    (7.0, 0.1, 2.4, 390.0),
)
"""Position x, y, z [m], and focal length [px] in images of 640 x 480."""
HEIGHT = 0.9
"""Height of the point in the middle of the room at which all cameras point [m]."""

BODY = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (0.0, 1.85)])
"""Corners of a box about a body, relative to its feet [m]."""
TRIES, DRAWN = 200, 500
"""Searches for positions without occlusions between people, and positions drawn in each."""


def people_room(views: int, size: tuple[int, int], rate_hz: float) -> Scene:
    """The empty room with cameras `view1`, `view2`, ..., in metres.

    Args:
        views: number of cameras, 1 to 6.
        size: width and height of the images [px]; the cameras see the same for any of the shape 4 : 3,
            and more to the sides, or above and below, for others.
        rate_hz: frame rate of the cameras.
    """
    return Scene(
        cameras=tuple(_camera(k, size, rate_hz) for k in range(views)),
        room=np.array([[0.0, 0.0], [SIDE, 0.0], [SIDE, SIDE], [0.0, SIDE]]),
        room_height=4.0,
    )


def _camera(number: int, size: tuple[int, int], rate_hz: float) -> Camera:
    x, y, z, focal = CAMERAS[number]
    away = np.array([0.5 * SIDE - x, 0.5 * SIDE - y])
    yaw, pitch = math.atan2(away[1], away[0]), -math.atan2(z - HEIGHT, float(np.hypot(*away)))
    rotation = rotation_from_angles(yaw, pitch, 0.0)
    focal_px = np.full(2, focal * min(size[0] / 640.0, size[1] / 480.0))
    principal = 0.5 * (np.asarray(size, dtype=np.float64) - 1.0)
    return Camera(
        name=f"view{number + 1}",
        position=np.array([x, y, z]),
        rotation=rotation,
        focal_px=focal_px,
        principal_px=principal,
        image_size=size,
        fov=camera_fov(size, focal_px, principal, distortion=np.zeros(5), model="brown", rotation=rotation),
        rate_hz=rate_hz,
    )


def people_apart(scene: Scene, people: int, seed: int) -> Floats:
    """Find positions (n, 2) in the middle of the room without occlusions between people in any camera.

    InputError if none are found.

    Args:
        scene: room of `people_room`.
        people: number n of people.
        seed: seed of the search.
    """
    rng = generator(seed, RandomStream.WORLD_START)
    for _ in range(TRIES):
        positions = rng.uniform(CLEARANCE, SIDE - CLEARANCE, (DRAWN, 2))
        boxes = np.stack([_image_boxes(camera, positions) for camera in scene.cameras], axis=1)
        free, kept = np.arange(DRAWN), [0]
        while len(kept) < people and len(free := free[_clear(boxes[kept[-1]], boxes[free])]):
            kept.append(int(free[0]))
        if len(kept) == people:
            return positions[kept]
    raise InputError(
        f"people: no positions of {people} people without occlusions in {len(scene.cameras)} "
        "cameras; take fewer people or cameras, or let them overlap in the first frame",
        id="no-room",
    )


def _image_boxes(camera: Camera, positions: Floats) -> Floats:
    """(n, 4) image boxes left, top, right, bottom [px] of people standing at ground positions (n, 2)."""
    corners = np.column_stack([positions, np.zeros(len(positions))])[:, None] + BODY
    pixels = camera.project(corners.reshape(-1, 3)).reshape(len(positions), len(BODY), 2)
    return np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)


def _clear(box: Floats, others: Floats) -> Bools:
    """(m,) mask of other persons with boxes that overlap none of a person's boxes, in any of V views.

    Args:
        box: (V, 4) left, top, right, bottom of the person in each view.
        others: (m, V, 4) left, top, right, bottom of m other persons.
    """
    disjoint = (box[:, :2] > others[..., 2:]) | (others[..., :2] > box[:, 2:])
    return np.asarray(disjoint.any(axis=-1).all(axis=-1))


class Avoidance(NamedTuple):
    """Parameters by which objects avoid obstacles in potential fields ([Lee] Sec. 5.2.2).

    Attributes:
        field: rules of the forces.
        steps: rules of the steps.
        occluders: packed polygons of the static occluders that repel.
        patience: steps without getting nearer to a destination, after which another one is taken.
        people: recorded walkers; None: none.
    """

    field: Field
    steps: StepRules
    occluders: tuple[Floats, Ints]
    patience: int
    people: MovingObstacleTracks | None


class AvoidingState(NamedTuple):
    """State of n objects that walk by potential fields.

    Attributes:
        xy, destination: (n, 2) positions and destinations.
        total: (n, 2) total force of the last step; NaN before the first.
        nearest: (n,) least distance from the destination so far.
        waited: (n,) number of steps since then.
        step: number of steps done.
    """

    xy: Floats
    destination: Floats
    total: Floats
    nearest: Floats
    waited: Ints
    step: int


def starting(world: WaypointState) -> AvoidingState:
    """Initial state of walking by potential fields, with the positions and destinations of `world`."""
    n = len(world.xy)
    return AvoidingState(
        xy=world.xy.copy(),
        destination=world.destination.copy(),
        total=np.full((n, 2), np.nan),
        nearest=np.full(n, np.inf),
        waited=np.zeros(n, dtype=np.int64),
        step=world.step,
    )


def walk_avoiding(
    world: AvoidingState, ground: Ground, motion: WaypointMotion, rules: Avoidance, draws: WaypointNoise
) -> tuple[AvoidingState, Floats]:
    """Move n objects by C steps, as many as there are draws; they avoid obstacles by potential fields.

    Args:
        world: state before the first step, not changed.
        ground: room and walls.
        motion: speed, noise and diameter.
        rules: field, obstacles and patience.
        draws: random numbers (C, n, ...).

    Returns:
        State after the last step, and positions after each step (C, n, 2).
    """
    path = np.empty(draws.noise.shape)
    low = ground.room.min(axis=0)
    positions = low + (ground.room.max(axis=0) - low) * draws.positions
    for t in range(len(path)):
        # Change of destination: on arrival, by chance, or where the object does not get nearer ([Ercan] Sec. 6)
        to_go = distance(world.destination, world.xy)
        nearer = to_go < world.nearest - 0.5 * motion.step
        nearest = np.where(nearer, to_go, world.nearest)
        waited = np.where(nearer, 0, world.waited + 1)
        change = (to_go < motion.step) | (draws.chance[t] < motion.redirect) | (waited > rules.patience)
        destination = world.destination.copy()
        for i in np.flatnonzero(change):
            if (found := _free(positions[t, i], ground)) is not None:
                destination[i], nearest[i], waited[i] = found, math.inf, 0
        # Forces, prevention and escape ([Lee] Eqs. 5.11 to 5.34)
        obstacles = None if rules.people is None else rules.people.at(world.step)
        around = _around(world.xy, ground, motion, rules, obstacles)
        steering = steer(world.xy, destination, around, rules.field, rules.steps, world.total)
        # Step: constant speed along the total force, plus noise
        length = np.hypot(steering.total[:, 0], steering.total[:, 1])[:, None]
        heading = np.where(length > 0.0, steering.total / np.where(length > 0.0, length, 1.0), 0.0)
        step = motion.step * heading + motion.sigma * draws.noise[t]
        xy = _moved(world.xy, step, first=world.step, ground=ground, diameter=motion.diameter, obstacles=obstacles)
        world = AvoidingState(xy, destination, steering.total, nearest, waited, step=world.step + 1)
        path[t] = xy
    return world, path


def _free(candidates: Floats, ground: Ground) -> Floats | None:
    """Return the first of the candidate positions (K, 2) that is free, as (2,); None if none is."""
    for position in candidates:
        if place_free(position[0], position[1], ground):
            return np.asarray(position)
    return None


def _around(
    xy: Floats, ground: Ground, motion: WaypointMotion, rules: Avoidance, obstacles: MovingObstacles | None
) -> NearbyObstacles:
    """Obstacles near each object: static occluders, walls, the other objects, and recorded people.

    Args:
        xy: (n, 2) positions of the objects.
        ground: room.
        motion: diameter and step of the objects.
        rules: static occluders.
        obstacles: recorded people at this time step; None: none.
    """
    n, radius = len(xy), 0.5 * motion.diameter
    others = np.array([[j for j in range(n) if j != i] for i in range(n)], dtype=np.int64).reshape(n, max(n - 1, 0))
    people = np.empty((0, 2)) if obstacles is None else obstacles.xy[np.isfinite(obstacles.xy[:, 0])]
    ways = np.zeros(0) if obstacles is None else np.hypot(*obstacles.move[np.isfinite(obstacles.xy[:, 0])].T)
    fixed = [nearest_on_polygons(xy, *rules.occluders), nearest_on_segments(xy, edges(ground.room))]
    bodies = [nearest_on_discs(xy, xy[others], np.full(others.shape[1], radius))]
    bodies.append(nearest_on_discs(xy, people, np.full(len(people), radius)))
    nearest = np.concatenate([*fixed, *bodies], axis=1)
    still, round_ones = sum(f.shape[1] for f in fixed), others.shape[1] + len(people)
    return NearbyObstacles(
        nearest=nearest,
        radius=np.zeros(still + round_ones),
        size=np.concatenate([np.zeros(still), np.full(round_ones, radius)]),
        way=np.concatenate([np.zeros(still), np.full(others.shape[1], motion.step), ways]),
    )


def _moved(
    xy: Floats, step: Floats, *, first: int, ground: Ground, diameter: float, obstacles: MovingObstacles | None
) -> Floats:
    """(n, 2) positions after the objects have moved in turn, and only to free positions.

    A step that is not free is turned, or the object stays.

    Args:
        xy: (n, 2) positions before.
        step: (n, 2) desired steps.
        first: number of the time step; object `first` modulo n moves first.
        ground: room and walls.
        diameter: minimum distance of centres from each other and from people.
        obstacles: recorded people at this step; None: none.
    """
    n, out = len(xy), xy.copy()
    people = np.empty((0, 2)) if obstacles is None else np.concatenate([obstacles.xy, obstacles.after])
    people = people[np.isfinite(people[:, 0])]
    for m in range(n):
        i = (m + first) % n
        bodies = out
        if len(people):
            # Who has walked into the object cannot be kept away from any more, but may be left
            bodies = np.concatenate([out, people[distance(people, out[i]) >= diameter]])
        move_into(bodies, i, step[i, 0], step[i, 1], ground, diameter)
        out[i] = bodies[i]
    return out
