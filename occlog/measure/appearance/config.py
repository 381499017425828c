"""Settings of `occlog appearance learn`, and of `occlog label` with a gallery."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting

MAX_LEVELS = 15
"""15 levels are 240 bins; m is at most 256 ([Lee] Sec. 5.2.1)."""


@dataclass(frozen=True)
class SightingConfig(Settings):
    """Settings for sightings of people, that is the assignment of boxes to tracks with viewing angles.

    Lengths are in the scene's unit.
    """

    OWNER: ClassVar[str] = "appearance"

    max_gap_s: float = setting(
        1.0,
        "Maximum gap between two rows of a track to interpolate.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--max-gap",
    )
    heading_window_s: float = setting(
        1.0,
        "Length of the time window about each row in which the velocity, so the heading, is estimated where tracks "
        "have no velocity.",
        unit="s",
        above=0,
        at_most=1e9,
        option="--heading-window",
    )
    min_speed: float = option_setting(
        0.3,
        "Minimum speed at which people face the direction of their motion; below it the viewing angle is unknown.",
        unit="length/s",
        at_least=0,
        metavar="SPEED",
    )
    person_height: float = option_setting(
        11.3,
        "Height of a person, by which the track is projected into the image to find its box.",
        unit="length",
        people=1.7,
        above=0,
    )
    iou_threshold: float = option_setting(
        0.3,
        "Minimum IoU (intersection over union) of a box with the box expected of a person at a track's position, for "
        "the box to be of that person. Tracks are not changed.",
        above=0,
        at_most=1,
        metavar="SHARE",
    )
    max_occlusion: float = option_setting(
        0.2,
        "Maximum occlusion: share of a box that boxes of nearer people may cover for it to be used.",
        at_least=0,
        at_most=1,
        metavar="SHARE",
    )
    min_pixels: int = option_setting(
        100,
        "Minimum number of pixels in the ellipse inscribed in a box, or in a region of views, for it to be used.",
        at_least=1,
        metavar="N",
    )


@dataclass(frozen=True)
class LearnConfig(SightingConfig):
    """Settings of an appearance gallery."""

    angle_step: float = option_setting(
        30.0,
        "Step between viewing angles from the front (0 degrees) to the back (180), a divisor of 180. 180: front and "
        "back alone; 360: angles are not distinguished.",
        unit="deg",
        above=0,
        at_most=360,
        metavar="DEG",
    )
    colour_levels: int = option_setting(
        8,
        "Levels of hue, saturation and brightness: L (L + 1) colours are distinguished.",
        at_least=2,
        at_most=MAX_LEVELS,
        metavar="L",
    )
    min_samples: int = option_setting(
        5, "Minimum number of boxes from which one viewing angle of a target is learned.", at_least=1, metavar="N"
    )

    def rules(self) -> list[tuple[str, bool, str]]:
        """Constraints, each as setting, whether it holds, and allowed values: the step divides 180 degrees, or is 360.

        The step is that of viewing angles.
        """
        steps = 180.0 / self.angle_step
        good = self.angle_step == 360.0 or (steps >= 1.0 and abs(steps - round(steps)) < 1e-9)
        return [("angle_step", good, "a divisor of 180 degrees, or 360")]

    @property
    def angles(self) -> int:
        """Number N of viewing angles ([Lee] 5.6); 1: not distinguished."""
        return 1 if self.angle_step == 360.0 else round(180.0 / self.angle_step) + 1


@dataclass(frozen=True)
class MatchConfig(SightingConfig):
    """Thresholds for assigning a box to a target of the gallery."""

    OWNER: ClassVar[str] = "match"

    min_similarity: float = option_setting(
        0.8,
        "Minimum similarity (Bhattacharyya coefficient without its bias) of a box to a target. Lower values match "
        "more boxes and mistake more.",
        at_least=0,
        at_most=1,
    )
