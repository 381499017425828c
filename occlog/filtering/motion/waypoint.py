"""Random waypoints: how a particle moves, [Ercan] Sec. 4.1, for steps of any length.

A particle has a position x, a destination tau, a speed s and a regime: it moves towards
its destination (MTD, Eq. 5), changes its destination and moves (CD), or waits (W).
The paper's step has length 1; here it lasts T, the reference step, and lengths and
speeds are per second:

* noise: variance sigma^2 dt per axis, so that sigma is the standard deviation after a second;
* regimes: resampled with probability n = dt / T, else the last one goes on (after CD:
  MTD).  A particle so decides once a reference step on average, waits for a reference
  step on average, and changes its destination lambda times a reference step;
* speed: s' = (1 - phi) s + phi |s T e + v| / T with e the direction and v the noise of
  this step.  The noise of the speed is then phi v along e / T, and its variance grows with
  dt as it should; the paper's |x' - x| / dt would diverge for short steps;
* a destination is reached when it is less than s T away.

With dt = T all of it is the paper's.  Longer steps must be split by the caller, since a
particle can change its mind more than once in them.

One thing is added to the paper.  A particle that would step next into a static
occluder or out of the room decides as if it had reached its destination; the paper's
own objects do that (Sec. 6).  Noise is added that the paper has not, all of it 0 in its model:

* of the velocity (`sigma_velocity`): white acceleration, by which speed and direction change.  People turn and hurry
  more than they jump aside, so that their positions need little additional noise;
* of the position while waiting (`sigma_waiting`): who stands is never quite still, and particles that never
  move become copies of one position.

The paper's targets wait for a reference step on average.  With `mean_wait_s` above 0 they *stand*: for `mean_wait_s` on
average, then they go on to a new destination with the speed that they had.  One that stands creeps with a
velocity of its own, which begins as N(0, sigma_creep^2 s I) and has the noise `sigma_creep`; its destination is the
position where it would creep in `WAITING_DESTINATION_S`.  The position of one that creeps is smooth, so that a filter
averages over longer the longer the target stands.

The paper's targets change their destination at the beginning of a step.  People turn at any time: given one change in
a step, its time is uniform in it, as that of an event of a Poisson process (Cox and Miller 1965, Sec. 4.1).  With u
the share of the step before the change the expected position is

    x + dt (u c + (1 - u) s e(tau')),    c the velocity before, s the speed, e(tau') towards the new destination.

Without it a turn within a step of 0.2 s at 3 m/s is up to half a metre from the position that the model expects.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.core.plane import Floor, on_floor, sample_floor

TOWARDS, CHANGE, WAIT = 0, 1, 2
"""Regimes: move towards the destination (MTD), change the destination and move (CD), wait (W)."""

WAITING_DESTINATION_S = 10.0
"""The destination of one that stands is where it creeps in this time [s]."""

MIN_STEP_VARIANCE = 1e-18
"""Least variance of a step, so that densities stay finite where the motion has no noise."""


class WaypointParticles(NamedTuple):
    """States of L particles of the waypoint model: positions, destinations, speeds [length/s] and regimes.

    A regime is `TOWARDS`, `CHANGE` or `WAIT`. The destination of a particle that stands is where it creeps in 10 s.
    """

    xy: Floats  # (L, 2) positions
    destination: Floats  # (L, 2)
    speed: Floats  # (L,) per second
    regime: Ints  # (L,)


class WaypointModel(NamedTuple):
    """Parameters of the waypoint model ([Ercan] Sec. 4.1); probabilities are those of one reference step."""

    reference_s: float  # T, the reference step
    sigma: float  # noise per axis accumulated over 1 s
    phi: float  # share of the last step in the speed, 0 to 1
    towards: float  # beta_1: of MTD
    change: float  # lambda_1: of CD; the rest waits
    towards_reached: float  # beta_2: of MTD once the destination is reached
    change_reached: float  # lambda_2: of CD once the destination is reached
    sigma_velocity: float = 0.0  # noise of the velocity per axis accumulated over 1 s
    sigma_waiting: float = 0.0  # noise per axis accumulated over 1 s by one that waits
    wait_s: float = 0.0  # how long one that stands waits on average; 0: waiting is the paper's
    sigma_creep: float = 0.0  # noise of the velocity per axis accumulated over 1 s by one that stands
    uniform_change: bool = False  # destinations change at a time uniform in the step; False: at its beginning


@kernel
def reached(particles: WaypointParticles, motion: WaypointModel, floor: Floor) -> Bools:
    """Return (L,) booleans: the particle decides as if it had reached its destination.

    Its destination is nearer than one reference step at its speed, or such a step towards it would leave the floor.
    """
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
def expected_xy(particles: WaypointParticles, arrived: Bools, dt: float, motion: WaypointModel) -> Floats:
    """Return (L, 2) expected positions after a step, x + beta s e(tau) dt (kappa of [Ercan] Alg. 1).

    A new destination is in no direction on average; the filter is correct for any kappa.

    Args:
        particles: L states.
        arrived: (L,) whether a particle has reached its destination, from `reached`.
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
def choose_regimes(particles: WaypointParticles, arrived: Bools, dt: float, motion: WaypointModel, u: Floats) -> Ints:
    """Draw the regimes (L,) of the particles in a step: `TOWARDS`, `CHANGE` or `WAIT`.

    Args:
        particles: L states.
        arrived: (L,) whether a particle has reached its destination, from `reached`.
        dt: length of the step [s], up to the reference step.
        motion: parameters.
        u: (L,) uniform in [0, 1).
    """
    regime = np.empty(u.shape[0], dtype=np.int64)
    n = min(1.0, dt / motion.reference_s)
    for i in range(u.shape[0]):
        if stands(particles.regime[i], motion):
            regime[i] = CHANGE if u[i] < dt / motion.wait_s else WAIT
            continue
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
def gather(dt: float, motion: WaypointModel) -> tuple[float, float, float]:
    """Return the process noise of a moving particle in a step: position variance, velocity gain, conditional variance.

    Given the position x', the velocity is c + gain (x' - x - c dt) plus noise of the conditional variance, with c the
    velocity before; variances are per axis. Without velocity noise the gain [1/s] is that of the speed in [Ercan] Eq.
    5.

    Args:
        dt: length of the step [s].
        motion: parameters.
    """
    q = motion.sigma_velocity * motion.sigma_velocity
    variance = motion.sigma * motion.sigma * dt + q * dt**3 / 3.0
    if q * dt == 0.0:
        return variance, motion.phi / motion.reference_s, 0.0
    gain = 0.5 * q * dt * dt / variance
    return variance, gain, max(q * dt - gain * gain * variance, 0.0)


