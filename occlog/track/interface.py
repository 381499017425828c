"""Interface of the tracking methods: scans in, estimates out, and a state in between.

`Online`: one state a target.  `init` makes it before the first scan, `step` takes a scan in and returns
the next state and the estimate.  `Batch`: one state a target, too; it takes several scans at once and gives
states out when it has seen enough of what comes after them.  `Joint`: one state for all targets.

Functions do not change their arguments, except the generator, from which they draw.  Scans come in
the order of their times, at any intervals, from any set of sensors.  What a method can do is a field
of its tuple.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

from numpy.random import Generator

from occlog.array_types import Floats, Ints
from occlog.consistency.estimates import RivalTrajectory
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan

from .smoothing_and_lag import LagConfig


class HeightEstimate(NamedTuple):
    """Height, vertical velocity, and covariance of an estimate in 3-D."""

    z: float
    vz: float  # per second; NaN if the method does not estimate it
    covariance: Floats  # (3,) of x and z, y and z, z and z


class ParticleSet(NamedTuple):
    """L weighted particles of a target's position."""

    xy: Floats  # (L, 2)
    weights: Floats  # (L,), sum 1


class SensorErrors(NamedTuple):
    """Estimated pose errors of S sensors, true minus stated: x and y in the scene's unit, and yaw [rad]."""

    mean: Floats  # (S, 3) dx, dy, dyaw [rad]
    deviation: Floats  # (S, 3) standard deviations


class BearingResiduals(NamedTuple):
    """Normalised residuals of n bearings from the estimates, and whether the bearings are true."""

    row: Ints  # (n,) which estimate, from 0; 0 where there is one alone
    sensor: Ints  # (n,) index in `sensor_names`
    residual: Floats  # (n,) in standard deviations as stated
    expected_variance: Floats  # (n,) variance that it has if the bearing is true
    inlier_probability: Floats  # (n,) probability that it is true


class NoiseScales(NamedTuple):
    """Estimated variance factors of the bearings and of the motion."""

    bearings: float
    motion: float


class StationBias(NamedTuple):
    """Estimated constant range error of one station, in the scene's unit."""

    station: int
    bias: float  # by how much they are too long
    error: float  # its standard error


class Estimate(NamedTuple):
    """Estimate of a filter after a scan, with diagnostics."""

    xy: Floats  # (2,)
    velocity: Floats  # (2,) per second; NaN if the method does not estimate it
    covariance: Floats  # (2, 2) of xy
    ess: float  # effective sample size
    log_likelihood: float  # of the scan given those before; NaN if no state was possible
    n_observing: int
    n_detected: int
    fallback: str  # as in `occlog.records.tables.Diagnostics`
    used: tuple[int, ...]  # sensors, indices in `sensor_names`
    seen_by: tuple[int, ...] | None = None  # those of them that saw the target; None: the method does not say which
    calibration: SensorErrors | None = None  # None: not estimated
    height: HeightEstimate | None = None  # None: the method tracks on the ground
    fit: BearingResiduals | None = None  # None: the method does not judge bearings


class SmoothedState(NamedTuple):
    """Smoothed state of a target at one time; fields as in `Estimate`."""

    xy: Floats  # (2,)
    velocity: Floats  # (2,) per second
    covariance: Floats  # (2, 2) of xy; of a tag (4, 4) of x, y, vx, vy
    height: HeightEstimate | None = None


class SmoothedTrajectory(NamedTuple):
    """Smoothed states of one target at T times."""

    t_ns: Ints  # (T,)
    xy: Floats  # (T, 2)
    velocity: Floats  # (T, 2) per second
    covariance: Floats  # (T, 4, 4) of x, y, vx, vy
    log_likelihood: Floats  # (T,) of the scan at the estimate; NaN: nothing was seen
    n_observing: Ints  # (T,)
    n_detected: Ints  # (T,)
    fallback: tuple[str, ...]  # (T,) as in `occlog.records.tables.Diagnostics`
    used: tuple[tuple[int, ...], ...]  # (T,) sensors, indices in `sensor_names`
    seen_by: tuple[tuple[int, ...], ...]  # (T,) those of them that saw the target
    iterations: int  # that it took
    converged: bool
    fit: BearingResiduals | None = None  # None: the method does not judge bearings
    noise: NoiseScales | None = None  # None: the method takes it as stated
    rivals: tuple[RivalTrajectory, ...] | None = None  # None: none were sought
    biases: tuple[StationBias, ...] = ()


