"""The best that a filter and a smoother can do in a simulated world: particles move as the simulation's target does.

A bootstrap filter with the simulation's own steps and very many particles: slow, and of use only where one knows
how the target moves.  It is smoothed by the ancestry of its particles: those of a scan count by the weights of the
particles that come from them `LAG` scans later.  Destinations must change now and then by chance: those that last
until arrival run out, since a bootstrap filter draws none anew.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel
from occlog.filtering.particles import normalise_log_weights, systematic_ancestors
from occlog.records.scene import Scene
from occlog.records.tables import Bearings
from occlog.scans.grouping import BearingRows, scans_of
from occlog.simulate.config import WorldConfig
from occlog.simulate.stage import ground, motion_in_a_step
from occlog.simulate.world.waypoints import Ground, WaypointMotion, walk_into
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.model import likelihood, make_model, pack_scan

PARTICLES = 20_000
LAG = 10
"""Scans after which an estimate is smoothed; ancestries of so many particles last for about 20."""
CHOICES = 8
"""Destinations of each particle of which the first free one is taken, as in the simulation."""


def estimated(
    scene: Scene, bearings: Bearings, world: WorldConfig, seed: int, particles: int = PARTICLES
) -> tuple[Floats, Floats]:
    """(T, 2) filtered and (T, 2) smoothed estimates of one target that walks alone, at the simulation's steps.

    Args:
        scene: room and cameras.
        bearings: labelled, of target 0.
        world: how the target moves.
        seed: of all random numbers.
        particles: how many.
    """
    rng, floor = np.random.default_rng(seed), ground(scene, world.wall_clearance)
    motion = motion_in_a_step(world)._replace(diameter=0.0)
    model = make_model(scene, ApfConfig())
    low, size = scene.region.min(axis=0), np.ptp(scene.region, axis=0)
    xy = low + size * rng.random((particles, 2))
    destination = low + size * rng.random((particles, 2))
    found: list[Floats] = []
    smoothed: list[Floats] = []
    past: list[Floats] = []
    first = True
    for group in scans_of([bearings], scene, BearingRows({c.name for c in scene.cameras})):
        scan = group.of_target(0)
        if scan is None:
            continue
        if not first:
            _walk(xy, destination, floor, motion, low + size * rng.random((particles, CHOICES, 2)), rng)
        first = False
        log_weights = likelihood(model, xy, pack_scan(scan, model.read_px, True))
        weights, log_sum = normalise_log_weights(log_weights)
        if not math.isfinite(log_sum):
            raise ValueError(f"no particle agrees with the scan at {scan.t_ns} ns; use more particles")
        found.append(weights @ xy)
        past.append(xy.copy())
        if len(past) > LAG:
            smoothed.append(weights @ past.pop(0))
        drawn = systematic_ancestors(weights, particles, rng.random())
        xy, destination, past = xy[drawn], destination[drawn], [places[drawn] for places in past]
    return np.array(found), np.array([*smoothed, *(places.mean(axis=0) for places in past)])


def _walk(
    xy: Floats, destination: Floats, floor: Ground, motion: WaypointMotion, positions: Floats, rng: Generator
) -> None:
    """Move all particles by one step of the simulation, in place, as if each were alone."""
    noise = motion.sigma * rng.standard_normal((len(xy), 2))
    _alone(xy, destination, noise, rng.random(len(xy)), positions, floor, motion)


@kernel
def _alone(
    xy: Floats,
    destination: Floats,
    noise: Floats,
    chance: Floats,
    positions: Floats,
    floor: Ground,
    motion: WaypointMotion,
) -> None:
    path, changed = np.empty((1, 1, 2)), np.empty((1, 1), dtype=np.bool_)
    for p in range(xy.shape[0]):
        walk_into(
            path,
            changed,
            xy[p : p + 1],
            destination[p : p + 1],
            noise[p : p + 1].reshape((1, 1, 2)),
            chance[p : p + 1].reshape((1, 1)),
            positions[p : p + 1].reshape((1, 1, CHOICES, 2)),
            0,
            floor,
            motion,
        )
