"""Calibrations of messages (`sensor_msgs/CameraInfo`) to intrinsic parameters that occlog's cameras have.

Raw images have the matrix K and the distortion D; rectified ones the matrix P, no distortion, and are turned by R.
`rational_polynomial` is fitted by the five coefficients of `plumb_bob`, and refused where they are not close.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.calibration.lens import fit_rational

from .kinds import InfoMessage

_BROWN = ("plumb_bob", "radtan", "")
_RATIONAL = ("rational_polynomial",)
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt")


class Intrinsics(NamedTuple):
    """What is known of a camera without its pose.

    Attributes:
        focal_px: (2,) focal lengths.
        principal_px: (2,) principal point.
        size: width and height.
        model: `brown` or `equidistant`.
        distortion: k1, k2, p1, p2, k3, or k1 to k4.
        turn: (3, 3) rotation of the frame of the images from the camera's own.
        shift: how far the camera stands to the right of the frame that a stereo pair shares.
        fit_px: largest error of a fitted lens model; 0: the model is the same.
    """

    focal_px: Floats
    principal_px: Floats
    size: tuple[int, int]
    model: str
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
    if (
        not np.isfinite(matrix).all()
        or matrix[0, 1]
        or matrix[1, 0]
        or matrix[2].tolist() != [0, 0, 1]
        or not (matrix[0, 0] > 0 < matrix[1, 1])
    ):
        raise InputError(f"{where}: its matrix {matrix.tolist()} is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    focal, principal = np.array([matrix[0, 0], matrix[1, 1]]), matrix[:2, 2].copy()
    if rectified:
        turn = info.r if info.r.any() else np.eye(3)
        with np.errstate(over="ignore", invalid="ignore"):
            rotates = np.isfinite(turn).all() and np.abs(turn @ turn.T - np.eye(3)).max() <= 1e-3
        if not rotates or np.linalg.det(turn) < 0:
            raise InputError(f"{where}: its matrix R is not a rotation; give a calibration file or a scene")
        shift = -float(info.p[0, 3]) / float(focal[0])
        return Intrinsics(focal, principal, info.size, "brown", np.zeros(5), turn, shift, fit_px=0.0)
    model, distortion, fit_px = _lens(info, focal, principal, where)
    return Intrinsics(focal, principal, info.size, model, distortion, np.eye(3), shift=0.0, fit_px=fit_px)


def _lens(info: InfoMessage, focal: Floats, principal: Floats, where: str) -> tuple[str, Floats, float]:
    """The lens model, its five coefficients, and the largest error that they make [px]."""
    given, model = info.distortion, info.model.lower()
    if not np.isfinite(given).all():
        raise InputError(f"{where}: its distortion {given.tolist()} is not finite")
    if model in _FISHEYE and len(given) in (0, 4):
        return "equidistant", _five(given), 0.0
    if not given.any() and model not in _FISHEYE:
        return "brown", np.zeros(5), 0.0
    if model in _BROWN and len(given) <= 5:
        return "brown", _five(given), 0.0
    if model in _RATIONAL and len(given) <= 14 and not given[8:].any():
        if not given[5:].any():
            return "brown", _five(given[:5]), 0.0
        eight = np.concatenate([given, np.zeros(8)])[:8]
        found, off = fit_rational(eight, info.size, focal, principal, where)
        return "brown", found, off
    raise InputError(
        f"{where}: lens model {info.model!r} with {len(given)} coefficients is not known; record rectified images "
        "(image_proc), or give a calibration file or a scene"
    )


def _five(given: Floats) -> Floats:
    return np.concatenate([given, np.zeros(5 - len(given))])
