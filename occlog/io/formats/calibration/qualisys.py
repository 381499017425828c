"""Qualisys Track Manager calibrations (`.qca.txt`, XML).

Lengths are millimetres, world z is up.  Intrinsic values are in 1/64 pixel.  With the
matrix r of a camera (r11 ... r33), R = diag(1, -1, -1) r turns world into camera
coordinates (x right, y down, z forward), and (x, y, z) is the camera's centre.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from occlog.errors import InputError
from occlog.io.files.texts.documents import number, parse_xml, required
from occlog.records.scene import Camera

from .common import CalibrationOptions, Pose, build_camera, read_text, scale_of

PIXEL = 1.0 / 64.0
AXES = np.diag([1.0, -1.0, -1.0])


def detect(text: str) -> bool:
    """Return whether a text is a Qualisys calibration."""
    head = text[:4000]
    return "<calibration" in head and "<camera" in text and "<transform" in text and "focalLengthU" in text


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """The active cameras of one calibration file, named by their serial numbers."""
    cameras = []
    for path in paths:
        root = parse_xml(read_text(path), path)
        for element in root.iter("camera"):
            if element.get("active", "1") != "0":
                cameras.append(_camera(element, path, options))
    return tuple(cameras)


def _camera(element: Element, path: Path, options: CalibrationOptions) -> Camera:
    name = element.get("serial") or element.get("name") or ""
    where = f"{path}: camera {name or '?'}"
    if element.get("viewrotation", "0") not in ("0", ""):
        raise InputError(f"{where}: viewrotation {element.get('viewrotation')}; export it with a view rotation of 0")
    inner = required(element, "intrinsic", where)
    transform = required(element, "transform", where)
    if number(inner, "skew", where, 0.0):
        raise InputError(f"{where}: skew {inner.get('skew')}; cameras with a skew cannot be used")
    r = np.array([[number(transform, f"r{i}{j}", where) for j in (1, 2, 3)] for i in (1, 2, 3)])
    pose = Pose(
        name=name,
        focal_px=[number(inner, f"focalLength{axis}", where) * PIXEL for axis in "UV"],
        principal_px=[number(inner, f"centerPoint{axis}", where) * PIXEL for axis in "UV"],
        rotation=AXES @ r,
        centre=np.array([number(transform, axis, where) for axis in "xyz"]) * scale_of(options, "mm"),
        image_size=options.image_size or _size(element, where),
        distortion=[
            number(inner, "radialDistortion1", where, 0.0),
            number(inner, "radialDistortion2", where, 0.0),
            number(inner, "tangentalDistortion1", where, 0.0),
            number(inner, "tangentalDistortion2", where, 0.0),
            number(inner, "radialDistortion3", where, 0.0),
        ],
    )
    return build_camera(pose, where)


def _size(element: Element, where: str) -> tuple[int, int]:
    field = required(element, "fov_video", where)
    left, top, right, bottom = (number(field, side, where) for side in ("left", "top", "right", "bottom"))
    return int(right - left) + 1, int(bottom - top) + 1
