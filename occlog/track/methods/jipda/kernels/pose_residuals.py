"""Errors of the cameras' orientations, from boxes of the same people in several cameras."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .body_box import GROUND_PLANE, MODEL, PackedCameras, box_and_slope
from .detections import DetectorModel, PackedDetections, axis_noise

MAX_RESIDUAL = 0.4
"""Boxes farther than this off, in heights, are of another person."""
ANGLES = 2
"""Angles of a camera: about the vertical, and about its horizontal axis."""


@kernel
def pose_residuals(
    mean: Floats,
    covariance: Floats,
    views: PackedCameras,
    boxes: PackedDetections,
    rates: DetectorModel,
    owner: Ints,
    good: Bools,
) -> Floats:
    """Normal equations of rotations of the cameras, from the boxes of one time step.

    The centre of a box is a function of the position and the height of the person and of two angles of the camera.
    Positions are eliminated without a prior, heights with that of the track: who is seen by one camera counts for
    nothing.

    Args:
        mean: (P, 6) people.
        covariance: (P, 6, 6).
        views: C cameras and sources of positions.
        boxes: M boxes of the time step.
        rates: of the detectors.
        owner: (M,) person of a box, or -1.
        good: (M,) boxes that are surely theirs.

    Returns:
        (2 C, 2 C + 1) N and b of N angles = b [rad].
    """
    C, M = views.lens.shape[0], boxes.box.shape[0]
    out = np.zeros((ANGLES * C, ANGLES * C + 1))
    box, slope, q, dq = np.empty(4), np.zeros((4, 6)), np.empty(3), np.empty(3)
    frame = np.zeros(M, dtype=np.int64)
    for k in range(boxes.camera.shape[0]):
        frame[boxes.first[k] : boxes.first[k + 1]] = k
    of, G, S = np.empty(M, dtype=np.int64), np.empty((M, 2, ANGLES)), np.empty((M, 2, 3))
    r, weight = np.empty((M, 2)), np.empty((M, 2))
    for i in range(mean.shape[0]):
        n = 0
        for j in range(M):
            if owner[j] != i or not good[j]:
                continue
            c = boxes.camera[frame[j]]
            lens = views.lens[c]
            delay = boxes.delay[frame[j]]
            if lens[MODEL] == GROUND_PLANE or box_and_slope(lens, mean[i], delay, box, slope) < 0.0:
                continue
            width, height = box[2] - box[0], box[3] - box[1]
            far = False
            for axis in range(2):
                weight[n, axis] = 1.0 / axis_noise(rates, axis, width, height, 1.0)[0]
                r[n, axis] = 0.5 * (boxes.box[j, axis] + boxes.box[j, axis + 2] - box[axis] - box[axis + 2])
                far |= abs(r[n, axis]) > MAX_RESIDUAL * height
                for k in range(3):
                    at = k if k < 2 else 4
                    S[n, axis, k] = 0.5 * (slope[axis, at] + slope[axis + 2, at])
            if far:
                continue
            # Derivatives of the centre of the body, in the camera's frame: rotations about the vertical and about x
            x, y = mean[i, 0] + delay * mean[i, 2] - lens[0], mean[i, 1] + delay * mean[i, 3] - lens[1]
            z = 0.5 * mean[i, 4] - lens[2]
            for k in range(3):
                q[k] = lens[3 + k] * x + lens[6 + k] * y + lens[9 + k] * z
            for angle in range(ANGLES):
                if angle == 0:
                    dq[0] = lens[11] * q[1] - lens[10] * q[2]
                    dq[1] = lens[9] * q[2] - lens[11] * q[0]
                    dq[2] = lens[10] * q[0] - lens[9] * q[1]
                else:
                    dq[0], dq[1], dq[2] = 0.0, q[2], -q[1]
                for axis in range(2):
                    G[n, axis, angle] = lens[12 + axis] * (dq[axis] - q[axis] * dq[2] / q[2]) / q[2]
            of[n] = c
            n += 1
        if n < 2:
            continue
        A, a = np.zeros((3, 3)), np.zeros(3)
        A[2, 2] = 1.0 / covariance[i, 4, 4]
        B, g = np.zeros((n, 3, ANGLES)), np.zeros((n, ANGLES))
        for m in range(n):
            for axis in range(2):
                w = weight[m, axis]
                for k in range(3):
                    a[k] += w * S[m, axis, k] * r[m, axis]
                    for l in range(3):  # noqa: E741 - a column
                        A[k, l] += w * S[m, axis, k] * S[m, axis, l]
                    for angle in range(ANGLES):
                        B[m, k, angle] += w * S[m, axis, k] * G[m, axis, angle]
                for angle in range(ANGLES):
                    g[m, angle] += w * G[m, axis, angle] * r[m, axis]
        inverse = np.linalg.inv(A)
        if not math.isfinite(inverse[0, 0]):
            continue
        for m in range(n):
            row = ANGLES * of[m]
            for p in range(ANGLES):
                out[row + p, ANGLES * C] += g[m, p]
                for axis in range(2):
                    for angle in range(ANGLES):
                        out[row + p, row + angle] += weight[m, axis] * G[m, axis, p] * G[m, axis, angle]
                for k in range(3):
                    share = 0.0
                    for l in range(3):  # noqa: E741 - a column
                        share += B[m, l, p] * inverse[l, k]
                    out[row + p, ANGLES * C] -= share * a[k]
                    for o in range(n):
                        for angle in range(ANGLES):
                            out[row + p, ANGLES * of[o] + angle] -= share * B[o, k, angle]
    return out
