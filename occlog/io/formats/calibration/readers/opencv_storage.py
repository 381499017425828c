"""OpenCV FileStorage calibrations, YAML, XML or JSON: one file a camera.

Read with an own parser: OpenCV's crashes on malformed files, and versions 4 and 5 write
different headers.  Names of the parts differ from program to program; the usual ones are
known.  Xc = R Xw + t; the unit is not stated: metres unless stated otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.texts.documents import parse_json, parse_xml
from occlog.records.scene import Camera

from ..common import CalibrationOptions, centre_of_extrinsics, keys_of, read_text, yaml_values
from ..lenses import Lens, stated_coefficients
from .opencv_toml import checked_rotation
from .projection import camera_of_parts

PLAIN_MATRIX = ("camera_matrix", "cameramatrix", "intrinsic_matrix", "k", "mtx")
"""Names that state what the matrix is, also in a text of which nothing else is known."""
MATRIX = (*PLAIN_MATRIX, "m", "matrix")
DISTORTION = ("distortion_coefficients", "distcoeffs", "dist_coeffs", "distortion", "dist", "d", "distortion_coeffs")
ROTATION = ("r", "rotation", "rotation_matrix", "rvec", "rotation_vector")
TRANSLATION = ("t", "tvec", "translation", "translation_vector")
SIZE = (("image_width", "image_height"), ("width", "height"))
SIZES = ("image_size", "imagesize", "img_size", "resolution", "size")
LENS = ("fisheye_model", "fisheye", "distortion_model")
WITHOUT_EFFECT = keys_of(
    "calibration_time calibration_date date time camera_name name comment description opencv_version",
    "nframes nr_of_frames n_frames num_images board_width board_height square_size marker_size flags flagvalue",
    "calibrate_flags aspectratio fix_k1 fix_k2 fix_k3 avg_reprojection_error reprojection_error rms rms_error",
    "avg_reproj_error error per_view_reprojection_errors per_view_errors extrinsic_parameters image_points",
    "grid_points write_extrinsics std_deviations_intrinsics standard_deviations_intrinsics",
)
"""Keys that change no camera: names, dates, how it was calibrated and how well, in small letters."""
YES, NO = ("1", "true"), ("0", "false", "none")
"""Values of `fisheye_model`, as written by OpenCV's calibration program."""
BROWN = ("plumb_bob", "radtan", "brown", "rational_polynomial", "thin_prism", "tilted", "opencv", "none", "pinhole")
FISHEYE = ("fisheye", "equidistant", "kannala_brandt", "opencv_fisheye")
"""Names of `distortion_model`."""
_NOT_FINITE = re.compile(r"[+-]?\.?(?:nan|inf)", re.IGNORECASE)
MAX_NUMBERS = 10_000
DIGITS = 9
"""Maximum number of digits of a number of rows or columns."""


def detect(text: str) -> bool:
    """Whether a text is an OpenCV FileStorage (YAML, XML or JSON) with a matrix."""
    head = "opencv_storage" in text[:400] or text.startswith("%YAML") or text.lstrip().startswith("{")
    return head and re.search("opencv-(?!python)", text) is not None  # the package is named in results of occlog


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read one camera per file of OpenCV's FileStorage, named after the file."""
    return tuple(_camera(path, options) for path in paths)


def _camera(path: Path, options: CalibrationOptions) -> Camera:
    where = f"{path}: camera {path.stem}"
    values = storage_values(read_text(path), path)
    matrix = matrix_of(values, MATRIX, where)
    rotation, translation = extrinsics_of(values, where)
    size = size_of(values)
    options.check_keys(path.stem, unused_keys(values, (MATRIX, DISTORTION, ROTATION, TRANSLATION)), WITHOUT_EFFECT)
    lens, centre = lens_of(values, where), centre_of_extrinsics(rotation, translation)
    return camera_of_parts(matrix, rotation, centre, size, options, name=path.stem, where=where, lens=lens)


