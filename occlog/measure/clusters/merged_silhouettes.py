"""Merged silhouettes: several people in one foreground region.

People who overlap considerably in the image are not separated by Gaussian clusters. Their silhouette is explained by
outlines of people of the expected size, fitted jointly. A cell is foreground unless no person covers it,

    P(foreground) = 1 - (1 - SPECKS) prod_k (1 - p_k),

p_k the probability that a person at position k covers the cell: the model of a probabilistic occupancy map (Fleuret,
Berclaz, Lengagne and Fua 2008, IEEE T-PAMI 30(2), Eq. 12) in one image, with the outline of a walking person instead of
a rectangle. The log likelihood over the cells is maximised: people are added one after another where the gain is
largest, all positions and sizes are refined in turn, and the last one is kept if the gain is sufficient.

Lengths are in cells; a foreground (rows, columns) holds shares of the cells, 0 to 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.core.numerics.jit import kernel

from .person_size import Prior, grid_cell, person_at
from .stage import Clusters

CLUTTER_PROBABILITY = 0.03
"""Probability that a cell without a person is foreground."""
MIN_LOG_LIKELIHOOD_GAIN = 0.45
"""Minimum gain in log-likelihood for one more person, per cell of a person."""
SIZE_COST = 10.0
"""Cost of the squared logarithm of a size relative to the expected one, in cells of a person."""
AREA = 0.175
"""Cells of a person over the square of the height."""
MAX_PEOPLE = 6
"""People in one silhouette."""
FINE = 14.0
"""Positions are tried that are this part of a height apart."""
ROUNDS = 12
"""Maximum number of rounds that improve positions and sizes."""
MIN_COVER = 0.02
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
"""Head, trunk, thighs, and legs that swing, in heights: share of background covered, on average over a walk."""


def _outline() -> Floats:
    """(ROWS, COLUMNS) log of the probability that a person does not cover a cell, from head to feet."""
    down, across = (np.arange(ROWS) + 0.5) / ROWS, SPAN * ((np.arange(COLUMNS) + 0.5) / COLUMNS - 0.5)
    _, most, half, soft = BANDS[np.searchsorted(BANDS[:, 0], down)].T
    cover = most[:, None] / (1.0 + np.exp((np.abs(across) - half[:, None]) / soft[:, None]))
    return np.log1p(-np.where(cover < MIN_COVER, 0.0, cover))


OUTLINE = _outline()


@kernel
def expected_height(prior: Prior, x: float, y: float, side: int) -> float:
    """Height [cells] of a person with the centre at column x and row y of the grid; `side` is that of a cell [px].

    By the size map `prior` of the camera.
    """
    return math.sqrt(12.0 * prior.cov[grid_cell(prior, (x + 0.5) * side - 0.5, (y + 0.5) * side - 0.5), 2]) / side


@kernel
def _window(x: float, y: float, height: float, rows: int, columns: int) -> tuple[int, int, int, int]:
    """Range of cells that a person may cover: first row, row after the last, first column, column after the last.

    Args:
        x: column of the person's centre [cells].
        y: row of the centre [cells].
        height: height of the person [cells].
        rows: number of rows of the grid.
        columns: number of columns of the grid.
    """
    top, bottom = max(math.ceil(y - 0.5 * height), 0), min(math.floor(y + 0.5 * height), rows - 1)
    half = 0.5 * SPAN * height
    left, right = max(math.ceil(x - half), 0), min(math.floor(x + half), columns - 1)
    return int(top), int(bottom) + 1, int(left), int(right) + 1


@kernel
def not_covered(x: float, y: float, height: float, column: int, row: int) -> float:
    """Log probability that a person with centre (x, y) and a height, all in cells, does not cover a cell.

    `column` and `row` are those of the cell, which must be within half a height of the centre, and in the person's
    width.
    """
    down = min(max(int(((row - y) / height + 0.5) * ROWS), 0), ROWS - 1)
    across = min(max(int(((column - x) / (SPAN * height) + 0.5) * COLUMNS), 0), COLUMNS - 1)
    return float(OUTLINE[down, across])


@kernel
def _put(free: Floats, x: float, y: float, height: float, sign: float) -> None:
    """Add (sign 1) or remove (sign -1) a person with centre (x, y) and a height, all in cells, in place.

    `free` (rows, columns) has the log probability of each cell that no person covers it.
    """
    top, bottom, left, right = _window(x, y, height, *free.shape)
    for row in range(top, bottom):
        for column in range(left, right):
            free[row, column] += sign * not_covered(x, y, height, column, row)


@kernel
def gain(foreground: Floats, free: Floats, x: float, y: float, height: float) -> float:
    """Gain in log-likelihood of a silhouette from one more person.

    Args:
        foreground: (rows, columns) share of each cell that is foreground, 0 to 1.
        free: (rows, columns) log probability of each cell that none of the other people covers it.
        x: column of the person's centre [cells].
        y: row of the person's centre [cells].
        height: height of the person [cells].
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
                clutter = (1.0 - CLUTTER_PROBABILITY) * math.exp(free[row, column])
                total += share * (math.log1p(-clutter * math.exp(mine)) - math.log1p(-clutter))
    return total


