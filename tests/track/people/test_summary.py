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
