"""Particles from one scan to the next: auxiliary sampling importance resampling ([Ercan] Alg. 1).

Two importance densities:

* `bootstrap`, [Ercan]'s: a particle moves by the model alone, without the scan.  Stage 1 chooses parents by the
  likelihood at their expected positions.  Where bearings are sharper than the motion is certain nearly all particles
  miss the scan's likelihood, and the few that do not are taken for certainty;
* `adapted`: for every particle there are three hypotheses, that it goes on, changes its destination, or waits.  The
  Laplace approximation of each one's posterior (`occlog.track.methods.apf.kernels.importance`) gives the predictive
  likelihood by which stage 1 chooses among the hypotheses of all particles, and the density from which the position is
  drawn.  What the approximation omits (walls, moving occluders, sensors that saw nothing) comes into stage 1
  from the likelihood at the mode of each particle's best hypothesis.

With either one the weights are those of importance sampling, so that the density decides how well the
particles are used and not what they estimate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.visibility import draw as draw_places
from occlog.core.geometry.visibility import initial_positions
from occlog.core.plane import sample_floor, sample_near, signed_area
from occlog.filtering.likelihood.directions import PackedScan
from occlog.filtering.motion import waypoint
from occlog.filtering.motion.waypoint import WaypointParticles
from occlog.filtering.particles import effective_sample_size, log_of, normalise_log_weights, systematic_ancestors

from .kernels import importance
from .model import OCCLUDER_SUPPORT_SIGMAS_STAGE1, ApfModel, evidence, likelihood, lines_of_sight

START_KERNEL_RATIO = 1.0 / 3.0
"""Share of the standard deviation of a given start that the kernel of each particle has."""

EVEN_HYPOTHESIS_SHARE = 0.2
"""Share of stage 1 that goes to the three hypotheses of the motion alike where a scan has no measurement.

