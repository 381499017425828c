"""How tall people are in the image, from the people that were seen in it.

Rule: in each sample, what differs from the empty scene is joined over gaps of an eighth
of its height; a blob counts as a person who stands alone if it is 1.5 to 4.5 times as
high as wide, fills 35 to 95 % of its box, is at least 24 px high and does not touch the
border of the image.  On level ground the height grows linearly with the row of the feet,
so a line is fitted by the median of the slopes between all pairs (Theil-Sen).  With
fewer than ten blobs, or blobs whose feet are all in nearly the same rows, the height is
their median everywhere.
"""

from __future__ import annotations

import cv2
import numpy as np

from occlog.array_types import Bytes, Floats
from occlog.measure.clusters.person_size import LOG_SIZE_SPREAD, SizeMap, cell_centres, sizes_from_heights

from .empty_scene import difference

DIFFERENCE = 30  # grey levels from the empty scene that mean foreground
ASPECT = (1.5, 4.5)
FILLED = (0.35, 0.95)
LEAST_HEIGHT_PX = 24
ENOUGH_BLOBS = 10
ROW_RANGE = 0.1  # of the image's height between the rows of the feet that allow a line
CLOSINGS = (3, 7, 15)  # sides tried for joining pieces [px]; the one with most people-like blobs is used


def person_like_blobs(samples: list[Bytes], empty: Bytes) -> Floats:
    """(N, 2) row of the feet and height [px] of blobs that look like a person who stands alone."""
    return max((_blobs(samples, empty, side) for side in CLOSINGS), key=len)


def _blobs(samples: list[Bytes], empty: Bytes, side: int) -> Floats:
    found = [_blobs_of(sample, empty, side) for sample in samples]
    return np.concatenate(found) if found else np.empty((0, 2))


def _blobs_of(sample: Bytes, empty: Bytes, side: int) -> Floats:
    mask = cv2.medianBlur((difference(sample, empty) > DIFFERENCE).astype(np.uint8), 5)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    left, top, width, height, area = stats[1:].T.astype(np.float64)
    rows, columns = mask.shape
    aspect, filled = height / width, area / (width * height)
    inside = (left > 0) & (top > 0) & (left + width < columns) & (top + height < rows)
    person = inside & (aspect >= ASPECT[0]) & (aspect <= ASPECT[1]) & (filled >= FILLED[0]) & (filled <= FILLED[1])
    person &= height >= LEAST_HEIGHT_PX
    blobs: Floats = np.column_stack([top + height, height])[person]
    return blobs


def observed_sizes(image_size: tuple[int, int], blobs: Floats) -> SizeMap | None:
    """Size map from blobs (N, 2) of feet's row and height; None where there are none."""
    if not len(blobs):
        return None
    feet, heights = blobs.T
    slope, at_top = _line(feet, heights) if _allow_line(feet, image_size[1]) else (0.0, float(np.median(heights)))
    _, centres = cell_centres(image_size)
    # A person centred in row v has its feet at v + h / 2, so h = at_top + slope (v + h / 2).
    fitted = (at_top + slope * centres[:, 1]) / (1.0 - 0.5 * slope)
    fitted = np.clip(fitted, 0.5 * heights.min(), 2.0 * heights.max())
    residuals = np.log(heights / np.maximum(at_top + slope * feet, 1.0))
    spread = 1.4826 * float(np.median(np.abs(residuals - np.median(residuals))))
    return sizes_from_heights(image_size, fitted, max(spread, LOG_SIZE_SPREAD))


def _allow_line(feet: Floats, rows: int) -> bool:
    return len(feet) >= ENOUGH_BLOBS and float(np.ptp(np.percentile(feet, [10, 90]))) >= ROW_RANGE * rows


def _line(x: Floats, y: Floats) -> tuple[float, float]:
    """Theil-Sen slope in [0, 1] and intercept of y over x."""
    dx, dy = x[:, None] - x, y[:, None] - y
    apart = dx > 1.0
    slope = float(np.clip(np.median(dy[apart] / dx[apart]), 0.0, 1.0))
    return slope, float(np.median(y - slope * x))