State = TypeVar("State")
"""State of a method, of one target or of all of them."""
Config = TypeVar("Config")
"""Settings of a method: a frozen dataclass, validated."""
Report = TypeVar("Report")
"""Results of a scan by a method with one state for all targets."""


class OccluderTerms(NamedTuple):
    """How a method uses moving occluders: their diameter, and the maximum age of priors."""

    diameter: float  # of each, in the scene's unit
    max_age_s: float  # priors that are older are not used


class TargetPredictor(NamedTuple, Generic[State, Config]):
    """Position prediction of a method, as used by the selection of cameras."""

    cloud: Callable[
        [State, int, Generator], ParticleSet
    ]  # at a time not before the last scan; the state stays as it is
    step_s: Callable[[Config], float]  # reference step, in which the time between selections is counted
    detection: Callable[[Config], float | None]  # P_D of cameras without one in the scene; None: 1
    hiding: Callable[[Config], int] | None = (
        None  # form of `core.occlusion.hidden` that occluders count by; None: IMPROVED
    )


class Smoothing(NamedTuple, Generic[State, Config]):
    """How a filter's estimates are improved by later measurements.

    What a step leaves for the backward pass, its trace, is of a type that the method alone knows.
    """

    wanted: Callable[[Config], LagConfig]  # whether and how
    trace: Callable[[State], Any]  # of the last step
    back: Callable[
        [Sequence[Any], Config, Generator], list[SmoothedState]
    ]  # traces of steps in order; a state for each


class Online(NamedTuple, Generic[State, Config]):
    """A method with one state for each target, which processes one scan after the other."""

    config: type[Config]
    init: Callable[[Scene, Config, Generator], State]
    step: Callable[[State, Scan, Generator], tuple[State, Estimate | None]]  # None: the scan determines no position
    started: Callable[[Config], bool]  # whether the settings say where the target is initially
    occluders: Callable[[Config], OccluderTerms] | None = None  # None: it knows nothing of moving occluders
    prediction: TargetPredictor[State, Config] | None = None  # None: cameras cannot be selected for it
    calibrates: Callable[[Config], bool] | None = None  # whether poses are estimated; None: they never are
    smoothing: Smoothing[State, Config] | None = None  # None: no smoother
    measured: bool = False  # whether it takes ranges, signal strengths and time differences
    judges: bool = False  # whether the fits of its estimates are of all bearings
    consistent: bool = False  # whether it gets no bearings that contradict the motion of their target


class Batch(NamedTuple, Generic[State, Config]):
    """A method that estimates a segment of one target's trajectory at once."""

    config: type[Config]
    begin: Callable[[Scene, Config, bool], State]  # nothing is known yet; true: it is back, so that no start holds
    advance: Callable[
        [State, Sequence[Scan], bool], tuple[State, SmoothedTrajectory]
    ]  # more scans; whether none will follow
    started: Callable[[Config], bool]  # whether the settings say where the target is initially
    lag_ns: Callable[[Config], int | None]  # how long states wait for what comes after them; None: to the end
    forgets_ns: Callable[[Scene, Config], int | None] = lambda *_: None  # after such a pause a target restarts
    occluders: Callable[[Config], OccluderTerms] | None = None  # None: it knows nothing of moving occluders
    measured: bool = False  # whether it takes ranges, signal strengths and time differences
    biases: bool = False  # whether it estimates constant errors of ranges


class Joint(NamedTuple, Generic[State, Config, Report]):
    """A method with one state for all targets."""

    config: type[Config]
    init: Callable[[Scene, Config, Generator], State]
    step: Callable[[State, Scan, Generator], tuple[State, Report]]  # rows of arrays alone
    estimates: Callable[[Report, Scene], list[tuple[int, Estimate]]]  # by target
    smoothing: Smoothing[tuple[State, int], Config] | None = None  # of one target of a state; None: no smoother


class JointMethod(NamedTuple, Generic[State, Config]):
    """A method with one state for all objects that carry a label, which hide one another."""

    config: type[Config]
    init: Callable[[Scene, Config, Generator], State]
    step: Callable[[State, Scan, Generator], tuple[State, list[tuple[int, Estimate]]]]  # estimates by object
    started: Callable[[Config], bool] = lambda _: False
    smoothing: Smoothing[tuple[State, int], Config] | None = None  # of one object of a state; None: no smoother


AnyMethod = Online[Any, Any] | Batch[Any, Any] | Joint[Any, Any, Any] | JointMethod[Any, Any]
"""A method that was chosen by its name; only the method itself knows the types of its state and settings."""
