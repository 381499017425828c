"""Normal equations of the cameras' clock offsets, from residuals of boxes along the velocities of people."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from ..body_box import MODEL, POSITION_SOURCE, PackedCameras, box_and_slope
from ..detections import PackedDetections

MAX_RESIDUAL = 0.4
"""Boxes farther than this off, in heights, are of another person."""


@kernel
def clock_residuals(
    mean: Floats, views: PackedCameras, boxes: PackedDetections, owner: Ints, good: Bools, late: Floats, centre: Floats
) -> tuple[Floats, Floats]:
    """Return normal equations of the cameras' clock offsets from the boxes of one time step.

    The residual of a camera that is late by d is (m - d) v, with v the velocity in the image, and m the mean delay of
    the person's track, which follows all cameras. Elimination of m gives N d = b, with N a graph Laplacian: only
    differences of d between cameras that see the same people are observable.

    Args:
        mean: (P, 6) predicted x, y, vx, vy, height, width of the people.
        views: C cameras and position sensors.
        boxes: M boxes of the time step; `delay` includes the correction by `late`.
        owner: (M,) index of the person of a box, or -1.
        good: (M,) whether a box is surely of its owner; others are not used.
        late: (C,) offset [s] by which each camera's frames are corrected in `delay`.
        centre: (C, 4) mean residuals (u, v) [box heights] and mean velocities [box heights/s] of each camera, which are
            subtracted: a pose that is wrong shifts boxes, too.

    Returns:
        (C, C + 1) N and, in the last column, b, for offsets in s; (C, 5) number of boxes, and sums of their residuals
        (u, v) and velocities (u, v), before `centre` is subtracted.
    """
    C, M = views.lens.shape[0], boxes.box.shape[0]
    normal, sums = np.zeros((C, C + 1)), np.zeros((C, 5))
    box, slope, r, v = np.empty(4), np.zeros((4, 6)), np.empty(2), np.empty(2)
    square, product, of = np.empty(M), np.empty(M), np.empty(M, dtype=np.int64)
    frame = np.zeros(M, dtype=np.int64)
    for k in range(boxes.camera.shape[0]):
        frame[boxes.first[k] : boxes.first[k + 1]] = k
    for i in range(mean.shape[0]):
        n = 0
        for j in range(M):
            if owner[j] != i or not good[j]:
                continue
            c = boxes.camera[frame[j]]
            if box_and_slope(views.lens[c], mean[i], boxes.delay[frame[j]], box, slope) < 0.0:
                continue
            height = mean[i, 4] if views.lens[c, MODEL] == POSITION_SOURCE else box[3] - box[1]
            far = False
            for axis in range(2):
                v[axis] = (
                    0.5
                    / height
                    * (
                        (slope[axis, 0] + slope[axis + 2, 0]) * mean[i, 2]
                        + (slope[axis, 1] + slope[axis + 2, 1]) * mean[i, 3]
                    )
                )
                r[axis] = 0.5 / height * (boxes.box[j, axis] + boxes.box[j, axis + 2] - box[axis] - box[axis + 2])
                far |= abs(r[axis]) > MAX_RESIDUAL
                # As without the correction
                r[axis] -= late[c] * v[axis]
            if far:
                continue
            sums[c, 0] += 1.0
            product[n], square[n], of[n] = 0.0, 0.0, c
            for axis in range(2):
                sums[c, 1 + axis] += r[axis]
                sums[c, 3 + axis] += v[axis]
                product[n] -= (r[axis] - centre[c, axis]) * (v[axis] - centre[c, 2 + axis])
                square[n] += (v[axis] - centre[c, 2 + axis]) ** 2
            n += 1
        total, weight = product[:n].sum(), square[:n].sum()
        if n < 2 or weight <= 0.0:
            continue
        for a in range(n):
            normal[of[a], of[a]] += square[a]
            normal[of[a], C] += product[a] - square[a] / weight * total
            for b in range(n):
                normal[of[a], of[b]] -= square[a] * square[b] / weight
    return normal, sums
