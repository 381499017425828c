"""Expected size of a person in the image by position, and the prior of clusters.

The size follows from the camera's pose, or from detections. A person is a box of given height, width and depth on the
ground, turned towards the camera. Its projection is nearly a parallelogram, and pixels of one spanned by vectors a, b,
c have the covariance (a a' + b b' + c c') / 12.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel
from occlog.records.scene import Camera

WIDTH_SHARE = 0.34  # width over height of a walking person with arms, seen from any side
DEPTH_SHARE = 0.2
FILL = 0.6  # share of a person's bounding box that is foreground
GRID = 24  # cells of a size map along the longer side of the image
DISTANCES = 48  # tried along each line of sight
NEAR, FAR = 1.0, 60.0  # nearest and farthest person, in body heights
ROW_TOLERANCE = 0.12  # of a body's height: how well the centre of a cluster is known
LOG_SIZE_SPREAD = 0.1  # of people's heights, and of postures
SIZE_STEPS = 3  # of the fixed point for the size of a person


@dataclass(frozen=True, eq=False)
class SizeMap:
    """Expected size in the image of a person centred in each of n cells of a regular grid over the image, row by row.

    Attributes:
        image_size: width and height of the image [px].
        shape: rows and columns of the grid; n is their product.
        cov: (n, 3) covariance xx, xy, yy of the person's pixels [px^2].
        mass: (n,) number of foreground pixels of a person in full view.
        spread: (n,) standard deviation of the logarithm of the size.
    """

    image_size: tuple[int, int]
    shape: tuple[int, int]
    cov: Floats
    mass: Floats
    spread: Floats

    @property
    def width_px(self) -> float:
        """Median over the image of a person's width [px]."""
        return float(np.sqrt(12.0 * np.median(self.cov[:, 0])))


def cell_centres(image_size: tuple[int, int]) -> tuple[tuple[int, int], Floats]:
    """Shape (rows, columns) of the grid for an image, and the pixels (cells, 2) of its cells' centres.

    `image_size` is width and height [px].
    """
    width, height = image_size
    longer = max(width, height)
    columns, rows = max(1, round(GRID * width / longer)), max(1, round(GRID * height / longer))
    x = (np.arange(columns) + 0.5) * width / columns - 0.5
    y = (np.arange(rows) + 0.5) * height / rows - 0.5
    return (rows, columns), np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def sizes_from_heights(image_size: tuple[int, int], heights_px: Floats, spread: float) -> SizeMap:
    """Size map of upright people from their heights in the image.

    Args:
        image_size: width and height of the image [px].
        heights_px: (cells,) height of a person centred in each grid cell [px], > 0, in the order of `cell_centres`.
        spread: standard deviation of the logarithm of the height.
    """
    shape, centres = cell_centres(image_size)
    widths = WIDTH_SHARE * heights_px
    cov = np.column_stack([widths**2, np.zeros(len(centres)), heights_px**2]) / 12.0
    return SizeMap(
        image_size=image_size,
        shape=shape,
        cov=cov,
        mass=FILL * widths * heights_px,
        spread=np.full(len(centres), spread),
    )


def constant_sizes(image_size: tuple[int, int], height_px: float) -> SizeMap:
    """Size map with one height of people [px] everywhere; `image_size` is width and height."""
    _, centres = cell_centres(image_size)
    return sizes_from_heights(image_size, np.full(len(centres), height_px), LOG_SIZE_SPREAD)


def sizes_from_camera(camera: Camera, image_size: tuple[int, int], height: float, reach: float) -> SizeMap:
    """Compute the size map from a camera's pose.

    For each grid cell people are placed at many distances along its azimuth and weighted by how near their centre
    comes to the cell in the image. A camera that points down gives one size per cell; one level with people's
    middle, or of unknown height (z = 0), the mean of the possible sizes and their spread.

    Args:
        camera: camera with a pose.
        image_size: width and height of the image [px].
        height: height of a person, in the scene's unit.
        reach: distance of the farthest person, in the scene's unit.

    Raises:
        ValueError: less than half of the image shows positions where a person can stand.
    """
    shape, centres = cell_centres(image_size)
    near, far = NEAR * height, max(min(reach, camera.range, FAR * height), 2.0 * NEAR * height)
    distances = np.geomspace(near, far, DISTANCES)
    azimuths = camera.bearings(centres)
    directions = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    spots = (camera.ground + distances[:, None, None] * directions).reshape(-1, 2)
    middles, spans = person_in_image(camera, spots, height)
    lengths = np.sqrt(np.einsum("nij,nij->n", spans, spans))
    offsets = middles.reshape(DISTANCES, -1, 2) - centres
    miss = np.hypot(offsets[..., 0], offsets[..., 1]) / lengths.reshape(DISTANCES, -1) / ROW_TOLERANCE
    if not camera.above_floor:
        miss = np.zeros_like(miss)
    log_weights = np.where(np.isfinite(miss), -0.5 * miss**2, -np.inf)
    log_weights -= np.max(log_weights, axis=0, initial=-1e300)
    weights = np.exp(log_weights)
    weights /= np.maximum(weights.sum(axis=0), 1e-300)
    return _mean_sizes(image_size, shape, weights, spans)


