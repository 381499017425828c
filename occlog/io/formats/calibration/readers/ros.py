"""ROS: `camera_info` files with lenses, and static transforms with positions.

A lens is the YAML of `camera_calibration` (`image_width`, `camera_matrix`, ...) or what `ros2 topic echo` prints of
`sensor_msgs/CameraInfo` (`width`, `k`, `d`, ...).  Positions are what it prints of `/tf_static`, or a list of
transforms with `frame_id`, `child_frame_id` (also in `header`), `translation` and `rotation` (x, y, z, w).  The frame
of a camera is its optical one (x right, y down, z forward: REP 103); the world is the frame that all others hang from.
Lengths are metres, and the lens is that of the raw images; `binning` and `roi` scale and shift it (REP 104).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, abridged
from occlog.io.files.texts.yaml import yaml_documents, yaml_text
from occlog.records.scene import Camera

from ..common import (
    WHAT,
    CalibrationOptions,
    CameraParameters,
    ImageRegion,
    build_camera,
    check_camera_matrix,
    keys_of,
    numbers,
    read_text,
    scale_of,
)
from ..lenses import Lens, stated_coefficients

LENSES = {
    "plumb_bob": "brown",
    "radtan": "brown",
    "rational_polynomial": "brown",
    "thin_prism": "brown",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
    "kannala_brandt": "equidistant",
    "": None,
}
"""Models of lenses by their names in ROS."""
WRITTEN = {5: "plumb_bob", 8: "rational_polynomial"}
"""Names of polynomial lenses that are written, by the number of coefficients."""
PLUMB_BOB = ("plumb_bob", "radtan")
"""Names of lenses with at most five coefficients."""
KEYS = keys_of(
    "image_width image_height width height camera_name camera_matrix k distortion_model distortion_coefficients d",
    "header binning_x binning_y roi",
    "rectification_matrix projection_matrix r p",  # without effect: of rectified images, and the lens is of raw ones
)
"""Keys of a `camera_info` that are used, or known to be without effect."""
ROI_KEYS = keys_of("x_offset y_offset width height do_rectify")
_INFO = re.compile(r"^[ \t]*(distortion_model|camera_matrix)[ \t]*:", re.MULTILINE)
_TRANSFORM = re.compile(r"^[ \t]*(-[ \t]*)?child_frame_id[ \t]*:", re.MULTILINE)
_OPTICAL = re.compile(r"_?optical(_frame)?$")


class Transform(NamedTuple):
    """CameraParameters of a frame in its parent frame: p_parent = R p + t."""

    parent: str
    rotation: Floats
    translation: Floats


class _Tree(dict[str, Transform]):
    """CameraParameters of each frame in its parent, by the last of its transforms.

    Attributes:
        given: all transforms, with the names of their frames.
        parents: parents in any of them.
    """

    def __init__(self, given: Sequence[tuple[str, Transform]]) -> None:
        """Take transforms with the names of their frames, in order."""
        super().__init__(given)
        self.parents = list(dict.fromkeys(transform.parent for _, transform in given))
        self.given = given

    def check(self, frame: str, where: str) -> None:
        """InputError if a frame has transforms with different parents or poses; `where` is the camera, for messages."""
        last = self[frame]
        for other in (transform for name, transform in self.given if name == frame):
            if other.parent != last.parent:
                raise InputError(
                    f"{where}: frame {frame} has several parents, {other.parent} and {last.parent}; keep one transform",
                    id="invalid-calibration",
                )
            distance, angle = apart(other[1:], last[1:])
            if distance > STILL_M or angle > STILL_RAD:
                raise InputError(
                    f"{where}: {two_poses(frame, last.parent, other[1:], last[1:])}; keep one of them",
                    id="invalid-calibration",
                )


def detect(text: str) -> bool:
    """Whether a text is a `camera_info` or transforms of ROS, in YAML."""
    head = text.lstrip()[:1] in ("<", "{") or text.startswith("%YAML") or "opencv-matrix" in text
    return not head and (_INFO.search(text) is not None or _TRANSFORM.search(text) is not None)


def read(paths: list[Path], options: CalibrationOptions) -> tuple[Camera, ...]:
    """Read the cameras of ROS `camera_info` files, with poses from the static transforms in the other files.

    The world is the root frame of the transforms; a note states it.

    Raises:
        InputError: there are no transforms or no cameras, the transforms have several roots, or a camera is invalid.
    """
    lenses: dict[str, tuple[Path, Mapping[str, object]]] = {}
    given: list[tuple[str, Transform]] = []
    for path in paths:
        for part in _documents(path):
            if any(key in part for key in ("camera_matrix", "k", "K")):
                name = _name(path, part)
                if name in lenses:
                    raise InputError(
                        f"{path}: camera {name} is in {lenses[name][0].name}, too; keep one", id="duplicate-name"
                    )
                lenses[name] = (path, part)
            else:
                given += _transforms(path, part)
    tree = _Tree(given)
    if not lenses:
        raise InputError(
            f"{paths[0]}: transforms without cameras; give the camera_info of each camera as well", id="missing-pose"
        )
    if not tree:
        raise InputError(
            f"{paths[0]}: a camera_info does not state where the camera is; give the static transforms as well",
            id="missing-pose",
        )
    roots = {_root(frame, tree, paths[-1]) for frame in tree}
    if len(roots) > 1:
        raise InputError(
            f"{paths[-1]}: the transforms have several roots: {abridged(sorted(roots))}; connect them, as the world "
            "must be one frame",
            id="invalid-calibration",
        )
    options.notes.append(f"the world is the frame {roots.pop()}, lenses are those of raw images")
    return tuple(_camera(name, *lenses[name], tree, options) for name in lenses)


def _documents(path: Path) -> Iterator[dict[str, object]]:
    parts = [part for part in yaml_documents(read_text(path), path, WHAT) if part is not None]
    for part in parts:
        for value in part if isinstance(part, list) else [part]:
            if not isinstance(value, dict):
                raise InputError(
                    f"{path}: {str(value)[:40]!r}; camera_info or transforms of ROS were expected", id="unknown-format"
                )
            yield value


def _name(path: Path, part: Mapping[str, object]) -> str:
    header = part.get("header")
    frame = header.get("frame_id") if isinstance(header, dict) else None
    name = part.get("camera_name") or (_OPTICAL.sub("", str(frame).lstrip("/")) if frame else None)
    return str(name or path.stem)


def _transforms(path: Path, part: Mapping[str, object]) -> Iterator[tuple[str, Transform]]:
    several = part.get("transforms", [part])
    for n, one in enumerate(several if isinstance(several, list) else [], start=1):
        where = f"{path}: transform {n}"
        header = one.get("header", {}) if isinstance(one, dict) else {}
        child = one.get("child_frame_id") if isinstance(one, dict) else None
        parent = one.get("frame_id") or (header.get("frame_id") if isinstance(header, dict) else None)
        values = one.get("transform", one) if isinstance(one, dict) else {}
        if not child or not parent or not isinstance(values, dict):
            raise InputError(
                f"{where}: expected frame_id, child_frame_id, translation and rotation", id="missing-value"
            )
        t = _parts(values.get("translation"), "xyz", f"{where}: translation")
        q = _parts(values.get("rotation"), "xyzw", f"{where}: rotation")
        if abs(float(np.linalg.norm(q)) - 1) > 1e-3:
            raise InputError(
                f"{where}: the rotation {q.tolist()} is no unit quaternion (length {np.linalg.norm(q):.4g})",
                id="invalid-calibration",
            )
        yield str(child).lstrip("/"), Transform(str(parent).lstrip("/"), quaternion_rotation(q[3], *q[:3]), t)


def _parts(value: object, names: str, where: str) -> Floats:
    if isinstance(value, dict):
        value = [value.get(name) for name in names]
    found = numbers(value, where).reshape(-1)
    if found.shape != (len(names),):
        raise InputError(f"{where}: expected {len(names)} numbers: {', '.join(names)}", id="invalid-calibration")
    return found


def quaternion_rotation(w: float, x: float, y: float, z: float) -> Floats:
    """(3, 3) rotation of the quaternion w + x i + y j + z k, which is normalised first."""
    w, x, y, z = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


STILL_M, STILL_RAD = 0.02, math.radians(0.5)
"""Up to this, changes of a pose are taken for noise of the localisation; what moves more is no fixed camera."""


def apart(a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses: rotation (3, 3) and translation (3,) [m] each."""
    cosine = (float(np.trace(a[0].T @ b[0])) - 1) / 2
    return float(np.linalg.norm(a[1] - b[1])), math.acos(min(max(cosine, -1.0), 1.0))