@kernel
def stands(regime: int, motion: WaypointModel) -> bool:
    """Return whether a particle of the regime stands, that is, creeps with a velocity of its own (`wait_s` above 0)."""
    return regime == WAIT and motion.wait_s > 0.0


@kernel
def waiting_noise(dt: float, motion: WaypointModel, stood: bool) -> tuple[float, float, float]:
    """Return the process noise of a waiting particle in a step: position variance, velocity gain, conditional variance.

    Given the position x', the velocity is c + gain (x' - x - c dt) plus noise of the conditional variance, with c the
    velocity before. A particle that has just stopped creeps with a velocity of N(0, sigma_creep^2 s) per axis; the
    velocity of one that stood in the step before, too, has white noise.

    Args:
        dt: length of the step [s].
        motion: parameters.
        stood: the particle stood in the step before, too.
    """
    q = motion.sigma_creep * motion.sigma_creep
    variance = motion.sigma_waiting * motion.sigma_waiting * dt + (q * dt**3 / 3.0 if stood else q * dt * dt)
    if q * dt == 0.0:
        return variance, 0.0, 0.0
    gain = (0.5 * q * dt * dt if stood else q * dt) / variance
    return variance, gain, max((q * dt if stood else q) - gain * gain * variance, 0.0)


@kernel
def regime_probabilities(regime: Ints, arrived: Bools, dt: float, motion: WaypointModel) -> Floats:
    """Return (L, 3) probabilities of the regimes `TOWARDS`, `CHANGE` and `WAIT` in a step.

    Args:
        regime: (L,) regimes of the step before.
        arrived: (L,) whether a particle has reached its destination, from `reached`.
        dt: length of the step [s], up to the reference step.
        motion: parameters.
    """
    out = np.empty((arrived.shape[0], 3))
    n = min(1.0, dt / motion.reference_s)
    for i in range(arrived.shape[0]):
        if stands(regime[i], motion):
            out[i, CHANGE], out[i, TOWARDS] = min(1.0, dt / motion.wait_s), 0.0
            out[i, WAIT] = 1.0 - out[i, CHANGE]
            continue
        out[i, CHANGE] = n * (motion.change_reached if arrived[i] else motion.change)
        out[i, TOWARDS] = n * (motion.towards_reached if arrived[i] else motion.towards)
        out[i, WAIT] = max(n - out[i, CHANGE] - out[i, TOWARDS], 0.0)
        out[i, WAIT if regime[i] == WAIT else TOWARDS] += 1.0 - n
    return out


