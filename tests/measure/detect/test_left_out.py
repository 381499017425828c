"""Numbers of frames that no one looked at."""

from __future__ import annotations

import pytest

from occlog.measure.detect import skipped_frames as left_out
from occlog.measure.detect.skipped_frames import SkippedFrames
from occlog.records.frames import Frame, gaps_of, inside
from occlog.records.losses import Loss


def report_of(numbers: list[int], *losses: Loss) -> dict[str, list[tuple[int, int]]]:
    """What is stated of a camera whose frames have these numbers."""
    collected = SkippedFrames()
    for _ in collected.watch(Frame(10 * n, "a", n, lambda: None) for n in numbers):  # type: ignore[arg-type, return-value]
        pass
    collected.lost(losses)
    return gaps_of(collected.parameters())


@pytest.mark.parametrize(
    ("numbers", "wanted"),
    [
        ([0, 1, 2, 3], []),
        ([7], []),
        ([0, 1, 4, 5, 7], [(2, 3), (6, 6)]),
        ([5, 6, 3, 4], []),  # numbers that go back begin again
        ([0, 5, 10, 15], []),  # in steps
        ([0, 5, 20, 25], [(6, 19)]),
        ([0, 5, 10, 11], [(1, 4), (6, 9)]),  # no steps after all
        ([3, 5, 7, 11], [(8, 10)]),
    ],
)
def test_numbers_between_are_left_out_unless_they_are_steps(numbers: list[int], wanted: list[tuple[int, int]]) -> None:
    assert report_of(numbers).get("a", []) == wanted


def test_frames_that_could_not_be_used_are_left_out_too() -> None:
    lost = [Loss("a", "frame 4", "cut", 1), Loss("a", "frames 8 to 10", "cut", 2), Loss("b", "frame 1", "cut", 1)]
    assert report_of([2, 4, 6, 8, 10], *lost) == {"a": [(4, 4), (8, 10)]}
    assert [n for n in range(12) if inside([(4, 4), (8, 10)], n)] == [4, 8, 9, 10]


def test_long_logs_in_steps_have_short_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(left_out, "MAX_SEGMENTS", 20)
    assert report_of(list(range(0, 1000, 4))) == {}
    assert report_of([*range(0, 400, 4), *range(800, 1200, 4)]) == {"a": [(397, 799)]}
    scattered = [n for n in range(200) if n % 3]
    assert report_of(scattered) == {}  # too many to be gaps of a recording
