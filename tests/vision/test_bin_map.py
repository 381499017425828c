"""Maps of bins against the bin of each pixel."""

import numpy as np
import pytest

from occlog.core.jit import kernel
from occlog.vision.appearance import pixel_bin
from occlog.vision.bin_map import bin_map


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
