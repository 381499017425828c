"""Visibility of each person among the others: occlusion of a grid of lines of sight over the body.

For a line of sight to one position, [Ercan] Eq. 7 gives P = prod_j (1 - q_j), with q_j the probability that the centre
of occluder j lies in the rectangle around the line of sight. Here the same product is formed in the image for a grid of
cells of a body, so that it states which part is occluded: q_j is the probability that person j exists, is nearer to the
camera, and has a box that covers the cell, given the uncertainty of both people's positions across the line of sight
and along it.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

from .body_box import MODEL, POSITION_SOURCE, PackedCameras

COLUMNS, ROWS = 5, 6
ROOT_HALF = math.sqrt(0.5)
NORMAL_TAIL_SIGMAS = 6.0
"""Truncation of normal distributions, in standard deviations."""


@kernel
def normal_cdf(z: float) -> float:
    """Standard normal distribution function; 0 or 1 beyond `NORMAL_TAIL_SIGMAS`."""
    if z < -NORMAL_TAIL_SIGMAS:
        return 0.0
    if z > NORMAL_TAIL_SIGMAS:
        return 1.0
    return 0.5 * math.erfc(-z * ROOT_HALF)


@kernel
def in_view(views: PackedCameras, c: int, x: float, y: float, box: Floats, cells: Floats) -> bool:
    """Return whether a person at (x, y) is in range of camera `c`, with a cell of the `box` (4,) [px] in its image.

    Write the grid `cells` (ROWS, COLUMNS) of the box: 1 inside the image, else 0. A position sensor covers a rectangle
    of the ground, with all cells 1.
    """
    if views.lens[c, MODEL] == POSITION_SOURCE:
        cells[:] = 1.0
        low, high = views.lens[c, :2], views.lens[c, 2:4]
        return bool(low[0] <= x <= high[0] and low[1] <= y <= high[1])
    if inside_image(box, views.size[c, 0], views.size[c, 1], cells) == 0.0:
        return False
    return bool(math.hypot(x - views.position[c, 0], y - views.position[c, 1]) <= views.range[c])


@kernel
def visibility(
    views: PackedCameras,
    c: int,
    state: Floats,
    i: int,
    box: Floats,
    depth: Floats,
    spread_px: Floats,
    spread_depth: Floats,
    existence: Floats,
    cells: Floats,
) -> float:
    """Return the expected visible share, 0 to 1, of person i in camera c, given border, static occluders and people.

    Args:
        views: cameras and static occluders.
        c: index of the camera.
        state: (6,) x, y, vx, vy, height, width of the person.
        i: index of the person among the N people.
        box: (N, 4) expected left, top, right, bottom [px].
        depth: (N,) depth along the optical axis; negative: not in front of the camera.
        spread_px: (N,) standard deviation of the box's horizontal centre [px].
        spread_depth: (N,) standard deviation of the depth, > 0.
        existence: (N,) existence probabilities of the people.
        cells: (ROWS, COLUMNS) written: probability that each cell of the person's box is visible; top row first.
    """
    if views.lens[c, MODEL] == POSITION_SOURCE:
        cells[:] = 1.0
        return 1.0
    inside_image(box[i], views.size[c, 0], views.size[c, 1], cells)
    occlude_by_static(views, c, state[0], state[1], state[4], state[5], cells)
    cells_unoccluded_by(i, box, depth, spread_px, spread_depth, existence, cells)
    return float(np.mean(cells))


@kernel
def visible_feet(cells: Floats) -> float:
    """Return the expected visible share of the feet: the mean over the lowest row of `cells` (ROWS, COLUMNS).

    `cells` are the probabilities that the cells of a person's box are visible.
    """
    bottom = 0.0
    for column in range(COLUMNS):
        bottom += cells[ROWS - 1, column]
    return bottom / COLUMNS


@kernel
def centre_deviation(spread: Floats) -> float:
    """Return the standard deviation [px] of a box's horizontal centre.

    `spread` (4, 4) is the covariance of the edges left, top, right, bottom [px^2].
    """
    return math.sqrt(0.25 * max(spread[0, 0] + 2.0 * spread[0, 2] + spread[2, 2], 0.0))


@kernel
def cells_unoccluded_by(
    i: int,
    boxes: Floats,
    depth: Floats,
    spread_px: Floats,
    spread_depth: Floats,
    existence: Floats,
    cells: Floats,
) -> None:
    """Multiply the visibility of the cells of person i by the probability that no other person occludes each, in place.

    Args:
        i: index of the person.
        boxes: (N, 4) expected left, top, right, bottom [px].
        depth: (N,) depth along the optical axis; negative: not in front of the camera.
        spread_px: (N,) standard deviation of the box's horizontal centre [px].
        spread_depth: (N,) standard deviation of the depth, > 0.
        existence: (N,) existence probabilities of the people.
        cells: (ROWS, COLUMNS) probabilities of visibility of the cells of the person's box, top row first; changed.
    """
    left, top, right, bottom = boxes[i]
    for j in range(boxes.shape[0]):
        if j == i or depth[j] < 0.0:
            continue
        spread = math.sqrt(spread_px[i] ** 2 + spread_px[j] ** 2) + 1e-9
        reach = NORMAL_TAIL_SIGMAS * spread
        if boxes[j, 0] > right + reach or boxes[j, 2] < left - reach or boxes[j, 1] > bottom or boxes[j, 3] < top:
            continue
        # Nearer than i, by the normal distribution of the difference of depths
        depth_deviation = math.sqrt(spread_depth[i] ** 2 + spread_depth[j] ** 2)
        nearer = existence[j] * normal_cdf((depth[i] - depth[j]) / depth_deviation)
        if nearer < 1e-3:
            continue
        for column in range(COLUMNS):
            u = left + (right - left) * (column + 0.5) / COLUMNS
            across = normal_cdf((boxes[j, 2] - u) / spread) - normal_cdf((boxes[j, 0] - u) / spread)
            if across < 1e-3:
                continue
            for row in range(ROWS):
                v = top + (bottom - top) * (row + 0.5) / ROWS
                if boxes[j, 1] < v < boxes[j, 3]:
                    cells[row, column] *= 1.0 - nearer * across


@kernel
def inside_image(box: Floats, width: float, height: float, cells: Floats) -> float:
    """Write the grid `cells` (ROWS, COLUMNS) of a `box` (4,): 1 inside a width x height image [px], 0 outside.

    Return the share of the cells inside.
    """
    count = 0
    for row in range(ROWS):
        v = box[1] + (box[3] - box[1]) * (row + 0.5) / ROWS
        for column in range(COLUMNS):
            u = box[0] + (box[2] - box[0]) * (column + 0.5) / COLUMNS
            inside = -0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5
            cells[row, column] = 1.0 if inside else 0.0
            count += 1 if inside else 0
    return count / (ROWS * COLUMNS)


@kernel
def occlude_by_static(
    views: PackedCameras, c: int, x: float, y: float, height: float, width: float, cells: Floats
) -> None:
    """Set those cells (ROWS, COLUMNS) of a person to 0 that a static occluder hides from camera c, in place.

    Cells are points of the upright rectangle through the person's axis that faces the camera. A line of sight passes
    above an occluder if it is higher than its top over the whole crossing; an occluder around the camera hides nothing.

    Args:
        views: cameras and static occluders.
        c: index of the camera.
        x: first coordinate of the person on the floor.
        y: second coordinate of the person on the floor.
        height: height of the person.
        width: width of the person.
        cells: probability of visibility of the person's cells, top row first; changed.
    """
    if views.top.shape[0] == 0 or views.lens[c, MODEL] == POSITION_SOURCE:
        return
    cx, cy, cz = views.position[c]
    away = math.hypot(x - cx, y - cy)
    if away == 0.0:
        return
    right_x, right_y = (y - cy) / away, -(x - cx) / away
    for column in range(COLUMNS):
        side = width * ((column + 0.5) / COLUMNS - 0.5)
        dx, dy = x + side * right_x - cx, y + side * right_y - cy
        for w in range(views.top.shape[0]):
            begin, end = views.first[w], views.first[w + 1]
            # Where the line of sight is over the polygon: from `enter` to `leave`, as shares of its length
            enter, leave, around, within = 2.0, -1.0, False, False
            for k in range(begin, end):
                n = k + 1 if k + 1 < end else begin
                ax, ay = views.corner[k, 0] - cx, views.corner[k, 1] - cy
                bx, by = views.corner[n, 0] - cx, views.corner[n, 1] - cy
                # Rays towards +x from the camera and from the person cross the border an odd number of times inside
                if (ay > 0.0) != (by > 0.0) and ax - ay * (bx - ax) / (by - ay) > 0.0:
                    around = not around
                if (ay > dy) != (by > dy) and ax + (dy - ay) * (bx - ax) / (by - ay) > dx:
                    within = not within
                cross = dx * (by - ay) - dy * (bx - ax)
                if cross != 0.0:
                    along = (ax * (by - ay) - ay * (bx - ax)) / cross
                    on = (ax * dy - ay * dx) / cross
                    if 0.0 <= along <= 1.0 and 0.0 <= on <= 1.0:
                        enter, leave = min(enter, along), max(leave, along)
            if within:
                leave = 1.0
            if around or enter > leave:
                continue
            for row in range(ROWS):
                rise = height * (1.0 - (row + 0.5) / ROWS) - cz
                if min(cz + enter * rise, cz + leave * rise) < views.top[w]:
                    cells[row, column] = 0.0
