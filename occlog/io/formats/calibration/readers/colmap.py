"""COLMAP's text model: `cameras.txt` with lenses, `images.txt` with positions.

Each image is a camera of the rig, named after the image's folder, or else after the image; several images of a camera
that stands still are one.  Xc = R Xw + t; pixels count
from the corner of the image, half a pixel before the centre of the first one.  A model from images alone has no unit:
it must be stated after the model was scaled.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, UsageError, option
from occlog.records.scene import Camera

from ..common import CalibrationOptions, CameraParameters, build_camera, centre_of_extrinsics, read_text, scale_of
from ..lenses import Lens, stated_coefficients
from .ros import quaternion_rotation, rotation_quaternion

NAMES = ("cameras.txt", "images.txt")
MAX_IMAGES = 2_000
"""Images of a model that are read, in some seconds."""
MODELS = {
    "SIMPLE_PINHOLE": ("f cx cy", "brown", ""),
    "PINHOLE": ("fx fy cx cy", "brown", ""),
    "SIMPLE_RADIAL": ("f cx cy k1", "brown", "k1"),
    "RADIAL": ("f cx cy k1 k2", "brown", "k1 k2"),
    "OPENCV": ("fx fy cx cy k1 k2 p1 p2", "brown", "k1 k2 p1 p2"),
    "SIMPLE_RADIAL_FISHEYE": ("f cx cy k1", "equidistant", "k1"),
    "RADIAL_FISHEYE": ("f cx cy k1 k2", "equidistant", "k1 k2"),
    "OPENCV_FISHEYE": ("fx fy cx cy k1 k2 k3 k4", "equidistant", "k1 k2 k3 k4"),
    "FULL_OPENCV": ("fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6", "brown", "k1 k2 p1 p2 k3 k4 k5 k6"),
}
"""Parameters of each model, our lens, and its coefficients."""
WRITTEN = {0: "PINHOLE", 4: "OPENCV", 8: "FULL_OPENCV"}
"""Models of polynomial lenses that are written, by the number of coefficients."""


class _Lens(NamedTuple):
    size: tuple[int, int]
    focal: Floats
    principal: Floats
    lens: Lens


SAME_SHARE, SAME_RAD = 0.01, np.radians(0.5)
"""Images of one camera may be apart by this share of the distance between cameras, and be turned by this angle."""


def folder_files(path: Path) -> list[Path] | None:
    """Paths of `cameras.txt` and `images.txt` of a COLMAP model in a folder; None without a model.

    Raises:
        InputError: the model is binary.
    """
    if (path / "cameras.bin").is_file() and not (path / "cameras.txt").is_file():
        raise InputError(
            f"{path}: a binary model of COLMAP; write it as text: colmap model_converter --output_type TXT",
            id="unsupported-format",
        )
    return [path / name for name in NAMES] if all((path / name).is_file() for name in NAMES) else None


def detect(text: str) -> bool:
    """Whether a text is one of the two files of COLMAP's text model."""
    return any(f" {model} " in text for model in MODELS) or "QW, QX, QY, QZ" in text


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read the images of a COLMAP text model as cameras, named by their folders or files.

    Images of one camera count once.

    Args:
        paths: `cameras.txt` and `images.txt`.
        options: must state the unit of lengths.

    Raises:
        InputError: a file is missing, damaged, or has images of a moving camera.
        UsageError: the unit of lengths is not stated.
    """
    files = {path.name: path for path in paths}
    if set(NAMES) - files.keys():
        raise InputError(f"{paths[0]}: COLMAP's model has {' and '.join(NAMES)}; give both", id="missing-value")
    if options.unit is None:
        raise UsageError(
            f"{files['images.txt']}: COLMAP's lengths have no unit; scale the model (colmap model_aligner) and state "
            f"the unit of the calibration ({option('calibration_unit')} m)",
            id="missing-unit",
        )
    lenses = dict(_lenses(files["cameras.txt"]))
    cameras = []
    # Every second line has the points of an image; it may be empty, but is there.
    lines = [text.strip() for text in read_text(files["images.txt"]).splitlines() if not text.startswith("#")]
    if len(lines) > 2 * MAX_IMAGES:
        raise InputError(
            f"{files['images.txt']}: {(len(lines) + 1) // 2} images; each becomes a camera, and at most {MAX_IMAGES} "
            "are read; give a model with one image for each camera",
            id="input-too-large",
        )
    for line in lines[::2]:
        cells = line.split(maxsplit=9)
        where = f"{files['images.txt']}: image {cells[-1] if cells else ''}"
        if len(cells) != 10:
            raise InputError(f"{where}: {len(cells)} values; expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        values = _numbers(cells[1:8], where)
        if cells[8] not in lenses:
            raise InputError(f"{where}: its camera {cells[8]} is not in cameras.txt", id="unknown-sensor")
        if abs(float(np.linalg.norm(values[:4])) - 1) > 1e-3:
            raise InputError(f"{where}: {values[:4].tolist()} is no unit quaternion", id="invalid-calibration")
        name = PurePosixPath(cells[9].replace("\\", "/"))
        size, focal, principal, lens = lenses[cells[8]]
        rotation = quaternion_rotation(*values[:4])
        pose = CameraParameters(
            name=name.parent.name or name.stem,
            focal_px=focal,
            principal_px=principal,
            rotation=rotation,
            centre=centre_of_extrinsics(rotation, values[4:]) * scale_of(options, "m"),
            image_size=size,
            lens=lens,
        )
        cameras.append(build_camera(pose, where, options))
    return _each_once(cameras, files["images.txt"], options)


def _each_once(cameras: Sequence[Camera], path: Path, options: CalibrationOptions) -> tuple[Camera, ...]:
    """One camera for each name, from the first of its images; a note is added to `options` if images were merged.

    Raises:
        InputError: images of one camera have different poses.
    """
    centres = np.array([camera.position for camera in cameras]).reshape(-1, 3)
    apart = float(np.linalg.norm(centres.max(axis=0) - centres.min(axis=0))) if len(cameras) else 0.0
    first: dict[str, Camera] = {}
    for camera in cameras:
        other = first.setdefault(camera.name, camera)
        turned = np.arccos(np.clip((np.trace(other.rotation.T @ camera.rotation) - 1) / 2, -1.0, 1.0))
        shift = float(np.linalg.norm(camera.position - other.position))
        if shift > SAME_SHARE * apart or turned > SAME_RAD:
            raise InputError(
                f"{path}: two images of camera {camera.name!r} have poses {shift:.3g} m and {np.degrees(turned):.2f} "
                "deg apart: a camera that moves cannot be used; give a model with one image of each camera",
                id="invalid-calibration",
            )
    if len(first) < len(cameras):
        options.notes.append(
            f"{len(cameras)} images of {len(first)} cameras that stand still; the first of each counts"
        )
    return tuple(first.values())


def _lenses(path: Path) -> Iterator[tuple[str, _Lens]]:
    for line in read_text(path).splitlines():
        cells = line.split()
        if not cells or line.startswith("#"):
            continue
        where = f"{path}: camera {cells[0]}"
        model = cells[1] if len(cells) > 1 else ""
        if model not in MODELS:
            raise InputError(f"{where}: model {model}; only {', '.join(MODELS)} can be used", id="unsupported-format")
        names, kind, coefficients = MODELS[model]
        if len(cells) != 4 + len(names.split()):
            raise InputError(f"{where}: {len(cells) - 4} parameters; {model} has {names}", id="invalid-calibration")
        values = dict(zip(names.split(), _numbers(cells[4:], where).tolist(), strict=True))
        focal = np.array([values.get("fx", values.get("f")), values.get("fy", values.get("f"))], dtype=np.float64)
        principal = np.array([values["cx"], values["cy"]]) - 0.5
        size = (int(cells[2]), int(cells[3]))
        lens = Lens(kind, np.array([values[name] for name in coefficients.split()]))
        yield cells[0], _Lens(size, focal, principal, lens)


def _numbers(cells: list[str], where: str) -> Floats:
    try:
        values = np.array([float(cell) for cell in cells])
    except ValueError:
        raise InputError(
            f"{where}: {' '.join(cells)[:60]!r}; numbers were expected", id="invalid-calibration"
        ) from None
    if not np.isfinite(values).all():
        raise InputError(f"{where}: has numbers that are not finite", id="invalid-calibration")
    return values


def texts(cameras: Sequence[Camera], late_s: Mapping[str, float]) -> dict[str, str]:  # noqa: ARG001
    """Texts of the three files of a COLMAP model, by name, with an image for each camera.

    Args:
        cameras: with positions in metres.
        late_s: clock offsets by camera [s], which the format cannot hold; ignored.
    """
    lenses = ["# Camera list with one line of data per camera: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; the line below each has its points"]
    for n, camera in enumerate(cameras, start=1):
        where = f"colmap: camera {camera.name}"
        lens = stated_coefficients(camera.distortion_model, camera.distortion, tuple(WRITTEN), where)
        model = "OPENCV_FISHEYE" if camera.distortion_model == "equidistant" else WRITTEN[len(lens)]
        parameters = [*camera.focal_px, *(camera.principal_px + 0.5), *lens]
        lenses.append(" ".join([str(n), model, *map(str, camera.image_size or ()), *_exactly(parameters)]))
        turn = camera.rotation.T
        x, y, z, w = rotation_quaternion(turn)
        pose = [w, x, y, z, *(-turn @ camera.position)]
        images += [" ".join([str(n), *_exactly(pose), str(n), f"{camera.name}.png"]), ""]
    return {NAMES[0]: "\n".join(lenses) + "\n", NAMES[1]: "\n".join(images) + "\n", "points3D.txt": ""}


def _exactly(values: Sequence[float] | Floats) -> list[str]:
    return [repr(float(value)) for value in values]
