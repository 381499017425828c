from __future__ import annotations

import cv2
import numpy as np
import pytest

from occlog.core.image import N_BINS, pixel_bin
from occlog.measure.regions import regions as appearance
from occlog.records.tables import APPEARANCE_BINS


def random_image(seed: int, height: int = 23, width: int = 31) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_the_record_and_the_kernel_agree_on_the_number_of_bins() -> None:
    assert N_BINS == APPEARANCE_BINS


@pytest.mark.parametrize("seed", [0, 1])
def test_histogram_agrees_with_opencv_up_to_its_rounding_of_hue(seed: int) -> None:
    # calcHist counts OpenCV's rounded 8-bit hue and saturation, so pixels near a limit may move.
    image = random_image(seed, 120, 160)
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV_FULL)
    high, low = image.max(axis=2).astype(int), image.min(axis=2).astype(int)
    coloured = ((10 * (high - low) > high) & (5 * high > 255)).astype(np.uint8)
    hs = cv2.calcHist([hsv], [0, 1], coloured, [8, 8], [0, 256, 0, 256])
    grey = cv2.calcHist([high.astype(np.uint8)], [0], 1 - coloured, [8], [0, 256])
    want = np.concatenate([hs.ravel(), grey.ravel()]) / image.shape[0] / image.shape[1]
    got = appearance.histogram(image)
    np.testing.assert_allclose(got[64:], want[64:], atol=1e-12)
    assert np.abs(got - want).sum() < 0.02


def test_histogram_counts_only_the_masked_pixels_and_sums_to_one() -> None:
    image = np.zeros((10, 10, 3), dtype=np.uint8)
    image[:5] = (0, 0, 255)
    mask = np.zeros((10, 10), dtype=np.uint8)
    mask[4:6, 2:4] = 1
    got = appearance.histogram(image, mask)
    assert got.sum() == 1.0
    assert got[pixel_bin(0, 0, 255)] == 0.5
    assert got[64] == 0.5


def test_histogram_without_pixels_is_nan() -> None:
    assert np.isnan(appearance.histogram(random_image(0), np.zeros((23, 31), dtype=np.uint8))).all()


def test_grey_images_fill_the_brightness_bins_only() -> None:
    got = appearance.histogram(np.full((4, 4), 200, dtype=np.uint8))
    assert got[64 + 200 // 32] == 1.0


def test_box_over_the_edge_of_the_image_is_cut() -> None:
    counts = np.zeros(72)
    appearance.add_pixels_into(counts, random_image(1), np.ones((23, 31), dtype=np.uint8), -5, -5, 99, 99, 0.5)
    assert counts.sum() == 0.5 * 23 * 31


def test_likeness_is_one_for_equal_and_zero_for_disjoint_histograms() -> None:
    rng = np.random.default_rng(3)
    a = appearance.normalised(rng.random((3, 72)))
    b = np.zeros((2, 72))
    b[0, 3], b[1, 70] = 1.0, 1.0
    np.testing.assert_allclose(np.diag(appearance.similarity(a, a)), 1.0)
    assert appearance.similarity(b, b)[0, 1] == 0.0
    np.testing.assert_allclose(appearance.similarity(a, b), np.sqrt(a[:, [3, 70]]))
    assert np.isnan(appearance.similarity(a, np.full((1, 72), np.nan))).all()
