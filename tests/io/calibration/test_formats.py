"""Calibration importers against what is known of the recordings, and on malformed files."""

from __future__ import annotations

import csv
import re
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.core.geometry.camera import intersection_point
from occlog.errors import InputError, UsageError
from occlog.ingest.rig import describe
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import IMPORTERS, read_calibration
from occlog.io.formats.calibration.readers.opencv_toml import checked_rotation
from occlog.io.formats.calibration.readers.projection import take_apart
from occlog.io.formats.calibration.readers.tsai import rotation_zyx
from occlog.io.formats.scenes.scene import read_scene
from occlog.records.scene import Camera

CMC_SIZE = CalibrationOptions(image_size=(1920, 1024))
# Camera centres as the authors of the CMC recordings state them.
CMC_CENTRES = {
    "cam1": (0.21, 3.11, 2.24),
    "cam2": (7.17, 3.34, 2.16),
    "cam3": (7.55, 0.47, 2.16),
    "cam4": (0.21, 1.26, 2.20),
}


def floor_points(camera: Camera, pixels: Floats) -> Floats:
    """(N, 2) points of the ground in the lines of sight of pixels."""
    rays = camera.rays(pixels)
    return camera.position[:2] + rays[:, :2] * (-camera.position[2] / rays[:, 2])[:, None]


# --- Qualisys


def qualisys(shared_data: Path) -> tuple[Camera, ...]:
    found = read_calibration([shared_data / "pose2sim_demo/single/calibration/Calib.qca.txt"])
    assert (found.format, found.unit) == ("qualisys", "mm")
    return found.cameras


def test_qualisys_cameras_stand_around_the_treadmill_and_look_at_it(shared_data: Path) -> None:
    cameras = qualisys(shared_data)
    assert [c.name for c in cameras] == ["cam01", "cam02", "cam03", "cam04"]
    assert all(1.6 < c.position[2] < 2.1 for c in cameras)
    assert all(c.image_size == (1088, 1920) for c in cameras)
    assert cameras[0].position == pytest.approx([1.4602323709, -1.9091590482, 1.8965058524])
    centres, axes = np.array([c.position for c in cameras]), np.array([c.rotation[:, 2] for c in cameras])
    point, along = intersection_point(centres, axes)
    distance = np.linalg.norm(point - centres - along[:, None] * axes, axis=1)
    # The transposed matrix would send the axes past each other by metres.
    assert distance.max() < 0.15
    assert np.hypot(*point[:2]) < 1.5
    assert 0 < point[2] < 1.5


def test_qualisys_axes_are_those_of_an_upright_camera(shared_data: Path) -> None:
    for camera in qualisys(shared_data):
        assert camera.rotation[2, 1] < -0.8  # the image's downwards is the world's downwards
        assert np.linalg.det(camera.rotation) == pytest.approx(1)
        assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-12)


def test_qualisys_four_views_of_the_cap_meet(shared_data: Path) -> None:
    """The coloured cap, found by colour in frame 0 of each view, is triangulated within a few centimetres."""
    cameras = qualisys(shared_data)
    centres = []
    for camera in cameras:
        capture = cv2.VideoCapture(str(shared_data / f"pose2sim_demo/single/videos/{camera.name}.mp4"), cv2.CAP_FFMPEG)
        _, image = capture.read()
        capture.release()
        low, high = (82, 110, 70), (98, 255, 200)
        mask = cv2.morphologyEx(
            cv2.inRange(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), low, high), cv2.MORPH_OPEN, np.ones((7, 7))
        )
        _, _, stats, middles = cv2.connectedComponentsWithStats(mask)
        largest = 1 + int(np.argmax(np.where(stats[1:, 1] < 800, stats[1:, 4], 0)))
        centres.append(middles[largest])
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for camera, pixel in zip(cameras, centres, strict=True):
        ray = camera.rays(pixel[None])[0]
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal, right = normal + across, right + across @ camera.position
    cap = np.linalg.solve(normal, right)
    assert 1.45 < cap[2] < 1.70
    errors = [np.linalg.norm(c.project(cap[None])[0] - p) for c, p in zip(cameras, centres, strict=True)]
    assert np.median(errors) < 15
    assert max(errors) < 25


