"""Adapted importance density: a Laplace approximation of each particle's posterior, in space.

A particle that moves in a given way is, before the scan, at N(p; m0, C), C = R R^T being the same for all.  The
density to draw it from is, with y = R^-1 (p - m0),

    q(y) = (1 - e) N(y; m, P) + e N(y; 0, I),

m the mode of N(y; 0, I) times the densities of the sights that are accepted, P the inverse of its
information there (Gauss-Newton), e a defensive share.  For linear sensors without false reports this is the
optimal importance density (Doucet, Godsill and Andrieu 2000), and the predictive likelihood is exact.

A sight counts by the tangents of the angles to its left and above, (left . d) / (along . d) and
(above . d) / (along . d), d being the way from the sensor: on the line of sight itself both are 0
at any distance, so that the iteration hardly bends.  Which sights are accepted is found along with the mode: the
variance of each residual begins with what the motion leaves open, and that part falls in steps (`ANNEALING_FACTOR`); a
sight counts by the probability that it is the target's and not a false report or another object's.

The angles of one plane count as azimuths in a space with a third axis that nothing depends on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

ANNEALING_FACTOR, MAX_STEPS = 1e-2, 8
"""Factor per Gauss-Newton step on the prediction's share of the residual variance."""
MAX_MOTION_SHARE, MAX_STEP_CHI2 = 1e-2, 1e-2
"""The search ends when that share is below `MAX_MOTION_SHARE` of the noise and the squared step below `MAX_STEP_CHI2`
variances."""
MIN_INLIER_PROBABILITY, NEGLIGIBLE_PROBABILITY = 0.5, 1e-6
MIN_CLUTTER_DENSITY = 1e-30
"""Floor of the clutter density, for a sensor without false alarms."""
MIN_DEPTH_RATIO = 0.05
"""A position that is not ahead of a sensor by so much of its distance is not found by this sight."""


class ScanRows(NamedTuple):
    """R directions of N sensors as residuals of the importance density, each with a frame of three unit vectors.

    A direction's residuals are the tangents of the angles to its left and above. A sensor's likelihood factor is the
    sum of `scale` times density over its rows, plus `rival`, the part that is not of the target.
    """

    first: Ints  # (N + 1,) rows of each sensor
    position: Floats  # (R, 3)
    along: Floats  # (R, 3) unit vectors, as the next two
    left: Floats  # (R, 3)
    above: Floats  # (R, 3)
    variance: Floats  # (R, 2) of the tangents to the left and above; the second is inf for an azimuth alone
    scale: Floats  # (R,)
    rival: Floats  # (R,) what is not the target, > 0


