"""Shared parts of calibration readers: options, poses and lenses as files state them, conversion to `Camera`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, option
from occlog.io.files.names import safe_name
from occlog.io.files.texts.formats import Probe
from occlog.io.files.texts.yaml import yaml_documents
from occlog.records.scene import MAX_COORDINATE, MAX_FOCAL_PX, MIN_FOCAL_PX, Camera, camera_fov
from occlog.records.verdicts import Check, finding

from .lenses import Lens, checked_lens, read_lens

WHAT = "a camera calibration"
CALIBRATION = "calibration files"
"""Name of the check of what calibrations state."""
MAX_BYTES = 16 * 2**20
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
MAX_PIXEL_ASPECT = 1.6
"""Ratio of the focal lengths of rows and columns above which a warning is given; anamorphic PAL has 1.46."""
OTHER_SIZE, SAME_RATIO = 0.2, 0.03
"""A principal point that is off the middle by this share of it or more, and by the same across and down to that, is the
middle of images of another size."""
AT_CORNER = 0.9
"""... or off both ways by this share: it is near a corner, or outside of the images."""
MAX_FOV_DEG = 170.0
"""Field of view of a lens without fisheye, above which the matrix is not in pixels."""
MAX_ROUNDING = 1e-6
MAX_SKEW_PX = 1.0
"""A larger skew would shift bearings by more than the noise of a reading; `Camera` has none."""


@dataclass(frozen=True, eq=False)
class CalibrationOptions:
    """Options for values that some formats do not state; readers also add their notes and findings to it.

    Attributes:
        unit: length unit of the file, `m`, `cm` or `mm`; None: the format's own, else metres.
        image_size: width and height [px] of the images, for files that do not state it; None: not given.
        lens_model: a key of `LENS_MODELS`, for files with 4 coefficients that do not state their model; None: not
            given.
        mirror: axis `x`, `y` or `z` of a left-handed world, in which rotations may have determinant -1; None:
            right-handed.
        notes: assumptions of the readers, for users.
        findings: what may be wrong.
        unused: keys of files that are not used, each with the cameras that have it.
    """

    unit: str | None = None
    image_size: tuple[int, int] | None = None
    lens_model: str | None = None
    mirror: str | None = None
    notes: list[str] = field(default_factory=list)
    findings: list[Check] = field(default_factory=list)
    unused: dict[str, list[str]] = field(default_factory=dict)

    def check_keys(self, name: str, keys: Iterable[str], known: Collection[str]) -> None:
        """Add the keys of camera `name` that are not among `known` (lower case) to `unused`, for a note."""
        for key in keys:
            if key.lower() not in known:
                self.unused.setdefault(key, []).append(name)


@dataclass(frozen=True, eq=False)
class CameraParameters:
    """Intrinsic and extrinsic parameters of one camera as a file states them, not checked.

    Attributes:
        name: the camera's name.
        focal_px: focal lengths in x and y [px].
        principal_px: principal point [px].
        rotation: (3, 3) camera-from-world; rows are the camera's axes x right, y down, z forward.
        centre: (3,) camera centre [m].
        image_size: width and height [px], None if not stated.
        lens: the distortion.
        binned_aspect: ratio of the focal lengths y and x that binning as stated makes of equal ones.
    """

    name: str
    focal_px: Sequence[float] | Floats
    principal_px: Sequence[float] | Floats
    rotation: Floats
    centre: Floats
    image_size: tuple[int, int] | None
    lens: Lens = Lens()
    binned_aspect: float = 1.0


def centre_of_extrinsics(rotation: Floats, translation: Floats) -> Floats:
    """Return the camera centre (3,) in the world for extrinsics R (3, 3) and t (3,), with x_camera = R x_world + t."""
    return -rotation.T @ translation


def keys_of(*texts: str) -> frozenset[str]:
    """Set of names from texts in which they are separated by spaces."""
    return frozenset(key for text in texts for key in text.split())


def mirror_matrix(axis: str | None) -> Floats:
    """(3, 3) reflection that changes the sign of axis `x`, `y` or `z`; the identity for None."""
    return np.diag([-1.0 if each == axis else 1.0 for each in "xyz"])


class ImageRegion(NamedTuple):
    """Part of the sensor that the images show (region of interest), and its scale (binning)."""

    size: tuple[int, int]  # of the images [px]
    offset: Floats  # (2,) first pixel, in pixels of the sensor
    scale: Floats  # (2,) pixels of the image in one of the sensor

    def intrinsics(self, focal: Floats, principal: Floats) -> tuple[Floats, Floats]:
        """Focal lengths and principal point of the images, (2,) each [px], from those of the whole sensor.

        Pixel centres have integer coordinates.
        """
        return focal * self.scale, (principal - self.offset + 0.5) * self.scale - 0.5


def numbers(value: object, what: str) -> Floats:
    """Convert nested lists to an array of finite numbers.

    InputError, which begins with `what`, if that is impossible.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError(f"{what} must be numbers, in rows of equal length", id="invalid-calibration") from None
    if not np.isfinite(array).all():
        raise InputError(f"{what} has numbers that are not finite", id="invalid-calibration")
    return array


