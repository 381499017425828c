"""Tracking methods of bearings: what a filter is given, and what it gives back."""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Protocol

from numpy.random import Generator

from occlog.array_types import Floats
from occlog.records.scene import Scene
from occlog.settings import Settings


class Moment(NamedTuple):
    """What R sensors say of one target at one time.

    Attributes:
        t_ns: time [ns since the Unix epoch]; it never goes back.
        sensors: (R,) names; one may be there several times, with candidates that may be of anything.
        places: (R, 2) where they are, in the scene's unit of length.
        bearings: (R,) from +x towards +y [rad]; NaN: the sensor looked and did not see the target.
        sigma: (R,) standard deviations [rad]; NaN where the bearing is.
    """

    t_ns: int
    sensors: tuple[str, ...]
    places: Floats
    bearings: Floats
    sigma: Floats


class Place(NamedTuple):
    """Where a target is thought to be.

    Attributes:
        xy: (2,) in the scene's unit of length.
        covariance: (2, 2) of xy, symmetric and positive definite.
        velocity: (2,) per second; None: the method does not estimate it.
    """

    xy: Floats
    covariance: Floats
    velocity: Floats | None = None


class Filter(Protocol):
    """A tracking method of bearings (group `occlog.tracking_methods`): an object for each target.

    It draws random numbers from its generator alone, changes nothing that it is given, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, scene: Scene, settings: Settings, rng: Generator) -> None:
        """Nothing of the target is known yet."""

    def step(self, moment: Moment) -> Place | None:
        """Take a moment in; where the target is then, or None where that cannot be told yet."""
