"""Projection matrices: one text file a camera with three rows of four numbers.

The pixel of a world point X is (u, v, w) = P (X, 1), divided by w.  P = K R (I | -C) is
split into intrinsic matrix K, rotation R and centre C; there is no distortion.  The
file states neither the unit (metres unless stated otherwise) nor the size of the images.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.records.scene import Camera

from ..common import CalibrationOptions, CameraParameters, build_camera, check_camera_matrix, read_text, scale_of
from ..lenses import Lens

STRAIGHT = Lens()

_SUFFIX = re.compile(r"[_-]?(P|proj|projection|matrix|calib|calibration)$", re.IGNORECASE)


def detect(text: str) -> bool:
    """Whether a text is a 3 x 4 matrix; also a transposed one, which `read` refuses."""
    try:
        return matrix_of(text).shape in ((3, 4), (4, 3))
    except ValueError:
        return False


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read one camera per file with a projection matrix, named after the file without `_P` and the like."""
    return tuple(_camera(path, options) for path in paths)


def matrix_of(text: str) -> Floats:
    """Parse a matrix (rows, columns): a row per line, values separated by spaces or commas; lines with # are skipped.

    Raises:
        ValueError: a value is not a number, or rows have different lengths.
    """
    rows = [line.replace(",", " ").split() for line in text.splitlines() if line.strip() and line.strip()[0] != "#"]
    return np.array([[float(cell) for cell in row] for row in rows], dtype=np.float64)


def _camera(path: Path, options: CalibrationOptions) -> Camera:
    name = _SUFFIX.sub("", path.stem) or path.stem
    where = f"{path}: camera {name}"
    try:
        matrix = matrix_of(read_text(path))
    except ValueError as error:
        raise InputError(
            f"{where}: not a matrix of numbers ({error}); three rows of four were expected", id="invalid-calibration"
        ) from None
    if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
        hint = "; transpose it (MATLAB has it so)" if matrix.shape == (4, 3) else ""
        raise InputError(
            f"{where}: {matrix.shape} numbers; three rows of four finite ones were expected{hint}",
            id="invalid-calibration",
        )
    k, rotation, centre = take_apart(matrix, where)
    return camera_of_parts(k, rotation, centre, options.image_size, options, name=name, where=where)


def camera_of_parts(
    k: Floats,
    rotation: Floats,
    centre: Floats,
    image_size: tuple[int, int] | None,
    options: CalibrationOptions,
    *,
    name: str,
    where: str,
    lens: Lens = STRAIGHT,
    unit: str = "m",
) -> Camera:
    """Create a camera from intrinsic matrix, rotation and centre.

    Args:
        k: (3, 3) intrinsic matrix.
        rotation: (3, 3) camera-from-world rotation.
        centre: (3,) camera centre in the unit of `options`.
        image_size: width and height [px]; None: that of the options.
        options: length unit and image size.
        name: of the camera.
        where: file and camera, for messages.
        lens: distortion.
        unit: length unit of the format, if the options state none.

    Raises:
        InputError: a parameter is impossible, or the skew, which a scene does not have, is above `MAX_SKEW_PX` at the
            upper or lower edge of the image.
    """
    check_camera_matrix(k, (image_size or options.image_size or (0, 1080))[1], where)
    pose = CameraParameters(
        name=name,
        focal_px=[k[0, 0], k[1, 1]],
        principal_px=[k[0, 2], k[1, 2]],
        rotation=rotation,
        centre=centre * scale_of(options, unit),
        image_size=image_size,
        lens=lens,
    )
    return build_camera(pose, where, options)


def take_apart(matrix: Floats, where: str = "matrix") -> tuple[Floats, Floats, Floats]:
    """Decompose a projection matrix (3, 4) into K (K[2, 2] = 1), camera-from-world rotation (3, 3) and centre (3,).

    RQ decomposition (Hartley and Zisserman, Sec. 6.2.4). `where` begins the message of the error.

    Raises:
        InputError: the left 3 x 3 part is singular, so that the camera would be at infinity.
    """
    left = matrix[:, :3]
    if not abs(np.linalg.det(left)) > 1e-12 * np.linalg.norm(left) ** 3:
        raise InputError(
            f"{where}: the left 3 x 3 part cannot be inverted (a camera at infinity); correct its numbers",
            id="invalid-calibration",
        )
    # P and -P show the same image; the one with a positive determinant has points in front at w > 0.
    matrix = matrix * np.sign(np.linalg.det(left))
    left = matrix[:, :3]
    # RQ decomposition by QR of the matrix with its rows reversed.
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ left).T)
    k, rotation = flip @ r.T @ flip, flip @ q.T
    signs = np.diag(np.sign(np.diag(k)))
    k, rotation = k @ signs, signs @ rotation
    centre: Floats = -np.asarray(np.linalg.solve(left, matrix[:, 3]), dtype=np.float64)
    return np.asarray(k / k[2, 2]), np.asarray(rotation), centre
