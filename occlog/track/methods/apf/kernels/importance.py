"""Adapted importance density: a Laplace approximation of each particle's posterior.

A particle that moves in a given way is, before the scan, at N(x; m0, p0 I).  The density to draw it from is

    q(x) = (1 - e) N(x; m, P) + e N(x; m0, p0 I),

m the mode of N(x; m0, p0 I) times the densities of the measurements that are accepted, P the inverse of its
information there (Gauss-Newton), e a defensive share.  For a linear sensor without false reports this is the
optimal importance density (Doucet, Godsill and Andrieu 2000), and the predictive likelihood is exact.

Which measurements are accepted is found along with the mode.  The variance of each residual begins with what
the motion leaves open, and that part falls in steps (`ANNEALING_FACTOR`); a measurement counts by the probability that
it is the target's and not a false report or another object's.  At the end those above one half are accepted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.visibility import Sensors
from occlog.core.numerics.jit import kernel
from occlog.filtering.likelihood.directions import (
    MIN_DEPTH,
    MIN_DEPTH_RATIO,
    PRODUCT_FLOOR,
    ROOT_2PI,
    DetectionModel,
    PackedScan,
    PoseNoise,
)
from occlog.filtering.likelihood.distances import COMPILED, RangeMeasurements
from occlog.filtering.likelihood.distances import NEAREST as CLOSEST

ANNEALING_FACTOR, MAX_STEPS = 1e-2, 8
"""Factor per Gauss-Newton step on the prediction's share of the residual variance, and the maximum number of steps."""
MAX_MOTION_SHARE, MAX_STEP_CHI2 = 1e-2, 1e-2
"""The search ends when that share is below `MAX_MOTION_SHARE` of the noise and the squared step below `MAX_STEP_CHI2`
variances."""
MIN_INLIER_PROBABILITY, NEGLIGIBLE_PROBABILITY = 0.5, 1e-6
MIN_CLUTTER_DENSITY = 1e-30
"""Floor of the clutter density, for a sensor without false alarms."""


KIND, VALUE, READING_NOISE, SCALE, X0, Y0, COS, SIN, FOCAL, POSITION2, YAW2, CLUTTER = range(12)
"""Columns of `measurements`."""
X1, Y1, RISE2, OTHER_RISE2 = 6, 7, 8, 9
"""Columns of measurements of distances, which have no axis and no focal length."""
BEARING, PIXEL, RANGE, LOG_RANGE, DIFFERENCE = range(5)
"""Kinds of measurements, `compiled` of `occlog.filtering.likelihood.measurement_model`."""


@kernel
def measurements(scan: PackedScan, sensors: Sensors, noise: PoseNoise, model: DetectionModel) -> Floats:
    """Return (M, 12) parameters of a scan's directions, one row each, for the importance density.

    Columns: kind, measured value, noise, factor (SCALE), position of the sensor (2), cosine and sine of its axis, focal
    length [px], variances of its position and yaw, and density of false measurements (CLUTTER). The likelihood factor
    of a sensor's report at a position is the sum of SCALE times the density of each of its measurements, plus CLUTTER.

    Args:
        scan: packed scan with M measurements.
        sensors: positions and axes of all sensors.
        noise: errors of their poses, focal lengths and image widths.
        model: probabilities of detection and false alarms.
    """
    out = np.empty((scan.value.shape[0], 12))
    for k in range(scan.sensor.shape[0]):
        i = scan.sensor[k]
        for m in range(scan.first[k], scan.first[k + 1]):
            width = noise.width_px[i] if scan.pixel[m] else noise.width[i]
            if scan.labelled[k]:
                scale, rival = model.hit[i], model.miss[i] * model.false[i] / width
            else:
                scale, rival = model.candidate[i] * width / model.clutter[i], 1.0 - model.candidate[i]
            out[m, KIND], out[m, VALUE], out[m, READING_NOISE] = (
                1.0 if scan.pixel[m] else 0.0,
                scan.value[m],
                scan.variance[m],
            )
            out[m, SCALE], out[m, CLUTTER] = scale * scan.share[m], max(rival, MIN_CLUTTER_DENSITY)
            out[m, X0], out[m, Y0] = sensors.xy[i, 0], sensors.xy[i, 1]
            out[m, COS], out[m, SIN], out[m, FOCAL] = sensors.axis[i, 0], sensors.axis[i, 1], noise.focal_px[i]
            out[m, POSITION2], out[m, YAW2] = noise.sigma_position[i] ** 2, noise.sigma_yaw[i] ** 2
    return out


