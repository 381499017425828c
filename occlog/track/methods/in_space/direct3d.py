"""Method `direct3d`: a particle filter of one target in space, the direct 3-D method of [Lee] Ch. 2.

A sampling importance resampling (SIR) filter with the state (x, y, z, vx, vy, vz).  Departures from
the thesis, each with its reason:

* particles are resampled only when their effective number is low, and then from a kernel
  density (`occlog.filtering.kernel_density`) that leaves mean and covariance as they are: without
  process noise mere copies would become one position;
* where nearly no particle agrees with a scan its likelihood is flattened
  (`occlog.filtering.kernel_density.update_weights`), since the spread of one or two particles
  would be taken for certainty;
* a labelled report may be false with a small probability, so that one outlier does not end a track;
* a filter that a sensor contradicts for some scans restarts from the scan (`restart`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.filtering.kernel_density import kernel_density, moments, resample_with_kernel, silverman_bandwidth
from occlog.filtering.lifecycle import advance, elapsed, is_lost
from occlog.filtering.motion.white_acceleration import moved
from occlog.filtering.particles import effective_sample_size, log_of, normalise_log_weights
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import Estimate, HeightEstimate, Online, ParticleSet, Smoothing, TargetPredictor

from .config import Direct3dConfig, SpaceConfig
from .importance_step import CloudTrace, TimeStepPath, lines_of_sight, through_clouds, update_by_scan
from .sensing import (
    C,
    ScanDirections,
    SpaceModel,
    agrees,
    log_likelihood,
    log_room_factor,
    make_space,
    pack_directions,
    particles_around,
    particles_from_scan,
)

REFERENCE_S = 1.0
"""Step in which the time between selections of cameras is counted [s]."""
RESTART_BACKOFF = 4
"""How many times longer a sensor must speak against a filter that has already restarted because of it."""


class Direct3dState(NamedTuple):
    """State of the filter of one target: weighted particles (x, y, z, vx, vy, vz) after the last scan.

    `t_ns` is None before the first scan; `cloud` (6, L) is then empty if no start is given. `loss_count` (S,) counts
    the contradictions of each sensor.
    """

    space: SpaceModel[Direct3dConfig]
    cloud: Floats  # (6, L)
    log_weights: Floats  # (L,)
    near: Floats  # (2,) about where the target is
    t_ns: int | None
    loss_count: Ints  # (S,) see `is_contradicted`
    begun: bool = True  # restarted with the last scan


class ScanUpdate(NamedTuple):
    """Particles at the time of a scan: states (6, L) with weights (L,), the scan's log-likelihood, and the fallback.

    `fallback` is empty, or `restart` or `gap` for particles drawn from the scan alone.
    """

    cloud: Floats
    weights: Floats
    log_likelihood: float
    fallback: str


def init(scene: Scene, config: Direct3dConfig, rng: Generator) -> Direct3dState:
    """Return the state before the first scan: particles around `config.start`, or none yet."""
    space = make_space(scene, config, cone=config.likelihood == "cone")
    n = config.particles * config.initial_particle_factor
    cloud = np.empty((6, 0)) if config.start is None else particles_around(space, config.start, n, rng)
    near = scene.region.mean(axis=0) if config.start is None else np.array(config.start[:2])
    return Direct3dState(
        space=space,
        cloud=cloud,
        log_weights=np.full(cloud.shape[1], -math.log(n)),
        near=near,
        t_ns=None,
        loss_count=np.zeros(len(space.ears.reach), dtype=np.int64),
    )


def step(state: Direct3dState, scan: Scan, rng: Generator) -> tuple[Direct3dState, Estimate]:
    """Return the state after a scan and the estimate; ValueError for a scan that is earlier than the last.

    Particles are proposed and weighed ([Lee] Eqs. 2.6-2.7), and resampled from a kernel density where few are
    effective.
    """
    space, config = state.space, state.space.config
    heard = pack_directions(scan, space.ears, state.near, use_score=config.use_score)

    def loss(draw: ScanUpdate) -> tuple[Ints, bool]:
        best = draw.cloud[:3, int(np.argmax(draw.weights))]
        return is_contradicted(state.loss_count, agrees(best[None], heard, config.gate)[0], heard, config)

    # Propose and weigh ([Lee] Eqs. 2.6-2.7 by particles)
    draw, loss_count = advance(
        elapsed(state.t_ns, scan.t_ns),
        config.max_gap_s,
        known=state.t_ns is not None or state.cloud.shape[1] > 0,
        initiate=lambda reason: begin(space, heard, reason, rng),
        update=lambda dt: _updated(state, heard, dt, rng),
        loss=loss,
    )
    # Estimate: weighted mean and covariance
    mean, covariance = moments(draw.cloud, draw.weights)
    estimate = estimate_of(mean, covariance, draw, heard, agrees(mean[None, :3], heard, config.gate)[0])
    # Resample from a kernel density: what begins has more particles, what moves blindly may have few effective ones
    cloud, weights = draw.cloud, draw.weights
    few = config.proposal == "bootstrap" and estimate.ess < config.resampling_threshold * config.particles
    if few or cloud.shape[1] != config.particles:
        n = config.particles
        cloud = resample_with_kernel(
            cloud, weights, mean, covariance, n, config.kernel_bandwidth * silverman_bandwidth(n, 6), rng
        )
        weights = np.full(n, 1.0 / n)
    begun = state.t_ns is None or draw.fallback != ""
    return Direct3dState(space, cloud, log_of(weights), mean[:2], scan.t_ns, loss_count, begun), estimate


def trace(state: Direct3dState) -> CloudTrace:
    """Return the record of the last step that smoothing needs: the particles as a kernel density."""
    assert state.t_ns is not None
    weights = np.exp(state.log_weights)
    return CloudTrace(state.t_ns, kernel_density(state.cloud, weights / weights.sum()), state.begun)


def predict(state: Direct3dState, t_ns: int, rng: Generator) -> ParticleSet:
    """Return weighted (x, y) positions predicted for time `t_ns`, not before the last scan; the state is not changed.

    Before the first scan, without a start, they are uniform over the box of the room and all sensors.
    """
    cloud, weights = state.cloud, np.exp(state.log_weights)
    if not cloud.shape[1]:
        space, n = state.space, state.space.config.particles
        return ParticleSet((space.low + (space.high - space.low) * rng.random((n, 3)))[:, :2], np.full(n, 1.0 / n))
    if state.t_ns is not None:
        dt = min((t_ns - state.t_ns) / NS, state.space.config.max_gap_s)
        cloud = moved(cloud, state.space.motion, dt, rng)
    return ParticleSet(np.ascontiguousarray(cloud[:2].T), weights / weights.sum())


def _updated(state: Direct3dState, heard: ScanDirections, dt: float, rng: Generator) -> ScanUpdate | None:
    """Return weighted particles at the time of a scan, `dt` [s] after the last one; None if no particle agrees with it.

    A factor for leaving the room is included in the weights. `heard` has the directions of the scan.
    """
    space = state.space
    cloud, weights, log_sum = update_by_scan(
        state.cloud,
        state.log_weights,
        TimeStepPath(space.motion, dt),
        lambda: lines_of_sight(heard, space.chances),
        lambda xyz: log_likelihood(xyz, heard, space),
        config=space.config,
        rng=rng,
        log_going=lambda before, after: log_room_factor(None if state.t_ns is None else before, after, space),
    )
    return ScanUpdate(cloud, weights, log_sum, "") if math.isfinite(log_sum) else None


def begin(space: SpaceModel[C], heard: ScanDirections, reason: str, rng: Generator) -> ScanUpdate:
    """Return particles drawn along the directions of a scan, for a start or restart, with `reason` as their fallback.

    Their number is `particles` times `initial_particle_factor`.
    """
    cloud, log_weights = particles_from_scan(
        space, heard, space.config.particles * space.config.initial_particle_factor, rng
    )
    weights, log_sum = normalise_log_weights(log_weights)
    return ScanUpdate(cloud, weights, log_sum - math.log(len(weights)), reason)


def is_contradicted(loss_count: Ints, good: Bools, heard: ScanDirections, config: SpaceConfig) -> tuple[Ints, bool]:
    """Return the track-loss counter of each sensor after a scan, and whether the track is lost.

    A contradiction by a sensor adds 1 to its counter, an agreement subtracts 1, down to 0. The track is lost when one
    counter reaches `track_loss_count`; counters above 0 then become negative (`RESTART_BACKOFF`), so that a sensor
    which may itself be wrong must contradict several times as often to do so again.

    Args:
        loss_count: (S,) counters so far; not changed.
        good: (N,) which sensors of the scan agree with the likeliest position.
        heard: directions of the scan by its N sensors; sensors without one do not count.
        config: settings of the method.
    """
    reports = np.diff(heard.sights.first) > 0
    loss_count = loss_count.copy()
    for sensor in heard.sensor[reports & good]:
        loss_count[sensor] = max(0, loss_count[sensor] - 1)
    loss_count[heard.sensor[reports & ~good]] += 1
    lost = is_lost(int(loss_count.max(initial=0)), config.track_loss_count)
    if lost:
        loss_count = np.where(loss_count > 0, -RESTART_BACKOFF * config.track_loss_count, 0)
    return loss_count, lost


def estimate_of(mean: Floats, covariance: Floats, draw: ScanUpdate, heard: ScanDirections, good: Bools) -> Estimate:
    """Return the estimate of a scan, with height.

    Args:
        mean: (6,) x, y, z, vx, vy, vz.
        covariance: (6, 6) covariance of `mean`.
        draw: particles, for effective sample size, likelihood and fallback.
        heard: directions of the scan by N sensors, all of which count as used.
        good: (N,) sensors that agree with the estimate; those, and labelled ones, with a direction have detected it.
    """
    seen = np.diff(heard.sights.first) > 0
    seen &= heard.sights.labelled | good
    return Estimate(
        xy=mean[:2],
        velocity=mean[3:5],
        covariance=covariance[:2, :2],
        ess=effective_sample_size(draw.weights),
        log_likelihood=draw.log_likelihood if math.isfinite(draw.log_likelihood) else math.nan,
        n_observing=len(heard.sensor),
        n_detected=int(np.count_nonzero(seen)),
        fallback=draw.fallback,
        used=tuple(heard.sensor.tolist()),
        seen_by=tuple(heard.sensor[seen].tolist()),
        height=HeightEstimate(
            float(mean[2]), float(mean[5]), np.array([covariance[0, 2], covariance[1, 2], covariance[2, 2]])
        ),
    )


METHOD = Online(
    config=Direct3dConfig,
    init=init,
    step=step,
    started=lambda config: config.start is not None,
    prediction=TargetPredictor(predict, lambda _: REFERENCE_S, lambda _: None),
    smoothing=Smoothing(lambda config: config, trace, through_clouds),
)
