"""Run of `occlog calibrate`: read boxes, calibrate, write the scene, and report how sure each parameter is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, replace

import numpy as np

from occlog import console
from occlog.array_types import NS
from occlog.core.geometry.camera import angles_from_rotation
from occlog.errors import InputError
from occlog.io.files.atomic import write_bytes
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Clock, Scene
from occlog.records.verdicts import Check, finding, outcome, summary_of, texts_of
from occlog.runner import Job
from occlog.settings import METRES, configure
from occlog.track.people.frame_detections import FrameDetectionsWithIds
from occlog.track.people.inputs import ImageInput
from occlog.track.request import TrackInImagesRequest

from .adjustment import DRIFT, LATE
from .config import CalibrateConfig
from .request import CalibrateRequest
from .stage import Calibrated, CameraResult, calibrate

CAMERAS, PARAMETERS, SEARCH = "cameras calibrated", "parameters determined", "convergence"
STATED, CLOCKS = "stated poses", "clocks of cameras"
"""Names of checks."""
MAX_MOVED = 4.0
"""Largest correction of a stated position or yaw, in stated standard deviations."""
CLOCK = "{}-clock"
"""Name of the clock of a camera that is late."""
MAX_BOXES = 60_000
"""Boxes that are used, from the beginning of a recording; more take longer and change little."""


def run_calibrate(request: CalibrateRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Calibrate and write; return the summary, and previous losses."""
    config = configure(CalibrateConfig(), request.settings)
    inputs = ImageInput(
        TrackInImagesRequest(
            bearings=request.recording, output=request.output, method="sort", scene=request.scene,
            cameras=request.cameras, without=request.without,
        )
    )  # fmt: skip
    unknown = [c.name for c in inputs.cameras if float(c.focal_px[0]) <= 1.0]
    if unknown:
        raise InputError(
            f"{request.recording}: no focal length of camera {', '.join(unknown)}; give a scene with focal_px and "
            "image_size_px of each camera"
        )
    if len(inputs.cameras) < 2:
        raise InputError(f"{request.recording}: boxes of one camera; cameras are calibrated against each other")
    cameras = [replace(c, placed=False) if request.ignore_poses else c for c in inputs.cameras]
    frames = _first_frames(inputs.frames, job)
    metre = 1.0 / METRES[inputs.scene.length_unit] if inputs.scene.length_unit in METRES else 1.0
    estimate = [name for name in ("focal", "radial") if getattr(request, name)]
    try:
        found = calibrate(
            frames, inputs.scene, cameras, config, metre, estimate, request.seed,
            step=lambda name: console.note(f"calibrate: {name}", job.quiet),
        )  # fmt: skip
    except InputError as error:
        raise InputError(f"{request.recording}: {error}") from error
    stated = any(c.has_height for c in cameras)
    made = job.provenance({**asdict(config), "ignore_poses": request.ignore_poses, "estimate": estimate}, inputs.losses)
    made = made.with_checks(_checks(found, cameras, config, metre))
    scene = _scene(inputs.scene, found, placed=stated)
    write_bytes(
        request.output, (_comment(found, inputs.scene.length_unit) + scene_to_yaml(scene)).encode(), job.overwrite
    )
    console.note_findings(texts_of(made.judged, "calibrate"), job.quiet)
    summary = {
        "scene": str(request.output),
        "people": found.people,
        "mean_height": round(found.mean_height, 3),
        "cameras": {each.camera.name: _figures(each) for each in found.cameras},
        "sigma_all_cameras": _frame(found),
        "error_correlation": round(found.correlation, 2),
    }
    return {**summary, **summary_of(made.judged)}, inputs.losses


def _first_frames(frames: Iterable[FrameDetectionsWithIds], job: Job) -> list[FrameDetectionsWithIds]:
    """Frames from the beginning with at most about `MAX_BOXES` boxes; a note where there are more."""
    out: list[FrameDetectionsWithIds] = []
    boxes = 0
    for each in job.progress(frames, "read"):
        if boxes >= MAX_BOXES:
            used_s = (out[-1].detections.t_ns - out[0].detections.t_ns) / NS
            job.note(f"note: the first {boxes} boxes are used, of {used_s:.1f} s")
            break
        out.append(each)
        boxes += len(each.detections.boxes)
    return out


def _scene(scene: Scene, found: Calibrated, *, placed: bool) -> Scene:
    """The scene with the calibrated cameras, their uncertainty as noise, and clocks that are late."""
    own = {each.camera.name: each for each in found.cameras if each.estimated}
    clocks = {clock.name: clock for clock in scene.clocks}
    cameras: list[Camera] = []
    for camera in scene.cameras:
        each = own.get(camera.name)
        if each is None:
            cameras.append(camera)
            continue
        clock, late_ns = camera.clock, round(each.late_s * NS)
        if each.is_late:
            clock = CLOCK.format(camera.name)
            before = clocks[camera.clock] if camera.clock is not None else Clock(clock)
            clocks[clock] = Clock(clock, before.offset_ns + late_ns, before.drift_ppm + each.drift_ppm)
        sigma = float(np.sqrt(np.mean(each.sigma[3:5] ** 2)))
        cameras.append(replace(each.camera, clock=clock, sigma_position=sigma, sigma_yaw=_sigma_yaw(each)))
    changed = replace(scene, cameras=tuple(cameras), clocks=tuple(clocks.values()))
    # Where the room and other sensors stand in a frame of the cameras' own is not known
    return changed if placed else replace(changed, room=None, occluders=(), arrays=(), readers=())


