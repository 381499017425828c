"""Limits of images: size, end marks, black bars."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.frames.codec import BLACK, PNG_MARK, dark_bars, decode_image, image_damage, image_size
from occlog.io.frames.limits import MAX_PIXELS


def png_head(width: int, height: int) -> bytes:
    """The beginning of a PNG image, up to its size."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return PNG_MARK + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))


def jpeg() -> bytes:
    return cv2.imencode(".jpg", np.full((8, 8, 3), 90, np.uint8))[1].tobytes()


def test_an_image_of_the_most_pixels_is_decoded_and_a_larger_one_is_refused_first() -> None:
    side = int(MAX_PIXELS**0.5)
    assert side**2 == MAX_PIXELS
    with pytest.raises(InputError, match="cut short"):  # its size is accepted
        decode_image(png_head(side, side), "x")
    with pytest.raises(InputError, match=f"{side} x {side + 1} px; the limit is {MAX_PIXELS} pixels"):
        decode_image(png_head(side, side + 1), "x")


def test_a_size_needs_24_bytes_of_a_png_image() -> None:
    assert image_size(png_head(3, 4)[:24]) == (3, 4)
    assert image_size(png_head(3, 4)[:23]) is None
    assert image_size(jpeg()) == (8, 8)
    assert image_size(b"GIF89a" + bytes(30)) is None


def test_the_end_mark_of_a_jpeg_image_is_looked_for_in_its_last_kilobyte() -> None:
    assert jpeg().endswith(b"\xff\xd9")
    assert image_damage(jpeg() + bytes(1022)) is None
    assert "the end mark of a JPEG image is missing" in (image_damage(jpeg() + bytes(1023)) or "")


def test_a_png_image_ends_with_its_last_part_and_not_a_byte_before() -> None:
    whole = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes()
    assert image_damage(whole) is None
    assert "the end mark of a PNG image is missing" in (image_damage(whole[:-1]) or "")


@pytest.mark.parametrize(("level", "bars"), [(BLACK, (3, 2, 1, 4)), (BLACK + 1, (0, 0, 0, 0))])
def test_a_bar_is_black_up_to_a_mean(level: int, bars: tuple[int, int, int, int]) -> None:
    image = np.full((20, 30), level, np.uint8)
    image[2:16, 3:29] = 200
    assert dark_bars(image) == bars
    assert dark_bars(np.full((20, 30, 3), BLACK, np.uint8)) == (0, 0, 0, 0)