def check_camera_matrix(matrix: Floats, height: float, where: str) -> None:
    """InputError unless a matrix is [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with negligible skew.

    A transposed one (MATLAB's `IntrinsicMatrix`) is refused with a hint.

    Args:
        matrix: any array.
        height: of the image [px], at the edge of which the effect of the skew is limited.
        where: file and camera, for messages.
    """
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise InputError(f"{where}: expected a 3 x 3 camera matrix", id="invalid-calibration")
    below = np.array([matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1.0])
    if np.abs(below).max() > MAX_ROUNDING:
        hint = "; it is transposed, as MATLAB has it" if matrix[2, :2].any() and not matrix[:2, 2].any() else ""
        raise InputError(
            f"{where}: camera matrix {matrix.tolist()}; expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]{hint}",
            id="invalid-calibration",
        )
    lean = abs(float(matrix[0, 1])) * height / 2 / max(abs(float(matrix[1, 1])), 1e-300)
    if not lean <= MAX_SKEW_PX:
        raise InputError(
            f"{where}: skew of the camera matrix: {lean:.2g} px at the edge of the image, limit {MAX_SKEW_PX:g}; "
            "calibrate without skew",
            id="invalid-calibration",
        )


def yaml_values(text: str, path: Path) -> dict[str, object]:
    """Values by name of a YAML text that is one mapping; InputError, with the file `path`, for anything else."""
    documents = yaml_documents(text, path, WHAT)
    values = documents[0] if len(documents) == 1 else None
    if not isinstance(values, dict):
        raise InputError(
            f"{path}: is not one YAML document with names and values; {WHAT} was expected", id="empty-input"
        )
    return {str(key): value for key, value in values.items()}


def read_text(path: Path) -> str:
    """Text of a calibration file; InputError unless it is UTF-8 of moderate size."""
    return Probe(path, WHAT).text


def scale_of(options: CalibrationOptions, own: str) -> float:
    """Metres per length unit of a file: of the unit that the user states, else of the format's own unit `own`."""
    return UNITS[options.unit or own]


