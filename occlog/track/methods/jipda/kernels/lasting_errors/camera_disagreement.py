"""Disagreement of cameras at one time step: residuals of boxes after a fit of position and body size.

Residuals against a filter's prediction contain the filter's lag; noise learned from them increases the lag. Here
position and body size of each person are fitted to the boxes of the time step alone. The residual variance is the
detectors' noise times 1 - h, with h the leverage of an observation in weighted least squares.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from ..body_box import PackedCameras, box_and_slope
from ..detections import DetectorModel, PackedDetections, axis_noise, biased
from ..linear import invert


class BoxDisagreement(NamedTuple):
    """Residuals of the M boxes of N people, after a fit of positions and body sizes to one time step alone.

    `residual` (M, 4) has the errors [px] of centre x, width, centre y, height (0: box not used), `kept` (M, 4) the
    share 1 - leverage of the noise variance that they retain (0: not used), `size` (M, 4) the box size [px] that scales
    each noise. `position` (N, 2) is the fitted position (NaN: fewer than two boxes), `variance` (N,) its mean variance
    per axis.
    """

    residual: Floats  # (M, 4) of the boxes that were used [px]; 0: not used
    kept: Floats  # (M, 4) share of the noise's variance that a residual keeps; 0: not used
    size: Floats  # (M, 4) in which shares of its noise count [px]
    position: Floats  # (N, 2) as the time step's boxes alone say; NaN: too few
    variance: Floats  # (N,) of it, mean of both axes, from the detectors' noise that does not last


@kernel
def camera_disagreement(
    mean: Floats,
    covariance: Floats,
    views: PackedCameras,
    boxes: PackedDetections,
    rates: DetectorModel,
    owner: Ints,
    good: Bools,
) -> BoxDisagreement:
    """Fit position and body size of each person to the boxes of one time step, by weighted least squares.

    Args:
        mean: (N, 6) x, y, vx, vy, height, width after the update; the fit is linearised here, with this body size as
            the prior.
        covariance: (N, 6, 6) of these states; the variances of height and width are used.
        views: cameras and position sensors.
        boxes: frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        owner: (M,) index of the person of each box.
        good: (M,) whether a box is surely of its owner, whole and unoccluded; others are not used.
    """
    N, M = mean.shape[0], boxes.box.shape[0]
    residual, kept, size = np.zeros((M, 4)), np.zeros((M, 4)), np.ones((M, 4))
    position, variance = np.full((N, 2), np.nan), np.zeros(N)
    slopes, noise, rows = np.zeros((M, 4, 4)), np.ones((M, 4)), np.empty(M, dtype=np.int64)
    box, slope, drawn, inverse = np.empty(4), np.zeros((4, 6)), np.empty(4), np.empty((4, 4))
    frame = np.zeros(M, dtype=np.int64)
    for l in range(boxes.camera.shape[0]):  # noqa: E741 - a frame
        frame[boxes.first[l] : boxes.first[l + 1]] = l
    for i in range(N):
        n = 0
        A, b = np.zeros((4, 4)), np.zeros(4)
        A[2, 2], A[3, 3] = 1.0 / covariance[i, 4, 4], 1.0 / covariance[i, 5, 5]
        for j in range(M):
            if owner[j] != i or not good[j]:
                continue
            c = boxes.camera[frame[j]]
            if box_and_slope(views.lens[c], mean[i], boxes.delay[frame[j]], box, slope) < 0.0:
                continue
            biased(box, rates.bias[c], drawn)
            width, height = drawn[2] - drawn[0], drawn[3] - drawn[1]
            size[j, 0], size[j, 1], size[j, 2], size[j, 3] = height, width, height, height
            for axis in range(2):
                noise[j, 2 * axis], noise[j, 2 * axis + 1] = axis_noise(rates, axis, width, height, 1.0)
                low, high = boxes.box[j, axis] - drawn[axis], boxes.box[j, axis + 2] - drawn[axis + 2]
                residual[j, 2 * axis], residual[j, 2 * axis + 1] = 0.5 * (low + high), high - low
                for k in range(4):
                    at = k if k < 2 else k + 2
                    slopes[j, 2 * axis, k] = 0.5 * (slope[axis, at] + slope[axis + 2, at])
                    slopes[j, 2 * axis + 1, k] = slope[axis + 2, at] - slope[axis, at]
            for e in range(4):
                for p in range(4):
                    b[p] += slopes[j, e, p] * residual[j, e] / noise[j, e]
                    for q in range(4):
                        A[p, q] += slopes[j, e, p] * slopes[j, e, q] / noise[j, e]
            rows[n] = j
            n += 1
        if n == 0 or math.isnan(invert(A, inverse)):
            continue
        shift = inverse @ b
        for k in range(n):
            j = rows[k]
            for e in range(4):
                fitted = slopes[j, e] @ shift
                leverage = slopes[j, e] @ inverse @ slopes[j, e] / noise[j, e]
                residual[j, e] -= fitted
                kept[j, e] = max(1.0 - leverage, 0.0)
        if n >= 2:
            position[i, 0], position[i, 1] = mean[i, 0] + shift[0], mean[i, 1] + shift[1]
            variance[i] = 0.5 * (inverse[0, 0] + inverse[1, 1])
    return BoxDisagreement(residual, kept, size, position, variance)
