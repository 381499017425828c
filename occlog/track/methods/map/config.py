"""Settings of method `map`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

from occlog.settings import Settings, setting

LOSSES = ("mixture", "square", "huber", "cauchy")
PACKAGES = ("clarabel", "osqp")
"""Solvers of quadratic programs that are packages of their own."""
LEAST, MOST, FAR = 1e-9, 1e9, 1e12
"""Settings beyond these are slips, and cannot be computed with."""
POSITIVE: dict[str, Any] = {"at_least": LEAST, "at_most": MOST}
AT_LEAST_0: dict[str, Any] = {"at_least": 0.0, "at_most": MOST}


@dataclass(frozen=True)
class MapConfig(Settings):
    """Settings of method `map`; lengths in the scene's unit, times in seconds.

    They concern the motion model, the loss, constraints, the estimate, the search and the lag; each field has its help
    and range.
    """

    OWNER: ClassVar[str] = "map"

    # Motion, [Rahimi] Eq. 1; with a fitted model the first two are not used
    process_noise_velocity: float = setting(
        1.0,
        "Process noise of the velocity per axis, accumulated over 1 s. Smaller values smooth more; too small a "
        "value cuts corners.",
        unit="length/s",
        own=0.33,
        **POSITIVE,
    )
    process_noise_position: float = setting(
        0.0, "Process noise of the position per axis, accumulated over 1 s.", unit="length", own=0.33, **AT_LEAST_0
    )
    sigma_initial_velocity: float = setting(
        1.0, "Standard deviation of the initial velocity, per axis.", unit="length/s", **POSITIVE
    )
    start: tuple[float, ...] | None = setting(
        None,
        "Initial position X, Y and standard deviation SIGMA.",
        unit="length",
        nothing="uniform over the room or the visible region",
    )
    A: tuple[float, ...] | None = setting(
        None,
        "Fitted transition matrix: 16 numbers by rows, for the state x, vx, y, vy (from `occlog fit-motion`).",
        counts=(16,),
        nothing="no model",
    )
    Sigma: tuple[float, ...] | None = setting(
        None, "Fitted process noise covariance: 16 numbers by rows.", counts=(16,), nothing="no model"
    )
    model_step_s: float = setting(1.0, "Time step of the fitted model.", unit="s", **POSITIVE)

    # Measurements, [Rahimi] Sec. 4
    loss: str = setting(
        "mixture",
        "Loss of residuals: `mixture` of true and false bearings, `square` (the paper), `huber`, `cauchy`.",
        choices=LOSSES,
    )
    loss_threshold: float | None = setting(
        None,
        "Threshold of the robust loss, in standard deviations. Smaller values reject more bearings.",
        nothing="3.7 (mixture), 1.345 (huber), 2.385 (cauchy)",
        **POSITIVE,
    )
    adapt_noise: bool = setting(
        True, "Scale process and measurement noise up where the residuals demand it (with initialisation=consensus)."
    )
    detection_probability: float | None = setting(
        None,
        "Detection probability P_D of a camera; needed to use missed detections as information.",
        above=0,
        at_most=1,
        nothing="missed detections are no information",
    )

    # Moving occluders, [Ercan] Sec. 4.2; only with priors of their positions
    use_missed_detections: bool = setting(
        True, "Use missed detections: with occluder priors a target that is not detected is occluded or out of view."
    )
    occlusion_tempering: float = setting(
        0.3,
        "Exponent of occlusion probabilities from uncertain priors, which have time-correlated errors; 1: as if "
        "independent.",
        at_least=0,
        at_most=1,
    )
    occluder_diameter: float = setting(3.33, "Diameter of a moving occluder.", unit="length", above=0, people=0.5)
    prior_max_age_s: float = setting(5.0, "Maximum age of occluder priors; older ones are not used.", unit="s", above=0)

    # Constraints
    in_front_constraint: bool = setting(True, "Constrain a detected target to lie in front of the camera.")
    min_depth: float = setting(
        0.01, "Minimum depth of a detected target in front of the camera.", unit="length", **POSITIVE
    )
    wall_constraints: bool = setting(
        True,
        "Constrain the target to the room, outside static occluders, and to an unobstructed line of sight where it "
        "is detected. Off where the scene's walls are unreliable.",
    )
    wall_clearance: float = setting(
        0.0, "Minimum distance to walls and static occluders, for example a body radius.", unit="length", **AT_LEAST_0
    )

    # What is given out
    estimate: str = setting(
        "mode",
        "Point estimate: `mode` of the density (the paper), or `invariant`, which does not depend on the coordinates.",
        choices=("mode", "invariant"),
    )
    covariance: str = setting(
        "moment",
        "Covariance: `moment`, the mean square error about the estimate, or the inverse `hessian` at it.",
        choices=("moment", "hessian"),
    )

    # Search, [Rahimi] Sec. 6
    initialisation: str | None = setting(
        None,
        "Initial trajectory: `consensus` (RANSAC over bearings), `axes` (points on the optical axes of the "
        "cameras, as in [Rahimi]) or `linear` (linear least squares).",
        choices=("consensus", "axes", "linear"),
        nothing="consensus; axes with loss square",
    )
    initial_depth: float | None = setting(
        None,
        "Initial depth along the camera axes, with initialisation=axes.",
        unit="length",
        nothing="a tenth of the room's extent",
        **POSITIVE,
    )
    solver: str = setting(
        "newton",
        "Solver: `newton` (interior point), or a quadratic program of the paper (clarabel, osqp): much slower, for "
        "comparison.",
        choices=("newton", *PACKAGES),
    )
    max_iterations: int = setting(200, "Maximum iterations per window.", at_least=1)
    tolerance: float = setting(
        1e-7,
        "Convergence tolerance: largest change of a position in the last iteration, relative to the extent of the "
        "room.",
        **POSITIVE,
    )

    # Time
    lag_s: float | None = setting(
        None,
        "Fixed-lag estimation: use this much later data, in bounded memory. Longer lags are more accurate and "
        "delay the output.",
        unit="s",
        at_least=1e-9,
        at_most=1e9,
        option="--lag",
        nothing="all of it",
    )
    window_states: int = setting(
        512, "States solved together before the full problem is started from them.", at_least=16
    )
    max_state_gap_s: float | None = setting(
        None,
        "Insert states in gaps between measurements longer than this; needed for paths around walls in long gaps.",
        unit="s",
        nothing="nowhere",
        **POSITIVE,
    )
    max_position_sigma: float = setting(
        0.1,
        "Flag rows `unobservable` above this standard deviation, relative to the extent of the room.",
        **POSITIVE,
    )

    @property
    def consensus(self) -> bool:
        """Whether the search starts from the path with which most bearings agree (RANSAC)."""
        return self.initialisation == "consensus" or (self.initialisation is None and self.loss != "square")

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate checks between settings as (setting, is fulfilled, requirement as text).

        A fitted model needs both matrices A and Sigma, a start both parts; without `in_front_constraint` the estimate
        must be the mode.
        """
        yield "Sigma", (self.A is None) == (self.Sigma is None), "given along with A"
        s = self.start
        good = s is None or (len(s) == 3 and s[2] >= LEAST and max(map(abs, s)) <= FAR)
        yield "start", good, f"X,Y,SIGMA, SIGMA at least {LEAST:g}"
        yield "estimate", self.in_front_constraint or self.estimate == "mode", "mode where front is false"
