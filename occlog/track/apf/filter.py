"""Auxiliary particle filter of [Ercan] Sec. 4 (Alg. 1) for one target among cameras and direction finders.

Departures from the paper, each with its reason:

* stage 2 divides by the stage-1 weight of the *parent* (the print divides by that of
  particle l), and stage 1 gives a small share to particles regardless of the scan, so that
  no parent's weight is far too small;
* steps have any length (`occlog.track.apf.kernels.waypoint`); what exceeds the reference step is
  predicted without measurements, by steps no longer than it;
* cameras that contradict a particle make it unlikely, not impossible (`Detection.soften`, `Detection.false`);
* what goes wrong is mended and reported: `sir` when no expected position agrees with the
  scan (stage 1 is skipped), `restart` when no particle does, or when most sensors
  contradict even the best particle in several scans, `gap` after too long a time without
  scans.  In both of these particles are drawn anew over the whole floor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Bools, Floats
from occlog.core.filter.likelihood import Detection, Noise, PackedScan, agreement, log_likelihood
from occlog.core.filter.likelihood_occluded import EXACT, INDEPENDENT, RECURSION, Occlusion, log_likelihood_among
from occlog.core.filter.particles import effective_size, log_of, mean_and_covariance, normalise, systematic_ancestors
from occlog.core.occlusion.priors import Priors, without_own
from occlog.core.plane.floor import Floor, make_floor, on_floor, sample_floor, sample_near
from occlog.core.sight.view_prior import ViewPrior, draw, first_places
from occlog.core.sight.visibility import Sensors
from occlog.errors import InputError
from occlog.measure.scans.scan import Scan
from occlog.records.scene import Scene
from occlog.track.apf.kernels.waypoint import Particles, WaypointModel
from occlog.track.interface import Cloud, Estimate, OccluderTerms, Online, Prediction

from .calibration import Calibration, begin, corrected, corrected_looks, learned
from .config import FORMS, ApfConfig
from .first_places import sight_lines, wander
from .kernels import waypoint
from .sensing import pack_detection, pack_noise, pack_scan, pack_sensors, read_noise

FINE, ROUGH = 5.5, 3.5
"""Standard deviations at which a prior of an occluder counts as over; stage 1 only has to be near."""


class Model(NamedTuple):
    """Scene and settings in the form of the kernels; priors of moving occluders are those of one scan."""

    config: ApfConfig
    floor: Floor
    sensors: Sensors
    noise: Noise
    read_px: Floats
    motion: WaypointModel
    detection: Detection
    informed: Detection  # the same where there are priors of the moving occluders
    occlusion: Occlusion  # how priors of the moving occluders count
    views: ViewPrior | None = None  # where a target can be without a room; None: all over the floor
    wander: float = math.inf  # how far a new destination is, without a room
    priors: Priors | None = None  # those at the time of the scan


class ApfState(NamedTuple):
    """Weighted particles at the time of the last scan; `t_ns` is None before the first."""

    model: Model
    particles: Particles
    weights: Floats  # (L,)
    t_ns: int | None
    astray: int  # reports against the likeliest place more than for it, see `_astray`
    calibration: Calibration | None = None  # None: errors of poses are white noise


class Draw(NamedTuple):
    """Outcome of taking in one scan."""

    particles: Particles
    weights: Floats
    log_likelihood: float
    fallback: str


def motion_of(config: ApfConfig) -> WaypointModel:
    """The motion model's part of the settings."""
    return WaypointModel(
        config.reference_s, config.sigma_v, config.phi, config.beta1, config.lambda1, config.beta2, config.lambda2
    )


def occlusion_of(config: ApfConfig) -> Occlusion:
    """How priors of moving occluders count."""
    kind = {"independent": INDEPENDENT, "recursion": RECURSION, "exact": EXACT}[config.likelihood]
    return Occlusion(kind, FORMS.index(config.q), config.p_floor, 0.0)