# --- Tsai


def pets(shared_data: Path) -> Camera:
    found = read_calibration([shared_data / "pets2009_s2l1_view1/calibration/View_001.xml"])
    assert (found.format, found.unit) == ("tsai", "mm")
    return found.cameras[0]


def test_tsai_camera_of_pets_stands_where_it_is_known_to_stand(shared_data: Path) -> None:
    camera = pets(shared_data)
    assert camera.name == "View_001"
    assert camera.position == pytest.approx([-28.9, -19.5, 7.1], abs=0.06)
    assert camera.image_size == (768, 576)
    assert camera.distortion_model == "tsai"


def test_tsai_all_eight_views_are_read_and_look_down_at_the_place(shared_data: Path) -> None:
    cameras = read_calibration([shared_data / "pets2009_s2l1_view1/calibration"]).cameras
    assert [c.name for c in cameras] == [f"View_00{n}" for n in range(1, 9)]
    assert all(c.position[2] > 1.5 and c.rotation[2, 2] < 0 for c in cameras)
    point, along = intersection_point(
        np.array([c.position for c in cameras]), np.array([c.rotation[:, 2] for c in cameras])
    )
    assert (along > 0).all()
    assert np.abs(point[:2]).max() < 12
    assert abs(point[2]) < 0.5


def test_tsai_people_of_pets_have_the_height_of_people(shared_data: Path) -> None:
    """Feet of the true boxes on the ground, heads above them: median 1.75 m (10-90 %: 1.65-1.90)."""
    import xml.etree.ElementTree as ElementTree

    camera = pets(shared_data)
    path = shared_data / "pets2009_s2l1_view1/annotations/PETS2009-S2L1_frames_000-399.xml"
    boxes = np.array([[float(b.get(k) or 0) for k in ("xc", "yc", "h")] for b in ElementTree.parse(path).iter("box")])[
        ::5
    ]
    feet = floor_points(camera, boxes[:, :2] + np.column_stack([0 * boxes[:, 2], boxes[:, 2] / 2]))
    heights = np.linspace(1.2, 2.4, 121)
    points = np.concatenate([np.column_stack([feet, np.full(len(feet), h)]) for h in heights])
    top = camera.project(points)[:, 1].reshape(len(heights), -1)
    measured = heights[np.abs(top - (boxes[:, 1] - boxes[:, 2] / 2)).argmin(axis=0)]
    low, middle, high = np.percentile(measured, [10, 50, 90])
    assert middle == pytest.approx(1.75, abs=0.02)
    assert low == pytest.approx(1.65, abs=0.05)
    assert high == pytest.approx(1.90, abs=0.05)


def test_tsai_projection_is_the_textbook_one(shared_data: Path) -> None:
    """Pixels of world points by Tsai's own formulas, the distortion solved by Newton's method."""
    import xml.etree.ElementTree as ElementTree

    root = ElementTree.parse(shared_data / "pets2009_s2l1_view1/calibration/View_001.xml").getroot()
    values = {k: float(v) for part in root for k, v in part.attrib.items()}
    camera = pets(shared_data)
    for point in ([-6.0, -6.0, 0.0], [-12.0, -3.0, 1.7], [0.0, 0.0, 0.9]):
        x, y, z = rotation_zyx(values["rx"], values["ry"], values["rz"]) @ (np.array(point) * 1000) + [
            values["tx"],
            values["ty"],
            values["tz"],
        ]
        ideal = values["focal"] * np.hypot(x, y) / z
        r = ideal
        for _ in range(50):
            r -= (r + values["kappa1"] * r**3 - ideal) / (1 + 3 * values["kappa1"] * r**2)
        u = values["sx"] * r * x / np.hypot(x, y) / values["dpx"] + values["cx"]
        v = r * y / np.hypot(x, y) / values["dpy"] + values["cy"]
        assert camera.project(np.array([point]))[0] == pytest.approx([u, v], abs=1e-6)