@kernel
def linearise_distance(x: float, y: float, z: Floats) -> tuple[float, float, float, float]:
    """Linearise a range, log range or range difference at (x, y); `z` (12,) is a row of `measurements`.

    Return the residual (measured minus expected), the derivatives of the expected value by x and y, and the variance of
    the reading, > 0.
    """
    dx, dy = x - z[X0], y - z[Y0]
    d = math.sqrt(max(dx * dx + dy * dy + z[RISE2], CLOSEST))
    if z[KIND] == LOG_RANGE:
        return z[VALUE] - math.log(d), dx / (d * d), dy / (d * d), z[READING_NOISE]
    if z[KIND] == RANGE:
        return z[VALUE] - d, dx / d, dy / d, z[READING_NOISE]
    ex, ey = x - z[X1], y - z[Y1]
    e = math.sqrt(max(ex * ex + ey * ey + z[OTHER_RISE2], CLOSEST))
    return z[VALUE] - (d - e), dx / d - ex / e, dy / d - ey / e, z[READING_NOISE]


@kernel
def linearise(x: float, y: float, z: Floats) -> tuple[float, float, float, float]:
    """Linearise a measurement at (x, y); `z` (12,) is a row of `measurements`.

    Return the residual (measured minus expected), the derivatives of the expected value by x and y, and the variance of
    the residual; -1 as variance where the position is behind the camera or at the sensor.
    """
    dx, dy = x - z[X0], y - z[Y0]
    if z[KIND] >= RANGE:
        return linearise_distance(x, y, z)
    if z[KIND] > 0.0:  # [Ercan] Eqs. 1 and 2
        h, d = z[COS] * dy - z[SIN] * dx, z[COS] * dx + z[SIN] * dy
        if not d > max(MIN_DEPTH_RATIO * abs(h), MIN_DEPTH):
            return 0.0, 0.0, 0.0, -1.0
        f, ratio = z[FOCAL], h / d
        spread, scale = 1.0 + ratio * ratio, f / d
        variance = z[READING_NOISE] + spread * (f * f * spread * z[YAW2] + scale * scale * z[POSITION2])
        return z[VALUE] - f * ratio, scale * (-z[SIN] - ratio * z[COS]), scale * (z[COS] - ratio * z[SIN]), variance
    square = dx * dx + dy * dy
    if not square > MIN_DEPTH:
        return 0.0, 0.0, 0.0, -1.0
    residual = z[VALUE] - math.atan2(dy, dx)
    residual -= 2.0 * math.pi * math.floor((residual + math.pi) / (2.0 * math.pi))
    return residual, -dy / square, dx / square, z[READING_NOISE]


def with_distances(first: Ints, rows: Floats, measured: RangeMeasurements) -> tuple[Ints, Floats]:
    """Return the index `first` and the parameters `rows` of a scan with measurements of distances appended.

    Each distance counts as a separate report of a sensor.

    Args:
        first: (K + 1,) measurements of report k are rows first[k] to first[k + 1] - 1.
        rows: (M, 12) from `measurements`.
        measured: m measurements of distances.

    Returns:
        (K + m + 1,) and (M + m, 12).
    """
    m = len(measured.kind)
    out = np.zeros((m, rows.shape[1]))
    out[:, KIND] = COMPILED[measured.kind]
    errors = measured.errors
    tail = errors.late + errors.early
    out[:, VALUE], out[:, READING_NOISE], out[:, SCALE] = measured.value, measured.sigma**2, 1.0 - tail
    out[:, [X0, Y0]], out[:, [X1, Y1]] = measured.position, measured.other
    out[:, RISE2], out[:, OTHER_RISE2] = measured.rise2, measured.other_rise2
    # The tail of late signals counts as if it were flat: what that omits is in the weights
    rival = np.exp(-0.5 * errors.bend**2) / ROOT_2PI + tail * errors.rate
    out[:, CLUTTER] = np.maximum(rival / measured.sigma, MIN_CLUTTER_DENSITY)
    return np.concatenate([first, first[-1] + 1 + np.arange(m)]), np.concatenate([rows, out])