def init(scene: Scene, config: ApfConfig, rng: Generator) -> ApfState:
    """State before the first scan: particles around `config.start`, or all over the floor.

    InputError if the scene has no free floor.
    """
    floor = make_floor(scene.region, [o.polygon for o in scene.occluders])
    model = Model(
        config=config,
        floor=floor,
        sensors=pack_sensors(scene),
        noise=pack_noise(scene),
        read_px=read_noise(scene),
        motion=motion_of(config),
        detection=pack_detection(scene, config, informed=False),
        informed=pack_detection(scene, config, informed=True),
        occlusion=occlusion_of(config),
        views=scene.views,
        wander=math.inf if scene.views is None else wander(scene, config.speed),
    )
    try:
        particles = _fresh(model, config.start, rng)
    except ValueError as error:
        raise InputError(f"scene: {error}; make the room larger") from error
    weights = np.full(len(particles.speed), 1.0 / len(particles.speed))
    calibration = begin(scene, model.noise, model.read_px, model.sensors, config.calibrate)
    return ApfState(model, particles, weights, None, 0, calibration)


def step(state: ApfState, scan: Scan, rng: Generator) -> tuple[ApfState, Estimate]:
    """The state after a scan and the estimate ([Ercan] Alg. 1 with start, restart and calibration around it).

    ValueError for a scan that is earlier than the last.
    """
    base = model = state.model
    config = model.config
    looks = pack_scan(scan, model.read_px, config.use_score)
    # Correct: sensors where their poses are thought to be
    calibration = state.calibration
    if calibration is not None:
        sensors, noise = corrected(calibration, state.particles.xy, state.weights)
        model = model._replace(sensors=sensors, noise=noise)
        state, looks = state._replace(model=model), corrected_looks(calibration, looks)
    # Moving occluders: their priors at this time ([Ercan] Sec. 4.2)
    if scan.occluders is not None:
        model = _informed(model, scan.occluders, state)
        state = state._replace(model=model)
    # Propose, weigh, resample ([Ercan] Alg. 1)
    draw = _take_in(state, scan.t_ns, looks, rng)
    # Restart: a filter that most reports have contradicted for some scans is lost
    astray = _astray(state, draw, looks)
    if config.lost_after and astray >= config.lost_after:
        draw = _begin(model, looks, "restart", rng)
        astray = 0
    # Estimate: weighted mean and covariance ([Ercan] Alg. 3, last line)
    estimate = _estimate(model, draw, looks)
    # Calibrate: learn the errors of the poses
    if calibration is not None:
        calibration, estimate = learned(calibration, scan, estimate, config.calibrate_s)
    return ApfState(base, draw.particles, draw.weights, scan.t_ns, astray, calibration), estimate


def _informed(model: Model, priors: Priors, state: ApfState) -> Model:
    """The model with what is known about moving occluders; priors of the target itself are left out."""
    config = model.config
    if config.own_gate > 0.0 and state.t_ns is not None:
        priors = without_own(priors, *mean_and_covariance(state.weights, state.particles.xy), config.own_gate)
    # Known positions are never known exactly: what contradicts them is made unlikely as for static occluders.
    known = not np.any(priors.sigma > 0.0)
    occlusion = occlusion_of(config)._replace(floor=config.soften) if known else occlusion_of(config)
    return model._replace(priors=priors, occlusion=occlusion, detection=model.informed)


def predict(state: ApfState, t_ns: int, rng: Generator) -> Cloud:
    """Where the target is thought to be at a time not before the last scan; the state stays as it is.

    Particles are drawn from the importance density, as [Ercan] Sec. 5 wants them for the
    selection of cameras.
    """
    if state.t_ns is None:
        n = len(state.particles.speed)
        return Cloud(state.particles.xy, np.full(n, 1.0 / n))
    dt = min((t_ns - state.t_ns) / NS, state.model.config.max_gap_s)
    return Cloud(_drift(state.model, state.particles, dt, rng).xy, state.weights)


def _drift(model: Model, particles: Particles, dt: float, rng: Generator) -> Particles:
    """Particles a time dt > 0 later, by steps no longer than the reference step."""
    parts = max(1, math.ceil(dt / model.motion.reference_s - 1e-9))
    for _ in range(parts):
        arrived = waypoint.reached(particles, model.motion, model.floor)
        particles = _move(model, particles, arrived, dt / parts, rng)
    return particles


