"""Settings of `occlog navigate`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.core.navigation.config import FieldSettings
from occlog.settings import option_setting, setting


@dataclass(frozen=True)
class NavigateConfig(FieldSettings):
    """A robot, its steps, and what counts as an obstacle; lengths in the scene's unit.

    The defaults in a scene-specific unit are those of the example printed in [Lee] Sec. 5.2.2.
    """

    OWNER: ClassVar[str] = "navigate"

    speed: float = option_setting(
        2.0**0.5,
        "Constant speed s_r of the robot.",
        unit="length/s",
        people=1.0,
        above=0,
        metavar="LENGTH",
        shown="1 m/s, or the square root of 2 in a scene-specific unit",
    )
    step_s: float = setting(
        1.0,
        "Time T_s between two changes of direction.",
        unit="s",
        people=0.1,
        at_least=1e-6,
        at_most=1e6,
        option="--step",
    )
    radius: float = option_setting(0.0, "Radius r_r of the robot.", unit="length", people=0.25, at_least=0)
    obstacle_radius: float = option_setting(
        0.0, "Radius r_o of tracked people.", unit="length", people=0.25, at_least=0
    )
    inflation_sigmas: float = setting(
        0.0, "Standard deviations of a track, along its widest axis, by which its obstacle is enlarged.", at_least=0
    )
    max_gap_s: float = setting(
        1.0, "Maximum gap between two rows of a track to interpolate.", unit="s", at_least=0, at_most=1e9
    )
    origin: str = option_setting(
        "centre",
        "Repulsive potentials depend on the distance to the `centre` of round obstacles and people, as in [Lee], or to "
        "their `border`.",
        people="border",
        choices=("centre", "border"),
    )
    prediction_horizon_s: float = setting(
        0.0,
        "People repel from their nearest predicted position within this time, at the velocity of the last step.",
        unit="s",
        people=1.0,
        at_least=0,
        at_most=3600,
        option="--prediction-horizon",
    )
    collision_guard: bool = setting(
        False,
        "Turn, or wait, instead of a step that would collide with people who keep their velocity; not in [Lee].",
        people=True,
        option="--collision-guard/--no-collision-guard",
    )
    shape: str = option_setting(
        "circle",
        "Static occluders repel as a `circle` about them, or by their nearest point, as a `polygon`, which "
        "traps robots at its sides; collisions are with the polygon in either case.",
        choices=("circle", "polygon"),
    )
    walls: bool = setting(True, "The walls of the room repel too.", option="--walls/--no-walls")
    goal_tolerance: float | None = option_setting(
        None,
        "Distance from the goal, in the scene's unit, at which it is reached.",
        unit="length",
        above=0,
        nothing="the length of a step",
    )
    max_steps: int = option_setting(2000, "Maximum number of steps.", at_least=1, at_most=10_000_000)

    @property
    def way(self) -> float:
        """Length of a step, s_r T_s."""
        return self.speed * self.step_s

    @property
    def near(self) -> float:
        """Distance at which the goal counts as reached."""
        return self.way if self.goal_tolerance is None else self.goal_tolerance
