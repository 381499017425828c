"""Person-sized regions of a frame: moments, box, appearance.

For clustering, foreground pixels are collected in small square cells with exact moments.

A row of a cell table is (n, x, y, xx, xy, yy): number of foreground pixels, their mean
[px], and the sums of squares and products about that mean [px^2].  Sums over cells are
therefore sums over pixels.

Connected components of the foreground as person-sized regions: the plain alternative to clustering.

Appearance of what a camera sees: a normalised histogram of colours in the 72 bins of `pixel_bin` ([Qu]).

Smaller images for faster detection, and results from them back in pixels of the whole image.

Pixel i of an image shrunk by f is the mean of pixels f i to f i + f - 1, so its centre is
at f (i + 1/2) - 1/2.  Rows and columns at the right and lower edge that do not fill a
whole pixel are skipped.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import Bytes, Floats, Ints, Ints32
from occlog.core.image import N_BINS, as_colour, pixel_bin
from occlog.core.numerics.jit import kernel
from occlog.measure.clusters.merged_silhouettes import SeparateSightings, split_silhouettes
from occlog.measure.clusters.person_size import Prior, SizeMap, grid_cell
from occlog.measure.clusters.stage import Clusters, find_clusters


@kernel
def add_pixels_into(
    histogram: Floats, image: Bytes, mask: Bytes, left: int, top: int, right: int, bottom: int, weight: float
) -> None:
    """Add the masked pixels of a box to a colour histogram of 72 bins, in place.

    Args:
        histogram: (72,) counts of `pixel_bin`, added to in place.
        image: (height, width, 3) BGR.
        mask: (height, width), pixels with a value other than 0 count.
        left: first column of the box; a box that exceeds the image is clipped.
        top: first row.
        right: column after the last.
        bottom: row after the last.
        weight: what each pixel adds.
    """
    height, width = mask.shape
    for y in range(max(top, 0), min(bottom, height)):
        for x in range(max(left, 0), min(right, width)):
            if mask[y, x]:
                k = pixel_bin(int(image[y, x, 0]), int(image[y, x, 1]), int(image[y, x, 2]))
                histogram[k] += weight


def histogram(image: Bytes, mask: Bytes | None = None) -> Floats:
    """(72,) normalised colour histogram of the masked pixels.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        mask: (height, width), non-zero where a pixel counts; None: all pixels count.

    Returns:
        The normalised histogram; all NaN when no pixel counts.
    """
    colour = as_colour(image)
    height, width = colour.shape[:2]
    where = np.ones((height, width), dtype=np.uint8) if mask is None else mask
    counts = np.zeros(N_BINS)
    add_pixels_into(counts, colour, where, 0, 0, width, height, 1.0)
    return normalised(counts)


def normalised(counts: Floats) -> Floats:
    """Histograms (..., 72) normalised to sum 1; NaN without counts."""
    total = counts.sum(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        return np.where(total > 0, counts / np.where(total > 0, total, 1.0), np.nan)


def similarity(a: Floats, b: Floats) -> Floats:
    """Bhattacharyya coefficients of histograms, 0 (disjoint) to 1 (equal).

    Args:
        a: (K, 72) normalised histograms.
        b: (R, 72) normalised histograms.

    Returns:
        (K, R) sums of sqrt(a_i b_i); NaN where a histogram is NaN.
    """
    coefficients: Floats = np.minimum(np.sqrt(a) @ np.sqrt(b).T, 1.0)
    return coefficients


@kernel
def gather(mask: Bytes, side: int) -> tuple[Floats, Ints]:
    """Collect the foreground pixels in square cells, row by row; cells without foreground are omitted.

    Args:
        mask: (height, width), non-zero on the foreground.
        side: side of a cell [px]; cells at the right and lower edges may be smaller.

    Returns:
        (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy about the mean [px^2]; (N, 2) left and upper pixel of
        each cell.
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
    """Write pixels, mean x, y [px] and scatter xx, xy, yy [px^2] of one nonempty cell's foreground to `cell` (6,).

    `mask` (h, w) is that of the cell, which begins at column `left` and row `top` of the image.
    """
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


class ForegroundRegions(NamedTuple):
    """K person-sized regions of one frame, by decreasing number of foreground pixels.

    Attributes:
        means: (K, 2) mean x, y [px].
        covs: (K, 3) covariance xx, xy, yy of the pixels [px^2].
        boxes: (K, 4) left, top, width, height [px].
        mass: (K,) number of foreground pixels.
        fill: (K,) this number relative to a person in full view at the position.
        person: (K, 3) covariance of a person's pixels at the position [px^2].
        appearance: (K, 72) colour histograms; NaN where not measured.
    """

    means: Floats
    covs: Floats
    boxes: Floats
    mass: Floats
    fill: Floats
    person: Floats
    appearance: Floats


def cluster_regions(
    image: Bytes, mask: Bytes, side: int, prior: Prior, separate: SeparateSightings | None = None
) -> ForegroundRegions:
    """Person-sized clusters of a frame's foreground by EM (`occlog.measure.clusters.stage`), with boxes and histograms.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        mask: (height, width), non-zero on the foreground.
        side: side of the cells in which pixels are collected [px].
        prior: size map of people for the camera.
        separate: frames of the camera with separate people, updated in place: people in a merged silhouette are
            found by their outlines (`occlog.measure.clusters.merged_silhouettes`); None: by EM alone.
    """
    cells, corners = gather(mask, side)
    clusters = find_clusters(cells, corners, side, prior)
    whole = np.full((len(clusters.mass), 4), np.nan)
    if separate is not None:
        clusters, whole = split_silhouettes(cells, corners, side, prior, clusters, separate)
    boxes, counts = _measure(as_colour(image), mask, corners, side, cells, clusters)
    boxes = np.where(np.isnan(whole), boxes, whole)
    return ForegroundRegions(
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
    """Boxes (K, 4: left, top, width, height [px]) around the core of each cluster, and colour counts (K, 72).

    The core are cells within 3 standard deviations of the mean; colours are those of all pixels of the cluster.

    Args:
        image: (height, width, 3) BGR.
        mask: (height, width), non-zero on the foreground.
        corners: (N, 2) left and upper pixel of the cells.
        side: side of a cell [px].
        cells: (N, 6) cells: pixels, mean x, y [px], scatter xx, xy, yy [px^2].
        clusters: K clusters, with the labels of the cells.
    """
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
    """Squared Mahalanobis distance of the pixel (x, y) from a cluster, with 1/12 px^2 added to its variances.

    `mean` (2,) [px] and `cov` (3,: xx, xy, yy [px^2]) are those of the cluster.
    """
    xx, xy, yy = cov[0] + 1.0 / 12.0, cov[1], cov[2] + 1.0 / 12.0
    dx, dy = x - mean[0], y - mean[1]
    return float((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy))


@kernel
def _boxes(edges: Ints, means: Floats, covs: Floats) -> Floats:
    """(K, 4) boxes left, top, width, height [px]; pixel x extends from x - 1/2 to x + 1/2.

    A cluster without pixels gets the box of its ellipse of two standard deviations.

    Args:
        edges: (K, 4) first and last pixels left, top, right, bottom; right is -1 for a cluster without pixels.
        means: (K, 2) of the clusters [px].
        covs: (K, 3) xx, xy, yy of the clusters [px^2].
    """
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


CLOSING = 0.2  # side of the closing that joins pieces, over a person's width


def component_regions(image: Bytes, mask: Bytes, width_px: float, prior: Prior) -> ForegroundRegions:
    """Connected components of a frame's foreground with enough pixels for a person, with boxes and histograms.

    Parts nearer than about a fifth of a person's width are joined first. People who touch in the image are one
    region; a person in several parts is several regions, or none.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        mask: (height, width), 255 on the foreground.
        width_px: width of a person in the image [px].
        prior: gives the sizes of people and the smallest share of a person's pixels; its other fields are not used.
    """
    side = 2 * round(0.5 * CLOSING * width_px) + 1
    joined = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)) if side > 1 else mask
    _, labels, stats, centres = cv2.connectedComponentsWithStats(joined, connectivity=8)
    order = np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable") + 1
    indices = np.array([grid_cell(prior, *centres[k]) for k in order], dtype=np.int64)
    enough = stats[order, cv2.CC_STAT_AREA] >= prior.least * prior.mass[indices]
    order, indices = order[enough], indices[enough]
    edges = stats[order, :4].astype(np.int64)
    moments, counts = _measure_component(as_colour(image), mask, labels, order.astype(np.int64), edges)
    return _regions(moments, counts, edges, prior.cov[indices], prior.mass[indices])


