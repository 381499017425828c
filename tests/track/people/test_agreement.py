"""Whether cameras see whom the others see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people_boxes import camera

from occlog.records.verdicts import findings
from occlog.track.methods.jipda.interface import BoxAssociations, FrameDetections, TrackSnapshot
from occlog.track.people.camera_checks.agreement import MIN_EXPECTED_DETECTIONS, CameraAgreement, distance_outside
from occlog.track.people.frame_detections import BoxStatistics, FrameDetectionsWithIds


def moment(by: list[list[bool]], visible: float = 1.0) -> TrackSnapshot:
    """People whom these cameras see."""
    seen = np.array(by)
    person, camera = np.nonzero(seen)
    n = len(person)
    return TrackSnapshot(
        t_ns=0,
        ids=np.arange(len(seen)),
        mean=np.zeros((len(seen), 6)),
        covariance=np.zeros((len(seen), 6, 6)),
        existence=np.ones(len(seen)),
        visibility=np.full(seen.shape, visible),
        support=BoxAssociations(person, camera, np.arange(n), np.ones(n), np.zeros(n)),
        events=(),
    )


def observations(cameras: int) -> list[FrameDetectionsWithIds]:
    none = np.zeros(0, dtype=np.int64)
    return [
        FrameDetectionsWithIds(
            FrameDetections(0, c, np.zeros((0, 4)), np.zeros(0), none, np.zeros((0, 0)), none), 0, none
        )
        for c in range(cameras)
    ]


def codes(by: list[bool], times: int, visible: float = 1.0) -> list[str]:
    agreement = CameraAgreement([camera(name) for name in "abcd"[: len(by)]])
    for _ in range(times):
        agreement.add(moment([by], visible), observations(len(by)))
    tally = BoxStatistics.of(len(by))
    tally.boxes[:] = 1
    return [f"{found.id}: {found.text.split()[1]}" for found in findings(agreement.checks(tally))]


def test_a_box_of_two_people_who_touch_is_one_explained_box() -> None:
    agreement = CameraAgreement([camera(name) for name in "ab"])
    pair = np.array([0, 1])
    # Camera a: one box of both with 0.75, of the first alone with 0.25; camera b: a box of the second alone
    support = BoxAssociations(
        np.array([*pair, 1]), np.array([0, 0, 1]), np.zeros(3, int), np.array([1, 0.75, 1]), np.array([0.75, 0.75, 0])
    )
    agreement.add(moment([[True, False], [True, True]])._replace(support=support), observations(2))
    np.testing.assert_allclose(agreement.used, [1.0, 1.0])


def test_a_camera_that_does_not_see_whom_the_others_see_is_named() -> None:
    assert codes([True, True, True, False], MIN_EXPECTED_DETECTIONS) == ["camera-inconsistent: d"]
    assert codes([True, True, True, True], MIN_EXPECTED_DETECTIONS) == []


def test_of_few_people_and_of_those_who_are_not_plainly_visible_nothing_is_stated() -> None:
    assert codes([True, True, True, False], MIN_EXPECTED_DETECTIONS - 1) == []
    assert codes([True, True, True, False], MIN_EXPECTED_DETECTIONS, visible=0.79) == []
    assert codes([True, True, True, False], MIN_EXPECTED_DETECTIONS, visible=float("nan")) == []


def unexplained(boxes: int, used: int, height: float = 2.5) -> list[str]:
    """Findings on boxes that no track explains, of two cameras of which people explain some of the boxes."""
    cameras = [replace(camera(name), position=np.array([0.0, 0.0, height])) for name in "ab"]
    agreement, tally = CameraAgreement(cameras), BoxStatistics.of(2)
    agreement.used[0] = used
    tally.boxes[0], tally.boxes[1] = boxes - boxes // 2, boxes // 2
    return [found.id for found in findings(agreement.checks(tally))]


@pytest.mark.parametrize(
    ("boxes", "used", "reported"), [(1000, 500, False), (1000, 400, True), (20, 0, True), (19, 0, False)]
)
def test_boxes_that_no_one_explains_speak_against_the_tracks_from_a_half_on(
    boxes: int, used: int, reported: bool
) -> None:
    assert unexplained(boxes, used) == ["boxes-unassociated"] * reported


def test_boxes_without_suppression_are_named_before_those_of_no_track() -> None:
    agreement, tally = CameraAgreement([camera(name) for name in "ab"]), BoxStatistics.of(2)
    tally.boxes[:], tally.twice[:], agreement.static[0] = 500, 600, 3
    ids = [found.id for found in findings(agreement.checks(tally))]
    assert ids == ["boxes-duplicated", "boxes-duplicated", "boxes-unassociated", "static-clutter"]


def test_cameras_below_the_ground_are_named_where_no_one_explains_the_boxes() -> None:
    assert unexplained(100, 0, height=-0.1) == ["boxes-unassociated", "camera-below-ground"]
    assert unexplained(100, 0) == ["boxes-unassociated"]


def test_of_four_cameras_two_must_see_whom_another_one_should_see() -> None:
    assert codes([True, False, False, False], MIN_EXPECTED_DETECTIONS) == []
    assert codes([True, False, False], MIN_EXPECTED_DETECTIONS) == ["camera-inconsistent: b", "camera-inconsistent: c"]


@pytest.mark.parametrize(("seen", "reported"), [(0.25, False), (0.24, True)])
def test_of_two_cameras_each_must_see_a_quarter_of_whom_the_other_sees(seen: float, reported: bool) -> None:
    agreement = CameraAgreement([camera(name) for name in "ab"])
    for k in range(100):
        agreement.add(moment([[True, k < 100 * seen]]), observations(2))
    tally = BoxStatistics.of(2)
    tally.boxes[:] = 1
    assert [f.id for f in findings(agreement.checks(tally))] == (["camera-inconsistent"] if reported else [])


def test_cameras_that_look_at_other_times_are_named() -> None:
    tally = BoxStatistics.of(2)
    tally.boxes[:] = 1
    tally.first_ns[:], tally.last_ns[:] = (0, 10_000_000_000), (9_000_000_000, 20_000_000_000)
    found = list(findings(CameraAgreement([camera(name) for name in "ab"]).checks(tally)))
    assert [f.id for f in found] == ["camera-times-disjoint"] * 2
    assert found[1].figures == {"offset_s": 10.0}
    tally.first_ns[1] = 9_000_000_000
    assert list(findings(CameraAgreement([camera(name) for name in "ab"]).checks(tally))) == []


def with_boxes(frames: int, still: bool, used: int) -> list[str]:
    """Findings of two cameras of which people explain the boxes, and a third with boxes that move, or do not."""
    agreement, tally = CameraAgreement([camera(name) for name in "abc"]), BoxStatistics.of(3)
    for k in range(frames):
        left = 100.0 + (0.0 if still else 3.0 * k)
        each = observations(3)
        each[2] = each[2]._replace(
            detections=each[2].detections._replace(boxes=np.array([[left, 50.0, left + 40.0, 150.0]]))
        )
        agreement.add(moment([[True, True, False]], visible=0.0), each)
    tally.boxes[:] = frames
    agreement.used[2] = used
    return [f"{found.id}: {found.text.split()[1]}" for found in findings(agreement.checks(tally))]


def test_a_camera_with_moving_boxes_that_no_track_explains_is_named() -> None:
    assert with_boxes(200, still=False, used=0) == ["camera-unassociated: c:"]
    assert with_boxes(200, still=False, used=30) == []
    # A picture on the wall is static clutter, which has a message of its own
    assert with_boxes(200, still=True, used=0) == []


def test_a_camera_that_shares_no_person_with_others_is_noted() -> None:
    agreement = CameraAgreement([camera(name) for name in "abc"])
    for _ in range(100):
        agreement.add(moment([[True, True, False], [False, False, True]], visible=0.0), observations(3))
    reported = list(findings(agreement.checks(BoxStatistics.of(3))))
    assert [(found.id, found.sensors, found.severity) for found in reported] == [("camera-alone", ("c",), "note")]
    assert (agreement.confirmed.tolist(), agreement.alone.tolist()) == ([100, 100, 0], [0, 0, 100])


@pytest.mark.parametrize(
    ("yaw_deg", "limit_deg", "severity"),
    [(0.9, 0.3, "note"), (1.3, 1.1, "note"), (1.4, 1.1, "warning"), (1.05, 0.3, "warning"), (0.0, 0.3, None)],
)
def test_a_rotation_is_a_warning_if_usual_errors_do_not_make_it_significant(yaw_deg, limit_deg, severity) -> None:
    agreement = CameraAgreement([camera(name) for name in "ab"])
    agreement.angles = np.radians([[yaw_deg, 0.1 * yaw_deg], [0.0, 0.0]])
    agreement.angles_limit = np.radians([[limit_deg, 0.4], [np.inf, np.inf]])
    found = [
        (check.severity, *check.sensors)
        for check in agreement.checks(BoxStatistics.of(2))
        if check.id == "camera-rotated"
    ]
    assert found == ([(severity, "a")] if severity else [])


def test_people_outside_the_room_are_stated_with_the_cameras_that_see_them() -> None:
    room = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
    for x, expected in ((4.8, []), (5.0, [("people-outside-room", ("b",))])):
        agreement = CameraAgreement([camera(name) for name in "ab"], 1.7, room)
        for _ in range(100):
            at = moment([[True, True], [False, True]], visible=0.0)
            at.mean[:, :2] = [[2.0, 1.0], [x, 1.0]]
            agreement.add(at, observations(2))
        reported = list(findings(agreement.checks(BoxStatistics.of(2))))
        assert [(found.id, found.sensors) for found in reported] == expected


def test_the_distance_from_a_room_is_that_to_its_nearest_wall() -> None:
    room = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
    points = np.array([[1.0, 1.0], [5.0, 1.0], [7.0, 7.0], [2.0, -0.5]])
    np.testing.assert_allclose(distance_outside(points, room), [0.0, 1.0, 5.0, 0.5])
