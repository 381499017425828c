"""Scene and seed to the true paths of targets and moving occluders: [Ercan] Sec. 6, or potential fields.

Scripted paths are in `occlog.simulate.world.scripted_paths`; what sensors measure of either in
`occlog.simulate.sensors`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from occlog.array_types import Floats
from occlog.core.navigation.forces import distance
from occlog.core.navigation.obstacles import MovingObstacleTracks
from occlog.core.navigation.steering import field_of, steps_of
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.core.plane import pack_polygons, pockets
from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.records.tables import Truth
from occlog.simulate.world.people_room import Avoidance, starting, walk_avoiding
from occlog.simulate.world.waypoints import (
    CANDIDATES,
    Ground,
    WaypointMotion,
    WaypointNoise,
    WaypointState,
    populate,
    walk,
)

from .config import FieldConfig, WorldConfig

CHUNK_STEPS = 256
"""Steps computed and yielded at a time; random numbers are drawn for whole chunks, so do not change it."""
STARTS = 200
"""Tries to put all objects where no people are."""


def motion_in_a_step(config: WorldConfig) -> WaypointMotion:
    """Convert speed, process noise and probability of a new destination from per second to per step."""
    redirect, step_s = config.redirect_probability, config.step_s
    return WaypointMotion(
        step=config.speed * step_s,
        sigma=config.process_noise_position * math.sqrt(step_s),
        redirect=-math.expm1(step_s * math.log1p(-redirect)) if redirect < 1 else 1.0,
        diameter=config.diameter,
    )


def ground(scene: Scene, clearance: float) -> Ground:
    """Free ground (walkable area) of a scene, at least `clearance` from walls and static occluders."""
    walls = [o.polygon for o in scene.occluders] + pockets(scene.surroundings)
    return Ground(np.ascontiguousarray(scene.surroundings, dtype=np.float64), *pack_polygons(walls), clearance)


def simulate_truth(
    scene: Scene,
    config: WorldConfig,
    seed: int,
    start: Floats | None = None,
    *,
    field: FieldConfig | None = None,
    people: MovingObstacleTracks | None = None,
) -> Iterator[Truth]:
    """Generate the true positions of all objects, chunk by chunk: targets are numbered 0, 1, ..., occluders after them.

    An object's noise depends on seed and number only, not on how many others there are
    or how many steps are requested.

    Args:
        scene: its room (or a box around its sensors) bounds the world.
        config: numbers, speeds, times.
        seed: seed of all random numbers.
        start: (n, 2) positions of all objects at the first step; None: random ones.
        field: avoidance of obstacles, for motion `field`; None: the defaults of the scene's unit.
        people: recorded walkers, avoided with motion `field`; None: none.

    Returns:
        Generator of tables of up to CHUNK_STEPS steps; time k is `start_ns + round(k step_s)`.
        InputError if there are no objects, or if they do not fit into the room.
    """
    floor, n = ground(scene, config.wall_clearance), config.targets + config.occluders
    world = _first(floor, n, config, seed, people)
    world = world if start is None else world._replace(xy=start.copy())
    generators = [[generator(seed, RandomStream.WORLD_MOTION, i, kind) for kind in range(3)] for i in range(n)]
    path, motion = world.xy[None], motion_in_a_step(config)
    rules = _avoidance(scene, config, field or FieldConfig.in_unit(scene.length_unit), people)
    avoiding = starting(world)
    for first in range(0, config.steps, CHUNK_STEPS):
        if config.motion == "field":
            avoiding, walked = walk_avoiding(avoiding, floor, motion, rules, _draw(generators))
        else:
            world, walked, _ = walk(world, floor, motion, _draw(generators))
        positions = np.concatenate([path, walked[:-1]])[: config.steps - first]
        path = walked[-1:]
        yield _truth(positions, first, config)


def _avoidance(scene: Scene, config: WorldConfig, field: FieldConfig, people: MovingObstacleTracks | None) -> Avoidance:
    """Settings of the potential field by which objects avoid obstacles.

    Args:
        scene: scene with the static occluders.
        config: speed, diameter and time step.
        field: settings of the potential field.
        people: recorded people, whom the objects avoid, too; None: none.
    """
    return Avoidance(
        field=field_of(field),
        steps=steps_of(field, config.speed * config.step_s, 0.5 * config.diameter),
        occluders=pack_polygons([o.polygon for o in scene.occluders]),
        patience=max(1, round(field.patience_s / config.step_s)),
        people=people,
    )


def _first(floor: Ground, n: int, config: WorldConfig, seed: int, people: MovingObstacleTracks | None) -> WaypointState:
    """Draw the random start state of n objects: positions and destinations.

    They are at least a diameter from each other and from the people of the first step. InputError if n is 0, or if they
    do not fit.
    """
    if n == 0:
        raise InputError("simulate: targets and occluders are both 0; give at least one object", id="missing-option")
    there = np.empty((0, 2)) if people is None else people.at(0).xy
    there = there[np.isfinite(there[:, 0])]
    rng = generator(seed, RandomStream.WORLD_START)
    try:
        for _ in range(STARTS):
            world = populate(n, floor, config.diameter, rng)
            if not len(there) or distance(world.xy[:, None], there).min() >= config.diameter:
                return world
    except ValueError as error:
        raise InputError(f"simulate: {error}; use fewer or smaller objects, or a larger room", id="no-room") from error
    raise InputError(
        f"simulate: no positions found for {n} objects next to {len(there)} people; use fewer or smaller ones",
        id="no-room",
    )


def _draw(generators: list[list[np.random.Generator]]) -> WaypointNoise:
    """Draw the random numbers of `CHUNK_STEPS` steps, those of each object from its own generators.

    `generators` has for each object those of noise, of changes of destination, and of destinations.
    """
    c, n = CHUNK_STEPS, len(generators)
    draws = WaypointNoise(np.empty((c, n, 2)), np.empty((c, n)), np.empty((c, n, CANDIDATES, 2)))
    for i, (noise, chance, position_noise) in enumerate(generators):
        draws.noise[:, i] = noise.standard_normal((c, 2))
        draws.chance[:, i] = chance.random(c)
        draws.positions[:, i] = position_noise.random((c, CANDIDATES, 2))
    return draws


def _truth(positions: Floats, first: int, config: WorldConfig) -> Truth:
    """Truth table of positions (C, n, 2) of n objects in C steps, the first of which has the number `first`."""
    c, n = positions.shape[:2]
    ids = np.arange(n)
    steps = np.rint(np.arange(first, first + c) * (config.step_s * 1e9)).astype(np.int64)
    target = np.tile(ids < config.targets, c)
    return Truth.of(
        t_ns=np.repeat(config.start_ns + steps, n),
        target_id=np.tile(ids, c).astype(np.int32),
        role=np.where(target, "target", "occluder"),
        x=positions[:, :, 0].ravel(),
        y=positions[:, :, 1].ravel(),
        z=np.full(c * n, math.nan if config.object_height is None else config.object_height),
    )
