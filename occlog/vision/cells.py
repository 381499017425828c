"""Foreground pixels gathered in small square cells, with exact moments: what clustering works on.

A row of a cell table is (n, x, y, xx, xy, yy): number of foreground pixels, their mean
[px], and the sums of squares and products about that mean [px^2].  Sums over cells are
therefore sums over pixels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.jit import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]


@kernel
def gather(mask: Bytes, side: int) -> tuple[Floats, Ints]:
    """Cells that hold foreground, row by row.

    Args:
        mask: (height, width), non-zero on the foreground.
        side: of a cell [px]; cells at the right and lower edges may be smaller.

    Returns:
        Cell table (N, 6), and (N, 2) left and upper pixel of each cell.
    """
    height, width = mask.shape
    rows, columns = (height + side - 1) // side, (width + side - 1) // side
    cells = np.empty((rows * columns, 6))
    corners = np.empty((rows * columns, 2), dtype=np.int64)
    occupied = np.empty(width, dtype=np.uint8)
    n_cells = 0
    for row in range(rows):
        top, bottom = row * side, min(row * side + side, height)
        # Columns with any foreground first: a plain loop that the compiler makes fast.
        occupied[:] = 0
        for y in range(top, bottom):
            line = mask[y]
            for x in range(width):
                occupied[x] |= line[x]
        for left in range(0, width, side):
            right = min(left + side, width)
            found = False
            for x in range(left, right):
                found |= occupied[x] != 0
            if not found:
                continue
            _moments_into(cells[n_cells], mask[top:bottom, left:right], left, top)
            corners[n_cells] = left, top
            n_cells += 1
    return cells[:n_cells].copy(), corners[:n_cells].copy()


@kernel
def _moments_into(cell: Floats, mask: Bytes, left: int, top: int) -> None:
    """Count, mean and scatter of the foreground of one cell, which must not be empty."""
    n = sx = sy = xx = xy = yy = 0
    for y in range(mask.shape[0]):
        for x in range(mask.shape[1]):
            if mask[y, x]:
                n += 1
                sx += x
                sy += y
                xx += x * x
                xy += x * y
                yy += y * y
    mx, my = sx / n, sy / n
    cell[0] = n
    cell[1], cell[2] = left + mx, top + my
    cell[3], cell[4], cell[5] = xx - n * mx * mx, xy - n * mx * my, yy - n * my * my
