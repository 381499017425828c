"""One video frame on its way from a recording to the detector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
"""(height, width, 3) BGR, or (height, width) grey."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame of one camera; the image is decoded only when asked for.

    `decode` must be called at most once, in the order of `index` for each camera
    (compressed video can only be decoded forwards).  It raises InputError for a
    frame that cannot be decoded.  `encoded` is the compressed image as recorded, PNG or
    JPEG as a rule; None: the frame is in a video.
    """

    t_ns: int
    sensor: str
    index: int
    decode: Callable[[], Image]
    encoded: bytes | None = None
