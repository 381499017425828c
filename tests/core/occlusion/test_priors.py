"""Packed priors of moving occluders against numbers worked by hand and by sampling."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from occlog.core.occlusion.priors import gaussian_priors, no_priors, polygon_priors, take_priors, without_own

BENT = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]])


def covariance_of(priors, j):
    axis = priors.axis[j]
    side = np.array([-axis[1], axis[0]])
    return priors.sigma[j] ** 2 * np.outer(axis, axis) + priors.minor[j] ** 2 * np.outer(side, side)


@pytest.mark.parametrize("seed", range(4))
def test_a_covariance_is_its_axes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((7, 2, 2))
    covariance = half @ half.transpose(0, 2, 1)
    priors = gaussian_priors(rng.uniform(0, 9, (7, 2)), covariance, 3.0)
    for j in range(7):
        np.testing.assert_allclose(covariance_of(priors, j), covariance[j], atol=1e-12)
        assert priors.sigma[j] >= priors.minor[j] >= 0.0
    np.testing.assert_array_equal(priors.radius, 1.5)
    assert len(priors.corners) == 0
    assert np.all(priors.first == 0)


def test_a_line_and_a_known_place_have_no_width() -> None:
    line = np.outer([3.0, 4.0], [3.0, 4.0])
    priors = gaussian_priors(np.zeros((2, 2)), np.array([line, np.zeros((2, 2))]), 1.0)
    np.testing.assert_allclose(priors.sigma, [5.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(priors.minor, 0.0)
    np.testing.assert_allclose(abs(priors.axis[0]), [0.6, 0.8])


def test_what_is_no_covariance_is_refused() -> None:
    with pytest.raises(ValueError, match="positive semi-definite"):
        gaussian_priors(np.zeros((1, 2)), np.array([[[1.0, 0.0], [0.0, -0.1]]]), 1.0)
    with pytest.raises(ValueError, match="no area"):
        polygon_priors([np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])], 1.0)


@pytest.mark.parametrize("turned", [False, True])
def test_moments_of_a_polygon(turned: bool) -> None:
    priors = polygon_priors([BENT[::-1] if turned else BENT, BENT + 10.0], 2.0)
    shape = shapely.Polygon(BENT)
    np.testing.assert_allclose(priors.mean[0], [shape.centroid.x, shape.centroid.y])
    # An L of two rectangles, 4 x 1 and 1 x 2: second moments about the origin by hand.
    xx = (64.0 / 3 * 1 + 1.0 / 3 * 2) / 6.0
    yy = (4 * 1.0 / 3 + 1 * (27 - 1) / 3.0) / 6.0
    xy = (8.0 * 0.5 + 0.5 * 4.0) / 6.0
    want = np.array([[xx, xy], [xy, yy]]) - np.outer(priors.mean[0], priors.mean[0])
    np.testing.assert_allclose(covariance_of(priors, 0), want, atol=1e-12)
    np.testing.assert_allclose(covariance_of(priors, 1), want, atol=1e-10)
    np.testing.assert_array_equal(priors.first, [0, 6, 12])
    found = shapely.Polygon(priors.corners[:6])
    assert found.exterior.is_ccw
    assert found.equals(shape)


def test_priors_of_the_target_itself_are_left_out() -> None:
    mean = np.array([[0.0, 0.0], [3.9, 0.0], [4.1, 0.0], [0.0, 9.0]])
    covariance = np.tile(np.diag([2.0, 2.0]), (4, 1, 1))
    priors = gaussian_priors(mean, covariance, 2.0)
    # Variance of a difference: 2 of the prior, 1 of the target, 1 for the radius: 2 standard deviations are 4.
    kept = without_own(priors, np.zeros(2), np.eye(2), 2.0)
    np.testing.assert_array_equal(kept.mean, mean[2:])
    assert len(without_own(no_priors(), np.zeros(2), np.eye(2), 2.0).sigma) == 0


def test_some_rows_keep_their_corners() -> None:
    squares = [np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * k for k in (1.0, 2.0, 3.0)]
    priors = polygon_priors([squares[0], BENT, squares[2]], 1.0)
    some = take_priors(priors, np.array([2, 1]))
    np.testing.assert_array_equal(some.first, [0, 4, 10])
    np.testing.assert_array_equal(some.corners, np.concatenate([squares[2], BENT]))
    np.testing.assert_array_equal(some.mean, priors.mean[[2, 1]])
    assert len(take_priors(priors, np.array([], dtype=int)).sigma) == 0


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_the_gate_is_in_deviations_of_the_difference_along_either_axis(turn: float) -> None:
    """Variances 4 and 1 of the prior, 1/4 of the target, and the square of a radius of 1/2."""
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, s], [-s, c]])
    covariance = axes.T @ np.diag([4.0, 1.0]) @ axes
    for axis, variance in zip(axes, (4.5, 1.5), strict=True):
        for share, left in ((1.0 - 1e-9, 0), (1.0 + 1e-9, 1)):
            mean = np.array([7.0, -3.0]) + 3.0 * share * np.sqrt(variance) * axis
            priors = gaussian_priors(mean[None], covariance[None], 1.0)
            assert len(without_own(priors, np.array([7.0, -3.0]), 0.25 * np.eye(2), 3.0).sigma) == left


def test_a_variance_that_is_negligible_against_the_other_is_none() -> None:
    for ratio, minor in ((1.1e-12, np.sqrt(1.1e-12)), (0.9e-12, 0.0)):
        priors = gaussian_priors(np.zeros((1, 2)), np.diag([1.0, ratio])[None], 1.0)
        assert priors.minor[0] == pytest.approx(minor, rel=1e-6, abs=0.0)
    assert no_priors().mean.shape == (0, 2)
    assert no_priors().axis.shape == (0, 2)
