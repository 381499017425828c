from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from occlog.report.drawing import broken, envelope, extremes, gaps, sensible_top, thin_path

VALUES = npst.arrays(np.float64, st.integers(1, 400), elements=st.floats(-1e6, 1e6))


@given(VALUES, st.integers(1, 40))
def test_extremes_keep_ends_and_range_and_are_few(values: np.ndarray, buckets: int) -> None:
    keep = extremes(values, buckets)
    assert (np.diff(keep) > 0).all()
    assert keep[0] == 0
    assert keep[-1] == len(values) - 1
    assert values[keep].min() == values.min()
    assert values[keep].max() == values.max()
    assert len(keep) <= 2 * buckets + 2


def test_extremes_of_every_stretch_against_a_loop() -> None:
    values = np.random.default_rng(3).normal(size=1003)
    keep = set(extremes(values, 50).tolist())
    width = -(-len(values) // 50)
    for start in range(0, len(values), width):
        part = values[start : start + width]
        assert start + int(part.argmin()) in keep
        assert start + int(part.argmax()) in keep


def test_nan_is_no_extreme() -> None:
    values = np.random.default_rng(3).normal(size=1000)
    values[::7] = np.nan
    keep = extremes(values, 20)
    assert np.nanmax(values[keep]) == np.nanmax(values)
    assert np.nanmin(values[keep]) == np.nanmin(values)


def test_path_keeps_its_extent_in_both_axes() -> None:
    xy = np.random.default_rng(0).normal(size=(5000, 2)).cumsum(axis=0)
    kept = xy[thin_path(xy, 60)]
    assert len(kept) <= 4 * 60 + 4
    assert (kept.min(axis=0) == xy.min(axis=0)).all()
    assert (kept.max(axis=0) == xy.max(axis=0)).all()


@given(VALUES, st.integers(1, 30))
def test_envelope_covers_the_band(values: np.ndarray, buckets: int) -> None:
    t = np.arange(len(values), dtype=float)
    times, low, high = envelope(t, values - 1.0, values + 1.0, buckets)
    assert (np.diff(times) >= 0).all()
    assert low.min() == (values - 1.0).min()
    assert high.max() == (values + 1.0).max()


def test_lines_break_at_gaps_even_when_thinned() -> None:
    t_ns = np.concatenate([np.arange(100), 1000 + np.arange(100)]).astype(np.int64)
    assert np.flatnonzero(gaps(t_ns)).tolist() == [100]
    keep = np.array([0, 50, 150, 199])
    t, v = broken(t_ns, keep, t_ns.astype(float), np.arange(200.0))
    np.testing.assert_array_equal(v, [0, 50, np.nan, 150, 199])
    assert np.isnan(t[2])


def test_no_break_without_gap() -> None:
    t_ns = np.arange(50, dtype=np.int64) * 10
    (v,) = broken(t_ns, np.arange(50), np.arange(50.0))
    assert not np.isnan(v).any()


@pytest.mark.parametrize(
    ("values", "low", "high"),
    [([1.0] * 500 + [1000.0], 1.0, 2.0), ([1.0, 1.5], 1.5, 2.0), ([0.0, 0.0], 0.0, 1e-6), ([np.nan], 0.5, 1.5)],
)
def test_an_outlier_does_not_flatten_the_axis(values: list[float], low: float, high: float) -> None:
    assert low < sensible_top(np.array(values)) < high


def test_an_axis_shows_all_up_to_twice_the_usual() -> None:
    """Of 201 values the 99th percentile is the third from the top."""
    usual = [1.0] * 200
    assert sensible_top(np.array([*usual, 2.0])) == pytest.approx(2.0 * 1.06)
    assert sensible_top(np.array([*usual, 2.001])) == pytest.approx(1.3)


def test_a_line_breaks_beyond_five_usual_steps() -> None:
    for last, breaks in ((40 + 50, []), (40 + 51, [5])):
        t_ns = np.array([0, 10, 20, 30, 40, last], dtype=np.int64)
        assert np.flatnonzero(gaps(t_ns)).tolist() == breaks


@pytest.mark.parametrize("n", [8, 9])
def test_few_values_all_come_back(n: int) -> None:
    found = extremes(np.zeros(n), 4)
    assert len(found) == n if n == 8 else len(found) < n