def lens_of(values: dict[str, object], where: str) -> Lens:
    """Lens of a calibration by the values of its file.

    Args:
        values: by name in lower case.
        where: file and camera, for messages.

    Raises:
        InputError: the lens model is unknown, or is stated twice in different ways.
    """
    stated: set[str] = set()
    for key, brown, fisheye in ((LENS[0], NO, YES), (LENS[1], NO, YES), (LENS[2], BROWN, FISHEYE)):
        text = str(values.get(key, "")).strip().lower()
        if text and text not in (*brown, *fisheye):
            raise InputError(
                f"{where}: {key} {text} is no known lens model; undistort the images, or remove {key}",
                id="unsupported-format",
            )
        stated |= {"equidistant" if text in fisheye else "brown"} if text else set()
    if len(stated) > 1:
        raise InputError(
            f"{where}: {' and '.join(k for k in LENS if k in values)} contradict each other; keep one",
            id="conflicting-values",
        )
    given = matrix_of(values, DISTORTION, where) if any(key in values for key in DISTORTION) else np.zeros(0)
    return Lens(next(iter(stated), None), given)


def unused_keys(values: Mapping[str, object], parts: Sequence[tuple[str, ...]]) -> list[str]:
    """Keys of a file that are not used.

    Args:
        values: of the file, by key.
        parts: alternative names of each quantity, of which the first that is present is used.
    """
    used = {next((name for name in names if name in values), "") for names in parts}
    size = next((pair for pair in SIZE if all(key in values for key in pair)), None)
    used |= set(size or [next((key for key in SIZES if key in values), "")])
    return [key for key in values if key not in used and key not in LENS]


def extrinsics_of(values: dict[str, object], where: str) -> tuple[Floats, Floats]:
    """Rotation (3, 3), camera-from-world, and translation (3,) with Xc = R Xw + t, from the values of a file by name.

    InputError if they are missing or of another shape; a rotation may be a vector of 3 numbers (Rodrigues).
    """
    rotation, translation = matrix_of(values, ROTATION, where), matrix_of(values, TRANSLATION, where).reshape(-1)
    if rotation.size == 3:
        rotation = checked_rotation(rotation.reshape(3), where)
    if rotation.shape != (3, 3) or translation.shape != (3,):
        raise InputError(
            f"{where}: expected a rotation of 9 or 3 and a translation of 3 numbers", id="invalid-calibration"
        )
    return rotation, translation


def storage_values(text: str, path: Path) -> dict[str, object]:
    """Values of an OpenCV FileStorage by name in lower case; a matrix is a mapping with `rows`, `cols` and `data`.

    Raises:
        InputError: the text is not XML, JSON or YAML.
    """
    start = text.lstrip()[:1]
    if start == "<":
        return _from_xml(text, path)
    return _from_json(text, path) if start == "{" else _from_yaml(text, path)


def _from_json(text: str, path: Path) -> dict[str, object]:
    values = parse_json(text, path, "an OpenCV calibration")
    if not isinstance(values, dict):
        raise InputError(f"{path}: names no values; an OpenCV calibration was expected", id="empty-input")
    return {str(key).lower(): value for key, value in values.items()}


def _from_yaml(text: str, path: Path) -> dict[str, object]:
    return {key.lower(): value for key, value in yaml_values(text, path).items()}


def _from_xml(text: str, path: Path) -> dict[str, object]:
    values: dict[str, object] = {}
    for element in parse_xml(text, path):
        parts = {child.tag: (child.text or "").strip() for child in element}
        values[element.tag.lower()] = (
            {**parts, "data": parts["data"].split()} if "data" in parts else _plain(element.text or "")
        )
    return values


def _plain(text: str) -> object:
    """Value of an XML element that is not a matrix: its text, or a list if it has several words."""
    cells = text.split()
    return cells if len(cells) > 1 else text.strip()