@kernel
def held_step(
    particles: WaypointParticles, i: int, share: float, dt: float, motion: WaypointModel
) -> tuple[float, float]:
    """Return the displacement (dx, dy) of a particle in the part of a step before it changes its destination.

    It is (0, 0) for a particle that waits without creeping.

    Args:
        particles: states.
        i: index of the particle.
        share: part of the step before the change, 0 to 1.
        dt: length of the step [s].
        motion: parameters of the model.
    """
    dx = particles.destination[i, 0] - particles.xy[i, 0]
    dy = particles.destination[i, 1] - particles.xy[i, 1]
    scale = 0.0
    if stands(particles.regime[i], motion):
        scale = share * dt / WAITING_DESTINATION_S
    elif particles.regime[i] != WAIT:
        distance = math.hypot(dx, dy)
        scale = share * particles.speed[i] * dt / distance if distance > 0.0 else 0.0
    return scale * dx, scale * dy


@kernel
def hypotheses(
    particles: WaypointParticles,
    arrived: Bools,
    destinations: Floats,
    before: Floats,
    dt: float,
    motion: WaypointModel,
) -> tuple[Floats, Floats, Floats]:
    """Return the hypotheses of each particle in a step: continue (MTD), change its destination (CD), wait (W).

    Args:
        particles: L states.
        arrived: (L,) whether a particle has reached its destination, from `reached`.
        destinations: (L, 2) the destination of each if it changes it.
        before: (L,) part of the step before the change, 0 to 1.
        dt: length of the step [s], up to the reference step.
        motion: parameters.

    Returns:
        (3, L) probabilities, in the order of the regimes' numbers.
        (3, L, 2) expected positions.
        (3, L) variances of the positions per axis, above 0.
    """
    L = particles.speed.shape[0]
    prior, mean, variance = np.empty((3, L)), np.empty((3, L, 2)), np.empty((3, L))
    moving, _, _ = gather(dt, motion)
    stopping, _, _ = waiting_noise(dt, motion, False)
    standing, _, _ = waiting_noise(dt, motion, True)
    moving, stopping = max(moving, MIN_STEP_VARIANCE), max(stopping, MIN_STEP_VARIANCE)
    standing = max(standing, MIN_STEP_VARIANCE)
    share = regime_probabilities(particles.regime, arrived, dt, motion)
    for i in range(L):
        x, y, step = particles.xy[i, 0], particles.xy[i, 1], particles.speed[i] * dt
        for r in (TOWARDS, CHANGE):
            ex = (particles.destination[i, 0] if r == TOWARDS else destinations[i, 0]) - x
            ey = (particles.destination[i, 1] if r == TOWARDS else destinations[i, 1]) - y
            distance = math.hypot(ex, ey)
            scale = step / distance if distance > 0.0 else 0.0
            hx = hy = 0.0
            if r == CHANGE:
                hx, hy = held_step(particles, i, before[i], dt, motion)
                scale *= 1.0 - before[i]
            prior[r, i], variance[r, i] = share[i, r], moving
            mean[r, i, 0], mean[r, i, 1] = x + hx + scale * ex, y + hy + scale * ey
        stood = stands(particles.regime[i], motion)
        prior[WAIT, i], variance[WAIT, i] = share[i, WAIT], standing if stood else stopping
        scale = dt / WAITING_DESTINATION_S if stood else 0.0
        mean[WAIT, i, 0] = x + scale * (particles.destination[i, 0] - x)
        mean[WAIT, i, 1] = y + scale * (particles.destination[i, 1] - y)
    return prior, mean, variance


