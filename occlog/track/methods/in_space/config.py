"""Settings of the 3-D methods `direct3d` and `pps`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import option_setting, setting
from occlog.track.smoothing_and_lag import SmoothingConfig

PLANES = ("xy", "yz", "zx")
STARTS = (3, 4, 8, 12)


@dataclass(frozen=True)
class SpaceConfig(SmoothingConfig):
    """Settings common to the methods `direct3d` and `pps`; lengths in the scene's unit, times in seconds.

    In metres, feet and inches defaults are those for people: they stop and turn, and their heads hardly go up or down.
    """

    OWNER: ClassVar[str] = "space"

    particles: int = option_setting(
        2000,
        "Particles per target, or per plane. More reduce the Monte Carlo error and take time in proportion.",
        at_least=1,
    )
    start: tuple[float, ...] | None = setting(
        None,
        "Initial state, as x,y,sigma; x,y,z,sigma; x,y,z,vx,vy,vz,sigma,sigma_v; or x,y,z,vx,vy,vz and a sigma "
        "of each. If not given, "
        "z is uncertain over the height of the room, and velocities by `sigma_initial_velocity` and "
        "`sigma_initial_velocity_z`.",
        unit="length",
        nothing="from the first scan",
    )
    initial_particle_factor: int = setting(
        10, "Particles at track initiation, as a multiple of `particles`.", at_least=1
    )

    # Motion
    acceleration: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0), "Known constant acceleration along x, y, z.", unit="length/s^2"
    )
    turn_acceleration: float = setting(
        0.0,
        "Lateral acceleration of a known coordinated turn, from the first axis of the plane to its second.",
        unit="length/s^2",
    )
    turn_plane: str = setting("xy", "Plane of the known turn.", choices=PLANES)
    process_noise_density: float = setting(
        0.1,
        "Process noise: spectral density of white acceleration. Larger values follow manoeuvres and widen covariances.",
        unit="length^2/s^3",
        at_least=0,
        people=1.0,
    )
    process_noise_density_z: float | None = setting(
        None,
        "Process noise along z: spectral density of white acceleration.",
        unit="length^2/s^3",
        at_least=0,
        people=0.02,
        nothing="as process_noise_density",
    )
    sigma_initial_velocity: float = setting(
        1.0, "Initial standard deviation of the velocity along x and y.", unit="length/s", at_least=0
    )
    sigma_initial_velocity_z: float = setting(
        0.3, "Initial standard deviation of the velocity along z.", unit="length/s", at_least=0, people=0.1
    )

    # Measurements
    false_alarm_probability: float = setting(1e-4, "False alarm probability of a labelled report.", at_least=0, below=1)
    out_of_range_likelihood: float = setting(
        1e-2, "Likelihood factor for a report of a target out of the range of the sensor.", above=0, at_most=1
    )
    out_of_room_likelihood: float = setting(
        1e-2,
        "Likelihood factor applied once when a target leaves the room, if the scene has one; 1: no penalty.",
        above=0,
        at_most=1,
    )
    candidate_detection_probability: float = setting(
        0.9, "Probability that the target is among the candidates of a sensor that has any.", above=0, at_most=1
    )
    clutter_rate: float = setting(1.0, "Clutter rate: candidates of other objects expected in a scan.", above=0)
    use_score: bool = setting(True, "Weigh candidates by their score.")

    # Sampling
    proposal: str = setting(
        "adapted",
        "Importance density: `adapted` uses the measurements where few particles would be effective, `bootstrap` the "
        "motion model alone.",
        choices=("adapted", "bootstrap"),
    )
    resampling_threshold: float = setting(
        0.5,
        "Resampling threshold: resample when the effective sample size, relative to the number of particles, is "
        "below this.",
        at_least=0,
    )
    kernel_bandwidth: float = setting(
        1.0,
        "Bandwidth of the regularisation kernel after resampling, relative to the optimum of a Gaussian; 0 "
        "duplicates particles.",
        at_least=0,
        at_most=1,
    )

    # When to give up
    max_gap_s: float = setting(60.0, "Reinitialise after more than this time without measurements.", unit="s", above=0)
    gate: float = setting(5.0, "Gate in standard deviations for a report to agree with a position.", above=0)
    track_loss_count: int = setting(
        6,
        "Reinitialise when the reports of a sensor that contradict the best particle outnumber those that agree by "
        "this count; 0: never.",
        at_least=0,
    )

    def rules(self) -> Iterable[tuple[str, bool, str]]:
        """Generate (setting, whether it fits, limit as text) for the number of values of `acceleration` and `start`."""
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
        "Measurement likelihood: `product` of azimuth and elevation, or `cone` of the angle from the line of sight.",
        choices=("product", "cone"),
    )


@dataclass(frozen=True)
class PpsConfig(SpaceConfig):
    """Settings of method `pps`; `particles` are those of each plane; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "pps"

    selection: str = setting(
        "variance",
        "Selection of the two planes: by predicted `variance`, or as `printed` in the thesis.",
        choices=("variance", "printed"),
    )
    combining: str = setting(
        "inverse",
        "Weights of the axis that both planes share: `inverse` variance, `planes-weighted`, or `equal`.",
        choices=("inverse", "planes-weighted", "equal"),
    )
    running: str = setting(
        "all", "Planes that are updated: `all`, or only the `selected` ones.", choices=("all", "selected")
    )
    per_plane: str = setting(
        "all",
        "Sensors used by a plane: `all`, or only the `best` one, as in the thesis.",
        choices=("all", "best"),
    )


def _good_start(start: tuple[float, ...]) -> bool:
    """Return whether `start` has one of the allowed numbers of values, with no standard deviation below 0."""
    n = len(start)
    sigmas = {3: 1, 4: 1, 8: 2, 12: 6}.get(n, 0)
    return n in STARTS and all(s >= 0 for s in start[n - sigmas :])
