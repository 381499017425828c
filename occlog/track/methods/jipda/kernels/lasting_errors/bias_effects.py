"""Effect of an error of the body model and of errors of the cameras' poses on estimated positions."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

from ..body_box import MODEL, POSITION_SOURCE, PackedCameras, box_and_slope
from ..detections import DetectorModel, axis_noise
from ..linear import invert
from .pose_residuals import ANGLES, POSE_ERRORS, centre_slopes


@kernel
def bias_effects(
    mean: Floats, covariance: Floats, views: PackedCameras, rates: DetectorModel, sigma_pose: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the effect of constant errors on least-squares positions: of box centres in common, and of camera poses.

    Cameras around a person shift the position in different directions, cameras on one side all along their lines of
    sight. Occlusion is ignored.

    Args:
        mean: (N, 6) x, y, vx, vy, height, width of the people.
        covariance: (N, 6, 6) of these states; the variances of height and width are used.
        views: C cameras and position sensors.
        rates: parameters of the cameras' detectors.
        sigma_pose: (C, 2) standard deviations of each coordinate of the camera [scene unit], and of its rotations about
            the vertical and about its horizontal axis [rad].

    Returns:
        (N, 2) shift of x and y [scene unit] for a vertical bias of one height of the box; (N,) its length as a share of
        the sum of what single cameras contribute: 1 if all cameras with the person in view are on one side or none has
        it in view, 0 in the area of a position sensor; (N, 2, 2) covariance of x and y [scene unit^2] due to the poses:
        0 in the area of a position sensor.
    """
    N, C = mean.shape[0], views.lens.shape[0]
    shift, share, poses = np.zeros((N, 2)), np.ones(N), np.zeros((N, 2, 2))
    box, slope, inverse = np.empty(4), np.zeros((4, 6)), np.empty((4, 4))
    for i in range(N):
        # Right sides of the normal equations: a bias of the box, errors of the pose
        A, b = np.zeros((4, 4)), np.zeros((C, 4, 1 + POSE_ERRORS))
        A[2, 2], A[3, 3] = 1.0 / covariance[i, 4, 4], 1.0 / covariance[i, 5, 5]
        n = 0
        for c in range(C):
            lens = views.lens[c]
            if box_and_slope(lens, mean[i], 0.0, box, slope) < 0.0:
                continue
            if lens[MODEL] == POSITION_SOURCE:
                # Positions have no bias of this kind
                if lens[0] < mean[i, 0] < lens[2] and lens[1] < mean[i, 1] < lens[3]:
                    share[i] = 0.0
                continue
            u, v = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
            away = math.hypot(mean[i, 0] - lens[0], mean[i, 1] - lens[1])
            if u < 0.0 or v < 0.0 or u > views.size[c, 0] or v > views.size[c, 1] or away > views.range[c]:
                continue
            n += 1
            moves = centre_slopes(lens, mean[i], 0.0)
            for axis in range(2):
                middle, size = axis_noise(rates, axis, box[2] - box[0], box[3] - box[1], 1.0)
                for p in range(4):
                    at_p = p if p < 2 else p + 2
                    mid_p = 0.5 * (slope[axis, at_p] + slope[axis + 2, at_p])
                    size_p = slope[axis + 2, at_p] - slope[axis, at_p]
                    if axis == 1:
                        b[c, p, 0] += mid_p / middle * (box[3] - box[1])
                    for error in range(POSE_ERRORS):
                        sigma = sigma_pose[c, 1 if error < ANGLES else 0]
                        b[c, p, 1 + error] += mid_p / middle * moves[axis, error] * sigma
                        if error == ANGLES or error == ANGLES + 1:
                            # A camera that is nearer sees a larger body
                            grows = slope[axis, error - ANGLES] - slope[axis + 2, error - ANGLES]
                            b[c, p, 1 + error] += size_p / size * grows * sigma
                    for q in range(4):
                        at_q = q if q < 2 else q + 2
                        A[p, q] += mid_p / middle * 0.5 * (slope[axis, at_q] + slope[axis + 2, at_q])
                        A[p, q] += size_p / size * (slope[axis + 2, at_q] - slope[axis, at_q])
        if n == 0 or share[i] == 0.0 or math.isnan(invert(A, inverse)):
            continue
        total = 0.0
        for c in range(C):
            own = inverse @ b[c]
            shift[i] += own[:2, 0]
            total += math.hypot(own[0, 0], own[1, 0])
            for error in range(1, 1 + POSE_ERRORS):
                for p in range(2):
                    for q in range(2):
                        poses[i, p, q] += own[p, error] * own[q, error]
        if total > 0.0:
            share[i] = math.hypot(shift[i, 0], shift[i, 1]) / total
    return shift, share, poses