The next scan needs particles of rare hypotheses to choose among: a target that stops unseen, for example.  The
effective number falls by a tenth in such a step.
"""


class ProposedParticles(NamedTuple):
    """Weighted particles at the time of a scan, with the log-likelihood of the scan and how they were drawn.

    `fallback` is empty, or names what went wrong: `sir`, `restart` or `gap`. `parents` are None for particles that were
    drawn without regard to earlier ones.
    """

    particles: WaypointParticles
    weights: Floats  # (L,) sum 1
    log_likelihood: float  # of the scan given those before; -inf if no particle agrees with it
    fallback: str
    parents: Ints | None = None  # (L,) among those before; None: they were resampled
    sharpness: float = 0.0  # mean variance per axis of the importance densities they came from
    effective: float = math.inf  # effective number of the many that these were drawn from, where they begin


def auxiliary_step(
    model: ApfModel, particles: WaypointParticles, weights: Floats, packed: PackedScan, dt: float, rng: Generator
) -> ProposedParticles:
    """Return particles moved to the time of a scan and weighted by it, in one step of at most one reference step.

    The importance density is that of the setting `proposal`; `bootstrap` if `dt` is 0. The log-likelihood is -inf if no
    particle agrees with the scan.

    Args:
        model: scene and settings.
        particles: L particles, a time dt before the scan.
        weights: (L,) weights of the particles, sum 1.
        packed: the scan.
        dt: time from the particles to the scan [s], >= 0.
        rng: generator of the random numbers drawn.
    """
    if model.config.proposal == "adapted" and dt > 0.0:
        return _adapted_step(model, particles, weights, packed, dt, rng)
    return _bootstrap_step(model, particles, weights, packed, dt, rng)


def _bootstrap_step(
    model: ApfModel, particles: WaypointParticles, weights: Floats, packed: PackedScan, dt: float, rng: Generator
) -> ProposedParticles:
    """Return particles at the time of a scan by [Ercan] Alg. 1, drawn from the motion model alone.

    Stage 1 chooses parents by the likelihood at their expected positions; stage 2 divides by the stage-1 weight of the
    parent.

    Args:
        model: scene and settings.
        particles: L particles, a time dt before the scan.
        weights: (L,) weights of the particles, sum 1.
        packed: the scan.
        dt: time from the particles to the scan [s], at most one reference step.
        rng: generator of the random numbers drawn.
    """
    config = model.config
    # Stage 1, weigh the expected states kappa: w_l f(Z|kappa_l)
    arrived = waypoint.reached(particles, model.motion, model.floor)
    kappa = waypoint.expected_xy(particles, arrived, dt, model.motion)
    first, fallback = _stage_1(
        log_of(weights) + likelihood(model, kappa, packed, OCCLUDER_SUPPORT_SIGMAS_STAGE1),
        weights,
        config.defensive_fraction,
    )
    # Resample: systematic; pi_l is the parent of particle l
    parents, ratio = np.arange(len(weights)), weights
    if effective_sample_size(first) < config.resampling_threshold * len(weights) or config.resampling_threshold >= 1.0:
        parents = systematic_ancestors(first, config.particles, rng.random())
        particles, arrived = waypoint.select(particles, parents), arrived[parents]
        ratio = weights[parents] / first[parents] / config.particles
    # Propose: draw from the importance density f(u(t)|u_pi(t-1)) ([Ercan] Sec. 4.1)
    particles = move(model, particles, arrived, dt, rng)
    # Stage 2, weigh: f(Z|u_l) over the stage-1 weight of the parent
    weights, log_sum = normalise_log_weights(log_of(ratio) + likelihood(model, particles.xy, packed))
    return ProposedParticles(particles, weights, log_sum, fallback, parents)


def _adapted_step(
    model: ApfModel, particles: WaypointParticles, weights: Floats, packed: PackedScan, dt: float, rng: Generator
) -> ProposedParticles:
    """Return particles at the time of a scan, drawn from Laplace approximations of each particle's posterior.

    Each particle has three hypotheses: it goes on, changes its destination, or waits. Stage 1 of the auxiliary particle
    filter chooses among the hypotheses of all particles by their predictive likelihood.

    Args:
        model: scene and settings.
        particles: L particles, a time dt before the scan.
        weights: (L,) weights of the particles, sum 1.
        packed: the scan.
        dt: time from the particles to the scan [s], > 0 and at most one reference step.
        rng: generator of the random numbers drawn.
    """
    config, L, n = model.config, len(weights), model.config.particles
    # Hypotheses: go on (MTD), change the destination (CD), wait (W)
    arrived = waypoint.reached(particles, model.motion, model.floor)
    positions, before = destinations(model, particles.xy, rng), times_of_change(model, L, rng)
    chance, mean, variance = waypoint.hypotheses(particles, arrived, positions, before, dt, model.motion)
    prior = (chance * weights).reshape(-1)  # (3 L,)
    mean, variance = mean.reshape(-1, 2), variance.reshape(-1)
    # Approximate each one's posterior, and the predictive likelihood of the scan
    first_row, rows = evidence(model, packed)
    near = importance.adapt(mean, variance, prior > 0.0, first_row, rows)
    log_first = (log_of(prior) + near.log_volume + near.log_factors).reshape(3, L)
    # What the approximation omits, at the mode of each particle's best hypothesis
    best = np.argmax(log_first, axis=0) * L + np.arange(L)
    log_first += (
        likelihood(model, near.mode[best], packed, OCCLUDER_SUPPORT_SIGMAS_STAGE1, anywhere=True)
        - near.log_factors[best]
    )
    # Stage 1, weigh the hypotheses, and resample: systematic
    first, fallback = _stage_1(log_first.reshape(-1), prior, config.defensive_fraction)
    if not len(rows):
        # No sensor detected the target: keep particles of every hypothesis for the next scan
        first = (1.0 - EVEN_HYPOTHESIS_SHARE) * first + EVEN_HYPOTHESIS_SHARE * _even_weights(weights, chance)
    chosen = systematic_ancestors(first, n, rng.random())
    parents, regime = chosen % L, chosen // L
    # Propose: positions from the importance density, the velocity given the position
    expected, spread = mean[chosen], variance[chosen]
    xy, log_ratio = importance.draw(
        expected,
        spread,
        near.mode[chosen],
        near.root[chosen],
        config.defensive_fraction,
        rng.random(n),
        rng.standard_normal((n, 2)),
    )
    moved = waypoint.arrive(
        waypoint.select(particles, parents),
        regime,
        positions[parents],
        expected,
        xy,
        rng.standard_normal((n, 2)),
        dt,
        model.motion,
    )
    # Stage 2, weigh: prior and likelihood over stage 1 and the importance density
    log_ratio += log_of(prior[chosen]) - np.log(first[chosen]) - math.log(n)
    weights, log_sum = normalise_log_weights(log_ratio + likelihood(model, xy, packed))
    sharpness = float(0.5 * np.mean(np.sum(near.root[chosen] ** 2, axis=1)))
    return ProposedParticles(moved, weights, log_sum, fallback, parents, sharpness)


def _stage_1(log_weights: Floats, prior: Floats, defensive: float) -> tuple[Floats, str]:
    """Return (M,) stage-1 weights of sum 1, and the fallback: `sir` if no expected state agrees with the scan, else "".

    Args:
        log_weights: (M,) log of prior weight times expected likelihood.
        prior: (M,) weights by the motion alone, of sum 1; used instead of `log_weights` in case of `sir`.
        defensive: share of `prior` in the result, 0 to 1.
    """
    first, log_sum = normalise_log_weights(log_weights)
    fallback = "" if math.isfinite(log_sum) else "sir"
    if fallback:  # stage 1 is skipped: plain sampling importance resampling
        first = prior
    return (1.0 - defensive) * first + defensive * prior, fallback


def _even_weights(weights: Floats, chance: Floats) -> Floats:
    """Return (3 L,) weights of hypotheses: each particle's weight shared evenly among those that are possible.

    Args:
        weights: (L,) weights of the particles.
        chance: (3, L) probabilities of the three hypotheses of each particle; possible means above 0.
    """
    possible = chance > 0.0
    return np.where(possible, weights / possible.sum(axis=0), 0.0).reshape(-1)


def drift(model: ApfModel, particles: WaypointParticles, dt: float, rng: Generator) -> WaypointParticles:
    """Return the particles a time `dt` > 0 [s] later, drawn from the motion model without measurements.

    The time is divided into equal steps of at most a reference step.
    """
    parts = parts_of(dt, model)
    for _ in range(parts):
        arrived = waypoint.reached(particles, model.motion, model.floor)
        particles = move(model, particles, arrived, dt / parts, rng)
    return particles


def parts_of(dt: float, model: ApfModel) -> int:
    """Return the number of equal steps of a time `dt` [s], none longer than the reference step."""
    return max(1, math.ceil(dt / model.motion.reference_s - 1e-9))


def move(model: ApfModel, particles: WaypointParticles, arrived: Bools, dt: float, rng: Generator) -> WaypointParticles:
    """Return particles moved by `dt` [s], drawn from the importance density of [Ercan] Sec. 4.1 (the motion model).

    `arrived` (L,) from `waypoint.reached`: the particle is at its destination.
    """
    L = len(particles.speed)
    regime = waypoint.choose_regimes(particles, arrived, dt, model.motion, rng.random(L))
    positions = destinations(model, particles.xy[regime == waypoint.CHANGE], rng)
    before = times_of_change(model, len(positions), rng)
    return waypoint.move(particles, regime, positions, before, rng.standard_normal((L, 4)), dt, model.motion)


def times_of_change(model: ApfModel, n: int, rng: Generator) -> Floats:
    """(n,) shares of a step, 0 to 1, after which targets take new destinations: 0, or uniform if `uniform_change`."""
    return rng.random(n) if model.motion.uniform_change else np.zeros(n)


def destinations(model: ApfModel, xy: Floats, rng: Generator) -> Floats:
    """Return (n, 2) random new destinations of targets at `xy` (n, 2), uniform over the floor of the room.

    In a scene without a room they are at most `model.wander` away from the target.
    """
    if model.views is None:
        return sample_floor(len(xy), model.floor, rng)
    return sample_near(xy, model.wander, model.floor, rng)


def initial_particles(model: ApfModel, start: tuple[float, ...] | None, rng: Generator) -> WaypointParticles:
    """Return `particles` * `initial_particle_factor` particles before any scan, with random destinations and speeds.

    Positions are uniform over the floor (without a room: over the region that sensors see), or, with `start` (x, y,
    standard deviation), Gaussian about it; for the proposal `adapted` a little narrower, as kernels are added later.
    """
    config = model.config
    n = config.particles * config.initial_particle_factor
    if start is not None:
        shrink = math.sqrt(1.0 - START_KERNEL_RATIO**2) if config.proposal == "adapted" else 1.0
        xy = np.array(start[:2]) + shrink * start[2] * rng.standard_normal((n, 2))
    elif model.views is not None:
        xy = draw_places(n, model.views, rng)
    else:
        xy = sample_floor(n, model.floor, rng)
    return _particles_at(model, xy, rng)


def _particles_at(model: ApfModel, xy: Floats, rng: Generator) -> WaypointParticles:
    """Return particles at positions `xy` (L, 2), with random destinations and the random speeds of new targets."""
    particles = waypoint.start_particles(
        xy, model.floor, model.config.initial_speed, model.config.sigma_initial_speed, rng
    )
    return particles if model.views is None else particles._replace(destination=destinations(model, xy, rng))


def reinitialise(model: ApfModel, packed: PackedScan, rng: Generator) -> ProposedParticles:
    """Return the filter's number of particles at the time of a scan, drawn without regard to earlier scans.

    Positions are drawn over the whole floor, or, without a room and without measurements of distances, along the
    bearings of the scan; they are then resampled by the likelihood of `packed`.
    """
    if model.views is None or model.measured is not None:
        return select_initial_particles(model, initial_particles(model, None, rng), None, packed, rng)
    n = model.config.particles * model.config.initial_particle_factor
    lines = lines_of_sight(packed, model.sensors, model.noise, model.views)
    xy, log_ratio = initial_positions(n, lines, model.views, rng)
    return _chosen(model, _particles_at(model, xy, rng), log_ratio - math.log(n), 0.0, packed, rng)


def select_initial_particles(
    model: ApfModel, particles: WaypointParticles, sigma: float | None, packed: PackedScan, rng: Generator
) -> ProposedParticles:
    """Resample initial particles by their likelihood for the first scan, to the filter's number of particles.

    With the proposal `adapted` each particle represents a kernel about its position, adapted to the scan as in a step.

    Args:
        model: scene and settings.
        particles: initial particles, from `initial_particles`.
        sigma: standard deviation of the given start; None: they are spread over the floor.
        packed: the scan.
        rng: generator of the random numbers drawn.
    """
    config, many = model.config, len(particles.speed)
    log_prior, sharpness = np.full(many, -math.log(many)), 0.0
    if config.proposal == "adapted" and sigma != 0.0:
        # The kernels' width: what lies between the positions of the floor, or a share of the start's
        width2 = abs(signed_area(model.floor.room)) / many if sigma is None else (START_KERNEL_RATIO * sigma) ** 2
        variance = np.full(many, width2)
        first_row, rows = evidence(model, packed)
        near = importance.adapt(particles.xy, variance, np.ones(many, dtype=np.bool_), first_row, rows)
        xy, log_ratio = importance.draw(
            particles.xy,
            variance,
            near.mode,
            near.root,
            config.defensive_fraction,
            rng.random(many),
            rng.standard_normal((many, 2)),
        )
        particles, log_prior = particles._replace(xy=xy), log_prior + log_ratio
        sharpness = float(0.5 * np.mean(np.sum(near.root**2, axis=1)))
    return _chosen(model, particles, log_prior, sharpness, packed, rng)


def _chosen(
    model: ApfModel,
    particles: WaypointParticles,
    log_prior: Floats,
    sharpness: float,
    packed: PackedScan,
    rng: Generator,
) -> ProposedParticles:
    """Resample particles by prior weight times likelihood of a scan, to the filter's number of equally weighted ones.

    Args:
        model: scene and settings.
        particles: L particles.
        log_prior: (L,) log weights before the scan.
        sharpness: mean variance per axis of the densities that they were drawn from.
        packed: the scan.
        rng: generator of the random numbers drawn.
    """
    weights, log_sum = normalise_log_weights(log_prior + likelihood(model, particles.xy, packed))
    n = model.config.particles
    drawn = systematic_ancestors(weights, n, rng.random())
    even = np.full(n, 1.0 / n)
    return ProposedParticles(
        waypoint.select(particles, drawn),
        even,
        log_sum,
        "",
        sharpness=sharpness,
        effective=effective_sample_size(weights),
    )
