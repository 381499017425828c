"""Calibrations of rigs: what was written is read as the same cameras, and what cannot be is refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
import yaml
from scipy.io import savemat

from occlog.array_types import Floats
from occlog.errors import InputError, OcclogError
from occlog.ingest.rig import describe
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import CalibrationFile, read_calibration
from occlog.records.scene import Camera

SIZE = (640, 480)
BROWN = np.array([-0.2, 0.05, 0.001, -0.002, 0.0])
FISHEYE = np.array([-0.02, 0.03, -0.02, 0.004])
POINTS = np.random.default_rng(3).uniform([-1, -1, 0], [1, 1, 2], (40, 3))


class View(NamedTuple):
    """A camera with Xc = R Xw + t."""

    name: str
    matrix: Floats
    rotation: Floats
    translation: Floats


def rig(n: int = 3) -> list[View]:
    """Cameras around the origin that point at it from above."""
    out = []
    for k in range(n):
        angle = 2 * np.pi * k / n + 0.3
        centre = np.array([4 * np.cos(angle), 5 * np.sin(angle), 2.5])
        forward = np.array([0, 0, 1]) - centre
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right = right / np.linalg.norm(right)
        rotation = np.array([right, np.cross(forward, right), forward])
        matrix = np.array([[500.0 + k, 0, 320], [0, 505, 238.5], [0, 0, 1]])
        out.append(View(f"cam{k}", matrix, rotation, -rotation @ centre))
    return out


def check(
    found: CalibrationFile, views: list[View], lens: Floats, *, fisheye: bool = False, near: float = 1e-6
) -> None:
    """Each camera has its name, size and centre, and projects points as OpenCV does."""
    assert [c.name for c in found.cameras] == [v.name for v in views]
    for camera, view in zip(found.cameras, views, strict=True):
        assert camera.image_size == SIZE
        assert camera.position == pytest.approx(-view.rotation.T @ view.translation, abs=1e-9)
        project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
        turn = cv2.Rodrigues(view.rotation)[0]
        if fisheye:
            want = project(POINTS[:, None], turn, view.translation, view.matrix, lens)[0][:, 0]
        else:
            want = project(POINTS, turn, view.translation, view.matrix, lens)[0][:, 0]
        assert np.abs(camera.project(POINTS) - want).max() < near


def rows(matrix: Floats) -> list[list[float]]:
    return [[float(v) for v in row] for row in matrix]


def kalibr(path: Path, views: list[View], lens: Floats, model: str = "radtan") -> Path:
    """A camera chain; its world is the frame of the first camera."""
    chain: dict[str, dict[str, object]] = {}
    before = np.eye(4)
    for view in views:
        here = np.eye(4)
        here[:3, :3], here[:3, 3] = view.rotation, view.translation
        k = view.matrix
        chain[view.name] = {
            "camera_model": "pinhole",
            "distortion_coeffs": [float(v) for v in lens[:4]],
            "distortion_model": model,
            "intrinsics": [float(v) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])],
            "resolution": list(SIZE),
            "rostopic": f"/{view.name}/image_raw",
        }
        if view is not views[0]:
            chain[view.name]["T_cn_cnm1"] = rows(here @ np.linalg.inv(before))
        before = here
    path.write_text(yaml.safe_dump(chain))
    return path


def seen_by_first(views: list[View]) -> list[View]:
    """The rig in the frame of its first camera."""
    first = views[0]
    return [
        v._replace(
            rotation=v.rotation @ first.rotation.T,
            translation=v.translation - v.rotation @ first.rotation.T @ first.translation,
        )
        for v in views
    ]


def test_places_by_the_imu_next_to_a_chain_of_kalibr_are_reported_to_be_unused(tmp_path: Path) -> None:
    path = kalibr(tmp_path / "camchain.yaml", rig(), BROWN)
    chain = read_calibration([path])
    assert not any("T_cam_imu" in note for note in chain.notes)
    tables = yaml.safe_load(path.read_text())
    for table in tables.values():
        table["T_cam_imu"] = rows(np.diag([-1.0, -1.0, 1.0, 1.0]))
    path.write_text(yaml.safe_dump(tables))
    both = read_calibration([path])
    assert any("T_cam_imu is not used: the cameras are placed by T_cn_cnm1" in note for note in both.notes)
    for camera, alone in zip(both.cameras, chain.cameras, strict=True):
        np.testing.assert_array_equal(camera.position, alone.position)


@pytest.mark.parametrize(("lens", "model"), [(BROWN, "radtan"), (FISHEYE, "equidistant"), (BROWN * 0, "none")])
def test_a_chain_of_kalibr_is_followed_from_its_first_camera(tmp_path: Path, lens: Floats, model: str) -> None:
    views = rig()
    found = read_calibration([kalibr(tmp_path / "camchain.yaml", views, lens, model)])
    assert (found.format, found.unit) == ("kalibr", "m")
    assert any("frame of cam0" in note for note in found.notes)
    moved = seen_by_first(views)
    for camera, view in zip(found.cameras, moved, strict=True):
        assert camera.position == pytest.approx(-view.rotation.T @ view.translation, abs=1e-9)
    world = (views[0].rotation @ POINTS.T).T + views[0].translation
    for camera, view in zip(found.cameras, views, strict=True):
        turn = cv2.Rodrigues(view.rotation)[0]
        if model == "equidistant":
            want = cv2.fisheye.projectPoints(POINTS[:, None], turn, view.translation, view.matrix, lens)[0][:, 0]
        else:
            want = cv2.projectPoints(POINTS, turn, view.translation, view.matrix, lens)[0][:, 0]
        assert np.abs(camera.project(world) - want).max() < 1e-6


def transforms(views: list[View]) -> dict[str, object]:
    """What `ros2 topic echo` prints of the optical frames, by way of a mast."""
    from scipy.spatial.transform import Rotation

    mast = {"x": 0.0, "y": 0.0, "z": 1.0}
    none = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    out = [
        {"header": {"frame_id": "map"}, "child_frame_id": "mast", "transform": {"translation": mast, "rotation": none}}
    ]
    for v in views:
        centre = -v.rotation.T @ v.translation - [0, 0, 1]
        q = Rotation.from_matrix(v.rotation.T).as_quat()
        place = {
            "translation": dict(zip("xyz", map(float, centre), strict=True)),
            "rotation": dict(zip("xyzw", map(float, q), strict=True)),
        }
        out.append({"header": {"frame_id": "mast"}, "child_frame_id": f"{v.name}_optical_frame", "transform": place})
    return {"transforms": out}


def camera_info(view: View, lens: Floats, model: str) -> dict[str, object]:
    return {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "camera_name": view.name,
        "camera_matrix": {"rows": 3, "cols": 3, "data": [float(v) for v in view.matrix.ravel()]},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": len(lens), "data": [float(v) for v in lens]},
    }


RATIONAL = np.array([0.3, -0.05, 0.001, -0.002, 0.002, 0.35, 0.02, -0.001])


@pytest.mark.parametrize(
    ("lens", "model", "near"),
    [(BROWN, "plumb_bob", 1e-6), (FISHEYE, "equidistant", 1e-6), (RATIONAL, "rational_polynomial", 0.5)],
)
def test_camera_info_of_ros_is_placed_by_transforms_to_optical_frames(
    tmp_path: Path, lens: Floats, model: str, near: float
) -> None:
    views = rig()
    (tmp_path / "tf_static.yaml").write_text(yaml.safe_dump(transforms(views)))
    for view in views:
        (tmp_path / f"{view.name}.yaml").write_text(yaml.safe_dump(camera_info(view, lens, model)))
    found = read_calibration([tmp_path])
    assert found.format == "ros"
    check(found, views, lens, fisheye=model == "equidistant", near=near)
    assert any("the world is the frame map" in note for note in found.notes)


def test_the_message_of_ros_names_its_frame(tmp_path: Path) -> None:
    views = rig(1)
    info = {
        "header": {"frame_id": "cam0_optical_frame"},
        "height": SIZE[1],
        "width": SIZE[0],
        "distortion_model": "plumb_bob",
        "d": BROWN.tolist(),
        "k": views[0].matrix.ravel().tolist(),
    }
    text = yaml.safe_dump(info) + "---\n" + yaml.safe_dump(transforms(views)) + "---\n"
    (tmp_path / "echo.yaml").write_text(text)
    check(read_calibration([tmp_path / "echo.yaml"]), views, BROWN)


def storage(view: View, ending: str, *, parts: str = "all") -> str:
    """What OpenCV writes (its version 5 where it is not YAML)."""
    store = cv2.FileStorage(ending, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    if parts != "place":
        store.write("camera_matrix", view.matrix)
        store.write("dist_coeffs", BROWN)
        store.write("image_width", SIZE[0])
        store.write("image_height", SIZE[1])
    if parts != "lens":
        store.write("rvec", cv2.Rodrigues(view.rotation)[0])
        store.write("tvec", view.translation)
    return str(store.releaseAndGetString())


@pytest.mark.parametrize("ending", [".yml", ".xml", ".json"])
def test_storage_of_opencv_is_read_in_every_ending_and_in_both_versions(tmp_path: Path, ending: str) -> None:
    for view in rig():
        text = storage(view, ending)
        if view.name == "cam1":
            # As version 4 writes the head, and one-dimensional arrays
            text = text.replace("%YAML 1.2", "%YAML:1.0")
        (tmp_path / f"{view.name}{ending}").write_text(text)
    found = read_calibration([tmp_path])
    assert found.format == "opencv-storage"
    check(found, rig(), BROWN)


def test_pairs_of_files_are_joined_by_their_names(tmp_path: Path) -> None:
    for view in rig():
        (tmp_path / f"intr_{view.name}.xml").write_text(storage(view, ".xml", parts="lens"))
        (tmp_path / f"{view.name}_extrinsics.yml").write_text(storage(view, ".yml", parts="place"))
    found = read_calibration([tmp_path])
    assert (found.format, found.unit) == ("opencv-pairs", "m")
    check(found, rig(), BROWN)
    (tmp_path / "intr_cam1.xml").unlink()
    with pytest.raises(InputError, match="camera cam1 has no intrinsic file"):
        read_calibration([tmp_path])


def wildtrack(folder: Path) -> list[View]:
    """WILDTRACK's folder of calibrations, in cm and as plain text; the rig in metres."""
    names = [*(f"CVLab{n}" for n in range(1, 5)), *(f"IDIAP{n}" for n in range(1, 4))]
    views = rig(7)
    for part in ("extrinsic", "intrinsic_zero", "intrinsic_original"):
        (folder / part).mkdir(parents=True)
    for view, name in zip(views, names, strict=True):
        rvec = " ".join(map(repr, cv2.Rodrigues(view.rotation)[0].ravel().tolist()))
        tvec = " ".join(map(repr, (view.translation * 100).tolist()))
        place = f"<opencv_storage>\n<rvec>\n  {rvec}</rvec>\n<tvec>\n  {tvec}</tvec>\n"
        place = '<?xml version="1.0"?>\n' + place + "</opencv_storage>\n"
        (folder / "extrinsic" / f"extr_{name}.xml").write_text(place)
        lens = storage(view, ".xml", parts="lens")
        (folder / "intrinsic_original" / f"intr_{name}.xml").write_text(lens)
        for key in ("dist_coeffs", "image_width", "image_height"):
            lens = lens.replace(f"<{key}", f"<no_{key}").replace(f"</{key}", f"</no_{key}")
        (folder / "intrinsic_zero" / f"intr_{name}.xml").write_text(lens)
    return [v._replace(name=f"C{k + 1}") for k, v in enumerate(views)]


