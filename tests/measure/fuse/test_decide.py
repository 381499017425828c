"""The decision about one object: gate, hold, confirmation and lone lines at their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from occlog.measure.fuse.config import FuseConfig
from occlog.measure.fuse.kernels import LocalDirections, MotionEstimate
from occlog.measure.fuse.object_decision import CONFIRMATION_STEPS, Decision, ObjectMemory, agreeing, decide
from occlog.measure.fuse.views import PlacedCameras, placed_cameras
from occlog.records.scene import Camera, Scene, camera_rotation

STEP = 10**8
SIGMA = 0.01
PLACE = (4.0, 5.0)
CONFIG = FuseConfig.in_unit("m")
ALL = np.arange(4)
CORNERS = (("a", 0.0, 0.0, 45.0), ("b", 10.0, 0.0, 135.0), ("c", 10.0, 10.0, 225.0), ("d", 0.0, 10.0, 315.0))


def cameras() -> PlacedCameras:
    """Four cameras in the corners of a room of 10 m."""
    made = tuple(
        Camera(
            name,
            np.array([x, y, 2.0]),
            camera_rotation(np.radians(yaw), 0.0, 0.0),
            np.array([500.0, 500.0]),
            np.array([499.5, 299.5]),
            (1000, 600),
            fov=np.radians(90.0),
        )
        for name, x, y, yaw in CORNERS
    )
    room = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    return placed_cameras(Scene(cameras=made, room=room), CONFIG)


def sight(which: Sequence[int], xy: Sequence[float] = PLACE, off: float = 0.0) -> LocalDirections:
    """Detections by some cameras of a place, each turned by `off` [rad]; without distances."""
    ground = np.array([c[1:3] for c in CORNERS])[list(which)]
    away = np.asarray(xy) - ground.reshape(-1, 2)
    azimuth = np.arctan2(away[:, 1], away[:, 0]) + off
    nothing = np.full(len(azimuth), np.nan)
    return LocalDirections(
        np.array(which, dtype=np.int64), ground, azimuth, np.full(len(azimuth), SIGMA), nothing, nothing
    )


def confirmed(absent: int = 0, xy: Sequence[float] = PLACE, met: int = CONFIRMATION_STEPS) -> ObjectMemory:
    """An object at rest that cameras met in often enough for its prediction to count."""
    motion = MotionEstimate(0, np.array([*xy, 0.0, 0.0]), np.diag([0.01, 0.01, 0.01, 0.01]))
    return ObjectMemory(motion, absent, met)


def decision(memory: ObjectMemory, seen: LocalDirections, config: FuseConfig = CONFIG) -> Decision:
    return decide(memory, STEP, seen, ALL, cameras(), config)


def test_three_cameras_that_agree_recover_the_fourth() -> None:
    got = decision(ObjectMemory(), sight([0, 1, 2]))
    assert got.declared
    assert got.value > 0.0
    assert got.kept.tolist() == [True, True, True]
    assert got.missed.tolist() == [3]
    np.testing.assert_allclose(got.at.xy, PLACE, atol=1e-6)
    assert (got.memory.absent, got.memory.met) == (0, 1)


def test_without_detections_nothing_is_declared_and_no_place_is_reported() -> None:
    got = decision(confirmed(), sight([]))
    assert not got.declared
    assert got.value == -np.inf
    assert got.memory.absent == 1
    assert got.memory.motion is not None
    with pytest.raises(ValueError, match="states no position"):
        _ = got.at


def test_a_prediction_is_dropped_after_hold_moments_without_a_declaration() -> None:
    config = replace(CONFIG, max_coasting_steps=3)
    assert decision(confirmed(absent=1), sight([]), config).memory.motion is not None
    assert decision(confirmed(absent=2), sight([]), config).memory == ObjectMemory()


def test_a_prediction_counts_once_cameras_met_in_it_twice() -> None:
    """An unconfirmed object is forgotten at the first time without detections."""
    assert decision(confirmed(met=CONFIRMATION_STEPS - 1), sight([])).memory == ObjectMemory()
    assert decision(confirmed(met=CONFIRMATION_STEPS), sight([])).memory.motion is not None


def test_detections_beyond_reach_of_the_prediction_count_as_missed() -> None:
    """Cameras that agree on a place far from a confirmed prediction declare nothing."""
    far = (PLACE[0], PLACE[1] + 3.0)
    near = (PLACE[0], PLACE[1] + 0.5)
    assert not decision(confirmed(), sight([0, 1, 2, 3], far)).declared
    assert decision(confirmed(), sight([0, 1, 2, 3], near)).declared


def test_a_detection_beyond_the_gate_of_the_global_position_is_removed() -> None:
    turned = sight([0, 1, 2, 3])
    for off, stands in ((1.0 * SIGMA, True), (10.0 * SIGMA, False)):
        azimuth = turned.azimuth + np.array([0.0, 0.0, 0.0, off])
        got = decision(ObjectMemory(), turned._replace(azimuth=azimuth))
        assert got.declared
        assert got.kept.tolist() == [True, True, True, stands]
        assert got.missed.tolist() == ([] if stands else [3])


def test_a_lone_line_that_three_cameras_could_confirm_is_not_declared() -> None:
    got = decision(ObjectMemory(), sight([0]))
    assert not got.declared
    assert got.position is None
    assert got.kept.tolist() == [False]


def test_of_lines_that_do_not_meet_the_nearest_to_the_prediction_agrees() -> None:
    two = sight([0, 2])  # opposite corners: the lines are nearly parallel to each other
    azimuth = two.azimuth + np.array([0.02, 0.0])
    motion = confirmed().motion
    narrow = replace(CONFIG, min_triangulation_angle_deg=45.0)
    assert agreeing(two._replace(azimuth=azimuth), np.arange(2), motion, cameras(), narrow).tolist() == [1]
    assert agreeing(two, np.arange(2), None, cameras(), narrow).tolist() == []
