"""How much two images differ, pixel by pixel."""

from __future__ import annotations

import cv2

from occlog.array_types import Bytes


def difference(a: Bytes, b: Bytes) -> Bytes:
    """(height, width) largest absolute difference over the channels of two images of one shape."""
    change = cv2.absdiff(a, b)
    if change.ndim == 2:
        return change  # type: ignore[no-any-return]
    blue, green, red = cv2.split(change)
    return cv2.max(cv2.max(blue, green), red)  # type: ignore[no-any-return]
