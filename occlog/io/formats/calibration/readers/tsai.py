"""Tsai calibrations as the PETS data sets give them: one XML file a camera.

World millimetres, Z = 0 the ground.  Xc = R Xw + T with R = Rz Ry Rx; the undistorted
sensor position f Xc/Zc [mm] and the distorted one (Xd, Yd) are related by
Xu = Xd (1 + kappa1 r^2), r^2 = Xd^2 + Yd^2 [Tsai 1987, Eq. 5]; the pixel is
(sx Xd / dpx + cx, Yd / dpy + cy).  In coordinates divided by f the coefficient is kappa1 f^2.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.texts.documents import number, parse_xml, required
from occlog.records.scene import Camera

from ..common import CalibrationOptions, CameraParameters, build_camera, centre_of_extrinsics, read_text, scale_of
from ..lenses import Lens

KEYS = {
    "Camera": frozenset(("name",)),
    "Geometry": frozenset(("width", "height", "ncx", "nfx", "dx", "dy", "dpx", "dpy")),
    "Intrinsic": frozenset(("focal", "kappa1", "cx", "cy", "sx")),
    "Extrinsic": frozenset(("tx", "ty", "tz", "rx", "ry", "rz")),
}
"""Elements and their attributes that are used."""
MAX_RATIO = 0.01
"""Largest relative difference of the size of a pixel from that by the cells of the sensor."""


def detect(text: str) -> bool:
    """Whether a text is a Tsai calibration (XML, as in the PETS data sets)."""
    return "<Camera" in text and "<Geometry" in text and "kappa1" in text


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read one camera per file of Tsai's calibration (XML), named as in the file."""
    return tuple(_camera(path, options) for path in paths)


def _camera(path: Path, options: CalibrationOptions) -> Camera:
    root = parse_xml(read_text(path), path)
    name = root.get("name") or path.stem
    where = f"{path}: camera {name}"
    options.check_keys(name, root.attrib, KEYS["Camera"])
    options.check_keys(name, (part.tag for part in root), {key.lower() for key in KEYS})
    for part in root:
        options.check_keys(name, part.attrib, KEYS.get(part.tag, ()))
    geometry, inner, outer = (required(root, part, where) for part in ("Geometry", "Intrinsic", "Extrinsic"))
    focal = number(inner, "focal", where)
    dpx, dpy = number(geometry, "dpx", where), number(geometry, "dpy", where)
    if dpx <= 0 or dpy <= 0:
        raise InputError(f"{where}: pixels of {dpx:g} x {dpy:g} mm; they must be above 0", id="invalid-calibration")
    _check_pixel(geometry, dpx, dpy, where)
    rotation = rotation_zyx(*(number(outer, axis, where) for axis in ("rx", "ry", "rz")))
    translation = np.array([number(outer, axis, where) for axis in ("tx", "ty", "tz")])
    size = (int(number(geometry, "width", where)), int(number(geometry, "height", where)))
    pose = CameraParameters(
        name=name,
        focal_px=[number(inner, "sx", where, 1.0) * focal / dpx, focal / dpy],
        principal_px=[number(inner, "cx", where), number(inner, "cy", where)],
        rotation=rotation,
        centre=centre_of_extrinsics(rotation, translation) * scale_of(options, "mm"),
        image_size=size,
        lens=Lens("tsai", np.array([number(inner, "kappa1", where, 0.0) * focal**2])),
    )
    return build_camera(pose, where, options)


def _check_pixel(geometry: Element, dpx: float, dpy: float, where: str) -> None:
    """InputError if pixel sizes [mm] are inconsistent: dpx must be dx ncx / nfx, and dpy = dy, if these are stated.

    Args:
        geometry: XML element with the other sizes.
        dpx: width of a pixel [mm].
        dpy: height of a pixel [mm].
        where: file and camera, for messages.
    """
    dx, dy, ncx, nfx = (number(geometry, key, where, 0.0) for key in ("dx", "dy", "ncx", "nfx"))
    for key, size, by, other in (("dpx", dpx, "dx ncx / nfx", dx * ncx / nfx if nfx else 0.0), ("dpy", dpy, "dy", dy)):
        if other and abs(size / other - 1) > MAX_RATIO:
            raise InputError(
                f"{where}: {key} is {size:g} mm, but {by} is {other:g} mm, and both are the pixel size; correct one",
                id="conflicting-values",
            )


def rotation_zyx(rx: float, ry: float, rz: float) -> Floats:
    """(3, 3) rotation Rz Ry Rx of the angles rx, ry, rz [rad]."""
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(a), np.sin(a)) for a in (rx, ry, rz))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)