def person_in_image(camera: Camera, spots: Floats, height: float) -> tuple[Floats, Floats]:
    """Image centres (N, 2) and spanning vectors (N, 3, 2) [px] of people at ground positions `spots` (N, 2).

    The vectors are the projections of whole height, width and depth of a person turned towards the camera. NaN
    behind the camera. `height` is that of a person, in scene units.
    """
    # Of a camera of unknown height: level with the middle of the body
    foot = 0.0 if camera.above_floor else float(camera.position[2]) - height / 2
    n = len(spots)
    middle = np.column_stack([spots, np.full(n, foot + height / 2)])
    away = spots - camera.ground
    away /= np.hypot(away[:, 0], away[:, 1])[:, None]
    side = np.column_stack([-away[:, 1], away[:, 0], np.zeros(n)]) * (WIDTH_SHARE * height / 2)
    deep = np.column_stack([away, np.zeros(n)]) * (DEPTH_SHARE * height / 2)
    up = np.tile([0.0, 0.0, height / 2], (n, 1))
    spans = [camera.project(middle + v) - camera.project(middle - v) for v in (up, side, deep)]
    return camera.project(middle), np.stack(spans, axis=1)


def _mean_sizes(image_size: tuple[int, int], shape: tuple[int, int], weights: Floats, spans: Floats) -> SizeMap:
    """Size map by weighting people at several distances in each cell: geometric mean size, and mean shape.

    Cells in which no person can stand take the sizes of the nearest one in which a person can; ValueError if they are
    most.

    Args:
        image_size: width and height of the image [px].
        shape: rows and columns of the map.
        weights: (distances, cells) weights, summing to 1 or 0 in a cell.
        spans: (distances * cells, 3, 2) vectors of height, width and depth of people in the image [px].
    """
    cov = np.einsum("nki,nkj->nij", spans, spans).reshape(*weights.shape, 2, 2) / 12.0
    det = cov[..., 0, 0] * cov[..., 1, 1] - cov[..., 0, 1] ** 2
    known = np.isfinite(det) & (det > 0)
    weights = np.where(known, weights, 0.0)
    # A cell in which no person can stand takes the sizes of the nearest one in which a person can
    like = _nearest_standing(weights.sum(axis=0) > 0.0, image_size)
    weights, known, cov, det = weights[:, like], known[:, like], cov[:, like], det[:, like]
    weights /= np.maximum(weights.sum(axis=0), 1e-300)
    log_size = np.where(known, 0.25 * np.log(np.where(known, det, 1.0)), 0.0)
    mean = (weights * log_size).sum(axis=0)
    spread = np.sqrt((weights * (log_size - mean) ** 2).sum(axis=0) + LOG_SIZE_SPREAD**2)
    unit = np.where(known[..., None, None], cov / np.exp(2.0 * log_size)[..., None, None], 0.0)
    shape_cov = (weights[..., None, None] * unit).sum(axis=0)
    shape_cov /= np.sqrt(np.linalg.det(shape_cov))[:, None, None]
    scaled = shape_cov * np.exp(2.0 * mean)[:, None, None]
    # Box area from the covariance: sqrt(det) = area / 12.
    mass = FILL * 12.0 * np.exp(2.0 * mean)
    flat = np.column_stack([scaled[:, 0, 0], scaled[:, 0, 1], scaled[:, 1, 1]])
    return SizeMap(image_size=image_size, shape=shape, cov=flat, mass=mass, spread=spread)


def _nearest_standing(standing: Bools, image_size: tuple[int, int]) -> Ints:
    """(cells,) index of the nearest grid cell in which a person can stand; itself where one can.

    `standing` (cells,) is the mask of these cells, `image_size` width and height [px]. ValueError if they are less than
    half of all.
    """
    like = np.arange(len(standing))
    if 2 * np.count_nonzero(standing) < len(standing):
        raise ValueError("no person can stand in most of the image; check the camera's pose")
    _, centres = cell_centres(image_size)
    there = np.flatnonzero(standing)
    for cell in np.flatnonzero(~standing):
        like[cell] = there[np.argmin(np.hypot(*(centres[there] - centres[cell]).T))]
    return like


class Prior(NamedTuple):
    """Size map of people for the images of one camera, with the weights of the clustering, for compiled functions.

    Attributes:
        cov: (n, 3) for each of n grid cells: covariance xx, xy, yy of a person's pixels [px^2].
        mass: (n,) foreground pixels of a person in full view.
        log_range: (n,) largest absolute logarithm of a size relative to the map.
        rows, columns: size of the grid; its cells are in row order.
        width, height: size of the image [px].
        strength: weight of the expected size against the pixels, in units of a person's pixels.
        penalty: cost of a cluster in the log posterior, in units of a person's pixels.
        least: smallest cluster that is kept, in units of a person's pixels.
    """

    cov: Floats
    mass: Floats
    log_range: Floats
    rows: int
    columns: int
    width: int
    height: int
    strength: float
    penalty: float
    least: float


