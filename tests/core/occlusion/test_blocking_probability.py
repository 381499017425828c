"""Exact probabilities of hiding from sets of cameras: against unions of rectangles, and the parts by closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import union_reference as union
from scipy.stats import norm

from occlog.array_types import Floats
from occlog.core.occlusion.blocking_probability import crossing, cuts, normal_between, shares, sides, steepest
from occlog.core.occlusion.priors import Priors, gaussian_priors, polygon_priors

DIAMETER = 3.33
CAMERAS = np.array([[0.0, 0.0], [3.0, 12.0], [18.0, -4.0], [20.0, 10.0]])
"""The last one is at the position and is never hidden."""
AT = np.array([20.0, 10.0])
BEND = np.array([[0.0, 0.0], [9.0, 1.0], [3.0, 3.0], [2.0, 8.0]])
COVARIANCES = {
    "general": np.array([[30.0, 12.0], [12.0, 9.0]]),
    "narrow": np.array([[4.0, 3.99], [3.99, 4.0]]),
    "isotropic": 5.0 * np.eye(2),
    "line": np.outer([4.0, 3.0], [4.0, 3.0]),
    "known": np.zeros((2, 2)),
}


def prior_of(name: str, mean: Floats) -> tuple[Priors, object]:
    """A prior for the kernel and for the reference."""
    if name == "polygon":
        return polygon_priors([mean + 1.3 * BEND], DIAMETER), mean + 1.3 * BEND
    covariance = COVARIANCES[name]
    return gaussian_priors(mean[None], covariance[None], DIAMETER), (mean, covariance)


@pytest.mark.parametrize("name", [*COVARIANCES, "polygon"])
@pytest.mark.parametrize("mean", [(13.0, 7.0), (17.5, 9.5), (1.0, -1.5), (40.0, 35.0)])
def test_the_sets_of_cameras_have_the_masses_of_their_unions(name: str, mean: tuple[float, float]) -> None:
    prior, person = prior_of(name, np.array(mean))
    found = shares(*AT, CAMERAS, prior, 0)
    clear = union.together(AT[None], CAMERAS[:3], [person], DIAMETER)[0]
    assert found.sum() == pytest.approx(1.0)
    assert not found[8:].any()
    for Q in range(8):
        assert sum(found[S] for S in range(8) if not S & Q) == pytest.approx(clear[Q], abs=1e-8)


def test_each_occluder_has_its_own_prior() -> None:
    means, covariances = np.array([[13.0, 7.0], [10.0, 4.0]]), np.array([COVARIANCES["general"], COVARIANCES["narrow"]])
    both = gaussian_priors(means, covariances, DIAMETER)
    for j in range(2):
        alone = gaussian_priors(means[[j]], covariances[[j]], DIAMETER)
        np.testing.assert_array_equal(shares(*AT, CAMERAS, both, j), shares(*AT, CAMERAS, alone, 0))


@pytest.mark.parametrize(("low", "high"), [(-0.5, 1.2), (5.0, 6.5), (-7.0, -5.5), (9.0, 30.0), (1.0, 1.0), (2.0, -1.0)])
def test_normal_probabilities_keep_their_relative_accuracy_in_the_tails(low: float, high: float) -> None:
    wanted = max(norm.cdf(high) - norm.cdf(low), 0.0) if low < 0.0 else max(norm.sf(low) - norm.sf(high), 0.0)
    assert normal_between(low, high) == pytest.approx(wanted, rel=1e-9)


def test_sides_go_around_the_rectangles_and_the_polygon() -> None:
    """A rectangle of length 5 along (0.6, 0.8) from (1, 2), 1 to either side."""
    along, across, start = np.array([0.6, 0.8]), np.array([-0.8, 0.6]), np.array([1.0, 2.0])
    corners = np.array([start - across, start + 5.0 * along - across, start + 5.0 * along + across, start + across])
    got = sides(np.array([[*along, *start, 5.0, 1.0]]), BEND)
    for points, edges in ((corners, got[:4]), (BEND, got[4:])):
        np.testing.assert_allclose(edges, np.column_stack([points, np.roll(points, -1, axis=0)]), atol=1e-15)


def test_segments_cross_within_both() -> None:
    one = np.array([0.0, 0.0, 4.0, 2.0])
    assert crossing(one, np.array([3.0, -1.0, 1.0, 3.0])) == pytest.approx(1.0)
    assert crossing(np.array([3.0, -1.0, 1.0, 3.0]), one) == pytest.approx(1.0)
    for ends, meets in (((2.0, 1.0, 2.0, 5.0), True), ((2.0, 1.001, 2.0, 5.0), False), ((4.0, 2.0, 9.0, 2.0), True),
                        ((4.001, 0.0, 4.001, 5.0), False), ((0.0, 1.0, 4.0, 3.0), False)):  # fmt: skip
        assert math.isfinite(crossing(one, np.array(ends))) == meets


def test_slices_are_cut_at_corners_crossings_and_even_deviations_of_steep_sides() -> None:
    border = np.array([[0.0, 0.0, 4.0, 2.0], [3.0, -1.0, 1.0, 3.0], [-9.0, -4.0, 9.0, -4.0]])
    np.testing.assert_allclose(cuts(border, -2.0, 2.5, 0.0, 0.0), [-2.0, -1.0, 0.0, 1.0, 2.5])
    # With deviations of 1 along and 1.01 across, the first side is at 2 and 4, where t is 1 and 2; it crosses at t = 1
    wanted = [-2.0, -1.0, 0.0, 1.0, 1.0, 2.5]
    np.testing.assert_allclose(cuts(border, -2.0, 2.5, 1.0, 1.01), wanted)
    np.testing.assert_allclose(cuts(border, -2.0, 2.5, 1.0, 0.99), [-2.0, -1.0, 0.0, 1.0, 2.5])
    for low, high, most in ((0.5, 1.5, 2.0), (2.5, 3.5, 0.5), (4.0, 5.0, 0.0), (-5.0, -3.0, 0.0)):
        assert steepest(border, low, high) == pytest.approx(most)
