"""Backward simulation of trajectories through the particles of a filter that is over.

Forward filtering, backward simulation (Godsill, Doucet and West 2004): given a particle of the step after, the
particle before it is drawn with probability w_l p(u'|u_l).  In [Ercan]'s motion model destination and speed go over
exactly, so that p(u'|u_l) is 0 but for the particle's own parent and its siblings: the smoother would have no more
than the filter's ancestry.  The destination is therefore integrated out.  What of the state after counts is its
position, its velocity (speed towards the destination) and its regime:

    W    p_W   N(x'; x, sigma_w^2 dt)     N(c'; c, h^2)
         p_W   N(x'; x + c dt, p1)        N(c'; c + gain1 (x' - x - c dt), V1)     if it stood before
         p_W   N(x'; x, p2)               N(c'; gain2 (x' - x), V2)                if it has just stopped
    MTD  p_MTD N(x'; x + c dt, p0)        N(c'; c + gain (x' - x - c dt), V + h^2)
    CD   p_CD  N(x'; x + s dt c'/|c'|, p0) N(|c'|; s, V + h^2) / (2 pi |c'|)
         p_CD  int_0^1 N(x'; x + dt (u b + (1 - u) s c'/|c'|), p0) du  N(|c'|; s, V + gain^2 p0 + h^2) / (2 pi |c'|)

c being the velocity, s its amount, p0, gain and V of `gather`, those with 1 and 2 of `waiting_noise`
(`occlog.filtering.motion.waypoint`), and h a width of the kernel that represents the exact destination.  The first
line of W is the paper's, the others are of targets that stand (`mean_wait_s`); c is the velocity with which they
creep then, and the speed that they remember is integrated out.  The second line of CD is of changes at any time of
the step (`change_time`), b being the velocity until then: c, or 0 after the paper's wait.

No density of a position is narrower than the kernel of the cloud's positions, nor is that of the velocity of one that
stands narrower than the kernel of the velocities.  Where bearings are blunt the cloud is wide against the noise of a
step, so that next to no other particle could have led to a given one; trajectories then would share a few ancestors,
and their spread would be too small.

To compare with every particle would cost L for each trajectory.  Instead a trajectory chooses among K
particles that are drawn from the filter's weights, and its own parent: one step of iterated sampling importance
resampling (Andrieu, Doucet and Holenstein 2010), which leaves the smoothing distribution as it is.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.filtering.motion.waypoint import (
    CHANGE,
    MIN_STEP_VARIANCE,
    TOWARDS,
    WAIT,
    WaypointModel,
    gather,
    stands,
    waiting_noise,
)

X, Y, VX, VY, SPEED = range(5)
"""Columns of the states of `parents_of`: position, direction times speed, and speed."""
MIN_SEGMENT_SIGMAS = 1e-3
"""A shorter segment is a point, in standard deviations."""
ROOT_2, ROOT_HALF_PI = math.sqrt(2.0), math.sqrt(0.5 * math.pi)
TOO_FAR = 50.0
"""Half the squared distance beyond which a density counts as 0."""


@kernel
def density_on_segment(x: float, y: float, wx: float, wy: float, variance: float) -> float:
    """Return the mean of exp(-|x - u w|^2 / (2 variance)) over u from 0 to 1: a Gaussian smeared along a segment w.

    The value is at most 1, and 0 beyond `TOO_FAR`. Along w it is a difference of two normal distribution functions,
    across w a normal density.

    Args:
        x: first coordinate of the offset from the beginning of the segment.
        y: second coordinate of this offset.
        wx: first coordinate of the segment w.
        wy: second coordinate of the segment w.
        variance: variance of the Gaussian per axis.
    """
    length, sigma = math.hypot(wx, wy), math.sqrt(variance)
    if length < MIN_SEGMENT_SIGMAS * sigma:
        half = 0.5 * (x * x + y * y) / variance
        return math.exp(-half) if half < TOO_FAR else 0.0
    along, across = (x * wx + y * wy) / length, (x * wy - y * wx) / length
    beyond = max(-along, along - length, 0.0)
    if 0.5 * (across * across + beyond * beyond) > TOO_FAR * variance:
        return 0.0
    inside = math.erf((length - along) / (ROOT_2 * sigma)) + math.erf(along / (ROOT_2 * sigma))
    return math.exp(-0.5 * across * across / variance) * ROOT_HALF_PI * sigma / length * inside


@kernel
def parents_of(
    later: Floats,
    regime: Ints,
    own: Ints,
    states: Floats,
    was: Ints,
    chances: Floats,
    candidates: Ints,
    dt: float,
    motion: WaypointModel,
    width2: tuple[float, float],
    u: Floats,
) -> Ints:
    """Draw, for each of M particles of a step, the particle of the step before from which its trajectory comes.

    It is drawn among K candidates and the filter's own parent, with probabilities in proportion to the transition
    density (formulas in the module docstring); the own parent if all densities are 0.

    Args:
        later: (M, 5) states of a step: x, y, direction times speed (2), speed.
        regime: (M,) regimes (MTD, CD or W) of the states `later`.
        own: (M,) index of the filter's parent of each among the L particles of the step before.
        states: (L, 5) states of the step before, columns as `later`.
        was: (L,) regimes of `states`.
        chances: (L, 3) probabilities of MTD, CD and W of each in the step.
        candidates: (K,) indices among the L particles, drawn by their weights.
        dt: time between the steps [s], > 0.
        motion: parameters of the motion model.
        width2: squared kernel widths h^2 of position and velocity.
        u: (M,) uniform in [0, 1).

    Returns:
        (M,) indices among the L particles.
    """
    M, K = later.shape[0], candidates.shape[0]
    place2, velocity2 = width2
    moving, gain, left = gather(dt, motion)
    turned = max(left + gain * gain * moving + velocity2, MIN_STEP_VARIANCE)
    moving = max(moving, place2, MIN_STEP_VARIANCE)
    waiting = max(motion.sigma_waiting**2 * dt, place2, MIN_STEP_VARIANCE)
    standing, stopping = _standing(dt, motion, True, width2), _standing(dt, motion, False, width2)
    spread = max(left + velocity2, MIN_STEP_VARIANCE)
    steady = max(velocity2, MIN_STEP_VARIANCE)
    weights, out = np.empty(K + 1), np.empty(M, dtype=np.int64)
    for j in range(M):
        total, r = 0.0, regime[j]
        x, y, cx, cy, s = later[j, X], later[j, Y], later[j, VX], later[j, VY], later[j, SPEED]
        ex, ey = (cx / s, cy / s) if s > 0.0 else (0.0, 0.0)
        for k in range(K + 1):
            i = own[j] if k == K else candidates[k]
            weights[k] = 0.0
            dx, dy = x - states[i, X], y - states[i, Y]
            if stands(r, motion):
                variance, pull, rest, scale = standing if was[i] == WAIT else stopping
                bx, by = (states[i, VX], states[i, VY]) if was[i] == WAIT else (0.0, 0.0)
                dx, dy = dx - bx * dt, dy - by * dt
                fx, fy = cx - bx - pull * dx, cy - by - pull * dy
                half = 0.5 * (dx * dx + dy * dy) / variance + 0.5 * (fx * fx + fy * fy) / rest
                if half < TOO_FAR:
                    weights[k] = chances[i, WAIT] * scale * math.exp(-half)
            elif r == WAIT:
                half = 0.5 * (dx * dx + dy * dy) / waiting
                half += 0.5 * ((cx - states[i, VX]) ** 2 + (cy - states[i, VY]) ** 2) / steady
                if half < TOO_FAR:
                    weights[k] = chances[i, WAIT] * math.exp(-half)
            elif r == CHANGE and motion.uniform_change:
                bx, by = (states[i, VX], states[i, VY]) if was[i] != WAIT or stands(was[i], motion) else (0.0, 0.0)
                dx -= states[i, SPEED] * dt * ex
                dy -= states[i, SPEED] * dt * ey
                along = s - states[i, SPEED]
                half = 0.5 * along * along / turned
                if half < TOO_FAR:
                    wx, wy = (bx - states[i, SPEED] * ex) * dt, (by - states[i, SPEED] * ey) * dt
                    weights[k] = chances[i, CHANGE] * math.exp(-half) * density_on_segment(dx, dy, wx, wy, moving)
            elif r == CHANGE:
                dx -= states[i, SPEED] * dt * ex
                dy -= states[i, SPEED] * dt * ey
                along = s - states[i, SPEED] - gain * (dx * ex + dy * ey)
                half = 0.5 * (dx * dx + dy * dy) / moving + 0.5 * along * along / spread
                if half < TOO_FAR:
                    weights[k] = chances[i, CHANGE] * math.exp(-half)
            else:
                dx -= states[i, VX] * dt
                dy -= states[i, VY] * dt
                fx, fy = cx - states[i, VX] - gain * dx, cy - states[i, VY] - gain * dy
                half = 0.5 * (dx * dx + dy * dy) / moving + 0.5 * (fx * fx + fy * fy) / spread
                if half < TOO_FAR:
                    weights[k] = chances[i, TOWARDS] * math.exp(-half)
            total += weights[k]
        # A parent that the densities do not allow (its step was distinguished by what was integrated out) stays
        out[j] = own[j]
        if total > 0.0:
            point = u[j] * total
            for k in range(K + 1):
                point -= weights[k]
                if point < 0.0:
                    out[j] = own[j] if k == K else candidates[k]
                    break
    return out


@kernel
def _standing(
    dt: float, motion: WaypointModel, stood: bool, width2: tuple[float, float]
) -> tuple[float, float, float, float]:
    """Return the position variance, gain and remaining velocity variance of a waiting target, and a density factor.

    The first three are those of `waiting_noise` after a time `dt` [s], variances per axis and not below `width2`
    (squared kernel widths of position and velocity) or `MIN_STEP_VARIANCE`. The factor is 1 / (variance * remaining
    variance), that of the densities of both axes. `stood`: the target was already waiting before the step.
    """
    variance, gain, left = waiting_noise(dt, motion, stood)
    variance, left = max(variance, width2[0], MIN_STEP_VARIANCE), max(left, width2[1], MIN_STEP_VARIANCE)
    return variance, gain, left, 1.0 / (variance * left)