def _regions(moments: Floats, counts: Floats, edges: Ints, person: Floats, person_mass: Floats) -> ForegroundRegions:
    mass = moments[:, 0]
    boxes = edges - np.array([0.5, 0.5, 0.0, 0.0])
    order = np.argsort(-mass, kind="stable")
    order = order[mass[order] > 0]
    covs = moments[:, 3:] / np.maximum(mass, 1.0)[:, None]
    appearance = normalised(counts)
    return ForegroundRegions(
        means=moments[order, 1:3],
        covs=covs[order],
        boxes=boxes[order],
        mass=mass[order],
        fill=mass[order] / person_mass[order],
        person=person[order],
        appearance=appearance[order],
    )


@kernel
def _measure_component(image: Bytes, mask: Bytes, labels: Ints32, wanted: Ints, edges: Ints) -> tuple[Floats, Floats]:
    """Measure K labelled components: (K, 6) pixels, mean x, y [px], scatter xx, xy, yy [px^2]; (K, 72) colour counts.

    Only foreground pixels of the component count.

    Args:
        image: (height, width, 3) BGR.
        mask: (height, width), non-zero on the foreground.
        labels: (height, width) component of each pixel.
        wanted: (K,) components to measure.
        edges: (K, 4) left, top, width, height of their boxes [px], inside the image.
    """
    n_regions = wanted.shape[0]
    moments, counts = np.zeros((n_regions, 6)), np.zeros((n_regions, N_BINS))
    for k in range(n_regions):
        left, top, width, height = edges[k]
        n = sx = sy = xx = xy = yy = 0
        for y in range(height):
            for x in range(width):
                py, px = top + y, left + x
                if labels[py, px] == wanted[k] and mask[py, px]:
                    n += 1
                    sx += x
                    sy += y
                    xx += x * x
                    xy += x * y
                    yy += y * y
                    counts[k, pixel_bin(int(image[py, px, 0]), int(image[py, px, 1]), int(image[py, px, 2]))] += 1.0
        if n > 0:
            mx, my = sx / n, sy / n
            moments[k, 0], moments[k, 1], moments[k, 2] = n, left + mx, top + my
            moments[k, 3], moments[k, 4], moments[k, 5] = xx - n * mx * mx, xy - n * mx * my, yy - n * my * my
    return moments, counts


