"""Shared parts of calibration importers: checked matrices to a `Camera`.

OpenCV's rational lens, fitted by Brown's, which has fewer coefficients.

The fit is by least squares over the image, and the lens is refused where it is not close enough for measurements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.io.files.names import safe_name
from occlog.io.files.texts.formats import Probe
from occlog.io.files.texts.yaml import yaml_documents
from occlog.records.scene import MAX_COORDINATE, MAX_FOCAL_PX, MIN_FOCAL_PX, Camera, camera_fov

MAX_ERROR_PX = 0.5
"""Largest difference [px] between a lens and its fit anywhere in the image."""
GRID = 41
ITERATIONS = 200


def fit_rational(
    coefficients: Floats, size: tuple[int, int], focal: Floats, principal: Floats, where: str
) -> tuple[Floats, float]:
    """Brown's coefficients (5,) for OpenCV's rational lens k1, k2, p1, p2, k3, k4, k5, k6, and the difference [px].

    Raises:
        InputError: the lens cannot be undone in the image, or the fit is not close.
    """
    distorted = _grid(size, focal, principal)
    ideal = distorted.copy()
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            ideal = ideal + distorted - _rational(ideal, coefficients)
        off = np.abs(_rational(ideal, coefficients) - distorted).max()
    if not off < 1e-6:
        raise InputError(
            f"{where}: the rational lens {coefficients.tolist()} cannot be undone at the edge of the image"
        )
    return _fit(ideal, distorted, focal, where)


def _rational(xy: Floats, coefficients: Floats) -> Floats:
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = xy.T
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    along = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    return np.column_stack([along, y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y])


def _grid(size: tuple[int, int], focal: Floats, principal: Floats) -> Floats:
    """(N, 2) normalised image coordinates of a grid over the image."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, GRID), np.linspace(0, size[1] - 1, GRID))
    return np.asarray((np.column_stack([u.ravel(), v.ravel()]) - principal) / focal)


def _fit(ideal: Floats, distorted: Floats, focal: Floats, where: str) -> tuple[Floats, float]:
    """Brown's coefficients by least squares; InputError where they differ by more than `MAX_ERROR_PX`."""
    x, y = ideal.T
    r2 = x * x + y * y
    across = np.column_stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3])
    down = np.column_stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3])
    terms = np.concatenate([across * focal[0], down * focal[1]])
    wanted = ((distorted - ideal) * focal).T.ravel()
    scale = np.abs(terms).max(axis=0)
    found = np.linalg.lstsq(terms / scale, wanted, rcond=None)[0] / scale
    worst = float(np.abs(terms @ found - wanted).max())
    if not worst <= MAX_ERROR_PX:
        raise InputError(
            f"{where}: Brown's lens differs from its rational one by {worst:.2g} px; the limit is {MAX_ERROR_PX:g}: "
            "undistort the images first"
        )
    return found, worst


WHAT = "a camera calibration"
MAX_BYTES = 16 * 2**20
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
MAX_ROUND_TRIP_PX = 0.5
MAX_FISHEYE_DEG = 80.0
"""Beyond, the ideal image that all methods work in becomes too large."""
MAX_ROUNDING = 1e-6
MAX_SKEW_PX = 1.0
"""A larger skew would shift bearings by more than the noise of a reading; `Camera` has none."""


