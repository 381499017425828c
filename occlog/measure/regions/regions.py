"""What is measured of each person-sized region of a frame: moments, box, appearance.

Foreground pixels gathered in small square cells, with exact moments: what clustering works on.

A row of a cell table is (n, x, y, xx, xy, yy): number of foreground pixels, their mean
[px], and the sums of squares and products about that mean [px^2].  Sums over cells are
therefore sums over pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bytes, Floats, Ints
from occlog.core.image.histogram_bins import N_BINS, as_colour, pixel_bin
from occlog.core.numerics.jit import kernel
from occlog.measure.clusters.crowds import SeenApart, find_people
from occlog.measure.clusters.person_size import Prior
from occlog.measure.clusters.stage import Clusters, find_clusters

from .appearance import normalised


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


CORE2 = 9.0  # squared Mahalanobis distance of the pixels that make a cluster's box


class Regions(NamedTuple):
    """Regions of one frame by falling number of pixels; K rows."""

    means: Floats  # (K, 2) [px]
    covs: Floats  # (K, 3) covariance xx, xy, yy of the pixels [px^2]
    boxes: Floats  # (K, 4) left, top, width, height [px]
    mass: Floats  # (K,) foreground pixels
    fill: Floats  # (K,) mass relative to a person in full view at the place
    person: Floats  # (K, 3) covariance of a person's pixels at the place [px^2]
    appearance: Floats  # (K, 72) histograms, NaN where not measured


def cluster_regions(image: Bytes, mask: Bytes, side: int, prior: Prior, apart: SeenApart | None = None) -> Regions:
    """The people-sized clusters of a frame by EM (`occlog.measure.clusters.stage`).

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        mask: (height, width), non-zero on the foreground.
        side: of the cells [px].
        prior: of the camera.
        apart: of the camera: people of a silhouette of several are found by their outlines
            (`occlog.measure.clusters.crowds`); None: by EM alone.
    """
    cells, corners = gather(mask, side)
    clusters = find_clusters(cells, corners, side, prior)
    whole = np.full((len(clusters.mass), 4), np.nan)
    if apart is not None:
        clusters, whole = find_people(cells, corners, side, prior, clusters, apart)
    boxes, counts = _measure(as_colour(image), mask, corners, side, cells, clusters)
    boxes = np.where(np.isnan(whole), boxes, whole)
    return Regions(
        means=clusters.means,
        covs=clusters.covs,
        boxes=boxes,
        mass=clusters.mass,
        fill=clusters.fill,
        person=clusters.person,
        appearance=normalised(counts),
    )


@kernel
def _measure(
    image: Bytes, mask: Bytes, corners: Ints, side: int, cells: Floats, clusters: Clusters
) -> tuple[Floats, Floats]:
    """Boxes (K, 4) around the core of each cluster and histograms (K, 72) of all its pixels."""
    n_clusters = clusters.means.shape[0]
    counts = np.zeros((n_clusters, N_BINS))
    edges = np.empty((n_clusters, 4), dtype=np.int64)  # left, top, right, bottom, of whole pixels
    edges[:, :2] = np.iinfo(np.int64).max
    edges[:, 2:] = -1
    height, width = mask.shape
    for i in range(corners.shape[0]):
        k = clusters.labels[i]
        if k < 0:
            continue
        core = _distance2(cells[i, 1], cells[i, 2], clusters.means[k], clusters.covs[k]) <= CORE2
        left, top = corners[i]
        for y in range(top, min(top + side, height)):
            for x in range(left, min(left + side, width)):
                if mask[y, x]:
                    counts[k, pixel_bin(int(image[y, x, 0]), int(image[y, x, 1]), int(image[y, x, 2]))] += 1.0
                    if core:
                        edges[k, 0] = min(edges[k, 0], x)
                        edges[k, 1] = min(edges[k, 1], y)
                        edges[k, 2] = max(edges[k, 2], x)
                        edges[k, 3] = max(edges[k, 3], y)
    return _boxes(edges, clusters.means, clusters.covs), counts


@kernel
def _distance2(x: float, y: float, mean: Floats, cov: Floats) -> float:
    """Squared Mahalanobis distance; a cluster that is a line counts as a twelfth of a pixel wide."""
    xx, xy, yy = cov[0] + 1.0 / 12.0, cov[1], cov[2] + 1.0 / 12.0
    dx, dy = x - mean[0], y - mean[1]
    return float((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy))


@kernel
def _boxes(edges: Ints, means: Floats, covs: Floats) -> Floats:
    """Boxes from first and last pixels: pixel x reaches from x - 1/2 to x + 1/2."""
    boxes = np.empty((edges.shape[0], 4))
    for k in range(edges.shape[0]):
        left, top, right, bottom = edges[k]
        if right >= 0:
            boxes[k] = left - 0.5, top - 0.5, right - left + 1.0, bottom - top + 1.0
        else:
            # All its pixels are shared with heavier clusters: the ellipse's box.
            rx, ry = 2.0 * np.sqrt(covs[k, 0]) + 0.5, 2.0 * np.sqrt(covs[k, 2]) + 0.5
            boxes[k] = means[k, 0] - rx, means[k, 1] - ry, 2.0 * rx, 2.0 * ry
    return boxes
