"""Pieces of tracks and the names that they get."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.appearance.stage import IdentityEvidence
from occlog.records.tables import Events, PeopleTracks
from occlog.track.people.reidentification import (
    FragmentNames,
    TrackSplit,
    name_probability,
    named_events,
    named_tracks,
    reidentification_events,
    reidentify_fragments,
    split_tracks,
)

LEAST = {"similarity_limit": 0.8, "least_boxes": 10}


def rows(*spans: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Rows of tracks that are there from one time to another, both included."""
    pairs = [(t, track) for track, first, last in spans for t in range(first, last + 1)]
    t_ns, track = np.array(sorted(pairs)).T
    return track.astype(np.int32), t_ns


def evidence(pieces: dict[int, tuple[float, ...]], gallery=(0, 1), boxes=20) -> IdentityEvidence:
    """Mean likenesses of pieces to the people of a gallery; NaN: not compared."""
    mean = np.array(list(pieces.values()))
    count = np.where(np.isnan(mean), 0, boxes)
    track = np.array(list(pieces), dtype=np.int32)
    return IdentityEvidence(track, np.array(gallery, dtype=np.int32), np.nan_to_num(mean) * count, count)


def exchanged() -> tuple[tuple[np.ndarray, np.ndarray], list[TrackSplit]]:
    """Tracks 3 and 5, who may have been exchanged at time 10."""
    return rows((3, 0, 20), (5, 4, 20)), [TrackSplit(3, 10, 5), TrackSplit(5, 10, 3)]


def test_rows_are_of_the_piece_of_their_time():
    where, cuts = exchanged()
    pieces = split_tracks(*where, [*cuts, TrackSplit(9, 12, 3)])
    assert pieces.track.tolist() == [3, 3, 5, 5]
    assert (pieces.first_ns.tolist(), pieces.last_ns.tolist()) == ([0, 10, 4, 10], [9, 20, 9, 20])
    found = pieces.of(np.array([3, 3, 5, 5, 4, 9], dtype=np.int32), np.array([9, 10, 9, 10, 9, 12]))
    assert found.tolist() == [0, 1, 2, 3, -1, -1]


def test_looks_put_an_exchange_right():
    where, cuts = exchanged()
    pieces = split_tracks(*where, cuts)
    # After they met each resembles the other
    stated = evidence({0: (0.99, 0.85), 1: (0.85, 0.99), 2: (0.85, 0.99), 3: (0.99, 0.85)})
    assert reidentify_fragments(pieces, stated, (0, 1), **LEAST).name.tolist() == [0, 1, 1, 0]
    # Where looks tell of one of them alone, the other is who is left
    stated = evidence({0: (0.99, 0.85), 1: (0.85, 0.99), 2: (0.85, 0.99)})
    assert reidentify_fragments(pieces, stated, (0, 1), **LEAST).name.tolist() == [0, 1, 1, 0]


def test_pieces_that_do_not_tell_go_on_as_they_were():
    where, cuts = exchanged()
    pieces = split_tracks(*where, cuts)
    names = reidentify_fragments(pieces, evidence({0: (0.99, 0.85), 1: (0.86, 0.86)}), (0, 1), **LEAST)
    assert names.name.tolist() == [0, 0, 2, 2]
    assert np.isfinite(names.probability).tolist() == [True, False, False, False]


def test_the_parts_of_somebody_who_was_lost_are_one_and_two_at_a_time_are_two():
    pieces = split_tracks(*rows((3, 0, 10), (5, 15, 30), (6, 20, 30)), [])
    names = reidentify_fragments(pieces, evidence({0: (0.95, 0.8), 1: (0.98, 0.8), 2: (0.96, 0.8)}), (0, 1), **LEAST)
    assert names.name.tolist() == [0, 0, 2]
    assert reidentification_events(pieces, names, 0, 14) == [
        (0, "reidentified", 0, -1, pytest.approx(names.probability[0]))
    ]
    assert [row[0] for row in reidentification_events(pieces, names, 15, 30)] == [15]


def test_a_name_is_as_probable_as_its_margin_is_wide():
    stated = evidence({0: (0.99, 0.9), 1: (0.92, 0.9), 2: (0.9, np.nan)})
    wide, narrow, alone = (name_probability(stated, row, 0, **LEAST) for row in range(3))
    assert wide > 0.99
    assert narrow < 0.5
    # No one else was compared: it must be more alike than a box of somebody else may be
    assert alone > 0.99
    # Less than half is no name
    pieces = split_tracks(*rows((3, 0, 9)), [])
    assert reidentify_fragments(pieces, evidence({0: (0.92, 0.9)}), (0, 1), **LEAST).name.tolist() == [2]


def events() -> Events:
    rows = [(10, "possible_switch", 3, 5, 0.6), (10, "possible_switch", 5, 3, 0.6), (4, "initiated", 5, -1, 0.9)]
    return Events.of_rows(rows)


@pytest.mark.parametrize(("sure", "left"), [(1.0, 0), (0.7, 2), (np.nan, 2)])
def test_a_doubt_is_what_looks_leave_of_it(sure, left):
    where, cuts = exchanged()
    pieces = split_tracks(*where, cuts)
    names = FragmentNames(np.array([7, 8, 8, 7], dtype=np.int32), np.array([1.0, 1.0, 1.0, sure]))
    found = named_events(events(), pieces, names)
    doubts = found.take(found.kind == "possible_switch")
    assert len(doubts) == left
    if left:
        # The names are those from the time on
        assert (doubts.target_id.tolist(), doubts.other_id.tolist()) == ([7, 8], [8, 7])
        assert doubts.probability == pytest.approx([0.6 if np.isnan(sure) else 1.0 - sure] * 2)
    assert found.target_id[found.kind == "initiated"].tolist() == [8]
    n = len(where[0])
    nothing = np.zeros(n)
    words = np.where((where[1] == 10), "single_view,possible_switch", "single_view")
    tracks = PeopleTracks.of(
        t_ns=where[1], target_id=where[0], x=nothing, y=nothing, vx=nothing, vy=nothing,
        cov_xx=nothing + 1, cov_xy=nothing, cov_yy=nothing + 1, quality_flags=words,
    )  # fmt: skip
    stated = named_tracks(tracks, found, pieces, names)
    assert stated.target_id[stated.t_ns == 20].tolist() == [7, 8]
    assert (
        stated.quality_flags[stated.t_ns == 10].tolist()
        == ["single_view,possible_switch" if left else "single_view"] * 2
    )
