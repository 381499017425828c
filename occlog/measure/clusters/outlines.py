"""Several people in one silhouette: outlines of people of the expected size, fitted to the foreground together.

Where people touch in the image their foreground is one region.  A cell of it is foreground unless nobody covers it,

    P(foreground) = 1 - (1 - SPECKS) prod_k (1 - p_k),

p_k the probability that a person at place k covers the cell: the model of a probabilistic occupancy map (Fleuret,
Berclaz, Lengagne and Fua 2008, IEEE T-PAMI 30(2), Eq. 12) in one image, with the outline of a walking person in place
of a rectangle.  Its logarithm, summed over the cells, is maximised: people are added one after another where they
explain most, all places and sizes are improved in turn, and the last one stays if the sum rises by enough.

Lengths are in cells; a foreground (rows, columns) holds shares of the cells, 0 to 1.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

from .person_size import Prior, place

SPECKS = 0.03
"""Probability that a cell is foreground which nobody covers."""
NEWCOMER = 0.45
"""What one more person must explain, in the logarithm of the likelihood per cell of a person."""
SIZE_COST = 10.0
"""Cost of the squared logarithm of a size relative to the expected one, in cells of a person."""
AREA = 0.175
"""Cells of a person over the square of the height."""
MOST_PEOPLE = 6
"""People in one silhouette."""
FINE = 14.0
"""Places are tried that are this part of a height apart."""
ROUNDS = 12
"""Most rounds in which places and sizes are improved."""
LEAST_COVER = 0.02
"""Cells that a person covers with a lower probability are passed over."""
SPAN = 0.5
"""Width of the outline's table over its height."""
WIDTH = 0.36
"""Width of a person's box over its height, seen from any side, on average."""
ROWS, COLUMNS = 24, 16
BANDS = np.array(
    # down to, probability in the middle, half of the width, softness of the sides
    [
        [0.15, 0.50, 0.050, 0.015],
        [0.50, 0.95, 0.125, 0.025],
        [0.68, 0.93, 0.110, 0.025],
        [1.00, 0.55, 0.140, 0.040],
    ]
)
"""Head, trunk, thighs, and legs that swing, in heights: how people cover what is behind them, on average of a walk."""


def _outline() -> Floats:
    """(ROWS, COLUMNS) log of the probability that a person does not cover a cell, from head to feet."""
    down, across = (np.arange(ROWS) + 0.5) / ROWS, SPAN * ((np.arange(COLUMNS) + 0.5) / COLUMNS - 0.5)
    _, most, half, soft = BANDS[np.searchsorted(BANDS[:, 0], down)].T
    cover = most[:, None] / (1.0 + np.exp((np.abs(across) - half[:, None]) / soft[:, None]))
    return np.log1p(-np.where(cover < LEAST_COVER, 0.0, cover))


OUTLINE = _outline()


@kernel
def expected_height(prior: Prior, x: float, y: float, side: int) -> float:
    """Height [cells] of a person whose middle is at a cell."""
    return math.sqrt(12.0 * prior.cov[place(prior, (x + 0.5) * side - 0.5, (y + 0.5) * side - 0.5), 2]) / side


@kernel
def _window(x: float, y: float, height: float, rows: int, columns: int) -> tuple[int, int, int, int]:
    """First row, row after the last, first column, column after the last that a person may cover."""
    top, bottom = max(math.ceil(y - 0.5 * height), 0), min(math.floor(y + 0.5 * height), rows - 1)
    half = 0.5 * SPAN * height
    left, right = max(math.ceil(x - half), 0), min(math.floor(x + half), columns - 1)
    return int(top), int(bottom) + 1, int(left), int(right) + 1


@kernel
def not_covered(x: float, y: float, height: float, column: int, row: int) -> float:
    """Log of the probability that a person with the middle at (x, y) does not cover a cell of their window."""
    down = min(max(int(((row - y) / height + 0.5) * ROWS), 0), ROWS - 1)
    across = min(max(int(((column - x) / (SPAN * height) + 0.5) * COLUMNS), 0), COLUMNS - 1)
    return float(OUTLINE[down, across])


