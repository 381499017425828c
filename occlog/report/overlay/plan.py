"""The floor plan beside the images: who is where, how surely, where from, and which cameras see them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from occlog.array_types import Bytes, Floats
from occlog.examine.viewers.drawings.people import Crowd, Person, name_of
from occlog.examine.viewers.drawings.sensors import placed
from occlog.examine.viewers.drawings.shapes import rim
from occlog.records.scene import Camera, Scene

from .draw import WHITE, Box, Way, bar, colour_of, draw_way, label

GROUND, FLOOR, WALL, PILLAR = (24, 24, 24), (44, 42, 40), (170, 165, 160), (96, 92, 88)
MARGIN = 0.06
"""Of the plan, around what is drawn, as a share of its size."""
MARK = 7.0
"""Size of a camera's mark [px]."""


class Plan:
    """Draws the plan of a scene into pictures of one size."""

    def __init__(self, scene: Scene, metres: float, size: tuple[int, int], ranks: Mapping[int, int]) -> None:
        """Fit what does not move into the picture.

        Args:
            scene: with a room, or sensors around which the plan is.
            metres: length of the scene's unit.
            size: width and height of the picture under its bar [px].
            ranks: place of each target among all by identity.
        """
        self._ranks, self._metres = ranks, metres
        places = [metres * sensor.position[:2] for sensor in placed(scene)]
        corners = [metres * scene.surroundings] if scene.room is not None or len(places) < 2 else []
        everything = np.vstack([*corners, *places])
        low, high = everything.min(axis=0), everything.max(axis=0)
        free = (1.0 - 2.0 * MARGIN) * np.array(size)
        self._scale = float((free / np.maximum(high - low, 1e-9)).min())
        self._middle, self._centre = 0.5 * (low + high), 0.5 * np.array(size) - 0.5
        self._sensors = {sensor.name: self._at(metres * sensor.position[:2]) for sensor in placed(scene)}
        self._still, self._names = self._draw_still(scene, size)

    def draw(self, crowd: Crowd, truth: Sequence[Floats], t_ns: int, seconds: float) -> Bytes:
        """(BAR + height, width, 3) the plan at a time, under a bar that says the time since the start.

        Args:
            crowd: estimates.
            truth: (2,) true places [m].
            t_ns: the time.
            seconds: since the start.
        """
        picture, taken = self._still.copy(), list(self._names)
        people = crowd.at(t_ns)
        for person in people:
            self._draw_sight(picture, person)
        for person in people:
            colour = colour_of(self._ranks.get(person.target, person.target))
            trail = crowd.trail(person.target)
            if len(trail) > 1:
                draw_way(picture, Way(self._at(trail), person.target, 1), 1.0, colour)
            if np.isfinite(person.covariance).all():
                ring = self._at(rim(person.xy, person.covariance))
                draw_way(picture, Way(ring, person.target, 2, person.unsure), 1.0, colour)
        for place in truth:
            cv2.drawMarker(picture, _pixel(self._at(place)), WHITE, cv2.MARKER_TILTED_CROSS, 9, 1, cv2.LINE_AA)
        for person in people:
            colour = colour_of(self._ranks.get(person.target, person.target))
            x, y = self._at(person.xy).tolist()
            cv2.circle(picture, _pixel(self._at(person.xy)), 4, colour, cv2.FILLED, cv2.LINE_AA)
            label(picture, name_of(person), (x, y - 8), colour, taken)
        return np.vstack([bar(f"plan   {seconds:.1f} s", picture.shape[1]), picture])

    def _draw_sight(self, picture: Bytes, person: Person) -> None:
        colour = colour_of(self._ranks.get(person.target, person.target))
        dim = tuple(round(0.45 * c + 0.55 * g) for c, g in zip(colour, FLOOR, strict=True))
        for name in sorted(person.seen_by or ()):
            if name in self._sensors:
                ends = np.array([self._sensors[name], self._at(person.xy)])
                draw_way(picture, Way(ends, person.target, 1), 1.0, (dim[0], dim[1], dim[2]))

    def _at(self, points: Floats) -> Floats:
        """Pixels of places [m]; y goes up."""
        return np.asarray(self._centre + self._scale * (points - self._middle) * [1.0, -1.0])

    def _draw_still(self, scene: Scene, size: tuple[int, int]) -> tuple[Bytes, list[Box]]:
        """Floor, walls, occluders and sensors; and where their names are."""
        picture = np.full((size[1], size[0], 3), GROUND, dtype=np.uint8)
        shapes = [(scene.room, FLOOR)] if scene.room is not None else []
        shapes += [(occluder.polygon, PILLAR) for occluder in scene.occluders]
        for polygon, colour in shapes:
            corners = np.rint(self._at(self._metres * polygon)).astype(np.int32)[:, None]
            cv2.fillPoly(picture, [corners], colour, cv2.LINE_AA)
            cv2.polylines(picture, [corners], True, WALL, 1, cv2.LINE_AA)
        taken: list[Box] = []
        for sensor in placed(scene):
            at = self._sensors[sensor.name]
            if isinstance(sensor, Camera):
                corners = np.rint(at + _mark(sensor.yaw)).astype(np.int32)[:, None]
                cv2.fillPoly(picture, [corners], WALL, cv2.LINE_AA)
            else:
                cv2.circle(picture, _pixel(at), 4, WALL, cv2.FILLED, cv2.LINE_AA)
            label(picture, sensor.name, (float(at[0]), float(at[1]) - 6), FLOOR, taken)
        return picture, taken


def _mark(yaw: float) -> Floats:
    """(3, 2) corners of a camera's mark around its place, which opens to where it looks [px]."""
    c, s = math.cos(yaw), -math.sin(yaw)
    ahead, aside = np.array([c, s]), np.array([-s, c])
    return MARK * np.array([0.0 * ahead, ahead + 0.6 * aside, ahead - 0.6 * aside])


def _pixel(at: Floats) -> tuple[int, int]:
    return round(float(at[0])), round(float(at[1]))
