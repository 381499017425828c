"""A target's record as a problem of optimisation ([Rahimi] Secs. 4 and 5), and where the paper's search begins."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.core.geometry.visibility import Sensors
from occlog.errors import InputError
from occlog.records.scene import Scene
from occlog.track.methods.apf.model import pack_sensors
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.gauss_markov import GaussMarkov, constant_velocity, transitions
from occlog.track.methods.map.kernels.interior_point import move_inside
from occlog.track.methods.map.kernels.problem import (
    CAUCHY,
    HUBER,
    MIXTURE,
    SQUARE,
    TrajectoryProblem,
    chain,
    start_on_axes,
)
from occlog.track.methods.map.kernels.windows import StatePrior
from occlog.track.methods.map.measurements import SensorStations, constraints, lines_of_sight, stations
from occlog.track.methods.map.record import EMPTY, TargetRecord

LOSS = {"square": SQUARE, "huber": HUBER, "cauchy": CAUCHY, "mixture": MIXTURE}
BEND = {"square": 1.0, "huber": 1.345, "cauchy": 2.385, "mixture": 3.7}
"""Parameters of the losses: those of Huber's and Cauchy's lose 5 % where all errors are Gaussian, that of the mixture
is where a bearing uniform in an image of some hundred standard deviations is as likely as a true one, at 5 %."""


START = 1e-3
"""Distance to the constraints, as a share of the room's extent, at which a search begins."""


FORGET_EXTENTS = 1000.0
"""Earlier measurements are dropped after a pause in which process noise alone spreads positions by this many times the
extent of the sensors."""
LONGEST_S = 1e9
"""Maximum pause that is considered."""


class Pending(NamedTuple):
    """Unreleased part of a target's record, with all that its estimation needs.

    Settings, sensors `at` relative to `origin` (2,), `extent` of the scene, Gaussian prior `before` of the first state,
    measurements `record`, states X (T, 4) x, vx, y, vy found so far (fewer than times: the rest is new), `sensors` in
    scene coordinates, and the factors of the variances of bearings and motion estimated so far.
    """

    config: MapConfig
    at: SensorStations
    origin: Floats  # (2,)
    extent: float
    before: StatePrior
    record: TargetRecord
    X: Floats  # (T, 4) states found so far; fewer than times: the rest is new
    sensors: Sensors  # in the scene's own coordinates
    scales: tuple[float, float] = (1.0, 1.0)  # factors of the stated variances of lines of sight and steps, so far


def motion_of(config: MapConfig) -> GaussMarkov:
    """Return the motion model of the settings: the fitted one (A, Sigma), else constant velocity with noise."""
    if config.A is None or config.Sigma is None:
        return constant_velocity(config.process_noise_velocity, config.process_noise_position, config.model_step_s)
    A, sigma = (np.array(m, dtype=np.float64).reshape(4, 4) for m in (config.A, config.Sigma))
    return GaussMarkov(A, sigma, config.model_step_s)


def begin(scene: Scene, config: MapConfig, returned: bool = False) -> Pending:
    """Return the initial, empty record of a target with its position prior.

    Args:
        scene: room and sensors.
        config: settings of the method.
        returned: the target is back after a gap, so that `config.start` no longer holds.

    Raises:
        InputError: the scene has no extent.
    """
    low, high = scene.surroundings.min(axis=0), scene.surroundings.max(axis=0)
    extent = _extent(scene)
    if not extent > 0:
        raise InputError(
            "scene: neither the room nor the positions of sensors have an extent, so that a "
            "trajectory has no scale; add `room` to the scene",
            id="missing-value",
        )
    origin = 0.5 * (low + high) if _moves_freely(config) else np.zeros(2)
    # Without a room a target can be as far as sensors see.
    farthest = scene.region.max(axis=0) - scene.region.min(axis=0)
    position, sigma = 0.5 * (low + high), float(np.hypot(*farthest))
    # After a gap the given start no longer holds: the target may be anywhere in the room.
    if config.start is not None and not returned:
        position, sigma = np.array(config.start[:2]), config.start[2]
    mean = np.zeros(4)
    mean[::2] = position - origin
    spread = np.diag([sigma**2, config.sigma_initial_velocity**2, sigma**2, config.sigma_initial_velocity**2])
    at = stations(scene, origin, walls=config.wall_constraints)
    return Pending(
        config=config,
        at=at,
        origin=origin,
        extent=extent,
        before=StatePrior(mean, spread),
        record=EMPTY,
        X=np.empty((0, 4)),
        sensors=pack_sensors(scene, None if config.wall_constraints else [()] * len(scene.cameras)),
    )


