"""Camera calibrations of other programs to cameras of a scene.

One module a format; `IMPORTERS` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, UsageError, option
from occlog.io.files.limits import guarded
from occlog.io.files.texts.formats import FileFormat, Probe, by_text, recognise
from occlog.records.messages import listed
from occlog.records.names import first_double
from occlog.records.scene import Camera
from occlog.records.verdicts import Check, finding, outcome

from .common import CALIBRATION, WHAT, CalibrationOptions, keys_of
from .readers import (
    arrays,
    colmap,
    homography,
    kalibr,
    opencv_storage,
    opencv_toml,
    pairs,
    projection,
    qualisys,
    ros,
    tsai,
)

Importer = FileFormat[Callable[[list[Path], CalibrationOptions], tuple[Camera, ...]]]
IMPORTERS: dict[str, Importer] = {
    "arrays": Importer(arrays.read, "arrays P or K, R, t (.npz, .mat up to version 7)", arrays.is_arrays, "m"),
    "qualisys": Importer(qualisys.read, "Qualisys Track Manager (.qca.txt)", by_text(qualisys.detect), "mm"),
    "tsai": Importer(tsai.read, "Tsai, as in the PETS data sets (XML, one file a camera)", by_text(tsai.detect), "mm"),
    "opencv-toml": Importer(opencv_toml.read, "TOML of caliscope, anipose, Pose2Sim", by_text(opencv_toml.detect), "m"),
    "kalibr": Importer(kalibr.read, "Kalibr (camchain.yaml)", by_text(kalibr.detect), "m"),
    "opencv-pairs": Importer(
        pairs.read,
        "OpenCV in two files a camera, as in WILDTRACK (intr_NAME.xml, extr_NAME.xml)",
        by_text(pairs.detect),
        "m",
    ),
    "opencv-storage": Importer(
        opencv_storage.read,
        "OpenCV FileStorage (YAML, XML or JSON, one file a camera)",
        by_text(opencv_storage.detect),
        "m",
    ),
    "ros": Importer(ros.read, "ROS camera_info with static transforms (YAML)", by_text(ros.detect), "m"),
    "colmap": Importer(colmap.read, "COLMAP's text model (cameras.txt, images.txt)", by_text(colmap.detect), "m"),
    "homography": Importer(
        homography.read, "homographies of the ground, 3 x 3 (text, one file a camera)", by_text(homography.detect), "m"
    ),
    "projection": Importer(
        projection.read, "3 x 4 projection matrices (text, one file a camera)", by_text(projection.detect), "m"
    ),
}
"""Every format that can be read, with its unit of lengths."""
FAR_M, NEAR_M = 500.0, 0.05
"""Cameras that are farther apart than that, or all nearer to each other, are a sign of another unit."""
SAME_FOCAL, MIN_LENS_SHARE = 0.1, 0.005
"""Greatest relative difference of the focal lengths of cameras of one type, and the least offset by a distortion at the
left and right borders that matters, by the width of the images."""

OF_CAMERAS = keys_of(
    "dist coef tang radial skew lens fish model xi alpha focal intr matrix cx cy fx fy center centre princ proj rot",
    "trans tvec rvec pose extr quat position width height size resol scale unit roi bin crop offset shift mirror flip",
    "order convention axis axes hand",
)
"""Parts of the names of keys that may change a camera."""


class CalibrationFile(NamedTuple):
    """Cameras of calibration files, with format, unit, notes and checks.

    Attributes:
        cameras: in the order of the files.
        format: a key of `IMPORTERS`, or words for another source.
        unit: length unit of the files; cameras are in metres.
        notes: assumptions, in words.
        mirror: axis of the left-handed world that is yet to be negated; None: the world is right-handed.
        checks: findings on unused keys, distances between cameras, and lenses.
    """

    cameras: tuple[Camera, ...]
    format: str
    unit: str
    notes: tuple[str, ...] = ()
    mirror: str | None = None
    checks: tuple[Check, ...] = ()


def read_calibration(
    paths: Sequence[Path], format: str = "auto", options: CalibrationOptions | None = None
) -> CalibrationFile:
    """Read the cameras of one or more calibration files of one format; lengths are converted to metres.

    Args:
        paths: files; a folder stands for all files in it, by name.
        format: a key of `IMPORTERS`, or `auto`: recognised by the content of the first file.
        options: what the format does not state itself; None: nothing is stated.

    Raises:
        InputError: the files are not of a known format, or do not describe cameras.
        UsageError: a folder has no file, or the named format does not exist.
    """
    files = [file for path in paths for file in _files(path)]
    if not files:
        where = ", ".join(str(path) for path in paths)
        raise UsageError(
            f"{where}: a folder without a calibration file; name the file (boxes are a separate input)", id="not-a-file"
        )
    name = recognise(IMPORTERS, Probe(files[0], WHAT), format, "calibration")
    if name is None:
        remedy = f"state it by {option('calibration_format')}, if it is one of {', '.join(IMPORTERS)}"
        raise InputError(f"{files[0]}: not a calibration of a known format; {remedy}", id="unknown-format")
    options = options or CalibrationOptions()
    # Numbers beyond all range become infinite, and no camera has such
    with guarded(files[0], WHAT), np.errstate(all="ignore"):
        cameras = IMPORTERS[name].read(files, options)
    if not cameras:
        raise InputError(f"{files[0]}: describes no camera ({IMPORTERS[name].doc})", id="empty-input")
    if (double := first_double([c.name for c in cameras])) is not None:
        raise InputError(f"{files[0]}: two cameras are named {double!r}; their names must differ", id="duplicate-name")
    unit = options.unit or (pairs.unit_of(files) if name == "opencv-pairs" else IMPORTERS[name].assumed)
    checks = outcome(CALIBRATION, [*options.findings, *_unused(options), *_distances(cameras), *_lenses(cameras)])
    return CalibrationFile(cameras, name, unit, tuple(options.notes), options.mirror, checks)


def _unused(options: CalibrationOptions) -> Iterator[Check]:
    """Yield findings on unused keys of calibration files.

    One is on keys that by their names (`OF_CAMERAS`) may change a camera, one on all others.
    """
    for kind, suspect in (("calibration-keys-unused", True), ("calibration-keys-other", False)):
        every = [
            f"{key} ({listed(tuple(dict.fromkeys(names)))})"
            for key, names in options.unused.items()
            if any(part in key.lower() for part in OF_CAMERAS) == suspect
        ]
        if every:
            yield finding(CALIBRATION, kind, keys=listed(every))


def _distances(cameras: Sequence[Camera]) -> Iterator[Check]:
    """Yield a finding if the extent of the cameras' positions is above `FAR_M` or below `NEAR_M`: a wrong unit."""
    centres = np.array([c.position for c in cameras])
    with np.errstate(over="ignore"):  # cameras that are too far apart for a number are infinitely so
        span = float(np.linalg.norm(centres.max(axis=0) - centres.min(axis=0)))
        single = _in_another_unit(centres) if span > FAR_M and len(cameras) > 2 else None
    if single is not None:
        camera, away, others = single
        yield finding(CALIBRATION, "camera-unit-differs", sensors=[cameras[camera].name], span=others, away=away)
    elif len(cameras) > 1 and (span > FAR_M or span < NEAR_M):
        yield finding(CALIBRATION, "camera-distances-implausible", span=span, least=NEAR_M, most=FAR_M)


