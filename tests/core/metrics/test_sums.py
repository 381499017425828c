"""Sums and quantiles of numbers that come in parts, against those of NumPy of the whole."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.metrics.sums import Sum, quantiles

RANDOM = np.random.default_rng(1)
SHARES = [0.0, 0.05, 0.25, 0.5, 0.95, 0.999, 1.0]


@pytest.mark.parametrize("count", [1, 2, 3, 10, 1001])
@pytest.mark.parametrize(
    "values",
    [
        RANDOM.normal(size=1001),
        np.zeros(1001),
        np.round(RANDOM.normal(size=1001), 1),
        -np.abs(RANDOM.normal(size=1001)) * 1e300,
        np.where(RANDOM.random(1001) < 0.5, -0.0, 5e-324),
    ],
    ids=["normal", "equal", "ties", "huge", "tiny"],
)
def test_quantiles_of_blocks_are_those_of_the_whole(values: np.ndarray, count: int) -> None:
    own = values[:count]
    got = quantiles(lambda: np.array_split(own, 7), count, SHARES)
    np.testing.assert_array_equal(got, np.quantile(own, SHARES))


def test_a_sum_keeps_what_rounding_takes_away() -> None:
    values = [1e16, 1.0, -1e16, 1.0, 0.1] * 100
    found = Sum()
    for value in values:
        found.add(value)
    assert found.value == pytest.approx(math.fsum(values), rel=1e-15)
    assert abs(sum(values) - math.fsum(values)) > 10.0
