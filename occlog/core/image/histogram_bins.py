"""Histogram bins of colours: 8 x 8 of hue and saturation, and 8 of brightness for pixels without a hue.

[Qu] compares targets by colour histograms and leaves the bins open; these are the project's.
A pixel too grey (saturation <= 0.1) or too dark (value <= 0.2) to have a hue goes to bin
64 + floor(8 * value), every other one to bin 8 * floor(hue / 45 deg) + floor(8 * saturation),
with OpenCV's hue, saturation = (max - min) / max and value = max / 255.  All limits are compared in
whole numbers, so that a pixel's bin does not depend on rounding.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bytes, Ints
from occlog.core.numerics.jit import kernel

HUE_BINS = 8
SATURATION_BINS = 8
BRIGHTNESS_BINS = 8
GREY_BIN = HUE_BINS * SATURATION_BINS
N_BINS = GREY_BIN + BRIGHTNESS_BINS

_OVER = np.concatenate([[0.0], 1.0 / np.arange(1, 256)])
"""1 / n; the half added to each whole numerator keeps the quotients far from whole numbers, so that none rounds up."""


@kernel
def pixel_bin(blue: int, green: int, red: int) -> int:
    """Histogram bin, 0 to 71, of a pixel with the given values, 0 to 255 each."""
    high, low = max(blue, green, red), min(blue, green, red)
    spread = high - low
    if 10 * spread <= high or 5 * high <= 255:
        return GREY_BIN + high * BRIGHTNESS_BINS // 256
    # Hue times `spread`, in sextants of the colour circle; a sextant holds 4/3 bins
    if high == red:
        sextants = green - blue if green >= blue else green - blue + 6 * spread
    elif high == green:
        sextants = 2 * spread + blue - red
    else:
        sextants = 4 * spread + red - green
    # floor(4 sextants / (3 spread)) and floor(8 spread / high) by multiplication, which is faster than division
    hue = min(int((4 * sextants + 0.5) * (_OVER[spread] / 3.0)), HUE_BINS - 1)
    saturation = min(int((spread * SATURATION_BINS + 0.5) * _OVER[high]), SATURATION_BINS - 1)
    return hue * SATURATION_BINS + saturation


def as_colour(image: Bytes) -> Bytes:
    """(height, width, 3) view of a grey or colour image; grey pixels count as B = G = R."""
    if image.ndim == 3:
        return image
    return np.broadcast_to(image[:, :, None], (*image.shape, 3))


def update_bins(bins: Bytes, image: Bytes, boxes: Ints, step: int = 1) -> None:
    """Set the bin numbers of the pixels inside boxes, once a frame for all particles of all trackers.

    Args:
        bins: (height, width) bin numbers, changed in place; pixels outside all boxes keep theirs.
        image: (height, width, 3) BGR or (height, width) grey.
        boxes: (K, 4) left, top, right, bottom, half-open; boxes may overlap and reach over the image.
        step: only pixels whose column and row are multiples of it.
    """
    colour, (height, width) = as_colour(image), bins.shape
    for left, top, right, bottom in boxes.tolist():
        start = max(left, 0) + -max(left, 0) % step, max(top, 0) + -max(top, 0) % step
        _bins_into(bins, colour, *start, min(right, width), min(bottom, height), step)


@kernel
def _bins_into(bins: Bytes, image: Bytes, left: int, top: int, right: int, bottom: int, step: int) -> None:
    for y in range(top, bottom, step):
        for x in range(left, right, step):
            bins[y, x] = pixel_bin(int(image[y, x, 0]), int(image[y, x, 1]), int(image[y, x, 2]))
