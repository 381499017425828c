"""Particles of ellipses, [Qu] Sec. 3: their motion, weights, means and resampling.

Arrays hold n trackers of N particles each; an ellipse is (cx, cy, a, b, rho) as in
`occlog.core.image`, the state of [Qu] Sec. 3.1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.filtering.particles import systematic_ancestors

SHORTEST = 0.5
"""Least half axis [px]."""


class EllipseMotion(NamedTuple):
    """Motion model of an ellipse from frame to frame, p(x_t | x_t-1) of [Qu] Eq. 1.

    The centre moves with a given velocity and Gaussian noise; half axes and angle are first-order autoregressive about
    their values at the start of the track. [Qu] leaves the dynamics open; these forms are the project's.
    """

    sigma: float  # of the centre, each axis [px]
    keep: float  # share of the difference from the first half axes that stays
    sigma_axes: float  # of the half axes [px]
    limit: float  # largest change of a half axis, as a share of the first one
    sigma_rho: float  # of the angle [rad]
    keep_rho: float = 1.0  # autoregressive coefficient of the deviation from the initial orientation


@kernel
def moved(
    particles: Floats, velocity: Floats, axes: Floats, gap: Floats, normals: Floats, motion: EllipseMotion
) -> Floats:
    """Return particles (n, N, 5) drawn from the motion model for the next frame of their view.

    The centre moves by the tracker's velocity and Gaussian noise. The half axes and the angle return towards those at
    the start and stay near them. The variances grow with the gap.

    Args:
        particles: (n, N, 5) ellipses, N particles of each tracker: centre, half axes [px], angle [rad].
        velocity: (n, 2) velocities of the centres [px a frame].
        axes: (n, 3) half axes [px] and angle [rad] at the start.
        gap: (n,) frames since the last one, >= 1.
        normals: (n, N, 5) standard normal numbers.
        motion: parameters of the model.
    """
    out = np.empty_like(particles)
    for i in range(particles.shape[0]):
        root = math.sqrt(gap[i])
        keep = motion.keep ** gap[i]
        for p in range(particles.shape[1]):
            x, z = particles[i, p], normals[i, p]
            for c in range(2):
                out[i, p, c] = x[c] + gap[i] * velocity[i, c] + root * motion.sigma * z[c]
                first = axes[i, c]
                half = first + keep * (x[2 + c] - first) + root * motion.sigma_axes * z[2 + c]
                half = min(max(half, (1.0 - motion.limit) * first), (1.0 + motion.limit) * first)
                out[i, p, 2 + c] = max(half, SHORTEST)
            turn = motion.keep_rho ** gap[i] * turned(x[4] - axes[i, 2])
            out[i, p, 4] = turned(axes[i, 2] + turn + root * motion.sigma_rho * z[4])
    return out


@kernel
def turned(rho: float) -> float:
    """Return the direction of an axis [rad] wrapped to [-pi/2, pi/2)."""
    out = (rho + 0.5 * math.pi) % math.pi - 0.5 * math.pi  # may round up to pi/2
    return out if out < 0.5 * math.pi else -0.5 * math.pi


@kernel
def normalise_into(weights: Floats, log_weights: Floats) -> None:
    """Set `weights` (N,) in place to exp(log_weights), scaled to sum 1.

    All weights are equal where the largest log weight is not finite.
    """
    top = -np.inf
    for p in range(log_weights.shape[0]):
        top = max(top, log_weights[p])
    if not math.isfinite(top):
        weights[:] = 1.0 / weights.shape[0]
        return
    total = 0.0
    for p in range(log_weights.shape[0]):
        weights[p] = math.exp(log_weights[p] - top)
        total += weights[p]
    for p in range(log_weights.shape[0]):
        weights[p] /= total


@kernel
def mean_into(out: Floats, particles: Floats, weights: Floats) -> None:
    """Set `out` (5,) in place to the weighted mean ellipse of `particles` (N, 5), with `weights` (N,) of sum 1.

    The mean angle is half the mean direction of the doubled angles, in [-pi/2, pi/2).
    """
    cx, cy, a, b, c, s = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for p in range(particles.shape[0]):
        w, x = weights[p], particles[p]
        cx += w * x[0]
        cy += w * x[1]
        a += w * x[2]
        b += w * x[3]
        c += w * math.cos(2.0 * x[4])
        s += w * math.sin(2.0 * x[4])
    out[0], out[1], out[2], out[3], out[4] = cx, cy, a, b, turned(0.5 * math.atan2(s, c))


@kernel
def weights_and_means(particles: Floats, log_weights: Floats) -> tuple[Floats, Floats]:
    """Return weights (n, N) of sum 1 from log weights, and weighted mean ellipses (n, 5).

    Args:
        particles: (n, N, 5) ellipses of n trackers: centre, half axes [px], angle [rad].
        log_weights: (n, N) unnormalised.
    """
    weights, mean = np.empty(log_weights.shape), np.empty((particles.shape[0], 5))
    for i in range(particles.shape[0]):
        normalise_into(weights[i], log_weights[i])
        mean_into(mean[i], particles[i], weights[i])
    return weights, mean


@kernel
def covariance_and_ess(particles: Floats, weights: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Return covariances (n, 3) of the centres about `mean`, as (xx, xy, yy) [px^2], and effective sample sizes (n,).

    Args:
        particles: (n, N, 5) ellipses of n trackers; only their centres count.
        weights: (n, N) with sums of 1.
        mean: (n, 5) ellipses; only their centres count.
    """
    n = particles.shape[0]
    out, ess = np.zeros((n, 3)), np.empty(n)
    for i in range(n):
        squares = 0.0
        for p in range(particles.shape[1]):
            w = weights[i, p]
            dx, dy = particles[i, p, 0] - mean[i, 0], particles[i, p, 1] - mean[i, 1]
            out[i, 0] += w * dx * dx
            out[i, 1] += w * dx * dy
            out[i, 2] += w * dy * dy
            squares += w * w
        ess[i] = 1.0 / squares
    return out, ess


@kernel
def resampled(particles: Floats, weights: Floats, u: Floats) -> Floats:
    """Draw (n, N, 5) particles of equal weight by systematic resampling, for each tracker by itself.

    `particles` are (n, N, 5), `weights` (n, N) with sums of 1, `u` (n,) uniform in [0, 1).
    """
    out = np.empty_like(particles)
    for i in range(particles.shape[0]):
        ancestors = systematic_ancestors(weights[i], particles.shape[1], u[i])
        for p in range(particles.shape[1]):
            for c in range(5):
                out[i, p, c] = particles[i, ancestors[p], c]
    return out


@kernel
def boxes_of(particles: Floats) -> Ints:
    """Return (n, 4) boxes left, top, right, bottom (whole pixels, half-open) that hold all N ellipses of each tracker.

    `particles` (n, N, 5) are the ellipses. Boxes are generous: the largest half axis is added on all sides.
    """
    out = np.empty((particles.shape[0], 4), dtype=np.int64)
    for i in range(particles.shape[0]):
        left, top, right, bottom, reach = np.inf, np.inf, -np.inf, -np.inf, 0.0
        for p in range(particles.shape[1]):
            x = particles[i, p]
            left, right = min(left, x[0]), max(right, x[0])
            top, bottom = min(top, x[1]), max(bottom, x[1])
            reach = max(reach, x[2], x[3])
        out[i, 0], out[i, 1] = math.floor(left - reach), math.floor(top - reach)
        out[i, 2], out[i, 3] = math.ceil(right + reach) + 1, math.ceil(bottom + reach) + 1
    return out
