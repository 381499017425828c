"""The empty scene behind moving people, from frames sampled over a recording.

A plain median over time shows a person who stays in one place for most of it.  Here a
sample is left out of a pixel's median where the picture around the pixel changes towards
the sample before or after it, that is where something moves; so the scene behind a man
who moves on the spot is found as soon as it shows in one quiet sample.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from occlog.array_types import Bytes
from occlog.core.numerics.jit import kernel

CHANGE = 12.0  # grey levels between two samples that mean motion, after smoothing
SMOOTHING_PX = 0.7  # more hides the edges of slow bodies
COARSE_THICKNESS_PX = 30.0  # bodies are thinned to this before their edges are sought
MAX_SAMPLES = 64  # size of the kernel's scratch space


def motion_masks(samples: Bytes, thickness_px: float) -> Bytes:
    """(n, height, width) 1 where something moves in a sample, 0 where it is quiet.

    Args:
        samples: (n, height, width, channels) in order of time.
        thickness_px: bodies up to this thickness are filled between their moving edges.
    """
    # Edges of motion need no fine grid: thick bodies are filled in a coarser one.
    coarse = max(1, int(thickness_px / COARSE_THICKNESS_PX))
    height, width = samples.shape[1:3]
    size = (max(1, width // coarse), max(1, height // coarse))
    smooth = [
        cv2.GaussianBlur(cv2.resize(s, size, interpolation=cv2.INTER_AREA), (0, 0), SMOOTHING_PX) for s in samples
    ]
    changed = np.stack([(difference(a, b) > CHANGE).astype(np.uint8) for a, b in pairwise(smooth)])
    moving = np.concatenate([changed[:1], changed[:-1] | changed[1:], changed[-1:]])
    side = 2 * round(thickness_px / coarse / 2) + 1
    square = np.ones((side, side), np.uint8)
    closed = [cv2.morphologyEx(m, cv2.MORPH_CLOSE, square) for m in moving]
    return np.stack([cv2.resize(m, (width, height), interpolation=cv2.INTER_NEAREST) for m in closed])


def empty_scene(samples: list[Bytes], thickness_px: float) -> Bytes:
    """Image of the scene without what moves: per pixel the median of its quiet samples.

    Args:
        samples: at least one image (height, width, 3) or (height, width), all of one
            size, in order of time.
        thickness_px: thickness of a person in the image.

    Returns:
        Image like the samples.  A pixel that is never quiet gets the median of all
        samples: something that is always there and always moves stays in the picture.
    """
    if len(samples) < 3:
        return samples[0].copy()
    stack = np.stack(samples[:MAX_SAMPLES])
    masks = motion_masks(stack, thickness_px)
    shape = stack.shape[1:]
    return _masked_median(stack.reshape(len(stack), shape[0] * shape[1], -1), masks.reshape(len(stack), -1)).reshape(
        shape
    )


@kernel
def _masked_median(samples: Bytes, masks: Bytes) -> Bytes:
    """(pixels, channels) lower median over samples (n, pixels, channels) where masks (n, pixels) is 0, or over all."""
    n, pixels, channels = samples.shape
    out = np.empty((pixels, channels), dtype=np.uint8)
    values = np.empty(n, dtype=np.uint8)
    for p in range(pixels):
        quiet = 0
        for i in range(n):
            quiet += masks[i, p] == 0
        for c in range(channels):
            count = 0
            for i in range(n):
                if quiet == 0 or masks[i, p] == 0:
                    # Insertion sort: n is small.
                    j = count
                    while j > 0 and values[j - 1] > samples[i, p, c]:
                        values[j] = values[j - 1]
                        j -= 1
                    values[j] = samples[i, p, c]
                    count += 1
            out[p, c] = values[(count - 1) // 2]
    return out


def difference(a: Bytes, b: Bytes) -> Bytes:
    """(height, width) largest absolute difference over the channels of two images of one shape."""
    change = cv2.absdiff(a, b)
    if change.ndim == 2:
        return change  # type: ignore[no-any-return]
    blue, green, red = cv2.split(change)
    return cv2.max(cv2.max(blue, green), red)  # type: ignore[no-any-return]
