"""Errors of ranges and differences that may come by a detour: numerical integration, derivatives, random numbers."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.filtering.likelihood.distances import (
    DIFFERENCE,
    LOGARITHM,
    RANGE,
    DistanceErrors,
    RangeMeasurements,
    inlier_probability,
    log_density,
    score_and_information,
    without_detours,
)

GRID = np.linspace(-60.0, 400.0, 460_001)


def errors(late: float, early: float, rate: float, bend: float = 40.0) -> DistanceErrors:
    return DistanceErrors(*(np.array([value]) for value in (bend, late, early, rate)))


def density(u: np.ndarray, own: DistanceErrors, variance: float = 1.0) -> np.ndarray:
    return np.exp(log_density(u[:, None], own, variance)[:, 0]) / np.sqrt(2.0 * np.pi)


@pytest.mark.parametrize("rate", [0.05, 0.5, 3.0])
@pytest.mark.parametrize("variance", [1.0, 9.0])
def test_the_density_is_the_convolution_of_a_gaussian_and_an_exponential(rate: float, variance: float) -> None:
    e = np.linspace(0.0, 30.0 / rate + 40.0, 200_001)
    for u in (-4.0, 0.0, 2.5, 12.0):
        gauss = np.exp(-0.5 * (u - e) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
        there = 0.7 * gauss[0] + 0.3 * np.trapezoid(gauss * rate * np.exp(-rate * e), e)
        reported = density(np.array([u]), errors(0.3, 0.0, rate), variance)[0]
        assert reported == pytest.approx(there, rel=1e-4, abs=1e-15)


@pytest.mark.parametrize(("late", "early"), [(0.0, 0.0), (0.2, 0.0), (0.2, 0.3)])
def test_the_density_integrates_to_one(late: float, early: float) -> None:
    wide = np.concatenate([-GRID[:0:-1], GRID])
    wide.sort()
    assert np.trapezoid(density(wide, errors(late, early, 0.1)), wide) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("own", [errors(0.0, 0.0, 1.0, 3.7), errors(0.1, 0.0, 0.1, 3.7), errors(0.2, 0.3, 0.5, 3.7)])
def test_slopes_are_those_of_finite_differences_and_curvatures_are_not_below_zero(own: DistanceErrors) -> None:
    u, step = np.linspace(-12.0, 40.0, 500)[:, None], 1e-5
    reported = score_and_information(u, own)
    slope = (log_density(u - step, own) - log_density(u + step, own)) / (2.0 * step)
    np.testing.assert_allclose(reported.slope, slope, rtol=1e-5, atol=1e-7)
    assert ((reported.weight >= 0.0) & (reported.weight <= 1.0)).all()
    np.testing.assert_allclose(reported.direct, inlier_probability(u, own))


@pytest.mark.parametrize("rate", [0.2, 1.5])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_information_of_a_component_is_its_curvature(rate: float, sign: float) -> None:
    """Late signals alone, and early ones alone, which mirror them."""
    u, step = sign * np.linspace(-4.0, 8.0, 100)[:, None], 1e-4
    own = errors(1.0, 0.0, rate) if sign > 0.0 else errors(0.0, 1.0, rate)
    low, middle, high = (log_density(u + d, own) for d in (-step, 0.0, step))
    np.testing.assert_allclose(score_and_information(u, own).weight, (2.0 * middle - low - high) / step**2, atol=1e-6)


def test_a_late_signal_is_not_false_and_an_early_one_is() -> None:
    own = errors(0.05, 0.0, 0.1, 3.7)
    assert inlier_probability(np.array([8.0]), own)[0] < 1e-3
    false = np.exp(-0.5 * 3.7**2 - log_density(np.array([8.0, -8.0]), own))
    assert false[0] < 0.2
    assert false[1] > 0.99
    # Far from the tail nothing is stated against a Gaussian
    assert inlier_probability(np.array([0.0, -2.0]), own).min() > 0.95


def test_without_detours_errors_are_gaussian_or_false() -> None:
    u = np.linspace(-8, 8, 33)[:, None]
    own = without_detours(np.array([3.7]))
    np.testing.assert_array_equal(log_density(u, own), np.logaddexp(-0.5 * u**2, -0.5 * 3.7**2))


def test_both_stations_of_a_difference_may_be_late_and_a_strength_cannot() -> None:
    blank = np.zeros(3)
    rows = RangeMeasurements(
        np.array([RANGE, LOGARITHM, DIFFERENCE]), blank, np.full(3, 0.5), np.zeros((3, 2)), blank,
        np.zeros((3, 2)), blank, np.arange(3), late=0.2, detour=2.0,
    )  # fmt: skip
    own = rows.errors
    np.testing.assert_allclose(own.late, [0.2, 0.0, 0.18])
    np.testing.assert_allclose(own.early, [0.0, 0.0, 0.18])
    np.testing.assert_allclose(own.rate, 0.25)
    np.testing.assert_allclose(rows._replace(detour=np.nan).errors.rate, 0.1)
    # Signals that are late by chance, at either station
    rng = np.random.default_rng(1)
    n = 40_000
    by = (rng.random((n, 2)) < 0.2) * rng.exponential(4.0, (n, 2))
    u = np.sort(rng.standard_normal(n) + by[:, 0] - by[:, 1])
    grid = np.linspace(-80.0, 80.0, 16_001)
    there = density(grid, DistanceErrors(*(column[2:] for column in own._replace(bend=np.full(3, 40.0)))))
    below = np.interp(u, grid, np.cumsum(there) * (grid[1] - grid[0]))
    # Kolmogorov and Smirnov: 1.95 / sqrt(n) is passed once in a thousand
    assert np.abs(below - (np.arange(n) + 0.5) / n).max() < 1.95 / np.sqrt(n) + 0.002
