"""Tracks at common times: rows as they are, straight lines between them, nothing over long gaps."""

from __future__ import annotations

import numpy as np
import pytest
from people_in_groups import walk

from occlog.array_types import NS
from occlog.measure.fuse.tracks.stage import at_times, default_window, step_times
from occlog.records.tables import PeopleTracks


def test_rows_at_a_moment_stay_as_they_are() -> None:
    track = walk(3, np.arange(5) / 10, (1.0, 2.0), (1.0, 0.0))
    same = at_times(track, track.t_ns, 0, NS)
    for column in PeopleTracks.columns():
        values = getattr(same, column.name)
        assert np.array_equal(values, getattr(track, column.name), equal_nan=column.kind == "f8"), column.name


def test_times_within_the_window_are_one_moment_and_others_are_not() -> None:
    a, b = walk(0, np.arange(4) / 10, (0, 0), (1, 0)), walk(0, np.arange(4) / 10 + 0.049, (0, 0), (1, 0))
    window = default_window([a, b])
    assert window == 49_000_000
    assert step_times([a, b], window).tolist() == a.t_ns.tolist()
    assert len(step_times([a, b], window - 1)) == 8


def test_people_who_walk_straight_on_are_placed_exactly_between_and_next_to_their_rows() -> None:
    track = walk(0, np.array([0.0, 0.4, 0.8]), (0.0, 0.0), (1.0, -1.0))
    asked = np.array([0.1, 0.4, 0.7, 0.9]) * NS
    found = at_times(track, asked.astype(np.int64), NS // 10, NS)
    assert found.x == pytest.approx([0.1, 0.4, 0.7, 0.9])
    assert found.y == pytest.approx([-0.1, -0.4, -0.7, -0.9])
    assert found.cov_xx == pytest.approx(0.01)


def test_a_long_gap_is_not_bridged() -> None:
    track = walk(0, np.array([0.0, 1.0, 2.1]), (0.0, 0.0), (1.0, 0.0))
    asked = np.array([500_000_000, 1_500_000_000], dtype=np.int64)
    assert at_times(track, asked, 0, NS).t_ns.tolist() == [500_000_000]


def test_without_velocities_a_row_next_to_a_moment_stays_where_it_is() -> None:
    track = walk(0, np.array([0.0]), (1.0, 2.0), (1.0, 0.0), velocities=False)
    found = at_times(track, np.array([50_000_000]), 60_000_000, NS)
    assert (found.x.tolist(), found.t_ns.tolist()) == ([1.0], [50_000_000])


def test_no_rows_have_no_moments() -> None:
    empty = PeopleTracks.empty()
    assert not len(step_times([empty], 0))
    assert not len(at_times(empty, np.zeros(0, dtype=np.int64), 0, NS))
    assert default_window([empty]) == 0
