"""Appearance of what a camera sees: a normalised histogram of colours in the 72 bins of `histogram_bins` ([Qu])."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bytes, Floats
from occlog.core.image.histogram_bins import N_BINS, as_colour, pixel_bin
from occlog.core.numerics.jit import kernel


@kernel
def add_pixels_into(
    histogram: Floats, image: Bytes, mask: Bytes, left: int, top: int, right: int, bottom: int, weight: float
) -> None:
    """Add the masked pixels of a box to a histogram.

    Args:
        histogram: (72,) added to in place.
        image: (height, width, 3) BGR.
        mask: (height, width), pixels with a value other than 0 count.
        left: first column of the box; a box that reaches over the image is cut.
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
    """(72,) appearance of the masked pixels, summing to 1.

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
    """Histograms (..., 72) scaled to sum to 1; NaN where there are no counts."""
    total = counts.sum(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        return np.where(total > 0, counts / np.where(total > 0, total, 1.0), np.nan)


def likeness(a: Floats, b: Floats) -> Floats:
    """Bhattacharyya coefficients of histograms, 0 (nothing in common) to 1 (equal).

    Args:
        a: (K, 72) normalised histograms.
        b: (R, 72) normalised histograms.

    Returns:
        (K, R) sums of sqrt(a_i b_i); NaN where a histogram is NaN.
    """
    coefficients: Floats = np.minimum(np.sqrt(a) @ np.sqrt(b).T, 1.0)
    return coefficients
