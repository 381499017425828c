"""The range of brightness that images of the kind PNM (PGM, PPM) state, and what decoders make of it."""

from __future__ import annotations

import re

import numpy as np

from occlog.records.frames import Image

_HEAD = re.compile(rb"P([2356])" + rb"(?:\s|#[^\r\n]*[\r\n])+(\d{1,9})" * 3)
FULL, FULL_16 = 255, 65535


def stated_most(data: bytes) -> int | None:
    """The value of white that an image states; None for other kinds."""
    found = _HEAD.match(data)
    return None if found is None else int(found[4])


def is_scaled(data: bytes, most: int) -> bool:
    """Whether OpenCV makes 255 of white by itself: in text up to 255, and of values that use all of 8 or 16 bits."""
    return most in (FULL, FULL_16) or (most < FULL and data[1:2] in (b"2", b"3"))


def scaled(image: np.ndarray, most: int) -> Image:
    """An image as it was decoded with white as 255, rounded down as OpenCV does it; what is above white is white."""
    shades = (np.arange(most + 1) * FULL // most).astype(np.uint8)
    out = np.empty(image.shape, np.uint8)
    for row, values in zip(out, image, strict=True):  # all at once would take eight bytes for each value
        row[...] = shades[np.minimum(values, most)]
    return out
