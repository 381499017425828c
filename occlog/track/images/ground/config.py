"""Settings of `occlog ground`, the way from tracks in images to tracks in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from occlog.records.scene import Scene
from occlog.settings import check_settings

HEIGHT = {"m": 0.9, "ft": 3.0, "in": 35.0}
"""Height of the middle of a person by length unit."""
HEIGHT_SIGMA = {"m": 0.1, "ft": 0.35, "in": 4.0}
"""Standard deviation of it."""


@dataclass(frozen=True)
class GroundConfig:
    """Lengths in the scene's unit; None: by the unit, see `in_scene`."""

    height: float | None = None  # of a target's middle, for one that a single view shows; 0: such times have no row
    height_sigma: float | None = None  # its standard deviation
    model_share: float = 0.25  # standard deviation by which an ellipse's centre is off the target's, of its half axes
    gate: float = 1e-3  # chance at which a time whose views are all right is said to have one that is wrong
    min_crossing_deg: float = 5.0  # sight lines that cross at smaller angles give no place
    window_s: float = 0.0  # frames at most this far apart are of one time

    def __post_init__(self) -> None:
        check_settings(
            self,
            "ground",
            (
                ("height", self.height is None or self.height >= 0, "at least 0"),
                ("height_sigma", self.height_sigma is None or self.height_sigma > 0, "above 0"),
                ("model_share", self.model_share >= 0, "at least 0"),
                ("gate", 0 < self.gate < 1, "between 0 and 1"),
                ("min_crossing_deg", 0 < self.min_crossing_deg < 90, "between 0 and 90"),
                ("window_s", self.window_s >= 0 and math.isfinite(self.window_s), "at least 0"),
            ),
        )


def in_scene(config: GroundConfig, scene: Scene) -> GroundConfig:
    """Fill in the settings that depend on the scene's length unit; an unknown unit has no height."""
    unit = scene.length_unit
    height = HEIGHT.get(unit, 0.0) if config.height is None else config.height
    sigma = config.height_sigma
    if sigma is None:
        sigma = HEIGHT_SIGMA.get(unit, 0.1 * height or 1.0)
    return replace(config, height=height, height_sigma=sigma)
