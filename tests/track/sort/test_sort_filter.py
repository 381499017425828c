"""Method `sort` in scenes that can be worked by hand: crossings, false boxes, occlusion, exits."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.track.methods.jipda.interface import FrameDetections
from occlog.track.methods.sort.config import SortConfig
from occlog.track.methods.sort.encounters import exchanges
from occlog.track.methods.sort.filter import FrameTracks, SortFilter
from occlog.track.methods.sort.learned import ImageDetectorStatistics

SIZE = (1000, 600)
FPS = 10.0


def person(x: float, feet: float, height: float = 150.0) -> list[float]:
    return [x - 0.2 * height, feet - height, x + 0.2 * height, feet]


def run(frames: list[list[list[float]]], score: float = 0.8, colours: list[list[Floats]] | None = None,
        config: SortConfig | None = None) -> list[FrameTracks]:  # fmt: skip
    tracker = SortFilter(config or SortConfig(), SIZE)
    out = []
    for k, boxes in enumerate(frames):
        n = len(boxes)
        observation = np.zeros((n, 0)) if colours is None else np.array(colours[k]).reshape(n, -1)
        found = FrameDetections(
            round(k / FPS * 1e9),
            0,
            np.array(boxes).reshape(-1, 4),
            np.full(n, score),
            np.full(n, -1),
            observation,
            np.arange(n),
        )
        out.append(tracker.step(found, k))
    return out


def near(track: FrameTracks, x: float) -> int:
    """Identity of the track nearest to a column."""
    middle = 0.5 * (track.boxes[:, 0] + track.boxes[:, 2])
    return int(track.id[np.argmin(np.abs(middle - x))])


def test_one_person_is_one_track_from_the_second_or_third_frame() -> None:
    found = run([[person(100 + 10 * k, 400)] for k in range(30)])
    assert [list(each.id) for each in found[3:]] == [[0]] * 27
    assert not len(found[0].id)
    np.testing.assert_allclose(found[-1].boxes[0], person(390, 400), atol=3.0)


def test_who_crosses_behind_somebody_keeps_the_identity() -> None:
    """Two people pass each other; the farther one has no box while the nearer covers more than half."""
    frames, ends = [], []
    for k in range(60):
        near_x, far_x = 200 + 8 * k, 680 - 8 * k
        boxes = [person(near_x, 450, 180)]
        if abs(near_x - far_x) > 45:
            boxes.append(person(far_x, 420, 150))
        frames.append(boxes)
        ends.append((near_x, far_x))
    found = run(frames)
    first = near(found[10], ends[10][0]), near(found[10], ends[10][1])
    last = near(found[-1], ends[-1][0]), near(found[-1], ends[-1][1])
    assert first == last
    assert len({i for each in found for i in each.id.tolist()}) == 2
    # The hidden person has rows, too, and they say that the frame has no box
    hidden = [each for each, (a, b) in zip(found, ends, strict=True) if abs(a - b) <= 45]
    assert all(len(each.id) == 2 and each.detected.sum() == 1 for each in hidden)
    assert min(each.visibility.min() for each in hidden) < 0.3


@pytest.mark.parametrize("seed", range(3))
def test_false_boxes_make_no_tracks(seed: int) -> None:
    """Boxes anywhere in the image, three a frame, of enough confidence to begin tracks: 300 of them."""
    rng = np.random.default_rng(seed)
    frames = [
        [person(rng.uniform(50, 950), rng.uniform(150, 590), rng.uniform(80, 200)) for _ in range(3)]
        for _ in range(100)
    ]
    found = run(frames, score=0.5)
    assert len({i for each in found for i in each.id.tolist()}) <= 1


def test_boxes_of_low_confidence_continue_tracks_and_begin_none() -> None:
    scores = [0.8] * 10 + [0.3] * 10
    tracker, seen = SortFilter(SortConfig(), SIZE), []
    for k, score in enumerate(scores):
        boxes = [person(100 + 5 * k, 400)] + ([person(700, 400)] if score < 0.4 else [])
        n = len(boxes)
        found = FrameDetections(
            round(k / FPS * 1e9), 0, np.array(boxes), np.full(n, score), np.full(n, -1), np.zeros((n, 0)), np.arange(n)
        )
        seen.append(tracker.step(found, k))
    assert [each.id.tolist() for each in seen[5:]] == [[0]] * 15
    assert all(each.detected.all() for each in seen[10:])


def test_who_leaves_the_image_is_not_there_any_more() -> None:
    found = run([[person(900 + 15 * k, 400)] if 900 + 15 * k < 1000 else [] for k in range(30)])
    assert len(found[4].id) == 1
    assert not len(found[-1].id)
    assert [e.kind for each in found for e in each.events] == ["initiated", "terminated"]


def test_a_gap_in_plain_view_is_bridged_and_a_long_absence_ends_the_track() -> None:
    shown = [[person(300, 400)] if not 20 <= k < 24 else [] for k in range(40)] + [[] for _ in range(60)]
    found = run(shown)
    assert {i for each in found for i in each.id.tolist()} == {0}
    assert not len(found[-1].id)


def test_an_exchange_is_reported_where_both_assignments_are_alike() -> None:
    ids, pair = np.array([4, 7]), (np.array([0, 1]), np.array([0, 1]))
    similar = np.array([[3.0, 3.0], [3.0, 3.0]])
    assert exchanges(ids, similar, *pair) == [(4, 7, pytest.approx(0.5))]
    assert exchanges(ids, np.array([[9.0, 1.0], [1.0, 9.0]]), *pair) == []
    # One box for two people
    assert exchanges(ids, np.array([[3.0], [2.0]]), np.array([0]), np.array([0])) == [
        (4, 7, pytest.approx(1.0 / (1.0 + np.sqrt(np.e))))
    ]


def test_rates_of_detection_are_learned_by_visible_share() -> None:
    learned = ImageDetectorStatistics(0.9)
    before = learned.detection(np.array([1.0, 0.05]))
    learned.add_detections(np.full(200, 0.95), np.arange(200) < 100)
    after = learned.detection(np.array([1.0, 0.05]))
    assert after[0] == pytest.approx((9.0 + 100) / 210)
    assert after[1] == before[1]
