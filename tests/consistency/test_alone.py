"""Bearings that no other sensor can confirm."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.track.sparse_false_bearings import solve
from occlog.array_types import NS
from occlog.consistency.bearings import (
    CONFIRMATION_WINDOW_S,
    MIN_OVERLAP_SHARE,
    UnconfirmedBearings,
    confirmed_by_another,
)
from occlog.records.tables import Residuals


def rows(times: list[float], sensors: list[str], target: int = 0) -> Residuals:
    n = len(times)
    return Residuals.of(
        t_ns=np.round(np.array(times) * NS).astype(np.int64),
        target_id=np.full(n, target, np.int32),
        sensor=np.array(sensors),
        residual=np.zeros(n),
        expected_variance=np.ones(n),
        inlier_probability=np.ones(n),
    )


def test_another_sensor_is_near_up_to_a_second() -> None:
    sensor, seconds = (
        np.array([0, 1, 0, 0]),
        np.array([0.0, CONFIRMATION_WINDOW_S, 2.0 * CONFIRMATION_WINDOW_S, 2.001 * CONFIRMATION_WINDOW_S]),
    )
    assert confirmed_by_another(sensor, seconds).tolist() == [True, True, True, False]
    assert not confirmed_by_another(np.zeros(3, np.int64), np.arange(3.0)).any()
    assert len(confirmed_by_another(np.zeros(0, np.int64), np.zeros(0))) == 0


def test_other_targets_bearings_confirm_nothing() -> None:
    found = UnconfirmedBearings()
    found.add(Residuals.merge([rows([0.0, 5.0], ["a", "a"]), rows([0.0], ["b"], target=1)]))
    assert (found.bearings, found.confirmed, found.one_at_a_time) == (3, 0, True)


@pytest.mark.parametrize(("together", "one_at_a_time"), [(10, False), (8, True)])
def test_half_of_the_bearings_near_another_are_enough(together: int, one_at_a_time: bool) -> None:
    alone = round(10 / MIN_OVERLAP_SHARE) - together
    pairs = rows([10.0 * k for k in range(together // 2) for _ in "ab"], ["a", "b"] * (together // 2))
    found = UnconfirmedBearings()
    found.add(pairs)
    found.add(rows([1e3 + 10.0 * k for k in range(alone)], ["a"] * alone))
    assert found.bearings == 20
    assert found.one_at_a_time is one_at_a_time


@pytest.mark.jit
@pytest.mark.parametrize(("false", "reported"), [(0.0, False), (0.2, True)])
def test_one_false_bearing_in_five_where_cameras_do_not_overlap_is_reported(false: float, reported: bool) -> None:
    """[Rahimi] Sec. 6: some false bearings agree with a motion that is as probable; run 17 has a NEES of 150."""
    assert ("measurements-unconfirmed" in solve(17, false, {}).said) is reported
