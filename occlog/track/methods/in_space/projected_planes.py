"""Method `pps`: projected planes selection of [Lee] Sec. 2.2 (Alg. 1), filters in the planes xy, yz and zx.

Each plane has a SIR filter of its own on (a, b, va, vb), fed with the projected angles of all
sensors; the two planes with the least variances of angles make the estimate.  Departures from
the thesis, each with its reason:

* angles and variances are those of world planes for a sensor of any pose (`occlog.core.geometry.projected_planes`),
  not the printed (2.1), (2.22) and selection rule, which are wrong on parts of the sphere;
* all three filters run, so that a switch finds a warm one, and take in all sensors;
  `running=selected` and `per_plane=best` are the thesis' way.  A plane that had to wait is started
  from the combined estimate when its turn comes;
* the axis that both planes have is weighed by inverse variance; the sums of unnormalised
  weights of one scan say little about which filter is better;
* particles are resampled as in `direct3d`.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats, Ints
from occlog.core.bounds.in_space import plane_axes
from occlog.core.geometry.projected_planes import AXES, PLANES, XY
from occlog.filtering.kernel_density import moments, resample_with_kernel, root_of, silverman_bandwidth
from occlog.filtering.lifecycle import advance, elapsed
from occlog.filtering.motion.white_acceleration import AccelerationModel, moved, turn_jump
from occlog.filtering.particles import effective_sample_size, log_of
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import Estimate, HeightEstimate, Online, ParticleSet, Smoothing, TargetPredictor

from .config import PpsConfig
from .direct3d import REFERENCE_S, ScanUpdate, begin, is_contradicted
from .importance_step import GaussianTrace, TimeStepPath, lines_of_sight, through_gaussians, update_by_scan
from .planes import (
    NOTHING,
    CombinedPosterior,
    Pair,
    PlanePosterior,
    PlaneSights,
    ProjectedAngles,
    choose_pair,
    combination_of,
    combine,
    errors_after,
    initial_errors,
    lines_in_plane,
    log_likelihood,
    moved_errors,
    plane_angles,
    reactivated,
    shared_axis,
    sights_in_plane,
)
from .sensing import ScanDirections, SpaceModel, agrees, log_room_factor, make_space, pack_directions, particles_around
from .sensing import log_likelihood as space_log_likelihood

ALL = range(len(PLANES))
Clouds = tuple[tuple[Floats, Floats], ...]
"""Particles (4, L) and log weights (L,) of each plane."""


class PpsState(NamedTuple):
    """State of method `pps` after the last scan: particles of three planes, and the state in space from two of them.

    `t_ns` and `joined` are None before the first scan. `pair` has the two selected planes, each with its best sensor;
    `loss_count` (S,) counts the contradictions of each sensor.
    """

    space: SpaceModel[PpsConfig]
    motions: tuple[AccelerationModel, ...]  # of each plane
    clouds: Clouds
    errors: Floats  # (12, 12) of the planes' states, see `plane_errors`
    joined: CombinedPosterior | None  # None: nothing is known
    pair: Pair
    t_ns: int | None
    loss_count: Ints  # (S,) see `direct3d.is_contradicted`
    begun: bool = True  # restarted with the last scan


def init(scene: Scene, config: PpsConfig, rng: Generator) -> PpsState:  # noqa: ARG001
    """Return the state before the first scan, without particles; `rng` is not used."""
    space = make_space(scene, config)
    loss_count = np.zeros(len(space.ears.reach), dtype=np.int64)
    return PpsState(space, plane_motions(space.motion), (), np.zeros((12, 12)), None, NOTHING, None, loss_count)


def plane_motions(motion: AccelerationModel) -> tuple[AccelerationModel, ...]:
    """Return the motion model of each plane, with acceleration and noise of its two axes.

    The turn of `motion` is that of the plane in which it lies, 0 in the others, where `_turned` adds its effect.
    """
    parts = []
    for axes in AXES:
        turn = motion.turn if axes == motion.axes else 0.0
        parts.append(AccelerationModel(motion.acceleration[list(axes)], motion.density[list(axes)], turn))
    return tuple(parts)


def step(state: PpsState, scan: Scan, rng: Generator) -> tuple[PpsState, Estimate]:
    """Return the state after a scan and the estimate, by [Lee] Alg. 1.

    ValueError for a scan that is earlier than the last.
    """
    space, config = state.space, state.space.config
    near = 0.5 * (space.low + space.high) if state.joined is None else state.joined.mean[:3]
    heard = pack_directions(scan, space.ears, near[:2], use_score=config.use_score)
    # Project the directions into the planes ([Lee] Eqs. 2.1-2.3, corrected)
    angles = plane_angles(heard)

    def initiate(reason: str) -> ScanUpdate | PlaneUpdate:
        return begin(space, heard, reason, rng) if reason else _first(state, heard, rng)

    def loss(found: ScanUpdate | PlaneUpdate) -> tuple[Ints, bool]:
        """Return the counts of contradictions, and whether the planes are lost.

        They are lost if sensors contradicted them for several scans, or if a plane in use explains no measurement.
        """
        if isinstance(found, ScanUpdate):
            return state.loss_count, False
        agree = agrees(found.joined.mean[None, :3], heard, config.gate)[0]
        loss_count, lost = is_contradicted(state.loss_count, agree, heard, config)
        return loss_count, lost or not all(math.isfinite(f.log_evidence) for f in found.used)

    found, loss_count = advance(
        elapsed(state.t_ns, scan.t_ns),
        config.max_gap_s,
        known=state.joined is not None,
        initiate=initiate,
        update=partial(_updated, state, heard, angles, rng),
        loss=loss,
    )
    if isinstance(found, ScanUpdate):
        return _started(state._replace(loss_count=loss_count), scan.t_ns, heard, angles, found, rng)
    after = state._replace(
        clouds=found.clouds,
        errors=found.errors,
        joined=found.joined,
        pair=found.pair,
        t_ns=scan.t_ns,
        loss_count=loss_count,
        begun=False,
    )
    ess, log_sum = min(f.ess for f in found.used), sum(f.log_evidence for f in found.used)
    return after, _estimate(found.joined, heard, config, ess, log_sum, "", found.pair)


class PlaneUpdate(NamedTuple):
    """Result of an update with a scan: particles of all planes, and the state combined of the two selected planes.

    `errors` (12, 12) is the joint error covariance of the planes' states; `used` are the posteriors of the two planes.
    """

    clouds: Clouds
    errors: Floats  # (12, 12)
    joined: CombinedPosterior
    pair: Pair
    used: tuple[PlanePosterior, PlanePosterior]  # what the two planes know


def _updated(
    state: PpsState, heard: ScanDirections, angles: ProjectedAngles, rng: Generator, dt: float
) -> ScanUpdate | PlaneUpdate:
    """Return the planes updated with a scan, `dt` [s] after the last one, and the state combined of two of them.

    Args:
        state: state after the last scan.
        heard: directions of the scan in the world.
        angles: these directions projected to the planes.
        rng: generator of the random numbers drawn.
        dt: time since the last scan [s].
    """
    space, config = state.space, state.space.config
    assert state.joined is not None
    # Select the two planes with the least variance of angles, about where the target should be by now
    ahead = state.joined.mean[:3] + dt * state.joined.mean[3:]
    pair = choose_pair(config.selection, heard, angles, ahead, state.pair)
    # Propose, weigh and resample in each plane (Eqs. 2.9-2.11 by particles)
    state = _woken(state, pair, rng)
    clouds, flats, likelihoods = _taken_in(state, dt, pair, heard, angles, rng)
    # What the planes' errors have in common
    errors = errors_after(moved_errors(state.errors, space.motion, dt), heard, angles, likelihoods, flats)
    # Combine the two planes to one state in space (Eqs. 2.17-2.21)
    used = flats[pair[0][1]], flats[pair[1][1]]
    joined = combine((pair[0][1], pair[1][1]), used, config.combining, errors)
    return PlaneUpdate(clouds, errors, joined, pair, used)


def predict(state: PpsState, t_ns: int, rng: Generator) -> ParticleSet:
    """Return weighted (x, y) positions predicted for time `t_ns`, not before the last scan, by plane xy.

    The state is not changed. Before the first scan they are uniform over the box of the room and all sensors.
    """
    space, n = state.space, state.space.config.particles
    even = np.full(n, 1.0 / n)
    if state.joined is None or state.t_ns is None:
        return ParticleSet((space.low + (space.high - space.low) * rng.random((n, 3)))[:, :2], even)
    cloud, log_weights = state.clouds[XY]
    if space.config.running == "selected" and XY not in (state.pair[0][1], state.pair[1][1]):
        cloud, log_weights = _reseeded(state.joined, XY, n, rng), np.log(even)
    dt = min((t_ns - state.t_ns) / NS, space.config.max_gap_s)
    ahead = moved(cloud, state.motions[XY], dt, rng, _turned(state, XY, dt))
    return ParticleSet(np.ascontiguousarray(ahead[:2].T), np.exp(log_weights))


def trace(state: PpsState) -> GaussianTrace:
    """Return the record of the last step that smoothing needs: the combined mean and covariance."""
    assert state.t_ns is not None
    assert state.joined is not None
    return GaussianTrace(state.t_ns, state.joined.mean, state.joined.covariance, state.begun)


def _first(state: PpsState, heard: ScanDirections, rng: Generator) -> ScanUpdate:
    """Return initial particles in space (6, L) with weights: around the setting `start`, weighted by the first scan.

    Without `start`, or if no particle around it agrees with the scan (fallback `restart`), they are drawn from the
    scan.
    """
    space, config = state.space, state.space.config
    if config.start is None:
        return begin(space, heard, "", rng)
    n = config.particles * config.initial_particle_factor
    cloud, weights, log_sum = update_by_scan(
        particles_around(space, config.start, n, rng),
        np.full(n, -math.log(n)),
        TimeStepPath(space.motion, 0.0),
        partial(lines_of_sight, heard, space.chances),
        lambda xyz: space_log_likelihood(xyz, heard, space),
        config=config,
        rng=rng,
        log_going=lambda _, after: log_room_factor(None, after, space),
    )
    return ScanUpdate(cloud, weights, log_sum, "") if math.isfinite(log_sum) else begin(space, heard, "restart", rng)


def _started(
    state: PpsState, t_ns: int, heard: ScanDirections, angles: ProjectedAngles, draw: ScanUpdate, rng: Generator
) -> tuple[PpsState, Estimate]:
    """Return the state with all planes reinitialised from particles in space, and the estimate of the scan.

    Args:
        state: state before, without regard to its planes.
        t_ns: time of the scan [ns].
        heard: directions of the scan in the world.
        angles: these directions projected to the planes.
        draw: weighted particles (6, L).
        rng: generator of the random numbers drawn.
    """
    config = state.space.config
    mean, covariance = moments(draw.cloud, draw.weights)
    clouds, n = [], config.particles
    for p in ALL:
        rows = plane_axes(p)
        part = covariance[np.ix_(rows, rows)]
        width = config.kernel_bandwidth * silverman_bandwidth(n, 4)
        cloud = resample_with_kernel(
            np.ascontiguousarray(draw.cloud[rows]), draw.weights, mean[rows], part, n, width, rng
        )
        clouds.append((cloud, np.full(n, -math.log(n))))
    pair = choose_pair(config.selection, heard, angles, mean[:3], state.pair)
    planes = (pair[0][1], pair[1][1])
    joined = CombinedPosterior(mean, covariance, combination_of(planes, shared_axis(*planes), np.full((2, 2), 0.5)))
    after = state._replace(
        clouds=tuple(clouds), errors=initial_errors(covariance), joined=joined, pair=pair, t_ns=t_ns, begun=True
    )
    ess = effective_sample_size(draw.weights)
    return after, _estimate(joined, heard, config, ess, draw.log_likelihood, draw.fallback, pair)


def _woken(state: PpsState, pair: Pair, rng: Generator) -> PpsState:
    """Return the state with the planes of `pair` that did not run before started from the combined estimate.

    With the setting `running=all` all planes run, and the state is returned unchanged.
    """
    if state.space.config.running == "all" or state.joined is None:
        return state
    before, clouds, errors = {p for _, p in state.pair}, list(state.clouds), state.errors
    for _, p in pair:
        if p not in before:
            n = state.space.config.particles
            clouds[p] = (_reseeded(state.joined, p, n, rng), np.full(n, -math.log(n)))
            errors = reactivated(errors, p, state.joined.combination)
    return state._replace(clouds=tuple(clouds), errors=errors)


def _reseeded(joined: CombinedPosterior, plane: int, n: int, rng: Generator) -> Floats:
    """Return (4, n) particles (a, b, va, vb) of plane number `plane`, drawn from the combined Gaussian estimate."""
    rows = plane_axes(plane)
    root = root_of(joined.covariance[np.ix_(rows, rows)])
    return np.asarray(root @ rng.standard_normal((4, n)) + joined.mean[rows][:, None])


def _running(state: PpsState, pair: Pair) -> list[int]:
    """Return the numbers of the planes to update: all, or with the setting `running=selected` those of `pair`."""
    chosen = {p for _, p in pair}
    return [p for p in ALL if state.space.config.running == "all" or p in chosen]


def _turned(state: PpsState, plane: int, dt: float) -> Floats | None:
    """Return (4,) the change of a plane's state in `dt` [s] by the known turn in another plane; None if there is none.

    The change is that at the velocity of the combined estimate, for (a, b, va, vb) of plane number `plane`.
    """
    motion, axes = state.space.motion, AXES[plane]
    if motion.turn == 0.0 or axes == motion.axes or state.joined is None:
        return None
    velocity = state.joined.mean[3:][list(motion.axes)]
    change, jump = turn_jump(velocity, motion.turn, dt), np.zeros(4)
    for index, k in enumerate(axes):
        if k in motion.axes:
            at = motion.axes.index(k)
            jump[[index, index + 2]] = change[[at, at + 2]]
    return jump


def _taken_in(
    state: PpsState, dt: float, pair: Pair, heard: ScanDirections, angles: ProjectedAngles, rng: Generator
) -> tuple[Clouds, dict[int, PlanePosterior], dict[int, PlaneSights]]:
    """Update the running planes with a scan, `dt` [s] after the last one.

    Args:
        state: state after the last scan.
        dt: time since the last scan [s].
        pair: the selected planes, each with its best sensor.
        heard: directions of the scan in the world.
        angles: these directions projected to the planes.
        rng: generator of the random numbers drawn.

    Returns:
        Particles of all planes; by running plane, its posterior; by running plane, the angles it was updated with.
    """
    config, n, chances = state.space.config, state.space.config.particles, state.space.chances
    best = {p: s for s, p in pair}
    new, flats, likelihoods = list(state.clouds), {}, {}
    for p in _running(state, pair):
        cloud, log_weights = state.clouds[p]
        own = sights_in_plane(p, heard, angles, best.get(p) if config.per_plane == "best" else None)
        cloud, weights, log_sum = update_by_scan(
            cloud,
            log_weights,
            TimeStepPath(state.motions[p], dt, _turned(state, p, dt)),
            partial(lines_in_plane, own, heard, chances),
            partial(log_likelihood, own=own, heard=heard, chances=chances),
            config=config,
            rng=rng,
        )
        mean, covariance = moments(cloud, weights)
        flats[p], likelihoods[p] = PlanePosterior(mean, covariance, log_sum, effective_sample_size(weights)), own
        if config.proposal == "bootstrap" and flats[p].ess < config.resampling_threshold * n:
            cloud = resample_with_kernel(
                cloud, weights, mean, covariance, n, config.kernel_bandwidth * silverman_bandwidth(n, 4), rng
            )
            weights = np.full(n, 1.0 / n)
        new[p] = (cloud, log_of(weights))
    return tuple(new), flats, likelihoods


def _estimate(
    joined: CombinedPosterior,
    heard: ScanDirections,
    config: PpsConfig,
    ess: float,
    log_sum: float,
    fallback: str,
    pair: Pair,
) -> Estimate:
    """Return the estimate of a scan from the combined state, with height.

    Args:
        joined: combined state in space.
        heard: directions of the scan.
        config: settings; with `per_plane=best` only the sensors of `pair` count as used.
        ess: effective sample size.
        log_sum: log-likelihood of the scan; NaN in the estimate if not finite.
        fallback: reason of a restart; empty: none.
        pair: the selected planes, each with its best sensor.
    """
    seen = np.diff(heard.sights.first) > 0
    seen &= heard.sights.labelled | agrees(joined.mean[None, :3], heard, config.gate)[0]
    used = heard.sensor
    if config.per_plane == "best":
        used = used[np.unique([s for s, _ in pair if s >= 0]).astype(np.int64)]
    c = joined.covariance
    return Estimate(
        xy=joined.mean[:2],
        velocity=joined.mean[3:5],
        covariance=c[:2, :2],
        ess=ess,
        log_likelihood=log_sum if math.isfinite(log_sum) else math.nan,
        n_observing=len(heard.sensor),
        n_detected=int(np.count_nonzero(seen)),
        fallback=fallback,
        used=tuple(used.tolist()),
        seen_by=tuple(heard.sensor[seen].tolist()),
        height=HeightEstimate(float(joined.mean[2]), float(joined.mean[5]), np.array([c[0, 2], c[1, 2], c[2, 2]])),
    )


METHOD = Online(
    config=PpsConfig,
    init=init,
    step=step,
    started=lambda config: config.start is not None,
    prediction=TargetPredictor(predict, lambda _: REFERENCE_S, lambda _: None),
    smoothing=Smoothing(lambda config: config, trace, through_gaussians),
)