@kernel
def move(
    particles: WaypointParticles,
    regime: Ints,
    destinations: Floats,
    before: Floats,
    noise: Floats,
    dt: float,
    motion: WaypointModel,
) -> WaypointParticles:
    """Return the particles after a step drawn from the motion model, [Ercan] Eq. 5.

    Args:
        particles: L states before the step.
        regime: (L,) regime of each in the step, from `choose_regimes`.
        destinations: (K, 2) new destinations of the K particles that change theirs, in their order.
        before: (K,) part of the step before the change, 0 to 1.
        noise: (L, 4) standard normal: of the position (2), and of the velocity given the position (2).
        dt: length of the step [s], up to the reference step.
        motion: parameters.
    """
    L = regime.shape[0]
    mean, xy, own = np.empty((L, 2)), np.empty((L, 2)), np.zeros((L, 2))
    variance, _, _ = gather(dt, motion)
    stopping, _, _ = waiting_noise(dt, motion, False)
    standing, _, _ = waiting_noise(dt, motion, True)
    moving, stopping, standing = math.sqrt(variance), math.sqrt(stopping), math.sqrt(standing)
    k = 0
    for i in range(L):
        spread, step = moving, particles.speed[i] * dt
        hx = hy = 0.0
        ex, ey = particles.destination[i, 0], particles.destination[i, 1]
        if regime[i] == WAIT and stands(particles.regime[i], motion):
            spread, step = (
                standing,
                math.hypot(ex - particles.xy[i, 0], ey - particles.xy[i, 1]) * dt / WAITING_DESTINATION_S,
            )
        elif regime[i] == WAIT:
            spread, step = stopping, 0.0
        elif regime[i] == CHANGE and k < destinations.shape[0]:
            own[i, 0], own[i, 1] = destinations[k, 0], destinations[k, 1]
            ex, ey = own[i, 0], own[i, 1]
            hx, hy = held_step(particles, i, before[k], dt, motion)
            step *= 1.0 - before[k]
            k += 1
        ex, ey = ex - particles.xy[i, 0], ey - particles.xy[i, 1]
        distance = math.hypot(ex, ey)
        scale = step / distance if distance > 0.0 else 0.0
        mean[i, 0], mean[i, 1] = particles.xy[i, 0] + hx + scale * ex, particles.xy[i, 1] + hy + scale * ey
        xy[i, 0], xy[i, 1] = mean[i, 0] + spread * noise[i, 0], mean[i, 1] + spread * noise[i, 1]
    return arrive(particles, regime, own, mean, xy, noise[:, 2:], dt, motion)


