"""Sums and quantiles of numbers that come in parts, against those of NumPy of the whole."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.metrics.errors import Sum, group_medians, quantiles

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


@pytest.mark.parametrize("parts", [1, 5])
def test_medians_of_groups_are_those_of_numpy(parts: int) -> None:
    random = np.random.default_rng(4)
    group, values = random.integers(0, 9, 500) % 8, random.choice([1e8, 1e8 + 1, -3.0, 0.0, 7.5e9, 2.25], 500)
    group[group == 3] = 4
    counts = np.bincount(group, minlength=9)
    cut = [np.array_split(each, parts) for each in (group, values)]
    got = group_medians(lambda: zip(*cut, strict=True), counts)
    assert counts[3] == counts[8] == 0
    for k in range(9):
        np.testing.assert_equal(got[k], np.median(values[group == k]) if counts[k] else np.nan)
    assert {int(n) % 2 for n in counts if n} == {0, 1}