def matrix_of(values: dict[str, object], names: tuple[str, ...], where: str) -> Floats:
    """First of several keys that is present in a file, as an array of floats.

    Args:
        values: of the file, by key.
        names: keys to look for, in this order.
        where: file and camera, for messages.

    Returns:
        The array, of the shape that an OpenCV matrix states, or that of nested lists.

    Raises:
        InputError: no key is present, or the value is no array of numbers of the stated shape.
    """
    key = next((name for name in names if name in values), None)
    if key is None:
        raise InputError(f"{where}: has none of {', '.join(names)}; add one", id="missing-value")
    value = values[key]
    shape = None
    if isinstance(value, dict):
        rows, columns = str(value.get("rows")), str(value.get("cols"))
        stated = all(cell.isdecimal() and len(cell) <= DIGITS for cell in (rows, columns))
        shape = (int(rows), int(columns)) if stated else _sizes(value.get("sizes"))
        value = value.get("data")
    try:
        array = np.array(value, dtype=np.float64)
        if array.size > MAX_NUMBERS:
            raise ValueError
        return array.reshape(shape) if shape else array
    except (ValueError, TypeError):
        # OpenCV writes .Nan and .Inf, which are texts in YAML
        if (bad := next((text for text in _texts(value) if _NOT_FINITE.fullmatch(text)), None)) is not None:
            raise InputError(
                f"{where}: {key} holds {bad}, as after a calibration that did not converge; calibrate again, from more "
                "images",
                id="invalid-calibration",
            ) from None
        raise InputError(
            f"{where}: {key} is not a matrix of numbers of the stated shape", id="invalid-calibration"
        ) from None


def _texts(value: object) -> Iterator[str]:
    """Yield the texts in nested lists, and the words of texts among them."""
    if isinstance(value, str):
        yield from value.split()
    elif isinstance(value, list):
        for each in value:
            yield from _texts(each)


def _sizes(value: object) -> tuple[int, ...] | None:
    """Shape of a matrix as OpenCV 5 states it in `sizes`, a list or a text of numbers; None if not stated."""
    cells = value.split() if isinstance(value, str) else value if isinstance(value, list) else []
    stated = cells and all(str(cell).isdecimal() and len(str(cell)) <= DIGITS for cell in cells)
    return tuple(int(cell) for cell in cells) if stated else None


def size_of(values: Mapping[str, Any]) -> tuple[int, int] | None:
    """Width and height of the images [px] in the values of a file; None if not stated."""
    for width, height in SIZE:
        if width in values and height in values:
            try:
                return int(values[width]), int(values[height])
            except (TypeError, ValueError, OverflowError):
                return None
    for key in SIZES:
        cells = values.get(key)
        cells = cells.get("data") if isinstance(cells, dict) else cells
        if isinstance(cells, list) and len(cells) == 2:
            try:
                return int(cells[0]), int(cells[1])
            except (TypeError, ValueError, OverflowError):
                return None
    return None


def texts(cameras: Sequence[Camera], late_s: Mapping[str, float]) -> dict[str, str]:  # noqa: ARG001
    """Texts of one YAML file per camera, by file name.

    Args:
        cameras: with positions in metres.
        late_s: clock offsets by camera [s], which the format cannot hold; ignored.
    """
    return {f"{camera.name}.yml": _text(camera) for camera in cameras}


def _text(camera: Camera) -> str:
    fisheye = camera.distortion_model == "equidistant"
    lens = stated_coefficients(
        camera.distortion_model, camera.distortion, (5, 8, 12, 14), f"opencv-storage: camera {camera.name}"
    )
    matrices = {
        "camera_matrix": camera.intrinsic_matrix,
        "distortion_coefficients": lens[:, None],
    }
    if camera.placed:
        rotation, translation = camera.extrinsics
        matrices |= {"R": rotation, "T": translation[:, None]}
    lines = [
        "%YAML:1.0",
        "---",
        *(f"{key}: {value}" for key, value in zip(SIZE[0], camera.image_size or (), strict=True)),
    ]
    lines.append(f"{LENS[0]}: {int(fisheye)}")
    for name, matrix in matrices.items():
        data = ", ".join(repr(float(value)) for value in matrix.ravel())
        lines += [f"{name}: !!opencv-matrix", f"   rows: {len(matrix)}", f"   cols: {matrix.shape[1]}", "   dt: d"]
        lines.append(f"   data: [ {data} ]")
    return "\n".join(lines) + "\n"
