"""Appearance of people in detector boxes: colour histograms of the inscribed ellipses.

Pixels inside a more confident box with lower feet (a nearer person) are excluded.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from occlog.array_types import Bytes, Floats, Floats32
from occlog.core.image import N_BINS, pixel_bin
from occlog.core.numerics.jit import kernel

from .regions import normalised

WIDTH_SHARE: Final = 0.8
"""Width of the ellipse over that of the box; its height is that of the box."""
MIN_PIXELS = 30
"""Fewest pixels that are an appearance."""


def box_appearance(image: Bytes, boxes: Floats, score: Floats) -> Floats32:
    """(n, 72) normalised colour histograms of people in boxes; NaN if fewer than `MIN_PIXELS` pixels are visible.

    Pixels of the inscribed ellipse count, unless a box with lower feet and a higher confidence (a nearer person) covers
    them.

    Args:
        image: (height, width, 3) BGR.
        boxes: (n, 4) left, top, right, bottom [px].
        score: (n,) confidences of the boxes.
    """
    counts = np.zeros((len(boxes), N_BINS))
    _count_into(counts, image, np.ascontiguousarray(boxes, dtype=np.float64), np.ascontiguousarray(score))
    counts[counts.sum(axis=1) < MIN_PIXELS] = 0.0
    return normalised(counts).astype(np.float32)


@kernel
def _count_into(counts: Floats, image: Bytes, boxes: Floats, score: Floats) -> None:
    """Add the visible pixels of the ellipse in each box to its row of `counts`, in place.

    Args:
        counts: (n, 72) numbers of pixels per colour bin.
        image: (height, width, 3) BGR.
        boxes: (n, 4) left, top, right, bottom [px].
        score: (n,) confidences; a box with a lower bottom edge and a higher score hides the pixels inside it.
    """
    height, width = image.shape[:2]
    for i in range(len(boxes)):
        left, top, right, bottom = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
        cx, cy = 0.5 * (left + right), 0.5 * (top + bottom)
        rx, ry = 0.5 * WIDTH_SHARE * (right - left), 0.5 * (bottom - top)
        for y in range(max(int(np.ceil(top)), 0), min(int(np.floor(bottom)) + 1, height)):
            for x in range(max(int(np.ceil(left)), 0), min(int(np.floor(right)) + 1, width)):
                if ((x - cx) / rx) ** 2 + ((y - cy) / ry) ** 2 > 1.0:
                    continue
                hidden = False
                for j in range(len(boxes)):
                    if boxes[j, 3] > bottom and score[j] > score[i]:
                        inside = boxes[j, 0] < x < boxes[j, 2] and boxes[j, 1] < y < boxes[j, 3]
                        hidden = hidden or inside
                if not hidden:
                    k = pixel_bin(int(image[y, x, 0]), int(image[y, x, 1]), int(image[y, x, 2]))
                    counts[i, k] += 1.0
