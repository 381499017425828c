"""How tall people are by their boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people_boxes import HEIGHT, boxes, camera, hall

from occlog.core.geometry.camera import angles_from_rotation
from occlog.records.scene import camera_rotation
from occlog.settings import LENGTH_POWER, declaration, declared
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.people.camera_checks.pair_overlap import person_heights
from occlog.track.people.frame_detections import BoxStatistics, FrameDetectionsWithIds, frame_detections, rows_of_boxes
from occlog.track.people.inputs import height_readings, in_units_of, inconsistent_cameras, median_height


def some(metre: float = 1.0) -> tuple[list[FrameDetectionsWithIds], tuple]:
    scene = hall("abc", metre, "unit")
    found = boxes(scene, 2.0, metre=metre, px=0.0)
    return list(frame_detections(rows_of_boxes([found]), scene.cameras, "abc", BoxStatistics.of(3))), scene.cameras


def heights(frames: list[FrameDetectionsWithIds], cameras: tuple) -> np.ndarray:
    own = [[each.detections.boxes for each in frames if each.detections.camera == c] for c in range(len(cameras))]
    return person_heights([np.concatenate([np.zeros((0, 4)), *each]) for each in own], cameras)


@pytest.mark.parametrize("metre", [1.0, 100.0])
def test_people_are_as_tall_as_they_are(metre: float) -> None:
    frames, cameras = some(metre)
    np.testing.assert_allclose(heights(frames, cameras), metre * HEIGHT, rtol=0.05)


def test_few_boxes_tell_nothing() -> None:
    frames, cameras = some()
    assert np.isnan(heights(frames[:2], cameras)).all()
    assert np.isnan(median_height(np.full(3, np.nan)))


def test_a_camera_that_is_not_where_the_scene_says_makes_other_people() -> None:
    frames, cameras = some()
    moved = (camera("a", position=np.array([0.0, 0.0, 6.0])), *cameras[1:])
    odd = inconsistent_cameras(heights(frames, moved))
    assert list(odd) == [0]
    assert odd[0] > 1.6 * HEIGHT
    assert inconsistent_cameras(heights(frames, cameras)) == {}


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("columns", "boxes have y, x in place of x, y"),
        ("heads", "boxes are of heads (give boxes of whole bodies)"),
        ("pitch", "pitch_deg is in radians"),
        ("sense", "pitch is positive downwards"),
    ],
)
def test_readings_with_which_people_have_their_height_are_named(how: str, words: str) -> None:
    frames, cameras = some()
    own = [[each.detections.boxes for each in frames if each.detections.camera == c] for c in range(len(cameras))]
    boxes = [np.concatenate(each) for each in own]
    if how == "columns":
        boxes = [each[:, [1, 0, 3, 2]] for each in boxes]
    elif how == "heads":
        boxes = [np.column_stack([each[:, :3], each[:, 1] + (each[:, 3] - each[:, 1]) / 7.0]) for each in boxes]
    else:
        turned = []
        for each in cameras:
            yaw, pitch, roll = angles_from_rotation(each.rotation)
            read = np.radians(pitch) if how == "pitch" else -pitch
            turned.append(replace(each, rotation=camera_rotation(yaw, float(read), roll)))
        cameras = tuple(turned)
    found = dict(height_readings(boxes, cameras))
    assert abs(found[words] / HEIGHT - 1.0) < 0.1


def test_lengths_are_put_in_units_of_the_scene() -> None:
    metres, own = JipdaConfig(), in_units_of(JipdaConfig(), 100.0)
    assert own.person_height == 100.0 * metres.person_height
    assert own.process_noise_density == pytest.approx(1e4 * metres.process_noise_density)
    for f in declared(JipdaConfig):
        if declaration(f).unit not in LENGTH_POWER:
            assert getattr(own, f.name) == getattr(metres, f.name)
