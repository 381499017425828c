"""Settings of method `joint`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import option_setting, setting
from occlog.track.methods.kalman.config import WalkConfig
from occlog.track.smoothing_and_lag import LagConfig


@dataclass(frozen=True)
class JointConfig(LagConfig, WalkConfig):
    """Settings of method `joint`; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "joint"

    particles: int = option_setting(
        1000,
        "Particles, each with the states of all objects. The number needed grows fast with the number of objects.",
        at_least=2,
    )
    detection_probability: float = setting(0.99, "Detection probability P_D of an unoccluded object.", above=0, below=1)
    false_alarm_probability: float = setting(
        1e-4,
        "False alarm probability P_F of a sensor that did not detect an object.",
        above=0,
        below=1,
    )
    occluder_diameter: float = setting(
        3.33, "Diameter of the objects, which occlude one another.", unit="length", above=0, people=0.5
    )
