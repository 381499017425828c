"""Compressed images: size and damage told from their bytes, encoding, decoding with a limit."""

from __future__ import annotations

import struct
import zlib
from contextlib import suppress

import cv2
import numpy as np

from occlog.errors import InputError
from occlog.records.frames import Image

from .limits import MAX_PIXELS
from .several import SEVERAL, holds_several
from .stated_range import FULL_16, is_scaled, scaled, stated_most

MAX_SCANS = 200
"""Scans of a JPEG image at most: progressive ones have some ten, and each goes through all pixels again."""
PNG_MARK = b"\x89PNG\r\n\x1a\n"
ORIENTATION = (0x0112, 3, 1)
"""Tag, type and count of the entry of Exif data that says how an image has to be turned."""
SIDEWAYS = (5, 6, 7, 8)
"""Values of it by which width and height are exchanged."""
EXIF_BYTES = 1 << 16
"""Bytes of a JPEG image among which its Exif data begin."""
DEEP_MARKS = (b"II*\0", b"MM\0*", b"P2", b"P3", b"P5", b"P6")
"""What TIFF, PGM and PPM begin with, whose values may have 16 bits; of PNG a byte says so."""
DARK_16 = 4095
"""Largest of values of 16 bits up to which they are taken for values of 12 bits or fewer, which say so nowhere."""
BLACK = 24
"""Mean of the brightest channel up to which a row or column is a black bar; codecs leave some noise in it."""


def image_kind(data: bytes) -> str | None:
    """`png` or `jpeg` by the first bytes, None for anything else."""
    if data.startswith(PNG_MARK):
        return "png"
    return "jpeg" if data.startswith(b"\xff\xd8\xff") else None


def image_size(data: bytes) -> tuple[int, int] | None:
    """Width and height [px] of PNG or JPEG bytes without decoding them; None where they do not say."""
    if image_kind(data) == "png" and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return int(width), int(height)
    return _jpeg_size(data) if image_kind(data) == "jpeg" else None


def shown_size(data: bytes) -> tuple[int, int] | None:
    """As `image_size`, of the image as it is decoded: turned as its Exif data say."""
    size = image_size(data)
    return size if size is None or _orientation(data) not in SIDEWAYS else size[::-1]


def _orientation(data: bytes) -> int:
    """How the image has to be turned, 1 to 8 as Exif has it; 1, which is not at all, where it does not say."""
    png = image_kind(data) == "png"
    at = data.find(b"eXIf", 0, data.find(b"IDAT")) + 4 if png else data.find(b"Exif\0\0", 0, EXIF_BYTES) + 6
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[at : at + 4])
    if order is None:
        return 1
    with suppress(struct.error):
        begin = at + struct.unpack_from(f"{order}I", data, at + 4)[0]
        for entry in range(struct.unpack_from(f"{order}H", data, begin)[0]):
            tag, kind, count, value = struct.unpack_from(f"{order}HHIH", data, begin + 2 + 12 * entry)
            if (tag, kind, count) == ORIENTATION:
                return int(value)
    return 1


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = 2
    # As decoders do, from mark to mark, whatever lies between
    while 0 <= (at := data.find(b"\xff", at)) <= len(data) - 9:
        mark, length = data[at + 1], struct.unpack_from(">H", data, at + 2)[0]
        # The frame header is one of SOF0..SOF15 without DHT (c4), JPG (c8) and DAC (cc).
        if 0xC0 <= mark <= 0xCF and mark not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return int(width), int(height)
        alone = mark in (0x00, 0x01) or 0xD0 <= mark <= 0xD9  # of these no length follows
        at += 1 if mark == 0xFF else 2 if alone else 2 + length
    return None


def image_damage(data: bytes) -> str | None:
    """What is wrong with PNG or JPEG bytes as far as their marks and check sums tell; None: nothing."""
    kind = image_kind(data)
    if kind == "png":
        return _png_damage(data)
    if kind == "jpeg" and b"\xff\xd9" not in data[-1024:]:
        return "cut short: the end mark of a JPEG image is missing"
    if kind == "jpeg" and (scans := _scans(data)) > MAX_SCANS:
        return f"{scans} scans; a JPEG image of at most {MAX_SCANS} was expected"
    return SEVERAL if holds_several(data) else None


