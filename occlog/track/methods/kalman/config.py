"""Settings of methods `ekf`, `ukf` and `iekf`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting
from occlog.track.smoothing_and_lag import LagConfig

ALL, VISIBLE = "all", "visible"
"""Which sigma points count."""
NONE, DESCENT, MULTISTART = "none", "descent", "multistart"
"""Search for the MAP estimate."""


@dataclass(frozen=True)
class WalkConfig(Settings):
    """Settings of the walking motion of targets and of track loss; lengths in the scene's unit, times in seconds."""

    # The first two moments of a walk by waypoints ([Ercan] Sec. 4.1)
    rms_speed: float = setting(
        1.0,
        "Usual speed (RMS) of targets: each velocity axis has this over the root of two as its standard deviation.",
        unit="length/s",
        above=0,
        people=1.2,
    )
    velocity_time_constant_s: float = setting(
        10.0,
        "Time constant of the velocity: mean time until a target changes its direction. Shorter values follow "
        "turns and predict less far.",
        unit="s",
        above=0,
        people=1.0,
    )
    process_noise_position: float = setting(
        0.33,
        "Process noise of the position per axis, accumulated over 1 s. Larger values follow manoeuvres and widen "
        "covariances.",
        unit="length",
        at_least=0,
        people=0.1,
    )
    gate: float = setting(
        5.0,
        "Gate: bearings with an innovation of more standard deviations are rejected. Smaller values reject more "
        "outliers and lose manoeuvring targets.",
        above=0,
    )
    max_gap_s: float = setting(60.0, "Reinitialise after more than this time without measurements.", unit="s", above=0)
    track_loss_count: int = setting(
        6, "Reinitialise when bearings outside the gate outnumber those inside by this count; 0: never.", at_least=0
    )


@dataclass(frozen=True)
class KalmanConfig(LagConfig, WalkConfig):
    """Settings common to the methods `ekf`, `ukf` and `iekf`; lengths in the scene's unit, times in seconds."""

    start: tuple[float, ...] | None = setting(
        None,
        "Initial position X, Y and standard deviation SIGMA.",
        unit="length",
        counts=(3,),
        nothing="triangulated from the first bearings",
    )
    false_bearing_probability: float = setting(
        0.01,
        "Initial probability that a labelled bearing is false; it is learned. 0: all within the gate are true.",
        at_least=0,
        at_most=0.5,
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text): the standard deviation in `start` is above 0."""
        yield "start", self.start is None or self.start[2] > 0, "X,Y,SIGMA, SIGMA > 0"


@dataclass(frozen=True)
class EkfConfig(KalmanConfig):
    """Settings of method `ekf`, the extended Kalman filter."""

    OWNER: ClassVar[str] = "ekf"


@dataclass(frozen=True)
class UkfConfig(KalmanConfig):
    """Settings of method `ukf`, the unscented Kalman filter."""

    OWNER: ClassVar[str] = "ukf"

    sigma_points: str = setting(
        ALL,
        "Sigma points used in the update: `all` in front of the camera, or only those `visible` to it (past walls "
        "and static occluders, in the field of view).",
        choices=(ALL, VISIBLE),
    )


@dataclass(frozen=True)
class IekfConfig(KalmanConfig):
    """Settings of method `iekf`, the iterated extended Kalman filter."""

    OWNER: ClassVar[str] = "iekf"

    visibility_constraint: str = setting(
        MULTISTART,
        "Constraint that a detected target is visible to the cameras that detect it: `none`; search the mode "
        "from the prediction alone (`descent`), or also from intersections of bearings (`multistart`).",
        choices=(NONE, DESCENT, MULTISTART),
    )
    max_iterations: int = setting(20, "Maximum Gauss-Newton iterations per start.", at_least=1)
