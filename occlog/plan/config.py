"""Settings of `occlog plan`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, like, setting
from occlog.simulate.config import WorldConfig
from occlog.track.methods.apf.config import ApfConfig

MAX_PEOPLE = 1000


@dataclass(frozen=True)
class PlanConfig(Settings):
    """Settings of walking people, accuracy of the map, and the criterion for positions; lengths in the scene's unit."""

    OWNER: ClassVar[str] = "plan"

    people: int | None = setting(
        None,
        "People beside the target, who hide it.",
        at_least=0,
        at_most=MAX_PEOPLE,
        option="--people",
        nothing="by `density`",
    )
    density: float = setting(
        0.0,
        "People beside the target to a square unit of the floor, where their number is not given.",
        at_least=0,
        option="--density",
        metavar="NUMBER",
    )
    diameter: float = like(WorldConfig, "diameter", "Of a person.")
    height: float | None = setting(
        None,
        "Of people who hide the target from cameras whose height is known.",
        unit="length",
        above=0,
        option="--height",
        metavar="LENGTH",
        nothing="no camera sees over them, as in `occlog simulate`",
    )
    z: float = setting(
        0.0, "Height of the target.", unit="length", at_least=0, people=0.9, option="--z", metavar="LENGTH"
    )
    speed: float = like(WorldConfig, "speed", "Of target and people.")
    sigma: float = like(WorldConfig, "sigma", "Noise of the motion per axis, gathered in a second.")
    redirect: float = like(
        WorldConfig,
        "redirect",
        "Probability of a new destination within a second, beside those on arrival.",
        at_most=None,
        below=1,
    )
    sigma_v: float = like(
        ApfConfig, "sigma_v", "Motion noise per axis, gathered in a second, that the filter expects; at least `sigma`."
    )
    sigma_a: float = like(
        ApfConfig, "sigma_a", "Noise of the velocity per axis, gathered in a second, that the filter expects."
    )
    rate_hz: float = setting(
        1.0,
        "Frames a second of sensors whose rate the scene does not say.",
        unit="Hz",
        people=10.0,
        above=0,
        at_most=1000,
        option="--rate",
        metavar="HZ",
    )
    window_s: float = setting(
        60.0,
        "How long the filter has followed a target when it comes to the place.",
        unit="s",
        people=8.0,
        above=0,
        at_most=3600,
    )
    cells: int = setting(400, "Places of the map, about.", at_least=4, at_most=100_000, option="--cells")
    draws: int = setting(
        16, "Walks through each place, each with a crowd.", at_least=4, at_most=10_000, option="--draws"
    )
    within: float | None = setting(
        None,
        "Tell the share of the floor whose expected error is below this.",
        unit="length",
        above=0,
        option="--within",
        metavar="LENGTH",
        nothing="not told",
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """The window has steps enough, and not too many."""
        steps = self.window_s * self.rate_hz
        yield "window_s", 2 <= steps <= 20_000, "2 to 20000 steps long"
