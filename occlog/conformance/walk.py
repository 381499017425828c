"""The walk that plug-ins are tried with: one target past three sensors, and what may happen to it on the way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Floats
from occlog.plugins.interface import Moment
from occlog.records.scene import MicrophoneArray, Scene

NAMES = ("north", "east", "west")
PLACES = np.array([[0.0, 40.0], [45.0, -5.0], [-40.0, 0.0]])  # [m]
START_NS = 1_790_000_000 * NS  # in 2026
STEP_NS = NS // 2
SIGMA_RAD = float(np.radians(1.0))
MOMENTS = 40


@dataclass(frozen=True)
class Walk:
    """A walk, seen by sensors; as it is, all of them see the target at all times.

    Attributes:
        moments: how many.
        start_ns: time of the first.
        sensors: places in `NAMES` of the sensors that look, in the order of rows.
        turn: the world is turned by this angle about its origin [rad].
        shift: and then shifted.
        scale: and its unit of length is 1/scale metres.
    """

    moments: int = MOMENTS
    start_ns: int = START_NS
    sensors: tuple[int, ...] = (0, 1, 2)
    turn: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0

    def at(self, xy: Floats) -> Floats:
        """(..., 2) places of the plain walk [m] in this one's world."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return np.asarray(self.scale * (xy @ np.array([[c, s], [-s, c]]) + np.array(self.shift)))

    @property
    def truth(self) -> Floats:
        """(moments, 2) true places."""
        t = np.arange(self.moments) * (STEP_NS / NS)
        return self.at(np.column_stack([-10.0 + 0.5 * t, 5.0 + 2.0 * np.sin(0.3 * t)]))

    @property
    def scene(self) -> Scene:
        """The sensors."""
        places = self.at(PLACES)
        arrays = (MicrophoneArray(n, np.array([*xy, 0.0]), planar=True) for n, xy in zip(NAMES, places, strict=True))
        return Scene(arrays=tuple(arrays), length_unit="m" if self.scale == 1.0 else "cm")

    def __iter__(self) -> Iterator[Moment]:
        """The moments, made one after the other; errors of a sensor are the same whoever else looks."""
        noise = np.random.default_rng(5)
        places, own = self.at(PLACES), list(self.sensors)
        for n, xy in enumerate(self.truth):
            away = xy - places[own]
            error = noise.normal(0.0, SIGMA_RAD, len(NAMES))[own]
            bearing = np.arctan2(away[:, 1], away[:, 0]) + error
            yield Moment(
                t_ns=self.start_ns + n * STEP_NS,
                sensors=tuple(NAMES[k] for k in own),
                places=places[own].copy(),
                bearings=(bearing + np.pi) % (2 * np.pi) - np.pi,
                sigma=np.full(len(own), SIGMA_RAD),
            )


PLAIN = Walk()
FEW = replace(PLAIN, moments=12)


def blind(moment: Moment) -> Moment:
    """The moment in which all sensors look and nobody sees the target."""
    unknown = np.full(len(moment.bearings), np.nan)
    return moment._replace(bearings=unknown, sigma=unknown.copy())


def nobody(moment: Moment) -> Moment:
    """The moment in which no sensor looks."""
    return moment._replace(sensors=(), places=np.zeros((0, 2)), bearings=np.zeros(0), sigma=np.zeros(0))


def later(moment: Moment, seconds: float) -> Moment:
    """The moment at another time."""
    return moment._replace(t_ns=moment.t_ns + round(seconds * NS))
