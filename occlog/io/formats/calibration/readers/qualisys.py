"""Qualisys Track Manager calibrations (`.qca.txt`, XML).

Lengths are millimetres, world z is up.  Intrinsic values are in 1/64 pixel.  With the
matrix r of a camera (r11 ... r33), R = diag(1, -1, -1) r turns world into camera
coordinates (x right, y down, z forward), and (x, y, z) is the camera's centre.  `fov_video` is the part of the
sensor that the video shows, `video_resolution` (540p) its rows where pixels of the sensor are joined.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from occlog.errors import InputError
from occlog.io.files.texts.documents import number, parse_xml, required
from occlog.records.scene import Camera

from ..common import CalibrationOptions, CameraParameters, ImageRegion, build_camera, keys_of, read_text, scale_of
from ..lenses import Lens

PIXEL = 1.0 / 64.0
AXES = np.diag([1.0, -1.0, -1.0])
FULL_HD = (1080, 1088)
"""Rows of a sensor that `1080p` has all of: those of the image, and those that are read out."""
_ROWS = re.compile(r"(\d{1,5})p")
SENSOR_SLACK_PX = 2.0
"""Largest difference between the sizes of the sensor by the lens and by the field of view."""
LIMITS = keys_of("left top right bottom")
KEYS = {
    "camera": keys_of(
        "active serial name viewrotation video_resolution",
        "avg-residual calibrated message model point-count",  # without effect: how well it was calibrated, with what
    ),
    "intrinsic": keys_of(
        "focallengthu focallengthv centerpointu centerpointv skew sensorminu sensormaxu sensorminv sensormaxv",
        "radialdistortion1 radialdistortion2 radialdistortion3 tangentaldistortion1 tangentaldistortion2",
        "focallength",  # without effect: in mm of a sensor that is not stated
    ),
    "transform": keys_of("x y z r11 r12 r13 r21 r22 r23 r31 r32 r33"),
    "fov_video": LIMITS,
    "fov_video_max": LIMITS,
    # Without effect: of the images in which markers are found, not of the video
    "fov_marker": LIMITS,
    "fov_marker_max": LIMITS,
}
"""Elements and their attributes, in small letters, that are used or known to be without effect."""


def detect(text: str) -> bool:
    """Whether a text is a calibration of Qualisys Track Manager (XML)."""
    head = text[:4000]
    return "<calibration" in head and "<camera" in text and "<transform" in text and "focalLengthU" in text


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read the active cameras of Qualisys calibration files, named by their serial numbers."""
    cameras = []
    for path in paths:
        root = parse_xml(read_text(path), path)
        for element in root.iter("camera"):
            if _is_active(element, path):
                cameras.append(_camera(element, path, options))
    return tuple(cameras)


def _is_active(element: Element, path: Path) -> bool:
    """Whether a camera is in use, by the attribute `active` of its element; also if the attribute is missing.

    InputError unless it is 0, 1, false or true.
    """
    stated = element.get("active", "1").lower()
    if stated not in ("0", "1", "false", "true"):
        raise InputError(f"{path}: camera {element.get('serial')}: active is {stated}; 0 or 1 was expected")
    return stated in ("1", "true")


