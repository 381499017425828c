"""Homographies of the ground, 3 x 3 matrices in text, one file a camera: intrinsics and pose by a few assumptions.

A homography maps the ground (x, y, 1) to the image (u, v, 1), or back.  With square pixels, a principal point in the
middle of the image and no distortion it is H = K [r1 r2 t] up to scale with one unknown of K, the focal length, and two
equations: r1 and r2 are orthogonal and of equal length (Zhang 2000).  What is left of them shows a principal point
that is off sideways; of a camera without roll nothing shows pixels that are not square, or a principal point that is
off in height.  A focal length that is not real shows a matrix of the other direction; the camera is above the ground.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, option
from occlog.records.scene import MAX_FOCAL_PX, MIN_FOCAL_PX, Camera

from ..common import CalibrationOptions, mirror_matrix, read_text
from .projection import camera_of_parts, matrix_of

MAX_MISFIT = 0.1
"""Largest relative residual of the two equations; points that are clicked by hand leave some hundredths."""
CLEARER = 3.0
"""Least ratio of the residuals of both directions of the matrix; below it the direction is not known."""


class GroundPose(NamedTuple):
    """CameraParameters and focal length of a camera from a homography of the ground.

    Attributes:
        focal: focal length [px].
        rotation: (3, 3) camera-from-world.
        centre: (3,) camera centre in the unit of the ground.
        misfit: relative residual of the two equations for the focal length.
    """

    focal: float
    rotation: Floats
    centre: Floats
    misfit: float


def detect(text: str) -> bool:
    """Whether a text is a 3 x 3 matrix."""
    try:
        return matrix_of(text).shape == (3, 3)
    except ValueError:
        return False


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read one camera per file with a homography of the ground, named after the file without `_H` and the like."""
    return tuple(_camera(path, options) for path in paths)


def _camera(path: Path, options: CalibrationOptions) -> Camera:
    stem = path.stem
    name = next((stem.removesuffix(end) for end in ("_H", "-H", ".H", "_homography") if stem.endswith(end)), stem)
    where = f"{path}: camera {name}"
    size = options.image_size
    if size is None:
        raise InputError(
            f"{where}: a homography does not state the size of the images; give {option('image_size')} WIDTHxHEIGHT",
            id="missing-image-size",
        )
    matrix = matrix_of(read_text(path))
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise InputError(
            f"{where}: {matrix.shape} numbers; three rows of three finite ones were expected", id="invalid-calibration"
        )
    middle = 0.5 * (np.array(size, dtype=np.float64) - 1.0)
    if options.mirror == "z":
        raise InputError(
            f"{where}: a homography states no z; mirror x or y ({option('mirror')} y)", id="invalid-calibration"
        )
    axes = mirror_matrix(options.mirror)
    pose, to_image = oriented(matrix, middle, where, axes)
    direction = "ground to image" if to_image else "image to ground"
    options.notes.append(
        f"camera {name}: of a homography ({direction}), with square pixels, the principal point in the middle and no "
        f"distortion: f {pose.focal:.4g} px, height {pose.centre[2]:.3g}, residual {pose.misfit:.2g}"
    )
    k = np.array([[pose.focal, 0.0, middle[0]], [0.0, pose.focal, middle[1]], [0.0, 0.0, 1.0]])
    rotation, centre = pose.rotation, pose.centre
    if options.mirror is not None:  # in the left-handed world, where it has all behind it
        rotation, centre = -rotation @ axes, axes @ centre
    return camera_of_parts(k, rotation, centre, size, options, name=name or stem, where=where)


