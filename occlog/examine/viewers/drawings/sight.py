"""What sensors look at: sight lines, which cameras were selected, and what people hide from cameras."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from occlog.array_types import Floats
from occlog.examine.viewers.drawings.people import Crowd, Palette, Person
from occlog.examine.viewers.drawings.plan import LIFTED, shadows, walls
from occlog.examine.viewers.drawings.sensors import placed
from occlog.examine.viewers.drawings.shapes import (
    CHOSEN,
    GREY,
    SHADOW,
    Column,
    Fill,
    Line,
    Thing,
    at_height,
    faded,
    fan,
    rim,
)
from occlog.records.scene import Camera, MicrophoneArray, Scene

MIDDLE = 0.5
"""Sight lines end at this share of a person's height."""
UNKNOWN_REACH = 8.0
"""Length of a sight line that is of no target whose place is known [m]."""
MARK = 0.3
"""Diameter of the mark of a camera that was selected [m]."""
_TURNS = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
AROUND = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])
"""(8, 2) corners of a person that throws a shadow, of radius 1."""


class Sight:
    """Draws what the sensors of a scene saw."""

    def __init__(self, scene: Scene, metres: float, palette: Palette, crowd: Crowd) -> None:
        """Take the scene, the length of its unit [m], the colours, and where targets are."""
        self._scene, self._metres, self._palette, self._crowd = scene, metres, palette, crowd
        self._sensors: Mapping[str, Camera | MicrophoneArray] = {sensor.name: sensor for sensor in placed(scene)}
        self._walls = walls(scene, metres)

    def lines(self, sensor: str, targets: Sequence[int], azimuths: Sequence[float]) -> list[Thing] | None:
        """Sight lines of one sensor and time.

        They end at the target; a dashed grey one leads to a target that the sensor looked for and did not see.

        Args:
            sensor: its name.
            targets: identities; -1: not known.
            azimuths: in the world [rad]; NaN: the sensor looked and did not see the target.

        Returns:
            None: the sensor is not in the scene, or its pose is not known.
        """
        known = self._sensors.get(sensor)
        if known is None:
            return None
        eye = self._metres * known.position
        things = []
        for n, (target, azimuth) in enumerate(zip(targets, azimuths, strict=True)):
            person = self._crowd.find(target)
            line = _missed(eye, person) if math.isnan(azimuth) else _seen(eye, azimuth, person, self._palette)
            if line is not None:
                things.append(Thing(f"{sensor} {n}", lines=[line]))
        return things

    def chosen(self, names: Iterable[str]) -> list[Thing]:
        """A mark at each camera that was selected."""
        things = []
        for name in names:
            if name in self._sensors:
                foot = self._metres * self._sensors[name].position - [0, 0, 0.5 * MARK]
                things.append(Thing(f"selected {name}", columns=[Column(foot, MARK, MARK, CHOSEN)]))
        return things

    def shadows(self, t_ns: int) -> list[Thing]:
        """The parts of the floor that people hide from each camera."""
        people = self._crowd.at(t_ns)
        cameras = [c for c in self._scene.cameras if c.placed]
        if not people or not cameras:
            return []
        middles = np.array([person.xy for person in people])
        radii = 0.5 * np.array([person.width for person in people])
        bases = middles[:, None] + radii[:, None, None] * AROUND
        heights = np.array([person.height for person in people])
        eyes = np.array([self._metres * camera.position for camera in cameras])
        n, m = len(cameras), len(people)
        shapes = shadows(np.repeat(eyes, m, axis=0), np.tile(bases, (n, 1, 1)), np.tile(heights, n), self._walls)
        things = []
        for k, camera in enumerate(cameras):
            own = [shape for shape in shapes[k * m : (k + 1) * m] if shape is not None]
            fills = [Fill(fan(shape, LIFTED), faded(SHADOW, 0.2)) for shape in own]
            if fills:
                things.append(Thing(f"behind people, from {camera.name}", fills=fills))
        return things


def _seen(eye: Floats, azimuth: float, person: Person | None, palette: Palette) -> Line:
    reach = UNKNOWN_REACH if person is None else float(np.linalg.norm(person.xy - eye[:2]))
    tip = eye[:2] + reach * np.array([np.cos(azimuth), np.sin(azimuth)])
    height = float(eye[2]) if person is None else MIDDLE * person.height
    colour = GREY if person is None else palette(person.target)
    return Line(np.array([eye, [*tip, height]]), faded(colour, 0.8), 1.5)


def _missed(eye: Floats, person: Person | None) -> Line | None:
    if person is None:
        return None
    return Line(np.array([eye, [*person.xy, MIDDLE * person.height]]), faded(GREY, 0.6), 1.0, dashed=True)


def moving_occluders(middles: Floats, covariances: Floats, metres: float) -> list[Thing]:
    """Ellipses of moving occluders as the tracker was told.

    Args:
        middles: (n, 2).
        covariances: (n, 2, 2).
        metres: length of their unit.
    """
    things = []
    for k, (middle, covariance) in enumerate(zip(middles, covariances, strict=True)):
        ring = rim(metres * middle, metres**2 * covariance)
        things.append(Thing(f"occluder {k}", lines=[Line(at_height(ring, 0.02), GREY, 1.5, dashed=True)]))
    return things
