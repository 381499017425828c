"""Tracks of several groups of cameras become one track a person, and identities go over from group to group."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people_in_groups import walk

from occlog.errors import InputError
from occlog.measure.fuse.tracks.config import TrackFusionConfig
from occlog.measure.fuse.tracks.stage import fuse_tracks
from occlog.records.tables import JoinedTracks, PeopleTracks

CONFIG = TrackFusionConfig.in_unit("m")
TIMES = np.arange(40) / 10


def people(*tracks: PeopleTracks) -> PeopleTracks:
    return PeopleTracks.merge(tracks)


def made_of(tracks: JoinedTracks) -> dict[int, list[str]]:
    """What each identity is made of, in the order of time."""
    return {
        i: list(dict.fromkeys(tracks.source_ids[tracks.target_id == i].tolist()))
        for i in np.unique(tracks.target_id).tolist()
    }


def test_people_whom_both_groups_follow_are_one_and_others_stay() -> None:
    east = people(walk(0, TIMES, (0, 0), (1, 0)), walk(1, TIMES, (0, 5), (1, 0)))
    west = people(walk(7, TIMES, (0.05, 5.05), (1, 0), camera="cam2"), walk(8, TIMES, (0, 9), (1, 0), camera="cam2"))
    fused = fuse_tracks([east, west], CONFIG)
    assert sorted(made_of(fused.tracks).values()) == [["-,8"], ["0,-"], ["1,7"]]
    both = fused.tracks.take(fused.tracks.source_ids == "1,7")
    assert set(both.seen_by.tolist()) == {"cam1,cam2"}
    assert both.y == pytest.approx(5.025, abs=0.03)
    assert both.cov_xx == pytest.approx(0.01, rel=1e-6)  # what they have in common is not known
    assert fused.events.kind.tolist() == ["initiated"] * 3
    assert fused.agreements[0].pairs == len(TIMES)
    assert fused.agreements[0].distance == pytest.approx(np.hypot(0.05, 0.05))


def test_an_identity_goes_over_from_group_to_group() -> None:
    east = walk(0, TIMES[:20], (0, 0), (1, 0))
    west = people(walk(4, TIMES[10:30], (0, 0), (1, 0)), walk(5, TIMES[30:], (0, 4), (1, 0)))
    east = people(east, walk(9, TIMES[25:], (0, 0), (1, 0)))
    fused = fuse_tracks([east, west], CONFIG)
    assert list(made_of(fused.tracks).values()) == [["0,-", "0,4", "-,4", "9,4", "9,-"], ["-,5"]]
    assert not (fused.events.kind == "possible_switch").any()


def test_tracks_that_meet_and_part_are_two_people_again_with_a_doubt() -> None:
    apart = np.concatenate([np.linspace(3, 0, 30), np.zeros(40), np.linspace(0, 3, 30)])
    times = np.arange(100) / 10
    east = walk(0, times, (0, 0), (0, 0))
    west = replace(walk(0, times, (0, 0), (0, 0)), x=apart)
    fused = fuse_tracks([east, west], CONFIG)
    # Alone, met, and alone with the first identities again
    assert made_of(fused.tracks) == {0: ["0,-", "0,0"], 1: ["-,0"]}
    doubts = fused.events.take(fused.events.kind == "possible_switch")
    assert sorted(zip(doubts.target_id.tolist(), doubts.other_id.tolist(), strict=True)) == [(0, 1), (1, 0)]
    assert np.count_nonzero(np.char.find(fused.tracks.quality_flags, "possible_switch") >= 0) == 2


def test_places_that_do_not_agree_for_a_moment_are_a_contradiction() -> None:
    west = walk(3, TIMES, (0, 0), (1, 0))
    west.x[20] += 2.0
    fused = fuse_tracks([walk(0, TIMES, (0, 0), (1, 0)), west], CONFIG)
    assert list(made_of(fused.tracks).values()) == [["0,3"]]
    assert np.flatnonzero(fused.tracks.quality_flags == "inconsistent_views").tolist() == [20]


def test_groups_at_other_rates_are_fused_at_all_times() -> None:
    east, west = walk(0, TIMES, (0, 0), (1, 0)), walk(2, np.arange(100) / 25, (0, 0), (1, 0))
    tracks = fuse_tracks([east, west], CONFIG).tracks
    assert set(tracks.source_ids[tracks.t_ns <= east.t_ns[-1]].tolist()) == {"0,2"}
    assert len(tracks) >= 100
    assert tracks.x == pytest.approx(tracks.t_ns / 1e9)


def test_three_groups_agree_on_one_person() -> None:
    groups = [walk(i, TIMES, (0, 0), (1, 0), camera=f"cam{i}") for i in (2, 5, 6)]
    tracks = fuse_tracks(groups, CONFIG).tracks
    assert set(tracks.source_ids.tolist()) == {"2,5,6"}
    assert set(tracks.seen_by.tolist()) == {"cam2,cam5,cam6"}


def test_doubts_of_the_first_groups_have_the_identities_that_people_get_with_the_last() -> None:
    times = np.arange(100) / 10
    apart = np.concatenate([np.linspace(3, 0, 30), np.zeros(40), np.linspace(0, 3, 30)])
    west = replace(walk(0, times, (0, 0), (0, 0)), x=apart)
    fused = fuse_tracks([walk(0, times, (0, 0), (0, 0)), west, walk(1, times, (0, 9), (0, 0))], CONFIG)
    known = set(fused.tracks.target_id.tolist())
    doubts = fused.events.take(fused.events.kind == "possible_switch")
    assert len(doubts) == 2
    assert set(doubts.target_id.tolist()) | set(doubts.other_id.tolist()) <= known


def test_velocities_that_one_group_does_not_know_are_not_known() -> None:
    tracks = fuse_tracks(
        [walk(0, TIMES, (0, 0), (1, 0)), walk(0, TIMES, (0, 0), (1, 0), velocities=False)], CONFIG
    ).tracks
    assert set(tracks.source_ids.tolist()) == {"0,0"}
    assert np.isnan(tracks.vx).all()


def test_a_group_of_no_person_changes_nothing() -> None:
    east = walk(4, TIMES, (0, 0), (1, 0))
    for groups in ([east, PeopleTracks.empty()], [PeopleTracks.empty(), east]):
        tracks = fuse_tracks(groups, CONFIG).tracks
        assert np.array_equal(tracks.x, east.x)
    assert not len(fuse_tracks([PeopleTracks.empty(), PeopleTracks.empty()], CONFIG).tracks)


def test_tracks_in_space_are_refused() -> None:
    with pytest.raises(InputError, match="tracks with heights"):
        fuse_tracks([replace(walk(0, TIMES, (0, 0), (1, 0)), z=np.ones(len(TIMES)))], CONFIG)
