"""Kalibr's `camchain.yaml`: a chain of cameras, each placed by the one before it.

`T_cn_cnm1` takes points of the camera before to this one; the world is the frame of the first camera.  Where there is
no chain, but `T_cam_imu` of every camera, the world is the frame of the IMU.  Lengths are metres.  Cameras are
`pinhole` with the lens `radtan` (k1, k2, p1, p2), `equidistant` (k1 to k4) or `none`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, abridged, option
from occlog.io.files.texts.yaml import yaml_text
from occlog.records.scene import Camera
from occlog.records.verdicts import finding

from ..common import (
    CALIBRATION,
    CalibrationOptions,
    CameraParameters,
    build_camera,
    keys_of,
    numbers,
    read_text,
    scale_of,
    yaml_values,
)
from ..lenses import Lens, stated_coefficients

KEYS = keys_of(
    "camera_model distortion_model distortion_coeffs intrinsics resolution t_cn_cnm1 t_cam_imu timeshift_cam_imu",
    "cam_overlaps rostopic",  # without effect: which cameras see the same, and where the images came from
)
"""Keys of a camera that are used or noted, or known to be without effect, in small letters."""

_CAMERA = re.compile(r"^cam\d+$")


def detect(text: str) -> bool:
    """Whether a text is a camera chain of Kalibr (camchain.yaml)."""
    return "camera_model:" in text and re.search(r"^cam\d+:", text, re.MULTILINE) is not None


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read the cameras of one Kalibr chain, named cam0, cam1, ...

    Raises:
        InputError: there is a second file, or a camera has no pose or a model that cannot be used.
    """
    if len(paths) > 1:
        raise InputError(
            f"{paths[1]}: a second camera chain; the relative pose of the two is unknown: give one chain",
            id="ambiguous-input",
        )
    values = yaml_values(read_text(paths[0]), paths[0])
    cameras = {key: table for key, table in values.items() if _CAMERA.match(key) and isinstance(table, dict)}
    positions = _places(paths[0], cameras, options)
    options.check_keys(paths[0].name, (key for key in values if key not in cameras), ())
    _note_clocks(cameras, options)
    return tuple(_camera(paths[0], key, table, positions[key], options) for key, table in cameras.items())


def _note_clocks(cameras: Mapping[str, Mapping[str, object]], options: CalibrationOptions) -> None:
    """Add a finding to `options` if cameras have different time shifts (`timeshift_cam_imu`).

    It has the command line options that state them. `cameras` are the mappings of the file by name of the camera.
    """
    shifts = {
        name: float(numbers(t.get("timeshift_cam_imu", 0.0), f"{name}: timeshift_cam_imu"))
        for name, t in cameras.items()
    }
    first = next(iter(shifts.values()), 0.0)
    others = [
        f"{option('clock_offset')} {name}={shift - first:.6g}s" for name, shift in shifts.items() if shift != first
    ]
    if others:
        options.findings.append(finding(CALIBRATION, "time-shifts-unused", options=" ".join(others)))


def _places(path: Path, cameras: Mapping[str, Mapping[str, object]], options: CalibrationOptions) -> dict[str, Floats]:
    """Camera-from-world transforms (4, 4) of the cameras of a Kalibr chain, by name.

    The world is the frame of cam0, or of the IMU if there is no chain; a note in `options` states it.

    Raises:
        InputError: a camera has no pose, or numbers of cameras are missing.
    """
    names = sorted(cameras, key=lambda name: int(name[3:]))
    if names != [f"cam{n}" for n in range(len(names))]:
        raise InputError(
            f"{path}: has {abridged(names)}; a chain has cam0, cam1, ... without a gap", id="unknown-format"
        )
    if all("T_cn_cnm1" in cameras[name] for name in names[1:]):
        options.notes.append("the world is the frame of cam0: x to its right, y down, z forward")
        if any("T_cam_imu" in table for table in cameras.values()):
            options.notes.append("T_cam_imu is not used: the cameras are placed by T_cn_cnm1")
        out = {names[0]: np.eye(4)}
        for before, name in pairwise(names):
            out[name] = _transform(cameras[name], "T_cn_cnm1", f"{path}: {name}") @ out[before]
        return out
    if all("T_cam_imu" in cameras[name] for name in names):
        options.notes.append("the world is the frame of the IMU")
        return {name: _transform(cameras[name], "T_cam_imu", f"{path}: {name}") for name in names}
    lacking = next(name for name in names[1:] if "T_cn_cnm1" not in cameras[name])
    raise InputError(
        f"{path}: {lacking}: has no T_cn_cnm1, so that its position is not known; calibrate all together",
        id="missing-pose",
    )


