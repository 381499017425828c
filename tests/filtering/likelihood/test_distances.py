"""Ranges, signal strengths and differences: closed forms, gradients by finite differences, integrals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.filtering.likelihood.distances import (
    DIFFERENCE,
    LOGARITHM,
    RANGE,
    RangeMeasurements,
    concat,
    information,
    inlier_probability,
    linearise,
    log_likelihood,
    no_measurements,
    residuals,
)

STEP = 1e-6


def rows(*, bend: float = 3.7) -> RangeMeasurements:
    """One of each kind; the stations are 1.5 over the target, or 0.5 below."""
    return RangeMeasurements(
        kind=np.array([RANGE, LOGARITHM, DIFFERENCE]),
        value=np.array([5.0, 1.5, -1.0]),
        sigma=np.array([0.1, 0.3, 0.2]),
        position=np.array([[0.0, 0.0], [4.0, 1.0], [0.0, 0.0]]),
        rise2=np.array([2.25, 2.25, 2.25]),
        other=np.array([[0.0, 0.0], [4.0, 1.0], [6.0, 2.0]]),
        other_rise2=np.array([2.25, 2.25, 0.25]),
        station=np.array([0, 1, 0]),
        bend=bend,
    )


def test_means_are_distances_in_space() -> None:
    xy = np.array([[3.0, 4.0]])
    first, second = math.sqrt(25.0 + 2.25), math.sqrt(9.0 + 4.0 + 0.25)
    expected = [(5.0 - first) / 0.1, (1.5 - 0.5 * math.log(1.0 + 9.0 + 2.25)) / 0.3, (-1.0 - first + second) / 0.2]
    np.testing.assert_allclose(residuals(rows(), xy)[0], expected, rtol=1e-12)


def test_gradients_are_those_of_finite_differences() -> None:
    xy = np.random.default_rng(0).uniform(-5, 9, (50, 2))
    reported = linearise(rows(), xy).gradient
    for axis in (0, 1):
        step = STEP * np.eye(2)[axis]
        slope = (residuals(rows(), xy - step) - residuals(rows(), xy + step)) / (2 * STEP)
        np.testing.assert_allclose(reported[..., axis], slope, rtol=1e-6, atol=1e-6)


def test_at_a_station_everything_is_finite() -> None:
    flat = rows()._replace(rise2=np.zeros(3), other_rise2=np.zeros(3))
    reported = linearise(flat, np.array([[0.0, 0.0], [4.0, 1.0]]))
    assert np.isfinite(reported.residual).all()
    assert np.isfinite(reported.gradient).all()


@pytest.mark.parametrize("n", [0, 1, 2])
def test_the_density_of_a_value_integrates_to_one_and_its_information_is_the_variance_of_the_score(n: int) -> None:
    one, xy = rows(bend=38.0).take(slice(n, n + 1)), np.array([[2.0, 3.0]])
    middle = one.value - residuals(one, xy)[0] * one.sigma
    z = middle + one.sigma * np.linspace(-9, 9, 1001)[:, None]

    def density(at: np.ndarray) -> np.ndarray:
        return np.exp([log_likelihood(one._replace(value=v), at)[0] for v in z])

    there = density(xy)
    assert np.trapezoid(there, z[:, 0]) == pytest.approx(1.0, abs=1e-9)
    score = np.stack([(np.log(density(xy + d)) - np.log(density(xy - d))) / (2 * STEP) for d in STEP * np.eye(2)])
    reported = np.trapezoid(score[:, None] * score[None] * there, z[:, 0])
    np.testing.assert_allclose(information(one, xy)[0], reported, rtol=1e-5, atol=1e-6)


def test_at_the_bend_a_value_is_as_likely_false_as_true() -> None:
    own = rows(bend=3.7).take(slice(1)).errors
    assert inlier_probability(np.array([3.7]), own)[0] == pytest.approx(0.5)
    assert inlier_probability(np.array([3.6]), own)[0] > 0.5 > inlier_probability(np.array([3.8]), own)[0]
    far = rows()._replace(value=np.array([1e3, 1e3, 1e3]))
    np.testing.assert_allclose(*log_likelihood(far, np.array([[1.0, 2.0], [5.0, 5.0]])), rtol=1e-12)


def test_sets_are_joined_and_none_has_the_likelihood_one() -> None:
    joined = concat([no_measurements(2.0), rows(), rows().take(np.array([2]))])
    assert joined.kind.tolist() == [RANGE, LOGARITHM, DIFFERENCE, DIFFERENCE]
    assert joined.bend == 3.7
    assert log_likelihood(no_measurements(2.0), np.zeros((2, 2))).tolist() == [0.0, 0.0]
