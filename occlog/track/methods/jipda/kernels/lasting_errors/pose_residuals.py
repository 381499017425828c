"""Errors of the cameras' orientations, from boxes of the same people in several cameras."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from ..body_box import MODEL, POSITION_SOURCE, PackedCameras, box_and_slope
from ..detections import DetectorModel, PackedDetections, axis_noise

MAX_RESIDUAL = 0.4
"""Boxes farther than this off, in heights, are of another person."""
ANGLES = 2
"""Angles of a camera: about the vertical, and about its horizontal axis."""
POSE_ERRORS = 5
"""Errors of a camera's pose: these angles, and shifts along x, y and z of the world."""
STATES = 3
"""Position on the ground and height of a person, which are eliminated."""


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
    """Return normal equations of camera rotations from the boxes of one time step.

    The centre of a box depends on position and height of the person and on two angles of the camera. Positions are
    eliminated without a prior, heights with that of the track; people seen by a single camera contribute nothing.

    Args:
        mean: (P, 6) x, y, vx, vy, height, width of the people.
        covariance: (P, 6, 6) of these states; the variance of the height is used.
        views: C cameras and position sensors.
        boxes: M boxes of the time step, packed.
        rates: parameters of the cameras' detectors.
        owner: (M,) index of the person of a box, or -1.
        good: (M,) whether a box is surely of its owner; others are not used.

    Returns:
        (2 C, 2 C + 1) N and, in the last column, b of N a = b, with the angles a [rad] of each camera about the
        vertical and about its horizontal axis.
    """
    angles, M = ANGLES * views.lens.shape[0], boxes.box.shape[0]
    out = np.zeros((angles, angles + 1))
    frame = np.zeros(M, dtype=np.int64)
    for k in range(boxes.camera.shape[0]):
        frame[boxes.first[k] : boxes.first[k + 1]] = k
    for i in range(mean.shape[0]):
        # Columns: position and height of the person, angles, residual; two rows a box
        rows, n = np.zeros((2 * M, STATES + angles + 1)), 0
        for j in range(M):
            if owner[j] == i and good[j]:
                c, delay = boxes.camera[frame[j]], boxes.delay[frame[j]]
                n += centre_rows(mean[i], c, views.lens[c], delay, boxes.box[j], rates, rows[n : n + 2])
        if n < 4:
            continue
        normal = rows[:n].T @ rows[:n]
        normal[2, 2] += 1.0 / covariance[i, 4, 4]
        inverse = np.linalg.inv(normal[:STATES, :STATES])
        if math.isfinite(inverse[0, 0]):
            cross = np.ascontiguousarray(normal[:STATES, STATES:])
            out += (normal[STATES:, STATES:] - (cross.T @ inverse) @ cross)[:-1]
    return out


@kernel
def centre_rows(
    state: Floats, camera: int, lens: Floats, delay: float, box: Floats, rates: DetectorModel, out: Floats
) -> int:
    """Fill the two rows of a box in the least squares of camera angles: Jacobian and residual of its centre.

    Rows (x, y) are divided by the standard deviation of the centre. Columns: the person's x, y and height; two angles
    of each camera; the residual.

    Args:
        state: (6,) x, y, vx, vy, height, width of the person.
        camera: index of the camera.
        lens: (LENS,) row of the camera in `PackedCameras.lens`.
        delay: time of the frame after that of the state [s].
        box: (4,) left, top, right, bottom [px].
        rates: parameters of the cameras' detectors.
        out: (2, 3 + 2 C + 1) zeros; filled.

    Returns:
        Number of filled rows: 2, or 0 for a position sensor, a person out of view, or a box farther than `MAX_RESIDUAL`
        heights from the expected one.
    """
    expected, slope = np.empty(4), np.zeros((4, 6))
    if lens[MODEL] == POSITION_SOURCE or box_and_slope(lens, state, delay, expected, slope) < 0.0:
        return 0
    width, height = expected[2] - expected[0], expected[3] - expected[1]
    residual = 0.5 * (box[:2] + box[2:] - expected[:2] - expected[2:])
    if np.abs(residual).max() > MAX_RESIDUAL * height:
        return 0
    moves = centre_slopes(lens, state, delay)
    for axis in range(2):
        weight = math.sqrt(1.0 / axis_noise(rates, axis, width, height, 1.0)[0])
        for k, column in enumerate((0, 1, 4)):
            out[axis, k] = weight * 0.5 * (slope[axis, column] + slope[axis + 2, column])
        for angle in range(ANGLES):
            out[axis, STATES + ANGLES * camera + angle] = weight * moves[axis, angle]
        out[axis, -1] = weight * residual[axis]
    return 2


@kernel
def centre_slopes(lens: Floats, state: Floats, delay: float) -> Floats:
    """Return the derivatives of the centre of a body's image with respect to errors of the camera's pose.

    The lens is taken as free of distortion.

    Args:
        lens: (LENS,) row of the camera in `PackedCameras.lens`.
        state: (6,) x, y, vx, vy, height, width of the person.
        delay: time of the frame after that of the state [s].

    Returns:
        (2, 5) derivatives of x and y [px]. Columns: rotation about the vertical and about the camera's horizontal axis
        [px/rad]; shift of the camera along x, y and z of the world [px per scene unit].
    """
    out = np.empty((2, POSE_ERRORS))
    x, y = state[0] + delay * state[2] - lens[0], state[1] + delay * state[3] - lens[1]
    z = 0.5 * state[4] - lens[2]
    # The centre of the body in the camera's frame
    q = lens[3:6] * x + lens[6:9] * y + lens[9:12] * z
    up = lens[9:12]
    moved = np.empty((POSE_ERRORS, 3))
    moved[0] = (up[2] * q[1] - up[1] * q[2], up[0] * q[2] - up[2] * q[0], up[1] * q[0] - up[0] * q[1])
    moved[1] = (0.0, q[2], -q[1])
    for axis in range(3):
        moved[2 + axis] = -lens[3 + 3 * axis : 6 + 3 * axis]
    for axis in range(2):
        for error in range(POSE_ERRORS):
            dq = moved[error]
            out[axis, error] = lens[12 + axis] * (dq[axis] - q[axis] * dq[2] / q[2]) / q[2]
    return out