def _take_in(state: ApfState, t_ns: int, looks: PackedScan, rng: Generator) -> Draw:
    """Weighted particles at the time of a scan; drawn anew at the start, after a gap, and where none agrees."""
    model = state.model
    if state.t_ns is None:
        if model.views is not None and model.config.start is None:
            return _begin(model, looks, "", rng)
        return _weigh_start(model, state.particles, looks, "", rng)
    dt = (t_ns - state.t_ns) / NS
    if dt < 0:
        raise ValueError(f"scan at {t_ns} ns is earlier than the last one at {state.t_ns} ns")
    if dt > model.config.max_gap_s:
        return _begin(model, looks, "gap", rng)
    particles, weights = state.particles, state.weights
    parts = max(1, math.ceil(dt / model.motion.reference_s - 1e-9))
    if parts > 1:
        particles = _drift(model, particles, dt * (parts - 1) / parts, rng)
    draw = _auxiliary_step(model, particles, weights, looks, dt / parts, rng)
    return draw if math.isfinite(draw.log_likelihood) else _begin(model, looks, "restart", rng)


def _auxiliary_step(
    model: Model, particles: Particles, weights: Floats, looks: PackedScan, dt: float, rng: Generator
) -> Draw:
    """[Ercan] Alg. 1: auxiliary sampling importance resampling over a time dt of at most one reference step.

    Args:
        model: scene and settings.
        particles: L of them, a time dt before the scan.
        weights: (L,) sum 1.
        looks: the scan.
        dt: [s], > 0.
        rng: draws.

    Returns:
        Particles at the time of the scan; their log-likelihood is -inf if none agrees with it.
    """
    config = model.config
    # Stage 1, weigh the expected states kappa: w_l f(Z|kappa_l)
    arrived = waypoint.reached(particles, model.motion, model.floor)
    kappa = waypoint.expected_xy(particles, arrived, dt, model.motion)
    first, log_sum = normalise(log_of(weights) + _log_likelihood(model, kappa, looks, ROUGH))
    # Where no expected state agrees with the scan, stage 1 is skipped: plain SIR.
    fallback = "" if math.isfinite(log_sum) else "sir"
    if fallback:
        first = weights
    # Defensive mixture: a share of stage 1 does not look at the scan
    first = (1.0 - config.defensive) * first + config.defensive * weights
    # Resample: systematic; pi_l is the parent of particle l
    ratio = weights
    if effective_size(first) < config.resample_below * len(weights) or config.resample_below >= 1.0:
        parents = systematic_ancestors(first, config.particles, rng.random())
        particles, arrived = waypoint.take(particles, parents), arrived[parents]
        ratio = weights[parents] / first[parents] / config.particles
    # Propose: draw from the importance density f(u(t)|u_pi(t-1)) ([Ercan] Sec. 4.1)
    particles = _move(model, particles, arrived, dt, rng)
    # Stage 2, weigh: f(Z|u_l) over the stage-1 weight of the parent
    weights, log_sum = normalise(log_of(ratio) + _log_likelihood(model, particles.xy, looks))
    return Draw(particles, weights, log_sum, fallback)


def _move(model: Model, particles: Particles, arrived: Bools, dt: float, rng: Generator) -> Particles:
    """Draw from the importance density of Sec. 4.1; `arrived` is from `waypoint.reached`."""
    L = len(particles.speed)
    regime = waypoint.choose_regimes(particles, arrived, dt, model.motion, rng.random(L))
    change = regime == waypoint.CHANGE
    if model.views is None:
        places = sample_floor(int(np.count_nonzero(change)), model.floor, rng)
    else:
        places = sample_near(particles.xy[change], model.wander, model.floor, rng)
    return waypoint.move(particles, regime, places, rng.standard_normal((L, 2)), dt, model.motion)


def _log_likelihood(model: Model, xy: Floats, looks: PackedScan, far: float = FINE) -> Floats:
    """(L,) log f(Z|u) at (L, 2) places ([Ercan] Eq. 6); `far`: deviations at which a prior counts as over."""
    free = on_floor(xy, *model.floor)
    packed = looks, model.sensors, model.noise, model.detection, free
    if model.priors is None:
        return np.asarray(log_likelihood(xy, *packed))
    return log_likelihood_among(xy, *packed, model.priors, model.occlusion._replace(far=far))


def _fresh(model: Model, start: tuple[float, ...] | None, rng: Generator) -> Particles:
    """Many particles, anywhere on the floor or around a start."""
    config = model.config
    n = config.particles * config.start_factor
    if start is not None:
        xy = np.array(start[:2]) + start[2] * rng.standard_normal((n, 2))
    elif model.views is not None:
        xy = draw(n, model.views, rng)
    else:
        xy = sample_floor(n, model.floor, rng)
    return _at_start(model, xy, rng)


