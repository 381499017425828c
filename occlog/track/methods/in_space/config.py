"""Settings of the methods that track in space, `direct3d` and `pps`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import setting
from occlog.track.smoothing_and_lag import SmoothingConfig

PLANES = ("xy", "yz", "zx")
STARTS = (3, 4, 8, 12)


@dataclass(frozen=True)
class SpaceConfig(SmoothingConfig):
    """Settings that both methods have; lengths in the scene's unit, times in seconds.

    In metres, feet and inches targets are people: they stop and turn, and their heads hardly go up or down.
    """

    OWNER: ClassVar[str] = "space"

    particles: int = setting(2000, "Particles a target, or of each plane.", at_least=1, option="--particles")
    start: tuple[float, ...] | None = setting(
        None,
        "x,y,sigma; x,y,z,sigma; x,y,z,vx,vy,vz,sigma,sigma_v; or x,y,z,vx,vy,vz and a sigma of each. What is not "
        "given is spread: z over the room's height, velocities by `speed` and `speed_z`.",
        unit="length",
        nothing="where the first scan says",
    )
    start_factor: int = setting(10, "A filter starts with this many times its particles.", at_least=1)

    # Motion
    acceleration: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "Known acceleration along x, y and z.", unit="length/s^2"
    )
    turn: float = setting(
        0.0, "Lateral acceleration of a known turn, from the plane's first axis to its second.", unit="length/s^2"
    )
    turn_plane: str = setting("xy", "Plane of the known turn.", choices=PLANES)
    q: float = setting(
        0.1,
        "Density of the white acceleration: variance of the velocity gathered in a second.",
        unit="length^2/s^3",
        at_least=0,
        people=1.0,
    )
    q_z: float | None = setting(None, "The same of z.", unit="length^2/s^3", at_least=0, people=0.02, nothing="as q")
    speed: float = setting(1.0, "Standard deviation of an unknown velocity along x and y.", unit="length/s", at_least=0)
    speed_z: float = setting(0.3, "The same along z.", unit="length/s", at_least=0, people=0.1)

    # Measurements
    false: float = setting(1e-4, "Probability that a labelled report is of nothing.", at_least=0, below=1)
    soften: float = setting(
        1e-2, "Factor for a target out of the range of a sensor that reports it.", above=0, at_most=1
    )
    outside: float = setting(
        1e-2, "Factor for a target that leaves the room, if the scene has one, each time.", above=0, at_most=1
    )
    candidate: float = setting(
        0.9, "Probability that the target is among the candidates of a sensor that has any.", above=0, at_most=1
    )
    clutter: float = setting(1.0, "Candidates of other objects expected in a scan.", above=0)
    use_score: bool = setting(True, "Weigh candidates by their score.")

    # Sampling
    proposal: str = setting(
        "scan",
        "Particles are drawn with a look at the scan where few would be effective, or by the motion alone.",
        choices=("scan", "motion"),
    )
    resample_below: float = setting(
        0.5, "Resample when the effective sample size is below this share of the particles.", at_least=0
    )
    kernel: float = setting(
        1.0,
        "Width of the kernel of resampled particles, of the width that is best for a Gaussian.",
        at_least=0,
        at_most=1,
    )

    # When to give up
    max_gap_s: float = setting(60.0, "After a longer time without a scan particles are drawn anew.", unit="s", above=0)
    gate: float = setting(5.0, "Standard deviations within which a report agrees with a place.", above=0)
    lost_after: int = setting(
        6,
        "Reports of a sensor more against than for the best particle after which all start anew; 0: never.",
        at_least=0,
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """How many numbers `acceleration` and `start` have."""
        yield "acceleration", len(self.acceleration) == 3, "AX,AY,AZ"
        limit = (
            "X,Y,SIGMA; X,Y,Z,SIGMA; X,Y,Z,VX,VY,VZ,SIGMA,SIGMA_V; or X,Y,Z,VX,VY,VZ and their six sigmas, none below 0"
        )
        yield "start", self.start is None or _good_start(self.start), limit


@dataclass(frozen=True)
class Direct3dConfig(SpaceConfig):
    """Settings of method `direct3d`; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "direct3d"

    likelihood: str = setting(
        "product",
        "Likelihood of azimuth and elevation, or of the angle from the sight line.",
        choices=("product", "cone"),
    )


@dataclass(frozen=True)
class PpsConfig(SpaceConfig):
    """Settings of method `pps`; `particles` are those of each plane; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "pps"

    selection: str = setting(
        "variance",
        "How the two planes are selected: by their variance, or as printed in the thesis.",
        choices=("variance", "printed"),
    )
    combining: str = setting(
        "inverse", "How the axis that both planes have is combined.", choices=("inverse", "planes-weighted", "equal")
    )
    running: str = setting(
        "all", "Planes that measure: all the time, or only while they are selected.", choices=("all", "selected")
    )
    per_plane: str = setting(
        "all",
        "Sensors that a plane takes in: all, or only the best one, as the thesis has it.",
        choices=("all", "best"),
    )


def _good_start(start: tuple[float, ...]) -> bool:
    n = len(start)
    sigmas = {3: 1, 4: 1, 8: 2, 12: 6}.get(n, 0)
    return n in STARTS and all(s >= 0 for s in start[n - sigmas :])
