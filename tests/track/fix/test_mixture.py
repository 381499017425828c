"""Modes of a mixture of true and false bearings: known answers, a grid, and honest covariances with few lines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.track.methods.fix.estimators import PRIOR_RESIDUALS, modes, pooled_factor, spread_of

PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0], [5.0, 0.0]])
BEND = 3.7


def towards(places, xy):
    return np.arctan2(xy[1] - places[:, 1], xy[0] - places[:, 0])


def log_likelihood(xy, places, bearings, sigma) -> float:
    r = (bearings - towards(places, xy) + np.pi) % (2 * np.pi) - np.pi
    return float(np.log(np.exp(-0.5 * (r / sigma) ** 2) + math.exp(-0.5 * BEND**2)).sum())


@pytest.mark.parametrize("n", [2, 3, 5])
def test_exact_bearings_give_the_place(n: int) -> None:
    xy = np.array([3.0, 5.0])
    found = modes(PLACES[:n], towards(PLACES[:n], xy), np.full(n, 0.01), BEND)
    assert_allclose(found.xy[0], xy, atol=1e-8)
    assert_allclose(found.inlier_probability[0], 1.0, atol=2e-3)
    away = xy - PLACES[:n]
    across = np.column_stack([-away[:, 1], away[:, 0]]) / (away**2).sum(axis=1)[:, None]
    assert_allclose(found.covariance[0], 0.01**2 * np.linalg.inv(across.T @ across), rtol=5e-3)


@pytest.mark.parametrize("liar", range(4))
def test_the_bearing_that_disagrees_with_the_others_is_false(liar: int) -> None:
    rng = np.random.default_rng(liar)
    xy, sigma = np.array([3.0, 5.0]), np.full(4, 0.01)
    bearings = towards(PLACES[:4], xy) + sigma * rng.standard_normal(4)
    bearings[liar] += 0.4
    found = modes(PLACES[:4], bearings, sigma, BEND)
    assert np.hypot(*(found.xy[0] - xy)) < 0.15
    assert (found.inlier_probability[0] < 0.5).tolist() == [k == liar for k in range(4)]
    assert found.probability[0] > 0.8


def test_the_first_mode_is_the_highest_place_of_a_grid() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        sigma = np.full(5, 0.05)
        bearings = towards(PLACES, rng.uniform([2, 2], [8, 6])) + sigma * rng.standard_normal(5)
        bearings[rng.integers(5)] += rng.uniform(0.5, 1.0)
        found = modes(PLACES, bearings, sigma, BEND)
        grid = [np.array([x, y]) for x in np.arange(0.1, 10, 0.1) for y in np.arange(0.1, 8, 0.1)]
        best = max(log_likelihood(g, PLACES, bearings, sigma) for g in grid)
        assert max(log_likelihood(m, PLACES, bearings, sigma) for m in found.xy) >= best - 1e-9
        for k, m in enumerate(found.xy):  # each is a mode: no place around it is better
            here = log_likelihood(m, PLACES, bearings, sigma)
            for angle in np.arange(0.0, 6.0):
                near = m + 1e-3 * np.array([math.cos(angle), math.sin(angle)])
                assert log_likelihood(near, PLACES, bearings, sigma) <= here + 1e-6, k


def test_where_it_cannot_be_reported_which_of_three_is_false_the_covariance_holds_all_crossings() -> None:
    xy = np.array([4.0, 3.0])
    bearings = towards(PLACES[:3], xy)
    bearings[1] += 0.5
    found = modes(PLACES[:3], bearings, np.full(3, 0.01), BEND)
    assert len(found.xy) >= 2
    spread = spread_of(found, pooled=True)
    for other in found.xy[1:]:
        away = other - found.xy[0]
        assert away @ np.linalg.solve(spread, away) < 5.991
    assert np.hypot(*(found.xy - xy).T).min() < 1e-2  # one of them is the place


def test_parallel_lines_and_lines_that_part_tell_no_position() -> None:
    sigma = np.full(2, 0.01)
    assert modes(PLACES[:2], np.radians([90.0, 90.0]), sigma, BEND) is None
    assert modes(PLACES[:2], np.radians([135.0, 45.0]), sigma, BEND) is None


def test_few_residuals_are_pooled_with_what_is_stated() -> None:
    assert pooled_factor(0.0, 0.0) == PRIOR_RESIDUALS / (PRIOR_RESIDUALS - 2.0)
    assert pooled_factor(1e6, 1e6) == pytest.approx(1.0, rel=1e-4)
    assert pooled_factor(9e6, 1e6) == pytest.approx(9.0, rel=1e-4)
    assert pooled_factor(2.0, 2.0) == (PRIOR_RESIDUALS + 2.0) / PRIOR_RESIDUALS


@pytest.mark.parametrize("n", [2, 3, 4])
def test_normalised_squared_errors_of_few_lines_are_right(n: int) -> None:
    rng = np.random.default_rng(n)
    nees = []
    for _ in range(400):
        xy, sigma = rng.uniform([2, 2], [8, 6]), np.full(n, 0.005)
        found = modes(PLACES[:n], towards(PLACES[:n], xy) + sigma * rng.standard_normal(n), sigma, BEND)
        away = found.xy[0] - xy
        nees.append(away @ np.linalg.solve(spread_of(found, pooled=True), away))
    assert 1.3 < np.mean(nees) < 2.3
    assert np.mean(np.array(nees) > 5.991) < 0.08
