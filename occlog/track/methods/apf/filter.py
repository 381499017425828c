"""Auxiliary particle filter of [Ercan] Sec. 4 (Alg. 1) for one target among cameras and direction finders.

Departures from the paper, each with its reason:

* stage 2 divides by the stage-1 weight of the *parent* (the print divides by that of
  particle l), and stage 1 gives a small share to particles regardless of the scan, so that
  no parent's weight is far too small;
* steps have any length (`occlog.filtering.motion.waypoint`); what exceeds the reference step is
  predicted without measurements, by steps no longer than it;
* cameras that contradict a particle make it unlikely, not impossible (`DetectionModel.soften`, `DetectionModel.false`);
* what goes wrong is mended and reported: `sir` when no expected position agrees with the
  scan (stage 1 is skipped), `restart` when no particle does, or when most sensors
  contradict even the best particle in several scans, `gap` after too long a time without
  scans.  In both of these particles are resampled over the whole floor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Bools, Floats
from occlog.consistency.estimates import MIN_EFFECTIVE_SAMPLE_SIZE
from occlog.core.occlusion.priors import Priors, without_own
from occlog.errors import InputError
from occlog.filtering.lifecycle import advance, elapsed, is_lost, track_loss_count
from occlog.filtering.likelihood.directions import PackedScan, likely_inliers
from occlog.filtering.likelihood.distances import inlier_probability, residuals
from occlog.filtering.motion import waypoint
from occlog.filtering.motion.waypoint import WaypointParticles
from occlog.filtering.particles import effective_sample_size, mean_and_covariance
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import Estimate, OccluderTerms, Online, ParticleSet, Smoothing, TargetPredictor

from .calibration import PoseCalibration, begin, corrected, corrected_scan, updated_calibration
from .config import FORMS, ApfConfig
from .model import ApfModel, make_model, motion_of, occlusion_of, pack_scan, with_distances
from .proposal import (
    ProposedParticles,
    auxiliary_step,
    drift,
    initial_particles,
    parts_of,
    reinitialise,
    select_initial_particles,
)
from .smoother import Trace, record_particles, smooth


class ApfState(NamedTuple):
    """State of the filter of one target: weighted particles at the time of the last scan.

    `t_ns` is None before the first scan. `loss_count` is the track-loss counter; `trace` has the smoother's records of
    the last step, empty without a smoother.
    """

    model: ApfModel
    particles: WaypointParticles
    weights: Floats  # (L,)
    t_ns: int | None
    loss_count: int  # reports against the likeliest position more than for it, see `_track_loss`
    calibration: PoseCalibration | None = None  # None: errors of poses are white noise
    trace: Trace = ()  # smoother state of the last step; empty without a smoother


def init(scene: Scene, config: ApfConfig, rng: Generator) -> ApfState:
    """Return the state before the first scan: particles around `config.start`, or over the whole floor.

    InputError if the scene has no free floor.
    """
    model = make_model(scene, config)
    try:
        particles = initial_particles(model, config.start, rng)
    except ValueError as error:
        raise InputError(f"scene: {error}; make the room larger", id="no-room") from error
    weights = np.full(len(particles.speed), 1.0 / len(particles.speed))
    calibration = begin(scene, model.noise, model.read_px, model.sensors, config.calibrate)
    return ApfState(model, particles, weights, None, 0, calibration)


def step(state: ApfState, scan: Scan, rng: Generator) -> tuple[ApfState, Estimate]:
    """Return the state after a scan and the estimate of the target, by [Ercan] Alg. 1.

    Around the algorithm there are track initiation and reinitialisation, occluder priors and the calibration of poses.
    ValueError for a scan that is earlier than the last.
    """
    base = model = state.model
    config = model.config
    packed = pack_scan(scan, model.read_px, config.use_score)
    if scan.measured is not None:
        model = model._replace(measured=scan.measured.distances)
        state = state._replace(model=model)
    # Correct: sensors where their poses are thought to be
    calibration = state.calibration
    if calibration is not None:
        sensors, noise = corrected(calibration, state.particles.xy, state.weights)
        model = model._replace(sensors=sensors, noise=noise)
        state, packed = state._replace(model=model), corrected_scan(calibration, packed)
    # Moving occluders: their priors at this time ([Ercan] Sec. 4.2)
    if scan.occluders is not None:
        model = _with_occluder_priors(model, scan.occluders, state)
        state = state._replace(model=model)
    # Propose, weigh, resample ([Ercan] Alg. 1); a filter that most reports have contradicted for some scans is lost
    (draw, trace), loss_count = advance(
        elapsed(state.t_ns, scan.t_ns),
        config.max_gap_s,
        known=state.t_ns is not None or model.views is None or config.start is not None,
        initiate=lambda reason: _begin(model, packed, reason, rng),
        update=lambda dt: _updated(state, packed, dt, rng),
        loss=lambda taken: _track_loss(state, taken[0], packed),
    )
    # Estimate: weighted mean and covariance ([Ercan] Alg. 3, last line)
    estimate = _estimate(model, draw, packed)
    # Calibrate: learn the errors of the poses
    if calibration is not None:
        calibration, estimate = updated_calibration(calibration, scan, estimate, config.calibration_s)
    return ApfState(base, draw.particles, draw.weights, scan.t_ns, loss_count, calibration, trace), estimate


def _with_occluder_priors(model: ApfModel, priors: Priors, state: ApfState) -> ApfModel:
    """Return the model with the position priors of moving occluders at the time of a scan.

    With `own_prior_gate`, priors within that many standard deviations of the target (by `state`) are omitted as the
    target's own. Where no prior has a standard deviation, positions count as known.
    """
    config = model.config
    if config.own_prior_gate > 0.0 and state.t_ns is not None:
        priors = without_own(priors, *mean_and_covariance(state.weights, state.particles.xy), config.own_prior_gate)
    # Known positions are never known exactly: what contradicts them is made unlikely as for static occluders.
    known = not np.any(priors.sigma > 0.0)
    occlusion = (
        occlusion_of(config)._replace(floor=config.out_of_view_likelihood, temper=1.0)
        if known
        else occlusion_of(config)
    )
    return model._replace(priors=priors, occlusion=occlusion, detection=model.informed)


def predict(state: ApfState, t_ns: int, rng: Generator) -> ParticleSet:
    """Return weighted positions predicted for time `t_ns`, not before the last scan; the state is not changed.

    Particles are drawn from the motion model, as [Ercan] Sec. 5 requires for the selection of cameras. No more than
    `max_gap_s` is predicted. Before the first scan, the initial particles.
    """
    if state.t_ns is None:
        n = len(state.particles.speed)
        return ParticleSet(state.particles.xy, np.full(n, 1.0 / n))
    dt = min((t_ns - state.t_ns) / NS, state.model.config.max_gap_s)
    return ParticleSet(drift(state.model, state.particles, dt, rng).xy, state.weights)


def _updated(state: ApfState, packed: PackedScan, dt: float, rng: Generator) -> tuple[ProposedParticles, Trace] | None:
    """Return weighted particles at the time of a scan and the smoother's records; None if no particle agrees with it.

    The time is predicted in steps no longer than the reference step, of which the last uses the scan. At the first scan
    the initial particles are resampled.

    Args:
        state: state at the last scan, not changed.
        packed: the scan.
        dt: time since the last scan [s].
        rng: generator of the random numbers drawn.
    """
    model = state.model
    if state.t_ns is None:
        start = model.config.start
        draw = select_initial_particles(model, state.particles, None if start is None else start[2], packed, rng)
        return draw, _last(model, draw, 0.0)
    # Predict without measurements, as far as one step does not reach
    particles, weights, parts = state.particles, state.weights, parts_of(dt, model)
    links: Trace = ()
    for _ in range(parts - 1):
        particles = drift(model, particles, dt / parts, rng)
        if model.config.smoothed:
            links = (*links, record_particles(particles, weights, None, dt / parts, model))
    # Take the scan in
    draw = auxiliary_step(model, particles, weights, packed, dt / parts, rng)
    return (draw, links + _last(model, draw, dt / parts)) if math.isfinite(draw.log_likelihood) else None


def _last(model: ApfModel, draw: ProposedParticles, dt: float) -> Trace:
    """Return the smoother's record of the step of `dt` [s] that ended at a scan, in a tuple.

    The tuple is empty if no smoothing is configured.
    """
    if not model.config.smoothed:
        return ()
    return (record_particles(draw.particles, draw.weights, draw.parents, dt, model, draw.sharpness),)


def _begin(model: ApfModel, packed: PackedScan, reason: str, rng: Generator) -> tuple[ProposedParticles, Trace]:
    """Return reinitialised particles with `reason` as their `fallback`, and the smoother's record of them.

    They are drawn over the whole floor, or, without a room and without measured distances, along the bearings of
    `packed`.
    """
    draw = reinitialise(model, packed, rng)._replace(fallback=reason)
    return draw, _last(model, draw, 0.0)


def _track_loss(state: ApfState, draw: ProposedParticles, packed: PackedScan) -> tuple[int, bool]:
    """Return the track-loss counter after a scan, and whether the track is lost (the counter is then 0).

    The counter grows by the labelled reports and distances that contradict the likeliest particle, less those that
    agree, by at most 2 a scan. A single sensor suffices: a filter that is lost among people who hide the target seldom
    has two at once.

    Args:
        state: state before the scan, with the counter so far.
        draw: particles after the scan.
        packed: the scan.
    """
    reports = packed.labelled & (np.diff(packed.first) > 0)
    # Gate: which reports agree with the likeliest particle
    count = int(np.count_nonzero(reports))
    model = state.model
    if model.measured is not None:
        count += len(model.measured.kind)
    if not count:
        return state.loss_count, False
    best = int(np.argmax(draw.weights))
    here = draw.particles.xy[best : best + 1]
    agree = likely_inliers(here, packed, model.sensors, model.noise, model.detection)
    against = int(np.count_nonzero(reports & ~agree))
    if model.measured is not None:
        against += int(
            np.count_nonzero(inlier_probability(residuals(model.measured, here)[0], model.measured.errors) < 0.5)
        )
    after = track_loss_count(state.loss_count, against, count)
    return (0, True) if is_lost(after, model.config.track_loss_count) else (after, False)


def _estimate(model: ApfModel, draw: ProposedParticles, packed: PackedScan) -> Estimate:
    """Return the estimate of a scan: weighted mean and covariance of the particles, and sensors that saw the target.

    With an effective sample size below `MIN_EFFECTIVE_SAMPLE_SIZE` the covariance is widened, and `fallback` is
    `depleted` if it was empty.
    """
    mean, covariance = mean_and_covariance(draw.weights, draw.particles.xy)
    size, fallback = min(effective_sample_size(draw.weights), draw.effective), draw.fallback
    if size < MIN_EFFECTIVE_SAMPLE_SIZE:
        # A few particles seem more certain than they are: at least what they were drawn from is open, too
        covariance = covariance * (size / (size - 1.0) if size > 1.5 else 3.0) + draw.sharpness * np.eye(2)
        fallback = fallback or "depleted"
    seen = np.diff(packed.first) > 0
    seen &= packed.labelled | likely_inliers(mean[None], packed, model.sensors, model.noise, model.detection)
    estimate = _as_estimate(draw, mean, covariance, size, fallback, packed, seen)
    return estimate if model.measured is None else with_distances(estimate, model.measured)


def _as_estimate(
    draw: ProposedParticles,
    mean: Floats,
    covariance: Floats,
    ess: float,
    fallback: str,
    packed: PackedScan,
    seen: Bools,
) -> Estimate:
    """Return the estimate of a scan from its parts; velocity and log-likelihood are those of the particles.

    Args:
        draw: weighted particles after the scan.
        mean: (2,) position.
        covariance: (2, 2) covariance of the position.
        ess: effective sample size of the particles.
        fallback: reason why the estimate is doubtful; empty: none.
        packed: the scan; all K of its sensors count as used.
        seen: (K,) whether a sensor detected the target.
    """
    return Estimate(
        xy=mean,
        velocity=draw.weights @ waypoint.velocities(draw.particles),
        covariance=covariance,
        ess=ess,
        log_likelihood=draw.log_likelihood if math.isfinite(draw.log_likelihood) else math.nan,
        n_observing=len(packed.sensor),
        n_detected=int(np.count_nonzero(seen)),
        fallback=fallback,
        used=tuple(packed.sensor.tolist()),
        seen_by=tuple(packed.sensor[seen].tolist()),
    )


METHOD = Online(
    config=ApfConfig,
    init=init,
    step=step,
    started=lambda config: config.start is not None,
    occluders=lambda config: OccluderTerms(config.occluder_diameter, config.prior_max_age_s),
    prediction=TargetPredictor(
        predict,
        step_s=lambda config: config.reference_step_s,
        detection=lambda config: config.detection_probability,
        hiding=lambda config: FORMS.index(config.occlusion_form),
    ),
    calibrates=lambda config: config.calibrate != "none",
    measured=True,
    smoothing=Smoothing(
        wanted=lambda config: config,
        trace=lambda state: state.trace,
        back=lambda traces, config, rng: smooth(traces, config, motion_of(config), rng),
    ),
)