def build_camera(pose: CameraParameters, where: str, options: CalibrationOptions) -> Camera:
    """Check parameters of a camera, and create the camera of the scene.

    Notes on its lens, and findings about implausible values, are added to `options`.

    Args:
        pose: parameters as stated.
        where: file and camera, for messages.
        options: image size, lens model and axis to mirror, where files do not state them.

    Raises:
        InputError: a parameter is impossible, or the image size is unknown.
    """
    if not pose.name.strip():
        raise InputError(f"{where}: a camera has no name; give it one", id="missing-value")
    focal = _vector(pose.focal_px, 2, "focal length", where)
    principal = _vector(pose.principal_px, 2, "principal point", where)
    centre = _vector(pose.centre, 3, "camera centre", where)
    if not ((focal >= MIN_FOCAL_PX) & (focal <= MAX_FOCAL_PX)).all():
        raise InputError(
            f"{where}: focal length {focal[0]:g}, {focal[1]:g} px; it must be {MIN_FOCAL_PX:g} to {MAX_FOCAL_PX:g}",
            id="invalid-calibration",
        )
    if (far := np.abs(centre).max()) > MAX_COORDINATE:
        raise InputError(
            f"{where}: the camera centre is {far:g} m from the origin, limit {MAX_COORDINATE:g}; correct its position",
            id="invalid-calibration",
        )
    size = pose.image_size or options.image_size
    if size is None:
        raise InputError(
            f"{where}: does not state the size of the images; give {option('image_size')} WIDTHxHEIGHT",
            id="missing-image-size",
        )
    if not (0 < size[0] < 65536 and 0 < size[1] < 65536):
        raise InputError(
            f"{where}: images of {size[0]} x {size[1]} px; both must be 1 to 65535", id="invalid-calibration"
        )
    rotation = _rotation(pose.rotation, options.mirror is not None, where).T
    lens = read_lens(pose.lens, options.lens_model, where)
    wide = float(np.degrees(2.0 * np.arctan(0.5 * max(size) / focal.max())))
    if lens.model != "equidistant" and wide > MAX_FOV_DEG:
        raise InputError(
            f"{where}: focal length {focal[0]:.4g} px in images of {size[0]} x {size[1]} px ({wide:.0f} degrees wide); "
            "give the matrix in pixels, not normalised or in mm",
            id="invalid-calibration",
        )
    with np.errstate(all="ignore"):
        model, coefficients, reported = checked_lens(lens, size, focal, principal, where)
        fov = camera_fov(size, focal, principal, coefficients, model, rotation)
    if reported:
        options.notes.append(f"camera {pose.name}: {reported}")
    if not 1.0 / MAX_PIXEL_ASPECT < float(focal[1] / focal[0]) / pose.binned_aspect < MAX_PIXEL_ASPECT:
        found = finding(
            CALIBRATION, "focal-lengths-differ", sensors=[pose.name], fx_px=float(focal[0]), fy_px=float(focal[1])
        )
        options.findings.append(found)
    if change := _other_middle(principal, size):
        width, height = np.round(2.0 * principal + 1.0).astype(int).tolist()
        middle, own = f"{width} x {height}", f"{size[0]} x {size[1]}"
        options.findings.append(
            finding(CALIBRATION, "principal-point-off", sensors=[pose.name], middle=middle, size=own, change=change)
        )
    return Camera(
        name=safe_name(pose.name),
        position=centre,
        rotation=rotation,
        focal_px=focal,
        principal_px=principal,
        image_size=size,
        distortion=coefficients,
        distortion_model=model,
        fov=fov,
    )


def _other_middle(principal: Floats, size: tuple[int, int]) -> str:
    """Text on how the image size seems wrong, judged by the principal point (2,) [px]; empty if it may be right.

    Either width and height are exchanged, or the point is the middle of images larger or smaller by a factor.
    """
    ratio = (principal + 0.5) / (0.5 * np.array(size))
    if not np.abs(ratio - 1.0).min() > OTHER_SIZE:
        return ""
    if np.abs((principal + 0.5) / (0.5 * np.array(size[::-1])) - 1.0).max() < OTHER_SIZE:
        return "width and height exchanged"
    same = ratio.min() > 0.0 and abs(ratio[0] / ratio[1] - 1.0) < SAME_RATIO
    return f"factor {ratio.mean():.3g}" if same or np.abs(ratio - 1.0).min() > AT_CORNER else ""


def _vector(values: Sequence[float] | Floats, n: int, what: str, where: str) -> Floats:
    array = np.asarray(values, dtype=np.float64).reshape(-1)
    if len(array) != n or not np.isfinite(array).all():
        raise InputError(
            f"{where}: {what} {array.tolist()}; {n} finite numbers were expected", id="invalid-calibration"
        )
    return array


def _rotation(matrix: Floats, mirrored: bool, where: str) -> Floats:
    """Nearest rotation matrix (3, 3) to a stated one.

    Args:
        matrix: as stated.
        mirrored: the world is left-handed: the negative of a matrix with determinant -1 is used.
        where: file and camera, for messages.

    Raises:
        InputError: the matrix is not orthonormal to 0.001, or has determinant -1 and is not mirrored.
    """
    r = np.asarray(matrix, dtype=np.float64)
    if r.shape != (3, 3) or not np.isfinite(r).all():
        raise InputError(f"{where}: the rotation is not a matrix of 3 x 3 finite numbers", id="invalid-calibration")
    off = float(np.abs(r @ r.T - np.eye(3)).max())
    if not off <= 1e-3:
        raise InputError(
            f"{where}: the rotation matrix is not orthonormal (off by {off:.2g}, limit 0.001); write more digits, and "
            "no scale",
            id="invalid-calibration",
        )
    if np.linalg.det(r) < 0 and not mirrored:
        raise InputError(
            f"{where}: the rotation matrix is mirrored (determinant -1); an axis has the wrong sign, or the world is "
            f"left-handed (Unity): mirror it, {option('mirror')} y",
            id="invalid-calibration",
        )
    u, _, vt = np.linalg.svd(r * np.sign(np.linalg.det(r)))
    return np.asarray(u @ vt)
