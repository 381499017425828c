"""Interpolated probabilities of being hidden against those computed place by place."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.occlusion.occlusion_probability import (
    IMPROVED,
    PRINTED,
    fit,
    make_grid,
    polynomials,
    terms,
    unhidden_over,
    visibility_probability,
)
from occlog.core.occlusion.priors import Priors, gaussian_priors

CAMERA = np.array([2.0, 3.0])


def cloud(rng: np.random.Generator, spread: float) -> np.ndarray:
    return rng.uniform(30, 70, 2) + spread * rng.standard_normal((1000, 2))


def occluders(rng: np.random.Generator, sigma: float, alpha: float, size: int = 40) -> Priors:
    axis = rng.standard_normal((size, 2))
    axis /= np.hypot(*axis.T)[:, None]
    spread = sigma**2 * (np.eye(2) + (alpha - 1) * axis[:, :, None] * axis[:, None, :])
    return gaussian_priors(rng.uniform(0, 100, (size, 2)), spread, 3.33)


@pytest.mark.parametrize("far", [5.5, 3.5])
@pytest.mark.parametrize("alpha", [1.0, 4.0])
@pytest.mark.parametrize("seed", range(6))
def test_the_error_is_that_of_the_tail(seed: int, alpha: float, far: float) -> None:
    rng = np.random.default_rng(seed)
    xy, priors = cloud(rng, rng.uniform(0.3, 2.0)), occluders(rng, rng.uniform(4, 8), alpha)
    free, rows = rng.random(1000) < 0.95, np.flatnonzero(rng.random(1000) < 0.9)
    grid = make_grid(xy, free | np.isin(np.arange(1000), rows), priors, far)
    assert 0 < len(grid.points) < 500
    form = PRINTED if seed % 2 else IMPROVED
    found = unhidden_over(grid, xy, rows, *CAMERA, priors, form, far)
    plain = visibility_probability(xy, rows, *CAMERA, priors, form, 9.0)
    # Culling and interpolation each leave about a tail.
    assert np.abs(found - plain).max() < 40 * grid.tolerance
    assert np.all((found >= 0) & (found <= 1))
    if far == 5.5:
        assert np.abs(found - plain).max() < 1e-6 * plain.max()


@pytest.mark.parametrize(
    ("name", "spread", "sigma"), [("wide cloud", 20.0, 5.0), ("narrow prior", 2.0, 0.1), ("known", 2.0, 0.0)]
)
def test_what_is_not_smooth_is_computed_place_by_place(name: str, spread: float, sigma: float) -> None:
    rng = np.random.default_rng(len(name))
    xy, priors = cloud(rng, spread), occluders(rng, sigma, 1.0)
    rows = np.arange(1000)
    grid = make_grid(xy, np.ones(1000, dtype=bool), priors, 5.5)
    assert len(grid.points) == 0
    found = unhidden_over(grid, xy, rows, *CAMERA, priors, IMPROVED, 5.5)
    np.testing.assert_array_equal(found, visibility_probability(xy, rows, *CAMERA, priors, IMPROVED, 5.5))


def test_a_camera_within_the_cloud_and_few_places_are_computed_place_by_place() -> None:
    rng = np.random.default_rng(3)
    xy, priors = cloud(rng, 1.0), occluders(rng, 5.0, 1.0)
    grid = make_grid(xy, np.ones(1000, dtype=bool), priors, 5.5)
    middle = xy.mean(axis=0)
    for camera, rows in ((middle + 0.5, np.arange(1000)), (CAMERA, np.arange(3))):
        found = unhidden_over(grid, xy, rows, *camera, priors, IMPROVED, 5.5)
        np.testing.assert_array_equal(found, visibility_probability(xy, rows, *camera, priors, IMPROVED, 5.5))


@pytest.mark.parametrize("n", [2, 5, 12])
def test_polynomials_go_through_values_at_their_points(n: int) -> None:
    points = 3.0 + 2.0 * np.cos(np.pi * (np.arange(n) + 0.5) / n)
    values = np.random.default_rng(n).standard_normal(n)
    found = (fit(n) @ values) @ polynomials(points, 3.0, 2.0, n)
    np.testing.assert_allclose(found, values, atol=1e-12)
    chebyshev = np.polynomial.chebyshev.chebvander(np.array([-0.3, 0.8]), n - 1)
    np.testing.assert_allclose(polynomials(3.0 + 2.0 * np.array([-0.3, 0.8]), 3.0, 2.0, n), chebyshev.T, atol=1e-12)


def test_more_polynomials_for_wider_clouds_and_smaller_errors() -> None:
    assert terms(0.0, 1e-8) < terms(0.5, 1e-8) < terms(2.0, 1e-8)
    assert terms(1.0, 1e-4) < terms(1.0, 1e-8)


@pytest.mark.parametrize("spread", [0.3, 1.0])
def test_smooth_probabilities_are_interpolated_and_not_computed(spread: float) -> None:
    """Interpolated values differ from computed ones, but by less than the tail that is left out."""
    rng = np.random.default_rng(7)
    xy, priors, rows = 50.0 + spread * rng.standard_normal((400, 2)), occluders(rng, 6.0, 1.0, 5), np.arange(400)
    grid = make_grid(xy, np.ones(400, dtype=bool), priors, 5.5)
    assert 0 < len(grid.points) <= 200
    found = unhidden_over(grid, xy, rows, *CAMERA, priors, IMPROVED, 5.5)
    computed = visibility_probability(xy, rows, *CAMERA, priors, IMPROVED, 5.5)
    assert 0.0 < np.abs(found - computed).max() < grid.tolerance
