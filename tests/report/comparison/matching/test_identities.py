"""Which tracks follow a person over time: pieces, changes, and what passes too quickly to be stated."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from occlog.report.comparison.matching.pairs import MatchedRuns, Piece, TrackChange, pieces_of, unmatched_changes

SECOND = 10**9
TIMES = np.arange(200) * SECOND


def follow(tracks: list[int | None], lasting: float) -> MatchedRuns:
    """One person, at each second followed by a track or by none."""
    frame = np.array([k for k, track in enumerate(tracks) if track is not None], dtype=np.int64)
    track = np.array([track for track in tracks if track is not None], dtype=np.int64)
    return pieces_of(np.full(len(frame), 7), track, frame, TIMES, round(lasting * SECOND))


def test_one_track_is_one_piece() -> None:
    assert follow([3] * 10, 1) == MatchedRuns((Piece(7, 3, 0, 9 * SECOND),), (), 0)


def test_another_track_is_another_piece_and_a_change() -> None:
    found = follow([3] * 5 + [4] * 5, 1)
    assert found.pieces == (Piece(7, 3, 0, 4 * SECOND), Piece(7, 4, 5 * SECOND, 9 * SECOND))
    assert found.changes == (TrackChange(5 * SECOND, 7, 3, 4),)
    assert found.passing == 0


def test_what_passes_is_counted_and_left_out() -> None:
    found = follow([3] * 5 + [4, 4] + [3] * 5, 3)
    assert found == MatchedRuns((Piece(7, 3, 0, 11 * SECOND),), (), 2)
    reported = follow([3] * 5 + [4, 4] + [3] * 5, 2)
    assert [change.after for change in reported.changes] == [4, 3]


def test_an_interruption_that_lasts_ends_a_piece_but_is_no_change() -> None:
    found = follow([3] * 4 + [None] * 8 + [3] * 4, 2)
    assert [(p.start_ns // SECOND, p.end_ns // SECOND) for p in found.pieces] == [(0, 3), (12, 15)]
    assert found.changes == ()


def test_no_one_is_nothing() -> None:
    assert follow([], 1) == MatchedRuns((), (), 0)


@given(st.lists(st.one_of(st.none(), st.integers(0, 3)), max_size=60))
def test_with_nothing_too_short_changes_are_those_of_neighbouring_rows(tracks: list[int | None]) -> None:
    there = [(k, track) for k, track in enumerate(tracks) if track is not None]
    wanted = [
        TrackChange(k * SECOND, 7, before, track) for (_, before), (k, track) in pairwise(there) if before != track
    ]
    found = follow(tracks, 0)
    assert list(found.changes) == wanted
    assert found.passing == 0


def test_changes_that_the_other_run_has_at_about_the_same_time_have_a_counterpart() -> None:
    own = MatchedRuns(
        (), (TrackChange(10 * SECOND, 1, 3, 4), TrackChange(50 * SECOND, 1, 4, 3), TrackChange(10 * SECOND, 2, 5, 6)), 0
    )
    other = MatchedRuns((), (TrackChange(11 * SECOND, 1, 8, 9),), 0)
    assert unmatched_changes(own, other, SECOND) == own.changes[1:]
    assert unmatched_changes(own, other, SECOND - 1) == own.changes
