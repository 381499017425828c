"""Images of messages: compressed ones as they are, raw pixels of any common encoding as grey or BGR."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from occlog.errors import InputError
from occlog.io.frames.codec import encode_image, image_damage, image_kind, shown_size
from occlog.io.frames.decoders.apart import decode_apart
from occlog.io.frames.limits import MAX_PIXELS
from occlog.records.frames import Image

from .kinds import ImageMessage

_GREY = ("mono8", "8UC1")
_COLOURS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "8UC4": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    # ROS names a pattern by its first row from the left, OpenCV by the second row from the second pixel on.
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
}
"""Encodings of 8 bits: bytes a pixel, and how OpenCV makes BGR of them."""
ENCODINGS = (*_GREY, *_COLOURS)


class Stored(NamedTuple):
    """An image as it goes into the recording."""

    data: bytes
    kind: str
    size: tuple[int, int]


def is_picture(message: ImageMessage) -> bool:
    """Whether the message shows what a camera sees, and not depth or the like."""
    if message.size is not None:
        return message.encoding in ENCODINGS
    words = message.encoding.lower()
    return not any(word in words for word in ("compresseddepth", "16uc1", "32fc1", "mono16"))


def stored(message: ImageMessage, where: str, store: str | None, quality: int) -> Stored:
    """The image as bytes of a recording.

    Args:
        message: the image.
        where: names it in errors.
        store: `png` or `jpeg`; None: compressed images of these kinds as they are, all else as JPEG.
        quality: of JPEG.

    Raises:
        InputError: the image is damaged or of an encoding that cannot be read.
    """
    kind = None if message.size is not None else image_kind(message.data)
    size = shown_size(message.data) if kind is not None else None
    if kind is not None and size is not None and store in (None, kind):
        damage = image_damage(message.data)
        if damage is None and size[0] * size[1] > MAX_PIXELS:
            damage = f"{size[0]} x {size[1]} px; the limit is {MAX_PIXELS} pixels"
        if damage is not None:
            raise InputError(f"{where}: {damage}")
        return Stored(message.data, kind, size)
    image = pixels(message, where)
    kind = store or "jpeg"
    return Stored(encode_image(image, kind, quality), kind, (image.shape[1], image.shape[0]))


def pixels(message: ImageMessage, where: str) -> Image:
    """(h, w, 3) BGR or (h, w) grey; InputError as `stored`."""
    if message.size is None:
        return decode_apart(message.data, f"{where} ({message.encoding})")
    (width, height), encoding = message.size, message.encoding
    if not is_picture(message):
        raise InputError(f"{where}: pixels of encoding {encoding!r} cannot be read; known: {', '.join(ENCODINGS)}")
    each, code = (1, None) if encoding in _GREY else _COLOURS[encoding]
    step = message.step or width * each
    if not (0 < width * height <= MAX_PIXELS and step >= width * each and len(message.data) >= step * height):
        raise InputError(
            f"{where}: {len(message.data)} bytes are not {width} x {height} pixels of {encoding}, {step} bytes a row"
        )
    rows = np.frombuffer(message.data, np.uint8, count=step * height).reshape(height, step)[:, : width * each]
    image = np.ascontiguousarray(rows if each == 1 else rows.reshape(height, width, each))
    try:
        return image if code is None else cv2.cvtColor(image, code)
    except cv2.error as error:
        reason = " ".join(str(error.err).split())[:100]
        raise InputError(f"{where}: pixels of {encoding} cannot be converted ({reason})") from None
