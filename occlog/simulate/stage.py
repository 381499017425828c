"""Scene and seed to the true paths of targets and moving occluders: the world of [Ercan] Sec. 6.

Scripted paths instead are in `simulate_paths`; what sensors measure of either in
`simulate_cameras` and `simulate_arrays`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.seeds import Stage, generator
from occlog.core.plane.polygons import pack_polygons
from occlog.core.plane.room_pockets import pockets
from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.records.tables import Truth
from occlog.simulate.sensors.arrays import observe_arrays
from occlog.simulate.sensors.cameras import ObserveConfig, observe
from occlog.simulate.sensors.sounding import SoundConfig
from occlog.simulate.world.scripted_paths import check_inside, grid_truth, silences, simulate_paths
from occlog.simulate.world.world import CANDIDATES, Draws, Ground, Motion, World, populate, walk

__all__ = [
    "ObserveConfig",
    "SoundConfig",
    "WorldConfig",
    "check_inside",
    "grid_truth",
    "observe",
    "observe_arrays",
    "silences",
    "simulate_paths",
    "simulate_truth",
    "world_config",
]

CHUNK_STEPS = 256
"""Steps computed and yielded at a time; random numbers are drawn for whole chunks, so do not change it."""

START_NS = 1_577_836_800_000_000_000
"""Time of the first step unless the configuration says otherwise: 2020-01-01T00:00:00Z."""

METRES = {"m": 1.0, "ft": 0.3048, "in": 0.0254}


@dataclass(frozen=True)
class WorldConfig:
    """How many objects move, and how; lengths in the scene's unit.

    Speed, noise and change of destination are per second, so that they keep their
    meaning when the step changes.  The defaults are the reference scene of [Ercan]:
    speed 1 and noise 0.33 per step of one second.
    """

    steps: int = 4000  # times simulated, the start included
    step_s: float = 1.0
    targets: int = 1
    occluders: int = 0
    diameter: float = 3.33  # of every object; centres keep this distance
    speed: float = 1.0  # length of the way without noise in a second
    sigma: float = 0.33  # noise per axis gathered in a second; a step has sigma sqrt(step_s)
    redirect: float = 0.095  # probability of a new destination within a second; 0: plain random waypoints
    clearance: float = 0.0  # centres keep this distance from walls and static occluders
    z: float = math.nan  # height of the objects' reference point; NaN: not known
    start_ns: int = START_NS

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name != "z" and not math.isfinite(value):
                raise InputError(f"simulate: {f.name} is {value}, must be a finite number")
        checks = {
            "steps": self.steps >= 1,
            "step_s": self.step_s >= 1e-6,
            "targets": self.targets >= 0,
            "occluders": self.occluders >= 0,
            "diameter": self.diameter > 0,
            "speed": self.speed > 0,
            "sigma": self.sigma >= 0,
            "redirect": 0 <= self.redirect <= 1,
            "clearance": self.clearance >= 0,
        }
        limits = {"steps": "at least 1", "step_s": "at least 1e-6", "diameter": "above 0", "speed": "above 0"}
        for name, good in checks.items():
            if not good:
                limit = limits.get(name, "in [0, 1]" if name == "redirect" else "at least 0")
                raise InputError(f"simulate: {name} is {getattr(self, name)}, must be {limit}")
        if not self.targets + self.occluders:
            raise InputError("simulate: targets and occluders are both 0; give at least one object")

    @property
    def motion(self) -> Motion:
        """The same, per step."""
        return Motion(
            step=self.speed * self.step_s,
            sigma=self.sigma * math.sqrt(self.step_s),
            redirect=-math.expm1(self.step_s * math.log1p(-self.redirect)) if self.redirect < 1 else 1.0,
            diameter=self.diameter,
        )


def world_config(length_unit: str) -> WorldConfig:
    """Default configuration for a scene's length unit.

    `unit`: the reference scene of [Ercan].  Metres, feet and inches: people 0.5 m wide who
    walk at 1.2 m/s, at 10 steps a second, and change their mind every 10 s on average.
    """
    if length_unit not in METRES:
        return WorldConfig()
    metre = 1.0 / METRES[length_unit]
    people = WorldConfig(steps=600, step_s=0.1, redirect=0.095, z=0.9 * metre)
    return replace(people, diameter=0.5 * metre, speed=1.2 * metre, sigma=0.05 * metre, clearance=0.25 * metre)


def ground(scene: Scene, clearance: float) -> Ground:
    """Where objects may be in a scene."""
    walls = [o.polygon for o in scene.occluders] + pockets(scene.region)
    return Ground(np.ascontiguousarray(scene.region, dtype=np.float64), *pack_polygons(walls), clearance)


def simulate_truth(scene: Scene, config: WorldConfig, seed: int, start: Floats | None = None) -> Iterator[Truth]:
    """True places of all objects, chunk after chunk: targets are numbered 0, 1, ..., occluders after them.

    An object's noise depends on seed and number only, not on how many others there are
    or how many steps are asked for.

    Args:
        scene: its room (or the region around its sensors) bounds the world.
        config: numbers, speeds, times.
        seed: of all random numbers.
        start: (n, 2) places of all objects at the first step; None: random ones.

    Returns:
        Tables of up to CHUNK_STEPS steps; time k is `start_ns + round(k step_s)`.
        InputError if the objects do not fit into the room.
    """
    floor, n = ground(scene, config.clearance), config.targets + config.occluders
    world = _first(floor, n, config, seed)
    world = world if start is None else world._replace(xy=start.copy())
    generators = [[generator(seed, Stage.WORLD_MOTION, i, kind) for kind in range(3)] for i in range(n)]
    path = world.xy[None]
    for first in range(0, config.steps, CHUNK_STEPS):
        world, walked, _ = walk(world, floor, config.motion, _draw(generators))
        places = np.concatenate([path, walked[:-1]])[: config.steps - first]
        path = walked[-1:]
        yield _truth(places, first, config)


def _first(floor: Ground, n: int, config: WorldConfig, seed: int) -> World:
    try:
        return populate(n, floor, config.diameter, generator(seed, Stage.WORLD_START))
    except ValueError as error:
        raise InputError(f"simulate: {error}; use fewer or smaller objects, or a larger room") from error


def _draw(generators: list[list[np.random.Generator]]) -> Draws:
    """Random numbers of one chunk, each object's from its own generators."""
    c, n = CHUNK_STEPS, len(generators)
    draws = Draws(np.empty((c, n, 2)), np.empty((c, n)), np.empty((c, n, CANDIDATES, 2)))
    for i, (noise, chance, places) in enumerate(generators):
        draws.noise[:, i] = noise.standard_normal((c, 2))
        draws.chance[:, i] = chance.random(c)
        draws.places[:, i] = places.random((c, CANDIDATES, 2))
    return draws


def _truth(places: Floats, first: int, config: WorldConfig) -> Truth:
    """Table of (C, n, 2) places whose first step is number `first`."""
    c, n = places.shape[:2]
    ids = np.arange(n)
    steps = np.rint(np.arange(first, first + c) * (config.step_s * 1e9)).astype(np.int64)
    target = np.tile(ids < config.targets, c)
    return Truth.of(
        t_ns=np.repeat(config.start_ns + steps, n),
        target_id=np.tile(ids, c).astype(np.int32),
        role=np.where(target, "target", "occluder"),
        x=places[:, :, 0].ravel(),
        y=places[:, :, 1].ravel(),
        z=np.full(c * n, config.z),
    )
