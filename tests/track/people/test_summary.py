"""The summary of the tracks of all people: frame numbers, and possible identity switches."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from occlog.records.declared.people import Events
from occlog.track.people.frame_detections import FrameNumbers
from occlog.track.people.run import MIN_PAIRS, PeopleSummary


@pytest.mark.parametrize(
    ("pairs", "left_out", "reported"),
    [(MIN_PAIRS, MIN_PAIRS, 1), (MIN_PAIRS, MIN_PAIRS - 1, 0), (MIN_PAIRS - 1, MIN_PAIRS - 1, 0)],
)
def test_numbers_that_are_hardly_ever_successive_are_stated(pairs: int, left_out: int, reported: int) -> None:
    inputs = SimpleNamespace(numbers={"a": FrameNumbers(1, pairs, left_out)})
    found = list(PeopleSummary(inputs, SimpleNamespace(person_height=1.7))._numbers())
    assert [f.id for f in found] == ["frame-numbers-sparse"] * reported


@pytest.mark.parametrize(("each", "severity"), [(0.19, []), (0.59, ["note"]), (0.61, ["warning"])])
def test_possible_switches_are_a_warning_from_where_identities_are_lost(each: float, severity: list[str]) -> None:
    summary = PeopleSummary(SimpleNamespace(), SimpleNamespace(person_height=1.7))
    summary.rows, summary.times, summary.exchanges = 400, 100, 4.0 * each
    found = [f for f in summary.identities() if f.id == "identity-switches-likely"]
    assert [f.severity for f in found] == severity


def test_a_possible_switch_of_two_tracks_has_two_rows_and_counts_once() -> None:
    rows = [(1, "possible_switch", 3, 4, 0.6), (1, "possible_switch", 4, 3, 0.6), (2, "possible_switch", 3, -1, 0.5)]
    events = Events.of_rows([(0, "initiated", 3, -1, 0.9), (0, "initiated", 4, -1, 0.9), *rows])
    summary = PeopleSummary(SimpleNamespace(), SimpleNamespace(person_height=1.7))
    summary.count_events(events)
    assert dict(summary.events) == events.counts() == {"initiated": 2, "possible_switch": 2}
    assert summary.exchanges == pytest.approx(0.6 + 0.5)
