"""What a tracking method is: records of one scan in, an estimate out, and a state in between.

An online method is two pure functions.  `init` makes the state before the first scan,
`step` takes a scan in and returns the next state and the estimate; neither changes its
arguments (but for the generator, from which it draws).  A state belongs to one target.
Scans come in the order of their times, at any intervals, from any set of sensors.
A batch method takes in the record of a target in blocks, and gives states out when it has
seen enough of what comes after them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from numpy.random import Generator

from occlog.array_types import Floats, Ints
from occlog.measure.scans.scan import Scan
from occlog.records.scene import Scene


class Height(NamedTuple):
    """The third coordinate of an estimate in space."""

    z: float
    vz: float  # per second; NaN if the method does not estimate it
    covariance: Floats  # (3,) of x and z, y and z, z and z


class Cloud(NamedTuple):
    """Where a filter thinks that the target is: L weighted places."""

    xy: Floats  # (L, 2)
    weights: Floats  # (L,), sum 1


class SensorErrors(NamedTuple):
    """Errors of the sensors' poses, true minus stated, as they are thought to be."""

    mean: Floats  # (S, 3) dx, dy, dyaw [rad]
    deviation: Floats  # (S, 3) standard deviations


class Estimate(NamedTuple):
    """What a filter knows after a scan, and how it fared."""

    xy: Floats  # (2,)
    velocity: Floats  # (2,) per second; NaN if the method does not estimate it
    covariance: Floats  # (2, 2) of xy
    ess: float  # effective sample size
    log_likelihood: float  # of the scan given those before; NaN if no state was possible
    n_looked: int
    n_seen: int
    fallback: str  # as in `occlog.records.tables.Diagnostics`
    used: tuple[int, ...]  # sensors, places in `sensor_names`
    calibration: SensorErrors | None = None  # None: not estimated
    height: Height | None = None  # None: the method tracks on the ground


class Smoothed(NamedTuple):
    """T states of one target, estimated from what was seen before and after them."""

    t_ns: Ints  # (T,)
    xy: Floats  # (T, 2)
    velocity: Floats  # (T, 2) per second
    covariance: Floats  # (T, 4, 4) of x, y, vx, vy
    log_likelihood: Floats  # (T,) of the scan at the estimate; NaN: nothing was seen
    n_looked: Ints  # (T,)
    n_seen: Ints  # (T,)
    fallback: tuple[str, ...]  # (T,) as in `occlog.records.tables.Diagnostics`
    used: tuple[tuple[int, ...], ...]  # (T,) sensors, places in `sensor_names`
    iterations: int  # that it took
    converged: bool


class Batch(NamedTuple):
    """A method that estimates a stretch of a trajectory at once."""

    summary: str
    config: type  # frozen dataclass of its settings, validated; see `settings.configure`
    defaults: Callable[[str], Any]  # settings that suit a scene's length unit
    begin: Callable[[Scene, Any], Any]  # the state of one target before anything is known
    advance: Callable[[Any, Sequence[Scan], bool], tuple[Any, Smoothed]]  # more scans; whether none will follow


class Online(NamedTuple):
    """A method that takes in one scan after the other."""

    summary: str
    config: type  # frozen dataclass of its settings, validated; see `settings.configure`
    defaults: Callable[[str], Any]  # settings that suit a scene's length unit
    init: Callable[[Scene, Any, Generator], Any]
    step: Callable[[Any, Scan, Generator], tuple[Any, Estimate | None]]  # None: the scan tells no position
    predict: Callable[[Any, int, Generator], Cloud] | None = None  # where the target will be; for selecting cameras


class Joint(NamedTuple):
    """A method with one state for all targets, which cameras may help: see `occlog.track.imm.filter`.

    States, reports, questions and memories are the method's own.
    """

    summary: str
    config: type  # frozen dataclass of its settings, validated; see `settings.configure`
    defaults: Callable[[str], Any]  # settings that suit a scene's length unit
    init: Callable[[Scene, Any, Generator], Any]
    step: Callable[[Any, Scan, Generator], tuple[Any, Any]]  # state and rows of arrays -> state, report
    estimates: Callable[[Any, Scene], list[tuple[int, Estimate]]]  # of a report, by target
