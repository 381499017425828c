"""Particle filter of the states of all objects together ([Ercan] Sec. 4.4; Doucet, Vo, Andrieu, Davy 2002).

A particle has a position and a velocity for every object. Given a particle, occlusion is certain: an object hides
another from a camera or does not. A detection is thus information about all objects that may stand in between, and
occluder priors are not needed. Since weights are products over all objects, the effective sample size falls with their
number.

Objects move as in `occlog.filtering.motion.ornstein_uhlenbeck`.  Each is proposed by the motion and its own rows,
linearised at the particle's prediction (Doucet, Godsill and Andrieu 2000); the weights are prior times likelihood
over that.

All sensors may miss an unoccluded object for seconds (it sits down, the exposure fails): it is then not perceivable (Li
and Li 2001), a state of a Markov chain with a probability in each particle, independent of the position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats
from occlog.consistency.estimates import MIN_EFFECTIVE_SAMPLE_SIZE
from occlog.core.geometry.visibility import seen_from
from occlog.core.plane import Floor, on_floor
from occlog.filtering.gaussian import Gaussian, PosteriorRecord, predicted, rts_smooth
from occlog.filtering.lifecycle import elapsed, is_lost, track_loss_count
from occlog.filtering.likelihood.directions import PackedScan
from occlog.filtering.likelihood.measurement_model import (
    LinearisedRows,
    MeasurementWorld,
    linearise,
    linearised,
    measured,
    residuals,
    rows_of,
)
from occlog.filtering.particles import (
    effective_sample_size,
    mean_and_covariance,
    normalise_log_weights,
    systematic_ancestors,
)
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import Estimate, JointMethod, SmoothedState, Smoothing
from occlog.track.methods.apf.model import pack_scan, read_noise
from occlog.track.methods.kalman.filter import anywhere_of, initial_position, motion_of, world_of
from occlog.track.methods.kalman.updates import gated_rows, linear

from .config import JointConfig

PROPOSAL_INFLATION = 1.2
"""Proposals are so much wider than the linearised posterior, so that weights stay bounded."""
MEAN_PERCEIVABLE_S, MEAN_UNPERCEIVABLE_S = 100.0, 2.0
"""Mean sojourn times [s] of an object in the states that detectors can, and cannot, detect it."""
OFF_FLOOR_LIKELIHOOD = 1e-4
"""Likelihood factor of a position outside the room or in a static occluder, where there is a room."""
MAX_PROBABILITY = 1.0 - 1e-6
"""Largest probability of a detection, or of none."""


class DetectionProbabilities(NamedTuple):
    """Detection and false-alarm probabilities of S sensors, from the scene or else from the settings."""

    detection: Floats  # (S,) P_D
    false: Floats  # (S,) P_F


class JointState(NamedTuple):
    """State of the filter at the time of the last scan: L particles, each with the states of all M objects."""

    config: JointConfig
    world: MeasurementWorld
    chances: DetectionProbabilities
    read_px: Floats
    floor: Floor | None  # where objects can be; None: the scene has no room
    anywhere: Gaussian
    objects: tuple[int, ...]  # their identities, in the order in which they were first seen
    loss_count: tuple[int, ...]  # of each, rows outside the gate more than inside
    particles: Floats  # (L, M, 4) x, y, vx, vy of each object
    unperceivable: Floats  # (L, M) probabilities that no detector can detect the object
    uncertain: frozenset[int] = frozenset()  # objects that the next scan initiates again: few particles were effective
    t_ns: int | None = None
    links: tuple[PosteriorRecord, ...] = ()  # of each object, what the last step leaves for the way back


class ObjectReports(NamedTuple):
    """Measurements of one object in a scan by all sensors, as packed scan and as rows for linearisation."""

    packed: PackedScan
    rows: LinearisedRows


def init(scene: Scene, config: JointConfig, rng: Generator) -> JointState:  # noqa: ARG001
    """Return the state before the first scan, without objects; InputError for a scene without free floor.

    `rng` is not used.
    """
    world = world_of(scene)
    none = np.empty((config.particles, 0, 4))
    return JointState(
        config,
        world,
        chances_of(scene, config),
        read_noise(scene),
        world.floor if scene.views is None else None,
        anywhere_of(scene, world, config),
        (),
        (),
        none,
        none[:, :, 0],
    )


def chances_of(scene: Scene, config: JointConfig) -> DetectionProbabilities:
    """Return detection and false-alarm probabilities of all sensors: those of the scene, or else of the settings.

    They lie between 1e-6 and 1 - 1e-6 (`MAX_PROBABILITY`), so that no detection contradicts every particle.
    """
    own = [(c.detection, c.false_alarm) for c in scene.cameras] + [(None, None)] * len(scene.arrays)
    found = [config.detection_probability if detection is None else detection for detection, _ in own]
    false = [config.false_alarm_probability if false is None else false for _, false in own]
    return DetectionProbabilities(
        *(np.clip(np.array(p, dtype=np.float64), 1.0 - MAX_PROBABILITY, MAX_PROBABILITY) for p in (found, false))
    )


def step(state: JointState, scan: Scan, rng: Generator) -> tuple[JointState, list[tuple[int, Estimate]]]:
    """Update the state with a scan of labelled rows, and return it with (identity, estimate) of every object.

    An object begins with the first scan in which a sensor detects it. It begins again after a gap, after track loss,
    and where few particles were effective at its beginning. ValueError for a scan that is earlier than the last.
    """
    config, L = state.config, state.config.particles
    dt = elapsed(state.t_ns, scan.t_ns)
    reports = {}
    for target in sorted(set(scan.target_id.tolist()).union(state.objects)):
        packed = pack_scan(scan.take(scan.target_id == target), state.read_px, use_score=False)
        reports[target] = ObjectReports(packed, rows_of(packed))
    # Begin: an object has a state from the first scan on in which a sensor sees it
    begun = [t for t in reports if t not in state.objects and len(reports[t].rows.sensor)]
    objects = (*state.objects, *begun)
    lost = [
        t
        for t, loss_count in zip(state.objects, state.loss_count, strict=True)
        if is_lost(loss_count, config.track_loss_count) and len(reports[t].rows.sensor)
    ]
    # Propose object by object, and weigh by what was linearised
    particles, log_weights = np.empty((L, len(objects), 4)), np.zeros((L, len(objects)))
    hidden = np.full((L, len(objects)), MEAN_UNPERCEIVABLE_S / (MEAN_PERCEIVABLE_S + MEAN_UNPERCEIVABLE_S))
    hidden[:, : len(state.objects)] = unperceivable_after(state.unperceivable, dt)
    drawn = np.zeros((len(objects), 2, 2))  # covariances of the positions' proposals
    gap = dt > config.max_gap_s
    again = [t for t in state.objects if t in state.uncertain and len(reports[t].rows.sensor)]
    restarted = dict.fromkeys((*again, *begun), "") | dict.fromkeys(lost, "restart")
    if gap:
        restarted |= dict.fromkeys(state.objects, "gap")
    loss_count = dict(zip(state.objects, state.loss_count, strict=True))
    for j, target in enumerate(objects):
        rows = reports[target].rows
        if target in restarted:
            particles[:, j], log_weights[:, j], drawn[j] = _placed(rows, state, rng)
            loss_count[target] = 0
            continue
        before = state.particles[:, j]
        known = Gaussian(*mean_and_covariance(np.full(L, 1.0 / L), before))
        known = predicted(known, *motion_of(config).transition(dt))
        inside = gated_rows(known, rows, linearise(known.mean[:2], rows, state.world), config.gate)
        loss_count[target] = track_loss_count(loss_count[target], int(np.count_nonzero(~inside)), len(inside))
        particles[:, j], log_weights[:, j], drawn[j] = _proposed(before, rows.take(inside), dt, state, rng)
    if not objects:
        return state._replace(t_ns=scan.t_ns), []
    # Weigh: who hides whom is certain in a particle ([Ercan] Fig. 3)
    seen = in_plain_view(particles[:, :, :2], [reports[t] for t in objects], state.world, config)
    factors, hidden = log_factors(
        particles[:, :, :2], [reports[t] for t in objects], seen, hidden, state.world, state.chances
    )
    log_weights += factors
    if state.floor is not None:
        outside = ~on_floor(particles[:, :, :2].reshape(-1, 2), *state.floor).reshape(L, -1)
        log_weights += math.log(OFF_FLOOR_LIKELIHOOD) * outside
    weights, log_likelihood = normalise_log_weights(log_weights.sum(axis=1))
    # An object that one sensor alone detected at its initiation may have few particles where it is
    waiting = [t for t in state.objects if t in state.uncertain and t not in restarted]
    few = [t for j, t in enumerate(objects) if t in restarted and _depleted(log_weights[:, j])]
    estimates = [
        (t, _estimate(particles[:, j], weights, drawn[j], reports[t], restarted.get(t, ""), log_likelihood))
        for j, t in enumerate(objects)
    ]
    # Moments of each object, for the way back
    links = (
        tuple(
            PosteriorRecord(
                _moments(particles[:, j], weights, drawn[j]),
                0.0 if restarted.get(t, "") else dt,
                begun=t in restarted,
            )
            for j, t in enumerate(objects)
        )
        if config.smoothed
        else ()
    )
    # Resample: systematic
    drawn_rows = systematic_ancestors(weights, L, rng.random())
    after = state._replace(
        objects=objects,
        loss_count=tuple(loss_count[t] for t in objects),
        particles=particles[drawn_rows],
        unperceivable=hidden[drawn_rows],
        uncertain=frozenset((*waiting, *few)),
        t_ns=scan.t_ns,
        links=links,
    )
    return after, estimates


def _placed(rows: LinearisedRows, state: JointState, rng: Generator) -> tuple[Floats, Floats, Floats]:
    """Draw L initial states of an object from its first measurements.

    Args:
        rows: measurements of the object in the scan.
        state: settings, sensors and prior.
        rng: generator of the random numbers drawn.

    Returns:
        (L, 4) states x, y, vx, vy; (L,) log weights, prior over proposal; (2, 2) position covariance of the proposal.
    """
    position, kept = initial_position(state.anywhere, rows, state.world, state.config.gate)
    first = linear(state.anywhere, position, rows.take(kept), state.world).state if len(kept) else state.anywhere
    drawn = Gaussian(first.mean, PROPOSAL_INFLATION**2 * first.covariance)
    states = rng.multivariate_normal(drawn.mean, drawn.covariance, state.config.particles, method="cholesky")
    log_ratio = _log_density(states, state.anywhere) - _log_density(states, drawn)
    return states, log_ratio, drawn.covariance[:2, :2]


def _log_density(states: Floats, of: Gaussian) -> Floats:
    """Return (L,) log densities of the Gaussian `of` at `states` (L, 4), up to a constant."""
    off = states - of.mean
    square = np.einsum("li,ij,lj->l", off, np.linalg.inv(of.covariance), off)
    return np.asarray(-0.5 * (square + np.linalg.slogdet(of.covariance)[1]))


def _proposed(
    before: Floats, rows: LinearisedRows, dt: float, state: JointState, rng: Generator
) -> tuple[Floats, Floats, Floats]:
    """Draw states of an object from its motion and its measurements in a scan.

    Args:
        before: (L, 4) states x, y, vx, vy at the scan before.
        rows: measurements of the object inside the gate.
        dt: time since the scan before [s].
        state: settings and sensors.
        rng: generator of the random numbers drawn.

    Returns:
        (L, 4) states; (L,) log weights, motion prior over proposal; (2, 2) mean position covariance of the proposals.
    """
    L = len(before)
    F, Q = motion_of(state.config).transition(dt)
    ahead = before @ F.T
    prior = Q[:2, :2] + 1e-12 * np.trace(state.anywhere.covariance[:2, :2]) * np.eye(2)
    P0 = np.linalg.inv(prior)
    information, pull = np.broadcast_to(P0, (L, 2, 2)).copy(), np.zeros((L, 2))
    if len(rows.sensor):
        # Linearise at the cloud's mean; residuals at each particle's prediction
        H, R = linearised(ahead[:, :2].mean(axis=0), rows, state.world)
        expected, possible = measured(ahead[:, :2], rows, state.world)
        off = np.where(possible, residuals(expected, rows), 0.0)
        information += (H.T / R) @ H
        pull = off / R @ H
    covariance = np.linalg.inv(information)
    mean = ahead[:, :2] + np.einsum("lij,lj->li", covariance, pull)
    root = np.linalg.cholesky(covariance)
    noise = rng.standard_normal((L, 2))
    xy = mean + PROPOSAL_INFLATION * np.einsum("lij,lj->li", root, noise)
    moved = xy - ahead[:, :2]
    # Velocity given the position, by the motion
    G = np.linalg.solve(prior, Q[:2, 2:]).T
    rest = Q[2:, 2:] - G @ Q[:2, 2:]
    drawn = rng.standard_normal((L, 2)) * np.sqrt(np.maximum(np.diag(rest), 0.0))
    velocity = ahead[:, 2:] + moved @ G.T + drawn
    log_motion = -0.5 * np.einsum("li,ij,lj->l", moved, P0, moved) - 0.5 * np.linalg.slogdet(prior)[1]
    log_drawn = (
        -0.5 * (noise**2).sum(axis=1) - 2.0 * math.log(PROPOSAL_INFLATION) - np.log(root[:, 0, 0] * root[:, 1, 1])
    )
    return np.hstack([xy, velocity]), log_motion - log_drawn, PROPOSAL_INFLATION**2 * covariance.mean(axis=0)


def occlusion_by_others(xy: Floats, camera: Floats, diameter: float) -> Bools:
    """Return (L, M) booleans: another object of the same particle hides the object from a camera, [Ercan] Fig. 3.

    Args:
        xy: (L, M, 2) positions of M objects in L particles.
        camera: (2,) position of the camera.
        diameter: diameter of the objects.
    """
    away = xy - camera
    r = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-12)
    e = away / r[..., None]
    along = np.einsum("lji,lki->ljk", e, away)
    across = e[:, :, None, 0] * away[:, None, :, 1] - e[:, :, None, 1] * away[:, None, :, 0]
    inside = (np.abs(across) < 0.5 * diameter) & (along > 0.0) & (along < r[:, :, None])
    diagonal = np.arange(xy.shape[1])
    inside[:, diagonal, diagonal] = False
    return np.asarray(inside.any(axis=2))


def in_plain_view(
    xy: Floats, reports: list[ObjectReports], world: MeasurementWorld, config: JointConfig
) -> list[Bools]:
    """Return, for each of M objects, (K, L) booleans: the sensor of each of its K reports can see it in each particle.

    The position must be in the sensor's field of view and range, and not behind one of its walls; from a camera, other
    objects may hide it, too.

    Args:
        xy: (L, M, 2) positions of the objects in L particles.
        reports: measurements of each object in the scan.
        world: has the sensors with their walls.
        config: has the diameter of the objects.
    """
    cameras = {int(i) for report in reports for i in report.packed.sensor if world.sensors.cos2[i] >= 0.0}
    hidden = {i: occlusion_by_others(xy, world.sensors.xy[i], config.occluder_diameter) for i in cameras}
    found = []
    for j, report in enumerate(reports):
        position = np.ascontiguousarray(xy[:, j])
        seen = np.empty((len(report.packed.sensor), len(xy)), dtype=np.bool_)
        for k, sensor in enumerate(report.packed.sensor.tolist()):
            seen[k] = seen_from(position, sensor, world.sensors)
            if sensor in hidden:
                seen[k] &= ~hidden[sensor][:, j]
        found.append(seen)
    return found


def unperceivable_after(unperceivable: Floats, dt: float) -> Floats:
    """Return the probability that no sensor can detect an object, `dt` [s] later and without measurements.

    It approaches its stationary value of a Markov chain with two states. `unperceivable`, of any shape, are the
    probabilities before.
    """
    a, b = 1.0 / MEAN_PERCEIVABLE_S, 1.0 / MEAN_UNPERCEIVABLE_S
    settled = a / (a + b)
    return settled + (unperceivable - settled) * math.exp(-(a + b) * dt)


def log_factors(
    xy: Floats,
    reports: list[ObjectReports],
    seen: list[Bools],
    unperceivable: Floats,
    world: MeasurementWorld,
    chances: DetectionProbabilities,
) -> tuple[Floats, Floats]:
    """Return (L, M) log-likelihoods of the measurements of M objects, and updated probabilities of being unperceivable.

    A detection z of an unoccluded object has the density P_D N(z) + (1 - P_D) P_F / W, of an occluded one P_F / W; a
    missed detection has 1 - P_D and 1 - P_F. W is the width of the image. An unperceivable object has the likelihood of
    one that is occluded from all sensors, and no sensor detects it.

    Args:
        xy: (L, M, 2) positions of the objects in L particles.
        reports: measurements of each object.
        seen: for each object, (K, L) whether the sensors of its K reports can see it in each particle.
        unperceivable: (L, M) probabilities before the measurements.
        world: sensors.
        chances: detection and false-alarm probabilities of the sensors.
    """
    total, after = np.empty_like(unperceivable), np.zeros_like(unperceivable)
    for j, report in enumerate(reports):
        position = np.ascontiguousarray(xy[:, j])
        expected, _ = measured(position, report.rows, world)
        _, variance = linearised(position.mean(axis=0), report.rows, world)
        # One that is detected is perceivable; otherwise both states are possible, given the position
        plain, missed = np.log1p(-unperceivable[:, j]), 0.0
        for k, sensor in enumerate(report.packed.sensor.tolist()):
            first, last = int(report.packed.first[k]), int(report.packed.first[k + 1])
            detection, false = float(chances.detection[sensor]), float(chances.false[sensor])
            if first == last:
                plain += np.log(np.where(seen[j][k], 1.0 - detection, 1.0 - false))
                missed += math.log(1.0 - false)
                continue
            row = report.rows.take(np.arange(first, first + 1))
            off = residuals(expected[:, first : first + 1], row)[:, 0]
            density = np.exp(-0.5 * off**2 / variance[first]) / math.sqrt(2.0 * math.pi * variance[first])
            widths = world.noise.width_px if row.pixel[0] else world.noise.width
            floor = false / widths[sensor]
            plain += np.log(np.where(seen[j][k], detection * density + (1.0 - detection) * floor, floor))
        if len(report.rows.sensor):
            total[:, j] = plain
            continue
        without = np.log(unperceivable[:, j]) + missed
        total[:, j] = np.logaddexp(plain, without)
        after[:, j] = np.exp(without - total[:, j])
    return total, after


def _depleted(log_weights: Floats) -> bool:
    """Return whether the log weights (L,) of one object alone give an effective sample size that is too small.

    The limit is `MIN_EFFECTIVE_SAMPLE_SIZE`.
    """
    weights, _ = normalise_log_weights(log_weights)
    return effective_sample_size(weights) < MIN_EFFECTIVE_SAMPLE_SIZE


def _moments(own: Floats, weights: Floats, drawn: Floats) -> Gaussian:
    """Return the weighted mean and covariance of the states `own` (L, 4) of one object.

    With a small effective sample size the covariance is inflated, and the position covariance `drawn` (2, 2) of the
    proposal is added.
    """
    mean, covariance = mean_and_covariance(weights, own)
    size = effective_sample_size(weights)
    if size < MIN_EFFECTIVE_SAMPLE_SIZE:
        covariance = covariance * (size / (size - 1.0) if size > 1.5 else 3.0)
        covariance[:2, :2] += drawn
    return Gaussian(mean, covariance)


def _estimate(
    own: Floats, weights: Floats, drawn: Floats, report: ObjectReports, fallback: str, log_likelihood: float
) -> Estimate:
    """Return the estimate of one object after a scan.

    Args:
        own: (L, 4) its states x, y, vx, vy.
        weights: (L,) weights of the particles, sum 1.
        drawn: (2, 2) position covariance of the proposal, added if few particles are effective.
        report: measurements of the object.
        fallback: reason of a new beginning; empty: none, and `depleted` may be set.
        log_likelihood: log-likelihood of the scan; NaN in the estimate if not finite.
    """
    mean, covariance = _moments(own, weights, drawn)
    size = effective_sample_size(weights)
    seen = np.diff(report.packed.first) > 0
    return Estimate(
        xy=mean[:2],
        velocity=mean[2:],
        covariance=np.ascontiguousarray(covariance[:2, :2]),
        ess=size,
        log_likelihood=log_likelihood if math.isfinite(log_likelihood) else math.nan,
        n_observing=len(report.packed.sensor),
        n_detected=int(np.count_nonzero(seen)),
        fallback=fallback or ("depleted" if size < MIN_EFFECTIVE_SAMPLE_SIZE else ""),
        used=tuple(report.packed.sensor.tolist()),
        seen_by=tuple(report.packed.sensor[seen].tolist()),
    )


def _trace(state: tuple[JointState, int]) -> PosteriorRecord:
    """Return the record of one object's last step, for smoothing: `state` is (state of the filter, identity)."""
    own, target = state
    return own.links[own.objects.index(target)]


def _smoothed(traces: Sequence[PosteriorRecord], config: JointConfig) -> list[SmoothedState]:
    """Return the smoothed state of one object for each of its records, in the order of time (Rauch-Tung-Striebel)."""
    found = rts_smooth(traces, motion_of(config).transition)
    return [SmoothedState(one.mean[:2], one.mean[2:], one.covariance[:2, :2]) for one in found]


METHOD = JointMethod(
    config=JointConfig,
    init=init,
    step=step,
    smoothing=Smoothing(
        wanted=lambda own: own,
        trace=_trace,
        back=lambda traces, own, rng: _smoothed(traces, own),  # noqa: ARG005
    ),
)