class Laplace(NamedTuple):
    """Laplace (Gaussian) approximations N(mode, P) of n posteriors of position, and the predictive likelihoods.

    `root` (n, 3) is (r0, r1, r2) of the upper triangular root of P: x = mode_x + r0 n1 + r1 n2, y = mode_y + r2 n2 for
    standard normal n1, n2. The log predictive likelihood is `log_volume` + `log_factors`.
    """

    mode: Floats  # (n, 2) m
    root: Floats  # (n, 3) the upper triangle of a root of P: x = m_x + r0 n1 + r1 n2, y = m_y + r2 n2
    log_volume: Floats  # (n,) log of 2 pi sqrt(det P) N(m; m0, p0 I), the motion's part in the predictive likelihood
    log_factors: Floats  # (n,) log of the factors of sensors with measurements at m; both sum to the whole


@kernel
def adapt(mean: Floats, variance: Floats, wanted: Bools, first: Ints, rows: Floats) -> Laplace:
    """Return Laplace approximations of the posteriors of n particles, each with the prior N(m0, p0 I).

    The mode is found by at most `MAX_STEPS` Gauss-Newton steps, in which each measurement counts by the probability
    that it is the target's; in the last one those above one half count fully.

    Args:
        mean: (n, 2) m0, expected positions.
        variance: (n,) p0 per axis, > 0.
        wanted: (n,) those to approximate; the others keep their prior, with both logarithms 0.
        first: (K + 1,) measurements of report k are rows first[k] to first[k + 1] - 1.
        rows: (M, 12) parameters from `measurements`.
    """
    n, packed, count = mean.shape[0], first.shape[0] - 1, rows.shape[0]
    mode, root = mean.copy(), np.zeros((n, 3))
    log_volume, log_factors = np.zeros(n), np.zeros(n)
    density, terms = np.empty(count), np.empty((count, 4))
    for p in range(n):
        spread = math.sqrt(variance[p])
        root[p, 0] = root[p, 2] = spread
        if not wanted[p]:
            continue
        x0, y0 = mean[p, 0], mean[p, 1]
        x, y, share, last = x0, y0, 1.0, False
        a, b, c = 1.0 / spread, 0.0, 1.0 / spread
        for step in range(MAX_STEPS):
            last = last or step == MAX_STEPS - 1
            open_still = False
            # Root (a b; 0 c) of the information, and its right side: the motion first
            a, b, c = 1.0 / spread, 0.0, 1.0 / spread
            e, f = (x0 - x) / spread, (y0 - y) / spread
            for k in range(packed):
                total = 0.0
                for m in range(first[k], first[k + 1]):
                    # Expect: the probability that the measurement is the target's
                    r, hx, hy, v = linearise(x, y, rows[m])
                    terms[m, 0], terms[m, 1], terms[m, 2], terms[m, 3] = r, hx, hy, v
                    density[m] = 0.0
                    if v > 0.0:
                        wide = share * variance[p] * (hx * hx + hy * hy)
                        open_still = open_still or wide > MAX_MOTION_SHARE * v
                        v += wide
                        density[m] = rows[m, SCALE] * math.exp(-0.5 * r * r / v) / (ROOT_2PI * math.sqrt(v))
                    total += density[m]
                for m in range(first[k], first[k + 1]):
                    g = density[m] / (total + rows[m, CLUTTER])
                    if last:
                        g = 1.0 if g > MIN_INLIER_PROBABILITY else 0.0
                    if g < NEGLIGIBLE_PROBABILITY:
                        continue
                    # Maximise (Gauss-Newton): one more row of the root of the information, by Givens rotations
                    weight = math.sqrt(g / terms[m, 3])
                    r, hx, hy = weight * terms[m, 0], weight * terms[m, 1], weight * terms[m, 2]
                    norm = math.sqrt(a * a + hx * hx)
                    co, si = a / norm, hx / norm
                    a, b, hy = norm, co * b + si * hy, co * hy - si * b
                    e, r = co * e + si * r, co * r - si * e
                    norm = math.sqrt(c * c + hy * hy)
                    f = (c * f + hy * r) / norm
                    c = norm
            dy = f / c
            dx = (e - b * dy) / a
            x, y = x + dx, y + dy
            if last:
                break
            last = not open_still and e * e + f * f < MAX_STEP_CHI2
            share = share * ANNEALING_FACTOR if open_still else 0.0
        mode[p, 0], mode[p, 1] = x, y
        root[p, 0], root[p, 1], root[p, 2] = 1.0 / a, -b / (a * c), 1.0 / c
        # Laplace: the motion at the mode, and the volume of the approximation
        log_volume[p] = -math.log(variance[p] * a * c) - 0.5 * ((x - x0) ** 2 + (y - y0) ** 2) / variance[p]
        product = 1.0
        for k in range(packed):
            total = 0.0
            for m in range(first[k], first[k + 1]):
                r, _, _, v = linearise(x, y, rows[m])
                if v > 0.0:
                    total += rows[m, SCALE] * math.exp(-0.5 * r * r / v) / (ROOT_2PI * math.sqrt(v))
            if first[k] < first[k + 1]:
                product *= total + rows[first[k], CLUTTER]
                if product < PRODUCT_FLOOR or product > 1.0 / PRODUCT_FLOOR:
                    log_factors[p] += math.log(product)
                    product = 1.0
        log_factors[p] += math.log(product)
    return Laplace(mode, root, log_volume, log_factors)