def test_wildtracks_calibrations_are_in_cm_and_named_as_its_images(tmp_path: Path) -> None:
    views = wildtrack(tmp_path / "calibrations")
    found = read_calibration([tmp_path / "calibrations"])
    assert (found.format, found.unit) == ("opencv-pairs", "cm")
    assert [c.name for c in found.cameras] == [f"C{n}" for n in range(1, 8)]
    for camera, view in zip(found.cameras, views, strict=True):
        assert camera.image_size == (1920, 1080)
        assert camera.position == pytest.approx(-view.rotation.T @ view.translation, abs=1e-9)
        assert not camera.distortion.any()
    assert "opencv-pairs, cm -> m, right-handed, 7 cameras at C1" in describe(found)


def colmap(folder: Path, views: list[View], model: str = "OPENCV") -> Path:
    from scipy.spatial.transform import Rotation

    cameras, images = ["# Camera list"], ["# Image list: IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"]
    for n, v in enumerate(views, start=1):
        k = v.matrix
        numbers = [k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5, *BROWN[:4]]
        cameras.append(f"{n} {model} {SIZE[0]} {SIZE[1]} " + " ".join(map(repr, map(float, numbers))))
        x, y, z, w = Rotation.from_matrix(v.rotation).as_quat()
        pose = " ".join(map(repr, map(float, (w, x, y, z, *v.translation))))
        images += [f"{n} {pose} {n} {v.name}/000001.jpg", "1.5 2.5 -1" if n == 1 else ""]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text("\n".join(cameras) + "\n")
    (folder / "images.txt").write_text("\n".join(images) + "\n")
    return folder


