"""Mistakes with one camera, which the boxes of people that other cameras track give away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.scene import Camera
from occlog.track.methods.jipda.interface import BoxAssociations, FrameDetections, TrackSnapshot
from occlog.track.people.camera_faults import MAX_SAMPLES, CameraFaults, projected_people
from occlog.track.people.frame_detections import FrameDetectionsWithIds

SIZE = (1280, 720)
NAMES = ("a", "b", "c", "d")
CORNERS = {"a": (0.0, 0.0, 45.0), "b": (8.0, 0.0, 135.0), "c": (8.0, 6.0, 215.0), "d": (0.0, 6.0, -35.0)}


def cameras() -> list[Camera]:
    """Four cameras in the corners of a room of 8 x 6 m, which look down by 20 degrees."""
    return [
        Camera(
            name=name,
            position=np.array([*CORNERS[name][:2], 2.5]),
            rotation=rotation_from_angles(np.radians(CORNERS[name][2]), np.radians(-20.0), 0.0),
            focal_px=np.array([800.0, 800.0]),
            principal_px=np.array([640.0, 360.0]),
            image_size=SIZE,
        )
        for name in NAMES
    ]


def people(seed: int, steps: int = 60) -> np.ndarray:
    """(T, 3, 6) states of three people who are somewhere in the middle of the room."""
    rng = np.random.default_rng(seed)
    states = np.zeros((steps, 3, 6))
    states[..., :2] = rng.uniform([2.5, 2.0], [5.5, 4.0], (steps, 3, 2))
    states[..., 4], states[..., 5] = 1.7, 0.5
    return states


def found(true: list[Camera], stated: list[Camera], seed: int = 0, steps: int = 60) -> CameraFaults:
    """Samples of people whom all cameras detect, with the boxes of the true cameras."""
    faults, none = CameraFaults(stated), np.zeros(0, dtype=np.int64)
    for state in people(seed, steps):
        frames = []
        for c, each in enumerate(true):
            boxes = projected_people(each, state[:, [0, 1, 4, 5]])
            boxes = boxes[np.isfinite(boxes).all(axis=1)]
            n = len(boxes)
            detections = FrameDetections(
                0, c, boxes, np.ones(n), np.full(n, -1), np.zeros((n, 0)), np.arange(n, dtype=np.int64)
            )
            frames.append(FrameDetectionsWithIds(detections, 0, np.arange(n)))
        snapshot = TrackSnapshot(
            t_ns=0,
            ids=np.arange(3),
            mean=state,
            covariance=np.zeros((3, 6, 6)),
            existence=np.ones(3),
            visibility=np.ones((3, len(true))),
            support=BoxAssociations(none, none, none, np.zeros(0), np.zeros(0)),
            events=(),
        )
        faults.add(snapshot, np.ones((3, len(true)), dtype=np.bool_), frames)
    return faults


def changed(camera: str, **values: object) -> list[Camera]:
    return [replace(each, **values) if each.name == camera else each for each in cameras()]


def test_nothing_is_said_of_cameras_that_are_right() -> None:
    faults = found(cameras(), cameras())
    assert [faults.fitting(c) for c in range(4)] == [None] * 4


@pytest.mark.parametrize("name", NAMES)
def test_inverted_extrinsics_are_named(name: str) -> None:
    own = next(each for each in cameras() if each.name == name)
    # What is stated is read as its own inverse
    stated = changed(name, rotation=own.rotation.T, position=-own.rotation.T @ own.position)
    faults = found(cameras(), stated)
    best = faults.fitting(NAMES.index(name))
    assert best is not None
    assert best.words.startswith("its extrinsics are inverted")
    assert best.fit == 1.0
    assert [faults.fitting(c) for c in range(4) if NAMES[c] != name] == [None] * 3


def test_exchanged_files_are_named_for_both_cameras() -> None:
    right = cameras()
    faults = found([right[1], right[0], right[2], right[3]], right)
    said = [faults.fitting(c) for c in range(4)]
    assert [None if each is None else each.words for each in said] == [
        "they are boxes of camera b",
        "they are boxes of camera a",
        None,
        None,
    ]


@pytest.mark.parametrize(("factor", "words"), [(2.0, "they are scaled by 0.5"), (2.0 / 3.0, "they are scaled by 1.5")])
def test_boxes_of_images_of_another_size_are_named_with_the_factor(factor: float, words: str) -> None:
    right = cameras()[2]
    other = changed("c", focal_px=factor * right.focal_px, principal_px=factor * right.principal_px)
    best = found(other, cameras()).fitting(2)
    assert best is not None
    assert best.words == words


def test_memory_does_not_grow_with_the_recording() -> None:
    faults = found(cameras(), cameras(), steps=5 * MAX_SAMPLES)
    assert MAX_SAMPLES // 2 <= len(faults._samples) <= MAX_SAMPLES
