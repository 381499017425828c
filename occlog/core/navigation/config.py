"""Settings of forces and of rules of motion, for robots that navigate and for people that avoid each other.

It loads nothing heavy, so that `--help` can read it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from occlog.settings import METRES, Settings, option_setting, setting

CUBIC_METRE = {unit: 0.1 / metres**3 for unit, metres in METRES.items()}
"""The default repulsion in each unit of length: with m = 1 and n = 2 it is a length to the third power."""


@dataclass(frozen=True)
class FieldSettings(Settings):
    """Constants of the potential field, and rules against collisions and oscillation ([Lee] Sec. 5.2.2).

    The defaults in a scene-specific unit are those of the printed example; those in metres, feet and inches let people
    and robots pass each other, and doors.
    """

    attraction: float = setting(
        0.5, "Strength c_att of the goal's potential; only its ratio to the repulsion counts.", above=0
    )
    attraction_power: int = setting(
        2,
        "Exponent m of the goal's potential; with 1 the goal attracts equally at all distances.",
        people=1,
        at_least=1,
    )
    repulsion: float = setting(5.0, "Strength c_rep of an obstacle's potential.", people=CUBIC_METRE, at_least=0)
    repulsion_power: int = setting(2, "Exponent n of an obstacle's potential.", at_least=1)
    influence_distance: float = option_setting(
        10.0, "Distance rho_0 from which obstacles repel.", unit="length", people=1.5, above=0
    )
    force: str = option_setting(
        "prevent",
        "Total force: `original` (Eq. 5.15), or `prevent`, which turns away from an obstacle in line with the "
        "goal before a step could reach it (Eq. 5.25).",
        choices=("original", "prevent"),
    )
    escape: str = option_setting(
        "inside",
        "Way out of an oscillation: `none`; `inside`: turn by a right angle if the next step could reach the obstacle "
        "(step 3.1); `outside`: if it is at most one more step away, turn by the angle at which the obstacle is just "
        "passed (step 3.2).",
        choices=("none", "inside", "outside"),
    )
    escape_angle: float | None = setting(
        None,
        "Angle by which the robot turns to escape from an oscillation.",
        unit="rad",
        at_least=0,
        at_most=math.pi,
        nothing="the largest of Eq. 5.31 or 5.32",
    )
    side: str = option_setting(
        "free",
        "Side to which a blocked path turns; `free`: where obstacles are farther, else nearer the goal, else left.",
        choices=("left", "right", "free"),
    )
    collinearity_tolerance: float = option_setting(
        0.1,
        "Robot, obstacle and goal are in line if the unit vectors of Eq. 5.18 differ by at most this; 0 is the "
        "printed equality, which rounding breaks.",
        at_least=0,
        at_most=2,
    )
    opposition_tolerance: float = option_setting(
        0.05,
        "Oscillation: total forces of two successive steps are opposite if the cosine of their angle is at most -1 "
        "plus this (Eq. 5.26). Larger values detect oscillations more readily.",
        at_least=0,
        below=1,
    )
