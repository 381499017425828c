"""What all calibration importers share: checked matrices to a `Camera`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.inputs import check_input
from occlog.io.files.sensor_names import safe_name
from occlog.records.scene import Camera, camera_fov

WHAT = "a camera calibration"
MAX_BYTES = 16 * 2**20
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
MAX_ROUND_TRIP_PX = 0.5
MAX_SKEW_PX = 1.0
"""A larger skew would shift bearings by more than the noise of a reading; `Camera` has none."""


@dataclass(frozen=True, eq=False)
class CalibrationOptions:
    """What some formats do not say themselves.

    Attributes:
        unit: length unit of the file, `m`, `cm` or `mm`; None: the format's own, else metres.
        image_size: width and height [px]; None: as stated in the file.
    """

    unit: str | None = None
    image_size: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False)
class Pose:
    """Intrinsic and extrinsic parameters of one camera as a file states them.

    Attributes:
        name: the camera's name.
        focal_px: focal lengths in x and y [px].
        principal_px: principal point [px].
        rotation: (3, 3) camera-from-world, rows x right, y down, z forward.
        centre: (3,) camera centre [m].
        image_size: width and height [px], None if not stated.
        distortion: k1, k2, p1, p2, k3 (shorter lists are filled with zeros).
        model: `brown` or `tsai`.
    """

    name: str
    focal_px: Sequence[float]
    principal_px: Sequence[float]
    rotation: Floats
    centre: Floats
    image_size: tuple[int, int] | None
    distortion: Sequence[float] = ()
    model: str = "brown"


def read_text(path: Path) -> str:
    """Content of a calibration file; InputError unless it is a text of moderate size."""
    path = check_input(path, WHAT)
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: {path.stat().st_size} bytes; {WHAT} was expected, of at most {MAX_BYTES}")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start}: not UTF-8 text; {WHAT} was expected") from None


def scale_of(options: CalibrationOptions, own: str) -> float:
    """Metres of one unit of the file; `own` is the unit that the format has unless told otherwise."""
    return UNITS[options.unit or own]


def build_camera(pose: Pose, where: str) -> Camera:
    """The camera of a pose; InputError where its numbers cannot be those of a camera."""
    focal = _vector(pose.focal_px, 2, "focal length", where)
    principal = _vector(pose.principal_px, 2, "principal point", where)
    centre = _vector(pose.centre, 3, "camera centre", where)
    if not (focal > 0).all():
        raise InputError(f"{where}: focal length {focal[0]:g}, {focal[1]:g} px; it must be above 0")
    size = pose.image_size
    if size is None:
        raise InputError(f"{where}: does not state the size of the images; give the image size, WIDTHxHEIGHT")
    if not (0 < size[0] < 65536 and 0 < size[1] < 65536):
        raise InputError(f"{where}: images of {size[0]} x {size[1]} px; that cannot be")
    coefficients = np.zeros(5)
    given = _vector(pose.distortion, len(pose.distortion), "distortion", where)
    if len(given) > 5 and given[5:].any():
        raise InputError(f"{where}: {len(given)} distortion coefficients; only k1, k2, p1, p2, k3 can be used")
    coefficients[: min(len(given), 5)] = given[:5]
    rotation = _rotation(pose.rotation, where).T
    with np.errstate(all="ignore"):
        fov = camera_fov(size, focal, principal, coefficients, pose.model, rotation)
        camera = _camera(pose, centre, rotation, focal, principal, size, coefficients, fov)
        off = _round_trip(camera, size)
    # Tsai's model gives the sight line of a pixel directly; only the way back has to be solved.
    if pose.model == "brown" and not off < MAX_ROUND_TRIP_PX:
        raise InputError(f"{where}: the distortion {given.tolist()} cannot be undone at the edge of the image")
    return camera


def _round_trip(camera: Camera, size: tuple[int, int]) -> float:
    """How far pixels of the image's border are from themselves after being undistorted and distorted again [px]."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, 9), np.linspace(0, size[1] - 1, 9))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    return float(np.abs(camera.project(camera.position + camera.rays(pixels)) - pixels).max())


def _camera(
    pose: Pose,
    centre: Floats,
    rotation: Floats,
    focal: Floats,
    principal: Floats,
    size: tuple[int, int],
    coefficients: Floats,
    fov: float,
) -> Camera:
    return Camera(
        name=safe_name(pose.name),
        position=centre,
        rotation=rotation,
        focal_px=focal,
        principal_px=principal,
        image_size=size,
        distortion=coefficients,
        distortion_model=pose.model,
        fov=fov,
    )


def _vector(values: Sequence[float] | Floats, n: int, what: str, where: str) -> Floats:
    array = np.asarray(values, dtype=np.float64).reshape(-1)
    if len(array) != n or not np.isfinite(array).all():
        raise InputError(f"{where}: {what} {array.tolist()}; {n} finite numbers were expected")
    return array


def _rotation(matrix: Floats, where: str) -> Floats:
    """The nearest rotation; InputError for a matrix that is none, or is mirrored."""
    r = np.asarray(matrix, dtype=np.float64)
    if r.shape != (3, 3) or not np.isfinite(r).all():
        raise InputError(f"{where}: the rotation is not a matrix of 3 x 3 finite numbers")
    off = float(np.abs(r @ r.T - np.eye(3)).max())
    if off > 1e-3:
        raise InputError(f"{where}: the rotation matrix is not orthonormal (off by {off:.2g}, limit 0.001)")
    if np.linalg.det(r) < 0:
        raise InputError(f"{where}: the rotation matrix is mirrored (determinant -1); an axis has the wrong sign")
    u, _, vt = np.linalg.svd(r)
    return np.asarray(u @ vt)
