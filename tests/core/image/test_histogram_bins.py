"""Maps of bins against the bin of each pixel."""

import numpy as np
import pytest

from occlog.core.image.histogram_bins import bin_map, update_bin_map
from occlog.core.numerics.jit import kernel
from occlog.measure.regions.appearance import pixel_bin


@kernel
def differences(blue: int, bins: np.ndarray) -> int:
    count = 0
    for g in range(256):
        for r in range(256):
            count += bins[g, r] != pixel_bin(blue, g, r)
    return count


@pytest.mark.jit
def test_every_colour_has_its_bin():
    g, r = np.mgrid[:256, :256].astype(np.uint8)
    assert sum(differences(b, bin_map(np.dstack([np.full_like(g, b), g, r]))) for b in range(256)) == 0


def test_colours_at_random_have_their_bins():
    image = np.random.default_rng(1).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    want = [[pixel_bin(*map(int, pixel)) for pixel in row] for row in image]
    assert np.array_equal(bin_map(image), want)


def test_grey_images_are_all_brightness():
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    assert np.array_equal(bin_map(image), 64 + image // 32)


def test_boxes_are_updated_and_the_rest_is_kept():
    old, new = np.random.default_rng(2).integers(0, 256, (2, 20, 30, 3)).astype(np.uint8)
    got, want = bin_map(old), bin_map(old)
    boxes = np.array([[3, 4, 9, 12], [7, 10, 99, 15], [-5, -5, 2, 2], [40, 0, 50, 10], [5, 5, 5, 9]])
    update_bin_map(got, new, boxes)
    whole = bin_map(new)
    for part in (np.s_[4:12, 3:9], np.s_[10:15, 7:], np.s_[:2, :2]):
        want[part] = whole[part]
    assert np.array_equal(got, want)


@pytest.mark.parametrize("step", [2, 3])
def test_only_pixels_that_count_are_updated(step):
    old, new = np.random.default_rng(3).integers(0, 256, (2, 20, 31, 3)).astype(np.uint8)
    got, want = bin_map(old), bin_map(old)
    update_bin_map(got, new, np.array([[1, 5, 9, 12], [-4, 8, 40, 30]]), step)
    box = np.zeros(got.shape, dtype=bool)
    box[5:12, 1:9] = box[8:, :] = True
    y, x = np.indices(got.shape)
    box &= (x % step == 0) & (y % step == 0)
    want[box] = bin_map(new)[box]
    assert np.array_equal(got, want)
