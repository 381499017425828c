"""Ellipses against plain forms: sampled outlines, pixel by pixel sums."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.core.image.ellipse import canonical, close, nearness, pixels_inside, support_radius, touching
from occlog.track.images.kernels.ellipse_colour import bhattacharyya, colour_likelihood, histograms, likenesses

W, H = 40, 30


def outline(e, n=4000):
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    c, s = math.cos(e[4]), math.sin(e[4])
    u, v = e[2] * np.cos(t), e[3] * np.sin(t)
    return np.column_stack([e[0] + c * u - s * v, e[1] + s * u + c * v])


def distance2(e, x, y):
    c, s = math.cos(e[4]), math.sin(e[4])
    dx, dy = x - e[0], y - e[1]
    return ((c * dx + s * dy) / e[2]) ** 2 + ((-s * dx + c * dy) / e[3]) ** 2


def plain_histogram(bins, e, n_bins, step=1):
    """Every pixel of a large field, on the image or not."""
    out, mass = np.zeros(n_bins), 0.0
    reach = int(max(e[2], e[3])) + 2
    for y in range(math.floor(e[1]) - reach, math.ceil(e[1]) + reach + 1):
        for x in range(math.floor(e[0]) - reach, math.ceil(e[0]) + reach + 1):
            q = distance2(e, x, y)
            if q <= 1.0 and x % step == 0 and y % step == 0:
                mass += 1.0 - q
                if 0 <= x < bins.shape[1] and 0 <= y < bins.shape[0]:
                    out[bins[y, x]] += 1.0 - q
    return out / mass if mass > 0 else out


def random_ellipses(rng, n):
    return np.column_stack(
        [rng.uniform(-8, W + 8, n), rng.uniform(-8, H + 8, n), rng.uniform(0.3, 12, (n, 2)), rng.uniform(-7, 7, n)]
    )


angles = st.floats(-20, 20)
axes = st.floats(0.1, 300)


@given(axes, axes, angles, angles)
def test_support_radius_is_the_farthest_point_in_a_direction(a, b, rho, theta):
    e = np.array([5.0, -3.0, a, b, rho])
    along = (outline(e) - e[:2]) @ [math.cos(theta), math.sin(theta)]
    assert support_radius(e, theta) == pytest.approx(along.max(), rel=1e-5)


@given(axes, axes, angles)
def test_canonical_is_the_same_ellipse(a, b, rho):
    e = np.array([1.0, 2.0, a, b, rho])
    c = canonical(e)
    assert c[2] >= c[3]
    assert -math.pi / 2 <= c[4] < math.pi / 2
    theta = np.linspace(0, np.pi, 7)
    np.testing.assert_allclose(support_radius(c, theta), support_radius(e, theta), rtol=1e-9)
    np.testing.assert_allclose(canonical(c), c)


def test_circles_touch_and_are_close_at_the_stated_distances():
    for ratio, is_touching, is_close in ((0.999, True, True), (1.001, False, True), (1.499, False, True)):
        e = np.array([[10.0, 20, 22, 22, 0], [10 + 0.6 * 44 * ratio, 20 + 0.8 * 44 * ratio, 22, 22, 1]])
        assert touching(e).tolist() == [[False, is_touching], [is_touching, False]]
        assert close(e).tolist() == [[False, is_close], [is_close, False]]
    beyond = np.array([[0.0, 0, 22, 22, 0], [66.01, 0, 22, 22, 0]])
    assert not close(beyond).any()


def test_nearness_is_symmetric_and_of_the_direction_between_centres():
    rng = np.random.default_rng(3)
    e = random_ellipses(rng, 9)
    near = nearness(e)
    assert np.array_equal(near, near.T)
    for i in range(9):
        for j in range(i):
            d = e[j, :2] - e[i, :2]
            u = d / np.hypot(*d)
            reach = ((outline(e[i]) - e[i, :2]) @ u).max() + ((outline(e[j]) - e[j, :2]) @ u).max()
            assert near[i, j] == pytest.approx(np.hypot(*d) / reach, rel=1e-5)
    e[4] = np.nan
    assert np.isinf(nearness(e)[4]).all()
    assert touching(np.zeros((0, 5))).shape == (0, 0)


@pytest.mark.parametrize("step", [1, 2, 3])
def test_pixels_inside_are_those_of_a_test_of_every_pixel(step):
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.arange(-60, 100), np.arange(-60, 100))
    for e in random_ellipses(rng, 60):
        inside = (distance2(e, x, y) <= 1.0) & (x % step == 0) & (y % step == 0)
        want = np.column_stack([x[inside], y[inside]])
        assert np.array_equal(pixels_inside(e, step=step), want)
        on = ((want >= 0) & (want < [W, H])).all(axis=1)
        assert np.array_equal(pixels_inside(e, (W, H), step), want[on])


@pytest.mark.parametrize("bad", [[np.nan, 0, 1, 1, 0], [0, 0, 0, 1, 0], [0, 0, 1, -1, 0], [0, 0, 1e9, 1, 0]])
def test_what_is_no_ellipse_holds_nothing(bad):
    e = np.array(bad, dtype=float)
    assert pixels_inside(e).shape == (0, 2)
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
    alike = likenesses(bins, e, owner, models, step)
    np.testing.assert_allclose(alike, np.sqrt(want * models[owner]).sum(axis=1), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(alike, bhattacharyya(got, models[owner]), rtol=1e-9, atol=1e-9)


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


def test_numbers_in_the_map_above_the_bins_are_left_out():
    bins = np.full((H, W), 255, dtype=np.uint8)
    assert not histograms(bins, np.array([[20.0, 15, 8, 5, 0.3]]), 3, 1).any()


def test_likelihood_of_equal_and_of_strange_colours():
    np.testing.assert_allclose(colour_likelihood(np.array([1.0, 0.9, 0.0])), [1.0, np.exp(-5.0), np.exp(-50.0)])
    h = np.array([[0.2, 0.8], [1.0, 0.0]])
    np.testing.assert_allclose(bhattacharyya(h, h[::-1]), np.sqrt([0.2, 0.2]))
