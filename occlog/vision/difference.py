"""How much two images differ, pixel by pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


def difference(a: Bytes, b: Bytes) -> Bytes:
    """(height, width) largest absolute difference over the channels of two images of one shape."""
    change = cv2.absdiff(a, b)
    if change.ndim == 2:
        return change  # type: ignore[no-any-return]
    blue, green, red = cv2.split(change)
    return cv2.max(cv2.max(blue, green), red)  # type: ignore[no-any-return]
