"""Offline part of method `sort`: tracks that are cut, linked and smoothed."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.track.methods.sort.config import SortConfig
from occlog.track.methods.sort.linking import TrackBoxes, cut, linked, smoothed_track

pytestmark = pytest.mark.jit
TIMES = np.arange(200) / 10.0
AREA = 1000.0 * 600.0
NOTHING = np.zeros((2, 3))
KNOWN = np.array([[1000.0, 950.0, 903.0], [1000.0, 600.0, 365.0]])
"""Likeness of .95 with a deviation of .02 to the same person, of .6 with .07 to others; 1000 boxes of each."""


def track(frames: range, speed: float, start: float, row: int, colour: int | None = None) -> TrackBoxes:
    frame = np.array(frames)
    x = start + speed * TIMES[frame]
    boxes = np.column_stack([x - 30, np.full(len(x), 250.0), x + 30, np.full(len(x), 400.0)])
    observation = np.zeros((len(x), 0))
    if colour is not None:
        observation = np.full((len(x), 4), 0.02 / 3)
        observation[:, colour] = 0.98
    return TrackBoxes(frame, boxes, observation, row + np.arange(len(x)))


def test_a_track_with_a_gap_is_one_person_and_is_interpolated() -> None:
    parts = [track(range(0, 30), 60.0, 100.0, 0), track(range(40, 70), 60.0, 100.0, 1000)]
    found, doubts = linked(parts, TIMES, SortConfig(), NOTHING, AREA)
    assert len(found) == 1
    assert not doubts
    smooth = smoothed_track(found[0], TIMES, SortConfig())
    assert smooth.frame.tolist() == list(range(70))
    assert not smooth.detected[30:40].any()
    assert smooth.shown[30:40].all()
    middle = 0.5 * (smooth.boxes[:, 0] + smooth.boxes[:, 2])
    np.testing.assert_allclose(middle, 100.0 + 60.0 * TIMES[:70], atol=1.0)


def test_people_far_apart_are_not_linked() -> None:
    parts = [track(range(0, 30), 0.0, 100.0, 0), track(range(40, 70), 0.0, 800.0, 1000)]
    assert len(linked(parts, TIMES, SortConfig(), NOTHING, AREA)[0]) == 2


def test_colours_undo_an_exchange_at_a_crossing() -> None:
    """Two people meet, stand, and go back; the filter has them exchanged after the meeting."""

    def there_and_back(first: bool, colours: tuple[int, int], row: int) -> TrackBoxes:
        side = -1.0 if first else 1.0
        frame = np.arange(60)
        away = np.concatenate([np.linspace(200, 0, 30), np.linspace(0, 200, 30)])
        x = 500.0 + side * away
        boxes = np.column_stack([x - 30, np.full(60, 250.0), x + 30, np.full(60, 400.0)])
        observation = np.full((60, 4), 0.02 / 3)
        observation[:30, colours[0]] = 0.98
        observation[30:, colours[1]] = 0.98
        return TrackBoxes(frame, boxes, observation, row + frame)

    exchanged = [there_and_back(True, (0, 1), 0), there_and_back(False, (1, 0), 1000)]
    assert len(cut(exchanged, TIMES)) == 4
    found, doubts = linked(exchanged, TIMES, SortConfig(), KNOWN, AREA)
    assert len(found) == 2
    for each in found:
        assert len(set(each.appearance.argmax(axis=1).tolist())) == 1
    assert all(each.probability < 0.5 for each in doubts)
    assert len(linked(exchanged, TIMES, SortConfig(), NOTHING, AREA)[0]) == 2


def test_a_link_that_may_be_of_another_person_is_reported() -> None:
    """Two people stand close together, are not detected for two seconds, and stand there again."""
    before = [track(range(0, 30), 0.0, 300.0, 0), track(range(0, 30), 0.0, 345.0, 1000)]
    after = [track(range(50, 80), 0.0, 300.0, 2000), track(range(50, 80), 0.0, 345.0, 3000)]
    found, doubts = linked([*before, *after], TIMES, SortConfig(), NOTHING, AREA)
    assert len(found) == 2
    pairs = [each for each in doubts if each.other >= 0]
    far = [track(range(40, 70), 0.0, 300.0, 2000), track(range(40, 70), 0.0, 700.0, 3000)]
    apart = [before[0], track(range(0, 30), 0.0, 700.0, 1000), *far]
    assert not [each for each in linked(apart, TIMES, SortConfig(), NOTHING, AREA)[1] if each.other >= 0]
    assert pairs
    assert all(0.2 <= each.probability <= 0.5 for each in pairs)


def test_short_tracks_are_left_out() -> None:
    assert not linked([track(range(0, 2), 0.0, 100.0, 0)], TIMES, SortConfig(), NOTHING, AREA)[0]
    assert linked([], TIMES, SortConfig(), NOTHING, AREA) == ([], [])
