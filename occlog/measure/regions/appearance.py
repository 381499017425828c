"""Appearance of what a camera sees: a colour histogram of 8 x 8 hue-saturation and 8 brightness bins.

[Qu] with the bins of the project's notes: a pixel with colour goes to the bin of its hue
and saturation; a pixel too grey or too dark to have a hue goes to one of eight
brightness bins.  All limits are compared in integers, so a pixel's bin does not depend
on rounding.

Bin of a coloured pixel: 8 * floor(hue / 45 deg) + floor(8 * saturation); of a grey one:
64 + floor(8 * value), with OpenCV's hue, saturation = (max - min) / max and
value = max / 255.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bytes, Floats
from occlog.core.image.histogram_bins import BRIGHTNESS_BINS, GREY_BIN, HUE_BINS, N_BINS, SATURATION_BINS, as_colour
from occlog.core.numerics.jit import kernel


@kernel
def pixel_bin(b: int, g: int, r: int) -> int:
    """Histogram bin of one pixel, 0 to 71.

    Args:
        b: blue, 0 to 255.
        g: green, 0 to 255.
        r: red, 0 to 255.

    Returns:
        A brightness bin for saturation <= 0.1 or value <= 0.2, else a hue-saturation bin.
    """
    high, low = max(b, g, r), min(b, g, r)
    spread = high - low
    if 10 * spread <= high or 5 * high <= 255:
        return GREY_BIN + high * BRIGHTNESS_BINS // 256
    # Hue in sextants is base + part / spread; eight bins are 4/3 of a bin a sextant.
    if high == r:
        sextants = (g - b) % (6 * spread)
    elif high == g:
        sextants = 2 * spread + b - r
    else:
        sextants = 4 * spread + r - g
    hue = min(sextants * 4 // (3 * spread), HUE_BINS - 1)
    saturation = min(spread * SATURATION_BINS // high, SATURATION_BINS - 1)
    return hue * SATURATION_BINS + saturation


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
