"""Whether calibrated cameras agree, by people whom one places in the image of another: on scenes worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.calibrate.adjustment import Clocks
from occlog.calibrate.common_views import detected_by_others
from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.scene import Camera
from occlog.track.methods.jipda.interface import FrameDetections
from occlog.track.people.camera_checks.pair_overlap import projected_people
from occlog.track.people.frame_detections import FrameDetectionsWithIds

STEPS = 60
LATE = 0.4


def camera(name: str, x: float, y: float, yaw_deg: float) -> Camera:
    turn = rotation_from_angles(np.radians(yaw_deg), np.radians(-15.0), 0.0)
    return Camera(
        name, np.array([x, y, 3.0]), turn, np.array([400.0, 400.0]), np.array([400.0, 300.0]), image_size=(800, 600)
    )


def frames_of(cameras: list[Camera], late: tuple[float, ...], missed: int = 0) -> list[FrameDetectionsWithIds]:
    """A person who walks through both views; of every `missed`-th frame of the second camera the box is left out."""
    out = []
    for k in range(STEPS):
        person = np.array([[4.0 + 0.05 * k, 0.02 * k - 0.5, 1.75, 0.6]])
        for c, each in enumerate(cameras):
            boxes = projected_people(each, person)
            if c == 1 and missed and k % missed == 0:
                boxes = boxes[:0]
            n = len(boxes)
            none = np.full(n, np.nan), np.full(n, -1), np.zeros((n, 0)), np.arange(n)
            stamp = round((0.2 * k + late[c]) * NS)
            out.append(FrameDetectionsWithIds(FrameDetections(stamp, c, boxes, *none), k, np.arange(n)))
    return sorted(out, key=lambda each: each.detections.t_ns)


CAMERAS = [camera("a", 0.0, 0.0, 0.0), camera("b", 5.5, -6.0, 90.0)]


@pytest.mark.parametrize(
    ("late", "missed", "share"), [((0.0, 0.0), 0, 1.0), ((0.0, LATE), 0, 1.0), ((0.0, 0.0), 2, 0.5)]
)
def test_people_in_common_views_are_counted_with_the_frames_that_miss_them(
    late: tuple[float, float], missed: int, share: float
) -> None:
    clocks = Clocks(np.array(late), np.zeros(2), 0.0)
    expected, met = detected_by_others(CAMERAS, clocks, frames_of(CAMERAS, late, missed), 1.75)
    assert expected[0, 1] == STEPS
    assert met[0, 1] / expected[0, 1] == pytest.approx(share, abs=0.02)
    assert (met[1, 0], expected[0, 0]) == (expected[1, 0], 0.0)


def test_a_camera_with_a_wrong_pose_does_not_confirm_the_other() -> None:
    frames = frames_of(CAMERAS, (0.0, 0.0))
    wrong = [CAMERAS[0], camera("b", 3.0, -5.0, 70.0)]
    expected, met = detected_by_others(wrong, Clocks(np.zeros(2), np.zeros(2), 0.0), frames, 1.75)
    assert expected[0, 1] > 10
    assert met.sum() < 0.1 * expected.sum()
