"""Two runs in common frames: their times, who is there, and places between the rows of another clock."""

from __future__ import annotations

import numpy as np
import pytest
from two_runs import STEP, lost, tracks

from occlog.errors import InputError
from occlog.report.comparison.matching.pairs import align_estimates, common_times


def test_frames_are_the_times_of_both_while_both_last() -> None:
    a, b = tracks(40), tracks(40, start=10)
    assert common_times(a, b).tolist() == [k * STEP for k in range(10, 40)]
    assert common_times(b, a).tolist() == common_times(a, b).tolist()


def test_runs_without_common_time_are_refused() -> None:
    with pytest.raises(InputError, match=r"no time in common: 0\.000 s to 3\.900 s and 4\.000 s to 7\.900 s"):
        common_times(tracks(40), tracks(40, start=40))


def test_at_a_run_s_own_times_only_those_are_there_who_have_a_row() -> None:
    table = tracks(20, lost(1, 7, 7))
    times = common_times(table, tracks(20))
    found = align_estimates(table, times)
    assert found.label[found.frame == 7].tolist() == [10, 12]
    assert found.label[found.frame == 8].tolist() == [10, 11, 12]
    assert np.array_equal(table.take(found.row).x, found.xy[:, 0])
    own = found.table(table, times)
    assert own.t_ns.tolist() == table.t_ns.tolist()


def test_at_times_of_another_clock_places_are_between_rows_and_never_over_a_long_gap() -> None:
    table = tracks(30, lost(2, 10, 19))
    other = tracks(28)
    other.t_ns[:] += STEP // 4
    times = common_times(table, other)
    found = align_estimates(table, times)
    k = int(np.searchsorted(times, 5 * STEP + STEP // 4))
    here = found.frame == k
    np.testing.assert_allclose(found.xy[here], [[0.525, 0.0], [0.525, 4.0], [0.525, 8.0]])
    assert table.t_ns[found.row[here]].tolist() == [5 * STEP] * 3
    inside = int(np.searchsorted(times, 12 * STEP + STEP // 4))
    assert found.label[found.frame == inside].tolist() == [10, 11]