@kernel
def adapt(mean: Floats, root: Floats, lines: ScanRows) -> tuple[Floats, Floats, Floats]:
    """Return Laplace approximations of the posteriors of n particles, each with the prior N(m0, R R^T).

    They are in whitened positions y = R^-1 (p - m0).

    Modes are found by at most `MAX_STEPS` Gauss-Newton steps, in which each direction counts by the probability that it
    is the target's; in the last step those above one half count fully.

    Args:
        mean: (3, n) m0, expected positions.
        root: (3, 3) lower triangular R, with a diagonal above 0.
        lines: directions of the scan as residuals.

    Returns:
        (3, n) modes m of y.
        (6, n) lower Cholesky factors L of the precisions P^-1 = L L^T: 11, 21, 22, 31, 32, 33.
        (n,) logarithms of N(m; 0, I) (2 pi)^(3/2) sqrt(det P), the part of the motion in the predictive likelihood.
    """
    n, frames, count = mean.shape[1], lines.first.shape[0] - 1, lines.scale.shape[0]
    modes, factors, volume = np.zeros((3, n)), np.zeros((6, n)), np.zeros(n)
    turned = np.empty((count, 3, 3))  # along, left and above in the coordinates y
    base, density = np.empty((count, 3)), np.empty(count)
    sight, slopes = np.empty((count, 2)), np.empty((count, 2, 3))  # both tangents, and their slopes by y
    for r in range(count):
        for k in range(3):
            turned[r, 0, k] = turned[r, 1, k] = turned[r, 2, k] = 0.0
            for j in range(3):
                turned[r, 0, k] += root[j, k] * lines.along[r, j]
                turned[r, 1, k] += root[j, k] * lines.left[r, j]
                turned[r, 2, k] += root[j, k] * lines.above[r, j]
    for p in range(n):
        for r in range(count):
            base[r, 0] = base[r, 1] = base[r, 2] = 0.0
            for j in range(3):
                d = mean[j, p] - lines.position[r, j]
                base[r, 0] += lines.along[r, j] * d
                base[r, 1] += lines.left[r, j] * d
                base[r, 2] += lines.above[r, j] * d
        y0, y1, y2, share, last = 0.0, 0.0, 0.0, 1.0, False
        l11 = l22 = l33 = 1.0
        l21 = l31 = l32 = 0.0
        for step in range(MAX_STEPS):
            last = last or step == MAX_STEPS - 1
            open_still = False
            a11 = a22 = a33 = 1.0
            a21 = a31 = a32 = 0.0
            b0, b1, b2 = -y0, -y1, -y2
            for k in range(frames):
                total = 0.0
                for r in range(lines.first[k], lines.first[k + 1]):
                    # Expect: the probability that the sight is the target's
                    t = turned[r]
                    u = base[r, 0] + t[0, 0] * y0 + t[0, 1] * y1 + t[0, 2] * y2
                    v = base[r, 1] + t[1, 0] * y0 + t[1, 1] * y1 + t[1, 2] * y2
                    w = base[r, 2] + t[2, 0] * y0 + t[2, 1] * y1 + t[2, 2] * y2
                    density[r] = 0.0
                    if not (u > 0.0 and u * u > MIN_DEPTH_RATIO * MIN_DEPTH_RATIO * (u * u + v * v + w * w)):
                        continue
                    one, two = v / u, w / u
                    g, h, sight[r, 0], sight[r, 1] = slopes[r, 0], slopes[r, 1], one, two
                    for j in range(3):
                        g[j], h[j] = (t[1, j] - one * t[0, j]) / u, (t[2, j] - two * t[0, j]) / u
                    wide = share * (g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
                    open_still = open_still or wide > MAX_MOTION_SHARE * lines.variance[r, 0]
                    wide += lines.variance[r, 0]
                    exponent, spread = one * one / wide, wide
                    if lines.variance[r, 1] < math.inf:
                        wide = share * (h[0] * h[0] + h[1] * h[1] + h[2] * h[2])
                        open_still = open_still or wide > MAX_MOTION_SHARE * lines.variance[r, 1]
                        wide += lines.variance[r, 1]
                        exponent, spread = exponent + two * two / wide, spread * wide * 2.0 * math.pi
                    density[r] = lines.scale[r] * math.exp(-0.5 * exponent) / math.sqrt(2.0 * math.pi * spread)
                    total += density[r]
                for r in range(lines.first[k], lines.first[k + 1]):
                    # Maximise: Gauss-Newton with the sights that are accepted
                    e = density[r] / (total + lines.rival[r])
                    if last:
                        e = 1.0 if e > MIN_INLIER_PROBABILITY else 0.0
                    if e > NEGLIGIBLE_PROBABILITY:
                        for c in range(2):
                            f = e / lines.variance[r, c]  # 0 for what is not measured
                            x, g0, g1, g2 = sight[r, c], slopes[r, c, 0], slopes[r, c, 1], slopes[r, c, 2]
                            a11 += f * g0 * g0
                            a21 += f * g1 * g0
                            a22 += f * g1 * g1
                            a31 += f * g2 * g0
                            a32 += f * g2 * g1
                            a33 += f * g2 * g2
                            b0 -= f * x * g0
                            b1 -= f * x * g1
                            b2 -= f * x * g2
            l11 = math.sqrt(a11)
            l21, l31 = a21 / l11, a31 / l11
            l22 = math.sqrt(max(a22 - l21 * l21, 1.0))  # the information is at least the prior's
            l32 = (a32 - l31 * l21) / l22
            l33 = math.sqrt(max(a33 - l31 * l31 - l32 * l32, 1.0))
            z0 = b0 / l11
            z1 = (b1 - l21 * z0) / l22
            z2 = (b2 - l31 * z0 - l32 * z1) / l33
            moved = z0 * z0 + z1 * z1 + z2 * z2
            d2 = z2 / l33
            d1 = (z1 - l32 * d2) / l22
            d0 = (z0 - l21 * d1 - l31 * d2) / l11
            y0, y1, y2 = y0 + d0, y1 + d1, y2 + d2
            if last:
                break
            last = not open_still and moved < MAX_STEP_CHI2
            share = share * ANNEALING_FACTOR if open_still else 0.0
        modes[0, p], modes[1, p], modes[2, p] = y0, y1, y2
        factors[0, p], factors[1, p], factors[2, p] = l11, l21, l22
        factors[3, p], factors[4, p], factors[5, p] = l31, l32, l33
        # Laplace: the prior at the mode, and the volume of the approximation
        volume[p] = -0.5 * (y0 * y0 + y1 * y1 + y2 * y2) - math.log(l11) - math.log(l22) - math.log(l33)
    return modes, factors, volume


@kernel
def draw(
    modes: Floats, factors: Floats, chosen: Ints, defensive: float, u: Floats, noise: Floats
) -> tuple[Floats, Floats]:
    """Draw whitened positions y from the importance densities, and return them with the log ratios of prior to density.

    Args:
        modes: (3, L) modes m, from `adapt`.
        factors: (6, L) Cholesky factors of the precisions, from `adapt`.
        chosen: (n,) index of the density to draw from, 0 to L - 1.
        defensive: share e that is drawn from the prior N(0, I), in (0, 1).
        u: (n,) uniform in [0, 1).
        noise: (3, n) standard normal.

    Returns:
        (3, n) whitened positions y, and (n,) log N(y; 0, I) - log q(y).
    """
    n = chosen.shape[0]
    positions, ratio = np.empty((3, n)), np.empty(n)
    for i in range(n):
        p = chosen[i]
        l11, l21, l22 = factors[0, p], factors[1, p], factors[2, p]
        l31, l32, l33 = factors[3, p], factors[4, p], factors[5, p]
        m0, m1, m2 = modes[0, p], modes[1, p], modes[2, p]
        if u[i] < defensive:
            y0, y1, y2 = noise[0, i], noise[1, i], noise[2, i]
        else:
            d2 = noise[2, i] / l33
            d1 = (noise[1, i] - l32 * d2) / l22
            d0 = (noise[0, i] - l21 * d1 - l31 * d2) / l11
            y0, y1, y2 = m0 + d0, m1 + d1, m2 + d2
        positions[0, i], positions[1, i], positions[2, i] = y0, y1, y2
        # Both densities without their common (2 pi)^(-3/2)
        log_prior = -0.5 * (y0 * y0 + y1 * y1 + y2 * y2)
        e0, e1, e2 = y0 - m0, y1 - m1, y2 - m2
        z0, z1, z2 = l11 * e0 + l21 * e1 + l31 * e2, l22 * e1 + l32 * e2, l33 * e2
        near = math.log1p(-defensive) - 0.5 * (z0 * z0 + z1 * z1 + z2 * z2) + math.log(l11 * l22 * l33)
        far = math.log(defensive) + log_prior
        top = max(near, far)
        ratio[i] = log_prior - top - math.log(math.exp(near - top) + math.exp(far - top))
    return positions, ratio
