"""Boxes where a wide fisheye is not used: they are views without bearings, and their frames are observed."""

from __future__ import annotations

import numpy as np

from occlog.measure.detect.from_boxes import detect_boxes
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.records.tables import Boxes


def test_boxes_beyond_80_degrees_give_no_bearings() -> None:
    focal, size = 420.0, (1280, 720)
    camera = Camera(
        "a", np.array([0.0, 0.0, 2.0]), camera_rotation(0.0, 0.0, 0.0), np.full(2, focal), np.array([639.5, 359.5]),
        size, distortion_model="equidistant",
    )  # fmt: skip
    angles = np.radians([30.0, 85.0, 85.0])
    middle = 639.5 + focal * angles
    boxes = Boxes.of(
        t_ns=np.array([0, 0, 10**8]), sensor=["a"] * 3, frame=np.array([0, 0, 1]), box=np.array([0, 1, 0]),
        target_id=np.full(3, -1), left_px=middle - 5, top_px=np.full(3, 350.0), width_px=np.full(3, 10.0),
        height_px=np.full(3, 20.0), confidence=np.full(3, 0.9),
    )  # fmt: skip
    (found,) = detect_boxes([boxes], Scene(cameras=(camera,)))
    assert np.isfinite(found.views.bearing).tolist() == [True, False, False]
    seen = found.bearings.take(found.bearings.seen)
    assert len(seen) == 1
    np.testing.assert_allclose(np.abs(seen.bearing), np.radians(30.0), atol=0.01)
    assert found.bearings.take(~found.bearings.seen).t_ns.tolist() == [10**8]
