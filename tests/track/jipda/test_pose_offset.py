"""Rotations of the cameras from their calibration: the normal equations, and the angles and standard errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from people_boxes import box, hall

from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.detector_model import detector_model, prior_edge_errors, prior_statistics
from occlog.track.methods.jipda.kernels.body_box import PackedCameras, expected_box, pack_views
from occlog.track.methods.jipda.kernels.detections import PackedDetections, axis_noise
from occlog.track.methods.jipda.kernels.lasting_errors.pose_residuals import pose_residuals
from occlog.track.methods.jipda.lasting_errors.pose_offset import (
    MIN_ANGLE,
    PoseStatistics,
    corrected,
    prior_poses,
    update_poses,
)

SCENE = hall("abcd")
C = len(SCENE.cameras)
CONFIG = JipdaConfig()
RATES = detector_model(prior_statistics(C, CONFIG), prior_edge_errors(C, 1.0, CONFIG), CONFIG, np.full(C, 0.1))


def rotated(angles: np.ndarray) -> PackedCameras:
    """The cameras with orientations that differ from the calibration by angles (C, 2) [rad]."""
    views = pack_views(SCENE.cameras)
    return corrected(views, replace(prior_poses(views), angles=angles))


def people(rng: np.random.Generator, n: int = 5) -> np.ndarray:
    return np.column_stack([rng.uniform(2.0, 8.0, (n, 2)), np.zeros((n, 2)), np.tile([1.75, 0.5], (n, 1))])


def detections(views: PackedCameras, mean: np.ndarray, rng: np.random.Generator, px: float) -> PackedDetections:
    """Boxes of everybody in all cameras, in the order of people."""
    drawn = np.zeros((C, len(mean), 4))
    for c in range(C):
        for i, state in enumerate(mean):
            assert expected_box(views.lens[c], state[0], state[1], state[4], state[5], drawn[c, i]) > 0.0
    return PackedDetections(
        camera=np.arange(C),
        delay=np.zeros(C),
        first=len(mean) * np.arange(C + 1),
        box=drawn.reshape(-1, 4) + rng.normal(0.0, px, (C * len(mean), 4)),
        usable=np.ones((C * len(mean), 4), dtype=np.bool_),
        clutter=np.zeros(C * len(mean)),
    )


def normal_equations(views: PackedCameras, mean: np.ndarray, boxes: PackedDetections) -> np.ndarray:
    covariance = np.tile(np.diag([1.0, 1.0, 1.0, 1.0, 0.04, 0.01]), (len(mean), 1, 1))
    owner = np.tile(np.arange(len(mean)), C)
    return pose_residuals(mean, covariance, views, boxes, RATES, owner, np.ones(len(owner), dtype=np.bool_))


def test_normal_equations_are_those_of_a_dense_bundle_adjustment() -> None:
    """Derivatives by differences; positions and heights of the people are eliminated by a Schur complement."""
    rng = np.random.default_rng(0)
    mean = people(rng, 3)
    boxes = detections(rotated(rng.normal(0.0, 0.01, (C, 2))), mean, rng, 2.0)
    found = normal_equations(rotated(np.zeros((C, 2))), mean, boxes)

    def centres(parameters: np.ndarray) -> np.ndarray:
        views, out, here = rotated(parameters[: 2 * C].reshape(C, 2)), np.zeros((C, 3, 2)), np.zeros(4)
        moved = mean.copy()
        moved[:, [0, 1, 4]] += parameters[2 * C :].reshape(3, 3)
        for c in range(C):
            for i, state in enumerate(moved):
                expected_box(views.lens[c], state[0], state[1], state[4], state[5], here)
                out[c, i] = 0.5 * (here[:2] + here[2:])
        return out.ravel()

    n = 2 * C + 9
    J = np.stack([(centres(h) - centres(-h)) / 2e-5 for h in 1e-5 * np.eye(n)], axis=1)
    r = 0.5 * (boxes.box[:, :2] + boxes.box[:, 2:]).ravel() - centres(np.zeros(n))
    expected, w = np.zeros(4), np.zeros((C, 3, 2))
    for c in range(C):
        for i, state in enumerate(mean):
            expected_box(rotated(np.zeros((C, 2))).lens[c], state[0], state[1], state[4], state[5], expected)
            size = expected[2:] - expected[:2]
            w[c, i] = [1.0 / axis_noise(RATES, axis, size[0], size[1], 1.0)[0] for axis in range(2)]
    N, b = J.T @ (w.ravel()[:, None] * J), J.T @ (w.ravel() * r)
    N[2 * C :, 2 * C :] += np.diag(3 * [0.0, 0.0, 1.0 / 0.04])
    inner, cross = np.linalg.inv(N[2 * C :, 2 * C :]), N[: 2 * C, 2 * C :]
    scale = np.abs(found).max()
    # The centre of the box is not quite the image of the centre of the body
    np.testing.assert_allclose(found[:, :-1], N[: 2 * C, : 2 * C] - cross @ inner @ cross.T, atol=0.04 * scale)
    np.testing.assert_allclose(found[:, -1], b[: 2 * C] - cross @ inner @ b[2 * C :], atol=0.05 * np.abs(b).max())


@pytest.mark.parametrize("degrees", [(0.0, 0.0, 0.0, 0.0), (0.0, 1.5, 0.0, 0.0), (1.0, -1.0, 0.5, 1.0)])
def test_rotations_are_found_with_honest_errors(degrees: tuple[float, ...]) -> None:
    rng, true = np.random.default_rng(1), np.column_stack([np.radians(degrees), np.radians([0.0, 0.6, 0.0, 0.0])])
    if not any(degrees):
        true[:] = 0.0
    views, stood = rotated(np.zeros((C, 2))), rotated(true)
    poses = prior_poses(views)
    for k in range(150):
        mean = people(rng)
        boxes = detections(stood, mean, rng, 3.0)
        # The tracks are off, too: positions are eliminated
        mean[:, :2] += rng.normal(0.0, 0.05, mean[:, :2].shape)
        poses = update_poses(poses, round(0.2 * k * 1e9), normal_equations(views, mean, boxes))
        views = corrected(views, poses)
    assert (poses.limit < np.radians(0.3)).all()
    np.testing.assert_array_equal(poses.angles.any(axis=1), np.abs(true).max(axis=1) > MIN_ANGLE)
    np.testing.assert_allclose(poses.angles, true, atol=float(np.radians(0.02) + 0.5 * poses.limit.max()))


def test_boxes_are_those_of_a_rotated_camera() -> None:
    """By the projection of points of the body, independent of the packed cameras."""
    from occlog.core.geometry.camera import rotation_from_angles

    angle = np.radians(2.0)
    views = rotated(np.array([[angle, 0.0], *3 * [[0.0, 0.0]]]))
    own = replace(SCENE.cameras[0], rotation=rotation_from_angles(np.radians(45.0) + angle, np.radians(-20.0), 0.0))
    found = np.zeros(4)
    expected_box(views.lens[0], 5.0, 4.0, 1.75, 0.5, found)
    np.testing.assert_allclose(found, box(own, 5.0, 4.0), atol=1.5)


def test_people_who_one_camera_sees_say_nothing() -> None:
    poses: PoseStatistics = prior_poses(pack_views(SCENE.cameras))
    for k in range(20):
        poses = update_poses(poses, k * 10**9, np.zeros((2 * C, 2 * C + 1)))
    assert not poses.angles.any()
    assert np.isinf(poses.limit).all()
