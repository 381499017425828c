"""Images as networks want them: brought to the network's size, colours as numbers; and boxes brought back.

Edges of boxes in a network's image are counted from the image's corner (0 is the left edge of the first pixel);
those of the program from the centre of the first pixel, so that they are half a pixel less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from occlog.array_types import Floats, Floats32
from occlog.records.frames import Image

from .config import CORNER, IMAGENET, IMAGENET_BGR, LETTERBOX, PAD, RAW, UNIT


def _table(mean: Sequence[float], deviation: Sequence[float], scale: float) -> Floats32:
    """(3, 256) number of each value of a colour: (value / scale - mean) / deviation, rounded as in 32 bits."""
    values = np.arange(256, dtype=np.float32) / np.float32(scale)
    column = (3, 1)
    means, deviations = (np.array(each, dtype=np.float32).reshape(column) for each in (mean, deviation))
    return np.asarray((values - means) / deviations)


PIXELS: dict[str, tuple[bool, Floats32]] = {
    UNIT: (True, _table((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 255.0)),
    IMAGENET: (True, _table((0.485, 0.456, 0.406), (0.229, 0.224, 0.225), 255.0)),
    IMAGENET_BGR: (False, _table((103.53, 116.28, 123.675), (57.375, 57.12, 58.395), 1.0)),
    RAW: (True, _table((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1.0)),
}
"""Of each choice whether red comes first, and the numbers of the values of each channel."""


@dataclass(frozen=True)
class Placement:
    """Where an image lies in a network's: x_network = x_scale * x + left, both counted from the corners."""

    x_scale: float
    y_scale: float
    left: float
    top: float
    width: int  # of the image [px]
    height: int

    def to_image(self, boxes: Floats) -> Floats:
        """(n, 4) left, top, right, bottom in the image, cut at its edges, of boxes (n, 4) in the network's image."""
        xs = (boxes[:, 0::2] - self.left) / self.x_scale
        ys = (boxes[:, 1::2] - self.top) / self.y_scale
        out = np.empty_like(boxes, dtype=np.float64)
        out[:, 0::2] = np.clip(xs, 0.0, self.width) - 0.5
        out[:, 1::2] = np.clip(ys, 0.0, self.height) - 0.5
        return out


def place(size: tuple[int, int], wanted: tuple[int, int], fit: str) -> Placement:
    """How an image comes to lie in a network's.

    `LETTERBOX` is that of ultralytics (`LetterBox`, `scaleup`, centred): one scale for both axes, the size rounded,
    the border halved and the odd pixel at the right and below.  `CORNER` is that of MMDetection (`Resize`, `Pad`).

    Args:
        size: width and height of the image.
        wanted: width and height of the network's.
        fit: `LETTERBOX`, `CORNER` or `STRETCH`.
    """
    (w, h), (W, H) = size, wanted
    if fit not in (LETTERBOX, CORNER):
        return Placement(W / w, H / h, 0.0, 0.0, w, h)
    scale = min(H / h, W / w)
    if fit == CORNER:
        new_w, new_h, left, top = int(w * scale + 0.5), int(h * scale + 0.5), 0, 0
    else:
        new_w, new_h = round(w * scale), round(h * scale)
        left, top = round((W - new_w) / 2 - 0.1), round((H - new_h) / 2 - 0.1)
    # What the rounded size says of each axis is where things truly are.
    new_w, new_h = min(max(new_w, 1), W), min(max(new_h, 1), H)
    return Placement(new_w / w, new_h / h, left, top, w, h)


def laid(image: Image, wanted: tuple[int, int], where: Placement, smooth: bool) -> Image:
    """The network's image (H, W, 3) from one in BGR; `smooth` averages where an image becomes smaller."""
    W, H = wanted
    new = (round(where.x_scale * where.width), round(where.y_scale * where.height))
    if new != (where.width, where.height):
        smaller = new[0] <= where.width and new[1] <= where.height
        image = np.asarray(
            cv2.resize(image, new, interpolation=cv2.INTER_AREA if smooth and smaller else cv2.INTER_LINEAR),
            dtype=np.uint8,
        )
    if new == (W, H):
        return image
    out = np.full((H, W, 3), PAD, dtype=np.uint8)
    left, top = int(where.left), int(where.top)
    out[top : top + new[1], left : left + new[0]] = image
    return out


def fill(out: Floats32, image: Image, pixels: str) -> None:
    """Write the numbers (3, H, W) of an image (H, W, 3) in BGR."""
    red_first, table = PIXELS[pixels]
    planes = cv2.split(image)
    for c in range(3):
        out[c] = cv2.LUT(planes[2 - c if red_first else c], table[c])


def crop(image: Image, box: Floats, wanted: tuple[int, int]) -> Image:
    """What is in a box (left, top, right, bottom) of an image, stretched to a size (width, height).

    All pixels of which a part is in the box are taken, at least one.
    """
    h, w = image.shape[:2]
    left, top = (int(np.clip(np.floor(edge + 0.5), 0, end - 1)) for edge, end in zip(box[:2], (w, h), strict=True))
    right, bottom = (int(np.clip(np.ceil(edge + 0.5), 1, end)) for edge, end in zip(box[2:], (w, h), strict=True))
    part = image[top : max(bottom, top + 1), left : max(right, left + 1)]
    return np.asarray(cv2.resize(part, wanted, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
