"""The world of [Ercan] Sec. 6: objects that walk to random waypoints and go around each other.

Every object walks straight towards its destination with constant speed plus noise
(regime MTD, Eq. 5).  It takes a new destination, uniform over the free floor (regime
CD), when it has arrived (the destination is less than a step away), when its next step
without noise would end in a static occluder or outside the room, and - the variant
"waypoints+" - with a fixed probability in every step.

The paper leaves open how objects go around each other.  Here the objects of a step move
one after another, each in turn first; an object whose step would bring its centre
closer than one diameter to another's, into a wall or out of the room turns its step by
15, 30, ... 180 degrees to either side and takes the first that is free, or stays.  So
objects never overlap, never leave the room and never enter a static occluder.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

from .step import Ground, Motion, place_free, walk_into

CANDIDATES = 8
"""Destinations drawn for each object and step; the first one that is free is taken if one is needed."""

ATTEMPTS = 20_000
"""Places tried for each object before the room is called full."""


class World(NamedTuple):
    """Where the objects are and want to go."""

    xy: Floats  # (n, 2)
    destination: Floats  # (n, 2)
    step: int  # steps done


class Draws(NamedTuple):
    """Random numbers for C steps of n objects."""

    noise: Floats  # (C, n, 2) standard normal
    chance: Floats  # (C, n) uniform in [0, 1)
    places: Floats  # (C, n, CANDIDATES, 2) uniform in [0, 1)


def populate(n: int, ground: Ground, diameter: float, rng: np.random.Generator) -> World:
    """Put `n` objects at random free places, at least a diameter apart, each with a random destination.

    ValueError says how many were placed when the room is too full.
    """
    xy = np.empty((n, 2))
    for i in range(n):
        xy[i] = _free_place(ground, xy[:i], diameter, rng)
    none = np.empty((0, 2))
    destination = np.array([_free_place(ground, none, diameter, rng) for _ in range(n)]).reshape(n, 2)
    return World(xy, destination, 0)


def _free_place(ground: Ground, taken: Floats, diameter: float, rng: np.random.Generator) -> Floats:
    low, size = _bounds(ground.room)
    for _ in range(ATTEMPTS):
        place: Floats = low + size * rng.random(2)
        far = not len(taken) or bool(np.min(np.sum((taken - place) ** 2, axis=1)) >= diameter**2)
        if far and place_free(place[0], place[1], ground):
            return place
    raise ValueError(f"no free place found after {len(taken)} objects of diameter {diameter:g}")


def _bounds(room: Floats) -> tuple[Floats, Floats]:
    low = room.min(axis=0)
    return low, room.max(axis=0) - low


def walk(world: World, ground: Ground, motion: Motion, draws: Draws) -> tuple[World, Floats, Bools]:
    """Move all objects by as many steps as there are draws.

    Returns:
        The world after the last step, the path (C, n, 2) with the places after each step,
        and (C, n) bool: which objects took a new destination in that step.
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
        candidates=low + size * draws.places,
        first_step=world.step,
        ground=ground,
        motion=motion,
    )
    return World(xy, destination, world.step + len(path)), path, changed
