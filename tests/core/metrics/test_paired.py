"""Paired comparisons against closed forms and enumeration, and their rate of false alarms."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from occlog.array_types import Floats
from occlog.core.metrics.paired import MANY_RECORDINGS, MAX_SEGMENTS, MIN_SEGMENTS, autocorrelation_time, compare


def mean(sums: Floats) -> Floats:
    """Mean of a value: of sums of values and of counts."""
    return np.asarray(sums[..., 0] / sums[..., 1])


def counted(values: Floats) -> Floats:
    return np.column_stack([values, np.ones(len(values))])


def ar1(rng: np.random.Generator, count: int, rho: float) -> Floats:
    noise = rng.normal(0, np.sqrt(1 - rho**2), count)
    noise[0] = rng.normal()
    return lfilter([1.0], [1.0, -rho], noise)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_autocorrelation_time_of_an_ar1_process(rho: float) -> None:
    rng = np.random.default_rng(3)
    found = autocorrelation_time([ar1(rng, 20_000, rho) for _ in range(4)])
    assert found == pytest.approx((1 + rho) / (1 - rho), rel=0.15)


def test_autocorrelation_time_of_little() -> None:
    assert autocorrelation_time([]) == 1.0
    assert autocorrelation_time([np.ones(50)]) == 1.0
    assert autocorrelation_time([np.array([1.0])]) == 1.0


def test_recordings_of_normal_differences_give_the_interval_of_student() -> None:
    rng = np.random.default_rng(1)
    size = 40
    a = [counted(rng.normal(5, 1, 50)) for _ in range(size)]
    shift = rng.normal(0.2, 0.5, size)
    b = [x + np.array([d, 0]) for x, d in zip(a, shift, strict=True)]
    found = compare(a, b, mean, np.random.default_rng(0))
    assert found.recordings
    assert found.segments == size
    assert found.difference == pytest.approx(shift.mean())
    assert found.se == pytest.approx(shift.std(ddof=1) / np.sqrt(size), rel=1e-5)
    half = stats.t.ppf(0.975, size - 1) * found.se
    assert found.low == pytest.approx(found.difference - half, abs=0.12 * half)
    assert found.high == pytest.approx(found.difference + half, abs=0.12 * half)
    assert found.p == pytest.approx(stats.ttest_1samp(shift, 0).pvalue, abs=0.015)


def test_p_is_that_of_all_exchanges_of_recordings() -> None:
    rng = np.random.default_rng(3)
    runs = [
        [np.column_stack([rng.binomial(1, 0.7 + d, 40), rng.uniform(0.5, 1.5, 40)]) for _ in range(MANY_RECORDINGS)]
        for d in (0.0, 0.05)
    ]
    found = compare(*runs, mean, rng)
    a, b = (np.array([x.sum(axis=0) for x in run]) for run in runs)
    differences = []
    for swap in product((False, True), repeat=MANY_RECORDINGS):
        swapped = np.array(swap)[:, None]
        differences.append(mean(np.where(swapped, a, b).sum(axis=0)) - mean(np.where(swapped, b, a).sum(axis=0)))
    # The figure itself of all 256 exchanges, for which `compare` takes its slope
    assert found.difference == differences[0]
    for chance, hits in (
        (found.above(0.0), np.array(differences) >= found.difference - 1e-12),
        (found.below(0.0), np.array(differences) <= found.difference + 1e-12),
    ):
        assert chance == pytest.approx(hits.mean(), abs=2 / 256)


def test_verdict_and_interval_do_not_contradict_each_other() -> None:
    rng = np.random.default_rng(6)
    for _ in range(60):
        a, b = ([counted(rng.exponential(size=9) + d) for _ in range(9)] for d in (0.0, 0.5))
        found = compare(a, b, mean, rng)
        assert (found.p <= 0.05) == (not found.low <= 0.0 <= found.high)
        assert found.below(found.high + 1e-6) <= 0.025 < found.below(found.high - 1e-6)
        assert found.above(found.low - 1e-6) <= 0.025 < found.above(found.low + 1e-6)


def test_standard_error_of_an_ar1_process() -> None:
    rng = np.random.default_rng(7)
    count, rho = 20_000, 0.8
    a = counted(np.zeros(count))
    errors = [compare([a], [counted(ar1(rng, count, rho))], mean, rng).se for _ in range(10)]
    true = np.sqrt((1 + rho) / (1 - rho) / count)
    # Of 100 stretches each the error is known to 7 %, of ten such to 2.3 %
    assert np.mean(errors) == pytest.approx(true, rel=0.1)


def test_a_shift_between_runs_that_share_their_noise_is_found_although_either_varies_much_more() -> None:
    rng = np.random.default_rng(2)
    hard = ar1(rng, 2000, 0.95) * 10
    a, b = counted(hard + rng.normal(0, 0.1, 2000)), counted(hard + rng.normal(0.05, 0.1, 2000))
    found = compare([a], [b], mean, rng)
    assert found.above(0.0) < 0.001
    assert found.below(0.0) > 0.99
    assert found.above(0.05) > 0.01
    assert found.below(0.1) < 0.001
    assert 0.03 < found.low < 0.05 < found.high < 0.07


def test_nothing_is_concluded_from_too_little() -> None:
    rng = np.random.default_rng(2)
    a, b = (counted(ar1(rng, 200, 0.99)) for _ in range(2))
    found = compare([a], [b], mean, rng)
    assert found.segments < MIN_SEGMENTS
    assert np.isnan([found.p, found.low, found.high, found.se]).all()
    assert found.difference == pytest.approx(b[:, 0].mean() - a[:, 0].mean())
    few = [counted(rng.normal(size=3)) for _ in range(MANY_RECORDINGS)]
    assert compare(few, [x + np.array([1, 0]) * rng.normal(size=(3, 1)) for x in few], mean, rng).recordings
    assert not compare(few[1:], few[1:], mean, rng).recordings


def test_runs_that_are_the_same_do_not_differ() -> None:
    a = counted(np.random.default_rng(0).normal(size=500))
    found = compare([a], [a], mean, np.random.default_rng(1))
    assert (found.difference, found.se, found.p, found.below(0.0), found.above(0.0)) == (0.0, 0.0, 1.0, 1.0, 1.0)
    assert (found.below(0.1), found.above(-0.1)) == (0.0, 0.0)
    assert found.segments == MAX_SEGMENTS
    lasting = compare([a], [a + np.array([1.0, 0.0])], mean, np.random.default_rng(1), lasting=True)
    assert lasting.difference == pytest.approx(1.0)
    assert np.isnan(lasting.p)
    assert compare([a], [a], mean, np.random.default_rng(1), lasting=True).p == 1.0
    many = [a] * MANY_RECORDINGS
    assert (
        compare(many, [x + np.array([1.0, 0.0]) for x in many], mean, np.random.default_rng(1), lasting=True).p < 0.01
    )
    with pytest.raises(ValueError, match="same frames"):
        compare([a], [a[1:]], mean, np.random.default_rng(1))


@pytest.mark.statistics
@pytest.mark.parametrize(("recordings", "frames", "rho"), [(1, 1200, 0.8), (4, 300, 0.8), (12, 100, 0.9)])
def test_false_alarms_come_as_often_as_is_reported(recordings: int, frames: int, rho: float) -> None:
    rng = np.random.default_rng(5)
    count, alarms = 200, 0
    for _ in range(count):
        hard = [3 * ar1(rng, frames, rho) for _ in range(recordings)]
        # Skewed errors: squares of normal ones
        runs = [[counted(np.abs(h) + ar1(rng, frames, rho) ** 2) for h in hard] for _ in range(2)]
        alarms += compare(*runs, mean, rng).p < 0.05
    # 0.05 of 200 runs is 10 with a standard deviation of 3.1
    assert 10 - 3.0 * 3.1 < alarms < 10 + 3.0 * 3.1
