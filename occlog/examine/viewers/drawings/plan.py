"""What does not move: the floor, walls, static occluders and what they hide, names of sensors."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from occlog.array_types import Floats
from occlog.examine.viewers.drawings.sensors import placed
from occlog.examine.viewers.drawings.shapes import (
    FLOOR,
    GREY,
    PILLAR,
    SHADOW,
    WALL,
    Fill,
    Line,
    Text,
    Thing,
    at_height,
    fan,
    triangles,
)
from occlog.records.scene import Occluder, Scene

if TYPE_CHECKING:
    from shapely import Polygon

NAME_SIZE = 0.25
"""Height of the name of a sensor or an occluder [m]."""
REACH = 60.0
"""How far shadows go where no room ends them [m]."""
LIFTED = 0.01
"""Shadows lie this far above the floor, so that viewers draw them over it [m]."""


def plan(scene: Scene, metres: float) -> list[Thing]:
    """The plan [m]; `metres` is the length of the scene's unit."""
    things: list[Thing] = []
    if scene.room is not None:
        room = metres * scene.room
        things.append(Thing("room", lines=[_outline(room, 0.0)], fills=[Fill(triangles(room, 0.0), FLOOR)]))
    things += [_prism(occluder, metres) for occluder in scene.occluders]
    for sensor in placed(scene):
        place = metres * sensor.position
        foot = np.array([[*place[:2], 0.0], place])
        lines = [Line(foot, GREY, 1.0, dashed=True)] if place[2] > 0 else []
        name = Text(place + np.array([0.0, 0.0, NAME_SIZE]), sensor.name, NAME_SIZE, WALL)
        things.append(Thing(f"sensor {sensor.name}", lines=lines, texts=[name]))
    return things


def _outline(polygon: Floats, z: float) -> Line:
    return Line(at_height(np.vstack([polygon, polygon[:1]]), z), WALL, 2.0)


def _prism(occluder: Occluder, metres: float) -> Thing:
    base, height = metres * occluder.polygon, metres * occluder.height
    ring = np.vstack([base, base[:1]])
    walls = []
    for a, b in itertools.pairwise(ring):
        low, high = at_height(np.array([a, b]), 0.0), at_height(np.array([a, b]), height)
        walls += [low[0], low[1], high[1], low[0], high[1], high[0]]
    posts = [Line(np.array([[*corner, 0.0], [*corner, height]]), WALL, 1.0) for corner in base]
    lines = [_outline(base, 0.0), _outline(base, height), *posts]
    name = Text(np.array([*base.mean(axis=0), height + NAME_SIZE]), occluder.name, NAME_SIZE, WALL)
    fills = [Fill(np.array(walls), PILLAR), Fill(triangles(base, height), PILLAR)]
    return Thing(f"occluder {occluder.name}", lines, fills=fills, texts=[name])


def static_shadows(scene: Scene, metres: float) -> list[Thing]:
    """The parts of the floor behind static occluders, for each camera [m]."""
    things = []
    room = walls(scene, metres)
    for camera in (c for c in scene.cameras if c.placed):
        eye = (metres * camera.position)[None]
        found = [shadows(eye, metres * o.polygon[None], metres * np.array([o.height]), room) for o in scene.occluders]
        fills = [Fill(fan(shape, LIFTED), SHADOW) for (shape,) in found if shape is not None]
        if fills:
            things.append(Thing(f"static {camera.name}", fills=fills))
    return things


def walls(scene: Scene, metres: float) -> Polygon | None:
    """What ends shadows: the convex hull of the room [m]; None where there is no room."""
    import shapely

    return None if scene.room is None else shapely.convex_hull(shapely.MultiPoint(metres * scene.room))


def shadows(eyes: Floats, bases: Floats, heights: Floats, room: Polygon | None) -> list[Floats | None]:
    """(k, 2) convex part of the floor that each upright prism hides from its eye, its own base with it [m].

    A prism as high as the eye hides all behind it, up to the walls; a lower one as far as the floor is seen again
    over its top. None where there is no such part.

    Args:
        eyes: (n, 3).
        bases: (n, K, 2) polygons, of which the convex hulls count.
        heights: (n,) of the prisms, > 0.
        room: what ends the shadows (see `walls`).
    """
    import shapely

    feet, polygon = eyes[:, None, :2], shapely.GeometryType.POLYGON
    hulls = shapely.convex_hull(shapely.multipoints(shapely.points(bases)))
    there = (shapely.get_type_id(hulls) == polygon) & ~shapely.contains(hulls, shapely.points(eyes[:, :2]))
    away = bases - feet
    grown = REACH / np.maximum(np.linalg.norm(away, axis=2), 1e-9)
    over = eyes[:, 2] > heights
    seen_again = eyes[over, 2] / (eyes[over, 2] - heights[over])
    grown[over] = np.minimum(grown[over], seen_again[:, None])
    both = np.concatenate([bases, feet + np.maximum(grown, 1.0)[:, :, None] * away], axis=1)
    areas = shapely.convex_hull(shapely.multipoints(shapely.points(both)))
    if room is not None:
        areas = shapely.intersection(areas, room)
    there &= (shapely.get_type_id(areas) == polygon) & ~shapely.is_empty(areas)
    rings = shapely.get_exterior_ring(areas)
    return [shapely.get_coordinates(ring)[:-1] if ok else None for ring, ok in zip(rings, there.tolist(), strict=True)]
