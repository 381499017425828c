"""Settings of methods `ekf`, `ukf` and `iekf`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting
from occlog.track.smoothing_and_lag import LagConfig

ALL, VISIBLE = "all", "visible"
"""Which sigma points count."""
IGNORE, DESCENT, STARTS = "ignore", "descent", "starts"
"""How the MAP estimate is looked for."""


@dataclass(frozen=True)
class WalkConfig(Settings):
    """How targets walk, and when a filter gives up; lengths in the scene's unit, times in seconds."""

    # The first two moments of a walk by waypoints ([Ercan] Sec. 4.1)
    speed: float = setting(
        1.0,
        "Usual speed: each axis of the velocity has this over the root of two as its standard deviation.",
        unit="length/s",
        above=0,
        people=1.2,
    )
    turn_s: float = setting(
        10.0,
        "Mean time in which a target changes its direction and its velocity is forgotten.",
        unit="s",
        above=0,
        people=1.0,
    )
    sigma_v: float = setting(
        0.33, "Motion noise per axis, gathered in a second.", unit="length", at_least=0, people=0.1
    )
    gate: float = setting(
        5.0, "Standard deviations within which a bearing agrees with the prediction; others are not used.", above=0
    )
    max_gap_s: float = setting(60.0, "After a longer time without a scan the filter begins anew.", unit="s", above=0)
    lost_after: int = setting(
        6, "Bearings more outside the gate than inside after which the filter begins anew; 0: never.", at_least=0
    )


@dataclass(frozen=True)
class KalmanConfig(LagConfig, WalkConfig):
    """Settings that the three filters share."""

    start: tuple[float, ...] | None = setting(
        None,
        "X, Y and SIGMA of the first position.",
        unit="length",
        counts=(3,),
        nothing="where the first bearings meet",
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """A spread is above 0: a Gaussian of no width takes nothing in."""
        yield "start", self.start is None or self.start[2] > 0, "X,Y,SIGMA, SIGMA > 0"


@dataclass(frozen=True)
class EkfConfig(KalmanConfig):
    """Settings of method `ekf`."""

    OWNER: ClassVar[str] = "ekf"


@dataclass(frozen=True)
class UkfConfig(KalmanConfig):
    """Settings of method `ukf`."""

    OWNER: ClassVar[str] = "ukf"

    points: str = setting(
        ALL,
        "Sigma points that count: all in front of the camera, or those alone that it can see past walls, static "
        "occluders and the ends of its field of view.",
        choices=(ALL, VISIBLE),
    )


@dataclass(frozen=True)
class IekfConfig(KalmanConfig):
    """Settings of method `iekf`."""

    OWNER: ClassVar[str] = "iekf"

    feasible: str = setting(
        STARTS,
        "Whether the target may be where the cameras that report it cannot see: it may (ignore), or not, and the most "
        "probable place is searched from the prediction alone (descent) or also from where bearings cross (starts).",
        choices=(IGNORE, DESCENT, STARTS),
    )
    iterations: int = setting(20, "Most steps of Gauss-Newton from each start.", at_least=1)
