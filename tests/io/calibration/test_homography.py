"""Homographies of the ground: exact poses from either direction, clicked points, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from people_boxes import SIZE, hall

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.ingest.scene import find_turn
from occlog.io.formats.calibration.common import CalibrationOptions, mirror_matrix
from occlog.io.formats.calibration.reader import read_calibration
from occlog.records.scene import Camera


def homography(camera: Camera) -> Floats:
    """(3, 3) from the ground to the image, as a projection matrix without its third column."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.principal_px
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    rotation = camera.rotation.T
    return np.asarray(k @ np.column_stack([rotation[:, 0], rotation[:, 1], -rotation @ camera.position]))


def read(folder: Path, matrices: dict[str, Floats], unit: str | None = None) -> tuple[Camera, ...]:
    for name, matrix in matrices.items():
        np.savetxt(folder / f"{name}_H.txt", matrix)
    paths = [folder / f"{name}_H.txt" for name in matrices]
    return read_calibration(paths, "auto", CalibrationOptions(unit, SIZE)).cameras


@pytest.mark.parametrize("scale", [1.0, -0.02])
@pytest.mark.parametrize("inverse", [False, True])
def test_poses_are_exact_in_either_direction(tmp_path: Path, inverse: bool, scale: float) -> None:
    true = hall("abcd").cameras
    matrices = {c.name: scale * (np.linalg.inv(homography(c)) if inverse else homography(c)) for c in true}
    for camera, found in zip(true, read(tmp_path, matrices), strict=True):
        assert found.name == camera.name
        assert found.position == pytest.approx(camera.position, abs=1e-6)
        assert found.focal_px == pytest.approx(camera.focal_px, rel=1e-6)
        assert found.rotation == pytest.approx(camera.rotation, abs=1e-8)


def test_clicked_points_give_a_pose_to_some_centimetres(tmp_path: Path) -> None:
    """Twelve points clicked to 1 px: of 40 heights of 3 m half are right to 0.1 m, nine of ten to 0.3 m.

    The draws have a median of 0.05 m and a ninth decile of 0.17 m; the limits are twice as large.
    """
    import cv2

    camera = hall("a").cameras[0]
    rng = np.random.default_rng(2)
    heights = []
    for _ in range(40):
        ground = rng.uniform(2.0, 8.0, (12, 2))
        pixels = camera.project(np.column_stack([ground, np.zeros(12)])) + rng.standard_normal((12, 2))
        matrix = cv2.findHomography(pixels, ground)[0]
        heights.append(read(tmp_path, {"a": matrix})[0].position[2])
    off = np.abs(np.array(heights) - 3.0)
    assert np.median(off) < 0.1
    assert np.quantile(off, 0.9) < 0.35


def test_lengths_are_in_the_stated_unit(tmp_path: Path) -> None:
    camera = hall("b").cameras[0]
    in_cm = homography(camera) @ np.diag([0.01, 0.01, 1.0])
    assert read(tmp_path, {"b": in_cm}, "cm")[0].position == pytest.approx(camera.position, abs=1e-6)


def test_what_is_no_camera_above_the_ground_is_refused(tmp_path: Path) -> None:
    matrix = homography(hall("a").cameras[0])
    with pytest.raises(InputError, match=r"below the ground: the axes of the ground are left-handed"):
        read(tmp_path, {"a": matrix @ np.diag([1.0, -1.0, 1.0])})
    with pytest.raises(InputError, match="fits no camera with square pixels"):
        read(tmp_path, {"a": np.array([[1.0, 0.0, 320.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ matrix})
    with pytest.raises(InputError, match=r"fits no camera|cannot be inverted"):
        read(tmp_path, {"a": np.ones((3, 3))})
    np.savetxt(tmp_path / "a_H.txt", matrix)
    with pytest.raises(InputError, match="does not state the size of the images"):
        read_calibration([tmp_path / "a_H.txt"], "auto", CalibrationOptions())


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_left_handed_ground_is_mirrored(tmp_path: Path, axis: str, inverse: bool) -> None:
    true, axes = hall("abcd").cameras, mirror_matrix(axis)
    matrices = {c.name: homography(c) @ axes for c in true}
    for name, matrix in matrices.items():
        np.savetxt(tmp_path / f"{name}_H.txt", np.linalg.inv(matrix) if inverse else matrix)
    paths = [tmp_path / f"{name}_H.txt" for name in matrices]
    with pytest.raises(InputError, match="its camera is below the ground: the axes of the ground are left-handed"):
        read_calibration(paths, "auto", CalibrationOptions(None, SIZE))
    found = read_calibration(paths, "auto", CalibrationOptions(None, SIZE, mirror=axis)).cameras
    turn = find_turn(found, None, None, lambda _: None, axis)
    assert turn is not None
    for camera, left in zip(true, found, strict=True):
        right = turn.camera(left)
        assert right.position == pytest.approx(camera.position, abs=1e-6)
        assert right.rotation == pytest.approx(camera.rotation, abs=1e-8)
    with pytest.raises(InputError, match="a homography states no z"):
        read_calibration(paths, "auto", CalibrationOptions(None, SIZE, mirror="z"))
