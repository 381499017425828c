"""The exact test of paired differences against enumeration, SciPy and Fisher's own example."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy import stats

from occlog.array_types import Floats
from occlog.core.metrics.paired import ALL, DRAWS, chance_above, chance_below, interval, subset_means

DARWIN = np.array([49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48.0])
"""Heights of crossed plants of maize above those of self-fertilised ones [1/8 inch] (Fisher 1935, sec. 17)."""


def even(count: int) -> Floats:
    return np.full(count, 1.0 / count)


def means(differences: Floats, weights: Floats | None = None, seed: int = 0) -> Floats:
    given = even(len(differences)) if weights is None else weights
    return subset_means(differences * (given if weights is None else 1.0), given, np.random.default_rng(seed))


def test_fishers_example_has_his_863_choices_of_signs() -> None:
    found = means(DARWIN)
    assert len(found) == 2**15 - 1
    # 835 of 32,768 have a larger sum than the one observed, 28 the same (Fisher 1935, sec. 21)
    assert chance_above(found, 0.0) == pytest.approx(863 / 32768, abs=1e-12)
    assert chance_below(-found[::-1], 0.0) == chance_above(found, 0.0)


@pytest.mark.parametrize("count", [1, 2, 7, 11])
@pytest.mark.parametrize("margin", [0.0, 0.3, -0.8])
def test_chances_are_those_of_all_choices_of_signs(count: int, margin: float) -> None:
    rng = np.random.default_rng(count)
    weights = rng.uniform(0.5, 2, count)
    weights /= weights.sum()
    parts = weights * rng.normal(0.3, 1, count)
    found = means(parts, weights)
    left = parts - margin * weights
    sums = np.array([np.dot(signs, left) for signs in product((1.0, -1.0), repeat=count)])
    assert chance_above(found, margin) == pytest.approx(np.mean(sums >= left.sum() - 1e-12))
    assert chance_below(found, margin) == pytest.approx(np.mean(sums <= left.sum() + 1e-12))


def test_chances_are_those_of_scipy() -> None:
    x = np.random.default_rng(4).standard_t(3, 10) + 0.5
    for alternative, chance in (("greater", chance_above), ("less", chance_below)):
        theirs = stats.permutation_test((x,), np.mean, permutation_type="samples", alternative=alternative)
        assert chance(means(x), 0.0) == pytest.approx(theirs.pvalue)


def test_equal_differences_are_ties_in_spite_of_rounding() -> None:
    x = np.array([0.1, 0.2, 0.3, -0.3, -0.2, -0.1])
    # The sum is 0: as many choices lie above as below, and the ties count on both sides
    found = means(x)
    assert chance_above(found, 0.0) == chance_below(found, 0.0) > 0.5
    nothing = means(np.zeros(8))
    assert chance_above(nothing, 0.0) == chance_below(nothing, 0.0) == 1.0
    similar = means(np.full(8, 0.1))
    assert chance_above(similar, 0.0) == 1 / 256
    assert chance_above(similar, 0.1) == chance_below(similar, 0.1) == 1.0


@pytest.mark.parametrize("count", [6, 10, ALL, ALL + 1, 40])
def test_the_interval_holds_the_margins_that_the_test_does_not_reject(count: int) -> None:
    x = np.random.default_rng(count).exponential(size=count)
    found = means(x)
    assert len(found) == (2**count - 1 if count <= ALL else DRAWS)
    low, high = interval(found, 0.95)
    assert low < x.mean() < high
    step = 1e-6
    assert chance_above(found, low - step) <= 0.025 < chance_above(found, low + step)
    assert chance_below(found, high + step) <= 0.025 < chance_below(found, high - step)


def test_few_parts_reject_no_margin_and_have_no_bounds() -> None:
    x = np.arange(1.0, 6.0)
    # 2 of 32 are more than 5 %
    assert interval(means(x), 0.95) == (-np.inf, np.inf)
    assert interval(means(x), 0.9) == (1.0, 5.0)


def test_drawn_subsets_give_nearly_what_all_of_them_give() -> None:
    x = np.random.default_rng(2).normal(0.3, 1, ALL + 3)
    sums = np.zeros(1)
    for each in x:
        sums = np.concatenate([sums, sums + each])
    whole = np.mean(sums <= 1e-12)
    got = chance_above(means(x, seed=5), 0.0)
    assert got == pytest.approx(whole, abs=5 * np.sqrt(whole * (1 - whole) / DRAWS))
    assert means(x, seed=5).tolist() == means(x, seed=5).tolist()


def test_the_level_is_kept_exactly_by_differences_of_any_even_distribution() -> None:
    rng = np.random.default_rng(8)
    size = np.abs(rng.standard_cauchy(10)) ** 2
    # All signs of these sizes, each once: 10 of 1,024 are rejected at 1 %, whatever the sizes
    given = np.array(list(product((1.0, -1.0), repeat=10))) * size
    rejected = sum(chance_above(means(x), 0.0) <= 0.01 for x in given)
    assert rejected == 10
