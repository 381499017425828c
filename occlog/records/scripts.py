"""Scripted targets: where they start, how they move, and when they make a sound.

Times are seconds after the first step of the recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Triple = tuple[float, float, float]

PLANES: dict[str, tuple[int, int]] = {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}
"""Axes of each plane; a turn is positive from the first towards the second."""


def to_ns(seconds: float) -> int:
    """Whole nanoseconds, so that a time that a step should meet is met."""
    return round(seconds * 1e9)


@dataclass(frozen=True)
class Segment:
    """How a target moves for a while; constant velocity where nothing else is said."""

    from_s: float
    until_s: float = math.inf
    lateral: float = 0.0  # acceleration at a right angle to the velocity in the plane [length/s^2]: a turn
    plane: str = "xy"
    acceleration: Triple = (0.0, 0.0, 0.0)  # [length/s^2]
    velocity: Triple | None = None  # taken on at the start of the segment [length/s]


@dataclass(frozen=True)
class ScriptedTarget:
    """One object; it is there from `from_s` to `until_s`, both included."""

    id: int
    position: Triple  # at from_s; z NaN: not known
    velocity: Triple = (0.0, 0.0, 0.0)
    role: Literal["target", "occluder"] = "target"
    from_s: float = 0.0
    until_s: float = math.inf
    noise_density: float = 0.0  # variance of the velocity gathered in a second, for each axis [length^2/s^3]
    segments: tuple[Segment, ...] = ()  # in order of time, not overlapping
    silent: tuple[tuple[float, float], ...] = ()  # makes no sound from the first time up to the second


@dataclass(frozen=True)
class Script:
    """All targets by rising number, and how long and how often they are to be looked at, if the file says."""

    targets: tuple[ScriptedTarget, ...]
    length_unit: str | None = None
    seconds: float | None = None
    rate_hz: float | None = None

    @property
    def heights(self) -> bool:
        """Whether the height of any of them is known."""
        return any(not math.isnan(t.position[2]) for t in self.targets)