def _sigma_yaw(each: CameraResult) -> float:
    """Standard deviation of the angle about the vertical [rad], of turns about the axes of the camera."""
    up = each.camera.rotation[2]
    return float(np.sqrt(np.sum((up * each.sigma[:3]) ** 2)))


def _figures(each: CameraResult) -> dict[str, object]:
    """Figures of one camera: what was found, and standard deviations."""
    if not each.estimated:
        return {"estimated": False}
    yaw, pitch, roll = np.degrees(angles_from_rotation(each.camera.rotation)).tolist()
    return {
        "position": [round(float(v), 4) for v in each.camera.position],
        "sigma_position": [round(float(v), 4) for v in each.sigma[3:6]],
        "yaw_pitch_roll_deg": [round(v, 3) for v in (yaw, pitch, roll)],
        "sigma_yaw_deg": round(float(np.degrees(_sigma_yaw(each))), 3),
        "sigma_turn_deg": [round(float(v), 3) for v in np.degrees(each.sigma[:3])],
        "focal_px": [round(float(v), 2) for v in each.camera.focal_px],
        "clock_offset_s": round(each.late_s, 4),
        "sigma_clock_s": round(float(each.sigma[LATE]), 4),
        "clock_drift_ppm": round(each.drift_ppm, 2),
        "sigma_drift_ppm": round(float(each.sigma[DRIFT]) * 1e6, 2),
        "boxes": each.boxes,
        "residual_px": round(each.rms_px, 2),
    }


def _frame(found: Calibrated) -> dict[str, float]:
    """Standard deviations of position, yaw and scale of all cameras together, of those that anything determines."""
    x, y, yaw, scale = found.sigma_frame.tolist()
    values = {"x": x, "y": y, "yaw_deg": float(np.degrees(yaw)), "scale": scale}
    return {name: round(value, 4) for name, value in values.items() if np.isfinite(value)}


def _checks(found: Calibrated, stated: Sequence[Camera], config: CalibrateConfig, metre: float) -> tuple[Check, ...]:
    """Checks of the calibration with their findings."""
    known = any(c.has_height for c in stated)
    return (
        *outcome(CAMERAS, _missing(found), cameras=sum(each.estimated for each in found.cameras)),
        *outcome(PARAMETERS, _loose(found)),
        *outcome(SEARCH, () if found.converged else (finding(SEARCH, "adjustment-not-converged"),)),
        *outcome(STATED, _moved(found, stated, config, metre), unless="" if known else "no poses are stated"),
        *_clocks(found),
    )


def _missing(found: Calibrated) -> Iterator[Check]:
    for each in found.cameras:
        if not each.estimated:
            yield finding(CAMERAS, "camera-not-calibrated", sensors=[each.camera.name])


def _loose(found: Calibrated) -> Iterator[Check]:
    for each in found.cameras:
        for name in each.undetermined:
            yield finding(PARAMETERS, "parameter-undetermined", sensors=[each.camera.name], parameter=name)


def _moved(found: Calibrated, stated: Sequence[Camera], config: CalibrateConfig, metre: float) -> Iterator[Check]:
    """Cameras with a pose that is farther from the stated one than that allows."""
    for each, camera in zip(found.cameras, stated, strict=True):
        if not (each.estimated and camera.has_height):
            continue
        away = float(np.linalg.norm(each.camera.position - camera.position))
        yaw = angles_from_rotation(each.camera.rotation)[0] - angles_from_rotation(camera.rotation)[0]
        yaw_deg = abs(float(np.degrees(np.angle(np.exp(1j * yaw)))))
        if away > MAX_MOVED * config.sigma_position * metre or yaw_deg > MAX_MOVED * config.sigma_yaw:
            yield finding(STATED, "camera-moved-far", sensors=[camera.name], distance=away, yaw_deg=yaw_deg)


def _clocks(found: Calibrated) -> tuple[Check, ...]:
    return outcome(CLOCKS, _clock_findings(found))


def _clock_findings(found: Calibrated) -> Iterator[Check]:
    for each in found.cameras:
        name, sigma = [each.camera.name], each.sigma
        if each.is_late:
            yield finding(CLOCKS, "clock-offset-found", sensors=name, late_s=each.late_s, sigma_s=float(sigma[LATE]))
        if each.is_drifting:
            yield finding(
                CLOCKS, "clock-drift-found", sensors=name, ppm=each.drift_ppm, sigma_ppm=1e6 * float(sigma[DRIFT])
            )
    # The clock that the others are compared with has no standard deviation
    loose = [e.camera.name for e in found.cameras if e.estimated and e.sigma[LATE] > 0.0 and not e.sigma[DRIFT] > 0.0]
    if loose:
        yield finding(CLOCKS, "clock-drift-undetermined", sensors=loose)


def _comment(found: Calibrated, unit: str) -> str:
    """Comments with the standard deviations."""
    lines = [f"Calibrated from {found.people} people by occlog calibrate; standard deviations relative to all cameras:"]
    for each in found.cameras:
        if each.estimated:
            position = ", ".join(f"{v:.3f}" for v in each.sigma[3:6])
            lines.append(
                f"{each.camera.name}: position {position} {unit}, yaw {np.degrees(_sigma_yaw(each)):.3f} deg, clock "
                f"{each.sigma[LATE]:.4f} s"
            )
        else:
            lines.append(f"{each.camera.name}: not calibrated, as it was stated")
    return "".join(f"# {line}\n" for line in lines)
