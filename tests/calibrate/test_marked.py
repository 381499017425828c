"""Poses from marked points of the floor: with a lens, without one, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from walking_people import cameras

from occlog.array_types import Floats
from occlog.calibrate.starts.focal import with_focal
from occlog.calibrate.starts.marked import pose_of_points
from occlog.errors import InputError
from occlog.io.formats.calibration.points import read_marked_points
from occlog.records.scene import Camera

FLOOR = np.array([[2.0, 2.0, 0.0], [8.0, 2.5, 0.0], [7.0, 6.0, 0.0], [3.0, 6.0, 0.0], [5.0, 4.0, 0.0], [4.0, 2.0, 0.0]])


def angle(a: Camera, b: Camera) -> float:
    """Angle [deg] between the orientations of two cameras."""
    return float(np.degrees(np.arccos(np.clip((np.trace(a.rotation.T @ b.rotation) - 1.0) / 2.0, -1.0, 1.0))))


def unplaced(camera: Camera) -> Camera:
    return replace(camera, position=np.zeros(3), rotation=np.eye(3), placed=False)


@pytest.mark.parametrize("count", [4, 6])
def test_exact_marks_give_the_pose(count: int) -> None:
    for camera in cameras():
        found = pose_of_points(unplaced(camera), camera.project(FLOOR[:count]), FLOOR[:count])
        np.testing.assert_allclose(found.camera.position, camera.position, atol=1e-5)
        assert angle(found.camera, camera) < 1e-3
        assert found.residual_px < 1e-4


@pytest.mark.parametrize("count", [4, 6])
def test_exact_marks_give_the_focal_length_too(count: int) -> None:
    for camera in cameras():
        unknown = with_focal(unplaced(camera), 1.0)
        found = pose_of_points(unknown, camera.project(FLOOR[:count]), FLOOR[:count])
        np.testing.assert_allclose(found.camera.focal_px, camera.focal_px, rtol=1e-5)
        np.testing.assert_allclose(found.camera.position, camera.position, atol=1e-4)
        assert 0.0 < found.sigma_focal < 0.3


def test_points_above_the_floor_and_a_distorted_lens_are_used() -> None:
    camera = replace(cameras()[0], distortion=np.array([-0.2, 0.05, 0.0, 0.0, 0.0]))
    points: Floats = np.vstack([FLOOR[:3], [[4.0, 5.0, 1.2]]])
    found = pose_of_points(unplaced(camera), camera.project(points), points)
    np.testing.assert_allclose(found.camera.position, camera.position, atol=1e-4)


def test_standard_deviations_are_those_of_the_errors() -> None:
    """Marks with errors of 2 px, 40 draws of each of three cameras: NEES of the position 3 in the mean, to 30 %."""
    rng = np.random.default_rng(12)
    nees = []
    for camera in cameras():
        exact = camera.project(FLOOR)
        for _ in range(40):
            found = pose_of_points(unplaced(camera), exact + rng.normal(0.0, 2.0, exact.shape), FLOOR)
            nees.append(((found.camera.position - camera.position) ** 2 / found.sigma_position**2).sum())
    assert 2.0 < np.mean(nees) < 4.0


def test_what_gives_no_pose_is_refused() -> None:
    camera = cameras()[0]
    with pytest.raises(InputError, match="3 marked points; 4 at least"):
        pose_of_points(unplaced(camera), camera.project(FLOOR[:3]), FLOOR[:3])
    line = np.array([[x, 0.5 * x, 0.0] for x in (2.0, 4.0, 6.0, 8.0)])
    with pytest.raises(InputError, match="are on a line"):
        pose_of_points(unplaced(camera), camera.project(line), line)
    with pytest.raises(InputError, match=r"px off the others|below the floor"):
        pose_of_points(unplaced(camera), camera.project(FLOOR)[[1, 0, 2, 3, 4, 5]], FLOOR)
    left_handed = FLOOR * [1.0, -1.0, 1.0]
    with pytest.raises(InputError, match="right-handed"):
        pose_of_points(unplaced(camera), camera.project(FLOOR), left_handed)


def test_the_table_is_read_by_camera(tmp_path: Path) -> None:
    path = tmp_path / "clicked.csv"
    path.write_text("camera,u,v,x,y\ncam1,10,20.5,1,2\ncam2,1,2,3,4\ncam1,30,40,5,6\n")
    found = read_marked_points(path, ["cam1", "cam2"])
    np.testing.assert_array_equal(found["cam1"][0], [[10.0, 20.5], [30.0, 40.0]])
    np.testing.assert_array_equal(found["cam1"][1], [[1.0, 2.0, 0.0], [5.0, 6.0, 0.0]])
    with pytest.raises(InputError, match="camera 'cam2' is none of cam1"):
        read_marked_points(path, ["cam1"])
