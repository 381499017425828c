"""Settings of method `joint`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import setting
from occlog.track.methods.kalman.config import WalkConfig


@dataclass(frozen=True)
class JointConfig(WalkConfig):
    """Settings of method `joint`; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "joint"

    particles: int = setting(1000, "Particles, each with a place for every object.", at_least=2, option="--particles")
    detection: float = setting(
        0.99, "P_D: probability that a camera detects an object in plain view.", above=0, below=1
    )
    false: float = setting(
        1e-4,
        "P_F: probability that a sensor that did not detect an object reports it all the same.",
        above=0,
        below=1,
    )
    occluder_diameter: float = setting(3.33, "Diameter of an object.", unit="length", above=0, people=0.5)
