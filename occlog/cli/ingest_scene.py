"""The scene of an ingested recording: calibrated cameras, arrays, and what a scene file adds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import InputError, UsageError
from ..io.calibration import CalibrationOptions, describe, read_calibration
from ..io.doa_logs import read_arrays
from ..io.sensor_names import match_sensor, safe_name
from ..scene import Camera, MicrophoneArray, Scene, camera_rotation
from .ingest_plan import IngestPlan
from .options import load_scene

Note = Callable[[str], None]


def base_scene(plan: IngestPlan, note: Note) -> Scene:
    """Scene of the scene file, the calibration and the tables of arrays, before cameras are matched."""
    scene = load_scene(plan.scene, None, plan.output) if plan.scene is not None else Scene()
    cameras = list(scene.cameras)
    if plan.calibration:
        options = CalibrationOptions(plan.calibration_unit, plan.image_size)
        calibration = read_calibration(plan.calibration, plan.calibration_format, options)
        note(describe(calibration))
        if scene.length_unit != "m":
            raise InputError(f"{plan.scene}: lengths are in {scene.length_unit}, but those of the calibration in m")
        double = next((c.name for c in calibration.cameras if c.name in {k.name for k in cameras}), None)
        if double is not None:
            raise UsageError(f"camera {double}: is both in {plan.scene} and in the calibration; keep one")
        cameras += calibration.cameras
    arrays = [*scene.arrays, *(a for name, path in plan.arrays for a in _arrays(path, name, note))]
    return replace(scene, cameras=tuple(cameras), arrays=tuple(arrays))


def _arrays(path: Path, name: str | None, note: Note) -> tuple[MicrophoneArray, ...]:
    arrays = read_arrays(path, name)
    first = arrays[0]
    what = f"{len(first.microphones)} microphones" if len(first.microphones) else "no microphones"
    place = ", ".join(f"{v:.2f}" for v in first.position)
    note(f"arrays: {len(arrays)} from {path.name}, m; first: {first.name} at ({place}), {what}")
    return arrays


def match_cameras(scene: Scene, wanted: Sequence[str], plan: IngestPlan) -> Scene:
    """The scene with the cameras that have data, under the names that the user gives them.

    Cameras of a calibration without data are left out, those of a scene file are kept.
    """
    kept = {c.name: c for c in scene.cameras}
    out: list[Camera] = []
    for name in wanted:
        found = _find(name, list(kept))
        if found is None and not plan.allow_uncalibrated:
            known = ", ".join(kept) or "none"
            raise InputError(
                f"camera {name}: has no calibration (calibrated: {known}); add it to --calibration or --scene, "
                "or give --allow-uncalibrated (it then gives no bearings)"
            )
        out.append(replace(kept.pop(found), name=name) if found is not None else _unplaced(name, plan))
    if plan.scene is not None:
        named = {c.name for c in load_scene(plan.scene, None, plan.output).cameras}
        out += [c for c in kept.values() if c.name in named]
    return replace(scene, cameras=tuple(out))


def _find(name: str, names: Sequence[str]) -> str | None:
    try:
        return match_sensor(name, names, "calibration")
    except InputError:
        return None


def _unplaced(name: str, plan: IngestPlan) -> Camera:
    """A camera of which nothing is known: the focal length is only a place holder."""
    width = float(plan.image_size[0]) if plan.image_size else 1000.0
    return Camera(
        name=safe_name(name), position=np.zeros(3), rotation=camera_rotation(0.0, 0.0, 0.0),
        focal_px=np.array([width, width]), principal_px=np.zeros(2), image_size=plan.image_size, placed=False,
    )  # fmt: skip
