"""Colours inside ellipses against sums over every pixel, and those of their halves."""

import math

import numpy as np
import pytest
from ellipse_reference import ellipse_distance

from occlog.track.methods.images.kernels.appearance import WIDTH, colour_similarity, colours_in, level, upright

W, H = 40, 30


def histograms(bins, ellipses, n_bins, step):
    """Histograms of whole ellipses, of the first bins."""
    out = colours_in(bins, ellipses, np.zeros(len(ellipses), dtype=bool), step)
    assert not out[:, n_bins:].any()
    return out[:, :n_bins]


def likenesses(bins, ellipses, owner, models, step):
    """Bhattacharyya coefficients with models of whole ellipses, of the first bins."""
    colours = np.zeros((len(models), WIDTH))
    colours[:, : models.shape[1]] = models
    return colour_similarity(bins, ellipses, owner, colours, np.zeros(len(models), dtype=bool), step)


def plain_histogram(bins, e, n_bins, step=1):
    """Every pixel of a large field, on the image or not."""
    out, mass = np.zeros(n_bins), 0.0
    reach = int(max(e[2], e[3])) + 2
    for y in range(math.floor(e[1]) - reach, math.ceil(e[1]) + reach + 1):
        for x in range(math.floor(e[0]) - reach, math.ceil(e[0]) + reach + 1):
            q = ellipse_distance(e, x, y)
            if q <= 1.0 and x % step == 0 and y % step == 0:
                mass += 1.0 - q
                if 0 <= x < bins.shape[1] and 0 <= y < bins.shape[0]:
                    out[bins[y, x]] += 1.0 - q
    return out / mass if mass > 0 else out


def random_ellipses(rng, n):
    return np.column_stack(
        [rng.uniform(-8, W + 8, n), rng.uniform(-8, H + 8, n), rng.uniform(0.3, 12, (n, 2)), rng.uniform(-7, 7, n)]
    )


@pytest.mark.parametrize("bad", [[np.nan, 0, 1, 1, 0], [0, 0, 0, 1, 0], [0, 0, 1, -1, 0], [0, 0, 1e9, 1, 0]])
def test_what_is_no_ellipse_holds_nothing(bad):
    e = np.array(bad, dtype=float)
    bins = np.zeros((H, W), dtype=np.uint8)
    assert not histograms(bins, e[None], 4, 1).any()
    assert likenesses(bins, e[None], np.zeros(1, dtype=np.int64), np.ones((1, 1)), 1)[0] == 0.0


@pytest.mark.parametrize("step", [1, 2, 5])
def test_histograms_are_those_of_a_sum_over_every_pixel(step):
    rng = np.random.default_rng(5)
    bins = rng.integers(0, 72, (H, W)).astype(np.uint8)
    bins[:, :20] = 7  # a stretch of one colour too
    e = random_ellipses(rng, 80)
    got = histograms(bins, e, 72, step)
    want = np.array([plain_histogram(bins, row, 72, step) for row in e])
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-12)
    models = want[:3] + 0.01
    models /= models.sum(axis=1, keepdims=True)
    owner = rng.integers(0, 3, len(e))
    similar = likenesses(bins, e, owner, models, step)
    np.testing.assert_allclose(similar, np.sqrt(want * models[owner]).sum(axis=1), rtol=1e-9, atol=1e-9)


def test_a_histogram_sums_to_the_share_of_its_weight_on_the_image():
    bins = np.zeros((H, W), dtype=np.uint8)
    inside, half, outside = [20.0, 15, 8, 5, 0.3], [-0.5, 15.0, 9, 7, 0.0], [-20.0, 15, 8, 5, 0.3]
    sums = histograms(bins, np.array([inside, half, outside]), 3, 1).sum(axis=1)
    np.testing.assert_allclose(sums, [1.0, 0.5, 0.0], atol=1e-12)


def test_total_weight_is_that_of_the_continuous_kernel():
    """Epanechnikov over an ellipse: mass pi a b / 2; a circle about the centre holds 1 - (1 - t^2)^2 of it."""
    y, x = np.mgrid[:400, :400]
    bins = (np.hypot(x - 200.3, y - 199.6) < 90).astype(np.uint8)
    got = histograms(bins, np.array([[200.3, 199.6, 180.0, 180.0, 0.0]]), 2, 1)[0]
    assert got[1] == pytest.approx(1 - (1 - 0.25) ** 2, abs=1e-3)


def test_numbers_above_the_bins_are_left_out():
    bins = np.full((H, W), 255, dtype=np.uint8)
    assert not histograms(bins, np.array([[20.0, 15, 8, 5, 0.3]]), 3, 1).any()


@pytest.mark.parametrize(("height", "split"), [(12.0, True), (12.0 - 1e-9, False), (8.0, False)])
def test_targets_as_many_times_higher_than_wide_have_halves(height, split):
    ellipse = np.array([[40.0, 40.0, 8.0, height, 0.0]])
    assert upright(ellipse, 1.5).tolist() == [split]
    # The other order of the axes is the same ellipse
    turned = np.array([[40.0, 40.0, height + 1e-6 * split, 8.0, 0.5 * np.pi]])
    assert upright(turned, 1.5).tolist() == [split]


def test_no_target_has_halves_for_a_share_of_none():
    assert not upright(np.array([[40.0, 40.0, 8.0, 80.0, 0.0]]), 0.0).any()


@pytest.mark.parametrize("rho", [-1.5, -0.8, -0.7, 0.0, 0.7, 0.8, 1.5, 3.0])
def test_the_first_axis_is_the_more_horizontal_one_of_the_same_ellipse(rho):
    given = np.array([[40.0, 40.0, 8.0, 12.0, rho]])
    out = level(given)[0]
    assert -0.25 * np.pi <= out[4] <= 0.25 * np.pi
    for angle in np.linspace(0.0, np.pi, 7):
        reach = [np.hypot(e[2] * np.cos(angle - e[4]), e[3] * np.sin(angle - e[4])) for e in (given[0], out)]
        assert reach[0] == pytest.approx(reach[1])