@dataclass(frozen=True, eq=False)
class CalibrationOptions:
    """Options for values that some formats do not state.

    Attributes:
        unit: length unit of the file, `m`, `cm` or `mm`; None: the format's own, else metres.
        image_size: width and height [px]; None: as stated in the file.
        notes: importers add their assumptions, as notes for users.
    """

    unit: str | None = None
    image_size: tuple[int, int] | None = None
    notes: list[str] = field(default_factory=list)


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
        model: `brown`, `tsai` or `equidistant`.
    """

    name: str
    focal_px: Sequence[float]
    principal_px: Sequence[float]
    rotation: Floats
    centre: Floats
    image_size: tuple[int, int] | None
    distortion: Sequence[float] = ()
    model: str = "brown"


class Lens(NamedTuple):
    """A lens as a file states it.

    `brown` has k1, k2, p1, p2, k3; `rational` k4, k5, k6 also; `equidistant` k1 to k4.
    """

    model: str
    coefficients: Floats


def lens_pose(
    *,
    name: str,
    focal: Floats,
    principal: Floats,
    size: tuple[int, int],
    lens: Lens,
    rotation: Floats,
    translation: Floats,
    options: CalibrationOptions,
    where: str,
) -> Pose:
    """The pose of a camera with Xc = R Xw + t [m], with a lens that is fitted by Brown's where it is rational.

    Raises:
        InputError: the lens cannot be fitted closely.
    """
    coefficients, model = np.asarray(lens.coefficients, dtype=np.float64), lens.model
    if model == "rational" and (focal > 0).all():
        coefficients, off = fit_rational(coefficients, size, focal, principal, where)
        options.notes.append(f"{name}: rational lens, fitted by Brown's within {off:.2g} px")
        model = "brown"
    return Pose(
        name=name,
        focal_px=focal.tolist(),
        principal_px=principal.tolist(),
        rotation=rotation,
        centre=-rotation.T @ translation,
        image_size=size,
        distortion=coefficients.tolist(),
        model=model,
    )


def numbers(value: object, what: str) -> Floats:
    """The value as an array of finite numbers; InputError where it is none."""
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError(f"{what} is not made of numbers, in rows of equal length") from None
    if not np.isfinite(array).all():
        raise InputError(f"{what} has numbers that are not finite")
    return array


def check_camera_matrix(matrix: Floats, height: float, where: str) -> None:
    """InputError for a matrix that is not [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], with a skew that matters.

    MATLAB's `IntrinsicMatrix` is its transpose, with the principal point at (0, 0).
    """
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise InputError(f"{where}: expected a 3 x 3 camera matrix")
    below = np.array([matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1.0])
    if np.abs(below).max() > MAX_ROUNDING:
        hint = "; it is transposed, as MATLAB has it" if matrix[2, :2].any() and not matrix[:2, 2].any() else ""
        raise InputError(
            f"{where}: camera matrix {matrix.tolist()}; expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]{hint}"
        )
    lean = abs(float(matrix[0, 1])) * height / 2 / max(abs(float(matrix[1, 1])), 1e-300)
    if not lean <= MAX_SKEW_PX:
        raise InputError(f"{where}: has a skew of {lean:.2g} px at the edge of the image; the limit is {MAX_SKEW_PX:g}")


def yaml_values(text: str, path: Path) -> dict[str, object]:
    """The values of a YAML file that has names at its top; InputError for anything else."""
    documents = yaml_documents(text, path, WHAT)
    values = documents[0] if len(documents) == 1 else None
    if not isinstance(values, dict):
        raise InputError(f"{path}: names no values in one document; {WHAT} was expected")
    return {str(key): value for key, value in values.items()}


def read_text(path: Path) -> str:
    """Content of a calibration file; InputError unless it is a text of moderate size."""
    return Probe(path, WHAT).text


def scale_of(options: CalibrationOptions, own: str) -> float:
    """Metres of one unit of the file; `own` is the unit that the format has unless stated otherwise."""
    return UNITS[options.unit or own]


def build_camera(pose: Pose, where: str) -> Camera:
    """The camera of a pose; InputError where its numbers cannot be those of a camera."""
    if not pose.name.strip():
        raise InputError(f"{where}: a camera has no name; give it one")
    focal = _vector(pose.focal_px, 2, "focal length", where)
    principal = _vector(pose.principal_px, 2, "principal point", where)
    centre = _vector(pose.centre, 3, "camera centre", where)
    if not ((focal >= MIN_FOCAL_PX) & (focal <= MAX_FOCAL_PX)).all():
        raise InputError(
            f"{where}: focal length {focal[0]:g}, {focal[1]:g} px; it must be {MIN_FOCAL_PX:g} to {MAX_FOCAL_PX:g}"
        )
    if (far := np.abs(centre).max()) > MAX_COORDINATE:
        raise InputError(f"{where}: a camera centre {far:g} away; it must be within {MAX_COORDINATE:g}")
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
    if pose.model == "equidistant":
        _check_fisheye(camera, size, where)
    # Tsai's model gives the line of sight of a pixel directly; only the way back has to be solved.
    if pose.model == "brown" and not off < MAX_ROUND_TRIP_PX:
        raise InputError(f"{where}: the distortion {given.tolist()} cannot be undone at the edge of the image")
    return camera


def _round_trip(camera: Camera, size: tuple[int, int]) -> float:
    """Return the largest error of border pixels after undistortion and distortion [px]."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, 9), np.linspace(0, size[1] - 1, 9))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    return float(np.abs(camera.project(camera.position + camera.rays(pixels)) - pixels).max())


def _check_fisheye(camera: Camera, size: tuple[int, int], where: str) -> None:
    """InputError where a border pixel of a fisheye is so far off the axis that its ray cannot be used."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, 9), np.linspace(0, size[1] - 1, 9))
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()])) @ camera.rotation
    if not np.hypot(rays[:, 0], rays[:, 1]).max() < np.tan(np.radians(MAX_FISHEYE_DEG)):
        raise InputError(
            f"{where}: an equidistant (fisheye) lens that sees more than {MAX_FISHEYE_DEG:g} degrees off its axis; "
            "undistort the images first"
        )


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
    if not off <= 1e-3:
        raise InputError(f"{where}: the rotation matrix is not orthonormal (off by {off:.2g}, limit 0.001)")
    if np.linalg.det(r) < 0:
        raise InputError(f"{where}: the rotation matrix is mirrored (determinant -1); an axis has the wrong sign")
    u, _, vt = np.linalg.svd(r)
    return np.asarray(u @ vt)
