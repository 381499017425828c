"""Errors of the body model and of camera poses in the covariances of positions."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from people_boxes import hall

from occlog.array_types import Floats
from occlog.records.scene import Camera
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.detector_model import detector_model, prior_edge_errors, prior_statistics
from occlog.track.methods.jipda.filter import initial_state, step
from occlog.track.methods.jipda.interface import FrameDetections, PositionSource
from occlog.track.methods.jipda.kernels.body_box import box_and_slope, cover_positions, pack_views
from occlog.track.methods.jipda.kernels.detections import DetectorModel, axis_noise
from occlog.track.methods.jipda.kernels.lasting_errors.bias_effects import bias_effects
from occlog.track.methods.jipda.lasting_errors.body_bias import PRIOR_SIGMA, bias_information, with_biases

MEAN = np.array([[4.5, 5.5, 0.0, 0.0, 1.75, 0.5]])
COVARIANCE = np.diag([0.01, 0.01, 1.0, 1.0, 0.01, 0.0025])[None]


def rates_of(cameras: int) -> DetectorModel:
    config = JipdaConfig()
    return detector_model(
        prior_statistics(cameras, config), prior_edge_errors(cameras, 1.0, config), config, np.full(cameras, 0.1)
    )


def exact(cameras: int) -> Floats:
    """Standard deviations of poses without error."""
    return np.zeros((cameras, 2))


@pytest.mark.parametrize("names", ["a", "ab", "abcd"])
def test_shift_is_that_of_weighted_least_squares(names: str) -> None:
    """Boxes that are lower by a thousandth of their heights move the solution by a thousandth of the shift."""
    scene = hall(names)
    views, rates = pack_views(scene.cameras), rates_of(len(names))
    shift, _, _ = bias_effects(MEAN, COVARIANCE, views, rates, exact(len(names)))
    rows, right, weight = [], [], []
    for c in range(len(names)):
        box, slope = np.zeros(4), np.zeros((4, 6))
        assert box_and_slope(views.lens[c], MEAN[0], 0.0, box, slope) > 0.0
        for axis in range(2):
            middle, size = axis_noise(rates, axis, box[2] - box[0], box[3] - box[1], 1.0)
            rows += [0.5 * (slope[axis] + slope[axis + 2]), slope[axis + 2] - slope[axis]]
            right += [0.001 * (box[3] - box[1]) if axis else 0.0, 0.0]
            weight += [1.0 / middle, 1.0 / size]
    # Heights and widths have priors
    rows += [np.eye(6)[4], np.eye(6)[5]]
    right += [0.0, 0.0]
    weight += [100.0, 400.0]
    root = np.sqrt(weight)
    free = [0, 1, 4, 5]
    solution = np.linalg.lstsq(root[:, None] * np.array(rows)[:, free], root * np.array(right), rcond=None)[0]
    np.testing.assert_allclose(0.001 * shift[0], solution[:2], rtol=1e-6)


def box_of(camera: Camera) -> Floats:
    """Box (4,) of the body `MEAN` in a camera: left, top, right, bottom [px]."""
    box = np.zeros(4)
    assert box_and_slope(pack_views([camera]).lens[0], MEAN[0], 0.0, box, np.zeros((4, 6))) > 0.0
    return box


def moved(camera: Camera, error: int, by: float) -> Camera:
    """A camera turned about the vertical (0) or its horizontal axis (1), or shifted along x, y or z (2 to 4)."""
    if error >= 2:
        return replace(camera, position=camera.position + by * np.eye(3)[error - 2])
    turn = cv2.Rodrigues(by * (np.array([0.0, 0.0, 1.0]) if error == 0 else camera.rotation[:, 0]))[0]
    return replace(camera, rotation=turn @ camera.rotation)


@pytest.mark.parametrize("names", ["a", "ab", "abcd"])
@pytest.mark.parametrize("sigma", [(0.05, 0.0), (0.0, 0.01), (0.03, 0.02)])
def test_poses_add_the_covariance_of_least_squares_with_moved_cameras(names: str, sigma: tuple[float, float]) -> None:
    scene, C = hall(names), len(names)
    views, rates = pack_views(scene.cameras), rates_of(C)
    sigmas = np.array([sigma]) * np.arange(1.0, C + 1.0)[:, None]
    _, _, got = bias_effects(MEAN, COVARIANCE, views, rates, sigmas)
    A, right = np.diag([0.0, 0.0, 100.0, 400.0]), []
    for c, camera in enumerate(scene.cameras):
        box, slope = np.zeros(4), np.zeros((4, 6))
        box_and_slope(views.lens[c], MEAN[0], 0.0, box, slope)
        slope = slope[:, [0, 1, 4, 5]]
        b = np.zeros((4, 5))
        for axis in range(2):
            middle, size = axis_noise(rates, axis, box[2] - box[0], box[3] - box[1], 1.0)
            row, other = 0.5 * (slope[axis] + slope[axis + 2]), slope[axis + 2] - slope[axis]
            A += np.outer(row, row) / middle + np.outer(other, other) / size
            for error in range(5):
                h = 1e-4
                by = (box_of(moved(camera, error, h)) - box_of(moved(camera, error, -h))) / (2 * h)
                b[:, error] += row / middle * 0.5 * (by[axis] + by[axis + 2]) * sigmas[c, int(error < 2)]
                b[:, error] += other / size * (by[axis + 2] - by[axis]) * sigmas[c, int(error < 2)]
        right.append(b)
    shifts = np.linalg.solve(A, np.concatenate(right, axis=1))[:2]
    np.testing.assert_allclose(got[0], shifts @ shifts.T, rtol=0.05 if C > 1 else 0.12, atol=1e-6)


def test_tracks_contain_the_stated_uncertainty_of_poses() -> None:
    """The covariances of a run without stated uncertainty, and what poses add to them."""
    scene, sigma = hall("abcd"), (0.2, 0.01)
    unsure = [replace(c, sigma_position=sigma[0], sigma_yaw=sigma[1]) for c in scene.cameras]
    found = []
    for cameras in (scene.cameras, unsure):
        state, last = initial_state(scene, list(cameras), JipdaConfig()), None
        for t in range(12):
            boxes = [box_of(camera)[None] for camera in cameras]
            n = np.full(1, np.nan), np.full(1, -1), np.zeros((1, 0)), np.arange(1)
            before = state
            state, last = step(state, [FrameDetections(t * 100_000_000, c, box, *n) for c, box in enumerate(boxes)])
        assert last is not None
        found.append((last, before))
    (sure, before), (wide, _) = found
    np.testing.assert_array_equal(sure.mean, wide.mean)
    rates = detector_model(before.counts, before.edges, JipdaConfig(), np.full(4, 0.1))
    _, _, poses = bias_effects(sure.mean, sure.covariance, before.views, rates, np.array([sigma] * 4))
    added = (wide.covariance - sure.covariance)[:, :2, :2]
    assert len(added) == 1
    np.testing.assert_allclose(added, poses, rtol=1e-6)


def test_cameras_around_a_person_cancel_and_find_the_bias() -> None:
    for names, most, least in (("abcd", 0.35, 0.0), ("a", 1.0, 1.0), ("ab", 0.8, 0.4)):
        scene = hall(names)
        shift, share, _ = bias_effects(
            MEAN, COVARIANCE, pack_views(scene.cameras), rates_of(len(names)), exact(len(names))
        )
        assert least <= share[0] <= most
        if names == "a":
            # Along the line of sight, as the cotangent of the angle to the ground says
            away = MEAN[0, :2] - scene.cameras[0].position[:2]
            assert abs(away[0] * shift[0, 1] - away[1] * shift[0, 0]) < 0.1 * np.hypot(*away) * np.hypot(*shift[0])
            assert bias_information(share, 100.0) == pytest.approx(0.0, abs=1e-6)
        else:
            assert bias_information(share, 5.0) > 0.3 / 0.03**2


def test_covariances_contain_what_is_not_known() -> None:
    shift = np.array([[3.0, 4.0]])
    none = np.zeros((1, 2, 2))
    wide = with_biases(COVARIANCE, shift, 0.0, none)
    np.testing.assert_allclose((wide - COVARIANCE)[0, :2, :2], PRIOR_SIGMA**2 * np.array([[9.0, 12.0], [12.0, 16.0]]))
    known = with_biases(COVARIANCE, shift, 3.0 / PRIOR_SIGMA**2, none)
    np.testing.assert_allclose((known - COVARIANCE)[0, 0, 0], PRIOR_SIGMA**2 * 9.0 / 4.0)
    of_poses = np.array([[[0.3, 0.1], [0.1, 0.2]]])
    np.testing.assert_allclose((with_biases(COVARIANCE, shift, 0.0, of_poses) - wide)[0, :2, :2], of_poses[0])


def test_positions_on_the_ground_have_no_such_bias() -> None:
    views = pack_views([*hall("a").cameras, PositionSource("lidar")])
    views = cover_positions(views, 1, np.array([[0.0, 0.0], [10.0, 10.0]]), 1.0)
    shift, share, poses = bias_effects(MEAN, COVARIANCE, views, rates_of(2), np.full((2, 2), 0.1))
    assert not shift.any()
    assert not poses.any()
    assert share[0] == 0.0
