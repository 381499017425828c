"""Silhouettes that are larger than one person: the people in them, instead of the clusters of their pixels.

People who touch in the image are one cluster where they overlap by much: their pixels are no two Gaussians.  Such
silhouettes are explained by outlines of people (`outlines`), whose boxes go on where another person hides them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.core.numerics.jit import kernel

from .outlines import WIDTH, expected_height, fit_outlines, not_covered
from .person_size import Prior, person_at
from .stage import Clusters

WIDER, TALLER = 1.25, 1.15
"""A silhouette that is larger than the box of a person by one of these factors may hold several."""
LEAST_SHARE = 0.02
"""Silhouettes with fewer cells are specks, in squares of the height of a person."""
SOLID = 0.3
"""Share of foreground from which a cell joins its neighbours."""
DIVIDED = 0.1
"""Silhouettes are left to the clusters that hold a larger share than this of one that goes on in another silhouette:
something in front of the people divides them, and outlines of whole people fit neither part."""
AROUND = 0.5
"""Heights of a person by which the surroundings of a silhouette count."""
LEAST_OWN = 0.05
"""A cell is nobody's that everybody covers with a lower probability."""
WHOLE = 0.5
"""Pixels, relative to a person in full view, from which a silhouette of its own is a person who was seen apart."""
APART_FRAMES = 5
"""Frames with two people apart after which silhouettes may hold several."""


@dataclass
class SeenApart:
    """Whether a camera has seen several people apart: one person with arms and legs spread is like two who touch.

    Attributes:
        frames: in which at least two people had silhouettes of their own.
    """

    frames: int = 0

    @property
    def several(self) -> bool:
        """Whether there is more than one person, as far as this camera has seen."""
        return self.frames >= APART_FRAMES


class Crowds(NamedTuple):
    """Clusters of one frame, some of which are people in a silhouette of several; by falling mass."""

    clusters: Clusters
    boxes: Floats  # (K, 4) left, top, width, height [px] of people in crowds; NaN: their pixels say it


def find_people(cells: Floats, corners: Ints, side: int, prior: Prior, clusters: Clusters, apart: SeenApart) -> Crowds:
    """Put people in the place of clusters where a silhouette is larger than one person, once several were seen apart.

    Args:
        cells: (N, 6) cell table.
        corners: (N, 2) its cells' corners.
        side: of the cells [px].
        prior: of the camera.
        clusters: of the frame.
        apart: of the camera; brought up to date.
    """
    column, row = (corners // side).T
    grid = np.zeros((-(-prior.height // side), -(-prior.width // side)))
    grid[row, column] = cells[:, 0] / side**2
    joined = cv2.morphologyEx((grid > SOLID).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
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
    one = inside[:, np.setdiff1d(np.arange(1, count), large)] & (clusters.fill >= WHOLE)[:, None]
    apart.frames += int(one.any(axis=0).sum() > 1)
    found: list[Floats] = []
    for k in large if apart.several else ():
        height, members = heights[k], np.flatnonzero(inside[:, k])
        if divided[k]:
            continue
        people = _people_in(grid, parts == k, boxes[k], height, prior, side)
        if len(people) < max(len(members), 2):
            continue  # clusters tell these people apart as well
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
    """Whether a silhouette with a box (left, top, width, height, cells) may hold several people."""
    if box[4] < LEAST_SHARE * height**2:
        return False
    return bool(clusters > 1 or box[2] > WIDER * WIDTH * height or box[3] > TALLER * height)


def _people_in(grid: Floats, silhouette: Bools, box: Ints32, height: float, prior: Prior, side: int) -> Floats:
    """(K, 3) middles and heights [cells] of the people in a silhouette."""
    around = int(AROUND * height)
    left, top = max(int(box[0]) - around, 0), max(int(box[1]) - around, 0)
    window = np.s_[top : box[1] + box[3] + around, left : box[0] + box[2] + around]
    people = fit_outlines(np.where(silhouette[window], grid[window], 0.0), prior, side, left, top)
    return np.asarray(people + np.array([left, top, 0.0]))


@kernel
def _owners(column: Ints, row: Ints, people: Floats, first: int) -> Ints:
    """(n,) number of the person who covers each cell with the highest probability, counted from `first`; -1: nobody."""
    out = np.full(column.shape[0], -1)
    for i in range(column.shape[0]):
        best = np.log1p(-LEAST_OWN)
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
    """What is left of the clusters, and the people, by falling mass."""
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
    """Pixels of cells and their covariance xx, xy, yy [px^2]."""
    n = cells[:, 0]
    total = float(n.sum())
    if total <= 0.0:
        return 0.0, np.zeros(3)
    x, y = cells[:, 1] - n @ cells[:, 1] / total, cells[:, 2] - n @ cells[:, 2] / total
    scatter = [n @ (x * x) + cells[:, 3].sum(), n @ (x * y) + cells[:, 4].sum(), n @ (y * y) + cells[:, 5].sum()]
    return total, np.array(scatter) / total
