"""What does not move: the floor, walls, static occluders and what they hide, names of sensors."""

from __future__ import annotations

import itertools

import numpy as np

from occlog.array_types import Floats
from occlog.records.scene import Occluder, Scene

from .sensors import placed
from .shapes import FLOOR, GREY, PILLAR, SHADOW, WALL, Fill, Line, Text, Thing, at_height, fan, triangles

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
    for camera in scene.cameras:
        if not camera.placed:
            continue
        eye = metres * camera.position
        shapes = [shadow(eye, metres * o.polygon, metres * o.height, scene, metres) for o in scene.occluders]
        fills = [Fill(fan(shape, LIFTED), SHADOW) for shape in shapes if shape is not None]
        if fills:
            things.append(Thing(f"static {camera.name}", fills=fills))
    return things


def shadow(eye: Floats, base: Floats, height: float, scene: Scene, metres: float) -> Floats | None:
    """(k, 2) convex part of the floor that an upright prism hides from a point, its own base with it [m].

    A prism as high as the eye hides all behind it, up to the walls; a lower one as far as the floor is seen again
    over its top.

    Args:
        eye: (3,).
        base: (K, 2) polygon, of which the convex hull counts.
        height: of the prism, > 0.
        scene: whose room ends the shadow.
        metres: length of the scene's unit.
    """
    import shapely

    hull = shapely.convex_hull(shapely.MultiPoint(base))
    if hull.geom_type != "Polygon" or hull.contains(shapely.Point(eye[:2])):
        return None
    away = base - eye[:2]
    far = REACH / np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    grown = far if eye[2] <= height else np.minimum(far, eye[2] / (eye[2] - height))
    both = np.vstack([base, eye[:2] + np.maximum(grown, 1.0)[:, None] * away])
    area = shapely.convex_hull(shapely.MultiPoint(both))
    if scene.room is not None:
        area = shapely.intersection(area, shapely.convex_hull(shapely.MultiPoint(metres * scene.room)))
    if area.geom_type != "Polygon" or area.is_empty:
        return None
    return np.asarray(area.exterior.coords)[:-1]