# --- Projection matrices


def cmc(shared_data: Path) -> tuple[Camera, ...]:
    found = read_calibration([shared_data / "cmc_detections/calibration"], options=CMC_SIZE)
    assert (found.format, found.unit) == ("projection", "m")
    return found.cameras


def test_projection_matrices_of_cmc_have_the_stated_centres(shared_data: Path) -> None:
    cameras = cmc(shared_data)
    assert [c.name for c in cameras] == ["cam1", "cam2", "cam3", "cam4"]
    for camera in cameras:
        assert np.linalg.norm(camera.position - CMC_CENTRES[camera.name]) < 0.13
        assert camera.rotation[2, 2] < 0  # points down


def test_projection_matrices_project_as_the_matrix_does(shared_data: Path) -> None:
    points = np.array([[4.0, 1.5, 0.0], [3.0, 2.0, 1.7], [5.5, 1.0, 0.9]])
    for camera in cmc(shared_data):
        matrix = np.loadtxt(shared_data / f"cmc_detections/calibration/{camera.name}_P.txt")
        u, v, w = matrix @ np.column_stack([points, np.ones(3)]).T
        assert np.allclose(camera.project(points), np.column_stack([u / w, v / w]), atol=1e-6)


def test_feet_of_cmc_boxes_meet_on_the_floor(shared_data: Path) -> None:
    """Feet seen by camera 1 and the nearest foot seen by camera 4: median 0.17 m."""
    cameras = {c.name: c for c in cmc(shared_data)}
    feet: dict[tuple[int, str], list[Floats]] = defaultdict(list)
    with (shared_data / "cmc_detections/CMC1_detections.csv").open() as file:
        for row in csv.DictReader(file):
            if float(row["confidence"]) < 0.5:
                continue
            pixel = np.array([[(float(row["left"]) + float(row["right"])) / 2, float(row["bottom"])]])
            name = f"cam{row['camera']}"
            feet[int(row["frame"]), name].append(floor_points(cameras[name], pixel)[0])
    nearest = [
        min(np.linalg.norm(here - there) for there in feet[frame, "cam4"])
        for (frame, name), points in list(feet.items())
        if name == "cam1" and (frame, "cam4") in feet
        for here in points
    ]
    assert np.median(nearest) < 0.25