@kernel
def _size_cost(height: float, size: float) -> float:
    """Cost in log-likelihood of a person with a height [cells] that is `size` times the expected one."""
    return SIZE_COST * AREA * height * height * math.log(size) ** 2


@kernel
def fit_outlines(foreground: Floats, prior: Prior, side: int, left: int, top: int) -> Floats:
    """Fit people (K, 3: centre x, y and height [cells]) to a silhouette; empty if none fits.

    People are added greedily, all positions and sizes refined in turn, up to `MAX_PEOPLE`. Centres are relative to the
    given foreground.

    Args:
        foreground: (rows, columns) share of each cell that is foreground, 0 to 1, in a part of the image around one
            silhouette.
        prior: size map of people for the camera.
        side: side of a cell [px].
        left: number of cells of the image left of this part.
        top: number of cells of the image above this part.
    """
    rows, columns = foreground.shape
    free = np.zeros((rows, columns))
    people = np.zeros((MAX_PEOPLE, 4))  # x, y, height, size
    count = 0
    while count < MAX_PEOPLE:
        # Add: the position that explains most of the rest
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
        if risen < MIN_LOG_LIKELIHOOD_GAIN * AREA * tall * tall:
            count -= 1
            people[:count] = before
            break
    return people[:count, :3].copy()


@kernel
def _improve(foreground: Floats, free: Floats, people: Floats, prior: Prior, side: int, left: int, top: int) -> float:
    """Refine positions and sizes of all people in turn, in decreasing steps, in place; return the log-likelihood gain.

    Args:
        foreground: (rows, columns) share of each cell that is foreground, 0 to 1.
        free: (rows, columns) log probabilities that no person covers a cell, updated in place.
        people: (K, 4) centre x, y, height [cells], and height over the expected one, updated in place.
        prior: size map of people for the camera.
        side: side of a cell [px].
        left: number of cells of the image left of the foreground.
        top: number of cells of the image above the foreground.
    """
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


MIN_WIDTH_RATIO, MIN_HEIGHT_RATIO = 1.25, 1.15
"""A silhouette that is larger than the box of a person by one of these factors may hold several."""
MIN_SHARE = 0.02
"""Silhouettes with fewer cells are specks, in squares of the height of a person."""
MIN_FOREGROUND_SHARE = 0.3
"""Share of foreground from which a cell joins its neighbours."""
DIVIDED = 0.1
"""Silhouettes are left to the clusters that hold a larger share than this of one that goes on in another silhouette:
something in front of the people divides them, and outlines of whole people fit neither part."""
AROUND = 0.5
"""Heights of a person by which the surroundings of a silhouette count."""
MIN_OWN = 0.05
"""A cell belongs to no person if all cover it with a lower probability."""
MIN_PIXEL_RATIO = 0.5
"""Pixels, relative to a person in full view, from which its own silhouette is a person who was seen apart."""
APART_FRAMES = 5
"""Frames with two separate people after which silhouettes may hold several."""


