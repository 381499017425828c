"""Ratios of squares with errors that know how alike neighbours are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from occlog.array_types import Floats
from occlog.core.metrics.normalised_squares import (
    MAX_BATCHES,
    MIN_BATCHES,
    MIN_DEGREES,
    BatchMeans,
    Ratio,
    ratio_interval,
)


def batches(squares: Floats, parts: int = 1) -> BatchMeans:
    out = BatchMeans()
    for part in np.array_split(squares, parts):
        out.add(part, np.ones(len(part)))
    return out


def similar(rng: np.random.Generator, n: int, rho: float) -> Floats:
    """Squares of an autoregressive series of variance 1."""
    noise = rng.standard_normal(n)
    noise[1:] *= math.sqrt(1.0 - rho**2)
    return lfilter([1.0], [1.0, -rho], noise) ** 2


def test_interval_is_that_of_the_chi_square() -> None:
    low, high = ratio_interval(2.0, 30.0, 0.05)
    assert low == pytest.approx(2.0 * 30.0 / stats.chi2.ppf(0.975, 30))
    assert high == pytest.approx(2.0 * 30.0 / stats.chi2.ppf(0.025, 30))


@pytest.mark.parametrize("degrees", [0.99 * MIN_DEGREES, 0.0, -1.0, math.nan])
def test_without_degrees_of_freedom_anything_is_possible(degrees: float) -> None:
    assert ratio_interval(3.0, degrees, 0.05) == (0.0, math.inf)


def test_nothing_expected_is_no_ratio() -> None:
    empty = BatchMeans().ratio
    assert math.isnan(empty.value)
    assert empty.error == math.inf
    assert empty.degrees == 0.0
    assert empty.interval(0.05) == (0.0, math.inf)
    assert math.isnan(Ratio.of_parts([BatchMeans()]).value)


def test_independent_squares_have_as_many_degrees_as_there_are() -> None:
    found = batches(np.random.default_rng(0).standard_normal(4000) ** 2)
    assert found.count == 4000
    assert found.ratio.value == pytest.approx(1.0, abs=0.1)
    assert 1500 < found.ratio.degrees <= 4000 + 1e-6


@pytest.mark.parametrize("parts", [2, 7, 100])
def test_how_rows_come_does_not_matter(parts: int) -> None:
    squares = similar(np.random.default_rng(1), 1000, 0.8)
    one, many = batches(squares).ratio, batches(squares, parts).ratio
    assert many.value == pytest.approx(one.value)
    assert many.error == pytest.approx(one.error)


@pytest.mark.parametrize(("n", "rho"), [(100, 0.0), (400, 0.5), (400, 0.9), (4000, 0.9)])
def test_limits_hold_where_neighbours_are_alike(n: int, rho: float) -> None:
    rng, runs = np.random.default_rng(2), 300
    outside = 0
    for _ in range(runs):
        low, high = batches(similar(rng, n, rho), 5).ratio.interval(0.01)
        outside += not low <= 1.0 <= high
    # 1 % is right; batches of a series that is short against its memory are optimistic by a factor of three
    assert outside <= 0.045 * runs


def test_fewer_squares_than_batches_count_as_independent() -> None:
    same = np.full(MIN_BATCHES - 1, 3.0)
    assert batches(same).ratio.degrees == pytest.approx(MIN_BATCHES - 1)


def test_memory_stays_bounded_and_nothing_is_lost() -> None:
    found = batches(np.ones(10_001), 10_001 // MAX_BATCHES)
    assert found.squares == found.expected == 10_001


def test_parts_are_put_together_as_independent() -> None:
    rng = np.random.default_rng(3)
    parts = [batches(rng.standard_normal(500) ** 2) for _ in range(4)]
    whole = Ratio.of_parts(parts)
    assert whole.value == pytest.approx(sum(p.squares for p in parts) / 2000)
    assert whole.error == pytest.approx(math.sqrt(sum((p.ratio.error * 500) ** 2 for p in parts)) / 2000)


def test_batches_of_which_nothing_is_expected_do_not_scatter() -> None:
    """The last square alone is expected to be one, and is in no whole batch yet."""
    means = BatchMeans()
    expected = np.zeros(2 * MAX_BATCHES + 1)
    expected[-1] = 1.0
    means.add(np.append(np.zeros(2 * MAX_BATCHES), 4.0), expected)
    assert means.ratio.value == 4.0
    assert means.ratio.error == pytest.approx(np.sqrt(32.0))
