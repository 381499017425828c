"""Detections of one time step, error model of the detectors, and densities of boxes.

The edges of a box are modelled by centre and size on each axis, with independent errors: left = centre - width / 2.
Edges that are not observed (truncated by the border of the image, occluded, or outliers) are marginalised.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .linear import invert

UNOBSERVED_VARIANCE = 1e10
"""Variance assigned to an unobserved box edge [px^2]."""
LOG_UNOBSERVED = 0.5 * math.log(2.0 * math.pi * UNOBSERVED_VARIANCE)
LOG_2PI = math.log(2.0 * math.pi)
LOG_SIZE_RANGE = math.log(20.0)
"""Sizes of false alarms are uniform in the logarithm over a factor of 20."""


class PackedDetections(NamedTuple):
    """Detections of the L frames of one time step, packed into arrays for the kernels: M boxes in all.

    Per frame: `camera` index, `delay` after the time step [s], and `first` (L + 1,): frame l has the boxes first[l] to
    first[l + 1] - 1. Per box: `box` (M, 4) left, top, right, bottom [px], `usable` (M, 4) edges that the image border
    does not cut, `clutter` log of the expected number of false alarms per frame. Positions on the ground are boxes
    (x, y, x, y) with `covariance` (M, 3) xx, xy, yy and `tail` (M,), the additional variance of a manoeuvring target.
    """

    camera: Ints  # (L,)
    delay: Floats  # (L,) later than the time step [s]
    first: Ints  # (L + 1,) boxes of frame l are first[l] to first[l + 1] - 1
    box: Floats  # (M, 4) left, top, right, bottom [px]
    usable: Bools  # (M, 4) edges that the border of the image does not cut
    clutter: Floats  # (M,) log of the expected number of false alarms like it in score, in the frame
    covariance: Floats = np.full((0, 3), np.nan)  # (M, 3) xx, xy, yy of positions, NaN of boxes; (0, 3): boxes only
    tail: Floats = np.zeros(0)  # (M,) variance per axis of the positions of a target that manoeuvres; (0,): boxes only


class DetectorModel(NamedTuple):
    """Parameters of the detectors of C cameras: detection, errors of box edges, merges and misses.

    `detection` (C,) is the detection probability of an unoccluded person, `curve` (K,) its factor at the visible shares
    0 to 1; `bias` (C, 4) and `noise` (4, 2) are errors of centre x, width, centre y, height (bias as shares of height,
    width, height, height; noise variance = constant [px^2] + factor x size^2); `gait_variance` is a further centre
    variance [box heights^2] with correlated errors, `lasting` (C,) and `slow` factors for correlation; `cut`, `wrong`,
    `merge` and `common_miss` are probabilities of a truncated box, an outlier edge, a merged detection, and a miss in
    all frames.
    """

    detection: Floats  # (C,) probability of detection of a person in plain view
    curve: Floats  # (K,) factor of it at the visible shares 0, 1 / (K - 1), .., 1
    cut: float  # probability that a box ends where the cover of the feet begins
    wrong: float  # probability that one edge of a box, any of the four, is an outlier
    bias: Floats  # (C, 4) centre and width across, centre and height down, in heights, widths, heights, heights
    noise: Floats  # (4, 2) variances of the same: constant [px^2], and share of the size, squared
    gait_variance: float  # variance of either centre also, in heights squared; its errors last
    lasting: Floats  # (C,) factor of it in an update
    merge: Floats  # (C,) probability that two people who touch in the image are detected as one box
    common_miss: float  # probability that a person is missed in all frames of a time step, in addition
    slow: float  # factor of the noise in an update, since errors are correlated from frame to frame


@kernel
def interpolate(curve: Floats, share: float) -> float:
    """Interpolate linearly, at `share` (clipped to 0 to 1), a curve (K,) with values at equal steps from 0 to 1."""
    at = min(max(share, 0.0), 1.0) * (curve.shape[0] - 1)
    k = min(int(at), curve.shape[0] - 2)
    value: float = curve[k] + (at - k) * (curve[k + 1] - curve[k])
    return value


@kernel
def axis_noise(rates: DetectorModel, axis: int, width: float, height: float, lasting: float) -> tuple[float, float]:
    """Return the variances [px^2] of the centre and of the size of a box along one image axis.

    Args:
        rates: parameters of the cameras' detectors.
        axis: 0: horizontal, 1: vertical.
        width: width of the box [px].
        height: height of the box [px].
        lasting: factor of the time-correlated variance of the centre.
    """
    size = width if axis == 0 else height
    centre = rates.noise[2 * axis, 0] + (rates.noise[2 * axis, 1] + lasting * rates.gait_variance) * height * height
    return centre, rates.noise[2 * axis + 1, 0] + rates.noise[2 * axis + 1, 1] * size * size


@kernel
def edge_noise(box: Floats, rates: DetectorModel, lasting: float, noise: Floats) -> None:
    """Write the covariance (4, 4) [px^2] of the edges of a box expected at `box` (left, top, right, bottom) to `noise`.

    `rates` are the detectors' parameters, `lasting` the factor of the time-correlated variance of the centre.
    """
    width, height = box[2] - box[0], box[3] - box[1]
    noise[:] = 0.0
    for axis in range(2):
        centre, size = axis_noise(rates, axis, width, height, lasting)
        a, b = axis, axis + 2
        noise[a, a] = noise[b, b] = centre + 0.25 * size
        noise[a, b] = noise[b, a] = centre - 0.25 * size


@kernel
def position_noise(boxes: PackedDetections, j: int, factor: float, noise: Floats) -> bool:
    """Write the covariance (4, 4) of the ground position `boxes.box[j]` = (x, y, x, y), times `factor`, to `noise`.

    The second x and y count as unobserved (`UNOBSERVED_VARIANCE`). Return False, and write nothing, if j is a box.
    """
    if boxes.covariance.shape[0] == 0 or math.isnan(boxes.covariance[j, 0]):
        return False
    noise[:] = 0.0
    noise[0, 0], noise[1, 1] = factor * boxes.covariance[j, 0], factor * boxes.covariance[j, 2]
    noise[0, 1] = noise[1, 0] = factor * boxes.covariance[j, 1]
    # Not observed
    noise[2, 2] = noise[3, 3] = UNOBSERVED_VARIANCE
    return True


@kernel
def biased(box: Floats, bias: Floats, out: Floats) -> None:
    """Write the box that a detector with systematic error `bias` (4,) reports for the true outline `box` (4,) to `out`.

    Boxes are left, top, right, bottom [px]; the bias is of centre x, width, centre y and height, as shares of the box's
    height, width, height and height.
    """
    width, height = box[2] - box[0], box[3] - box[1]
    u, v = 0.5 * (box[0] + box[2]) + bias[0] * height, 0.5 * (box[1] + box[3]) + bias[2] * height
    half_w, half_h = 0.5 * width * (1.0 + bias[1]), 0.5 * height * (1.0 + bias[3])
    out[0], out[1], out[2], out[3] = u - half_w, v - half_h, u + half_w, v + half_h


@kernel
def log_density(off: Floats, inverse: Floats, use: Bools, noise: Floats, spread: Floats) -> tuple[float, float]:
    """Return the Gaussian log density of a residual over the edges in use, and its squared Mahalanobis distance.

    Args:
        off: (4,) residual of left, top, right, bottom: observed minus expected [px].
        inverse: (4, 4) written: inverse of the residual's covariance, with `UNOBSERVED_VARIANCE` for edges not in use.
        use: (4,) edges in use.
        noise: (4, 4) measurement covariance R of the edges.
        spread: (4, 4) covariance H P H' of the expected edges.
    """
    S = np.empty((4, 4))
    unused = 0
    for a in range(4):
        for b in range(4):
            S[a, b] = spread[a, b] + noise[a, b]
        if not use[a]:
            S[a, a] += UNOBSERVED_VARIANCE
            unused += 1
    log_determinant = invert(S, inverse)
    distance = 0.0
    for a in range(4):
        for b in range(4):
            distance += off[a] * inverse[a, b] * off[b]
    return -0.5 * (distance + log_determinant + 4 * LOG_2PI) + unused * LOG_UNOBSERVED, distance


@kernel
def log_clutter(box: Floats, use: Bools, width: float, height: float) -> float:
    """Return the log density of the edges in `use` (4,) of a clutter box (left, top, right, bottom) [1/px per edge].

    The position is uniform in a width x height image [px], the size uniform on a logarithmic scale.
    """
    total = 0.0
    for axis in range(2):
        extent = width if axis == 0 else height
        a, b = axis, axis + 2
        if use[a] or use[b]:
            total -= math.log(extent)
        if use[a] and use[b]:
            total -= math.log(max(box[b] - box[a], 1.0) * LOG_SIZE_RANGE)
    return total


@kernel
def add_axis_precision(
    noise: Floats, axis: int, low: bool, high: bool, low_weight: float, high_weight: float, both: float, out: Floats
) -> None:
    """Add the weighted inverse covariance of the observed edges of one image axis to `out` (4, 4), in place.

    Args:
        noise: (4, 4) covariance of left, top, right, bottom [px^2].
        axis: 0: left and right, 1: top and bottom.
        low: the left or top edge is observed.
        high: the right or bottom edge is observed.
        low_weight: weight if the low edge alone is observed.
        high_weight: weight if the high edge alone is observed.
        both: weight if both edges are observed.
        out: (4, 4) changed.
    """
    a, b = axis, axis + 2
    if low and high:
        det = noise[a, a] * noise[b, b] - noise[a, b] * noise[a, b]
        out[a, a] += both * noise[b, b] / det
        out[b, b] += both * noise[a, a] / det
        out[a, b] -= both * noise[a, b] / det
        out[b, a] -= both * noise[a, b] / det
    elif low:
        out[a, a] += low_weight / noise[a, a]
    elif high:
        out[b, b] += high_weight / noise[b, b]


@kernel
def add_precision(noise: Floats, use: Bools, weight: float, out: Floats) -> None:
    """Add `weight` times the inverse covariance of the edges in `use` (4,) to `out` (4, 4), in place.

    `noise` (4, 4) is the covariance of left, top, right, bottom. The image axes are independent; a ground position with
    correlated x and y uses the first two rows.
    """
    if noise[0, 1] != 0.0 and use[0] and use[1]:
        det = noise[0, 0] * noise[1, 1] - noise[0, 1] * noise[0, 1]
        out[0, 0] += weight * noise[1, 1] / det
        out[1, 1] += weight * noise[0, 0] / det
        out[0, 1] -= weight * noise[0, 1] / det
        out[1, 0] -= weight * noise[0, 1] / det
        return
    for axis in range(2):
        add_axis_precision(noise, axis, use[axis], use[axis + 2], weight, weight, weight, out)
