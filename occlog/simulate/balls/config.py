"""Settings of the video of balls; the defaults are the synthetic video of [Qu] Sec. 4.1."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting

ORTHOGRAPHIC_DISTANCE_PX = 1e6
"""At this distance [px] positions and sizes in an image of 320 px change by less than 0.03 px with depth."""
MOTIONS = ("straight", "walk", "manoeuvre")
"""Motions of balls: straight on at constant speed, by steps at random, or with accelerations at random."""
FASTEST = 2.0
"""Balls that manoeuvre are at most this many times as fast as `speed`."""


@dataclass(frozen=True)
class BallsConfig(Settings):
    """Settings of the video of balls: number, motion, cameras and rendering; lengths in pixels."""

    OWNER: ClassVar[str] = "balls"

    frames: int = option_setting(400, "Number of frames of each camera.", at_least=1)
    width: int = setting(320, "Width of the images.", unit="px", at_least=16, at_most=8192)
    height: int = setting(240, "Height of the images.", unit="px", at_least=16, at_most=8192)
    balls: int = option_setting(6, "Number of balls.", at_least=1)
    radius: float = option_setting(22.0, "Radius of the balls.", unit="px", at_least=0.5)
    ball_speed: float = option_setting(
        3.0, "Mean displacement of a ball per frame, in space; balls have 0.5 to 1.5 times this.", unit="px", at_least=0
    )
    spin: float = option_setting(0.05, "Rotation of a ball per frame.", unit="rad", at_least=0, metavar="RAD")
    views: int = option_setting(
        2,
        "Number of cameras: the two of the paper, at a right angle and level, then some between them, tilted down.",
        at_least=1,
        at_most=6,
    )
    distance: float = option_setting(
        ORTHOGRAPHIC_DISTANCE_PX,
        "Distance of the cameras from the centre of the box. Near cameras see sizes change.",
        unit="px",
        at_least=1,
    )
    start_separated: bool = setting(
        True, "Start without occlusions of balls in the first frame.", option="--separated/--overlapping"
    )
    collide: bool = option_setting(False, "Balls bounce off each other.", shown="one flies through the other")
    noise: float = setting(
        1.5,
        "Image noise common to the colour channels: standard deviation in grey levels of 255.",
        at_least=0,
        option="--image-noise",
        metavar="LEVELS",
    )
    colour_noise: float = option_setting(
        1.0, "Image noise per colour channel: standard deviation in grey levels of 255.", at_least=0, metavar="LEVELS"
    )
    background_clutter: int = option_setting(6, "Background patches in the colours of the balls, per view.", at_least=0)
    ball_motion: str = option_setting(
        "straight",
        f"Straight on; a random walk with steps of standard deviation `speed` along each axis; or manoeuvres: "
        f"random accelerations, with a speed of at most {FASTEST:g} times `speed`.",
        choices=MOTIONS,
    )
    ball_acceleration: float = option_setting(
        1.0,
        "Manoeuvring balls: standard deviation of the velocity change per frame, along each axis.",
        unit="px",
        at_least=0,
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Constraints, each as setting, whether it holds, and allowed values.

        Cameras are outside the box of the balls, and balls that collide fly straight in between.
        """
        limit = self.width + self.height + 4 * self.radius
        yield "distance", self.distance > limit, f"above {limit:g}, outside the box"
        yield "ball_motion", self.ball_motion == "straight" or not self.collide, "straight for balls that collide"
