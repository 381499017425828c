"""Boxes of people on the floor in the image of a camera, with the covariance of their centres."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel
from occlog.track.jipda.kernels.body_box import BOTTOM, LEFT, RIGHT, TOP, Views, box_and_slope


@kernel
def project(views: Views, c: int, mean: Floats, covariance: Floats, delay: float, out: Floats) -> None:
    """Write boxes and covariances of n people in camera c.

    Args:
        views: cameras.
        c: which of them.
        mean: (n, 6) states.
        covariance: (n, 6, 6) of them.
        delay: how much later than the states' time the camera looked [s].
        out: (n, 8) written: left, top, right, bottom [px], xx, xy and yy of the centre's covariance [px^2], and the
            depth; -1 where the person is behind the camera, and nothing else is written.
    """
    box, slope, centre = np.empty(4), np.empty((4, 6)), np.empty((2, 6))
    for k in range(mean.shape[0]):
        depth = box_and_slope(views.lens[c], mean[k], delay, box, slope)
        out[k, 7] = depth
        if depth < 0.0:
            continue
        out[k, :4] = box
        for i in range(6):
            centre[0, i] = 0.5 * (slope[LEFT, i] + slope[RIGHT, i])
            centre[1, i] = 0.5 * (slope[TOP, i] + slope[BOTTOM, i])
        for e in range(3):
            a, b = e // 2, (e + 1) // 2
            total = 0.0
            for i in range(6):
                for j in range(6):
                    total += centre[a, i] * covariance[k, i, j] * centre[b, j]
            out[k, 4 + e] = total