def oriented(matrix: Floats, middle: Floats, where: str, axes: Floats) -> tuple[GroundPose, bool]:
    """CameraParameters of a camera from a homography of either direction, and whether it maps the ground to the image.

    Args:
        matrix: (3, 3), up to scale.
        middle: (2,) the principal point [px].
        where: file and camera, for messages.
        axes: (3, 3) diagonal signs of the axes of the ground in a right-handed world.

    Raises:
        InputError: neither direction fits a camera above the ground, or both do.
    """
    if not abs(np.linalg.det(matrix)) > 1e-18 * np.linalg.norm(matrix) ** 3:
        raise InputError(
            f"{where}: the homography cannot be inverted (its determinant is 0); correct its numbers",
            id="invalid-calibration",
        )
    found = [
        (ground_pose(each @ axes, middle), to)
        for each, to in ((matrix, True), (np.asarray(np.linalg.inv(matrix)), False))
    ]
    fits = sorted((pose.misfit, to) for pose, to in found if pose is not None)
    if not fits or fits[0][0] > MAX_MISFIT:
        left = f"; the residual is {fits[0][0]:.2g}, and {MAX_MISFIT:g} is the limit" if fits else ""
        raise InputError(
            f"{where}: fits no camera with square pixels and its principal point in the middle{left}; it must map "
            "undistorted images of this size to positions on the ground",
            id="invalid-calibration",
        )
    if len(fits) > 1 and fits[1][0] < CLEARER * fits[0][0]:
        raise InputError(
            f"{where}: its direction is ambiguous, image to ground or ground to image; give a calibration that states "
            "it (P, or K, R and t)",
            id="ambiguous-input",
        )
    pose = next(pose for pose, to in found if to is fits[0][1])
    assert pose is not None
    if pose.centre[2] <= 0:
        raise InputError(
            f"{where}: its camera is below the ground: the axes of the ground are left-handed, as those of a map in "
            f"pixels with y down; mirror it ({option('mirror')} y)",
            id="invalid-calibration",
        )
    return pose, fits[0][1]


def ground_pose(matrix: Floats, middle: Floats) -> GroundPose | None:
    """Focal length and pose of a camera from a homography from the ground to the image (Zhang 2000).

    Pixels are square and there is no distortion. None if no real focal length fits.

    Args:
        matrix: (3, 3), up to scale.
        middle: (2,) the principal point [px].
    """
    shift = np.eye(3)
    shift[:2, 2] = -np.asarray(middle)
    h = shift @ matrix
    h = h / np.linalg.norm(h[:, :2])
    a = np.array([h[0, 0] * h[0, 1] + h[1, 0] * h[1, 1], (h[:2, 0] @ h[:2, 0] - h[:2, 1] @ h[:2, 1]) / 2])
    b = np.array([h[2, 0] * h[2, 1], (h[2, 0] ** 2 - h[2, 1] ** 2) / 2])
    if not a @ a > 0 or not (inverse := -(a @ b) / (a @ a)) > 0:
        return None
    focal = float(1.0 / np.sqrt(inverse))
    if not MIN_FOCAL_PX <= focal <= MAX_FOCAL_PX:
        return None
    plain = np.diag([1.0 / focal, 1.0 / focal, 1.0]) @ h
    scale = np.sqrt(np.linalg.norm(plain[:, 0]) * np.linalg.norm(plain[:, 1]))
    misfit = float(np.linalg.norm(a * inverse + b) / scale**2)
    plain = plain / scale
    # The ground that the middle of the image shows, or that of its lower edge, is in front of the camera
    if _depth(plain) < 0:
        plain = -plain
    u, _, vt = np.linalg.svd(np.column_stack([plain[:, 0], plain[:, 1], np.cross(plain[:, 0], plain[:, 1])]))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return GroundPose(focal, rotation, -rotation.T @ plain[:, 2], misfit)


def _depth(plain: Floats) -> float:
    """Depth of the ground point on the ray 45 degrees below the optical axis; negative behind the camera.

    Only its sign is meant; 0 if the point is at infinity, where there is none. `plain` (3, 3) is the homography from
    the ground to normalised image coordinates.
    """
    ground = np.linalg.solve(plain, np.array([0.0, 1.0, 1.0]))
    return float(plain[2] @ ground / ground[2]) if ground[2] else 0.0
