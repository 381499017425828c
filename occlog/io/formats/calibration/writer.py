"""Cameras of a scene to calibration files of other programs, which `occlog.io.formats.calibration.reader` reads.

The name of an output states the format (`occlog.io.formats.calibration.outputs`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from occlog.array_types import NS
from occlog.errors import InputError, OutputError, OutputExistsError
from occlog.io.files.atomic import OutputGroup, check_writable, open_output, translate_write_errors
from occlog.records.scene import Camera, Scene, camera_fov
from occlog.settings import METRES

from .outputs import is_folder
from .readers import colmap, kalibr, opencv_storage, ros

TEXTS: dict[str, Callable[[Sequence[Camera], Mapping[str, float]], dict[str, str]]] = {
    "opencv-storage": opencv_storage.texts,
    "kalibr": kalibr.texts,
    "colmap": colmap.texts,
    "ros": ros.texts,
}
"""Files by name, of cameras in metres and offsets of their clocks [s], for each format of `OUTPUTS`."""
WITHOUT_POSE = ("opencv-storage", "ros")
"""Formats that can state a camera without a pose."""
WITH_CLOCKS = ("kalibr",)
"""Formats that state offsets of clocks."""


def check_calibration(path: Path, format: str, overwrite: bool) -> None:
    """Check that a calibration can be written to `path`; called before any work is done.

    Args:
        path: file or folder, as the format has it.
        format: a key of `OUTPUTS`.
        overwrite: an existing file, or folder with files, may be replaced.

    Raises:
        OutputExistsError: it exists, and may not be replaced.
        OutputError: it cannot be written.
    """
    if not is_folder(path, format):
        check_writable(path, overwrite)
    elif not path.is_dir():
        check_writable(path, False)
    elif not overwrite and any(path.iterdir()):
        raise OutputExistsError(f"{path}: exists")


def write_calibration(path: Path, scene: Scene, format: str, overwrite: bool = False) -> tuple[str, ...]:
    """Write the cameras of a scene as a calibration of another program.

    Args:
        path: file or folder, as the format has it (`is_folder`).
        scene: with at least one camera.
        format: a key of `OUTPUTS`.
        overwrite: files of the same names are replaced.

    Returns:
        What the scene states and the format cannot hold, each in a few words.

    Raises:
        InputError: the format cannot state a lens, or needs something that the scene does not state.
        OutputError: the folder has other files, which would be read as further cameras.
    """
    check_calibration(path, format, overwrite)
    texts = TEXTS[format](_in_metres(scene, format), _late(scene))
    if not is_folder(path, format):
        if len(texts) > 1:
            raise InputError(
                f"{path}: {format} consists of {len(texts)} files; name a folder, such as {path.stem}", id="not-a-file"
            )
        texts = {path.name: next(iter(texts.values()))}
        folder = path.parent
    else:
        folder = path
        others = sorted(each.name for each in path.iterdir() if each.name not in texts) if path.is_dir() else []
        if others:
            raise OutputError(
                f"{path}: has other files ({others[0]}), which would be read too; name a new folder", id="output-exists"
            )
        with translate_write_errors(path):
            path.mkdir(exist_ok=True)
    with OutputGroup() as together:
        for name, text in texts.items():
            with open_output(folder / name, overwrite, together) as file:
                file.write(text.encode())
    return tuple(_not_held(path, scene, format))


def _in_metres(scene: Scene, format: str) -> list[Camera]:
    """Copies of the cameras of a scene with positions in metres.

    InputError if there is none, or the scene lacks a length unit, an image size, or a pose that the format needs.
    """
    if not scene.cameras:
        raise InputError(f"the scene has no camera, but {format} describes cameras; add one", id="too-few-sensors")
    if scene.length_unit not in METRES:
        raise InputError(
            f"lengths are in {scene.length_unit!r}, but {format} requires metres; state length_unit in the scene, one "
            f"of {', '.join(METRES)}",
            id="missing-unit",
        )
    out = []
    for camera in scene.cameras:
        if camera.image_size is None:
            raise InputError(
                f"{format}: camera {camera.name} states no image size; add image_size_px to the scene",
                id="missing-image-size",
            )
        if not (camera.placed or format in WITHOUT_POSE):
            raise InputError(
                f"{format}: camera {camera.name} has no pose; write opencv-storage, ros or a scene (.yaml)",
                id="missing-pose",
            )
        out.append(replace(camera, position=camera.position * METRES[scene.length_unit]))
    return out


def _late(scene: Scene) -> dict[str, float]:
    """Clock offset [s] of each camera that names a clock, by the camera's name; positive if the clock is ahead."""
    clocks = {clock.name: clock.offset_ns / NS for clock in scene.clocks}
    return {camera.name: clocks[camera.clock] for camera in scene.cameras if camera.clock is not None}


def _not_held(path: Path, scene: Scene, format: str) -> Iterator[str]:
    """Yield a few words on each thing in a scene that the calibration format cannot hold, as `ranges`."""
    cameras = scene.cameras
    named = {path.stem if format == "opencv-storage" and not is_folder(path, format) else c.name for c in cameras}
    if format == "kalibr":
        named = {f"cam{n}" for n in range(len(cameras))}
    if named != {c.name for c in cameras}:
        yield "names of cameras"
    if scene.common_noise is not None or any(c.sigma_position or c.sigma_yaw for c in cameras):
        yield "standard deviations of poses"
    if any(np.isfinite(c.range) for c in cameras):
        yield "ranges"
    if any(abs(c.fov - _own_fov(c)) > 1e-6 for c in cameras):
        yield "fields of view"
    late = any(_late(scene).values()) and format not in WITH_CLOCKS
    if late or any(clock.drift_ppm for clock in scene.clocks):
        yield "clocks" if late else "drifts of clocks"
    others = {"room": scene.room is not None, "occluders": scene.occluders, "arrays": scene.arrays}
    yield from (name for name, there in (others | {"readers": scene.readers}).items() if there)


def _own_fov(c: Camera) -> float:
    size = c.image_size or (0, 0)
    return float(camera_fov(size, c.focal_px, c.principal_px, c.distortion, c.distortion_model, c.rotation))