def test_a_model_of_colmap_needs_its_unit(tmp_path: Path) -> None:
    folder = colmap(tmp_path / "sparse", rig())
    with pytest.raises(OcclogError, match="COLMAP's lengths have no unit"):
        read_calibration([folder])
    check(read_calibration([folder], options=CalibrationOptions(unit="m")), rig(), BROWN)
    with pytest.raises(InputError, match="model THIN_PRISM_FISHEYE; only"):
        read_calibration([colmap(folder, rig(), "THIN_PRISM_FISHEYE")], "colmap", CalibrationOptions(unit="m"))


def projection(view: View) -> Floats:
    return view.matrix @ np.column_stack([view.rotation, view.translation])


@pytest.mark.parametrize("write", [np.savez, lambda path, **arrays: savemat(str(path), arrays)])
@pytest.mark.parametrize("form", ["stack", "parts", "named", "transposed"])
def test_arrays_of_numpy_and_matlab_hold_matrices_of_all_cameras(
    tmp_path: Path, write: Callable[..., None], form: str
) -> None:
    views = rig(4)
    p = np.array([projection(v) for v in views])
    forms = {
        "stack": {"P": p},
        "transposed": {"P": np.moveaxis(p, 0, 2)},
        "named": {v.name: m for v, m in zip(views, p, strict=True)},
        "parts": {
            "K": np.array([v.matrix for v in views]),
            "R": np.array([v.rotation for v in views]),
            "t": np.array([v.translation for v in views]),
            "dist": np.tile(BROWN, (4, 1)),
        },
    }
    path = tmp_path / ("c.npz" if write is np.savez else "c.mat")
    write(path, image_size=np.array(SIZE), **forms[form])
    found = read_calibration([path], options=CalibrationOptions(image_size=SIZE))
    names = views if form == "named" else [v._replace(name=f"cam{k + 1}") for k, v in enumerate(views)]
    check(found, names, BROWN if form == "parts" else BROWN * 0)


