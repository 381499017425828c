"""Densities of colours: bins against the compiled form, the coefficient and its bias against their closed forms."""

from __future__ import annotations

import colorsys

import numpy as np
import pytest

from occlog.core.image import (
    N_BINS,
    bhattacharyya,
    bias,
    bins_of,
    colour_bins,
    colour_counts,
    corrected,
    density,
    update_bins,
)


def slow_bin(pixel, levels):
    """The bin of one pixel (BGR) by exact fractions of hue, saturation and value."""
    blue, green, red = (int(v) for v in pixel)
    hue, saturation, _ = colorsys.rgb_to_hsv(red / 255, green / 255, blue / 255)
    high, low = max(blue, green, red), min(blue, green, red)
    if 10 * (high - low) <= high or 5 * high <= 255:
        return levels**2 + high * levels // 256
    row = min(int(hue * levels + 1e-9), levels - 1)
    return row * levels + min(int(saturation * levels + 1e-9), levels - 1)


@pytest.mark.parametrize("levels", [2, 3, 8, 15])
def test_bins_are_those_of_the_slow_form(levels):
    rng = np.random.default_rng(levels)
    image = rng.integers(0, 256, (40, 40, 3)).astype(np.uint8)
    image[:5] = [[0, 0, 0]]
    image[5:10] = [[255, 255, 255]]
    image[10:12] = [[0, 0, 255]]
    image[12:14] = [[255, 0, 255]]
    want = np.array([[slow_bin(pixel, levels) for pixel in row] for row in image])
    assert (colour_bins(image, levels) == want).all()
    assert want.max() < bins_of(levels)


def test_eight_levels_are_the_bins_of_views():
    image = np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    bins = np.zeros((60, 80), dtype=np.uint8)
    update_bins(bins, image, np.array([[0, 0, 80, 60]]))
    assert bins_of(8) == N_BINS
    assert (colour_bins(image, 8) == bins).all()


def test_a_grey_image_has_no_hue():
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    assert (colour_bins(image, 4) == 16 + np.arange(256).reshape(16, 16) // 64).all()


def test_only_masked_pixels_count():
    image = np.zeros((4, 4, 3), dtype=np.uint8)
    image[:2] = (0, 0, 255)
    mask = np.zeros((4, 4), dtype=np.uint8)
    mask[1:3, 0] = 1
    counts = colour_counts(image, mask, 2)
    assert counts.tolist() == [0, 1, 0, 0, 1, 0]
    assert density(counts).sum() == 1.0
    assert np.isnan(density(np.zeros(6))).all()


def test_coefficient_is_one_for_equal_and_zero_for_disjoint_densities():
    a = np.array([[0.5, 0.5, 0.0], [0.0, 0.0, 1.0]])
    assert bhattacharyya(a, a).tolist() == [[pytest.approx(1.0), 0.0], [0.0, 1.0]]
    slow = sum(np.sqrt(p * q) for p, q in zip([0.2, 0.3, 0.5], [0.6, 0.1, 0.3], strict=True))
    assert bhattacharyya(np.array([[0.2, 0.3, 0.5]]), np.array([[0.6, 0.1, 0.3]]))[0, 0] == pytest.approx(slow)


@pytest.mark.parametrize(("bins", "n", "within"), [(64, 2000, 2e-4), (16, 400, 2e-3), (32, 2000, 2e-4)])
def test_bias_is_the_closed_form_where_bins_have_many_values(bins, n, within):
    rng = np.random.default_rng(1)
    samples = density(rng.multinomial(n, np.full(bins, 1.0 / bins), size=(2, 400)))
    rho = np.sqrt(samples[0] * samples[1]).sum(axis=1)
    assert rho.mean() == pytest.approx(1.0 - bias(bins, n, n), abs=within)


def test_bias_is_larger_than_the_closed_form_where_bins_have_few_values():
    """The second order does not suffice: 256 bins, 2 values in each."""
    rng = np.random.default_rng(1)
    samples = density(rng.multinomial(500, np.full(256, 1.0 / 256), size=(2, 200)))
    assert np.sqrt(samples[0] * samples[1]).sum(axis=1).mean() < 0.81 < 1.0 - bias(256, 500, 500)


def test_correction_counts_the_colours_that_there_are():
    a, b = np.array([[0.5, 0.5, 0.0, 0.0]]), np.array([[0.5, 0.0, 0.5, 0.0]])
    rho, without = corrected(a, b, np.array([100]), np.array([50]))
    assert rho[0, 0] == pytest.approx(0.5)
    assert without[0, 0] == pytest.approx(0.5 + 2.0 / 8.0 * (1 / 100 + 1 / 50))
