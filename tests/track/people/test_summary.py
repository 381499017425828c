"""What the summary of everybody's tracks says of the numbers of frames."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

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
