"""Smaller images for faster detection, and results from them back in pixels of the whole image.

Pixel i of an image shrunk by f is the mean of pixels f i to f i + f - 1, so its centre is
at f (i + 1/2) - 1/2.  Rows and columns at the right and lower edge that do not fill a
whole pixel are left out.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from occlog.array_types import Bytes
from occlog.measure.clusters.person_size import SizeMap

from .regions import Regions

ENOUGH_WIDTH_PX = 100.0
"""A person this wide is large enough: its centre is found to a small part of what posture makes uncertain."""

MOST = 8


def shrink_factor(width_px: float) -> int:
    """Whole number by which images are shrunk where people are so wide."""
    return int(np.clip(width_px // ENOUGH_WIDTH_PX, 1, MOST))


def shrink(image: Bytes, factor: int) -> Bytes:
    """(height // factor, width // factor) image of means; the image itself for factor 1."""
    if factor == 1:
        return image
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    whole = image[: rows * factor, : columns * factor]
    return cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)  # type: ignore[no-any-return]


def shrink_sizes(sizes: SizeMap, factor: int) -> SizeMap:
    """Size map for shrunk images."""
    width, height = sizes.image_size
    area = float(factor**2)
    return replace(sizes, image_size=(width // factor, height // factor), cov=sizes.cov / area, mass=sizes.mass / area)


def enlarge(regions: Regions, factor: int) -> Regions:
    """Regions of a shrunk image in pixels of the whole one."""
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