@pytest.mark.parametrize("seed", range(5))
def test_a_projection_matrix_is_taken_apart_into_what_it_was_made_of(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = np.array([[900 + 100 * rng.random(), 0, 640], [0, 950.0, 360], [0, 0, 1]])
    rotation = checked_rotation(rng.normal(size=3), "")
    centre = rng.normal(size=3) * 5
    matrix = k @ rotation @ np.column_stack([np.eye(3), -centre]) * rng.choice([-3.7, 0.002, 80])
    found = take_apart(matrix)
    for got, want in zip(found, (k, rotation, centre), strict=True):
        assert np.allclose(got, want, atol=1e-8)


# --- TOML


def caliscope(shared_data: Path) -> tuple[Camera, ...]:
    found = read_calibration([shared_data / "caliscope_4cam/session_a/camera_array.toml"])
    assert (found.format, found.unit) == ("opencv-toml", "m")
    return found.cameras


def test_caliscope_corners_reproject(shared_data: Path) -> None:
    """Triangulated board corners against the measured ones: median 0.9-1.5 px in every camera."""
    folder = shared_data / "caliscope_4cam/session_a/calibration/extrinsic/CHARUCO"
    with (folder / "xyz_CHARUCO.csv").open() as file:
        world = {
            (r["sync_index"], r["keypoint_id"]): [float(r[f"{a}_coord"]) for a in "xyz"] for r in csv.DictReader(file)
        }
    seen: dict[str, list[tuple[list[float], list[float]]]] = defaultdict(list)
    with (folder / "xy_CHARUCO.csv").open() as file:
        for r in csv.DictReader(file):
            key = (r["sync_index"], r["keypoint_id"])
            if key in world:
                seen[f"cam_{r['cam_id']}"].append((world[key], [float(r["img_loc_x"]), float(r["img_loc_y"])]))
    cameras = caliscope(shared_data)
    assert [c.name for c in cameras] == ["cam_0", "cam_1", "cam_2", "cam_3"]
    for camera in cameras:
        points, pixels = (np.array(side) for side in zip(*seen[camera.name], strict=True))
        error = np.linalg.norm(camera.project(points) - pixels, axis=1)
        assert len(error) > 100
        assert 0.8 < np.median(error) < 1.6


def test_both_files_of_caliscope_say_the_same(shared_data: Path) -> None:
    other = read_calibration([shared_data / "caliscope_4cam/session_a/config.toml"]).cameras
    for a, b in zip(caliscope(shared_data), other, strict=True):
        assert a.name == b.name
        assert np.allclose(a.position, b.position)
        assert np.allclose(a.rotation, b.rotation)


TOML = """[cam1]
name = "left"
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, -0.05, 0.001, 0.002]
rotation = [1.2, -0.3, 0.4]
translation = [100.0, 200.0, 3000.0]
"""


def test_toml_with_a_rotation_vector_and_a_stated_unit(tmp_path: Path) -> None:
    path = tmp_path / "Calib.toml"
    path.write_text(TOML)
    (camera,) = read_calibration([path], options=CalibrationOptions(unit="mm")).cameras
    rotation, _ = cv2.Rodrigues(np.array([1.2, -0.3, 0.4]))
    assert camera.name == "left"
    assert np.allclose(camera.rotation, rotation.T)
    assert np.allclose(camera.position, -rotation.T @ [0.1, 0.2, 3.0])
    assert camera.distortion.tolist() == [0.1, -0.05, 0.001, 0.002, 0]
    point = np.array([[0.3, -0.2, 0.5]])
    want, _ = cv2.projectPoints(
        point,
        rotation,
        np.array([0.1, 0.2, 3.0]),
        np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]]),
        np.array([0.1, -0.05, 0.001, 0.002]),
    )
    assert np.allclose(camera.project(point), want.reshape(-1, 2), atol=1e-6)


# --- OpenCV FileStorage

