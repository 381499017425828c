"""Random waypoints: how a particle moves, [Ercan] Sec. 4.1, for steps of any length.

A particle has a position x, a destination tau, a speed s and a regime: it moves towards
its destination (MTD, Eq. 5), changes its destination and moves (CD), or waits (W).
The paper's step has length 1; here it lasts T, the reference step, and lengths and
speeds are per second:

* noise: variance sigma^2 dt per axis, so that sigma is what gathers in a second;
* regimes: drawn anew with probability n = dt / T, else the last one goes on (after CD:
  MTD).  A particle so decides once a reference step on average, waits for a reference
  step on average, and changes its destination lambda times a reference step;
* speed: s' = (1 - phi) s + phi |s T e + v| / T with e the direction and v the noise of
  this step.  The noise of the speed is then phi v along e / T, whose variance grows with
  dt as it should; the paper's |x' - x| / dt would diverge for short steps;
* a destination is reached when it is less than s T away.

With dt = T all of it is the paper's.  Longer steps must be split by the caller, since a
particle can change its mind more than once in them.

One thing is added to the paper.  A particle whose next step would lead into a static
occluder or out of the room decides as if it had reached its destination; the paper's
own objects do that (Sec. 6).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane.floor import Floor, on_floor, sample_floor

TOWARDS, CHANGE, WAIT = 0, 1, 2
"""Regimes: move towards the destination (MTD), change the destination and move (CD), wait (W)."""


class Particles(NamedTuple):
    """States of L particles."""

    xy: Floats  # (L, 2) positions
    destination: Floats  # (L, 2)
    speed: Floats  # (L,) per second
    regime: Ints  # (L,)


class WaypointModel(NamedTuple):
    """Parameters of the model; the probabilities are those of a reference step."""

    reference_s: float  # T, the reference step
    sigma: float  # noise per axis gathered in a second
    phi: float  # share of the last step in the speed, 0 to 1
    towards: float  # beta_1: of MTD
    change: float  # lambda_1: of CD; the rest waits
    towards_reached: float  # beta_2: of MTD once the destination is reached
    change_reached: float  # lambda_2: of CD once the destination is reached


@kernel
def reached(particles: Particles, motion: WaypointModel, floor: Floor) -> Bools:
    """(L,) bool: which particles decide as if they had reached their destination."""
    L = particles.speed.shape[0]
    out, ahead = np.empty(L, dtype=np.bool_), np.empty((L, 2))
    for i in range(L):
        x, y, reach = particles.xy[i, 0], particles.xy[i, 1], particles.speed[i] * motion.reference_s
        dx, dy = particles.destination[i, 0] - x, particles.destination[i, 1] - y
        distance = math.hypot(dx, dy)
        scale = reach / distance if distance > 0.0 else 0.0
        out[i] = distance < reach or distance == 0.0
        ahead[i, 0], ahead[i, 1] = x + scale * dx, y + scale * dy
    return out | ~on_floor(ahead, floor.room, floor.walls, floor.starts)


@kernel
def expected_xy(particles: Particles, arrived: Bools, dt: float, motion: WaypointModel) -> Floats:
    """(L, 2) kappa of [Ercan] Alg. 1: the expected position after the step, x + beta s e(tau) dt.

    A new destination is taken to lead nowhere on average; any kappa leaves the filter correct.

    Args:
        particles: L states.
        arrived: (L,) from `reached`.
        dt: length of the step [s], up to the reference step.
        motion: parameters.
    """
    n = min(1.0, dt / motion.reference_s)
    out = np.empty_like(particles.xy)
    for i in range(out.shape[0]):
        beta = motion.towards_reached if arrived[i] else motion.towards
        going = n * beta + (1.0 - n) * (0.0 if particles.regime[i] == WAIT else 1.0)
        dx = particles.destination[i, 0] - particles.xy[i, 0]
        dy = particles.destination[i, 1] - particles.xy[i, 1]
        distance = math.hypot(dx, dy)
        scale = going * particles.speed[i] * dt / distance if distance > 0.0 else 0.0
        out[i, 0] = particles.xy[i, 0] + scale * dx
        out[i, 1] = particles.xy[i, 1] + scale * dy
    return out


@kernel
def choose_regimes(particles: Particles, arrived: Bools, dt: float, motion: WaypointModel, u: Floats) -> Ints:
    """(L,) regimes of the particles in a step.

    Args:
        particles: L states.
        arrived: (L,) from `reached`.
        dt: length of the step [s], up to the reference step.
        motion: parameters.
        u: (L,) uniform in [0, 1).
    """
    regime = np.empty(u.shape[0], dtype=np.int64)
    n = min(1.0, dt / motion.reference_s)
    for i in range(u.shape[0]):
        change = n * (motion.change_reached if arrived[i] else motion.change)
        towards = n * (motion.towards_reached if arrived[i] else motion.towards)
        if u[i] < towards:
            regime[i] = TOWARDS
        elif u[i] < towards + change:
            regime[i] = CHANGE
        elif u[i] < n:
            regime[i] = WAIT
        else:  # no decision in this step
            regime[i] = WAIT if particles.regime[i] == WAIT else TOWARDS
    return regime


@kernel
def move(
    particles: Particles, regime: Ints, destinations: Floats, noise: Floats, dt: float, motion: WaypointModel
) -> Particles:
    """Particles after a step, Eq. 5.

    Args:
        particles: L states.
        regime: (L,) from `choose_regimes`.
        destinations: (K, 2) new destinations, K the number of particles that change theirs, in their order.
        noise: (L, 2) standard normal.
        dt: length of the step [s], up to the reference step.
        motion: parameters.
    """
    xy, destination = particles.xy.copy(), particles.destination.copy()
    speed = particles.speed.copy()
    spread, T = motion.sigma * math.sqrt(dt), motion.reference_s
    k = 0
    for i in range(speed.shape[0]):
        if regime[i] == WAIT:
            continue
        # CD: a new destination
        if regime[i] == CHANGE and k < destinations.shape[0]:
            destination[i, 0], destination[i, 1] = destinations[k, 0], destinations[k, 1]
            k += 1
        # MTD (Eq. 5): towards the destination, with noise
        ex, ey = destination[i, 0] - xy[i, 0], destination[i, 1] - xy[i, 1]
        distance = math.hypot(ex, ey)
        if distance > 0.0:
            ex, ey = ex / distance, ey / distance
        vx, vy, s = spread * noise[i, 0], spread * noise[i, 1], speed[i]
        xy[i, 0] += s * dt * ex + vx
        xy[i, 1] += s * dt * ey + vy
        # Speed: s' = (1 - phi) s + phi |step|
        speed[i] = (1.0 - motion.phi) * s + motion.phi * math.hypot(s * T * ex + vx, s * T * ey + vy) / T
    return Particles(xy, destination, speed, regime)


@kernel
def velocities(particles: Particles) -> Floats:
    """(L, 2) velocities: speed towards the destination; 0 for particles that wait."""
    out = np.zeros_like(particles.xy)
    for i in range(out.shape[0]):
        dx = particles.destination[i, 0] - particles.xy[i, 0]
        dy = particles.destination[i, 1] - particles.xy[i, 1]
        distance = math.hypot(dx, dy)
        if distance > 0.0 and particles.regime[i] != WAIT:
            out[i, 0] = particles.speed[i] * dx / distance
            out[i, 1] = particles.speed[i] * dy / distance
    return out


def start_particles(xy: Floats, floor: Floor, speed: float, speed_spread: float, rng: np.random.Generator) -> Particles:
    """Particles at (L, 2) places with random destinations and speeds |N(speed, speed_spread^2)|."""
    speeds = np.abs(speed + speed_spread * rng.standard_normal(len(xy)))
    return Particles(xy, sample_floor(len(xy), floor, rng), speeds, np.zeros(len(xy), dtype=np.int64))


def take(particles: Particles, rows: Ints) -> Particles:
    """The particles of the given rows."""
    xy, destination, speed, regime = particles
    return Particles(xy[rows], destination[rows], speed[rows], regime[rows])
