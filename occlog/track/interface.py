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
    """Height `z`, vertical velocity `vz` (NaN: not estimated), and covariance (3,) xz, yz, zz of an estimate in 3-D."""

    z: float
    vz: float  # per second; NaN if the method does not estimate it
    covariance: Floats  # (3,) of x and z, y and z, z and z


class ParticleSet(NamedTuple):
    """L weighted particles of a target's position: `xy` (L, 2) in the scene's unit, and weights (L,) with sum 1."""

    xy: Floats  # (L, 2)
    weights: Floats  # (L,), sum 1


class SensorErrors(NamedTuple):
    """Estimated pose errors of S sensors, true minus stated.

    `mean` and `deviation` (standard deviations) are (S, 3): x and y in the scene's unit, and yaw [rad].
    """

    mean: Floats  # (S, 3) dx, dy, dyaw [rad]
    deviation: Floats  # (S, 3) standard deviations


class BearingResiduals(NamedTuple):
    """Normalised residuals of n bearings from the estimates, and whether the bearings are true.

    Columns (n,): `row`, the index of the estimate (0 if there is only one), `sensor` index, `residual` in stated
    standard deviations, `expected_variance` of it if the bearing is true, and `inlier_probability`.
    """

    row: Ints  # (n,) which estimate, from 0; 0 where there is one alone
    sensor: Ints  # (n,) index in `sensor_names`
    residual: Floats  # (n,) in standard deviations as stated
    expected_variance: Floats  # (n,) variance that it has if the bearing is true
    inlier_probability: Floats  # (n,) probability that it is true


class NoiseScales(NamedTuple):
    """Estimated factors of the stated variances of the bearings and of the motion; 1: as stated."""

    bearings: float
    motion: float


class StationBias(NamedTuple):
    """Estimated constant error of the ranges of one station [scene unit], and its standard error.

    A positive bias means that ranges are too long.
    """

    station: int
    bias: float  # by how much they are too long
    error: float  # its standard error


class Estimate(NamedTuple):
    """Estimate of one target by a filter after a scan, with diagnostics.

    `xy` (2,), `velocity` (2,) [scene unit/s] (NaN: not estimated) and `covariance` (2, 2) of xy; effective sample size
    and log likelihood (NaN: none); numbers of sensors with a frame and with a detection; `fallback`, the reason of a
    restart or of coasting as in table `diagnostics`; indices of the sensors used and of those that saw the target; pose
    errors, height and residuals where the method estimates them (else None).
    """

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
    """Smoothed state of a target at one time: `xy` (2,), `velocity` (2,) [scene unit/s], `covariance` of xy (2, 2).

    Of a radio tag the covariance is (4, 4), of x, y, vx, vy. `height` is None for methods on the ground plane.
    """

    xy: Floats  # (2,)
    velocity: Floats  # (2,) per second
    covariance: Floats  # (2, 2) of xy; of a tag (4, 4) of x, y, vx, vy
    height: HeightEstimate | None = None


class SmoothedTrajectory(NamedTuple):
    """Smoothed states of one target at T times, with diagnostics.

    `xy` and `velocity` (T, 2), `covariance` (T, 4, 4) of x, y, vx, vy in scene units and seconds; log likelihoods (T,)
    (NaN: nothing was seen); per time the numbers and indices of sensors used and of those that saw the target;
    iterations and convergence of the search; residuals, noise factors, competing modes and range biases where the
    method estimates them.
    """

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
    """How a method uses moving occluders: their `diameter` [scene unit], and the maximum age of priors [s]."""

    diameter: float  # of each, in the scene's unit
    max_age_s: float  # priors that are older are not used


class TargetPredictor(NamedTuple, Generic[State, Config]):
    """Position prediction of a method, as used by the selection of cameras: functions of its state or settings.

    `cloud(state, t_ns, generator)` returns predicted particles, `step_s` the time that selection intervals are counted
    in, `detection` the detection probability of cameras without one in the scene (None: 1), `hiding` the form of the
    occlusion probability.
    """

    cloud: Callable[
        [State, int, Generator], ParticleSet
    ]  # at a time not before the last scan; the state stays as it is
    step_s: Callable[[Config], float]  # reference step, in which the time between selections is counted
    detection: Callable[[Config], float | None]  # P_D of cameras without one in the scene; None: 1
    hiding: Callable[[Config], int] | None = (
        None  # form of `core.occlusion.hidden` that occluders count by; None: IMPROVED
    )


class Smoothing(NamedTuple, Generic[State, Config]):
    """How a filter's estimates are improved by later measurements: three functions of the method.

    `wanted(config)` returns whether and how to smooth, `trace(state)` what the backward pass needs of the last step (of
    a type that only the method knows), and `back(traces, config, generator)` one smoothed state for each trace, in
    order.
    """

    wanted: Callable[[Config], LagConfig]  # whether and how
    trace: Callable[[State], Any]  # of the last step
    back: Callable[
        [Sequence[Any], Config, Generator], list[SmoothedState]
    ]  # traces of steps in order; a state for each


class Online(NamedTuple, Generic[State, Config]):
    """A tracking method with one state for each target, which processes one scan after the other.

    `init(scene, config, generator)` creates the state, `step(state, scan, generator)` returns the next state and the
    estimate (None: the scan determines no position), `started(config)` whether the settings give a start position. The
    other fields state what the method can do: moving occluders, prediction for camera selection, pose errors,
    smoothing, distance measurements, and its own checks of bearings.
    """

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
    """A tracking method that estimates a segment of one target's trajectory at once.

    `begin(scene, config, returned)` creates the state of a target (`returned`: it is back after a pause), and
    `advance(state, scans, last)` adds scans and returns the next state and the released trajectory. `lag_ns` is how
    long states wait for later data (None: to the end), `forgets_ns` the pause after which a target restarts.
    """

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
    """A tracking method with one state for all targets, which associates rows with targets itself.

    `init(scene, config, generator)` creates the state, `step(state, scan, generator)` takes rows of microphone arrays
    and returns the next state and a report, of which `estimates(report, scene)` lists (target, estimate).
    """

    config: type[Config]
    init: Callable[[Scene, Config, Generator], State]
    step: Callable[[State, Scan, Generator], tuple[State, Report]]  # rows of arrays alone
    estimates: Callable[[Report, Scene], list[tuple[int, Estimate]]]  # by target
    smoothing: Smoothing[tuple[State, int], Config] | None = None  # of one target of a state; None: no smoother


class JointMethod(NamedTuple, Generic[State, Config]):
    """A tracking method with one state for all labelled objects, which occlude one another.

    `init(scene, config, generator)` creates the state; `step(state, scan, generator)` returns the next state and a list
    of (object, estimate).
    """

    config: type[Config]
    init: Callable[[Scene, Config, Generator], State]
    step: Callable[[State, Scan, Generator], tuple[State, list[tuple[int, Estimate]]]]  # estimates by object
    started: Callable[[Config], bool] = lambda _: False
    smoothing: Smoothing[tuple[State, int], Config] | None = None  # of one object of a state; None: no smoother


AnyMethod = Online[Any, Any] | Batch[Any, Any] | Joint[Any, Any, Any] | JointMethod[Any, Any]
"""A method that was chosen by its name; only the method itself knows the types of its state and settings."""
