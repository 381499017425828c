"""What `evaluate` is asked for, and what it gives back."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from occlog.array_types import NS
from occlog.errors import InputError
from occlog.records.tables import Bound, Errors
from occlog.records.views import Failures

METRES = {"m": 1.0, "ft": 0.3048, "in": 0.0254}


@dataclass(frozen=True)
class EvaluateConfig:
    """Options of `evaluate`; lengths in the scene's unit.

    The motion of the bound: `waypoint` is a walk with noise `sigma_v` whose drift is known
    ([Ercan] Eq. 5 with known destination and speed); `cv` is a constant velocity
    disturbed by white acceleration, not known in advance.
    """

    max_gap_s: float = 1.0  # truth is interpolated between samples at most this far apart
    match: str = "id"  # tracks to truth: `id`, or `optimal` (least overall RMSE)
    skip_s: float = 0.0  # `settled_` figures leave out this much after each target's first estimate
    from_ns: int | None = None  # and everything before this time
    gate_sigma: float = 4.0  # a bearing within this many standard deviations of the truth is of the target
    gate_px: float | None = None  # the same in pixels, for cameras, instead of gate_sigma
    occluder_diameter: float | None = None  # of moving objects; None: they hide nothing
    motion: str = "waypoint"
    sigma_v: float | None = None  # noise gathered in 1 s per axis; None: `default_sigma_v`
    acceleration_density: float = 1.0  # of `cv` [length^2 / s^3]
    sigma_speed: float = 1.5  # prior of each velocity component, `cv` [length / s]
    prior_cov: tuple[float, float, float] | None = None  # xx, xy, yy at the first look; None: anywhere in the room
    prior_z: float | None = None  # variance of the height there; None: anywhere below the room's ceiling
    bound_in: str = "auto"  # `ground`, `space`, or in space for targets whose errors are
    held_out: tuple[str, ...] = ()  # sensors that the tracks were made without
    held_out_gate: float = 0.05  # [rad]
    lines_min_sensors: int = 2  # sight lines that must meet
    lines_window_s: float = 0.0  # looks this close together count as one time
    lines_loss: str = "huber"  # `gauss`, `huber` or `cauchy`
    lines_limit: float | None = None  # share of the distances up to this is given
    lines_min_crossing: float = math.radians(5.0)
    box_overlap: float = 0.5  # intersection over union from which a view is of a true box

    def __post_init__(self) -> None:
        for name in ("max_gap_s", "skip_s", "acceleration_density", "lines_window_s", "lines_min_crossing"):
            _check(name, getattr(self, name), getattr(self, name) >= 0, "at least 0")
        for name in ("gate_sigma", "sigma_speed", "held_out_gate"):
            _check(name, getattr(self, name), getattr(self, name) > 0, "above 0")
        for name in ("gate_px", "occluder_diameter", "lines_limit", "prior_z"):
            value = getattr(self, name)
            _check(name, value, value is None or value > 0, "above 0")
        _check("sigma_v", self.sigma_v, self.sigma_v is None or self.sigma_v >= 0, "at least 0")
        _check("box_overlap", self.box_overlap, 0 < self.box_overlap <= 1, "above 0 and at most 1")
        _check("lines_min_sensors", self.lines_min_sensors, self.lines_min_sensors >= 2, "at least 2")
        _check("match", self.match, self.match in ("id", "optimal"), "id or optimal")
        _check("motion", self.motion, self.motion in ("waypoint", "cv"), "waypoint or cv")
        _check("bound_in", self.bound_in, self.bound_in in ("ground", "space", "auto"), "ground, space or auto")
        _check("lines_loss", self.lines_loss, self.lines_loss in ("gauss", "huber", "cauchy"), "gauss, huber or cauchy")
        if self.prior_cov is not None:
            xx, xy, yy = self.prior_cov
            _check("prior_cov", self.prior_cov, xx > 0 and xx * yy > xy**2, "xx, xy, yy of a positive covariance")

    @property
    def limit_ns(self) -> int:
        """Widest gap of the truth that is bridged [ns]."""
        return round(self.max_gap_s * NS)


def _check(name: str, value: object, good: bool, limit: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"evaluate: {name} is {value}, must be a finite number")
    if not good:
        raise InputError(f"evaluate: {name} is {value}, must be {limit}")


def default_sigma_v(length_unit: str) -> float:
    """Noise of a walker after 1 s: [Ercan]'s 0.33 in units of its own, 0.05 m for people, as `simulate` has it."""
    return 0.33 if length_unit not in METRES else 0.05 / METRES[length_unit]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What came out; `metrics` are flat, with the unit as the end of the name."""

    metrics: dict[str, float]
    errors: Errors = field(default_factory=Errors.empty)
    bound: Bound = field(default_factory=Bound.empty)
    failures: Failures = field(default_factory=Failures.empty)
    notes: tuple[str, ...] = ()  # what the user must know of
