"""Images to maps of histogram bins, made once a frame for all particles of all trackers.

The bins are 8 x 8 of hue and saturation, and 8 of brightness for pixels without a hue;
`occlog.measure.regions.appearance` tells how they are numbered.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bytes, Floats, Ints
from occlog.core.numerics.jit import kernel

HUE_BINS = 8
SATURATION_BINS = 8
BRIGHTNESS_BINS = 8
GREY_BIN = HUE_BINS * SATURATION_BINS
N_BINS = GREY_BIN + BRIGHTNESS_BINS

_OVER = np.concatenate([[0.0], 1.0 / np.arange(1, 256)])
"""1 / n; the half added to each whole numerator keeps the quotients far from whole numbers, so that none rounds up."""


def as_colour(image: Bytes) -> Bytes:
    """(height, width, 3) view of a grey or colour image; grey pixels count as B = G = R."""
    if image.ndim == 3:
        return image
    return np.broadcast_to(image[:, :, None], (*image.shape, 3))


def bin_map(image: Bytes) -> Bytes:
    """(H, W) bin number, 0 to 71, of each pixel; the same bins as `occlog.measure.regions.appearance.pixel_bin`.

    Args:
        image: (H, W, 3) BGR or (H, W) grey; the pixels of a grey image are all in brightness bins.
    """
    colour = as_colour(image)
    out = np.empty(colour.shape[:2], dtype=np.uint8)
    _bins_into(out, colour, 0, 0, colour.shape[1], colour.shape[0], 1, _OVER)
    return out


def update_bin_map(out: Bytes, image: Bytes, boxes: Ints, step: int = 1) -> None:
    """Set the numbers of a map inside boxes only: all that trackers look at, in a fraction of the time.

    Args:
        out: (H, W) map, changed in place; pixels outside all boxes keep their numbers.
        image: (H, W, 3) BGR or (H, W) grey.
        boxes: (K, 4) left, top, right, bottom, half-open; boxes may overlap and reach over the image.
        step: only pixels whose column and row are multiples of it.
    """
    colour, (height, width) = as_colour(image), out.shape
    for left, top, right, bottom in boxes.tolist():
        start = max(left, 0) + -max(left, 0) % step, max(top, 0) + -max(top, 0) % step
        _bins_into(out, colour, *start, min(right, width), min(bottom, height), step, _OVER)


@kernel
def _bins_into(out: Bytes, image: Bytes, left: int, top: int, right: int, bottom: int, step: int, over: Floats) -> None:
    for y in range(top, bottom, step):
        for x in range(left, right, step):
            b, g, r = int(image[y, x, 0]), int(image[y, x, 1]), int(image[y, x, 2])
            high, low = max(b, g, r), min(b, g, r)
            spread = high - low
            if 10 * spread <= high or 5 * high <= 255:
                out[y, x] = GREY_BIN + high * BRIGHTNESS_BINS // 256
                continue
            if high == r:
                sextants = g - b if g >= b else g - b + 6 * spread
            elif high == g:
                sextants = 2 * spread + b - r
            else:
                sextants = 4 * spread + r - g
            hue = min(int((4 * sextants + 0.5) * (over[spread] / 3.0)), HUE_BINS - 1)
            saturation = min(int((spread * SATURATION_BINS + 0.5) * over[high]), SATURATION_BINS - 1)
            out[y, x] = hue * SATURATION_BINS + saturation