@kernel
def _put(free: Floats, x: float, y: float, height: float, sign: float) -> None:
    """Add a person to the (rows, columns) logs of the probability that nobody covers a cell, or take them out."""
    top, bottom, left, right = _window(x, y, height, *free.shape)
    for row in range(top, bottom):
        for column in range(left, right):
            free[row, column] += sign * not_covered(x, y, height, column, row)


@kernel
def gain(foreground: Floats, free: Floats, x: float, y: float, height: float) -> float:
    """How much the log-likelihood rises with one more person.

    Args:
        foreground: (rows, columns) shares of the cells.
        free: (rows, columns) logs of the probability that none of the others covers a cell.
        x: middle of the person, as y.
        y: see x.
        height: of the person.
    """
    top, bottom, left, right = _window(x, y, height, *free.shape)
    total = 0.0
    for row in range(top, bottom):
        for column in range(left, right):
            mine = not_covered(x, y, height, column, row)
            if mine == 0.0:
                continue
            share = foreground[row, column]
            total += (1.0 - share) * mine
            if share > 0.0:
                nobody = (1.0 - SPECKS) * math.exp(free[row, column])
                total += share * (math.log1p(-nobody * math.exp(mine)) - math.log1p(-nobody))
    return total


@kernel
def _size_cost(height: float, size: float) -> float:
    """Cost of a person of a height who is `size` times as large as expected."""
    return SIZE_COST * AREA * height * height * math.log(size) ** 2


@kernel
def fit_outlines(foreground: Floats, prior: Prior, side: int, left: int, top: int) -> Floats:
    """The people (K, 3) in a silhouette: x, y of the middle and height [cells of the foreground]; none where none fits.

    Args:
        foreground: (rows, columns) shares of cells of one silhouette and its surroundings.
        prior: of the camera.
        side: of the cells [px].
        left: cells of the image left of the foreground.
        top: cells of the image above the foreground.
    """
    rows, columns = foreground.shape
    free = np.zeros((rows, columns))
    people = np.zeros((MOST_PEOPLE, 4))  # x, y, height, size
    count = 0
    while count < MOST_PEOPLE:
        # Add: the place that explains most of what is left
        best, at_x, at_y, tall = 0.0, 0.0, 0.0, 1.0
        for row in range(rows):
            for column in range(columns):
                if foreground[row, column] < 0.5:
                    continue
                height = expected_height(prior, column + left, row + top, side)
                step = max(1, int(height / FINE))
                if column % step != 0 or row % step != 0:
                    continue
                found = gain(foreground, free, float(column), float(row), height)
                if found > best:
                    best, at_x, at_y, tall = found, float(column), float(row), height
        if best <= 0.0:
            break
        before = people[:count].copy()
        people[count] = at_x, at_y, tall, 1.0
        _put(free, at_x, at_y, tall, 1.0)
        count += 1
        risen = best + _improve(foreground, free, people[:count], prior, side, left, top)
        if risen < NEWCOMER * AREA * tall * tall:
            count -= 1
            people[:count] = before
            break
    return people[:count, :3].copy()


@kernel
def _improve(foreground: Floats, free: Floats, people: Floats, prior: Prior, side: int, left: int, top: int) -> float:
    """Improve places and sizes of all people (K, 4) in turn, in steps that get finer; how much it is worth."""
    step, risen = max(1.0, people[-1, 2] / FINE), 0.0
    for _ in range(ROUNDS):
        moved = False
        for k in range(people.shape[0]):
            x, y, height, size = people[k]
            _put(free, x, y, height, -1.0)
            start = gain(foreground, free, x, y, height) - _size_cost(height, size)
            best = start
            for move in range(6):
                new_x, new_y, new_size = x, y, size
                sign = 1.0 if move % 2 == 0 else -1.0
                if move < 2:
                    new_x += sign * step
                elif move < 4:
                    new_y += sign * step
                else:
                    new_size *= math.exp(sign * step / height)
                new_height = new_size * expected_height(prior, new_x + left, new_y + top, side)
                found = gain(foreground, free, new_x, new_y, new_height) - _size_cost(new_height, new_size)
                if found > best + 1e-9:
                    best = found
                    people[k] = new_x, new_y, new_height, new_size
            _put(free, people[k, 0], people[k, 1], people[k, 2], 1.0)
            moved = moved or best > start
            risen += best - start
        if not moved:
            if step <= 0.5:
                break
            step *= 0.5
    return risen
