"""Who of one run is who of the other, and where two runs part: scenes of which the answer is known by hand."""

from __future__ import annotations

import numpy as np
import pytest
from two_runs import PEOPLE, STEP, Change, exchanged_at, lost, moved, tracks

from occlog.array_types import NS
from occlog.records.tables import PeopleTracks
from occlog.report.comparison.matching.divergences import (
    ONLY_B,
    ONLY_IN_A,
    OTHER,
    TOO_FAR_APART,
    Divergences,
    divergences_of,
)
from occlog.report.comparison.matching.pairs import (
    PersonPair,
    RunPairs,
    align_estimates,
    common_times,
    mutual_matches,
    pairs_of,
)


def diverged(
    a: PeopleTracks, b: PeopleTracks, near: float = 1.0, tolerance: float = 0.5, lasting: float = 0.5
) -> tuple[RunPairs, Divergences]:
    times = common_times(a, b)
    left, right = align_estimates(a, times), align_estimates(b, times)
    pairs = pairs_of(left, right, near)
    partners = mutual_matches(left, right, pairs, times, round(lasting * NS))
    return pairs, divergences_of(left, right, pairs, times, tolerance, partners)


def test_a_run_next_to_itself_never_parts() -> None:
    pairs, found = diverged(tracks(), tracks())
    assert found.first is None
    assert (found.frames, found.diverged, found.segments) == (60, 0, ())
    assert len(pairs.frame) == 60 * PEOPLE
    assert pairs.people == tuple(PersonPair((k,), (k,)) for k in (10, 11, 12))
    assert found.farthest is not None
    assert found.farthest.distance == 0.0


def test_partners_part_at_the_frame_in_which_they_are_beyond_the_tolerance() -> None:
    _, found = diverged(tracks(), tracks(60, moved(1, 20, 29, 0.6)))
    assert found.first is not None
    kind, start = found.first
    assert kind == TOO_FAR_APART
    assert (start.t_ns, start.a, start.b) == (20 * STEP, 11, 11)
    assert start.distance == pytest.approx(0.6)
    assert found.diverged == 10
    assert [(s.start_ns, s.end_ns) for s in found.segments] == [(20 * STEP, 29 * STEP)]
    assert [kind.frames for kind in found.kinds] == [10, 0, 0, 0]


@pytest.mark.parametrize(("by", "first"), [(0.5, None), (0.5001, 20)])
def test_the_tolerance_itself_is_not_beyond_it(by: float, first: int | None) -> None:
    _, found = diverged(tracks(), tracks(60, moved(0, 20, 29, by)))
    assert (None if found.first is None else found.first[1].t_ns) == (None if first is None else first * STEP)


def test_somebody_whom_one_run_alone_has_is_a_parting() -> None:
    _, found = diverged(tracks(), tracks(60, lost(2, 30, 44)))
    assert found.first is not None
    kind, start = found.first
    assert kind == ONLY_IN_A
    assert (start.t_ns, start.a, start.b) == (30 * STEP, 12, None)
    assert start.distance == pytest.approx(4.0)  # the nearest of B is its neighbour
    _, other = diverged(tracks(60, lost(2, 30, 44)), tracks())
    assert other.first is not None
    assert other.first[0] == ONLY_B
    assert other.first[1][1:3] == (None, 12)
    assert found.diverged == other.diverged == 15
    assert found.alone.tolist() == [int(30 <= k < 45) for k in range(60)]


def test_partners_beyond_the_distance_at_which_they_meet_are_both_alone() -> None:
    _, found = diverged(tracks(), tracks(60, moved(0, 10, 12, 1.5)))
    assert found.first is not None
    assert found.first[1].distance == pytest.approx(1.5)
    assert [kind.rows for kind in found.kinds] == [0, 3, 3, 0]


def test_an_exchange_of_identities_is_a_parting_though_places_are_the_same() -> None:
    pairs, found = diverged(tracks(), tracks(60, exchanged_at(25)))
    assert found.first is not None
    kind, start = found.first
    assert kind == OTHER
    assert (start.t_ns, start.a, start.b) == (25 * STEP, 10, 11)
    assert start.distance == 0.0
    assert found.diverged == 0
    # 35 frames with the other one, 25 with the own one: most frames decide who is whom
    assert pairs.people == (PersonPair((10,), (11,)), PersonPair((11,), (10,)), PersonPair((12,), (12,)))


def test_parts_of_a_broken_track_are_one_person() -> None:
    def broken(frame: np.ndarray, label: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        label[(frame >= 40) & (label == 12)] = 30

    pairs, found = diverged(tracks(60, broken), tracks())
    assert pairs.people[-1] == PersonPair((12, 30), (12,))
    assert found.first is not None
    assert (found.first[0], found.first[1].t_ns) == (OTHER, 40 * STEP)


def test_the_longest_stretches_come_first() -> None:
    def twice(*columns: np.ndarray) -> None:
        for change in (moved(0, 5, 6, 0.7), moved(1, 50, 55, 0.8), moved(2, 20, 22, 0.9)):
            change(*columns)

    change: Change = twice
    _, found = diverged(tracks(), tracks(60, change))
    assert [(s.start_ns // STEP, s.end_ns // STEP) for s in found.segments] == [(50, 55), (20, 22), (5, 6)]
    assert [s.worst.distance for s in found.segments] == pytest.approx([0.8, 0.9, 0.7])
    assert found.farthest is not None
    assert found.farthest.t_ns == 20 * STEP
