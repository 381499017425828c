"""Interpolation in time: exactness, the limit, no extrapolation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.core.numerics.interpolate import hold_positions, interpolate_positions

EPOCH = 1_700_000_000_000_000_000


def test_halfway_between_two_samples() -> None:
    known_t = np.array([0, 10, 30])
    known = np.array([[0.0, 0.0], [1.0, -2.0], [3.0, 2.0]])
    xy, good = interpolate_positions(np.array([0, 5, 10, 20, 30]), known_t, known, 20)
    assert good.all()
    np.testing.assert_array_equal(xy, [[0, 0], [0.5, -1], [1, -2], [2, 0], [3, 2]])


def test_gap_at_the_limit_is_bridged_and_one_nanosecond_more_is_not() -> None:
    known_t = EPOCH + np.array([0, 1_000_000_000])
    known = np.array([[0.0, 0.0], [2.0, 0.0]])
    middle = np.array([EPOCH + 500_000_000])
    assert interpolate_positions(middle, known_t, known, 1_000_000_000)[1].all()
    xy, good = interpolate_positions(middle, known_t, known, 999_999_999)
    assert not good.any()
    assert np.isnan(xy).all()


def test_samples_themselves_are_good_next_to_any_gap() -> None:
    known_t = EPOCH + np.array([0, 10**12])
    known = np.array([[1.0, 2.0], [3.0, 4.0]])
    xy, good = interpolate_positions(known_t, known_t, known, 0)
    assert good.all()
    np.testing.assert_array_equal(xy, known)


def test_nothing_is_extrapolated() -> None:
    known_t = np.array([100, 200])
    known = np.zeros((2, 2))
    _, good = interpolate_positions(np.array([99, 100, 200, 201]), known_t, known, 10**9)
    assert good.tolist() == [False, True, True, False]


def test_no_samples_or_no_times() -> None:
    xy, good = interpolate_positions(np.array([1, 2]), np.zeros(0, np.int64), np.zeros((0, 2)), 5)
    assert xy.shape == (2, 2)
    assert not good.any()
    xy, good = interpolate_positions(np.zeros(0, np.int64), np.array([1]), np.zeros((1, 2)), 5)
    assert xy.shape == (0, 2)
    assert good.shape == (0,)


def test_equal_times_take_the_last_sample() -> None:
    known_t = np.array([0, 10, 10, 20])
    known = np.array([[0.0], [1.0], [5.0], [5.0]])
    xy, good = interpolate_positions(np.array([10, 15]), known_t, known, 10)
    assert good.all()
    np.testing.assert_array_equal(xy[:, 0], [5, 5])


def test_nanoseconds_are_not_lost_at_times_since_1970() -> None:
    known_t = EPOCH + np.array([0, 100])
    xy, _ = interpolate_positions(EPOCH + np.arange(101), known_t, np.array([[0.0], [100.0]]), 100)
    np.testing.assert_allclose(xy[:, 0], np.arange(101), atol=1e-9)


def test_hold_keeps_the_ends_and_bridges_all() -> None:
    known_t = np.array([10, 1010])
    known = np.array([[1.0, 0.0], [3.0, 4.0]])
    xy = hold_positions(np.array([0, 10, 510, 1010, 5000]), known_t, known)
    np.testing.assert_array_equal(xy, [[1, 0], [1, 0], [2, 2], [3, 4], [3, 4]])


@given(
    st.lists(st.integers(0, 10_000), min_size=2, max_size=20, unique=True),
    st.lists(st.integers(-100, 10_100), min_size=1, max_size=20),
    st.integers(0, 2_000),
)
def test_against_numpy_on_exact_floats(samples: list[int], times: list[int], limit: int) -> None:
    known_t = np.sort(np.array(samples))
    known = np.sin(np.arange(len(known_t)))[:, None]
    t = np.array(times)
    xy, good = interpolate_positions(t, known_t, known, limit)
    for k, time in enumerate(times):
        below = known_t[known_t <= time]
        above = known_t[known_t >= time]
        allowed = bool(len(below) and len(above) and above[0] - below[-1] <= limit)
        assert good[k] == allowed
        if allowed:
            assert xy[k, 0] == pytest.approx(np.interp(time, known_t, known[:, 0]))


def test_a_gap_that_no_number_of_nanoseconds_holds_is_not_bridged() -> None:
    known_t = np.array([-6 * 10**18, 6 * 10**18])
    known = np.array([[0.0], [2.0]])
    xy, good = interpolate_positions(np.array([-6 * 10**18, 0, 6 * 10**18]), known_t, known, 10**9)
    assert good.tolist() == [True, False, True]
    np.testing.assert_array_equal(xy, [[0.0], [np.nan], [2.0]])
