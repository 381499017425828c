"""Options of the fusion of detections, and its counts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from occlog.errors import UsageError
from occlog.measure.detections import PERSON_HEIGHT
from occlog.records.scene import Scene

SIGMA = {"m": 0.5, "ft": 1.6, "in": 20.0}
"""Spread about the prediction by length unit: about a person's width."""
SPEED = {"m": 1.5, "ft": 5.0, "in": 60.0}
ACCELERATION = {"m": 1.0, "ft": 10.0, "in": 1500.0}
OWN_SIGMA, OWN_SPEED, OWN_ACCELERATION = 3.33, 1.5, 1.0
"""The same in scenes with a unit of their own, where objects are 3.33 wide."""


@dataclass(frozen=True)
class FuseConfig:
    """Options of the fusion; lengths in the scene's unit."""

    sigma: float | None = None  # spread of a position about its prediction, [Lee] Eq. 4.20; None: SIGMA
    p_miss: float = 0.2  # P_M of a camera whose `detection` the scene does not give
    p_false: float = 0.2  # P_F of a camera whose `false_alarm` the scene does not give
    reach: float = 4.0  # a detection this many spreads from the prediction counts as missed
    gate: float = 3.0  # one this many standard deviations from the global position is removed
    hold: int = 5  # moments in a row without a declaration after which the prediction is dropped
    window_s: float = 0.0  # frames at most this far apart are of one moment
    min_crossing_deg: float = 5.0  # sight lines that cross at smaller angles give no place
    acceleration: float | None = None  # density of the dynamic model [length^2/s^3]
    speed: float | None = None  # of a target just found, per axis
    person_height: float | None = None  # None: PERSON_HEIGHT

    def __post_init__(self) -> None:
        for name in ("sigma", "reach", "gate", "acceleration", "speed", "person_height"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UsageError(f"fuse: {name} is {value}, must be a finite number above 0")
        for name in ("p_miss", "p_false"):
            if not 0 < getattr(self, name) < 1:
                raise UsageError(f"fuse: {name} is {getattr(self, name)}, must be between 0 and 1")
        if not (math.isfinite(self.window_s) and self.window_s >= 0):
            raise UsageError(f"fuse: window_s is {self.window_s}, must be a finite number of at least 0")
        if self.hold < 1:
            raise UsageError(f"fuse: hold is {self.hold}, must be at least 1")
        if not 0 < self.min_crossing_deg < 90:
            raise UsageError(f"fuse: min_crossing_deg is {self.min_crossing_deg}, must be between 0 and 90")


def in_scene(config: FuseConfig, scene: Scene) -> FuseConfig:
    """The options with what depends on the scene's unit filled in; `person_height` stays None in units of its own."""
    unit = scene.length_unit
    return FuseConfig(
        config.sigma or SIGMA.get(unit, OWN_SIGMA),
        config.p_miss,
        config.p_false,
        config.reach,
        config.gate,
        config.hold,
        config.window_s,
        config.min_crossing_deg,
        config.acceleration or ACCELERATION.get(unit, OWN_ACCELERATION),
        config.speed or SPEED.get(unit, OWN_SPEED),
        config.person_height or PERSON_HEIGHT.get(unit),
    )
