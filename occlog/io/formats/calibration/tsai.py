"""Tsai calibrations as the PETS data sets give them: one XML file a camera.

World millimetres, Z = 0 the ground.  Xc = R Xw + T with R = Rz Ry Rx; the undistorted
sensor position f Xc/Zc [mm] and the distorted one (Xd, Yd) are related by
Xu = Xd (1 + kappa1 r^2), r^2 = Xd^2 + Yd^2 [Tsai 1987, Eq. 5]; the pixel is
(sx Xd / dpx + cx, Yd / dpy + cy).  In coordinates divided by f the coefficient is kappa1 f^2.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.texts.documents import number, parse_xml, required
from occlog.records.scene import Camera

from .common import CalibrationOptions, Pose, build_camera, read_text, scale_of


def detect(text: str) -> bool:
    """Return whether a text is a Tsai calibration."""
    return "<Camera" in text and "<Geometry" in text and "kappa1" in text


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """One camera a file, named as in the file."""
    return tuple(_camera(path, options) for path in paths)


def _camera(path: Path, options: CalibrationOptions) -> Camera:
    root = parse_xml(read_text(path), path)
    where = f"{path}: camera {root.get('name') or path.stem}"
    geometry, inner, outer = (required(root, part, where) for part in ("Geometry", "Intrinsic", "Extrinsic"))
    focal = number(inner, "focal", where)
    dpx, dpy = number(geometry, "dpx", where), number(geometry, "dpy", where)
    if dpx <= 0 or dpy <= 0:
        raise InputError(f"{where}: pixels of {dpx:g} x {dpy:g} mm; they must be above 0")
    rotation = rotation_zyx(*(number(outer, axis, where) for axis in ("rx", "ry", "rz")))
    translation = np.array([number(outer, axis, where) for axis in ("tx", "ty", "tz")])
    size = (int(number(geometry, "width", where)), int(number(geometry, "height", where)))
    pose = Pose(
        name=root.get("name") or path.stem,
        focal_px=[number(inner, "sx", where, 1.0) * focal / dpx, focal / dpy],
        principal_px=[number(inner, "cx", where), number(inner, "cy", where)],
        rotation=rotation,
        centre=-rotation.T @ translation * scale_of(options, "mm"),
        image_size=options.image_size or size,
        distortion=[number(inner, "kappa1", where, 0.0) * focal**2],
        model="tsai",
    )
    return build_camera(pose, where)


def rotation_zyx(rx: float, ry: float, rz: float) -> Floats:
    """(3, 3) rotation Rz Ry Rx of three angles [rad]."""
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(a), np.sin(a)) for a in (rx, ry, rz))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)