@kernel
def draw(
    mean: Floats, variance: Floats, mode: Floats, root: Floats, defensive: float, u: Floats, noise: Floats
) -> tuple[Floats, Floats]:
    """Draw positions from the importance densities, and return them with the log ratios of prior to importance density.

    Args:
        mean: (n, 2) m0, means of the priors.
        variance: (n,) p0 per axis, variances of the priors.
        mode: (n, 2) m, from `adapt`.
        root: (n, 3) root of P, from `adapt`.
        defensive: share e that is drawn from N(m0, p0 I), 0 to 1.
        u: (n,) uniform in [0, 1).
        noise: (n, 2) standard normal.

    Returns:
        (n, 2) positions x and (n,) log N(x; m0, p0 I) - log q(x).
    """
    n = mean.shape[0]
    positions, ratio = np.empty((n, 2)), np.empty(n)
    for p in range(n):
        a, b, c, spread = root[p, 0], root[p, 1], root[p, 2], math.sqrt(variance[p])
        if u[p] < defensive:
            x, y = mean[p, 0] + spread * noise[p, 0], mean[p, 1] + spread * noise[p, 1]
        else:
            x, y = mode[p, 0] + a * noise[p, 0] + b * noise[p, 1], mode[p, 1] + c * noise[p, 1]
        positions[p, 0], positions[p, 1] = x, y
        # Both densities without their common 1 / (2 pi)
        log_prior = -0.5 * ((x - mean[p, 0]) ** 2 + (y - mean[p, 1]) ** 2) / variance[p] - math.log(variance[p])
        second = (y - mode[p, 1]) / c
        first = (x - mode[p, 0] - b * second) / a
        log_q = -0.5 * (first * first + second * second) - math.log(a * c)
        if defensive >= 1.0:
            log_q = log_prior
        elif defensive > 0.0:
            one, two = math.log1p(-defensive) + log_q, math.log(defensive) + log_prior
            top = max(one, two)
            log_q = top + math.log(math.exp(one - top) + math.exp(two - top))
        ratio[p] = log_prior - log_q
    return positions, ratio
