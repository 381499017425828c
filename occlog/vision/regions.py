"""What is measured of each person-sized region of a frame: moments, box, appearance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.bin_map import N_BINS, as_colour
from ..core.jit import kernel
from .appearance import normalised, pixel_bin
from .cells import gather
from .clustering import Clusters, find_clusters
from .prior import Prior

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]

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


def cluster_regions(image: Bytes, mask: Bytes, side: int, prior: Prior) -> Regions:
    """The people-sized clusters of a frame by EM (`occlog.vision.clustering`).

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        mask: (height, width), non-zero on the foreground.
        side: of the cells [px].
        prior: of the camera.
    """
    cells, corners = gather(mask, side)
    clusters = find_clusters(cells, corners, side, prior)
    boxes, counts = _measure(as_colour(image), mask, corners, side, cells, clusters)
    return Regions(
        clusters.means, clusters.covs, boxes, clusters.mass, clusters.fill, clusters.person, normalised(counts)
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
