"""TOML calibrations in OpenCV's convention (caliscope, anipose, Pose2Sim).

Each table with `matrix` is a camera: `size`, `distortions` (OpenCV's 4, 5, 8, 12 or 14; 4 with `fisheye`),
`rotation` as a 3 x 3 matrix or a rotation vector, and `translation`, with Xc = R Xw + t.
The files do not state their unit: metres unless stated otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, option
from occlog.io.files.texts.documents import toml_values
from occlog.records.scene import Camera
from occlog.records.verdicts import finding

from ..common import (
    CALIBRATION,
    WHAT,
    CalibrationOptions,
    CameraParameters,
    build_camera,
    centre_of_extrinsics,
    keys_of,
    read_text,
    scale_of,
)
from ..lenses import Lens

KEYS = keys_of(
    "matrix size distortions fisheye rotation translation name ignore rotation_count",
    # Without effect: numbers of the camera, how well it was calibrated, how it was recorded
    "port cam_id error exposure grid_count verified_resolutions",
)
"""Keys of a camera's table that are used, or known to be without effect."""
TABLES = frozenset(("metadata", "adjusted", "error"))
"""Other keys of a file that are without effect."""

MAX_ANGLE = 2.0 * np.pi
"""Greatest length of a rotation vector [rad]."""


def detect(text: str) -> bool:
    """Whether a text is a TOML calibration: it has a table with `matrix`."""
    try:
        return any(True for _ in _tables(toml_values(text, "calibration", WHAT)))
    except InputError:
        return False


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read the cameras of TOML files that are not marked `ignore`, named by `name` or by their table."""
    cameras = []
    for path in paths:
        root = toml_values(read_text(path), path, WHAT)
        options.check_keys(path.name, _others(root), TABLES)
        cameras += [_camera(key, table, path, options) for key, table in _tables(root) if not table.get("ignore")]
    return tuple(cameras)


def _tables(root: Mapping[str, object]) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield name and content of each table that describes a camera (has `matrix`), at the top or second level."""
    for key, value in root.items():
        if not isinstance(value, dict):
            continue
        if "matrix" in value:
            yield key, value
            continue
        for inner, table in value.items():
            if isinstance(table, dict) and "matrix" in table:
                # [cameras.0] has only a number for a name: cam_0, as its videos are called.
                yield (f"cam_{inner}" if inner.isdigit() else inner), table


def _others(root: Mapping[str, object]) -> Iterator[str]:
    """Yield the keys of a file that belong to no camera, for a note on unused keys."""
    cameras = {id(table) for _, table in _tables(root)}
    for key, value in root.items():
        inner = value if isinstance(value, dict) else {}
        if id(value) not in cameras and not any(id(table) in cameras for table in inner.values()):
            yield key
            yield from inner if key == "metadata" else ()


def _camera(key: str, table: dict[str, object], path: Path, options: CalibrationOptions) -> Camera:
    name = str(table.get("name", key))
    where = f"{path}: camera {name}"
    options.check_keys(name, table, KEYS)
    turns = table.get("rotation_count") or 0
    if turns:
        options.findings.append(finding(CALIBRATION, "images-before-rotation", sensors=[name], turns=str(turns)))
    if table.get("rotation") is None or table.get("translation") is None:
        raise InputError(f"{where}: has no rotation and translation; calibrate its pose", id="missing-pose")
    matrix = _array(table, "matrix", where)
    if matrix.shape != (3, 3) or matrix[0, 1] or matrix[1, 0] or matrix[2].tolist() != [0, 0, 1]:
        raise InputError(
            f"{where}: matrix {matrix.tolist()}; expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]",
            id="invalid-calibration",
        )
    rotation = _array(table, "rotation", where)
    if rotation.size == 3:
        rotation = checked_rotation(rotation.reshape(3), where)
    translation = _array(table, "translation", where).reshape(-1)
    if rotation.shape != (3, 3) or translation.shape != (3,):
        raise InputError(
            f"{where}: rotation and translation must have 9 (or 3) and 3 numbers", id="invalid-calibration"
        )
    given = _array(table, "distortions", where) if "distortions" in table else np.zeros(0)
    model: str | None = "equidistant" if table.get("fisheye") else "brown"
    column = given.ndim == 2 and given.shape[1] == 1  # as of cv2.fisheye
    if "fisheye" not in table and (options.lens_model is not None or column):
        model = None
    elif "fisheye" not in table and given.size == 4 and given.any():
        # In this format a lens that is not stated to be a fisheye is none
        options.notes.append(
            f"camera {name}: k1, k2, p1, p2 are assumed, as fisheye is not stated ({option('lens_model')})"
        )
    pose = CameraParameters(
        name=name,
        focal_px=[matrix[0, 0], matrix[1, 1]],
        principal_px=[matrix[0, 2], matrix[1, 2]],
        rotation=rotation,
        centre=centre_of_extrinsics(rotation, translation) * scale_of(options, "m"),
        image_size=_size(table, where),
        lens=Lens(model, given),
    )
    return build_camera(pose, where, options)


def _array(table: dict[str, object], key: str, where: str) -> Floats:
    try:
        return np.array(table[key], dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError(f"{where}: {key} must be numbers in rows of equal length", id="invalid-calibration") from None


def _size(table: dict[str, object], where: str) -> tuple[int, int] | None:
    if "size" not in table:
        return None
    size = _array(table, "size", where).reshape(-1)
    if len(size) != 2 or not np.isfinite(size).all():
        raise InputError(f"{where}: size must be width and height in pixels", id="invalid-calibration")
    return int(size[0]), int(size[1])


def checked_rotation(vector: Floats, where: str) -> Floats:
    """(3, 3) rotation matrix of a rotation vector (3,) [rad] (Rodrigues); InputError for more than a whole turn."""
    angle = float(np.linalg.norm(vector))
    if angle > MAX_ANGLE:
        text = ", ".join(f"{value:.4g}" for value in vector)
        raise InputError(
            f"{where}: rotation vector ({text}) of length {angle:.3g}, limit 2 pi; give radians, not degrees",
            id="invalid-calibration",
        )
    return np.asarray(cv2.Rodrigues(vector)[0])
