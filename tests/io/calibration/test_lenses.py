"""Lenses of every reader: OpenCV's complete model, fisheyes that are stated or not, wide ones, and those that fold."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import read_calibration
from occlog.io.formats.scenes.scene import read_scene, scene_to_yaml
from occlog.records.scene import Camera, Scene

SIZE = (1280, 720)
MATRIX = np.array([[900.0, 0.0, 640.0], [0.0, 905.0, 358.0], [0.0, 0.0, 1.0]])
COMPLETE = np.array([0.5, -0.3, 0.0003, -0.0002, 0.02, 0.75, -0.35, 0.01, 0.01, -0.002, -0.008, 0.003, 0.02, -0.03])
KINECT = np.array([0.49, -2.77, 3e-4, -1e-4, 1.61, 0.37, -2.59, 1.54])
FISHEYE = np.array([0.05, -0.01, 0.002, -0.001])
POINTS = np.stack(np.meshgrid(np.linspace(-2.4, 2.4, 9), np.linspace(-1.3, 1.3, 7), [4.0]), axis=-1).reshape(-1, 3)
Writer = Callable[[Path, Floats, dict[str, object]], list[Path]]


def _storage(data: Floats, shape: tuple[int, int]) -> str:
    values = ", ".join(map(repr, data.ravel().tolist()))
    return f"!!opencv-matrix\n   rows: {shape[0]}\n   cols: {shape[1]}\n   dt: d\n   data: [ {values} ]\n"


def storage(folder: Path, lens: Floats, more: dict[str, object]) -> list[Path]:
    parts = {"K": (MATRIX, (3, 3)), "D": (lens, (len(lens), 1)), "R": (np.eye(3), (3, 3)), "T": (np.zeros(3), (3, 1))}
    text = "%YAML:1.0\n---\nimage_width: 1280\nimage_height: 720\n"
    text += "".join(f"{name}: {_storage(*part)}" for name, part in parts.items())
    (folder / "a.yml").write_text(text + "".join(f"{key}: {value}\n" for key, value in more.items()))
    return [folder / "a.yml"]


def pairs(folder: Path, lens: Floats, more: dict[str, object]) -> list[Path]:
    parts = {"camera_matrix": (MATRIX, (3, 3)), "distortion_coefficients": (lens, (len(lens), 1))}
    text = "%YAML:1.0\n---\nimage_width: 1280\nimage_height: 720\n"
    text += "".join(f"{name}: {_storage(*part)}" for name, part in parts.items())
    (folder / "intr_a.yml").write_text(text + "".join(f"{key}: {value}\n" for key, value in more.items()))
    pose = "".join(f"{name}: {_storage(np.zeros(3), (3, 1))}" for name in ("rvec", "tvec"))
    (folder / "extr_a.yml").write_text("%YAML:1.0\n---\n" + pose)
    return [folder / "extr_a.yml", folder / "intr_a.yml"]


def toml(folder: Path, lens: Floats, more: dict[str, object]) -> list[Path]:
    values: dict[str, object] = {"name": "a", "size": SIZE, "matrix": MATRIX.tolist(), "distortions": lens.tolist()}
    values |= {"rotation": [0.0, 0.0, 0.0], "translation": [0.0, 0.0, 0.0], **more}
    (folder / "a.toml").write_text("[cam1]\n" + "".join(f"{key} = {json.dumps(v)}\n" for key, v in values.items()))
    return [folder / "a.toml"]


def arrays(folder: Path, lens: Floats, more: dict[str, object]) -> list[Path]:
    parts = {"K": MATRIX, "R": np.eye(3), "t": np.zeros(3), "dist": lens, "image_size": np.array(SIZE)}
    np.savez(folder / "a.npz", **parts, **{key: np.array(value) for key, value in more.items()})  # type: ignore[arg-type]
    return [folder / "a.npz"]


def ros(folder: Path, lens: Floats, more: dict[str, object]) -> list[Path]:
    info = {
        "image_width": 1280,
        "image_height": 720,
        "camera_name": "a",
        "camera_matrix": {"rows": 3, "cols": 3, "data": MATRIX.ravel().tolist()},
        "distortion_model": "rational_polynomial" if len(lens) > 5 else "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": len(lens), "data": lens.tolist()},
        **more,
    }
    none = {"translation": [0.0, 0.0, 0.0], "rotation": [0.0, 0.0, 0.0, 1.0]}
    (folder / "a.yaml").write_text(yaml.safe_dump(info))
    (folder / "tf.yaml").write_text(yaml.safe_dump([{"frame_id": "map", "child_frame_id": "a_optical_frame", **none}]))
    return [folder / "a.yaml", folder / "tf.yaml"]


def colmap(folder: Path, lens: Floats, more: dict[str, object]) -> list[Path]:
    numbers = [900.0, 905.0, 640.5, 358.5, *lens.tolist()]
    (folder / "cameras.txt").write_text(f"1 FULL_OPENCV 1280 720 {' '.join(map(repr, numbers))}\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    return [folder / "cameras.txt", folder / "images.txt"]


READERS: dict[str, Writer] = {"storage": storage, "pairs": pairs, "toml": toml, "arrays": arrays, "ros": ros}


def one(paths: list[Path], **options: object) -> Camera:
    (camera,) = read_calibration(paths, options=CalibrationOptions("m", **options)).cameras  # type: ignore[arg-type]
    return camera


@pytest.mark.parametrize("count", [8, 12, 14])
@pytest.mark.parametrize("reader", READERS)
def test_lenses_of_8_12_and_14_coefficients_are_those_of_opencv(tmp_path: Path, reader: str, count: int) -> None:
    camera = one(READERS[reader](tmp_path, COMPLETE[:count], {}))
    wanted = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), MATRIX, COMPLETE[:count])[0].reshape(-1, 2)
    assert np.abs(camera.project(POINTS) - wanted).max() < 1e-6
    rays = camera.rays(wanted)
    assert np.abs(rays / rays[:, 2:] - POINTS / 4.0).max() < 1e-8


def test_full_opencv_of_colmap_has_eight(tmp_path: Path) -> None:
    camera = one(colmap(tmp_path, COMPLETE[:8], {}))
    wanted = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), MATRIX, COMPLETE[:8])[0].reshape(-1, 2)
    assert np.abs(camera.project(POINTS) - wanted).max() < 1e-6


def test_the_lens_of_a_depth_camera_that_five_coefficients_miss_by_7_px_is_exact(tmp_path: Path) -> None:
    camera = one(storage(tmp_path, KINECT, {}))
    wanted = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), MATRIX, KINECT)[0].reshape(-1, 2)
    assert np.abs(camera.project(POINTS) - wanted).max() < 1e-6


def test_a_scene_file_keeps_the_complete_model_and_a_fisheye_without_coefficients(tmp_path: Path) -> None:
    a, b = one(storage(tmp_path, COMPLETE, {})), one(storage(tmp_path, np.zeros(4), {"fisheye_model": 1}))
    for camera in (a, b):
        (tmp_path / "scene.yaml").write_text(scene_to_yaml(Scene(cameras=(camera,))))
        (found,) = read_scene(tmp_path / "scene.yaml").cameras
        assert found.distortion_model == camera.distortion_model
        np.testing.assert_allclose(found.project(POINTS), camera.project(POINTS), atol=1e-9)


@pytest.mark.parametrize("reader", ["storage", "pairs", "arrays"])
def test_four_coefficients_without_a_model_are_asked_about(tmp_path: Path, reader: str) -> None:
    paths = READERS[reader](tmp_path, FISHEYE, {})
    with pytest.raises(InputError, match="4 distortion coefficients, of a fisheye lens or k1, k2, p1, p2; state"):
        one(paths)
    fisheye, brown = one(paths, lens_model="fisheye"), one(paths, lens_model="brown")
    wanted = cv2.fisheye.projectPoints(POINTS[:, None], np.zeros(3), np.zeros(3), MATRIX, FISHEYE)[0].reshape(-1, 2)
    assert np.abs(fisheye.project(POINTS) - wanted).max() < 1e-6
    wanted = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), MATRIX, FISHEYE)[0].reshape(-1, 2)
    assert np.abs(brown.project(POINTS) - wanted).max() < 1e-6
    key = "fisheye" if reader == "arrays" else "fisheye_model"
    stated = READERS[reader](tmp_path, FISHEYE, {key: 1})
    assert one(stated).distortion_model == "equidistant"
    with pytest.raises(InputError, match="states another lens than"):
        one(stated, lens_model="brown")
    assert one(READERS[reader](tmp_path, FISHEYE, {key: 0})).distortion_model == "brown"
    assert one(READERS[reader](tmp_path, np.zeros(4), {})).straight


def test_in_toml_a_lens_that_is_not_stated_to_be_a_fisheye_is_none_and_it_is_noted(tmp_path: Path) -> None:
    paths = toml(tmp_path, FISHEYE, {})
    found = read_calibration(paths)
    assert found.cameras[0].distortion_model == "brown"
    assert any("k1, k2, p1, p2 are assumed" in note for note in found.notes)
    assert one(paths, lens_model="fisheye").distortion_model == "equidistant"
    assert not read_calibration(toml(tmp_path, FISHEYE, {"fisheye": False})).notes


def test_models_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="fisheye_model and distortion_model contradict each other"):
        one(storage(tmp_path, FISHEYE, {"fisheye_model": 1, "distortion_model": "plumb_bob"}))
    with pytest.raises(InputError, match="5 distortion coefficients; a fisheye lens has 4"):
        one(storage(tmp_path, np.full(5, 0.01), {"fisheye_model": 1}))
    with pytest.raises(InputError, match="7 distortion coefficients; OpenCV's lenses have 4, 5, 8, 12 or 14"):
        one(storage(tmp_path, np.full(7, 0.01), {}))


def test_a_fisheye_of_180_degrees_is_used_up_to_80_off_its_axis(tmp_path: Path) -> None:
    (path,) = storage(tmp_path, np.array([-0.03, 0.004, -0.002, 0.0003]), {"fisheye_model": 1})
    path.write_text(path.read_text().replace("900.0", "420.0").replace("905.0", "420.0"))
    found = read_calibration([path])
    assert any("more than 80 degrees off its axis; what lies beyond, 26% of the image" in note for note in found.notes)
    (camera,) = found.cameras
    edge = camera.project(np.array([[np.tan(np.radians(79.9)), 0.0, 1.0], [np.tan(np.radians(80.1)), 0.0, 1.0]]))
    assert camera.usable(edge).tolist() == [True, False]
    assert np.isfinite(camera.rays(edge)[:, 0]).tolist() == [True, False]
    assert 0 < camera.fov <= 2 * np.pi


@pytest.mark.parametrize(
    ("lens", "where"),
    [
        ([-0.9, 0.0, 0.0, 0.0, 0.0], "31 degrees off the axis"),  # atan(1 / sqrt(2.7))
        ([0.1, 0.0, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0], "degrees off the axis"),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0], "35 degrees off the axis"),  # atan(1 / sqrt(2))
    ],
)
def test_a_lens_that_folds_inside_the_image_is_refused_and_where_is_stated(
    tmp_path: Path, lens: list[float], where: str
) -> None:
    with pytest.raises(InputError, match=rf"the distortion polynomial turns back .*{where}, inside the image"):
        one(storage(tmp_path, np.array(lens), {}))


def test_a_brown_lens_that_a_fixed_point_does_not_undo_is_read(tmp_path: Path) -> None:
    lens = np.array([1.5, 0.0, 0.0, 0.0, 0.0])
    camera = one(storage(tmp_path, lens, {}))
    points = POINTS * [0.8, 0.8, 1.0]
    wanted = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, lens)[0].reshape(-1, 2)
    assert np.abs(camera.project(points) - wanted).max() < 1e-6
