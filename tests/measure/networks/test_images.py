from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from occlog.measure.networks.config import CORNER, IMAGENET, IMAGENET_BGR, LETTERBOX, PAD, RAW, STRETCH, UNIT
from occlog.measure.networks.network import ImagePlacement, crop, fill, image_placement, laid

SIZES = [(1920, 1080), (1080, 1920), (640, 480), (641, 359), (333, 500), (64, 64), (100, 3), (3, 100), (1, 1)]
RNG = np.random.default_rng(0)


def picture(size: tuple[int, int]) -> np.ndarray:
    return RNG.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)


def letterboxed(image: np.ndarray, wanted: tuple[int, int]) -> np.ndarray:
    """What ultralytics does to an image, by its documentation: scale, border of 114, rounding by 0.1."""
    h, w = image.shape[:2]
    ratio = min(wanted[1] / h, wanted[0] / w)
    new = round(w * ratio), round(h * ratio)
    across, down = (wanted[0] - new[0]) / 2, (wanted[1] - new[1]) / 2
    if (w, h) != new:
        image = cv2.resize(image, new, interpolation=cv2.INTER_LINEAR)
    edges = [round(down - 0.1), round(down + 0.1), round(across - 0.1), round(across + 0.1)]
    return cv2.copyMakeBorder(image, *edges, cv2.BORDER_CONSTANT, value=(114, 114, 114))


@pytest.mark.parametrize("wanted", [(640, 640), (416, 256), (96, 33)])
@pytest.mark.parametrize("size", SIZES)
def test_a_letterbox_is_that_of_ultralytics(size: tuple[int, int], wanted: tuple[int, int]) -> None:
    image = picture(size)
    where = image_placement(size, wanted, LETTERBOX)
    assert_array_equal(laid(image, wanted, where, smooth=False), letterboxed(image, wanted))


def test_a_corner_letterbox_has_its_border_at_the_right_and_below() -> None:
    image = picture((100, 50))
    out = laid(image, (64, 64), image_placement((100, 50), (64, 64), CORNER), smooth=False)
    assert (out[32:] == PAD).all()
    assert_array_equal(out[:32], cv2.resize(image, (64, 32), interpolation=cv2.INTER_LINEAR))


@pytest.mark.parametrize("fit", [LETTERBOX, CORNER, STRETCH])
@pytest.mark.parametrize("size", SIZES)
def test_places_come_back_where_they_were(size: tuple[int, int], fit: str) -> None:
    where = image_placement(size, (320, 192), fit)
    corners = np.array([[0.0, 0.0, *size], [0.25 * size[0], 0.5 * size[1], 0.75 * size[0], 0.875 * size[1]]])
    scale = np.array([where.x_scale, where.y_scale] * 2)
    there = corners * scale + np.array([where.left, where.top] * 2)
    assert there.min() >= 0
    assert (there[:, 2] <= 320).all()
    assert (there[:, 3] <= 192).all()
    assert_allclose(where.to_image(there), corners - 0.5, atol=1e-9)


def test_boxes_are_cut_at_the_edges_of_the_image() -> None:
    where = ImagePlacement(2.0, 2.0, 0.0, 10.0, 30, 20)
    found = where.to_image(np.array([[-7.0, -7.0, 99.0, 99.0], [0.0, 10.0, 60.0, 50.0], [2.0, 14.0, 58.0, 46.0]]))
    assert_array_equal(found, [[-0.5, -0.5, 29.5, 19.5], [-0.5, -0.5, 29.5, 19.5], [0.5, 1.5, 28.5, 17.5]])


def test_colours_become_the_numbers_that_their_formulas_say() -> None:
    image = picture((7, 5))
    rgb = image[:, :, ::-1].transpose(2, 0, 1).astype(np.float32)
    bgr = image.transpose(2, 0, 1).astype(np.float32)
    mean, deviation = (np.array(v, np.float32)[:, None, None] for v in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    grey = np.array([103.53, 116.28, 123.675], np.float32)[:, None, None]
    wide = np.array([57.375, 57.12, 58.395], np.float32)[:, None, None]
    wanted = {
        UNIT: rgb / np.float32(255),
        RAW: rgb,
        IMAGENET: (rgb / np.float32(255) - mean) / deviation,
        IMAGENET_BGR: (bgr - grey) / wide,
    }
    for pixels, numbers in wanted.items():
        out = np.empty((3, 5, 7), dtype=np.float32)
        fill(out, image, pixels)
        assert_array_equal(out, numbers, err_msg=pixels)


def test_a_crop_takes_all_pixels_that_a_box_touches_and_at_least_one() -> None:
    image = np.zeros((10, 20, 3), dtype=np.uint8)
    image[2:5, 3:9] = 200
    assert (crop(image, np.array([2.5, 1.5, 8.5, 4.5]), (6, 3)) == 200).all()  # the block's own edges
    assert (crop(image, np.array([2.5, 1.5, 8.51, 4.5]), (7, 3))[:, -1] < 200).all()
    assert crop(image, np.array([19.4, 9.4, 19.5, 9.5]), (4, 4)).shape == (4, 4, 3)
    assert crop(image, np.array([-0.5, -0.5, -0.5, -0.5]), (4, 4)).shape == (4, 4, 3)