def _at_start(model: Model, xy: Floats, rng: Generator) -> Particles:
    """Particles at (L, 2) places, on their way to anywhere at the usual speeds."""
    particles = waypoint.start_particles(xy, model.floor, model.config.speed, model.config.speed_spread, rng)
    if model.views is None:
        return particles
    return particles._replace(destination=sample_near(xy, model.wander, model.floor, rng))


def _begin(model: Model, looks: PackedScan, reason: str, rng: Generator) -> Draw:
    """Particles drawn anew: all over the floor, or, without a room, where the scan says."""
    if model.views is None:
        return _weigh_start(model, _fresh(model, None, rng), looks, reason, rng)
    n = model.config.particles * model.config.start_factor
    xy, log_prior = first_places(n, sight_lines(looks, model.sensors, model.noise, model.views), model.views, rng)
    return _weigh_start(model, _at_start(model, xy, rng), looks, reason, rng, log_prior)


def _weigh_start(
    model: Model, fresh: Particles, looks: PackedScan, fallback: str, rng: Generator, log_weights: Floats | None = None
) -> Draw:
    """As many of the fresh particles as the filter has, drawn by how well they agree with the scan.

    Args:
        model: scene and settings.
        fresh: many particles.
        looks: the scan.
        fallback: why the filter starts.
        rng: draws.
        log_weights: (L,) of the prior over the density that the particles were drawn from; None: they are of the prior.
    """
    n = model.config.particles
    log_prior = np.full(len(fresh.speed), -math.log(len(fresh.speed)))
    if log_weights is not None:
        log_prior = log_prior + log_weights
    weights, log_sum = normalise(log_prior + _log_likelihood(model, fresh.xy, looks))
    rows = systematic_ancestors(weights, n, rng.random())
    return Draw(waypoint.take(fresh, rows), np.full(n, 1.0 / n), log_sum, fallback)


def _astray(state: ApfState, draw: Draw, looks: PackedScan) -> int:
    """How many more reports spoke against where the target is thought to be than for it, since they last were even.

    A report speaks against it if the target should be elsewhere; a scan counts for two
    reports at most, either way.  A single sensor may speak: a filter that is lost among
    people who hide the target seldom has two at once.  False reports come seldom enough in
    a row not to add up.
    """
    reports = looks.labelled & (np.diff(looks.first) > 0)
    # Gate: which reports agree with the likeliest particle
    count = int(np.count_nonzero(reports))
    if not count:
        return state.astray
    best = int(np.argmax(draw.weights))
    model = state.model
    agree = agreement(draw.particles.xy[best : best + 1], looks, model.sensors, model.noise, model.detection)
    against = int(np.count_nonzero(reports & ~agree))
    return max(0, state.astray + max(-2, min(2, 2 * against - count)))


def _estimate(model: Model, draw: Draw, looks: PackedScan) -> Estimate:
    mean, covariance = mean_and_covariance(draw.weights, draw.particles.xy)
    seen = np.diff(looks.first) > 0
    seen &= looks.labelled | agreement(mean[None], looks, model.sensors, model.noise, model.detection)
    return Estimate(
        xy=mean,
        velocity=draw.weights @ waypoint.velocities(draw.particles),
        covariance=covariance,
        ess=effective_size(draw.weights),
        log_likelihood=draw.log_likelihood if math.isfinite(draw.log_likelihood) else math.nan,
        n_looked=len(looks.sensor),
        n_seen=int(np.count_nonzero(seen)),
        fallback=draw.fallback,
        used=tuple(looks.sensor.tolist()),
        seen_by=tuple(looks.sensor[seen].tolist()),
    )


METHOD = Online(
    config=ApfConfig,
    init=init,
    step=step,
    started=lambda config: config.start is not None,
    occluders=lambda config: OccluderTerms(config.occluder_diameter, config.prior_max_age_s),
    prediction=Prediction(
        predict,
        step_s=lambda config: config.reference_s,
        detection=lambda config: config.detection,
        hiding=lambda config: FORMS.index(config.q),
    ),
    calibrates=lambda config: config.calibrate != "none",
)
