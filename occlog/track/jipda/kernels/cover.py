"""How much of each person a camera sees among the others: a grid of sight lines over the body.

For a sight line to one place, [Ercan] Eq. 7 gives P = prod_j (1 - q_j), q_j the probability that occluder j's centre
lies in the rectangle around the sight line.  Here the same product is formed in the image for a grid of places of a
body, so that it says which part is covered: q_j is the probability that person j exists, is nearer to the camera, and
that j's box holds the place, with the spread of both people's places across the sight line and along it.
"""

from __future__ import annotations

import math

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

COLUMNS, ROWS = 5, 6
ROOT_HALF = math.sqrt(0.5)
SHARP = 6.0
"""Beyond so many standard deviations a normal distribution is over."""


@kernel
def below(z: float) -> float:
    """Standard normal distribution function; 0 or 1 beyond `SHARP`."""
    if z < -SHARP:
        return 0.0
    if z > SHARP:
        return 1.0
    return 0.5 * math.erfc(-z * ROOT_HALF)


@kernel
def clear_cells(
    i: int,
    boxes: Floats,
    depth: Floats,
    spread_px: Floats,
    spread_depth: Floats,
    existence: Floats,
    cells: Floats,
) -> None:
    """Multiply (ROWS, COLUMNS) probabilities of seeing the cells of person i by those that no other person covers them.

    Args:
        i: the person.
        boxes: (N, 4) expected boxes [px].
        depth: (N,) along the optical axis; negative: not in front of the camera.
        spread_px: (N,) standard deviation of the box's middle, across the image [px].
        spread_depth: (N,) standard deviation of the depth, > 0.
        existence: (N,) probabilities that the others are there.
        cells: (ROWS, COLUMNS) in place, from the top and from the left.
    """
    left, top, right, bottom = boxes[i]
    for j in range(boxes.shape[0]):
        if j == i or depth[j] < 0.0:
            continue
        spread = math.sqrt(spread_px[i] ** 2 + spread_px[j] ** 2) + 1e-9
        reach = SHARP * spread
        if boxes[j, 0] > right + reach or boxes[j, 2] < left - reach or boxes[j, 1] > bottom or boxes[j, 3] < top:
            continue
        # Nearer than i, by the normal distribution of the difference of depths
        apart = math.sqrt(spread_depth[i] ** 2 + spread_depth[j] ** 2)
        nearer = existence[j] * below((depth[i] - depth[j]) / apart)
        if nearer < 1e-3:
            continue
        for column in range(COLUMNS):
            u = left + (right - left) * (column + 0.5) / COLUMNS
            across = below((boxes[j, 2] - u) / spread) - below((boxes[j, 0] - u) / spread)
            if across < 1e-3:
                continue
            for row in range(ROWS):
                v = top + (bottom - top) * (row + 0.5) / ROWS
                if boxes[j, 1] < v < boxes[j, 3]:
                    cells[row, column] *= 1.0 - nearer * across


@kernel
def inside_image(box: Floats, width: float, height: float, cells: Floats) -> float:
    """Write 1 to the cells (ROWS, COLUMNS) of a box in the image and 0 to the others; give the share inside."""
    count = 0
    for row in range(ROWS):
        v = box[1] + (box[3] - box[1]) * (row + 0.5) / ROWS
        for column in range(COLUMNS):
            u = box[0] + (box[2] - box[0]) * (column + 0.5) / COLUMNS
            inside = -0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5
            cells[row, column] = 1.0 if inside else 0.0
            count += 1 if inside else 0
    return count / (ROWS * COLUMNS)
