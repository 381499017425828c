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
    """Settings of method `map`; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "map"

    # Motion, [Rahimi] Eq. 1; with a fitted model the first two are not used
    acceleration: float = setting(
        1.0, "Standard deviation of the velocity gathered in a second, per axis.", unit="length/s", own=0.33, **POSITIVE
    )
    jitter: float = setting(0.0, "The same of the position besides.", unit="length", own=0.33, **AT_LEAST_0)
    speed: float = setting(1.0, "Standard deviation of the first velocity, per axis.", unit="length/s", **POSITIVE)
    start: tuple[float, ...] | None = setting(
        None, "X, Y and SIGMA of the first position.", unit="length", nothing="anywhere a target can be"
    )
    A: tuple[float, ...] | None = setting(
        None, "16 numbers of a fitted model, by rows, for the state x, vx, y, vy.", counts=(16,), nothing="no model"
    )
    Sigma: tuple[float, ...] | None = setting(
        None, "16 numbers: covariance of the model's noise.", counts=(16,), nothing="no model"
    )
    step_s: float = setting(1.0, "Length of the model's step.", unit="s", **POSITIVE)

    # Measurements, [Rahimi] Sec. 4
    loss: str = setting(
        "mixture",
        "How residuals count: as of true and false bearings, as the paper's squares, or by a robust loss.",
        choices=LOSSES,
    )
    bend: float | None = setting(
        None,
        "Standard deviations beyond which a residual's loss is bent.",
        nothing="3.7 (mixture), 1.345 (huber), 2.385 (cauchy)",
        **POSITIVE,
    )
    adapt: bool = setting(
        True, "With consensus: motion and bearings are noisier than stated where the residuals say so."
    )
    detection: float | None = setting(None, "P_D of a camera.", above=0, at_most=1, nothing='"not seen" says nothing')

    # Moving occluders, [Ercan] Sec. 4.2; only with priors of their positions
    unseen: bool = setting(
        True, 'With priors of moving occluders: "not seen" says that the target is hidden or out of view.'
    )
    temper: float = setting(
        0.3,
        "Exponent of the probabilities of being hidden or not, where priors are uncertain: their errors last, so that "
        "each scan tells less than if they were new.",
        at_least=0,
        at_most=1,
    )
    occluder_diameter: float = setting(3.33, "Diameter of a moving occluder.", unit="length", above=0, people=0.5)
    prior_max_age_s: float = setting(5.0, "Older priors are not used.", unit="s", above=0)

    # Constraints
    front: bool = setting(True, "A target that is seen is in front of the camera.")
    near: float = setting(0.01, "It is so by at least this much.", unit="length", **POSITIVE)
    walls: bool = setting(True, "A target is in the room, in no static occluder, and not behind one when it is seen.")
    clearance: float = setting(0.0, "Least distance to walls and static occluders.", unit="length", **AT_LEAST_0)

    # What is given out
    estimate: str = setting(
        "mode",
        "The paper's mode of the density, or the estimate that does not depend on the coordinates.",
        choices=("mode", "invariant"),
    )
    covariance: str = setting(
        "moment", "Mean square error about the estimate, or the inverse Hessian at it.", choices=("moment", "hessian")
    )

    # Search, [Rahimi] Sec. 6
    initial: str | None = setting(
        None,
        "Start where most bearings agree, from the cameras' axes as in the paper, or from a linear problem.",
        choices=("consensus", "axes", "linear"),
        nothing="consensus; axes with loss square",
    )
    depth: float | None = setting(
        None, "Distance of the start along the axes.", unit="length", nothing="a tenth of the room's extent", **POSITIVE
    )
    solver: str = setting(
        "newton",
        "Newton's method, or the paper's quadratic programs: much slower, to compare.",
        choices=("newton", *PACKAGES),
    )
    iterations: int = setting(200, "Iterations in a window at most.", at_least=1)
    tolerance: float = setting(
        1e-7, "Largest change of a position in the last iteration, as a share of the room's extent.", **POSITIVE
    )

    # Time
    lag_s: float | None = setting(
        None,
        "Estimate with so much of what comes after, in bounded memory.",
        unit="s",
        at_least=1e-9,
        at_most=1e9,
        option="--lag",
        metavar="SECONDS",
        nothing="all of it",
    )
    window: int = setting(512, "States solved at once at first; they then start the whole.", at_least=16)
    fill_s: float | None = setting(
        None, "States are added where there is none for a longer time.", unit="s", nothing="nowhere", **POSITIVE
    )
    vague: float = setting(
        0.1,
        "Rows with a greater standard deviation, as a share of the room's extent, are `unobservable`.",
        **POSITIVE,
    )

    @property
    def consensus(self) -> bool:
        """Whether the search starts where most bearings agree."""
        return self.initial == "consensus" or (self.initial is None and self.loss != "square")

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """A fitted model has both matrices; a start is a position and a spread; the mode needs no constraint."""
        yield "Sigma", (self.A is None) == (self.Sigma is None), "given along with A"
        s = self.start
        good = s is None or (len(s) == 3 and s[2] >= LEAST and max(map(abs, s)) <= FAR)
        yield "start", good, f"X,Y,SIGMA, SIGMA at least {LEAST:g}"
        yield "estimate", self.front or self.estimate == "mode", "mode where front is false"
