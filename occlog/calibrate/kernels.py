"""Expected boxes of many people in many cameras, with derivatives."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.track.methods.jipda.kernels.body_box import box_and_slope, expected_box


@kernel
def boxes_and_slopes(
    lens: Floats, camera: Ints, state: Floats, delay: Floats, box: Floats, slope: Floats, good: Bools
) -> None:
    """Write the expected boxes of N observations and their Jacobians with respect to the states.

    Args:
        lens: (C, LENS) cameras, as `PackedCameras.lens`.
        camera: (N,) index of the camera of each observation.
        state: (N, 6) x, y, vx, vy, height and width of the person.
        delay: (N,) time from the state to the observation [s].
        box: (N, 4) filled: left, top, right, bottom [px].
        slope: (N, 4, 6) filled: derivatives of the edges by the state.
        good: (N,) filled: whether the person is in front of the camera.
    """
    for n in range(camera.shape[0]):
        good[n] = box_and_slope(lens[camera[n]], state[n], delay[n], box[n], slope[n]) > 0.0


@kernel
def expected_boxes(lens: Floats, camera: Ints, state: Floats, delay: Floats, box: Floats) -> None:
    """Write the expected box of each of N observations to `box` (N, 4) [px]; NaN behind the camera.

    Args:
        lens: (C, LENS) cameras, as `PackedCameras.lens`.
        camera: (N,) index of the camera of each observation.
        state: (N, 6) x, y, vx, vy, height and width of the person.
        delay: (N,) time from the state to the observation [s].
        box: (N, 4) filled: left, top, right, bottom.
    """
    for n in range(camera.shape[0]):
        x, y = state[n, 0] + delay[n] * state[n, 2], state[n, 1] + delay[n] * state[n, 3]
        if expected_box(lens[camera[n]], x, y, state[n, 4], state[n, 5], box[n]) < 0.0:
            box[n, :] = np.nan
