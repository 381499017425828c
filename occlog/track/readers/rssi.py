"""Method `rssi`: a Rao-Blackwellised particle filter on the strength of signals.

Particles are places and velocities; the shadowing of each reader, given a particle's places, is linear and Gaussian,
and is integrated out by a Kalman filter.  Without it errors that last for seconds would be counted as new evidence in
every window, and the covariance would be too small.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import Bools, Floats, Ints
from occlog.core.plane.polygons import inside_polygon
from occlog.filtering.lifecycle import advance, elapsed
from occlog.filtering.particles import effective_size, log_of, mean_and_covariance, normalise, systematic_ancestors

from .path_loss import PathLoss, Shadowing, no_shadowing, predict_shadowing, update_shadowing

EDGE = 0.1
"""Width of the edge of a coverage, as a share of the range."""
TRIES = 20
"""Draws of a place in the room; what is then still outside is at the corner of the room."""


class Rules(NamedTuple):
    """What does not change while a tag is tracked."""

    model: PathLoss
    ranges: Floats  # (R,) infinite: not known, so that no read says nothing
    room: Floats  # (K, 2) polygon in which tags are
    particles: int
    speed: float  # standard deviation of each axis' velocity
    turn_s: float  # time in which a velocity is forgotten
    detection: float
    stray: float


class Cloud(NamedTuple):
    """Weighted particles of one tag."""

    t_ns: int
    xy: Floats  # (N, 2)
    velocity: Floats  # (N, 2)
    weights: Floats  # (N,) sum 1
    shadowing: Shadowing


class Draw(NamedTuple):
    """Particles after a window."""

    cloud: Cloud
    log_likelihood: float  # of the window; -inf: no particle explains it
    restarted: bool = False


class Located(NamedTuple):
    """The estimate of a window."""

    xy: Floats  # (2,)
    velocity: Floats  # (2,)
    covariance: Floats  # (4, 4) of x, y, vx, vy
    effective: float  # number of particles
    restarted: bool  # no particle explained the window, and all were drawn anew


def begin(rules: Rules, t_ns: int, rng: Generator) -> Cloud:
    """Draw particles evenly over the room."""
    n = rules.particles
    velocity = rules.speed * rng.standard_normal((n, 2))
    return Cloud(t_ns, _places(rules.room, n, rng), velocity, np.full(n, 1.0 / n), no_shadowing(rules.model, n))


def step(rules: Rules, cloud: Cloud, t_ns: int, count: Ints, rssi: Floats, rng: Generator) -> tuple[Cloud, Located]:
    """Take in the reads of a window.

    Args:
        rules: model and settings.
        cloud: of the window before, or from `begin`.
        t_ns: time of the window, not before that of the cloud.
        count: (R,) reads of each reader.
        rssi: (R,) their mean strength [dBm]; NaN: not told.
        rng: random numbers.
    """

    def weighed(moved: Cloud) -> Draw:
        """Particles weighed by strengths with the shadowing integrated out, coverage, and walls."""
        shadowing, log_weights = _weigh(rules, moved, count, rssi)
        weights, total = normalise(log_weights)
        return Draw(moved._replace(weights=weights, shadowing=shadowing), total)

    def update(dt_s: float) -> Draw | None:
        """Propose: the prior, velocities that are forgotten (Ornstein-Uhlenbeck)."""
        draw = weighed(_predict(rules, cloud, t_ns, dt_s, rng))
        return draw if draw.log_likelihood > -math.inf else None

    (after, _, restarted), _ = advance(
        elapsed(cloud.t_ns, t_ns),
        math.inf,
        known=True,
        initiate=lambda _: weighed(begin(rules, t_ns, rng))._replace(restarted=True),
        update=update,
        loss=lambda _: (0, False),
    )
    weights = after.weights
    # Estimate
    mean, covariance = mean_and_covariance(weights, np.column_stack([after.xy, after.velocity]))
    effective = effective_size(weights)
    found = Located(mean[:2], mean[2:], covariance, effective, restarted)
    # Resample: systematic, where fewer than half of the particles count
    if effective < 0.5 * rules.particles:
        rows = systematic_ancestors(weights, rules.particles, float(rng.random()))
        after = Cloud(
            t_ns,
            after.xy[rows],
            after.velocity[rows],
            np.full(rules.particles, 1.0 / rules.particles),
            Shadowing(after.shadowing.mean[rows], after.shadowing.variance),
        )
    return after, found


def _predict(rules: Rules, cloud: Cloud, t_ns: int, dt_s: float, rng: Generator) -> Cloud:
    """Move the particles to the time of the next window."""
    decay = math.exp(-dt_s / rules.turn_s)
    noise = rng.standard_normal(cloud.velocity.shape)
    velocity = decay * cloud.velocity + rules.speed * math.sqrt(1.0 - decay**2) * noise
    xy = cloud.xy + 0.5 * dt_s * (cloud.velocity + velocity)
    return Cloud(t_ns, xy, velocity, cloud.weights, predict_shadowing(rules.model, cloud.shadowing, dt_s))


def _weigh(rules: Rules, cloud: Cloud, count: Ints, rssi: Floats) -> tuple[Shadowing, Floats]:
    """Update the shadowing of each particle, and return the log-weights with it."""
    expected = rules.model.expected(cloud.xy)
    shadowing, log_likelihood = update_shadowing(rules.model, cloud.shadowing, expected, rssi, count)
    log_weights = log_of(cloud.weights) + log_likelihood + _coverage(rules, cloud.xy, count > 0)
    return shadowing, np.where(inside_polygon(cloud.xy, rules.room), log_weights, -np.inf)


def _coverage(rules: Rules, xy: Floats, read: Bools) -> Floats:
    """(N,) log-probability that those readers of known range read the tag that did, and the others did not."""
    known = np.isfinite(rules.ranges)
    if not known.any():
        return np.zeros(len(xy))
    reach, places = rules.ranges[known], rules.model.places[known, :2]
    distance = np.sqrt(((xy[:, None, :] - places) ** 2).sum(axis=2))
    inside = 0.5 * (1.0 + np.tanh((reach - distance) / (EDGE * reach)))
    probability = rules.stray + (rules.detection - rules.stray) * inside
    return np.asarray(np.log(np.where(read[known], probability, 1.0 - probability)).sum(axis=1))


def _places(room: Floats, n: int, rng: Generator) -> Floats:
    """(n, 2) places that are even over a polygon."""
    low, high = room.min(axis=0), room.max(axis=0)
    xy = np.broadcast_to(room[0], (n, 2)).copy()
    outside = np.ones(n, dtype=np.bool_)
    for _ in range(TRIES):
        xy[outside] = low + (high - low) * rng.random((int(outside.sum()), 2))
        outside[outside] = ~inside_polygon(xy[outside], room)
        if not outside.any():
            break
    return xy
