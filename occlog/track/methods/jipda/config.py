"""Settings of method `jipda`; one set of defaults for all positions, frame rates and numbers of cameras."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import setting
from occlog.track.smoothing_and_lag import LagConfig


@dataclass(frozen=True)
class JipdaConfig(LagConfig):
    """Settings of method `jipda`; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "jipda"

    # Bodies
    height: float = setting(1.7, "Height of people, on average.", unit="length", above=0)
    sigma_height: float = setting(0.12, "Its standard deviation.", unit="length", above=0)
    width: float = setting(
        0.55, "Diameter of the cylinder that stands for a person, on average.", unit="length", above=0
    )
    sigma_width: float = setting(0.12, "Its standard deviation.", unit="length", above=0)

    apart: float = setting(
        0.22,
        "People do not walk through one another: two stand at a distance d with a probability that is multiplied by "
        "1 - exp(-d^2 / (2 apart^2)); 0: they may.",
        unit="length",
        at_least=0,
    )

    # Motion
    acceleration: float = setting(
        0.06,
        "Spectral density of people's acceleration, per axis, while they walk on.",
        unit="length^2/s^3",
        at_least=0,
    )
    manoeuvre: float = setting(1.0, "The same while they turn, stop or start.", unit="length^2/s^3", at_least=0)
    calm_s: float = setting(20.0, "They do so after so long on average, at first; it is learned.", unit="s", above=0)
    turn_s: float = setting(1.0, "It takes so long on average.", unit="s", above=0)
    bend_s: float = setting(
        6000.0,
        "They bend, fall, lie down or get up after so long on average, at first; it is learned.",
        unit="s",
        above=0,
    )
    bent_s: float = setting(2.0, "That takes so long on average.", unit="s", above=0)
    speed: float = setting(0.9, "Standard deviation of a new person's velocity, per axis.", unit="length/s", above=0)

    # Boxes
    edge_px: float = setting(3.0, "Standard deviation of a box's edge.", unit="px", above=0)
    looseness: float = setting(
        0.04, "Standard deviation of a box's size and place, as a share of its size.", at_least=0
    )

    # Detection
    detection: float = setting(
        0.8, "Probability at first that a camera detects a person in plain view; it is learned.", above=0, below=1
    )
    clutter: float = setting(0.5, "Boxes of nobody expected at first of a camera at a time; it is learned.", above=0)
    visible: bool = setting(True, "People are detected as far as others do not hide them; no: all alike.")

    # Existence
    stay_s: float = setting(60.0, "How long a person stays in sight of the cameras on average.", unit="s", above=0)
    confirm: float = setting(0.8, "A person is reported from this probability on that they exist.", above=0, below=1)
    die: float = setting(0.01, "Below this probability a person is given up.", above=0, below=1)

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Who is given up was reported before."""
        yield "die", self.die < self.confirm, "below confirm"