def _transform(table: Mapping[str, object], key: str, where: str) -> Floats:
    matrix = numbers(table[key], f"{where}: {key}")
    if matrix.shape != (4, 4) or not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise InputError(
            f"{where}: {key} must be four rows of four numbers, the last one 0, 0, 0, 1", id="invalid-calibration"
        )
    return matrix


def _camera(
    path: Path, name: str, table: Mapping[str, object], position: Floats, options: CalibrationOptions
) -> Camera:
    where = f"{path}: camera {name}"
    options.check_keys(name, table, KEYS)
    model, lens = str(table.get("camera_model")), str(table.get("distortion_model", "none"))
    if model != "pinhole":
        raise InputError(
            f"{where}: camera model {model}; only pinhole can be used: calibrate again with pinhole",
            id="unsupported-format",
        )
    intrinsics = numbers(table.get("intrinsics"), f"{where}: intrinsics").reshape(-1)
    size = numbers(table.get("resolution"), f"{where}: resolution").reshape(-1)
    if intrinsics.shape != (4,) or size.shape != (2,):
        raise InputError(
            f"{where}: expected intrinsics of 4 numbers (fu, fv, pu, pv) and a resolution of 2",
            id="invalid-calibration",
        )
    known = {"radtan": ("brown", 4), "equidistant": ("equidistant", 4), "none": ("brown", 0)}
    if lens not in known:
        raise InputError(
            f"{where}: distortion model {lens}; only {', '.join(known)} can be used", id="unsupported-format"
        )
    kind, count = known[lens]
    given = numbers(table.get("distortion_coeffs", []), f"{where}: distortion_coeffs").reshape(-1)
    if count and len(given) != count:
        raise InputError(f"{where}: {len(given)} distortion_coeffs; {lens} has {count}", id="invalid-calibration")
    if not count and given.any():
        raise InputError(
            f"{where}: distortion model none with distortion_coeffs {given.tolist()}; state their model",
            id="invalid-calibration",
        )
    pose = CameraParameters(
        name=name,
        focal_px=intrinsics[:2],
        principal_px=intrinsics[2:],
        rotation=position[:3, :3],
        centre=-position[:3, :3].T @ position[:3, 3] * scale_of(options, "m"),
        image_size=(int(size[0]), int(size[1])),
        lens=Lens(kind, given),
    )
    return build_camera(pose, where, options)


def texts(cameras: Sequence[Camera], late_s: Mapping[str, float]) -> dict[str, str]:
    """Text of `camchain.yaml`, by file name, with the world as the frame of the IMU.

    Args:
        cameras: with positions in metres.
        late_s: clock offset of cameras by name [s]; its negative is written as `timeshift_cam_imu`.
    """
    chain, names = {}, []
    for n, camera in enumerate(cameras):
        where = f"kalibr: camera {camera.name}"
        turn = np.eye(4)
        turn[:3, :3], turn[:3, 3] = camera.extrinsics
        lens = stated_coefficients(camera.distortion_model, camera.distortion, (4,), where)
        names.append(f"# cam{n}: {camera.name}\n")
        chain[f"cam{n}"] = {
            "T_cam_imu": turn.tolist(),
            "camera_model": "pinhole",
            "distortion_coeffs": lens.tolist(),
            "distortion_model": "equidistant" if camera.distortion_model == "equidistant" else "radtan",
            "intrinsics": [*camera.focal_px.tolist(), *camera.principal_px.tolist()],
            "resolution": list(camera.image_size or ()),
            "timeshift_cam_imu": 0.0 - late_s.get(camera.name, 0.0),
        }
    return {"camchain.yaml": "".join(names) + yaml_text(chain)}