def memory_ns(scene: Scene, config: MapConfig) -> int | None:
    """Return the pause [ns] after which a target may be anywhere by the motion model (to a factor of 2).

    None if there is no such pause below `LONGEST_S`, or the model is invalid. Over longer pauses the variances exceed
    what 64 bits hold together with those of bearings.
    """
    model, extent = motion_of(config), _extent(scene)
    try:
        seconds = model.step_s
        while seconds < LONGEST_S:
            _, (sigma,) = transitions(model, np.array([seconds]))
            if np.sqrt(np.linalg.eigvalsh(sigma[::2, ::2])[-1]) > FORGET_EXTENTS * extent:
                return round(seconds * NS)
            seconds *= 2.0
    except (ValueError, np.linalg.LinAlgError):  # the model is refused where it is used
        pass
    return None


def _extent(scene: Scene) -> float:
    """Return the diagonal of the bounding box of the scene's surroundings [scene unit]."""
    return float(np.hypot(*(scene.surroundings.max(axis=0) - scene.surroundings.min(axis=0))))


def _moves_freely(config: MapConfig) -> bool:
    """Return whether the motion model is translation-invariant (constant velocity, or fitted so).

    Then any origin of coordinates may be used.
    """
    return bool(np.allclose(motion_of(config).A[:, ::2], np.eye(4)[:, ::2], rtol=0.0, atol=1e-12))


def problem_of(pending: Pending, record: TargetRecord, inlier: Bools | None = None) -> TrajectoryProblem:
    """Return the minimisation problem of a record ([Rahimi] Eq. 8): motion chain, lines of sight and half-planes.

    Args:
        pending: unreleased part of the target's record: settings, sensors, prior.
        record: measurements of the target.
        inlier: (N,) which of the bearings that saw it constrain it; None: all.

    Raises:
        InputError: the motion model does not fit the times of the record.
    """
    config, before = pending.config, pending.before
    try:
        # Prior: a Gauss-Markov chain (Eqs. 1-3)
        steps = chain(motion_of(config), np.diff(record.t_ns) / NS, before.mean, before.spread)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise InputError(
            f"map: the motion model does not fit the times: {error}; use form cv (`occlog fit-motion`)"
        ) from error
    # Likelihood: a residual for each bearing (Eq. 4)
    lines = lines_of_sight(record, pending.at)
    # Constraints: half-planes in front of the cameras (Eq. 9), and in the room
    planes = constraints(lines, record, pending.at, config, len(record.t_ns), inlier)
    return TrajectoryProblem(steps, lines, planes, LOSS[config.loss], bend_of(config))


def bend_of(config: MapConfig) -> float:
    """Return the parameter of the loss [standard deviations]: that of the settings, else the loss's usual one."""
    return BEND[config.loss] if config.loss_threshold is None else config.loss_threshold


def start_of(pending: Pending, problem: TrajectoryProblem) -> tuple[Floats, Bools]:
    """Return feasible initial states (T, 4) x, vx, y, vy, and a mask (T,) of states with contradictory constraints.

    States found before (`pending.X`) start there; of the others, those that a camera saw on its optical axis, the rest
    in the room's centre ([Rahimi] Sec. 6); then all are moved inside the half-planes of `problem`.
    """
    config, T = pending.config, problem.T
    depth = 0.1 * pending.extent if config.initial_depth is None else config.initial_depth
    X = start_on_axes(problem.lines, T, _centre(pending), depth)
    known = len(pending.X)
    X[:known] = pending.X
    return move_inside(X, problem.planes, START * pending.extent)


def _centre(pending: Pending) -> Floats:
    """Return the centre (2,) of the room's bounding box, or the mean position of the sensors without a room."""
    hull = pending.at.hull
    return np.asarray(pending.at.position.mean(axis=0) if hull is None else 0.5 * (hull.min(axis=0) + hull.max(axis=0)))