def _camera(element: Element, path: Path, options: CalibrationOptions) -> Camera:
    name = element.get("serial") or element.get("name") or ""
    where = f"{path}: camera {name or '?'}"
    if element.get("viewrotation", "0") not in ("0", ""):
        raise InputError(
            f"{where}: viewrotation {element.get('viewrotation')}; export it with a view rotation of 0",
            id="unsupported-format",
        )
    options.check_keys(name, element.attrib, KEYS["camera"])
    options.check_keys(name, (part.tag for part in element), KEYS)
    for part in element:
        options.check_keys(name, part.attrib, KEYS.get(part.tag, ()))
    inner = required(element, "intrinsic", where)
    transform = required(element, "transform", where)
    if number(inner, "skew", where, 0.0):
        raise InputError(
            f"{where}: skew {inner.get('skew')}; cameras with a skew cannot be used: calibrate without skew",
            id="unsupported-format",
        )
    r = np.array([[number(transform, f"r{i}{j}", where) for j in (1, 2, 3)] for i in (1, 2, 3)])
    region = _region(element, inner, where)
    focal, principal = region.intrinsics(
        np.array([number(inner, f"focalLength{axis}", where) for axis in "UV"]) * PIXEL,
        np.array([number(inner, f"centerPoint{axis}", where) for axis in "UV"]) * PIXEL,
    )
    if (region.scale != 1.0).any() or region.offset.any():
        options.notes.append(
            f"camera {name}: video of {region.size[0]} x {region.size[1]} px, {region.scale[1]:.4g} of the sensor's "
            f"pixels (video_resolution), from its pixel {region.offset[0]:g}, {region.offset[1]:g} (fov_video)"
        )
    pose = CameraParameters(
        name=name,
        focal_px=focal,
        principal_px=principal,
        rotation=AXES @ r,
        centre=np.array([number(transform, axis, where) for axis in "xyz"]) * scale_of(options, "mm"),
        image_size=region.size,
        lens=Lens(
            "brown",
            np.array(
                [
                    number(inner, "radialDistortion1", where, 0.0),
                    number(inner, "radialDistortion2", where, 0.0),
                    number(inner, "tangentalDistortion1", where, 0.0),
                    number(inner, "tangentalDistortion2", where, 0.0),
                    number(inner, "radialDistortion3", where, 0.0),
                ]
            ),
        ),
    )
    return build_camera(pose, where, options)


def _region(element: Element, inner: Element, where: str) -> ImageRegion:
    """Part of the sensor that the video shows (`fov_video`), scaled to the rows of `video_resolution`.

    Args:
        element: XML element of the camera.
        inner: element of its intrinsics.
        where: file and camera, for messages.

    Raises:
        InputError: the sizes of the sensor contradict each other, or the resolution is invalid.
    """
    left, top, right, bottom = _limits(required(element, "fov_video", where), where)
    found = element.find("fov_video_max")
    most = (left, top, right, bottom) if found is None else _limits(found, where)
    for axis, low, high in (("U", most[0], most[2]), ("V", most[1], most[3])):
        ends = [number(inner, f"sensor{end}{axis}", where, np.nan) * PIXEL for end in ("Min", "Max")]
        off = float(np.nan_to_num(np.abs(np.array(ends) - [low, high])).max())
        if found is not None and off > SENSOR_SLACK_PX:
            raise InputError(
                f"{where}: fov_video_max is {low:g} to {high:g}, but the sensor of the lens {ends[0]:g} to "
                f"{ends[1]:g} px (sensorMin{axis}, sensorMax{axis}); calibrate again, or correct one",
                id="invalid-calibration",
            )
    rows = min(most[2] - most[0], most[3] - most[1]) + 1
    rows = float(FULL_HD[0]) if FULL_HD[0] <= rows <= FULL_HD[1] else rows
    stated = element.get("video_resolution", "")
    scale = 1.0
    if stated not in ("", "N/A", "none"):
        match = _ROWS.fullmatch(stated)
        if match is None or not 0 < int(match[1]) <= rows:
            raise InputError(
                f"{where}: video_resolution {stated}; 540p or the like was expected, at most {rows:g}p",
                id="invalid-calibration",
            )
        scale = int(match[1]) / rows
    size = (int((right - left + 1) * scale + 0.5), int((bottom - top + 1) * scale + 0.5))
    return ImageRegion(size, np.array([left, top]), np.array([scale, scale]))


def _limits(element: Element, where: str) -> tuple[float, float, float, float]:
    left, top, right, bottom = (number(element, side, where) for side in ("left", "top", "right", "bottom"))
    return left, top, right, bottom
