"""Likelihood of a scan for a target at given positions: [Ercan] Sec. 4.2-4.3 without moving occluders.

A scan has a *report* of every sensor that delivered a frame.  A report of a labelled target
has one measurement or none ("not seen"); an unlabelled report has any number of candidates,
of which at most one is the target's.

A sensor is assigned (A) to a position that no static occluder, field of view or range keeps it from seeing
(`occlog.core.geometry.visibility.seen_from`, [Ercan] Sec. 4.3).  The factor of a report is

    labelled, z:       hit N(z) + miss floor      A
                       soften hit N(z) + floor    not A (the first term only in front of a camera)
    labelled, unseen:  miss                       A
                       1                          not A
    candidates z_k:    1 - P + P sum_k w_k N(z_k) / lambda     A
                       1                          not A

Likelihood of a scan for a target at given positions among moving occluders with priors: [Ercan] Sec. 4.2-4.3.

A camera sees a position in its view with probability P (`occlog.core.occlusion.occlusion_probability`).  Let a be
its factor for a position that it sees (A in `occlog.filtering.likelihood.directions`) and b that for a position
hidden by an occluder: the floor of a reading, and 1 where it reports nothing or
candidates.  Cameras then count, by `Occlusion.probability`, with

    INDEPENDENT        prod_i (P_i a_i + (1 - P_i) b_i)
    RECURSION, EXACT   sum over subsets Q of the cameras of p_Q prod_Q (a_i - b_i) prod_not-Q b_i

p_Q being the probability that no camera of Q is blocked, by Eq. 8 or without its
assumption.  With P_D = 1 and P_F = 0 this is Eq. 9.  P_i and 1 - P_i count as no less than
`Occlusion.floor`, and with the exponent `Occlusion.temper`; a sum over subsets counts as no less than `floor` times
prod_i max(a_i, b_i).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.visibility import Sensors, seen_from
from occlog.core.numerics.jit import kernel
from occlog.core.occlusion.joint_occlusion import add_joint
from occlog.core.occlusion.occlusion_probability import make_grid, unhidden_over
from occlog.core.occlusion.priors import Priors

ROOT_2PI = math.sqrt(2.0 * math.pi)
MIN_DEPTH_RATIO = 1e-9
"""A position counts as in front of a camera if d is above this times |h|."""
MIN_DEPTH = 1e-100
"""A position counts as in front of a camera if d is above this, so that h/d does not overflow."""
PRODUCT_FLOOR = 1e-150
"""Products below this or above its reciprocal go to the logarithms, long before a double under- or overflows."""
MIN_FALSE_ALARM_PROBABILITY = 1e-5
"""Least probability of a false report times that of a miss in `likely_inliers`."""


class PoseNoise(NamedTuple):
    """Standard deviations of the poses of S sensors for [Ercan] Eq. 2, with focal lengths and image widths."""

    focal_px: Floats  # (S,)
    sigma_position: Floats  # (S,)
    sigma_yaw: Floats  # (S,) [rad]
    width_px: Floats  # (S,) width of the image in z [px]
    width: Floats  # (S,) angle that bearings can come from [rad]


class PackedScan(NamedTuple):
    """A scan as the kernels read it: n reports with m measurements in all.

    Numba requires arrays of one type each, and a report's measurements in adjacent rows: rows without detection are
    removed, pixels and bearings share a column, and every measurement has a variance.
    `occlog.track.methods.apf.model.pack_scan` makes it of an `occlog.scans.grouping.Scan`.
    """

    sensor: Ints  # (n,) rows of the sensors
    labelled: Bools  # (n,)
    first: Ints  # (n + 1,) measurements of report k are first[k] to first[k + 1] - 1
    pixel: Bools  # (m,) true: z [px] of Eq. 1, false: a bearing [rad]
    value: Floats  # (m,) z = -u_px, or the bearing
    variance: Floats  # (m,) of reading [px^2], or of the bearing in all [rad^2]
    share: Floats  # (m,) w_k, weight of a candidate; 1 for a labelled measurement


class DetectionModel(NamedTuple):
    """Probabilities of detection, false alarms and clutter of S sensors, by which the reports of a scan are weighed.

    `hit` P_D and `miss` 1 - P_D of a labelled report, `false` P_F, `candidate` P that the target is among a sensor's
    candidates, `clutter` the expected number of other candidates. `soften` is the factor of a detection of a target
    that the camera cannot see. The factors are listed in the module docstring.
    """

    hit: Floats  # (S,)
    miss: Floats  # (S,)
    false: Floats  # (S,) P_F
    soften: float
    candidate: Floats  # (S,) P
    clutter: Floats  # (S,) lambda W: other candidates expected in a frame


@kernel
def add_pixel(
    out: Floats, xy: Floats, i: int, z: float, variance: float, share: float, sensors: Sensors, noise: PoseNoise
) -> None:
    """Add the density of a horizontal pixel coordinate that a camera measured to sums over positions, in place.

    This is [Ercan] Eq. 1 with the variance of Eq. 2. Nothing is added behind the camera (d <= 0).

    Args:
        out: (L,) sums; changed.
        xy: (L, 2) positions of the target.
        i: index of the camera.
        z: measurement [px], from the optical axis.
        variance: variance of the reading [px^2]; that by the errors of the camera's pose is added.
        share: factor of the density.
        sensors: has positions and axes of the cameras.
        noise: has focal lengths and the errors of the poses.
    """
    x0, y0, c, s = sensors.xy[i, 0], sensors.xy[i, 1], sensors.axis[i, 0], sensors.axis[i, 1]
    f, sigma_position, yaw2 = noise.focal_px[i], noise.sigma_position[i], noise.sigma_yaw[i] ** 2
    f2, scale = f * f, share / ROOT_2PI
    for p in range(xy.shape[0]):
        dx, dy = xy[p, 0] - x0, xy[p, 1] - y0
        h, d = c * dy - s * dx, c * dx + s * dy
        if not d > max(MIN_DEPTH_RATIO * abs(h), MIN_DEPTH):
            continue
        # Variance of Eq. 2: reading, yaw and position of the camera
        ratio = h / d
        spread = 1.0 + ratio * ratio
        angle = sigma_position / d
        v = variance + f2 * spread * (spread * yaw2 + angle * angle)
        residual = z - f * ratio  # Eq. 1
        out[p] += scale * math.exp(-0.5 * residual * residual / v) / math.sqrt(v)


@kernel
def add_bearing(out: Floats, xy: Floats, x0: float, y0: float, bearing: float, variance: float, share: float) -> None:
    """Add `share` times the density of a bearing [rad] from (x0, y0) at positions `xy` (L, 2) to `out` (L,), in place.

    The density is a Gaussian of the difference wrapped to [-pi, pi); the square root of `variance` [rad^2] must be much
    smaller than pi.
    """
    scale = share / (ROOT_2PI * math.sqrt(variance))
    for p in range(xy.shape[0]):
        residual = bearing - math.atan2(xy[p, 1] - y0, xy[p, 0] - x0)
        residual -= 2.0 * math.pi * math.floor((residual + math.pi) / (2.0 * math.pi))
        out[p] += scale * math.exp(-0.5 * residual * residual / variance)


@kernel
def densities(xy: Floats, k: int, scan: PackedScan, sensors: Sensors, noise: PoseNoise) -> Floats:
    """Return (L,) sums, over the measurements of one report, of share times density at given target positions.

    Args:
        xy: (L, 2) positions.
        k: index of the report.
        scan: has the measurements of the report, their variances and shares.
        sensors: positions and axes of all sensors.
        noise: errors of measurements in pixels.
    """
    out = np.zeros(xy.shape[0])
    i = scan.sensor[k]
    for m in range(scan.first[k], scan.first[k + 1]):
        if scan.pixel[m]:
            add_pixel(out, xy, i, scan.value[m], scan.variance[m], scan.share[m], sensors, noise)
        else:
            add_bearing(out, xy, sensors.xy[i, 0], sensors.xy[i, 1], scan.value[m], scan.variance[m], scan.share[m])
    return out


@kernel
def factors(
    xy: Floats, k: int, scan: PackedScan, sensors: Sensors, noise: PoseNoise, model: DetectionModel, seen: Bools
) -> tuple[Floats, float]:
    """Return the (L,) likelihood factors of report k at target positions, and the factor behind an occluder.

    The factors, by the table in the module docstring, are those without moving occluders.

    Args:
        xy: (L, 2) positions.
        k: index of the report.
        scan: the measurements.
        sensors: positions, fields of view and walls of the sensors.
        noise: errors of their measurements.
        model: probabilities of detection, false alarms and clutter.
        seen: (L,) positions that the sensor sees, apart from moving occluders.
    """
    # Every factor is scale N + offset, with one pair for assigned positions and one for the others.
    i = scan.sensor[k]
    scale, offset, scale_else, offset_else, hidden = 0.0, 0.0, 0.0, 1.0, 1.0
    if scan.first[k] == scan.first[k + 1]:
        offset = model.miss[i] if scan.labelled[k] else 1.0 - model.candidate[i]
        out = np.zeros(xy.shape[0])
    else:
        width = image_width(k, scan, noise)
        if scan.labelled[k]:
            hidden = model.false[i] / width  # the floor: a false report, uniform over the image
            scale, offset = model.hit[i], model.miss[i] * hidden
            scale_else, offset_else = model.soften * model.hit[i], hidden
        else:
            scale, offset = model.candidate[i] * width / model.clutter[i], 1.0 - model.candidate[i]
        out = densities(xy, k, scan, sensors, noise)
    for p in range(out.shape[0]):
        if seen[p]:
            out[p] = scale * out[p] + offset
        else:
            out[p] = scale_else * out[p] + offset_else
    return out, hidden


@kernel
def image_width(k: int, scan: PackedScan, noise: PoseNoise) -> float:
    """Return the range W of possible measurement values of report k of the scan [px or rad]; it has a measurement."""
    widths = noise.width_px if scan.pixel[scan.first[k]] else noise.width
    width: float = widths[scan.sensor[k]]
    return width


@kernel
def log_likelihood(
    xy: Floats, scan: PackedScan, sensors: Sensors, noise: PoseNoise, model: DetectionModel, free: Bools
) -> Floats:
    """Return (L,) log-likelihoods of a scan for target positions, without priors of moving occluders.

    -inf where a position is impossible.

    Args:
        xy: (L, 2) positions.
        scan: the measurements.
        sensors: positions, fields of view and walls of the sensors.
        noise: errors of their measurements.
        model: probabilities of detection, false alarms and clutter.
        free: (L,) positions where a target can be; -inf elsewhere.
    """
    L = xy.shape[0]
    total, product = np.zeros(L), np.ones(L)
    for k in range(scan.sensor.shape[0]):
        # Assign ([Ercan] Sec. 4.3), then multiply: reports are independent given the position (Eq. 6)
        seen = seen_from(xy, scan.sensor[k], sensors)
        factor, _ = factors(xy, k, scan, sensors, noise, model, seen)
        multiply_into(product, total, factor)
    for p in range(L):
        total[p] = total[p] + math.log(product[p]) if free[p] else -np.inf
    return total


@kernel
def multiply_into(product: Floats, total: Floats, factor: Floats) -> None:
    """Multiply `product` (L,) by `factor` (L,) in place; logarithms are taken only where a product becomes extreme.

    A product outside [1e-150, 1e150] is added as its logarithm to `total` (L,), in place, and reset to 1.
    """
    for p in range(product.shape[0]):
        product[p] *= factor[p]
        if product[p] < PRODUCT_FLOOR or product[p] > 1.0 / PRODUCT_FLOOR:
            total[p] += math.log(product[p]) if product[p] > 0.0 else -np.inf
            product[p] = 1.0


@kernel
def likely_inliers(xy: Floats, scan: PackedScan, sensors: Sensors, noise: PoseNoise, model: DetectionModel) -> Bools:
    """Return (n,) booleans: the report has a measurement that is more probably the target's than false or another's.

    False too for a report without a measurement, and for a sensor that cannot see the position.

    Args:
        xy: (1, 2) estimated position of the target.
        scan: n reports.
        sensors: positions, fields of view and walls of the sensors.
        noise: errors of their measurements.
        model: probabilities; without false alarms a limit near 5 sigma still applies.
    """
    out = np.zeros(scan.sensor.shape[0], dtype=np.bool_)
    for k in range(out.shape[0]):
        i = scan.sensor[k]
        if scan.first[k] == scan.first[k + 1] or not seen_from(xy, i, sensors)[0]:
            continue
        density = densities(xy, k, scan, sensors, noise)[0]
        if scan.labelled[k]:
            others = max(model.miss[i] * model.false[i], MIN_FALSE_ALARM_PROBABILITY)
            out[k] = model.hit[i] * density * image_width(k, scan, noise) > others
        else:
            others = (1.0 - model.candidate[i]) * model.clutter[i]
            out[k] = model.candidate[i] * density * image_width(k, scan, noise) > others
    return out


class Occlusion(NamedTuple):
    """Settings of the likelihood among moving occluders with priors: how the reports of several cameras are combined.

    Let a_i be the factor of camera i if it sees the position, b_i that if an occluder hides it, P_i the probability
    that none does. INDEPENDENT: prod_i (P_i a_i + (1 - P_i) b_i). RECURSION, EXACT: the sum over subsets Q of cameras
    of p_Q prod_Q (a_i - b_i) prod_not-Q b_i, with p_Q the probability that none of Q is blocked, by [Ercan] Eq. 8 or
    exact.

    Attributes:
        probability: INDEPENDENT, RECURSION or EXACT.
        form: form of the probability that an occluder hides a position: PRINTED (Eq. 7), IMPROVED or QUADRATURE.
        floor: least probability that counts, 0 to 1.
        far: standard deviations beyond which a normal prior counts as 0.
        temper: exponent of P_i and of 1 - P_i, INDEPENDENT only. The errors of a prior last for many scans, in which
            the same evidence would be counted again; an exponent below 1 counts it as often as it is new.
    """

    probability: int
    form: int
    floor: float
    far: float
    temper: float = 1.0


INDEPENDENT, RECURSION, EXACT = 1, 2, 3


def log_likelihood_among(
    xy: Floats,
    scan: PackedScan,
    sensors: Sensors,
    noise: PoseNoise,
    model: DetectionModel,
    free: Bools,
    priors: Priors,
    occlusion: Occlusion,
) -> Floats:
    """Return (L,) log-likelihoods of a scan for target positions, given priors of moving occluders.

    -inf where a position is impossible.

    Args:
        xy: (L, 2) positions.
        scan: the measurements.
        sensors: positions, fields of view and walls of the sensors.
        noise: errors of their measurements.
        model: probabilities of detection, false alarms and clutter.
        free: (L,) positions where a target can be; -inf elsewhere.
        priors: position priors of the moving occluders.
        occlusion: how the priors count.
    """
    # Separate kernels, so that only those that are used are compiled.
    if occlusion.probability == INDEPENDENT:
        return np.asarray(_independent(xy, scan, sensors, noise, model, free, priors, occlusion))
    total, a, b, assigned = _split_by_occlusion(xy, scan, sensors, noise, model, free)
    add_joint(
        total=total,
        xy=xy,
        sensor=scan.sensor,
        a=a,
        b=b,
        assigned=assigned,
        positions=sensors.xy,
        priors=priors,
        exact=occlusion.probability == EXACT,
        form=occlusion.form,
        floor=occlusion.floor,
        far=occlusion.far,
    )
    return np.asarray(total)


@kernel
def _independent(
    xy: Floats,
    scan: PackedScan,
    sensors: Sensors,
    noise: PoseNoise,
    model: DetectionModel,
    free: Bools,
    priors: Priors,
    occlusion: Occlusion,
) -> Floats:
    """Return (L,) log-likelihoods of a scan for target positions, with cameras independent given the position.

    -inf where a position is impossible. Occluders do not hide sounds from microphone arrays.

    Args:
        xy: (L, 2) positions.
        scan: the measurements.
        sensors: positions, fields of view and walls of the sensors.
        noise: errors of their measurements.
        model: probabilities of detection and of false measurements.
        free: (L,) positions where a target can be; -inf elsewhere.
        priors: position priors of the moving occluders.
        occlusion: how the priors count.
    """
    L = xy.shape[0]
    total, product = np.zeros(L), np.ones(L)
    grid = make_grid(xy, free, priors, occlusion.far)
    for k in range(scan.sensor.shape[0]):
        i = scan.sensor[k]
        seen = seen_from(xy, i, sensors)
        factor, hidden = factors(xy, k, scan, sensors, noise, model, seen)
        if sensors.cos2[i] >= 0.0:  # a camera: people do not hide sounds from arrays
            # P_i at the positions that the camera is assigned to, then P_i a_i + (1 - P_i) b_i
            rows = np.flatnonzero(seen & free)
            x0, y0 = sensors.xy[i, 0], sensors.xy[i, 1]
            share = unhidden_over(grid, xy, rows, x0, y0, priors, occlusion.form, occlusion.far)
            for m in range(rows.shape[0]):
                clear, blocked = max(share[m], occlusion.floor), max(1.0 - share[m], occlusion.floor)
                if occlusion.temper < 1.0:
                    clear, blocked = clear**occlusion.temper, blocked**occlusion.temper
                factor[rows[m]] = clear * factor[rows[m]] + blocked * hidden
        multiply_into(product, total, factor)
    for p in range(L):
        total[p] = total[p] + np.log(product[p]) if free[p] else -np.inf
    return total


@kernel
def _split_by_occlusion(
    xy: Floats, scan: PackedScan, sensors: Sensors, noise: PoseNoise, model: DetectionModel, free: Bools
) -> tuple[Floats, Floats, Floats, Bools]:
    """Split the likelihood of a scan of n reports into factors that moving occluders cannot change and others.

    Args:
        xy: (L, 2) positions.
        scan: the reports.
        sensors: all sensors.
        noise: errors of their measurements.
        model: probabilities of detection, false alarms and clutter.
        free: (L,) positions on the floor; the others have the log-likelihood -inf.

    Returns:
        (L,) log-likelihoods of arrays, and of cameras that cannot see a position anyway.
        (n, L) factors a of each report for a camera that is not blocked, and (n,) factors b for a blocked one.
        (n, L) booleans: the report's camera may see the position, so that its factor is not in the first.
    """
    n, L = scan.sensor.shape[0], xy.shape[0]
    total, product = np.zeros(L), np.ones(L)
    a, b, assigned = np.empty((n, L)), np.ones(n), np.zeros((n, L), dtype=np.bool_)
    for k in range(n):
        i = scan.sensor[k]
        seen = seen_from(xy, i, sensors)
        factor, b[k] = factors(xy, k, scan, sensors, noise, model, seen)
        a[k] = factor
        if sensors.cos2[i] >= 0.0:
            for p in range(L):
                if seen[p] and free[p]:
                    assigned[k, p] = True
                    factor[p] = 1.0
        multiply_into(product, total, factor)
    for p in range(L):
        total[p] = total[p] + np.log(product[p]) if free[p] else -np.inf
    return total, a, b, assigned
