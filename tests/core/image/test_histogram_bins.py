"""Bins of colours against the textbook's formulas, and maps of bins against the bin of each pixel."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import Bytes
from occlog.core.image import N_BINS, pixel_bin, update_bins
from occlog.core.numerics.jit import kernel


def slow_bin(b: int, g: int, r: int) -> int:
    """The definition in floating point, hue by the textbook's degrees."""
    high, low = max(b, g, r), min(b, g, r)
    value, saturation = high / 255.0, (high - low) / high if high else 0.0
    if saturation <= 0.1 or value <= 0.2:
        return 64 + int(high / 32)
    if high == r:
        degrees = 60.0 * (g - b) / (high - low) % 360.0
    elif high == g:
        degrees = 120.0 + 60.0 * (b - r) / (high - low)
    else:
        degrees = 240.0 + 60.0 * (r - g) / (high - low)
    return 8 * min(int(degrees / 45.0 + 1e-9), 7) + min(int(8.0 * saturation + 1e-9), 7)


@kernel
def whole_number_bin(b: int, g: int, r: int) -> int:
    """The definition by division of whole numbers."""
    high, spread = max(b, g, r), max(b, g, r) - min(b, g, r)
    if 10 * spread <= high or 5 * high <= 255:
        return 64 + high // 32
    if high == r:
        sextants = (g - b) % (6 * spread)
    elif high == g:
        sextants = 2 * spread + b - r
    else:
        sextants = 4 * spread + r - g
    return 8 * min(4 * sextants // (3 * spread), 7) + min(8 * spread // high, 7)


@kernel
def differences() -> int:
    """How many of all colours have another bin than by division."""
    count = 0
    for b in range(256):
        for g in range(256):
            for r in range(256):
                count += pixel_bin(b, g, r) != whole_number_bin(b, g, r)
    return count


def bins_of(image: Bytes) -> Bytes:
    """The bins of a whole image."""
    bins = np.full(image.shape[:2], 255, dtype=np.uint8)
    update_bins(bins, image, np.array([[0, 0, image.shape[1], image.shape[0]]]))
    return bins


@pytest.mark.jit
def test_every_colour_has_its_bin() -> None:
    assert differences() == 0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_colours_at_random_have_the_bin_of_the_textbook(seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (23, 31, 3)).astype(np.uint8)
    want = [[slow_bin(*map(int, pixel)) for pixel in row] for row in image]
    assert bins_of(image).tolist() == want


def test_primary_colours_have_the_bins_of_their_hue() -> None:
    bgr = {"red": (0, 0, 255), "yellow": (0, 255, 255), "green": (0, 255, 0), "blue": (255, 0, 0)}
    hues = {name: pixel_bin(*c) // 8 for name, c in bgr.items()}
    assert hues == {"red": 0, "yellow": 1, "green": 2, "blue": 5}
    assert pixel_bin(0, 0, 0) == 64
    assert pixel_bin(255, 255, 255) == N_BINS - 1 == 71


def test_a_pixel_has_a_hue_above_a_tenth_of_saturation_and_a_fifth_of_value() -> None:
    assert pixel_bin(180, 180, 200) == 64 + 200 // 32  # saturation 0.1
    assert pixel_bin(179, 179, 200) == 0  # red, saturation 0.105
    assert pixel_bin(0, 0, 51) == 64 + 51 // 32  # value 0.2
    assert pixel_bin(0, 0, 52) == 7  # red, saturation 1


def test_grey_images_are_all_brightness() -> None:
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    assert np.array_equal(bins_of(image), 64 + image // 32)


def test_boxes_are_updated_and_the_rest_is_kept() -> None:
    old, new = np.random.default_rng(2).integers(0, 256, (2, 20, 30, 3)).astype(np.uint8)
    got, want = bins_of(old), bins_of(old)
    boxes = np.array([[3, 4, 9, 12], [7, 10, 99, 15], [-5, -5, 2, 2], [40, 0, 50, 10], [5, 5, 5, 9]])
    update_bins(got, new, boxes)
    whole = bins_of(new)
    for part in (np.s_[4:12, 3:9], np.s_[10:15, 7:], np.s_[:2, :2]):
        want[part] = whole[part]
    assert np.array_equal(got, want)


def test_with_a_step_only_its_multiples_are_updated() -> None:
    old, new = np.random.default_rng(3).integers(0, 256, (2, 20, 30, 3)).astype(np.uint8)
    got, want = bins_of(old), bins_of(old)
    update_bins(got, new, np.array([[4, -1, 26, 17]]), step=3)
    box = np.s_[0:17:3, 6:26:3]
    want[box] = bins_of(new)[box]
    assert np.array_equal(got, want)