def make_prior(sizes: SizeMap, strength: float, penalty: float, least: float) -> Prior:
    """Prior of the clustering for the images of one camera.

    Args:
        sizes: size map of people.
        strength: weight of the expected size against the pixels, in units of a person's pixels.
        penalty: cost of a cluster in the log posterior, in units of a person's pixels.
        least: smallest cluster that is kept, in units of a person's pixels.
    """
    width, height = sizes.image_size
    rows, columns = sizes.shape
    return Prior(
        cov=np.ascontiguousarray(sizes.cov),
        mass=np.ascontiguousarray(sizes.mass),
        log_range=2.0 * sizes.spread,
        rows=rows,
        columns=columns,
        width=width,
        height=height,
        strength=float(strength),
        penalty=float(penalty),
        least=float(least),
    )


@kernel
def grid_cell(prior: Prior, x: float, y: float) -> int:
    """Index of the size map's cell that contains the pixel (x, y); outside the image the nearest cell."""
    column = min(max(int((x + 0.5) * prior.columns / prior.width), 0), prior.columns - 1)
    row = min(max(int((y + 0.5) * prior.rows / prior.height), 0), prior.rows - 1)
    return row * prior.columns + column


@kernel
def person_at(means: Floats, log_sizes: Floats, prior: Prior) -> tuple[Floats, Floats]:
    """Covariances and numbers of pixels of people at image positions by the size map, with their sizes scaled.

    Args:
        means: (K, 2) centres of people [px].
        log_sizes: (K,) natural logarithms of the factors by which height and width differ from the map.
        prior: size map of the camera.

    Returns:
        (K, 3) covariances xx, xy, yy [px^2], and (K,) numbers of pixels.
    """
    covs, mass = np.empty((means.shape[0], 3)), np.empty(means.shape[0])
    for k in range(means.shape[0]):
        at = grid_cell(prior, means[k, 0], means[k, 1])
        area = math.exp(2.0 * log_sizes[k])
        covs[k] = prior.cov[at] * area
        mass[k] = prior.mass[at] * area
    return covs, mass


@kernel
def best_size(n: float, cxx: float, cxy: float, cyy: float, at: int, prior: Prior) -> float:
    """Log of a person's size relative to the map that maximises the objective of a cluster, within the map's range.

    The size s and the covariance Sigma = (nu s^2 S + C) / (nu + n) are optimised in turn; for given Sigma, s^2 = 2 /
    tr(Sigma^-1 S).

    Args:
        n: pixels of the cluster.
        cxx: xx of its scatter [px^2].
        cxy: xy of its scatter.
        cyy: yy of its scatter.
        at: index of the size map's cell at the cluster.
        prior: size map of the camera.
    """
    sxx, sxy, syy = prior.cov[at]
    limit = prior.log_range[at]
    log_size = 0.0
    for _ in range(SIZE_STEPS):
        area = math.exp(2.0 * log_size)
        nu = prior.strength * prior.mass[at] * area
        xx, xy, yy = cxx + nu * area * sxx, cxy + nu * area * sxy, cyy + nu * area * syy
        trace = (yy * sxx - 2.0 * xy * sxy + xx * syy) / (xx * yy - xy * xy) * (nu + n)
        log_size = min(max(0.5 * math.log(2.0 / trace), -limit), limit)
    return log_size


@kernel
def worth(n: float, x: float, y: float, cxx: float, cxy: float, cyy: float, prior: Prior) -> float:
    """Contribution of a cluster to the penalised objective J, if its pixels belong to it alone.

    With Sigma at its maximum, sum_i log N - 1/2 nu (tr(Sigma^-1 S) - log det(Sigma^-1 S)) is -1/2 (n + nu) log det
    Sigma + 1/2 nu log det S up to terms that are equal before and after a merge or split; its mixing weight adds n
    log n, and the cluster costs `penalty` times a person's pixels.

    Args:
        n: pixels, > 0.
        x: x of their mean [px].
        y: y of their mean [px].
        cxx: xx of their scatter [px^2].
        cxy: xy of their scatter.
        cyy: yy of their scatter.
        prior: size map of the camera, with the weights of the objective.
    """
    at = grid_cell(prior, x, y)
    area = math.exp(2.0 * best_size(n, cxx, cxy, cyy, at, prior))
    person = prior.mass[at] * area
    nu = prior.strength * person
    sxx, sxy, syy = prior.cov[at] * area
    w = n + nu
    xx, xy, yy = (cxx + nu * sxx) / w, (cxy + nu * sxy) / w, (cyy + nu * syy) / w
    fit = -0.5 * w * math.log(xx * yy - xy * xy) + 0.5 * nu * math.log(sxx * syy - sxy * sxy)
    return float(fit + n * math.log(n) - prior.penalty * person)