def chain(change: Callable[[dict[str, dict[str, object]]], object]) -> Callable[[Path], Path]:
    """A camera chain with one change."""

    def make(folder: Path) -> Path:
        path = kalibr(folder / "camchain.yaml", rig(), BROWN)
        values = yaml.safe_load(path.read_text())
        change(values)
        path.write_text(yaml.safe_dump(values))
        return path

    return make


def arrays(**values: object) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        np.savez(folder / "c.npz", **{key: np.asarray(value) for key, value in values.items()})  # type: ignore[arg-type]
        return folder / "c.npz"

    return make


def file(name: str, content: str | bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / name

    return make


MIRROR = np.diag([1.0, 1.0, -1.0])
ONE = rig(1)[0]
LEFT = ONE._replace(name="left")
FAULTS: list[tuple[Callable[[Path], Path], str]] = [
    (chain(lambda c: c["cam1"].update(camera_model="omni")), "camera cam1: camera model omni; only pinhole"),
    (chain(lambda c: c["cam1"].update(distortion_model="fov")), "distortion model fov; only radtan"),
    (chain(lambda c: c["cam1"].pop("T_cn_cnm1")), "cam1: has no T_cn_cnm1"),
    (chain(lambda c: c.pop("cam1")), "has cam0, cam2; a chain has"),
    (chain(lambda c: c["cam1"].update(T_cn_cnm1=[[1, 0], [0, 1]])), "four rows of four"),
    (chain(lambda c: c["cam2"].update(T_cn_cnm1=rows(np.diag([1, 1, -1, 1])))), "cam2: the rotation matrix is mirr"),
    (chain(lambda c: c["cam2"].update(T_cn_cnm1=rows(np.diag([2, 1, 1, 1])))), "not orthonormal"),
    (chain(lambda c: c["cam0"].update(distortion_coeffs=[1.0])), "1 distortion_coeffs; radtan has 4"),
    (file("c.yaml", yaml.safe_dump(camera_info(ONE, BROWN, "plumb_bob"))), "give the static transforms"),
    (file("c.yaml", yaml.safe_dump(transforms([ONE]))), "transforms without cameras"),
    (
        file("c.yaml", yaml.safe_dump_all([camera_info(LEFT, BROWN, "plumb_bob"), transforms([ONE])])),
        "exactly one frame left_optical_frame",
    ),
    (file("c.yaml", yaml.safe_dump_all([camera_info(ONE, BROWN, "fov"), transforms([ONE])])), "distortion model fov"),
    (file("c.mat", b"MATLAB 7.3 MAT-file" + b" " * 493 + b"\x89HDF\r\n\x1a\n"), "version 7.3 .*'-v7'"),
    (file("c.mat", b"nonsense" * 40), "cannot be read as arrays"),
    (arrays(P=np.zeros((3, 4))), "at infinity"),
    (arrays(Q=np.zeros((5, 5))), r"has Q \(5, 5\); expected P"),
    (arrays(K=ONE.matrix, t=ONE.translation), "has K, but no R"),
    (arrays(K=ONE.matrix, R=MIRROR @ ONE.rotation, t=ONE.translation), "mirrored"),
    (arrays(P=np.full((3, 4), np.nan)), "not finite"),
    (arrays(K=np.tile(ONE.matrix, (3, 1, 1)), R=np.tile(np.eye(3), (3, 1, 1)), t=np.eye(3)), "ambiguous"),
    (file("c.npz", b"PK\x03\x04 broken"), "cannot be read as arrays"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "message"), FAULTS)
def test_what_cannot_be_is_refused_by_name(tmp_path: Path, make: Callable[[Path], Path], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_calibration([make(tmp_path)], options=CalibrationOptions(image_size=SIZE))


def test_one_camera_in_millimetres_is_named(tmp_path: Path) -> None:
    views = rig()
    for n, view in enumerate(views):
        changed = view._replace(translation=view.translation * 1000) if n == 1 else view
        np.savez(tmp_path / f"{view.name}.npz", P=projection(changed))
    found = read_calibration([tmp_path], options=CalibrationOptions(image_size=SIZE))
    assert [(check.id, check.sensors) for check in found.checks if check.found] == [
        ("camera-unit-differs", (views[1].name,))
    ]


def test_cameras_that_are_kilometres_apart_are_doubted(tmp_path: Path) -> None:
    views = [v._replace(translation=v.translation * 1000) for v in rig()]
    for view in views:
        np.savez(tmp_path / f"{view.name}.npz", P=projection(view))
    found = read_calibration([tmp_path], options=CalibrationOptions(image_size=SIZE))
    assert [check.id for check in found.checks] == ["camera-distances-implausible"]
    nearer = read_calibration([tmp_path], options=CalibrationOptions(image_size=SIZE, unit="mm"))
    assert not nearer.notes
    assert [check.status for check in nearer.checks] == ["passed"]


def test_caliscopes_fisheye_is_an_equidistant_lens(tmp_path: Path) -> None:
    view = rig(1)[0]
    values = {
        "size": list(SIZE),
        "matrix": rows(view.matrix),
        "distortions": FISHEYE.tolist(),
        "rotation": rows(view.rotation),
        "translation": view.translation.tolist(),
    }
    text = "[cam0]\nfisheye = true\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())
    (tmp_path / "camera_array.toml").write_text(text)
    check(read_calibration([tmp_path / "camera_array.toml"]), [view], FISHEYE, fisheye=True)


def test_a_fisheye_camera_gives_back_its_pixels() -> None:
    camera = Camera("c", np.zeros(3), np.eye(3), np.array([400.0, 400]), np.array([320.0, 240]), SIZE)
    from dataclasses import replace

    camera = replace(camera, distortion=np.array([*FISHEYE, 0]), distortion_model="equidistant")
    pixels = np.random.default_rng(0).uniform([0, 0], SIZE, (100, 2))
    assert np.abs(camera.project(camera.rays(pixels)) - pixels).max() < 1e-9