STORAGE = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 510., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0.1, -0.05, 0.001, 0.002, 0. ]
rvec: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 1.2, -0.3, 0.4 ]
tvec: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ 0.1, 0.2, 3. ]
"""


def test_opencv_storage_of_version_4_equals_the_toml(tmp_path: Path) -> None:
    (tmp_path / "left.yml").write_text(STORAGE)
    (tmp_path / "left.toml").write_text(TOML)
    storage = read_calibration([tmp_path / "left.yml"])
    assert storage.format == "opencv-storage"
    toml = read_calibration([tmp_path / "left.toml"], options=CalibrationOptions(unit="mm"))
    a, b = storage.cameras[0], toml.cameras[0]
    assert a.name == b.name
    assert np.allclose(a.position, b.position)
    assert np.allclose(a.rotation, b.rotation)
    assert np.allclose(a.distortion, b.distortion)


@pytest.mark.parametrize("value", [".Nan", "-.NAN"])
def test_values_of_a_calibration_that_did_not_converge_are_named(tmp_path: Path, value: str) -> None:
    (tmp_path / "left.yml").write_text(STORAGE.replace("0.002, 0. ]", f"0.002, {value} ]"))
    with pytest.raises(
        InputError, match=rf"left: distortion_coefficients holds {re.escape(value)}, as .*calibrate again"
    ):
        read_calibration([tmp_path / "left.yml"])


@pytest.mark.parametrize("key", ["camera_matrix", "K", "mtx", "cameraMatrix"])
def test_the_matrix_of_opencv_storage_under_the_names_in_use(tmp_path: Path, key: str) -> None:
    (tmp_path / "left.yml").write_text(STORAGE.replace("camera_matrix:", f"{key}:"))
    found = read_calibration([tmp_path / "left.yml"])
    assert found.format == "opencv-storage"
    assert found.cameras[0].focal_px.tolist() == [500, 510]


def test_a_matrix_under_another_name_is_reported_of_with_those_that_are_known(tmp_path: Path) -> None:
    (tmp_path / "left.yml").write_text(STORAGE.replace("camera_matrix:", "lens:"))
    with pytest.raises(
        InputError, match=r"if this file has both, rename its keys: camera matrix camera_matrix, .* mtx, "
    ):
        read_calibration([tmp_path / "left.yml"])


def test_a_calibration_is_no_scene(tmp_path: Path) -> None:
    (tmp_path / "left.yml").write_text(STORAGE)
    with pytest.raises(InputError, match=r"left.yml: a calibration of OpenCV; give it to occlog ingest --calibration"):
        read_scene(tmp_path / "left.yml")


@pytest.mark.parametrize("name", ["cam1.yml", "cam1.xml"])
def test_what_this_opencv_writes_is_read(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([0.1, -0.05, 0.001, 0.002, 0.0]))
    storage.write("rotation_matrix", np.eye(3))
    storage.write("translation", np.array([0.0, 0.0, 2.0]))
    storage.release()
    found = read_calibration([path])
    assert found.format == "opencv-storage"
    assert found.cameras[0].position.tolist() == [0, 0, -2]
    assert found.cameras[0].focal_px.tolist() == [500, 510]
    assert found.cameras[0].distortion.tolist() == [0.1, -0.05, 0.001, 0.002, 0]


# --- Faults


def test_the_echo_tells_format_unit_centres_and_where_the_axes_meet(shared_data: Path) -> None:
    text = describe(read_calibration([shared_data / "pose2sim_demo/single/calibration/Calib.qca.txt"]))
    assert "\n" not in text
    assert text.startswith("calibration: qualisys, mm -> m, right-handed, 4 cameras at cam01 (1.46, -1.91, 1.90)")
    assert "optical axes meet near (-0.94, -0.02, 0.59) and pass it at 0.08 m" in text


FAULTS = [
    ("a.toml", TOML.replace("[500.0, 0.0, 320.0]", "[-500.0, 0.0, 320.0]"), "focal length -500"),
    ("a.toml", TOML.replace("[500.0, 0.0, 320.0]", "[5e10, 0.0, 320.0]"), r"must be 0.001 to 1e\+09"),
    ("a.toml", TOML.replace("320.0]", "nan]"), "finite"),
    ("a.toml", TOML.replace("rotation = [1.2, -0.3, 0.4]", "rotation = [[1,0,0],[0,1,0],[0,0,-1]]"), "mirrored"),
    ("a.toml", TOML.replace("rotation = [1.2, -0.3, 0.4]", "rotation = [[1,0,0],[0,2,0],[0,0,1]]"), "not orthonormal"),
    ("a.toml", TOML.replace("rotation = [1.2, -0.3, 0.4]\n", ""), "no rotation and translation"),
    ("a.toml", TOML.replace("size = [640, 480]\n", ""), "does not state the size of the images"),
    ("a.toml", TOML.replace("0.002]", "0.002, 0, 0.1, 0.2]"), "7 distortion coefficients"),
    ("a.toml", TOML.replace("0.1, -0.05", "-9.1, 4.5"), "has no inverse there"),
    ("a.toml", TOML.replace("0.1, -0.05", "1e90, 0.5"), "has no inverse there"),
    ("a.toml", TOML + TOML.replace("[cam1]", "[cam2]"), "two cameras are named 'left'"),
    ("a.txt", "1 2 3 4\n5 6 7 8\n", "not a calibration of a known format"),
    ("a.txt", "1 2 3 4\n5 6 7 8\n2 4 6 8\n", "camera at infinity"),
    ("a.txt", "", "is empty"),
    ("a.xml", "<Camera name='x'><Geometry/><Intrinsic kappa1='1'", "not XML"),
    ("a.xml", "<Camera name='x'><Geometry/><Intrinsic kappa1='1'/></Camera>", "<Extrinsic> is missing"),
    ("a.xml", "<!DOCTYPE a [<!ENTITY b 'c'>]><Camera><Geometry/><Intrinsic kappa1='1'/></Camera>", "XML entities"),
    ("a.yml", STORAGE.replace("rows: 3\n   cols: 3", "rows: 3\n   cols: 4"), "not a matrix of numbers"),
    ("a.yml", STORAGE.replace("tvec", "whatever"), "has none of t, tvec"),
    ("a.bin", "\udcff\udcfe", "not UTF-8"),
]


@pytest.mark.parametrize(("name", "text", "message"), FAULTS)
def test_a_malformed_calibration_is_one_clear_line(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=message) as caught:
        read_calibration([path], options=CalibrationOptions())
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_format_is_a_usage_error_that_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("x")
    with pytest.raises(UsageError, match=", ".join(IMPORTERS)):
        read_calibration([tmp_path / "a"], "nonsense")


def test_qualisys_view_rotation_is_refused(shared_data: Path, tmp_path: Path) -> None:
    text = (shared_data / "pose2sim_demo/single/calibration/Calib.qca.txt").read_text()
    (tmp_path / "c.txt").write_text(text.replace('viewrotation="0"', 'viewrotation="90"', 1))
    with pytest.raises(InputError, match="camera cam01: viewrotation 90"):
        read_calibration([tmp_path / "c.txt"])


STORED = """%YAML 1.2
---
image_width: 1280
image_height: 720
EXTRA
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [MATRIX]
distortion_coefficients: !!opencv-matrix {rows: 1, cols: 4, dt: d, data: [0.1, 0.0, 0.0, 0.0]}
R: !!opencv-matrix {rows: 3, cols: 3, dt: d, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
T: !!opencv-matrix {rows: 3, cols: 1, dt: d, data: [0, 0, 0]}
"""
PLAIN = "800., 0., 640., 0., 800., 360., 0., 0., 1."


def stored(tmp_path: Path, matrix: str, extra: str = "") -> Path:
    path = tmp_path / "cam.yaml"
    path.write_text(STORED.replace("MATRIX", matrix).replace("EXTRA", extra))
    return path


@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        ("800., 0., 0., 0., 800., 0., 640., 360., 1.", "it is transposed, as MATLAB has it"),
        ("800., 9., 640., 0., 800., 360., 0., 0., 1.", "skew of the camera matrix: 4 px"),
        ("800., 0., 640., 0., 800., 360., 0., 0., 2.", "expected .*fx, 0, cx"),
    ],
)
def test_a_matrix_that_is_none_of_a_camera_is_refused(tmp_path: Path, matrix: str, expected: str) -> None:
    """The principal point of a transposed one was (0, 0), and a skew was not looked at."""
    with pytest.raises(InputError, match=expected):
        read_calibration([stored(tmp_path, matrix)])
    k = np.array([float(cell) for cell in matrix.split(",")]).reshape(3, 3)
    np.savez(tmp_path / "cam.npz", K=k, R=np.eye(3), t=np.zeros(3), image_size=[1280, 720])
    with pytest.raises(InputError, match=expected):
        read_calibration([tmp_path / "cam.npz"])


def test_a_calibration_of_opencv_says_that_its_lens_is_a_fisheye(tmp_path: Path) -> None:
    """Its four coefficients were taken for k1, k2, p1, p2."""
    (camera,) = read_calibration([stored(tmp_path, PLAIN, "fisheye_model: 1")]).cameras
    assert camera.distortion_model == "equidistant"
    (camera,) = read_calibration([stored(tmp_path, PLAIN, "fisheye_model: 0")]).cameras
    assert camera.distortion_model == "brown"
    with pytest.raises(InputError, match="distortion_model scaramuzza is no known lens model"):
        read_calibration([stored(tmp_path, PLAIN, "distortion_model: scaramuzza")])


def test_a_rotation_vector_in_degrees_is_refused() -> None:
    with pytest.raises(InputError, match=r"length 92\.5, limit 2 pi; give radians, not degrees"):
        checked_rotation(np.array([90.0, 20.0, -8.0]), "left.yaml: camera left")
    assert np.allclose(checked_rotation(np.array([0.0, 0.0, np.pi]), ""), np.diag([-1.0, -1.0, 1.0]))
