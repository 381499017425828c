"""Method `rssi`: a Rao-Blackwellised particle filter on the strength of signals.

Particles are positions and velocities; the shadowing of each reader, given a particle's positions, is linear and
Gaussian, and is integrated out by a Kalman filter.  Without it errors that last for seconds would be counted as new
evidence in every window, and the covariance would be too small.

With smoothing, the moments of a window's particles and of their shadowing are smoothed as Gaussians.

Strength of a tag's signal at a reader: path loss with distance, shadowing, noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.path_loss import received_power
from occlog.core.plane import inside_polygon
from occlog.filtering.gaussian import Gaussian, PosteriorRecord, rts_smooth
from occlog.filtering.lifecycle import advance, elapsed
from occlog.filtering.particles import (
    effective_sample_size,
    log_of,
    mean_and_covariance,
    normalise_log_weights,
    systematic_ancestors,
)
from occlog.track.interface import SmoothedState


class PathLoss(NamedTuple):
    """The model of R readers: a strength is power - 10 exponent log10(d / 1 m) + shadowing + noise [dBm].

    Shadowing is a stationary Ornstein-Uhlenbeck process of each reader; noise is white.
    """

    positions: Floats  # (R, 3)
    power: Floats  # (R,) strength at 1 m [dBm]
    exponent: float
    noise_db: float  # standard deviation of the noise of a read
    shadow_db: float  # standard deviation of the shadowing
    shadow_s: float  # time in which it is forgotten
    height: float  # of the tags
    metre: float  # in units of length

    def expected(self, xy: Floats) -> Floats:
        """Return (N, R) strengths [dBm], without shadowing and noise, of tags at positions `xy` (N, 2)."""
        across = ((xy[:, None, :] - self.positions[None, :, :2]) ** 2).sum(axis=2)
        distance = np.sqrt(across + (self.positions[:, 2] - self.height) ** 2) / self.metre
        return received_power(self.power, self.exponent, distance)

    def strength_at(self, distance: float) -> Floats:
        """Return (R,) strengths [dBm] that are expected at a `distance` [length] from each reader."""
        return received_power(self.power, self.exponent, distance / self.metre)


class ShadowingState(NamedTuple):
    """Gaussian belief about the shadowing [dB] of R readers, for each of N position hypotheses.

    The variance is common to all hypotheses, since it does not depend on the strengths.
    """

    mean: Floats  # (N, R) [dB]
    variance: Floats  # (R,) [dB^2]


def no_shadowing(model: PathLoss, hypotheses: int) -> ShadowingState:
    """Return the shadowing before any read, for N = `hypotheses`: mean 0 and the stationary variance of each reader."""
    readers = len(model.power)
    return ShadowingState(np.zeros((hypotheses, readers)), np.full(readers, model.shadow_db**2))


def predict_shadowing(model: PathLoss, known: ShadowingState, dt_s: float) -> ShadowingState:
    """Return the shadowing `dt_s` seconds later: the mean decays to 0, the variance approaches the stationary one."""
    decay = np.exp(-dt_s / model.shadow_s)
    variance = decay**2 * known.variance + model.shadow_db**2 * (1.0 - decay**2)
    return ShadowingState(decay * known.mean, variance)


def update_shadowing(
    model: PathLoss, known: ShadowingState, expected: Floats, rssi: Floats, count: Ints
) -> tuple[ShadowingState, Floats]:
    """Return the shadowing after the mean strengths of a window (Kalman update), and the log-likelihood of these.

    Args:
        model: path loss model of the R readers.
        known: shadowing before the window, for N hypotheses.
        expected: (N, R) strengths by the distance of each hypothesis [dBm].
        rssi: (R,) mean strengths [dBm]; NaN: none.
        count: (R,) number of reads that each is the mean of.

    Returns:
        The shadowing afterwards, and the (N,) log-likelihood of the strengths.
    """
    finite: Bools = np.isfinite(rssi)
    # Innovation, its variance, gain
    innovation = np.where(finite, np.where(finite, rssi, 0.0) - expected - known.mean, 0.0)
    spread = known.variance + model.noise_db**2 / np.maximum(count, 1)
    gain = np.where(finite, known.variance / spread, 0.0)
    log_likelihood = -0.5 * (innovation**2 / spread + np.where(finite, np.log(2.0 * np.pi * spread), 0.0)).sum(axis=1)
    return ShadowingState(known.mean + gain * innovation, (1.0 - gain) * known.variance), log_likelihood


EDGE = 0.1
"""Width of the edge of a coverage, as a share of the range."""
TRIES = 20
"""Draws of a position in the room; what is then still outside is at the corner of the room."""

MIN_EFFECTIVE_SAMPLE_SIZE = 10.0
"""Fewer effective particles are too few for a covariance."""
TEMPERING_STEPS, MIN_LOG_WEIGHT = 30, -700.0
"""Bisections of the power of weights, and the logarithm that the smallest of them have."""


class TagFilterModel(NamedTuple):
    """Constants of the filter of tags: path loss, ranges, room, motion, and probabilities of reads.

    `detection` and `stray` are the probabilities of a read in the range of a reader and out of it.
    """

    model: PathLoss
    ranges: Floats  # (R,) infinite: not known, so that a missing read is uninformative
    room: Floats  # (K, 2) polygon in which tags are
    particles: int
    speed: float  # standard deviation of each axis' velocity
    turn_s: float  # time in which a velocity is forgotten
    detection: float
    stray: float


class TagParticles(NamedTuple):
    """N weighted particles of one tag at the time of a window, with the shadowing for each."""

    t_ns: int
    xy: Floats  # (N, 2)
    velocity: Floats  # (N, 2)
    weights: Floats  # (N,) sum 1
    shadowing: ShadowingState


class ReadUpdate(NamedTuple):
    """Particles after the update by a window of reads, and the log-likelihood of the window."""

    cloud: TagParticles
    log_likelihood: float  # of the window; -inf: no particle explains it
    restarted: bool = False


class TagEstimate(NamedTuple):
    """Estimated position and velocity of a tag in one window, with covariance and the particles."""

    xy: Floats  # (2,)
    velocity: Floats  # (2,)
    covariance: Floats  # (4, 4) of x, y, vx, vy
    effective: float  # number of particles
    restarted: bool  # no particle explained the window, and all were resampled
    cloud: TagParticles  # weighted, before resampling


def begin(tag_model: TagFilterModel, t_ns: int, rng: Generator) -> TagParticles:
    """Return particles of one tag before its first window at time `t_ns` [ns]: uniform over the room.

    Their weights are equal, velocities random, and the shadowing is unknown.
    """
    n = tag_model.particles
    velocity = tag_model.speed * rng.standard_normal((n, 2))
    return TagParticles(
        t_ns, _places(tag_model.room, n, rng), velocity, np.full(n, 1.0 / n), no_shadowing(tag_model.model, n)
    )


def step(
    tag_model: TagFilterModel, cloud: TagParticles, t_ns: int, count: Ints, rssi: Floats, rng: Generator
) -> tuple[TagParticles, TagEstimate]:
    """Return the resampled particles after the reads of a window, and the estimate.

    If no particle explains the window, particles are drawn over the room.

    Args:
        tag_model: constants of the filter.
        cloud: particles after the window before, or from `begin`.
        t_ns: time of the window [ns], not before that of the particles.
        count: (R,) number of reads of each reader.
        rssi: (R,) mean strength of each reader's reads [dBm]; NaN: not known.
        rng: generator of the random numbers drawn.
    """

    def weighed(moved: TagParticles) -> ReadUpdate:
        """Return particles weighted by strengths (shadowing integrated out), coverage and walls."""
        shadowing, log_weights = _weigh(tag_model, moved, count, rssi)
        weights, total = normalise_log_weights(log_weights)
        return ReadUpdate(moved._replace(weights=weights, shadowing=shadowing), total)

    def update(dt_s: float) -> ReadUpdate | None:
        """Return the particles, predicted by `dt_s` seconds and weighted by the reads; None if none explains them.

        Velocities are Ornstein-Uhlenbeck processes.
        """
        draw = weighed(_predict(tag_model, cloud, t_ns, dt_s, rng))
        return draw if draw.log_likelihood > -math.inf else None

    (after, _, restarted), _ = advance(
        elapsed(cloud.t_ns, t_ns),
        math.inf,
        known=True,
        initiate=lambda _: weighed(begin(tag_model, t_ns, rng))._replace(restarted=True),
        update=update,
        loss=lambda _: (0, False),
    )
    weights = after.weights
    # Estimate
    effective = effective_sample_size(weights)
    usable = tempered(weights, inside_polygon(after.xy, tag_model.room), MIN_EFFECTIVE_SAMPLE_SIZE)
    mean, covariance = mean_and_covariance(usable, np.column_stack([after.xy, after.velocity]))
    found = TagEstimate(mean[:2], mean[2:], covariance, effective, restarted, after._replace(weights=usable))
    # Resample: systematic, where fewer than half of the particles count
    if effective < 0.5 * tag_model.particles:
        rows = systematic_ancestors(weights, tag_model.particles, float(rng.random()))
        after = TagParticles(
            t_ns,
            after.xy[rows],
            after.velocity[rows],
            np.full(tag_model.particles, 1.0 / tag_model.particles),
            ShadowingState(after.shadowing.mean[rows], after.shadowing.variance),
        )
    return after, found


def tempered(weights: Floats, possible: Bools, least: float) -> Floats:
    """Return the weights, flattened by a power if fewer than `least` particles would be effective.

    One or two particles have no spread: it would state millimetres where metres are open.

    Args:
        weights: (N,) weights, sum 1.
        possible: (N,) which particles may have a weight: those in the room.
        least: effective sample size to reach; at most a third of the possible particles.
    """
    least = min(least, np.count_nonzero(possible) / 3.0)
    if effective_sample_size(weights) >= least:
        return weights
    log_weights = np.where(possible, np.maximum(log_of(weights), MIN_LOG_WEIGHT), -np.inf)
    low, high = 1e-9, 1.0
    for _ in range(TEMPERING_STEPS):
        power = 0.5 * (low + high)
        found, _ = normalise_log_weights(power * log_weights)
        low, high = (power, high) if effective_sample_size(found) >= least else (low, power)
    found, _ = normalise_log_weights(low * log_weights)
    return found


MIN_RELATIVE_SPREAD = 1e-4
"""Standard deviations of a trace of few particles are at least such a share of the stationary ones."""


def trace_of(tag_model: TagFilterModel, found: TagEstimate, before_ns: int) -> PosteriorRecord:
    """Return the record of a window for smoothing: a Gaussian of position, velocity and the shadowing of R readers.

    It has 4 + R dimensions (4 without shadowing). The shadowing belongs to the state, as it lasts: without it later
    reads would count as independent of earlier ones.

    Args:
        tag_model: constants of the filter.
        found: the estimate of the window.
        before_ns: time of the tag's window before [ns].
    """
    cloud = found.cloud
    states = np.column_stack([cloud.xy, cloud.velocity, cloud.shadowing.mean])
    mean, covariance = mean_and_covariance(cloud.weights, states)
    scale = np.full(len(mean), tag_model.model.shadow_db)
    scale[:2], scale[2:4] = tag_model.speed * tag_model.turn_s, tag_model.speed
    own = np.concatenate([np.zeros(4), cloud.shadowing.variance])
    covariance = covariance + np.diag(own + (MIN_RELATIVE_SPREAD * scale) ** 2)
    if not tag_model.model.shadow_db:
        mean, covariance = mean[:4], covariance[:4, :4]
    return PosteriorRecord(Gaussian(mean, covariance), elapsed(before_ns, cloud.t_ns), found.restarted)


def smoothed_states(tag_model: TagFilterModel, traces: Sequence[PosteriorRecord]) -> list[SmoothedState]:
    """Return smoothed states of a tag by the Rauch-Tung-Striebel recursion (walls count in the filter only).

    Backward simulation is no alternative: with the shadowing integrated out, a particle's past is a part of its state.

    Args:
        tag_model: constants of the filter.
        traces: records of a tag's windows, in the order of time.
    """
    readers = len(traces[0].after.mean) - 4

    def transition(dt_s: float) -> tuple[Floats, Floats]:
        """Return transition matrix and noise covariance over `dt_s` [s] of (x, y, vx, vy, shadowing of each reader)."""
        forgets = np.repeat([tag_model.turn_s, tag_model.model.shadow_s], [2, readers])
        stationary = np.repeat([tag_model.speed**2, tag_model.model.shadow_db**2], [2, readers])
        decay = np.exp(-dt_s / forgets)
        F, G = np.eye(4 + readers), np.zeros((4 + readers, 2 + readers))
        F[2:, 2:], G[2:] = np.diag(decay), np.eye(2 + readers)
        F[:2, 2:4] = 0.5 * dt_s * np.diag(1.0 + decay[:2])
        G[:2, :2] = 0.5 * dt_s * np.eye(2)
        return F, (G * (stationary * (1.0 - decay**2))) @ G.T

    found = rts_smooth(traces, transition)
    return [SmoothedState(one.mean[:2], one.mean[2:4], one.covariance[:4, :4]) for one in found]


def _predict(tag_model: TagFilterModel, cloud: TagParticles, t_ns: int, dt_s: float, rng: Generator) -> TagParticles:
    """Return the particles moved by `dt_s` seconds to time `t_ns` [ns], with their shadowing predicted."""
    decay = math.exp(-dt_s / tag_model.turn_s)
    noise = rng.standard_normal(cloud.velocity.shape)
    velocity = decay * cloud.velocity + tag_model.speed * math.sqrt(1.0 - decay**2) * noise
    xy = cloud.xy + 0.5 * dt_s * (cloud.velocity + velocity)
    return TagParticles(t_ns, xy, velocity, cloud.weights, predict_shadowing(tag_model.model, cloud.shadowing, dt_s))


def _weigh(tag_model: TagFilterModel, cloud: TagParticles, count: Ints, rssi: Floats) -> tuple[ShadowingState, Floats]:
    """Return each particle's shadowing updated by a window of reads, and the log weights (N,), -inf outside the room.

    Args:
        tag_model: constants of the filter.
        cloud: N particles at the time of the window.
        count: (R,) number of reads of each reader.
        rssi: (R,) their mean strengths [dBm]; NaN: not known.
    """
    expected = tag_model.model.expected(cloud.xy)
    shadowing, log_likelihood = update_shadowing(tag_model.model, cloud.shadowing, expected, rssi, count)
    log_weights = log_of(cloud.weights) + log_likelihood + _coverage(tag_model, cloud.xy, count > 0)
    return shadowing, np.where(inside_polygon(cloud.xy, tag_model.room), log_weights, -np.inf)


def _coverage(tag_model: TagFilterModel, xy: Floats, read: Bools) -> Floats:
    """Return (N,) log probabilities that, of the readers of known range, exactly the given ones read the tag.

    Args:
        tag_model: ranges and positions of the readers, and probabilities of reads.
        xy: (N, 2) positions of the tag.
        read: (R,) whether a reader has read it.
    """
    known = np.isfinite(tag_model.ranges)
    if not known.any():
        return np.zeros(len(xy))
    reach, positions = tag_model.ranges[known], tag_model.model.positions[known, :2]
    distance = np.sqrt(((xy[:, None, :] - positions) ** 2).sum(axis=2))
    inside = 0.5 * (1.0 + np.tanh((reach - distance) / (EDGE * reach)))
    probability = tag_model.stray + (tag_model.detection - tag_model.stray) * inside
    return np.asarray(np.log(np.where(read[known], probability, 1.0 - probability)).sum(axis=1))


def _places(room: Floats, n: int, rng: Generator) -> Floats:
    """Return (n, 2) random positions, uniform over the polygon `room` (K, 2).

    What is still outside after `TRIES` draws is at its first corner.
    """
    low, high = room.min(axis=0), room.max(axis=0)
    xy = np.broadcast_to(room[0], (n, 2)).copy()
    outside = np.ones(n, dtype=np.bool_)
    for _ in range(TRIES):
        xy[outside] = low + (high - low) * rng.random((int(outside.sum()), 2))
        outside[outside] = ~inside_polygon(xy[outside], room)
        if not outside.any():
            break
    return xy
