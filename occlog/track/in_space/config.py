"""Settings of the methods that track in space, `direct3d` and `pps`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from occlog.core.motion.in_space import Motion
from occlog.core.sight.projected_planes import AXES, PLANES
from occlog.settings import check_settings
from occlog.track.apf.config import METRES
from occlog.track.in_space.kernels.likelihood import Chances

LIKELIHOODS = ("product", "cone")
SELECTIONS = ("variance", "printed")
COMBININGS = ("inverse", "planes-weighted", "equal")
RUNNING = ("all", "selected")
PER_PLANE = ("all", "best")
STARTS = (3, 4, 8, 12)
S = TypeVar("S", bound="SpaceConfig")


@dataclass(frozen=True)
class SpaceConfig:
    """Settings that both methods have; lengths in the scene's unit, times in seconds."""

    particles: int = 2000
    start: tuple[float, ...] | None = None
    """x,y,sigma; x,y,z,sigma; x,y,z,vx,vy,vz,sigma,sigma_v; or x,y,z,vx,vy,vz and a sigma of each.

    What is not given is spread: z over the room's height, velocities by `speed` and `speed_z`.
    None: where the first scan says.
    """
    start_factor: int = 10  # a filter starts with this many times its particles

    # Motion
    acceleration: tuple[float, ...] = (0.0, 0.0, 0.0)  # known, along x, y and z
    turn: float = 0.0  # lateral acceleration of a known turn, from the plane's first axis to its second
    turn_plane: str = "xy"
    q: float = 0.1  # density of the white acceleration: variance of the velocity gathered in a second
    q_z: float | None = None  # that of z; None: as q
    speed: float = 1.0  # standard deviation of an unknown velocity along x and y
    speed_z: float = 0.3  # the same along z

    # Measurements
    false: float = 1e-4  # probability that a labelled report is of nothing
    soften: float = 1e-2  # factor for a target out of the range of a sensor that reports it
    outside: float = 1e-2  # factor for a target outside the room, if the scene has one
    candidate: float = 0.9  # probability that the target is among the candidates of a sensor that has any
    clutter: float = 1.0  # candidates of other objects expected in a scan
    use_score: bool = True  # weigh candidates by their score

    # Sampling
    resample_below: float = 0.5  # resample when the effective sample size is below this share of the particles
    kernel: float = 1.0  # width of the kernel of resampled particles, of the width that is best for a Gaussian

    # When to give up
    max_gap_s: float = 60.0  # after a longer time without a scan particles are drawn anew
    gate: float = 5.0  # standard deviations within which a report agrees with a place
    lost_after: int = 6  # reports of a sensor more against than for the best particle; then all start anew; 0: never

    METHOD = "space"

    def __post_init__(self) -> None:
        check_settings(self, self.METHOD, self.limits())

    def limits(self) -> list[tuple[str, bool, str]]:
        """Limits of the settings, see `check_settings`."""
        limits = [("false", 0.0 <= self.false < 1.0, "in [0, 1)"), ("kernel", 0.0 <= self.kernel <= 1.0, "in [0, 1]")]
        for name in ("soften", "outside", "candidate"):
            limits.append((name, 0.0 < getattr(self, name) <= 1.0, "above 0 and at most 1"))
        for name in ("clutter", "max_gap_s", "gate"):
            limits.append((name, getattr(self, name) > 0, "above 0"))
        for name in ("q", "speed", "speed_z", "resample_below", "lost_after"):
            limits.append((name, getattr(self, name) >= 0, "at least 0"))
        for name in ("particles", "start_factor"):
            limits.append((name, getattr(self, name) >= 1, "at least 1"))
        limits += [
            ("q_z", self.q_z is None or self.q_z >= 0, "at least 0"),
            ("acceleration", len(self.acceleration) == 3, "AX,AY,AZ"),
            ("turn_plane", self.turn_plane in PLANES, "one of " + ", ".join(PLANES)),
            (
                "start",
                self.start is None or _good_start(self.start),
                "X,Y,SIGMA; X,Y,Z,SIGMA; "
                "X,Y,Z,VX,VY,VZ,SIGMA,SIGMA_V; or X,Y,Z,VX,VY,VZ and their six sigmas, none below 0",
            ),
        ]
        return limits

    @property
    def motion(self) -> Motion:
        """The motion model's part."""
        up = self.q if self.q_z is None else self.q_z
        axes = AXES[PLANES.index(self.turn_plane)]
        return Motion(np.array(self.acceleration), np.array([self.q, self.q, up]), self.turn, axes)

    @property
    def chances(self) -> Chances:
        """The measurements' part."""
        return Chances(self.false, self.soften, self.candidate, self.clutter)


@dataclass(frozen=True)
class Direct3dConfig(SpaceConfig):
    """Settings of method `direct3d`; lengths in the scene's unit, times in seconds."""

    likelihood: str = "product"  # of azimuth and elevation, or `cone`: of the angle from the sight line

    METHOD = "direct3d"

    def limits(self) -> list[tuple[str, bool, str]]:
        """With those of its own."""
        return [*super().limits(), ("likelihood", self.likelihood in LIKELIHOODS, "one of " + ", ".join(LIKELIHOODS))]


@dataclass(frozen=True)
class PpsConfig(SpaceConfig):
    """Settings of method `pps`; `particles` are those of each plane; lengths in the scene's unit, times in seconds."""

    selection: str = "variance"  # of the two planes: by their `variance`, or as `printed` in the thesis
    combining: str = "inverse"  # of the axis that both have: by `inverse` variance, `planes-weighted` or `equal`
    running: str = "all"  # planes that measure all the time, or only those `selected`
    per_plane: str = "all"  # sensors that a plane takes in, or only the `best` one, as the thesis has it

    METHOD = "pps"

    def limits(self) -> list[tuple[str, bool, str]]:
        """With those of its own."""
        choices = {"selection": SELECTIONS, "combining": COMBININGS, "running": RUNNING, "per_plane": PER_PLANE}
        own = [(n, getattr(self, n) in known, "one of " + ", ".join(known)) for n, known in choices.items()]
        return [*super().limits(), *own]


def direct3d_defaults(length_unit: str) -> Direct3dConfig:
    """Settings that suit a scene."""
    return _suited(Direct3dConfig(), length_unit)


def pps_defaults(length_unit: str) -> PpsConfig:
    """Settings that suit a scene."""
    return _suited(PpsConfig(), length_unit)


def _suited(config: S, length_unit: str) -> S:
    """People in metres, feet or inches: they stop and turn, and their heads hardly go up or down."""
    if length_unit not in METRES:
        return config
    metre = 1.0 / METRES[length_unit]
    return replace(config, q=1.0 * metre**2, q_z=0.02 * metre**2, speed=1.0 * metre, speed_z=0.1 * metre)


def _good_start(start: tuple[float, ...]) -> bool:
    n = len(start)
    sigmas = {3: 1, 4: 1, 8: 2, 12: 6}.get(n, 0)
    return n in STARTS and all(s >= 0 for s in start[n - sigmas :])