def two_poses(frame: str, parent: str, a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> str:
    """Text on two static poses (`apart`) of a frame in its parent."""
    distance, angle = apart(a, b)
    places = " and ".join("({})".format(", ".join(f"{x:.4g}" for x in place)) for _, place in (a, b))
    return (
        f"frame {frame!r} has different static transforms in {parent!r}: at {places}, {distance:.3g} m and "
        f"{math.degrees(angle):.3g} degrees apart"
    )


def _root(frame: str, tree: Mapping[str, Transform], path: Path) -> str:
    for _ in range(len(tree) + 1):
        if frame not in tree:
            return frame
        frame = tree[frame].parent
    raise InputError(f"{path}: the transforms of {frame} form a cycle; correct them", id="invalid-calibration")


def _is_optical(frame: str, camera: str) -> bool:
    """Whether a frame is by its name the optical frame of a camera."""
    return frame != camera and _OPTICAL.sub("", frame) == camera


def _camera(name: str, path: Path, part: Mapping[str, object], tree: _Tree, options: CalibrationOptions) -> Camera:
    where = f"{path}: camera {name}"
    options.check_keys(name, part, KEYS)
    header = part.get("header")
    stated = str(header.get("frame_id", "")).lstrip("/") if isinstance(header, dict) else ""
    names = [stated] if stated in tree else [f for f in tree if _is_optical(f, name)]
    exchanged = next((f for f in tree.parents if f == stated or _is_optical(f, name)), None)
    if not names and exchanged is not None:
        children = abridged(dict.fromkeys(child for child, each in tree.given if each.parent == exchanged))
        raise InputError(
            f"{where}: frame {exchanged} is only a parent in the transforms (of {children}); if parent and child are "
            "exchanged, invert each of them: R' = R transposed, t' = -R' t",
            id="missing-pose",
        )
    if len(names) != 1:
        raise InputError(
            f"{where}: exactly one frame {name}_optical_frame (x right, y down, z forward) is needed, but the "
            f"transforms are of {abridged(tree)}; add or rename it",
            id="missing-pose",
        )
    rotation, position = np.eye(3), np.zeros(3)
    frame = names[0]
    while frame in tree:
        tree.check(frame, where)
        step = tree[frame]
        rotation, position = step.rotation @ rotation, step.rotation @ position + step.translation
        frame = step.parent
    matrix = _matrix(part, ("camera_matrix", "k", "K"), f"{where}: camera matrix")
    if matrix.size != 9:
        raise InputError(f"{where}: the camera matrix has {matrix.size} numbers, not 9", id="invalid-calibration")
    given = _matrix(part, ("distortion_coefficients", "d", "D"), f"{where}: distortion").reshape(-1)
    lens = lens_of(str(part.get("distortion_model", "")), given, where)
    keys = ("image_width", "image_height") if "image_width" in part else ("width", "height")
    size = [part.get(key) for key in keys]
    if not all(isinstance(n, int) for n in size):
        raise InputError(f"{where}: does not state the size of the images ({', '.join(keys)})", id="missing-image-size")
    matrix = matrix.reshape(3, 3)
    whole = (int(str(size[0])), int(str(size[1])))
    check_camera_matrix(matrix, whole[1], where)
    region = region_of(whole, _binning(part, where), _roi(part, name, options, where), where)
    if region.size != whole:
        options.notes.append(region_text(name, region, whole))
    focal, principal = region.intrinsics(np.array([matrix[0, 0], matrix[1, 1]]), matrix[:2, 2])
    pose = CameraParameters(
        name=name,
        focal_px=focal,
        principal_px=principal,
        rotation=rotation.T,
        centre=position * scale_of(options, "m"),
        image_size=region.size,
        lens=lens,
        binned_aspect=float(region.scale[1] / region.scale[0]),
    )
    return build_camera(pose, where, options)


def lens_of(model: str, given: Floats, where: str) -> Lens:
    """Lens of a `camera_info`.

    Args:
        model: its `distortion_model`.
        given: its coefficients, in OpenCV's order.
        where: file and camera, for messages.

    Raises:
        InputError: the model is unknown, or has another number of coefficients.
    """
    kind = model.lower()
    if kind not in LENSES:
        raise InputError(
            f"{where}: distortion model {model}; only {', '.join(m for m in LENSES if m)} can be used",
            id="unsupported-format",
        )
    count = 4 if LENSES[kind] == "equidistant" else 5 if kind in PLUMB_BOB else 14
    if given[count:].any() or (count == 4 and len(given) not in (0, 4)):
        raise InputError(
            f"{where}: {len(given)} distortion coefficients; {model} has {count}", id="invalid-calibration"
        )
    return Lens(LENSES[kind], given)


def region_of(
    whole: tuple[int, int], binning: tuple[int, int], roi: tuple[int, int, int, int], where: str
) -> ImageRegion:
    """Part of the sensor that the images of a `camera_info` show, by binning and region of interest (REP 104).

    Args:
        whole: width and height [px] of the sensor at full resolution.
        binning: pixels of the sensor in one of the image, in x and y; 0 means 1.
        roi: x, y, width and height [px] at full resolution; width or height 0: up to the end of the sensor.
        where: file and camera, for messages.

    Raises:
        InputError: the region is not inside the sensor.
    """
    x, y, width, height = roi
    bins = [max(n, 1) for n in binning]
    wide, high = width or whole[0] - x, height or whole[1] - y
    if min(*roi, *binning) < 0 or x + wide > whole[0] or y + high > whole[1] or wide < bins[0] or high < bins[1]:
        raise InputError(
            f"{where}: binning {binning} and roi {roi} do not fit a sensor of {whole[0]} x {whole[1]} px; correct them",
            id="invalid-calibration",
        )
    return ImageRegion((wide // bins[0], high // bins[1]), np.array([x, y], dtype=np.float64), 1.0 / np.array(bins))


def region_text(name: str, region: ImageRegion, whole: tuple[int, int]) -> str:
    """Note on the image region of a camera: image size, sensor size, binning and offset.

    Args:
        name: of the camera.
        region: part of the sensor.
        whole: width and height of the sensor [px].
    """
    bins = np.round(1.0 / region.scale).astype(int).tolist()
    x, y = region.offset.astype(int).tolist()
    return (
        f"camera {name}: images of {region.size[0]} x {region.size[1]} px of a sensor of {whole[0]} x {whole[1]} "
        f"(binning {bins[0]} x {bins[1]}, region from {x}, {y})"
    )


def _binning(part: Mapping[str, object], where: str) -> tuple[int, int]:
    return _whole(part.get("binning_x"), f"{where}: binning_x"), _whole(part.get("binning_y"), f"{where}: binning_y")


def _roi(part: Mapping[str, object], name: str, options: CalibrationOptions, where: str) -> tuple[int, int, int, int]:
    """Offsets x and y, width and height of the region of interest [px]; each 0 if not stated.

    Args:
        part: the `camera_info`.
        name: of the camera, for the note on unused keys.
        options: unused keys are added to it.
        where: file and camera, for messages.
    """
    roi = part.get("roi") or {}
    if not isinstance(roi, dict):
        raise InputError(
            f"{where}: roi {str(roi)[:40]!r}; x_offset, y_offset, width and height were expected",
            id="invalid-calibration",
        )
    options.check_keys(name, (f"roi.{key}" for key in roi if key not in ROI_KEYS), ())
    x, y, width, height = (_whole(roi.get(k), f"{where}: roi.{k}") for k in ("x_offset", "y_offset", "width", "height"))
    return x, y, width, height


def _whole(value: object, where: str) -> int:
    """Return `value` if it is a whole number, 0 if it is None (not stated); InputError for anything else.

    `where` is the file and key, for messages.
    """
    if value is None:
        return 0
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(f"{where} {str(value)[:40]!r}; a whole number was expected", id="invalid-calibration")
    return value


def _matrix(part: Mapping[str, object], names: tuple[str, ...], where: str) -> Floats:
    value = next((part[name] for name in names if name in part), [])
    return numbers(value.get("data") if isinstance(value, dict) else value, where)


def texts(cameras: Sequence[Camera], late_s: Mapping[str, float]) -> dict[str, str]:  # noqa: ARG001
    """Texts of a `camera_info` per camera and of the transforms from the frame `world`, by file name.

    Args:
        cameras: with positions in metres; those without a pose have no transform.
        late_s: clock offsets by camera [s], which the format cannot hold; ignored.
    """
    out, transforms = {}, []
    for camera in cameras:
        lens = stated_coefficients(
            camera.distortion_model, camera.distortion, tuple(WRITTEN), f"ros: camera {camera.name}"
        )
        fisheye = camera.distortion_model == "equidistant"
        width, height = camera.image_size or (0, 0)
        intrinsics = camera.intrinsic_matrix
        info = {
            "image_width": width,
            "image_height": height,
            "camera_name": camera.name,
            "camera_matrix": {"rows": 3, "cols": 3, "data": intrinsics.ravel().tolist()},
            "distortion_model": "equidistant" if fisheye else WRITTEN[len(lens)],
            "distortion_coefficients": {"rows": 1, "cols": len(lens), "data": lens.tolist()},
            "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
            "projection_matrix": {
                "rows": 3, "cols": 4, "data": np.column_stack([intrinsics, np.zeros(3)]).ravel().tolist(),
            },
        }  # fmt: skip
        out[f"{camera.name}.yaml"] = yaml_text(info)
        if camera.placed:
            values = {
                "translation": camera.position.tolist(),
                "rotation": rotation_quaternion(camera.rotation).tolist(),
            }
            transform = {part: dict(zip("xyzw", each, strict=False)) for part, each in values.items()}
            transforms.append(
                {
                    "header": {"frame_id": "world"},
                    "child_frame_id": f"{camera.name}_optical_frame",
                    "transform": transform,
                }
            )
    return out | ({"tf_static.yaml": yaml_text({"transforms": transforms})} if transforms else {})


def rotation_quaternion(rotation: Floats) -> Floats:
    """(4,) x, y, z, w >= 0 of a rotation (3, 3): the eigenvector of Bar-Itzhack's matrix, stable for all angles."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    q = np.asarray(np.linalg.eigh(k)[1][:, -1])
    return q if q[3] >= 0 or math.isclose(q[3], 0.0) else -q
