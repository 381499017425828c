"""Settings of the batch method, with their defaults."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS
from occlog.settings import check_settings
from occlog.track.apf.config import METRES
from occlog.track.map.kernels.gauss_markov import GaussMarkov, constant_velocity
from occlog.track.map.kernels.problem import CAUCHY, HUBER, SQUARE

from .qp_solvers import PACKAGES

LOSSES = {"square": SQUARE, "huber": HUBER, "cauchy": CAUCHY}
BEND = {"square": 1.0, "huber": 1.345, "cauchy": 2.385}
"""Parameters of the losses that lose 5 % where all errors are Gaussian."""
STARTS = ("axes", "linear")
ESTIMATES = ("mode", "invariant")
COVARIANCES = ("moment", "hessian")
LEAST, MOST, FAR = 1e-9, 1e9, 1e12
"""Settings beyond these are slips, and cannot be computed with."""


@dataclass(frozen=True)
class MapConfig:
    """Settings of method `map`; lengths in the scene's unit, times in seconds."""

    # Motion, [Rahimi] Eq. 1; with --motion the first two are not used
    acceleration: float = 1.0  # standard deviation of the velocity gathered in a second, per axis
    jitter: float = 0.0  # of the position besides
    speed: float = 1.0  # standard deviation of the first velocity, per axis
    start: tuple[float, ...] | None = None  # x, y and sigma of the first position; None: anywhere in the room
    A: tuple[float, ...] | None = None  # 16 numbers of a fitted model, by rows, for the state x, vx, y, vy
    Sigma: tuple[float, ...] | None = None  # 16 numbers
    step_s: float = 1.0  # length of its step

    # Measurements, [Rahimi] Sec. 4
    loss: str = "square"  # of a residual: `square`, `huber` or `cauchy`
    bend: float | None = None  # standard deviations beyond which it is bent; None: 1.345 (huber), 2.385 (cauchy)
    detection: float | None = None  # P_D of a camera; None: "not seen" says nothing

    # Constraints
    front: bool = True  # a target that is seen is in front of the camera
    near: float = 0.01  # by at least this much
    walls: bool = True  # a target is in the room, in no static occluder, and not behind one when it is seen
    clearance: float = 0.0  # least distance to walls and static occluders

    # What is given out
    estimate: str = (
        "mode"  # the paper's `mode` of the density, or the `invariant` one (`occlog.track.map.kernels.invariant`)
    )
    covariance: str = "moment"  # mean square error about the estimate, or the inverse `hessian` at it

    # Search, [Rahimi] Sec. 6
    initial: str = "axes"  # start from the cameras' `axes`, or from a `linear` problem
    depth: float | None = None  # distance along the axes; None: a tenth of the room's extent
    solver: str = "newton"  # or the paper's quadratic programs by `clarabel` or `osqp`: much slower, to compare
    iterations: int = 200  # at most, in a window
    tolerance: float = 1e-7  # largest change of a position in the last iteration, as a share of the room's extent

    # Time
    lag_s: float | None = None  # estimates wait for so much of what comes after them; None: for all of it
    window: int = 512  # states solved at once at first; they then start the whole
    fill_s: float | None = None  # states are added where there is none for a longer time; None: nowhere
    vague: float = 0.1  # rows with a greater standard deviation, as a share of the room's extent, are `unobservable`

    def __post_init__(self) -> None:
        limits = [
            (name, LEAST <= getattr(self, name) <= MOST, f"{LEAST:g} to {MOST:g}")
            for name in ("acceleration", "speed", "step_s", "near", "tolerance", "vague")
        ]
        for name in ("jitter", "clearance"):
            limits.append((name, 0.0 <= getattr(self, name) <= MOST, f"0 to {MOST:g}"))
        for name in ("bend", "depth", "fill_s"):
            value = getattr(self, name)
            limits.append((name, value is None or LEAST <= value <= MOST, f"{LEAST:g} to {MOST:g}"))
        limits.append(("lag_s", self.lag_s is None or 1e-9 <= self.lag_s <= 1e9, "from 1e-9 to 1e9"))
        for name in ("A", "Sigma"):
            value = getattr(self, name)
            limits.append((name, value is None or len(value) == 16, "16 numbers"))
        limits += [
            ("Sigma", (self.A is None) == (self.Sigma is None), "given along with A"),
            (
                "start",
                self.start is None
                or (len(self.start) == 3 and self.start[2] >= LEAST and max(map(abs, self.start)) <= FAR),
                f"X,Y,SIGMA, SIGMA at least {LEAST:g}",
            ),
            ("loss", self.loss in LOSSES, "one of " + ", ".join(LOSSES)),
            ("estimate", self.estimate in ESTIMATES, "one of " + ", ".join(ESTIMATES)),
            ("covariance", self.covariance in COVARIANCES, "one of " + ", ".join(COVARIANCES)),
            ("estimate", self.front or self.estimate == "mode", "mode where front is false"),
            ("initial", self.initial in STARTS, "one of " + ", ".join(STARTS)),
            ("detection", self.detection is None or 0.0 < self.detection <= 1.0, "above 0 and at most 1"),
            ("solver", self.solver in ("newton", *PACKAGES), "newton, " + " or ".join(PACKAGES)),
            ("iterations", self.iterations >= 1, "at least 1"),
            ("window", self.window >= 16, "at least 16"),
        ]
        check_settings(self, "map", limits)

    @property
    def motion(self) -> GaussMarkov:
        """How the target moves."""
        if self.A is None or self.Sigma is None:
            return constant_velocity(self.acceleration, self.jitter, self.step_s)
        A, sigma = (np.array(m, dtype=np.float64).reshape(4, 4) for m in (self.A, self.Sigma))
        return GaussMarkov(A, sigma, self.step_s)

    @property
    def lag_ns(self) -> int | None:
        """`lag_s` in ns."""
        return None if self.lag_s is None else round(self.lag_s * NS)


def map_defaults(length_unit: str) -> MapConfig:
    """Settings that suit a scene: people for metres, feet and inches; the reference scene of [Ercan] for `unit`."""
    config = MapConfig()
    if length_unit not in METRES:
        return replace(config, acceleration=0.33, jitter=0.33)
    metre = 1.0 / METRES[length_unit]
    return replace(config, acceleration=1.0 * metre, speed=1.0 * metre, near=0.01 * metre)