@kernel
def arrive(
    particles: WaypointParticles,
    regime: Ints,
    destinations: Floats,
    mean: Floats,
    xy: Floats,
    noise: Floats,
    dt: float,
    motion: WaypointModel,
) -> WaypointParticles:
    """Return particles with destinations and speeds updated, after they have moved to given positions in a step.

    Args:
        particles: L states before the step.
        regime: (L,) regime of each in the step.
        destinations: (L, 2) new destinations of those that change theirs; other rows are not used.
        mean: (L, 2) expected positions after the step.
        xy: (L, 2) positions after the step.
        noise: (L, 2) standard normal, of the velocity given the position.
        dt: length of the step [s], up to the reference step.
        motion: parameters.
    """
    destination, speed, T = particles.destination.copy(), particles.speed.copy(), motion.reference_s
    _, gain, left = gather(dt, motion)
    spread = math.sqrt(left)
    for i in range(speed.shape[0]):
        if regime[i] == WAIT:
            # W: the velocity with which one that stands creeps, given the position
            if stands(WAIT, motion):
                stood = particles.regime[i] == WAIT
                _, pull, rest = waiting_noise(dt, motion, stood)
                before, rest = 1.0 / WAITING_DESTINATION_S if stood else 0.0, math.sqrt(rest)
                for k in range(2):
                    c = before * (destination[i, k] - particles.xy[i, k]) + pull * (xy[i, k] - mean[i, k])
                    destination[i, k] = xy[i, k] + WAITING_DESTINATION_S * (c + rest * noise[i, k])
            continue
        # CD: a new destination
        if regime[i] == CHANGE:
            destination[i, 0], destination[i, 1] = destinations[i, 0], destinations[i, 1]
        ex, ey = destination[i, 0] - particles.xy[i, 0], destination[i, 1] - particles.xy[i, 1]
        distance = math.hypot(ex, ey)
        if distance > 0.0:
            ex, ey = ex / distance, ey / distance
        s, vx, vy = speed[i], xy[i, 0] - mean[i, 0], xy[i, 1] - mean[i, 1]
        # Speed: s' = (1 - phi) s + phi |step|
        speed[i] = (1.0 - motion.phi) * s + motion.phi * math.hypot(s * T * ex + vx, s * T * ey + vy) / T
        # White acceleration: the velocity given the position; the destination turns with it about the particle
        if motion.sigma_velocity > 0.0 and distance > 0.0:
            cx = speed[i] * ex + gain * vx + spread * noise[i, 0]
            cy = speed[i] * ey + gain * vy + spread * noise[i, 1]
            speed[i] = math.hypot(cx, cy)
            if speed[i] > 0.0:
                far = math.hypot(destination[i, 0] - xy[i, 0], destination[i, 1] - xy[i, 1]) / speed[i]
                destination[i, 0], destination[i, 1] = xy[i, 0] + far * cx, xy[i, 1] + far * cy
    return WaypointParticles(xy, destination, speed, regime)


@kernel
def headings(particles: WaypointParticles, motion: WaypointModel) -> Floats:
    """Return (L, 5) position x and y, velocity towards the destination x and y, and speed of the particles.

    Waiting particles have the velocity with which they would go on; for a standing particle it is its creeping
    velocity.
    """
    out = np.zeros((particles.speed.shape[0], 5))
    for i in range(out.shape[0]):
        dx = particles.destination[i, 0] - particles.xy[i, 0]
        dy = particles.destination[i, 1] - particles.xy[i, 1]
        distance = math.hypot(dx, dy)
        out[i, 0], out[i, 1], out[i, 4] = particles.xy[i, 0], particles.xy[i, 1], particles.speed[i]
        if stands(particles.regime[i], motion):
            out[i, 2], out[i, 3] = dx / WAITING_DESTINATION_S, dy / WAITING_DESTINATION_S
        elif distance > 0.0:
            out[i, 2], out[i, 3] = particles.speed[i] * dx / distance, particles.speed[i] * dy / distance
    return out


@kernel
def velocities(particles: WaypointParticles) -> Floats:
    """Return (L, 2) velocities of the particles towards their destinations; 0 for waiting particles."""
    out = np.zeros_like(particles.xy)
    for i in range(out.shape[0]):
        dx = particles.destination[i, 0] - particles.xy[i, 0]
        dy = particles.destination[i, 1] - particles.xy[i, 1]
        distance = math.hypot(dx, dy)
        if distance > 0.0 and particles.regime[i] != WAIT:
            out[i, 0] = particles.speed[i] * dx / distance
            out[i, 1] = particles.speed[i] * dy / distance
    return out


def start_particles(
    xy: Floats, floor: Floor, speed: float, speed_spread: float, rng: np.random.Generator
) -> WaypointParticles:
    """Return particles at given positions with random destinations and speeds, all in the regime `TOWARDS`.

    Args:
        xy: (L, 2) positions.
        floor: floor over which destinations are uniformly distributed.
        speed: mean of a normal distribution; speeds are absolute values of draws from it [length/s].
        speed_spread: standard deviation of the speed [length/s].
        rng: generator of the random numbers drawn.
    """
    speeds = np.abs(speed + speed_spread * rng.standard_normal(len(xy)))
    return WaypointParticles(xy, sample_floor(len(xy), floor, rng), speeds, np.zeros(len(xy), dtype=np.int64))


def select(particles: WaypointParticles, rows: Ints) -> WaypointParticles:
    """Return the particles at the given row indices."""
    xy, destination, speed, regime = particles
    return WaypointParticles(xy[rows], destination[rows], speed[rows], regime[rows])
