"""The filters `ekf`, `ukf` and `iekf`: predict, gate, update; begin, and restart where the target is lost.

They differ in the update alone (`occlog.track.methods.kalman.updates`).  What a Gaussian cannot hold has no place in
them: that a camera did not see the target, moving occluders, and several positions at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.visibility import prior_moments
from occlog.core.plane import floor_moments, make_floor
from occlog.errors import InputError
from occlog.filtering.false_bearings import FalseBearings
from occlog.filtering.gaussian import Gaussian, PosteriorRecord, predicted, rts_smooth
from occlog.filtering.lifecycle import advance, elapsed, is_lost, track_loss_count
from occlog.filtering.likelihood.directions import PackedScan
from occlog.filtering.likelihood.measurement_model import (
    Linearisation,
    LinearisedRows,
    MeasurementWorld,
    azimuths,
    linearise,
    linearised,
    measured,
    near_sensor_variance,
    residuals,
    rows_of,
)
from occlog.filtering.motion.ornstein_uhlenbeck import OrnsteinUhlenbeck
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import Estimate, Online, SmoothedState, Smoothing
from occlog.track.methods.apf.model import pack_noise, pack_scan, pack_sensors, read_noise, with_distances

from . import updates
from .config import NONE, EkfConfig, IekfConfig, KalmanConfig, UkfConfig, WalkConfig
from .outliers import RowsUpdate, log_false_density, mixture_update, moment_matched
from .stations import StationUpdate, extended, first_position, innovation_gating, unscented
from .updates import Updated, by_linearisation, gated_rows, gauss_newton

K = TypeVar("K", bound=KalmanConfig)
MAX_INITIAL_MEASUREMENTS = 40
"""Maximum number of measurements from which a filter begins, the most certain ones."""
INFLATION_TIME_S = 1.0
"""A target of which most reports disagree with the prediction is as far from it as it goes in about this time [s]."""
MANOEUVRE_PROBABILITY = 0.01
"""Probability that a target is not where it was predicted, in a scan of which most reports disagree."""
INFLATED = "inflated"
"""Value of `fallback`: most reports disagreed with the prediction, which was made wider."""
INITIAL_SEARCH_CONFIG = IekfConfig(visibility_constraint=NONE)
"""How the first position is searched."""


class KalmanState(NamedTuple, Generic[K]):
    """State of the filter of one target after the last scan: Gaussian of (x, y, vx, vy), and the track-loss counter.

    `t_ns` is None before the first scan. `anywhere` is the prior of a target that has not been seen, `false` the
    statistics of false bearings.
    """

    config: K
    world: MeasurementWorld
    read_px: Floats
    anywhere: Gaussian  # before anything was seen
    known: Gaussian
    t_ns: int | None
    loss_count: int  # reports outside the gate more than inside, since they last were even
    false: FalseBearings = FalseBearings()
    link: PosteriorRecord | None = None  # what the last step leaves for the way back


def init(scene: Scene, config: K, rng: Generator) -> KalmanState[K]:  # noqa: ARG001
    """Return the state before the first scan: around `config.start`, or as wide as the floor.

    InputError for a scene without free floor; `rng` is not used.
    """
    world = world_of(scene)
    anywhere = anywhere_of(scene, world, config)
    known = anywhere
    if config.start is not None:
        known = gaussian_of(np.array(config.start[:2]), config.start[2] ** 2 * np.eye(2), config)
    return KalmanState(config, world, read_noise(scene), anywhere, known, None, 0)


def world_of(scene: Scene) -> MeasurementWorld:
    """Return the sensors of a scene with their noise, and its floor."""
    return MeasurementWorld(
        pack_sensors(scene), pack_noise(scene), make_floor(scene.region, [o.polygon for o in scene.occluders])
    )


def anywhere_of(scene: Scene, world: MeasurementWorld, config: WalkConfig) -> Gaussian:
    """Return the Gaussian prior of a target over the whole floor, or, without a room, over the region that sensors see.

    The velocity has mean 0. InputError for a scene without free floor.
    """
    try:
        moments = floor_moments(world.floor) if scene.views is None else prior_moments(scene.views)
    except ValueError as error:
        raise InputError(f"scene: {error}; make the room larger", id="no-room") from error
    return gaussian_of(*moments, config)


def motion_of(config: WalkConfig) -> OrnsteinUhlenbeck:
    """Return the motion model with the parameters that the settings state."""
    return OrnsteinUhlenbeck(config.rms_speed, config.velocity_time_constant_s, config.process_noise_position)


def gaussian_of(xy: Floats, covariance: Floats, config: WalkConfig) -> Gaussian:
    """Return the Gaussian of (x, y, vx, vy) at position `xy` (2,) with `covariance` (2, 2) and unknown velocity.

    The velocity has mean 0 and the variance of the motion model.
    """
    whole = np.zeros((4, 4))
    whole[:2, :2], whole[2:, 2:] = covariance, motion_of(config).velocity_variance * np.eye(2)
    return Gaussian(np.array([*xy, 0.0, 0.0]), whole)


Update = Callable[[Gaussian, LinearisedRows, Linearisation, MeasurementWorld, K], Updated]


def stepper(
    update: Update[K], by_stations: StationUpdate | None
) -> Callable[[KalmanState[K], Scan, Generator], tuple[KalmanState[K], Estimate]]:
    """Return the step function of a filter, from its update by bearings and its update by distances of stations.

    The function takes state, scan and random numbers, and returns the next state and the estimate; ValueError for a
    scan that is earlier than the last.

    Args:
        update: updates a Gaussian by rows of directions.
        by_stations: updates a Gaussian by distances; None: distances are not used.
    """

    def step(state: KalmanState[K], scan: Scan, rng: Generator) -> tuple[KalmanState[K], Estimate]:  # noqa: ARG001
        config, world = state.config, state.world
        packed = pack_scan(scan, state.read_px, use_score=False)
        rows = rows_of(packed)
        dt = elapsed(state.t_ns, scan.t_ns)
        distances = None if scan.measured is None or by_stations is None else scan.measured.distances
        stations = 0 if distances is None else len(distances.kind)

        epsilon = state.false.probability(config.false_bearing_probability)

        def of_true(known: Gaussian, own: LinearisedRows, near: Linearisation) -> Updated:
            return update(known, own, near, world, config)

        def linear(known: Gaussian, own: LinearisedRows, near: Linearisation) -> Updated:
            return by_linearisation(known, own, near, world)

        def initiate(reason: str) -> KalmanUpdate:
            if distances is not None:
                first, used = first_position(state.anywhere, rows, distances, world, config.gate)
                return KalmanUpdate(Updated(first, math.nan, reason), used, state.false, begun=True, restarted=True)
            taken = initial_update(state.anywhere)
            return taken._replace(done=taken.done._replace(fallback=reason), restarted=True)

        def predict_and_update(dt: float) -> KalmanUpdate:
            known = predicted(state.known, *motion_of(config).transition(dt))
            taken = by_directions(known)
            if distances is None or by_stations is None:
                return taken
            inside = innovation_gating(known, distances, config.gate)
            after, score = by_stations(taken.done.state, distances.take(inside))
            done = Updated(after, taken.done.score + score, taken.done.fallback)
            return taken._replace(done=done, against=int(np.count_nonzero(~inside)))

        def of_mixture(
            known: Gaussian, rows: LinearisedRows, near: Linearisation, inside: Bools, by: RowsUpdate
        ) -> KalmanUpdate:
            """Return the state `known` after rows inside the gate, each true or false; labelled rows outside are false.

            Args:
                known: the prediction.
                rows: all rows.
                near: these, linearised.
                inside: (R,) rows inside the gate.
                by: updates a Gaussian by rows that are all true.
            """
            own, outside = rows, ~inside & rows.labelled
            if not inside.all():
                own, near = rows.take(inside), near.take(inside)
            done, inlier = mixture_update(known, own, near, world, epsilon, by)
            false = state.false.counted(inlier)
            if outside.any():
                false = false.counted(np.zeros(np.count_nonzero(outside)))
                log_false = math.log(max(epsilon, 1e-300)) + log_false_density(rows.take(outside), world)
                done = done._replace(score=done.score + float(log_false.sum()))
            return KalmanUpdate(done, own.sensor[inlier >= 0.5], false, begun=state.t_ns is None)

        def initial_update(anywhere: Gaussian) -> KalmanUpdate:
            position, kept = initial_position(anywhere, rows, world, config.gate)
            inside = np.zeros(len(rows.sensor), dtype=np.bool_)
            inside[kept] = True
            taken = of_mixture(anywhere, rows, linearise(position, rows, world), inside, linear)
            return taken._replace(begun=True)

        def by_directions(known: Gaussian) -> KalmanUpdate:
            xy, P = known.mean[:2], known.covariance[:2, :2]
            wide = rows._replace(variance=rows.variance + near_sensor_variance(xy, P, rows, world))
            near = linearise(xy, wide, world)
            inside = gated_rows(known, wide, near, config.gate)
            taken = of_mixture(known, wide, near, inside, of_true)
            if not _most_outside_gate(rows, inside):
                return taken
            # Most reports disagree, as of a target that has turned: where they meet, not far from the prediction
            turned = initial_update(_inflated(known, config))
            turned = turned._replace(done=turned.done._replace(fallback=INFLATED))
            if not epsilon > 0.0:
                return turned
            odds = math.log(MANOEUVRE_PROBABILITY) + turned.done.score - taken.done.score
            odds -= math.log1p(-MANOEUVRE_PROBABILITY)
            share = 1.0 / (1.0 + math.exp(-min(max(odds, -700.0), 700.0)))
            both = moment_matched(np.array([share, 1.0 - share]), [turned.done.state, taken.done.state])
            probable = turned if share >= 0.5 else taken
            return probable._replace(done=probable.done._replace(state=both))

        def loss(taken: KalmanUpdate) -> tuple[int, bool]:
            count = 0 if taken.restarted else _track_loss(state.loss_count, packed, taken, stations)
            lost = not taken.restarted and (
                is_lost(count, config.track_loss_count) or left_scene(taken.done.state, world)
            )
            return (0, True) if lost else (count, False)

        known = state.t_ns is not None or config.start is not None
        (done, used, false, begun, restarted, _), loss_count = advance(
            dt, config.max_gap_s, known=known, initiate=initiate, update=predict_and_update, loss=loss
        )
        link = PosteriorRecord(done.state, 0.0 if restarted else dt, begun=begun)
        state = state._replace(known=done.state, t_ns=scan.t_ns, loss_count=loss_count, false=false, link=link)
        estimate = _estimate(done, packed, used)
        return state, estimate if distances is None else with_distances(estimate, distances)

    return step


class KalmanUpdate(NamedTuple):
    """Result of a scan: posterior, sensors that contributed, statistics of false bearings, and how it came about."""

    done: Updated
    used: Ints
    false: FalseBearings
    begun: bool
    restarted: bool = False  # from the scan alone
    against: int = 0  # measurements of stations outside the gate


def _most_outside_gate(rows: LinearisedRows, inside: Bools) -> bool:
    """Return whether at least two labelled rows are outside the gate, and more than are inside (`inside` (R,))."""
    against = int(np.count_nonzero(rows.labelled & ~inside))
    return against >= 2 and against > int(np.count_nonzero(rows.labelled & inside))


def _inflated(known: Gaussian, config: KalmanConfig) -> Gaussian:
    """Return the prediction with a wider position and unknown velocity, for a target that has turned.

    The position is widened by the way that a target covers in `INFLATION_TIME_S`.
    """
    away = (config.rms_speed * INFLATION_TIME_S) ** 2 * np.eye(2)
    return gaussian_of(known.mean[:2], known.covariance[:2, :2] + away, config)


def left_scene(known: Gaussian, world: MeasurementWorld) -> bool:
    """Return whether the target's mean is farther outside the region's bounding box than the extent of the box."""
    low, high = world.floor.room.min(axis=0), world.floor.room.max(axis=0)
    xy = known.mean[:2]
    return not bool(np.all((xy >= 2.0 * low - high) & (xy <= 2.0 * high - low)))


def initial_position(
    anywhere: Gaussian, rows: LinearisedRows, world: MeasurementWorld, gate: float
) -> tuple[Floats, Ints]:
    """Return the most probable position (2,) given the rows of one scan, and the indices of the rows that agree.

    Of each sensor the nearest row counts, if within the gate, so that candidates of others and false bearings do not.

    Args:
        anywhere: prior of the target.
        rows: measurements of directions in the scan.
        world: sensors and floor.
        gate: largest deviation of a row [standard deviations].
    """
    order = np.sort(np.argsort(rows.variance, kind="stable")[:MAX_INITIAL_MEASUREMENTS])
    rows = rows.take(order)
    starts = np.vstack([anywhere.mean[None, :2], bearing_intersections(rows, world)])
    _, costs = zip(*(_gated_rows(position, anywhere, rows, world, gate) for position in starts), strict=True)
    start = starts[int(np.argmin(costs))]
    kept, _ = _gated_rows(start, anywhere, rows, world, gate)
    if not len(kept):
        return anywhere.mean[:2], kept
    position, _, _ = gauss_newton(start, anywhere, rows.take(kept), world, INITIAL_SEARCH_CONFIG)
    return position, order[kept]


def _gated_rows(
    position: Floats, anywhere: Gaussian, rows: LinearisedRows, world: MeasurementWorld, gate: float
) -> tuple[Ints, float]:
    """Return the indices of the rows that agree with a position, one for each sensor at most, and its cost.

    The cost is minus the log of prior times likelihood, in which a sensor without a row within the gate costs gate^2 /
    2.

    Args:
        position: (2,) position.
        anywhere: prior of the target.
        rows: measurements of directions.
        world: sensors.
        gate: largest deviation of a row [standard deviations].
    """
    expected, ahead = measured(position[None], rows, world)
    _, variance = linearised(position, rows, world)
    off = np.where(ahead[0], residuals(expected[0], rows) ** 2 / variance, np.inf)
    nearest = [own[np.argmin(off[own])] for s in np.unique(rows.sensor) for own in [np.flatnonzero(rows.sensor == s)]]
    chosen = np.array(nearest, dtype=np.int64)
    away = position - anywhere.mean[:2]
    cost = 0.5 * float(np.minimum(off[chosen], gate**2).sum())
    cost += 0.5 * float(away @ np.linalg.solve(anywhere.covariance[:2, :2], away))
    return chosen[off[chosen] <= gate**2], cost


def bearing_intersections(rows: LinearisedRows, world: MeasurementWorld) -> Floats:
    """Return (K, 2) intersections of the lines of sight of all pairs of rows of different sensors, ahead of both."""
    azimuth = azimuths(rows, world)
    e, origin = np.column_stack([np.cos(azimuth), np.sin(azimuth)]), world.sensors.xy[rows.sensor]
    i, j = np.nonzero(rows.sensor[:, None] < rows.sensor[None, :])
    base = origin[j] - origin[i]
    sine = e[i, 0] * e[j, 1] - e[i, 1] * e[j, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along_i = (base[:, 0] * e[j, 1] - base[:, 1] * e[j, 0]) / sine
        along_j = (base[:, 0] * e[i, 1] - base[:, 1] * e[i, 0]) / sine
    ahead = np.isfinite(along_i) & (along_i > 0.0) & (along_j > 0.0)
    return np.asarray(origin[i][ahead] + along_i[ahead, None] * e[i][ahead])


def _track_loss(before: int, packed: PackedScan, taken: KalmanUpdate, measured: int) -> int:
    """Return the track-loss counter after a scan, by its labelled reports and measurements of stations.

    Args:
        before: the counter before.
        packed: the scan.
        taken: result of the update, with the sensors that contributed.
        measured: number of measurements of stations.
    """
    reports = packed.sensor[packed.labelled & (np.diff(packed.first) > 0)]
    against = int(np.count_nonzero(~_among(reports, taken.used))) + taken.against
    return track_loss_count(before, against, len(reports) + measured)


def _among(numbers: Ints, some: Ints) -> Bools:
    """Return (n,) booleans: the number is in `some`; faster than `np.isin` for few."""
    return np.asarray((numbers[:, None] == some).any(axis=1))


def _estimate(done: Updated, packed: PackedScan, agree: Ints) -> Estimate:
    """Return the estimate of a scan from its update; `agree` are the sensors with an inlier.

    A sensor has detected the target if it has a labelled measurement, or a candidate that is an inlier.
    """
    seen = np.diff(packed.first) > 0
    seen &= packed.labelled | _among(packed.sensor, agree)
    return Estimate(
        xy=done.state.mean[:2],
        velocity=done.state.mean[2:],
        covariance=np.ascontiguousarray(done.state.covariance[:2, :2]),
        ess=math.nan,
        log_likelihood=done.score,
        n_observing=len(packed.sensor),
        n_detected=int(np.count_nonzero(seen)),
        fallback=done.fallback,
        used=tuple(packed.sensor.tolist()),
        seen_by=tuple(packed.sensor[seen].tolist()),
    )


def _trace(state: KalmanState[K]) -> PosteriorRecord:
    """Return the record of the last step that smoothing needs."""
    assert state.link is not None, "a trace is asked for after a step"
    return state.link


def _smoothed(traces: Sequence[PosteriorRecord], config: K) -> list[SmoothedState]:
    """Return the smoothed state for each record, in the order of time, by the Rauch-Tung-Striebel recursion."""
    found = rts_smooth(traces, motion_of(config).transition)
    return [SmoothedState(one.mean[:2], one.mean[2:], one.covariance[:2, :2]) for one in found]


def _method(config: type[K], update: Update[K], by_stations: StationUpdate | None) -> Online[KalmanState[K], K]:
    """Return a tracking method with smoothing, made of its settings and its updates.

    Args:
        config: class of settings.
        update: updates a state by the directions of a scan.
        by_stations: updates a state by ranges, differences and strengths; None: the method uses no such measurements.
    """
    return Online(
        config=config,
        init=init,
        step=stepper(update, by_stations),
        started=lambda own: own.start is not None,
        measured=by_stations is not None,
        smoothing=Smoothing(
            wanted=lambda own: own,
            trace=_trace,
            back=lambda traces, own, rng: _smoothed(traces, own),  # noqa: ARG005
        ),
    )


EKF: Online[KalmanState[EkfConfig], EkfConfig] = _method(
    EkfConfig, lambda known, rows, near, world, _: by_linearisation(known, rows, near, world), extended
)
UKF: Online[KalmanState[UkfConfig], UkfConfig] = _method(
    UkfConfig, lambda known, rows, _, world, config: updates.ukf(known, rows, world, config), unscented
)
IEKF: Online[KalmanState[IekfConfig], IekfConfig] = _method(
    IekfConfig,
    lambda known, rows, _, world, config: updates.iekf(known, rows, world, config, bearing_intersections(rows, world)),
    None,
)