def _in_another_unit(centres: Floats) -> tuple[int, float, float] | None:
    """Camera that is implausibly far from all others, which are not far from each other.

    Args:
        centres: (C, 3) positions of cameras [m], C >= 3.

    Returns:
        Its index, its distance from the mean of the others and their extent [m]; None: there is no such camera.
    """
    camera = int(np.argmax(np.linalg.norm(centres - np.median(centres, axis=0), axis=1)))
    others = np.delete(centres, camera, axis=0)
    span = float(np.linalg.norm(np.ptp(others, axis=0)))
    away = float(np.linalg.norm(centres[camera] - others.mean(axis=0)))
    return (camera, away, span) if NEAR_M < span <= FAR_M else None


def _lenses(cameras: Sequence[Camera]) -> Iterator[Check]:
    """Yield a finding for each camera without distortion that is of the same type as one with distortion.

    The same type: equal image size, and focal lengths that differ by less than 10 %.
    """
    straight = [camera for camera in cameras if camera.straight]
    offsets = {c.name: _offset_at_border(c) for c in cameras if straight and not c.straight}
    for camera in straight:
        same = [
            (offsets[other.name], other.name)
            for other in cameras
            if other.image_size == camera.image_size
            and abs(other.focal_px[0] / camera.focal_px[0] - 1.0) < SAME_FOCAL
            and offsets.get(other.name, 0.0) > MIN_LENS_SHARE * _width(other)
        ]
        if same:
            offset, name = max(same)
            yield finding(CALIBRATION, "distortion-missing", sensors=[camera.name], other=name, offset_px=offset)


def _offset_at_border(camera: Camera) -> float:
    """Largest shift of a point by lens distortion at the middle of the left and right image borders [px]."""
    half = 0.5 * _width(camera) / camera.focal_px[0]
    points = camera.position + np.array([[-half, 0.0, 1.0], [half, 0.0, 1.0]]) @ camera.rotation.T
    ideal = camera.principal_px + camera.focal_px * [[-half, 0.0], [half, 0.0]]
    with np.errstate(over="ignore"):
        return float(np.linalg.norm(camera.project(points) - ideal, axis=1).max())


def _width(camera: Camera) -> int:
    return (camera.image_size or (0, 0))[0]


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        for files in (pairs.folder_files(path), colmap.folder_files(path)):
            if files is not None:
                return files
        return sorted(p for p in path.iterdir() if p.is_file() and not p.name.startswith("."))
    return [path]