@dataclass
class SeparateSightings:
    """Evidence that a camera has detected several separate people.

    Without it, one person with spread limbs would be taken for two who touch.

    Attributes:
        frames: in which at least two people had their own silhouettes.
    """

    frames: int = 0

    @property
    def several(self) -> bool:
        """Whether `APART_FRAMES` frames or more showed several separate people."""
        return self.frames >= APART_FRAMES


class Crowds(NamedTuple):
    """K clusters of one frame by decreasing mass, where people in merged silhouettes replace the clusters in them.

    `boxes` (K, 4) are left, top, width, height [px] of those people; NaN for clusters, which have the box of their
    pixels.
    """

    clusters: Clusters
    boxes: Floats  # (K, 4) left, top, width, height [px] of people in crowds; NaN: given by their pixels


def split_silhouettes(
    cells: Floats, corners: Ints, side: int, prior: Prior, clusters: Clusters, separate: SeparateSightings
) -> Crowds:
    """Replace clusters by people in silhouettes that are larger than one person.

    This needs `APART_FRAMES` earlier frames with several separate people. A silhouette gets people only if at least two
    are found in it, and not fewer than it has clusters.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        corners: (N, 2) left and upper pixel of each cell.
        side: side of a cell [px].
        prior: size map of people for the camera.
        clusters: clusters of the frame, with the labels of the cells.
        separate: count of frames of the camera with separate people, updated in place.
    """
    column, row = (corners // side).T
    grid = np.zeros((-(-prior.height // side), -(-prior.width // side)))
    grid[row, column] = cells[:, 0] / side**2
    joined = cv2.morphologyEx(
        (grid > MIN_FOREGROUND_SHARE).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)
    )
    count, parts, boxes, middles = cv2.connectedComponentsWithStats(joined, connectivity=8)
    part = parts[row, column]
    # Pixels of each cluster in each silhouette
    shared = np.zeros((len(clusters.mass), count))
    known = clusters.labels >= 0
    np.add.at(shared, (clusters.labels[known], part[known]), cells[known, 0])
    inside = shared > DIVIDED * shared.sum(axis=1, keepdims=True)
    divided = inside[inside.sum(axis=1) > 1].any(axis=0)
    labels, gone = clusters.labels.copy(), np.zeros(len(clusters.mass), dtype=np.bool_)
    heights = [expected_height(prior, float(x), float(y), side) for x, y in middles]
    large = [k for k in range(1, count) if _may_be_several(boxes[k], heights[k], int(inside[:, k].sum()))]
    one = inside[:, np.setdiff1d(np.arange(1, count), large)] & (clusters.fill >= MIN_PIXEL_RATIO)[:, None]
    separate.frames += int(one.any(axis=0).sum() > 1)
    found: list[Floats] = []
    for k in large if separate.several else ():
        height, members = heights[k], np.flatnonzero(inside[:, k])
        if divided[k]:
            continue
        people = _people_in(grid, parts == k, boxes[k], height, prior, side)
        if len(people) < max(len(members), 2):
            continue  # clusters distinguish these people as well
        gone[members] = True
        labels[np.isin(labels, members)] = -1
        mine = np.flatnonzero(part == k)
        first = len(clusters.mass) + sum(map(len, found))
        labels[mine] = _owners(column[mine], row[mine], people, first)
        found.append(people)
    if not found:
        return Crowds(clusters, np.full((len(clusters.mass), 4), np.nan))
    return _together(cells, labels, clusters, gone, np.concatenate(found), side, prior)


def _may_be_several(box: Ints32, height: float, clusters: int) -> bool:
    """Whether a silhouette may hold several people: several clusters, or larger than the box of one person.

    `box` is left, top, width, height and number of its cells, `height` that of a person there [cells], `clusters` the
    number of clusters in the silhouette.
    """
    if box[4] < MIN_SHARE * height**2:
        return False
    return bool(clusters > 1 or box[2] > MIN_WIDTH_RATIO * WIDTH * height or box[3] > MIN_HEIGHT_RATIO * height)


def _people_in(grid: Floats, silhouette: Bools, box: Ints32, height: float, prior: Prior, side: int) -> Floats:
    """(K, 3) centres x, y in the image and heights, in cells, of the people fitted to a silhouette.

    Args:
        grid: (rows, columns) share of each cell of the image that is foreground, 0 to 1.
        silhouette: (rows, columns) mask of its cells.
        box: left, top, width and height of the silhouette [cells].
        height: height of a person there [cells].
        prior: size map of people for the camera.
        side: side of a cell [px].
    """
    around = int(AROUND * height)
    left, top = max(int(box[0]) - around, 0), max(int(box[1]) - around, 0)
    window = np.s_[top : box[1] + box[3] + around, left : box[0] + box[2] + around]
    people = fit_outlines(np.where(silhouette[window], grid[window], 0.0), prior, side, left, top)
    return np.asarray(people + np.array([left, top, 0.0]))


@kernel
def _owners(column: Ints, row: Ints, people: Floats, first: int) -> Ints:
    """(n,) index of the person who most probably covers each of n cells, counted from `first`; -1: none.

    `column` (n,) and `row` (n,) are those of the cells, `people` (K, 3) are centre x, y and height [cells]. A
    person covers a cell with a probability of at least `MIN_OWN`.
    """
    out = np.full(column.shape[0], -1)
    for i in range(column.shape[0]):
        best = np.log1p(-MIN_OWN)
        for k in range(people.shape[0]):
            x, y, height = people[k]
            if abs(row[i] - y) <= 0.5 * height and abs(column[i] - x) <= 0.25 * height:
                free = not_covered(x, y, height, column[i], row[i])
                if free < best:
                    best, out[i] = free, first + k
    return out


def _together(
    cells: Floats, labels: Ints, clusters: Clusters, gone: Bools, people: Floats, side: int, prior: Prior
) -> Crowds:
    """Combine the remaining clusters of a frame and the fitted people, sorted by decreasing mass.

    People without cells are dropped.

    Args:
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        labels: (N,) cluster of each cell; people are numbered after the K clusters; -1: none.
        clusters: K clusters.
        gone: (K,) mask of clusters that the people replace.
        people: (P, 3) centre x, y and height [cells].
        side: side of a cell [px].
        prior: size map of people for the camera.
    """
    K, n = len(clusters.mass), len(clusters.mass) + len(people)
    means = np.concatenate([clusters.means, (people[:, :2] + 0.5) * side - 0.5])
    mass, covs = np.concatenate([clusters.mass, np.zeros(len(people))]), np.zeros((n, 3))
    covs[:K] = clusters.covs
    for k in range(K, n):
        mass[k], covs[k] = _moments(cells[labels == k])
    size = side * people[:, 2:] * np.array([WIDTH, 1.0])
    boxes = np.full((n, 4), np.nan)
    boxes[K:] = np.hstack([means[K:] - 0.5 * size, size])
    kept = np.concatenate([~gone, mass[K:] > 0.0])
    order = np.argsort(-mass, kind="stable")
    order = order[kept[order]]
    rank = np.full(n + 1, -1)
    rank[order] = np.arange(len(order))
    person, expected = person_at(means[order], np.zeros(len(order)), prior)
    return Crowds(
        Clusters(means[order], covs[order], mass[order], mass[order] / expected, person, rank[labels]),
        boxes[order],
    )


def _moments(cells: Floats) -> tuple[float, Floats]:
    """Number of pixels of cells (n, 6), and the covariance xx, xy, yy [px^2] of the pixels; zeros without pixels.

    Columns: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
    """
    n = cells[:, 0]
    total = float(n.sum())
    if total <= 0.0:
        return 0.0, np.zeros(3)
    x, y = cells[:, 1] - n @ cells[:, 1] / total, cells[:, 2] - n @ cells[:, 2] / total
    scatter = [n @ (x * x) + cells[:, 3].sum(), n @ (x * y) + cells[:, 4].sum(), n @ (y * y) + cells[:, 5].sum()]
    return total, np.array(scatter) / total
