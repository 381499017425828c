"""Images of messages: encodings of raw pixels, rows with padding, what is no picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from occlog.errors import InputError
from occlog.io.messages.contents import is_picture, pixels, stored
from occlog.io.messages.kinds import ImageMessage, MessageStamp

RED, GREEN, BLUE = (0, 0, 250), (0, 250, 0), (250, 0, 0)


def message(rows: np.ndarray, encoding: str, width: int, step: int = 0) -> ImageMessage:
    rows = np.asarray(rows, dtype=np.uint8)
    return ImageMessage(MessageStamp(1, "f"), rows.tobytes(), encoding, (width, len(rows)), step or rows.shape[1])


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [
        ("rgb8", (250, 0, 0)),
        ("bgr8", (0, 0, 250)),
        ("8UC3", (0, 0, 250)),
        ("rgba8", (250, 0, 0, 9)),
        ("bgra8", (0, 0, 250, 9)),
    ],
)
def test_colours_keep_their_order(encoding: str, pixel: tuple[int, ...]) -> None:
    image = pixels(message(np.tile(pixel, (4, 6)), encoding, 6), "x")
    assert image.shape == (4, 6, 3)
    assert (image == RED).all()


def test_grey_pixels_stay_grey_and_the_padding_of_rows_is_left_out() -> None:
    rows = np.hstack([np.full((4, 6), 7), np.full((4, 2), 99)])
    image = pixels(message(rows, "mono8", 6), "x")
    assert image.shape == (4, 6)
    assert (image == 7).all()


@pytest.mark.parametrize("colour", [RED, GREEN, BLUE])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_are_named_by_their_first_two_rows(pattern: str, colour: tuple[int, int, int]) -> None:
    cell = np.array([colour["bgr".index(c)] for c in pattern]).reshape(2, 2)
    image = pixels(message(np.tile(cell, (6, 6)), f"bayer_{pattern}8", 12), "x")
    assert np.abs(image[3:-3, 3:-3].astype(int) - colour).max() <= 1


def test_yuv422_is_uyvy() -> None:
    grey = np.tile([128, 77, 128, 77], (4, 3))  # U Y V Y
    assert (pixels(message(grey, "yuv422", 6), "x") == pixels(message(grey[:, ::-1], "yuv422_yuy2", 6), "x")).all()


def test_compressed_images_stay_as_they_are_unless_another_kind_is_wanted() -> None:
    data = cv2.imencode(".png", np.full((4, 6), 7, np.uint8))[1].tobytes()
    sent = ImageMessage(MessageStamp(1, "f"), data, "mono8; png compressed")
    assert stored(sent, "x", None, 95) == (data, "png", (6, 4))
    assert stored(sent, "x", "jpeg", 95).kind == "jpeg"
    with pytest.raises(InputError, match="cut short"):
        stored(sent._replace(data=data[:-5]), "x", None, 95)


def test_depth_is_no_picture() -> None:
    assert not is_picture(message(np.zeros((2, 4)), "16UC1", 2))
    assert not is_picture(ImageMessage(MessageStamp(1, "f"), b"", "16UC1; compressedDepth png"))
    with pytest.raises(InputError, match="pixels of encoding '16UC1' cannot be read; known: mono8"):
        pixels(message(np.zeros((2, 4)), "16UC1", 2), "x")


def test_rows_must_hold_their_pixels_and_no_fewer() -> None:
    assert pixels(message(np.zeros((4, 18)), "bgr8", 6), "x").shape == (4, 6, 3)
    for bad in (message(np.zeros((4, 18)), "bgr8", 6, step=17), message(np.zeros((4, 17)), "bgr8", 6, step=18)):
        with pytest.raises(InputError, match="bytes are not 6 x 4 pixels of bgr8"):
            pixels(bad, "x")
