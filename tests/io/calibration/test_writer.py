"""Calibrations that are written: what the readers read again, and what a format cannot state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.errors import InputError, OutputError, OutputExistsError
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.outputs import OUTPUTS, format_of
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.formats.calibration.writer import write_calibration
from occlog.records.scene import Camera, Clock, Scene, camera_fov, camera_rotation

NAMES = {"opencv-storage": "opencv", "kalibr": "camchain.yaml", "colmap": "colmap", "ros": "camera_info"}
BROWN = np.array([-0.2, 0.05, 1e-3, -2e-3, 0.0])
LENSES: dict[str, tuple[str, Floats]] = {
    "none": ("brown", np.zeros(5)),
    "four": ("brown", BROWN),
    "five": ("brown", np.array([-0.2, 0.05, 1e-3, -2e-3, 0.01])),
    "rational": ("opencv", np.array([0.3, 0.1, 1e-3, -1e-3, 0.02, 0.4, 0.15, 0.01, *[0.0] * 6])),
    "prism": ("opencv", np.array([-0.2, 0.05, 1e-3, -1e-3, 0.01, 0.0, 0.0, 0.0, 1e-3, 2e-3, -1e-3, 1e-3, 0.0, 0.0])),
    "fisheye": ("equidistant", np.array([0.02, -0.01, 1e-3, -1e-4, 0.0])),
}
REFUSED = {("kalibr", "five"), ("kalibr", "rational")} | {(f, "prism") for f in ("kalibr", "colmap", "ros")}


def cameras(lens: str) -> list[Camera]:
    """Two cameras that point down, one of them rolled; pixels are not square."""
    model, coefficients = LENSES[lens]
    made = [
        Camera(
            name=name,
            position=np.array([3.0 * n, -2.25, 2.7]),
            rotation=camera_rotation(1.1 + 2.5 * n, -0.3, 0.05 * n),
            focal_px=np.array([700.5, 702.25]),
            principal_px=np.array([322.0, 238.5]),
            image_size=(640, 480),
            distortion=coefficients,
            distortion_model=model,
        )
        for n, name in enumerate(("cam0", "cam1"))
    ]
    size = made[0].image_size
    assert size is not None
    return [
        replace(c, fov=camera_fov(size, c.focal_px, c.principal_px, c.distortion, c.distortion_model, c.rotation))
        for c in made
    ]


def read_again(path: Path) -> tuple[Camera, ...]:
    found = read_calibration([path], "auto", CalibrationOptions(unit="m"))
    assert format_of(path) == found.format
    return found.cameras


def assert_same(found: Sequence[Camera], wanted: Sequence[Camera]) -> None:
    assert [c.name for c in found] == [c.name for c in wanted]
    for one, other in zip(found, wanted, strict=True):
        for of in ("position", "rotation", "focal_px", "principal_px"):
            np.testing.assert_allclose(getattr(one, of), getattr(other, of), rtol=0, atol=1e-12)
        assert one.image_size == other.image_size
        ours, theirs = (np.concatenate([c.distortion, np.zeros(14)])[:14] for c in (one, other))
        np.testing.assert_array_equal(ours, theirs)
        assert (one.distortion_model == "equidistant") == (other.distortion_model == "equidistant")


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("format", OUTPUTS)
def test_readers_read_the_same_cameras_again(tmp_path: Path, format: str, lens: str) -> None:
    path = tmp_path / NAMES[format]
    if (format, lens) in REFUSED:
        with pytest.raises(InputError, match="this format cannot state a lens") as caught:
            write_calibration(path, Scene(tuple(cameras(lens))), format)
        assert len(str(caught.value)) <= 160
        assert not path.exists()
        return
    assert write_calibration(path, Scene(tuple(cameras(lens))), format) == ()
    assert_same(read_again(path), cameras(lens))


def test_lengths_become_metres(tmp_path: Path) -> None:
    wanted = cameras("none")
    feet = [replace(c, position=c.position / 0.3048) for c in wanted]
    write_calibration(tmp_path / "colmap", Scene(tuple(feet), length_unit="ft"), "colmap")
    assert_same(read_again(tmp_path / "colmap"), wanted)
    with pytest.raises(InputError, match="lengths are in 'unit'"):
        write_calibration(tmp_path / "feet-colmap", Scene(tuple(feet), length_unit="unit"), "colmap")


def test_opencv_reads_its_file(tmp_path: Path) -> None:
    camera = cameras("four")[0]
    write_calibration(tmp_path / "opencv.yml", Scene((camera,)), "opencv-storage")
    file = cv2.FileStorage(str(tmp_path / "opencv.yml"), cv2.FILE_STORAGE_READ)
    K, d, R, t = (file.getNode(name).mat() for name in ("camera_matrix", "distortion_coefficients", "R", "T"))
    points = camera.position + camera.rotation @ np.array([[0.3], [0.2], [4.0]]).ravel()
    pixels, _ = cv2.projectPoints(points.reshape(1, 3), cv2.Rodrigues(R)[0], t, K, d)
    np.testing.assert_allclose(pixels.reshape(1, 2), camera.project(points.reshape(1, 3)), atol=1e-9)


def test_kalibr_states_clocks_with_its_sign(tmp_path: Path) -> None:
    """A camera 0.25 s late: Kalibr adds -0.25 s to the times of its images."""
    first, second = cameras("four")
    scene = Scene((first, replace(second, clock="late")), clocks=(Clock("late", 250_000_000),))
    path = tmp_path / "camchain.yaml"
    assert write_calibration(path, scene, "kalibr") == ()
    found = read_calibration([path])
    (check,) = (c for c in found.checks if c.id == "time-shifts-unused")
    assert "cam1=-0.25s" in check.text
    assert "timeshift_cam_imu: -0.25" in path.read_text()
    assert write_calibration(tmp_path / "colmap", scene, "colmap") == ("clocks",)


def test_what_is_not_held_is_listed(tmp_path: Path) -> None:
    named = [replace(c, name=f"hall-{c.name}", sigma_position=0.1) for c in cameras("none")]
    missed = write_calibration(tmp_path / "camchain.yaml", Scene(tuple(named)), "kalibr")
    assert missed == ("names of cameras", "standard deviations of poses")


def test_a_camera_without_pose_or_size_is_refused(tmp_path: Path) -> None:
    camera = cameras("none")[0]
    with pytest.raises(InputError, match="camera cam0 has no pose"):
        write_calibration(tmp_path / "colmap", Scene((replace(camera, placed=False),)), "colmap")
    with pytest.raises(InputError, match="camera cam0 states no image size"):
        write_calibration(tmp_path / "colmap", Scene((replace(camera, image_size=None),)), "colmap")
    write_calibration(tmp_path / "opencv.yml", Scene((replace(camera, placed=False),)), "opencv-storage")
    assert "R:" not in (tmp_path / "opencv.yml").read_text()


def test_folders_are_replaced_on_request_and_not_mixed(tmp_path: Path) -> None:
    scene, path = Scene(tuple(cameras("none"))), tmp_path / "opencv"
    write_calibration(path, scene, "opencv-storage")
    with pytest.raises(OutputExistsError):
        write_calibration(path, scene, "opencv-storage")
    write_calibration(path, scene, "opencv-storage", overwrite=True)
    with pytest.raises(OutputError, match=r"other files \(cam1.yml\)"):
        write_calibration(path, Scene(scene.cameras[:1]), "opencv-storage", overwrite=True)
    with pytest.raises(InputError, match="consists of 2 files; name a folder"):
        write_calibration(tmp_path / "opencv.yml", scene, "opencv-storage")
