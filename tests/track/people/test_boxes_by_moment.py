"""Boxes of all cameras as looks, and looks as times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people_boxes import SIZE, STEP_NS, boxes, camera, hall, table

from occlog.errors import InputError
from occlog.records.tables import Boxes
from occlog.track.people.frame_detections import (
    BoxStatistics,
    FrameDetectionsWithIds,
    RegionFrameTimes,
    duplicate_boxes,
    frame_detections,
    frames_without_boxes,
    group_time_steps,
    in_order,
    rows_of_boxes,
)

CAMERAS = hall("ab").cameras
MS = 1_000_000


def observations(*chunks: Boxes, tally: BoxStatistics | None = None) -> list[FrameDetectionsWithIds]:
    return list(frame_detections(rows_of_boxes(chunks), CAMERAS, ["a", "b", "c"], tally or BoxStatistics.of(2)))


def some(*rows: tuple[str, int, int, float, float, float, float]) -> Boxes:
    """Rows of camera, frame (10 a second), box, left, top, width, height."""
    nothing = (np.nan,) * 4
    values = [(f * STEP_NS, f, n, 7, *(place if n >= 0 else nothing), 0.9) for _, f, n, *place in rows]
    return table([row[0] for row in rows], np.array(values))


def test_every_frame_is_a_look_also_one_without_boxes() -> None:
    found = observations(some(("a", 0, 0, 10, 10, 20, 60), ("a", 0, 1, 90, 10, 20, 60), ("b", 0, -1, 0, 0, 0, 0)))
    assert [(each.detections.t_ns, each.detections.camera, each.frame, each.box.tolist()) for each in found] == [
        (0, 0, 0, [0, 1]),
        (0, 1, 0, []),
    ]
    assert found[0].detections.boxes.tolist() == [[10, 10, 30, 70], [90, 10, 110, 70]]
    assert found[0].detections.tracklet_id.tolist() == [7, 7]
    assert found[0].detections.row.tolist() == [0, 1]


def test_where_chunks_are_cut_does_not_matter() -> None:
    whole = boxes(hall("ab"), 1.0)
    once = observations(whole)
    for cut in (1, 2, 5, 8):
        parts = observations(*(whole.take(slice(k, k + cut)) for k in range(0, len(whole), cut)))
        assert len(parts) == len(once)
        for one, other in zip(once, parts, strict=True):
            assert (one.detections.t_ns, one.detections.camera, one.frame) == (
                other.detections.t_ns,
                other.detections.camera,
                other.frame,
            )
            np.testing.assert_array_equal(one.detections.boxes, other.detections.boxes)
            np.testing.assert_array_equal(one.detections.row, other.detections.row)


def test_a_box_outside_the_image_is_left_out_and_one_at_its_border_is_not() -> None:
    tally = BoxStatistics.of(2)
    w, h = SIZE
    beyond = [(w - 0.5, 10), (-20.5, 10), (10, h - 0.5), (10, -60.5)]
    at = [(w - 0.6, 10), (-20.4, 10), (10, h - 0.6), (10, -60.4)]
    rows = [("a", 0, n, x, y, 20, 60) for n, (x, y) in enumerate([*beyond, *at])]
    (found,) = observations(some(*rows), tally=tally)
    assert found.box.tolist() == [4, 5, 6, 7]
    assert (tally.outside.tolist(), tally.boxes.tolist()) == ([4, 0], [4, 0])


def test_no_border_is_known_of_an_image_without_a_size() -> None:
    cameras = (camera("a", image_size=None),)
    (found,) = frame_detections(
        rows_of_boxes([some(("a", 0, 0, 9000, 10, 20, 60))]), cameras, ["a"], BoxStatistics.of(1)
    )
    assert len(found.box) == 1


def test_boxes_that_repeat_another_are_left_out() -> None:
    edges = np.array([[0.0, 0, 100, 100], [0, 0, 100, 91], [0, 0, 100, 89], [500, 0, 600, 100]])
    assert duplicate_boxes(edges, np.full(4, 0.9)).tolist() == [False, True, False, False]
    assert duplicate_boxes(edges, np.array([0.5, 0.9, 0.1, 0.1])).tolist() == [True, False, True, False]
    tally = BoxStatistics.of(2)
    (found,) = observations(some(("a", 0, 0, 10, 10, 20, 60), ("a", 0, 1, 10, 10, 20, 60)), tally=tally)
    assert (found.box.tolist(), tally.twice.tolist()) == ([0], [1, 0])


def test_rows_of_other_cameras_are_passed_over_and_unknown_ones_refused() -> None:
    assert observations(some(("c", 0, 0, 10, 10, 20, 60))) == []
    with pytest.raises(InputError, match="no camera 'z' in the scene"):
        observations(some(("z", 0, 0, 10, 10, 20, 60)))


def test_times_that_go_back_are_refused() -> None:
    late, early = some(("a", 1, 0, 10, 10, 20, 60)), some(("a", 0, 0, 10, 10, 20, 60))
    with pytest.raises(InputError, match="times go back"):
        observations(late, early)


def test_frames_that_a_table_leaves_out_are_looks_at_no_one() -> None:
    times = RegionFrameTimes.of(
        t_ns=MS * np.array([0, 0, 40, 300, 400]),
        sensor=["a", "b", "b", "a", "b"],
        frame=np.array([3, 0, 1, 6, 10]),
    )
    found = list(frames_without_boxes([times.take(slice(0, 2)), times.take(slice(2, None))], {"a": 0, "b": 1}))
    assert [(e.detections.t_ns / MS, e.detections.camera, e.frame) for e in found] == [
        (80, 1, 2),
        (100, 0, 4),
        (120, 1, 3),
        (160, 1, 4),
        (200, 0, 5),
        (200, 1, 5),
        (240, 1, 6),
        (280, 1, 7),
        (320, 1, 8),
        (360, 1, 9),
    ]
    assert all(not len(e.detections.boxes) for e in found)
    assert list(frames_without_boxes([times], {"c": 0})) == []


@pytest.mark.parametrize(("frames", "empty"), [(14, [15, 20]), (5, [1, 2, 3, 4, 6, 7])])
def test_frames_that_are_numbered_in_steps_have_none_between(frames: int, empty: list[int]) -> None:
    number = np.delete(5 * np.arange(frames), slice(3, 5))
    times = RegionFrameTimes(t_ns=number * STEP_NS, sensor=np.full(len(number), "a"), frame=number)
    assert [e.frame for e in frames_without_boxes([times], {"a": 0})][: len(empty)] == empty
    assert frames < 14 or len(list(frames_without_boxes([times], {"a": 0}))) == 2


def test_numbers_that_cannot_be_those_of_frames_are_refused() -> None:
    times = RegionFrameTimes(t_ns=np.array([0, STEP_NS]), sensor=np.array(["a", "a"]), frame=np.array([0, 2_000_000]))
    with pytest.raises(InputError, match=r"camera a: frames 0 and 2000000 are 0\.1 s apart"):
        list(frames_without_boxes([times], {"a": 0}))


def look_at(t_ns: int, c: int) -> FrameDetectionsWithIds:
    (found,) = observations(some(("a", 0, -1, 0, 0, 0, 0)))
    return replace_time(found, t_ns, c)


def replace_time(found: FrameDetectionsWithIds, t_ns: int, c: int) -> FrameDetectionsWithIds:
    return found._replace(detections=found.detections._replace(t_ns=t_ns, camera=c))


@pytest.mark.parametrize(("window", "sizes"), [(0, [1, 1, 1, 1]), (9, [1, 1, 2]), (10, [2, 2])])
def test_looks_within_the_window_are_one_moment(window: int, sizes: list[int]) -> None:
    stream = [look_at(0, 0), look_at(10, 1), look_at(40, 0), look_at(45, 1)]
    assert [len(m) for m in group_time_steps(stream, window)] == sizes


def test_a_camera_looks_once_in_a_moment() -> None:
    stream = [look_at(0, 0), look_at(1, 0), look_at(2, 1)]
    assert [[e.detections.t_ns for e in m] for m in group_time_steps(stream, 100)] == [[0], [1, 2]]


def test_streams_are_put_in_the_order_of_time() -> None:
    found = in_order([look_at(0, 1), look_at(20, 1)], [look_at(0, 0), look_at(10, 0)])
    assert [(e.detections.t_ns, e.detections.camera) for e in found] == [(0, 0), (0, 1), (10, 0), (20, 1)]


def test_identities_are_hints() -> None:
    whole = boxes(hall("ab"), 0.2, miss=0.0)
    plain = replace(whole, target_id=np.full(len(whole), -1, dtype=np.int32))
    assert all((each.detections.tracklet_id == -1).all() for each in observations(plain))
    assert {h for each in observations(whole) for h in each.detections.tracklet_id.tolist()} == {0, 1, 2, 3}
