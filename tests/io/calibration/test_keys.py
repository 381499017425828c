"""Every key of every reader's sample: a change of it changes the cameras, is noted, is refused, or is listed here.

Keys without effect are those of `WITHOUT_EFFECT`; an unknown key, too, is noted.
"""

from __future__ import annotations

import copy
import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from occlog.errors import InputError, OcclogError
from occlog.io.formats.calibration.common import CalibrationOptions
from occlog.io.formats.calibration.reader import read_calibration
from occlog.records.messages import Severity

POINTS = np.array([[0.3, -0.2, 5.0], [-0.6, 0.4, 6.0], [0.1, 0.7, 4.0]])
WITHOUT_EFFECT = {
    "kalibr": {"cam_overlaps", "rostopic"},
    "ros": {"rectification_matrix", "projection_matrix", "rows", "cols", "do_rectify"},
    "opencv-toml": {"port", "error", "exposure", "grid_count", "verified_resolutions", "adjusted"},
    "opencv-storage": {
        "calibration_time",
        "nframes",
        "board_width",
        "square_size",
        "flags",
        "avg_reprojection_error",
        "dt",
    },
    "qualisys": {
        "avg-residual",
        "calibrated",
        "message",
        "model",
        "point-count",
        "focallength",
        "fov_marker",
        "fov_marker_max",
    },
    "tsai": set(),
    "arrays": {"rms"},
}
"""Keys that may be changed in silence: names, dates, how it was calibrated; shapes of the same numbers."""
MATRIX = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
NONE = {"translation": {"x": 0.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}

KALIBR = {
    f"cam{n}": {
        "camera_model": "pinhole",
        "distortion_model": "radtan",
        "distortion_coeffs": [-0.2, 0.05, 0.001, -0.002],
        "intrinsics": [900.0, 905.0, 640.0, 360.0],
        "resolution": [1280, 720],
        "rostopic": "/image",
        "cam_overlaps": [1 - n],
        "timeshift_cam_imu": 0.01,
        **(
            {"T_cn_cnm1": np.array([[1, 0, 0, -0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]).tolist()} if n else {}
        ),
    }
    for n in (0, 1)
}
ROS = {
    "camera_name": "a",
    "image_width": 1280,
    "image_height": 720,
    "camera_matrix": {"rows": 3, "cols": 3, "data": [v for row in MATRIX for v in row]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.2, 0.05, 0.001, -0.002, 0.0]},
    "rectification_matrix": {"rows": 3, "cols": 3, "data": [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]},
    "projection_matrix": {"rows": 3, "cols": 4, "data": [900.0, 0, 640.0, 0, 0, 900.0, 360.0, 0, 0, 0, 1.0, 0]},
    "binning_x": 0,
    "binning_y": 0,
    "roi": {"x_offset": 0, "y_offset": 0, "width": 0, "height": 0, "do_rectify": False},
}
TOML = {
    "a": {
        "name": "a",
        "port": 1,
        "size": [1280, 720],
        "matrix": MATRIX,
        "distortions": [-0.2, 0.05, 0.001, -0.002, 0.0],
        "fisheye": False,
        "rotation": [0.1, 0.2, 0.3],
        "translation": [0.1, 0.2, 3.0],
        "rotation_count": 0,
        "error": 0.5,
        "exposure": -7,
        "grid_count": 33,
        "ignore": False,
        "verified_resolutions": [[640, 480]],
    },
    "metadata": {"adjusted": False, "error": 0.1},
}
STORAGE = {
    "calibration_time": "2026",
    "nframes": 20,
    "image_width": 1280,
    "image_height": 720,
    "board_width": 9,
    "square_size": 0.03,
    "flags": 0,
    "camera_matrix": {"rows": 3, "cols": 3, "dt": "d", "data": [v for row in MATRIX for v in row]},
    "distortion_coefficients": {"rows": 1, "cols": 5, "dt": "d", "data": [-0.2, 0.05, 0.001, -0.002, 0.0]},
    "fisheye_model": 0,
    "distortion_model": "plumb_bob",
    "rvec": {"rows": 3, "cols": 1, "dt": "d", "data": [0.1, 0.2, 0.3]},
    "tvec": {"rows": 3, "cols": 1, "dt": "d", "data": [0.1, 0.2, 3.0]},
    "avg_reprojection_error": 0.3,
}
ARRAYS = {"K": MATRIX, "R": [0.1, 0.2, 0.3], "t": [0.1, 0.2, 3.0], "dist": [-0.2, 0.05, 0.001, -0.002, 0.0]}
ARRAYS |= {"image_size": [1280, 720], "rms": 0.2, "fisheye": 0}
QUALISYS = """<calibration created="2023" qtm-version="2023.1"><cameras>
<camera active="1" avg-residual="0.4" calibrated="true" message="" model="Miqus" point-count="9" serial="a"
 viewrotation="0" video_resolution="1080p">
<fov_marker bottom="1087" left="0" right="1919" top="0"/><fov_marker_max bottom="1087" left="0" right="1919" top="0"/>
<fov_video bottom="1087" left="0" right="1919" top="0"/><fov_video_max bottom="1087" left="0" right="1919" top="0"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1" x="1460" y="-1909" z="1896"/>
<intrinsic centerPointU="61440" centerPointV="34816" focalLengthU="107599" focalLengthV="107588" focallength="9.3"
 radialDistortion1="-0.04" radialDistortion2="0.1" radialDistortion3="0.0" sensorMaxU="122816" sensorMaxV="69568"
 sensorMinU="0.0" sensorMinV="0.0" skew="0.0" tangentalDistortion1="0.0006" tangentalDistortion2="0.0007"/>
</camera></cameras></calibration>"""
TSAI = """<Camera name="a">
<Geometry width="768" height="576" ncx="795" nfx="752" dx="4.85e-3" dy="4.65e-3" dpx="5.1273e-3" dpy="4.65e-3"/>
<Intrinsic focal="5.55" kappa1="5.1e-3" cx="324" cy="282" sx="1.09"/>
<Extrinsic tx="828" ty="-3175" tz="35469" rx="2.04" ry="-0.89" rz="-0.43"/></Camera>"""

Tree = dict[str, object]


def changed(value: object) -> object:
    """Another value of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 2
    if isinstance(value, float):
        return value + 0.05
    if isinstance(value, list):
        return [changed(value[0]), *value[1:]]
    return f"{value}x"


def mutants(tree: Tree, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Tree]]:
    """Each key of a nested sample, with the sample in which its value is another one, and with one key more."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from ((name, {**tree, key: inner}) for name, inner in mutants(value, (*path, key)))
        else:
            yield (path[-1] if key == "data" else key), {**tree, key: changed(value)}
    if "data" not in tree:  # a matrix has no other keys
        yield "sensor_mode", {**tree, "sensor_mode": 3}


def elements(text: str) -> Iterator[tuple[str, str]]:
    """As `mutants`, of the attributes of XML."""
    for n, each in enumerate(ElementTree.fromstring(text).iter()):
        if each.tag in ("calibration", "cameras"):  # when and with what all were calibrated
            continue
        for key, value in [*each.attrib.items(), ("sensor_mode", "")]:
            root = ElementTree.fromstring(text)
            number = value.replace(".", "").replace("-", "").replace("e", "").isdecimal()
            list(root.iter())[n].set(key, repr(1.5 * float(value) + 300.0) if number else f"{value}x")
            yield (
                (each.tag if each.tag.startswith("fov_marker") else key),
                ElementTree.tostring(root, encoding="unicode"),
            )


def write_yaml(name: str) -> Callable[[Path, Tree], list[Path]]:
    def write(folder: Path, tree: Tree) -> list[Path]:
        (folder / name).write_text(yaml.safe_dump(tree))
        return [folder / name]

    return write


def write_ros(folder: Path, tree: Tree) -> list[Path]:
    (folder / "a.yaml").write_text(yaml.safe_dump(tree))
    transform = {"header": {"frame_id": "map"}, "child_frame_id": "a_optical_frame", "transform": NONE}
    (folder / "tf.yaml").write_text(yaml.safe_dump({"transforms": [transform]}))
    return [folder / "a.yaml", folder / "tf.yaml"]


def write_toml(folder: Path, tree: Tree) -> list[Path]:
    lines: list[str] = [f"{key} = {json.dumps(v)}" for key, v in tree.items() if not isinstance(v, dict)]
    for table, values in tree.items():
        if isinstance(values, dict):
            lines += [f"[{table}]", *(f"{key} = {json.dumps(v)}" for key, v in values.items())]
    (folder / "a.toml").write_text("\n".join(lines) + "\n")
    return [folder / "a.toml"]


def write_storage(folder: Path, tree: Tree) -> list[Path]:
    typed = {key: {"type_id": "opencv-matrix", **v} if isinstance(v, dict) else v for key, v in tree.items()}
    (folder / "a.json").write_text(json.dumps(typed))
    return [folder / "a.json"]


def write_arrays(folder: Path, tree: Tree) -> list[Path]:
    np.savez(folder / "a.npz", **{key: np.array(value) for key, value in tree.items()})  # type: ignore[arg-type]
    return [folder / "a.npz"]


def write_text(folder: Path, tree: str) -> list[Path]:
    (folder / "a.xml").write_text(tree)
    return [folder / "a.xml"]


SAMPLES: dict[str, tuple[Tree | str, Callable[[Path, Tree | str], list[Path]]]] = {
    "kalibr": (KALIBR, write_yaml("chain.yaml")),  # type: ignore[dict-item]
    "ros": (ROS, write_ros),  # type: ignore[dict-item]
    "opencv-toml": (TOML, write_toml),  # type: ignore[dict-item]
    "opencv-storage": (STORAGE, write_storage),  # type: ignore[dict-item]
    "arrays": (ARRAYS, write_arrays),  # type: ignore[dict-item]
    "qualisys": (QUALISYS, write_text),  # type: ignore[dict-item]
    "tsai": (TSAI, write_text),  # type: ignore[dict-item]
}


def outcome(paths: list[Path], format: str) -> str:
    """What a user gets: the cameras' projections and names with the notes, or the error."""
    try:
        found = read_calibration(paths, format, CalibrationOptions())
    except OcclogError as error:
        return f"refused: {error}"
    with np.errstate(all="ignore"):
        cameras = [
            (
                c.name,
                c.image_size,
                np.round(c.project(c.position + POINTS @ c.rotation.T), 6).tolist(),
                c.position.tolist(),
            )
            for c in found.cameras
        ]
    texts = [check.text for check in found.checks if check.found]
    return repr((cameras, [c.rotation.round(9).tolist() for c in found.cameras], found.notes, texts))


@pytest.mark.parametrize("format", SAMPLES)
def test_no_key_is_changed_in_silence(tmp_path: Path, format: str) -> None:
    sample, write = SAMPLES[format]
    plain = outcome(write(tmp_path, copy.deepcopy(sample)), format)
    assert not plain.startswith("refused"), plain
    assert plain.endswith(", [])")
    tried = list(elements(sample) if isinstance(sample, str) else mutants(sample))
    assert len(tried) > 7
    silent = {key for key, mutant in tried if outcome(write(tmp_path, mutant), format) == plain}
    assert silent == WITHOUT_EFFECT[format] & {key for key, _ in tried}


def test_unused_keys_are_a_warning_where_they_may_change_a_camera_and_else_a_note(tmp_path: Path) -> None:
    path = tmp_path / "cam.yaml"
    cameras = {name: {**camera, "distorsion": [0.1], "serial": 7} for name, camera in KALIBR.items()}
    path.write_text(yaml.safe_dump(cameras))
    found = {check.id: check for check in read_calibration([path], "kalibr").checks if check.found}
    assert {(name, check.severity) for name, check in found.items()} == {
        ("calibration-keys-unused", Severity.WARNING),
        ("calibration-keys-other", Severity.NOTE),
    }
    assert "distorsion" in found["calibration-keys-unused"].text
    assert "serial" in found["calibration-keys-other"].text


@pytest.mark.parametrize(
    ("places", "message"),
    [
        (
            [("a_optical_frame", "map", 1.0)],
            "frame a_optical_frame is only a parent in the transforms .of map.; if parent",
        ),
        (
            [("map", "a_optical_frame", 0.0), ("map", "a_optical_frame", 2.0)],
            r"in 'map': at .0, 0, 0. and .2, 0, 0., 2 m",
        ),
        (
            [("map", "a_optical_frame", 0.0), ("odom", "a_optical_frame", 0.0), ("map", "odom", 0.0)],
            "several parents, map and",
        ),
        ([("map", "a_optical_frame", 0.0), ("map", "a_optical_frame", 0.01), ("map", "b", 0.0), ("map", "b", 9.0)], ""),
    ],
)
def test_transforms_of_ros_that_contradict_each_other_are_named(
    tmp_path: Path, places: list[tuple[str, str, float]], message: str
) -> None:
    """Only those that a camera needs."""
    paths = write_ros(tmp_path, ROS)
    several = [
        {"frame_id": parent, "child_frame_id": child, **NONE, "translation": [x, 0.0, 0.0]}
        for parent, child, x in places
    ]
    paths[1].write_text(yaml.safe_dump(several))
    if not message:
        assert len(read_calibration(paths).cameras) == 1
        return
    with pytest.raises(InputError, match=message):
        read_calibration(paths)
