"""Calibrations of messages (`sensor_msgs/CameraInfo`) to intrinsic parameters that occlog's cameras have.

Raw images have the matrix K and the distortion D; rectified ones the matrix P, no distortion, and are turned by R.
Lens models with more parameters (`rational_polynomial`, `equidistant`) are fitted by the five of `plumb_bob`; how well
that goes in the whole image is measured, and what is not the same to half a pixel is refused.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError

from .kinds import InfoMessage

MAX_FIT_PX = 0.5
"""Largest error of a fitted lens model at any pixel of the image; readings have a noise of 2 px."""
GRID = 33
_BROWN = ("plumb_bob", "radtan", "")
_RATIONAL = ("rational_polynomial",)
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt")
REMEDY = "record rectified images (image_proc), or give a calibration file or a scene"


class Intrinsics(NamedTuple):
    """What is known of a camera without its pose.

    Attributes:
        focal_px: (2,) focal lengths.
        principal_px: (2,) principal point.
        size: width and height.
        distortion: k1, k2, p1, p2, k3.
        turn: (3, 3) rotation of the frame of the images from the camera's own.
        shift: how far the camera stands to the right of the frame that a stereo pair shares.
        fit_px: largest error of a fitted lens model; 0: the model is the same.
    """

    focal_px: Floats
    principal_px: Floats
    size: tuple[int, int]
    distortion: Floats
    turn: Floats
    shift: float
    fit_px: float


def intrinsics(info: InfoMessage, *, rectified: bool, where: str) -> Intrinsics | None:
    """The intrinsic parameters of the camera of a calibration; None for one that says that it is not calibrated.

    InputError, with the remedy, for lens models and crops that cannot be used.
    """
    matrix = info.p[:, :3] if rectified else info.k
    if not matrix[0, 0]:
        return None
    if max(info.binning) > 1 or any(info.roi[:2]) or (any(info.roi) and info.roi[2:] != info.size):
        raise InputError(
            f"{where}: its calibration is of images that are binned {info.binning} or cut {info.roi}, which cannot be "
            "used; give a calibration file or a scene"
        )
    if not np.isfinite(matrix).all() or matrix[0, 1] or matrix[1, 0] or not (matrix[0, 0] > 0 < matrix[1, 1]):
        raise InputError(f"{where}: its matrix {matrix.tolist()} is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    focal, principal = np.array([matrix[0, 0], matrix[1, 1]]), matrix[:2, 2].copy()
    if rectified:
        turn = info.r if info.r.any() else np.eye(3)
        if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0:
            raise InputError(f"{where}: its matrix R is not a rotation; give a calibration file or a scene")
        return Intrinsics(focal, principal, info.size, np.zeros(5), turn, -float(info.p[0, 3]) / focal[0], 0.0)
    distortion, fit_px = _distortion(info, focal, principal, where)
    return Intrinsics(focal, principal, info.size, distortion, np.eye(3), 0.0, fit_px)


def _distortion(info: InfoMessage, focal: Floats, principal: Floats, where: str) -> tuple[Floats, float]:
    """The five coefficients, and the largest error that they make [px]."""
    given, model = info.distortion, info.model.lower()
    if not np.isfinite(given).all():
        raise InputError(f"{where}: its distortion {given.tolist()} is not finite")
    if not given.any() and model not in _FISHEYE:
        return np.zeros(5), 0.0
    if model in _BROWN and len(given) <= 5:
        return np.concatenate([given, np.zeros(5 - len(given))]), 0.0
    if model in _RATIONAL and len(given) <= 14 and not given[8:].any():
        if not given[5:].any():
            return np.concatenate([given[:5], np.zeros(5 - len(given[:5]))]), 0.0
        return _fitted(info, focal, principal, where)
    if model in _FISHEYE and len(given) == 4:
        return _fitted(info, focal, principal, where)
    raise InputError(f"{where}: lens model {info.model!r} with {len(given)} coefficients is not known; {REMEDY}")


def _fitted(info: InfoMessage, focal: Floats, principal: Floats, where: str) -> tuple[Floats, float]:
    """The five coefficients that are nearest to another model over the whole image (least squares)."""
    width, height = info.size
    # Ideal points whose images reach a little over the border: the model maps ideal to distorted.
    corners = np.array([[0.0, 0.0], [width - 1.0, 0.0], [0.0, height - 1.0], [width - 1.0, height - 1.0]])
    wanted = np.abs((corners - principal) / focal).max(axis=0)
    ideal = _grid(wanted, info)
    inside = np.abs(_distorted(ideal, info) * focal + principal - (np.array(info.size) - 1) / 2)
    kept = (inside <= np.array(info.size) / 2 + 1).all(axis=1)
    ideal = ideal[kept]
    goal = _distorted(ideal, info)
    x, y = ideal.T
    r2 = x * x + y * y
    across = np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3])
    down = np.column_stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3])
    system = np.concatenate([across * focal[0], down * focal[1]])
    target = np.concatenate([(goal - ideal)[:, 0] * focal[0], (goal - ideal)[:, 1] * focal[1]])
    found, *_ = np.linalg.lstsq(system, target, rcond=None)
    off = float(np.abs(system @ found - target).max())
    if not off <= MAX_FIT_PX:
        raise InputError(
            f"{where}: lens model {info.model} differs from that of five coefficients by up to {off:.3g} px (limit "
            f"{MAX_FIT_PX}); {REMEDY}"
        )
    return np.asarray(found), off


def _grid(wanted: Floats, info: InfoMessage) -> Floats:
    """(n, 2) ideal points out to where their images leave the image."""
    reach = wanted.copy()
    for _ in range(40):
        edge = np.abs(_distorted(np.diag(reach), info)).max(axis=0)
        if (edge >= wanted).all():
            break
        reach = np.where(edge < wanted, reach * 1.1, reach)
    u, v = np.meshgrid(np.linspace(-reach[0], reach[0], GRID), np.linspace(-reach[1], reach[1], GRID))
    return np.column_stack([u.ravel(), v.ravel()])


def _distorted(ideal: Floats, info: InfoMessage) -> Floats:
    """(n, 2) distorted normalised coordinates, by the rational or the equidistant model of OpenCV."""
    x, y = ideal.T
    r2 = x * x + y * y
    if info.model.lower() in _FISHEYE:
        r = np.sqrt(r2)
        angle = np.arctan(r)
        k1, k2, k3, k4 = info.distortion
        a2 = angle * angle
        bent = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
        return ideal * np.where(r > 1e-9, bent / np.maximum(r, 1e-9), 1.0)[:, None]
    k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([info.distortion, np.zeros(8)])[:8]
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    down = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack([across, down])