def _scans(data: bytes) -> int:
    """How many scans of a JPEG image begin; `bytes.count` would take a tenth of the time of decoding."""
    values = np.frombuffer(data, np.uint8)
    return int(np.count_nonzero((values[:-1] == 0xFF) & (values[1:] == 0xDA)))


def _png_damage(data: bytes) -> str | None:
    at = len(PNG_MARK)
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(data[at + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            return f"wrong check sum of PNG part {name.decode('ascii', 'backslashreplace')} at byte {at}"
        if name == b"acTL" and int.from_bytes(data[at + 8 : at + 12], "big") > 1:
            return SEVERAL
        if name == b"IEND":
            return None
        at = end
    return "cut short: the end mark of a PNG image is missing"


def check_image(data: bytes, where: str) -> None:
    """InputError for images that are too large, or damaged as far as their marks and check sums tell."""
    size = image_size(data)
    if size is not None and size[0] * size[1] > MAX_PIXELS:
        raise InputError(f"{where}: {size[0]} x {size[1]} px; the limit is {MAX_PIXELS} pixels")
    damage = image_damage(data)
    if damage:
        raise InputError(f"{where}: {damage}")


def decode_image(data: bytes, where: str) -> Image:
    """(h, w, 3) BGR or (h, w) grey; InputError for damaged, too large or unknown images.

    For the decoding process, which meets foreign bytes in place of the command (see `apart`).
    """
    check_image(data, where)
    most = stated_most(data)
    unscaled = most is not None and 0 < most < FULL_16 and not is_scaled(data, most)
    how = cv2.IMREAD_ANYCOLOR | (cv2.IMREAD_ANYDEPTH if unscaled else 0)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), how) if data else None
    except cv2.error as error:
        if error.func == "validateInputImageSize":
            raise InputError(f"{where}: has more pixels than the limit, {MAX_PIXELS}") from None
        raise InputError(f"{where}: cannot be decoded ({' '.join(str(error.err).split())})") from None
    if image is None:
        raise InputError(f"{where}: not an image that can be decoded ({len(data)} bytes)")
    if unscaled and most is not None:
        return scaled(image, most)
    _check_depth(data, where)
    return image  # type: ignore[no-any-return]


def _check_depth(data: bytes, where: str) -> None:
    """InputError for values of 16 bits that use the lowest of them alone: the upper 8 bits are what is decoded."""
    if not (data[24:25] == b"\x10" if image_kind(data) == "png" else data.startswith(DEEP_MARKS)):
        return
    deep = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    if deep is not None and deep.dtype == np.uint16 and 0 < (most := int(deep.max())) <= DARK_16:
        raise InputError(
            f"{where}: values of 16 bits up to {most} of 65535, which as 8 bits would be nearly black; scale them to "
            "the whole range, or write 8 bits"
        )


def dark_bars(image: Image) -> tuple[int, int, int, int]:
    """Width of the black bars at the left, top, right and lower edge [px], as converters add them."""
    grey = image if image.ndim == 2 else image.max(axis=2)
    columns, rows = grey.mean(axis=0) > BLACK, grey.mean(axis=1) > BLACK
    if not columns.any() or not rows.any():
        return 0, 0, 0, 0
    return int(columns.argmax()), int(rows.argmax()), int(columns[::-1].argmax()), int(rows[::-1].argmax())


def encode_image(image: Image, kind: str, quality: int) -> bytes:
    """PNG (lossless) or JPEG bytes of an image; the same bytes for the same image on every machine."""
    if kind == "png":
        # A third faster than the default, and smaller on photographs.
        ok, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_FILTERED])
    else:
        ok, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise ValueError(f"an image of shape {image.shape} cannot be encoded as {kind}")
    return data.tobytes()