ENOUGH_WIDTH_PX = 100.0
"""A person this wide is large enough: its centre is found to a small part of what posture makes uncertain."""

MOST = 8


def downscale_factor(width_px: float) -> int:
    """Integer factor, 1 to `MOST`, for downscaling images in which people are `width_px` pixels wide."""
    return int(np.clip(width_px // ENOUGH_WIDTH_PX, 1, MOST))


def downscale(image: Bytes, factor: int) -> Bytes:
    """Downscale an image by block means to (height // factor, width // factor); unchanged for factor 1."""
    if factor == 1:
        return image
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    whole = image[: rows * factor, : columns * factor]
    return cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)  # type: ignore[no-any-return]


def downscale_sizes(sizes: SizeMap, factor: int) -> SizeMap:
    """Size map for images downscaled by the integer `factor`: numbers of pixels are divided by its square."""
    width, height = sizes.image_size
    area = float(factor**2)
    return replace(sizes, image_size=(width // factor, height // factor), cov=sizes.cov / area, mass=sizes.mass / area)


def enlarge(regions: ForegroundRegions, factor: int) -> ForegroundRegions:
    """Convert regions of an image downscaled by the integer `factor` to pixels of the original image."""
    if factor == 1:
        return regions
    area = float(factor**2)
    # Each shrunk pixel is spread over factor x factor pixels.
    spread = (area - 1.0) / 12.0 * np.array([1.0, 0.0, 1.0])
    boxes = regions.boxes * factor
    boxes[:, :2] += 0.5 * (factor - 1)
    return regions._replace(
        means=regions.means * factor + 0.5 * (factor - 1),
        covs=regions.covs * area + spread,
        boxes=boxes,
        mass=regions.mass * area,
        person=regions.person * area,
    )
