"""Cameras and microphone arrays from boxes of people: read them, calibrate, and report how sure each parameter is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from typing import NamedTuple

import numpy as np

from occlog import console
from occlog.array_types import NS, Floats
from occlog.consistency.clock_offsets import offset_words
from occlog.core.geometry.camera import angles_from_rotation
from occlog.errors import InputError, option
from occlog.io.formats.calibration.points import read_marked_points
from occlog.io.open import input_losses
from occlog.records.frames import Image
from occlog.records.scene import Camera, Clock, CommonNoise, Scene
from occlog.records.verdicts import Check, finding, outcome
from occlog.runner import Job
from occlog.settings import METRES, configure
from occlog.track.people.frame_detections import FrameDetectionsWithIds
from occlog.track.people.inputs import ImageInput
from occlog.track.request import TrackInImagesRequest

from .adjustment import DRIFT, FOCAL, LATE, Clocks
from .common_views import detected_by_others
from .config import CalibrateConfig
from .microphones.array_outputs import (
    array_checks,
    array_comment,
    array_figures,
    opened_directions,
    place_arrays,
    with_arrays,
)
from .request import CalibrateRequest
from .results.output import CLOCK, CalibrationResult
from .stage import Calibrated, CameraResult, calibrate, tracks_in_images
from .starts.focal import FocalEstimate, focal_of_people, lens_unknown, with_focal
from .starts.marked import MarkedPose, pose_of_points

CAMERAS, PARAMETERS, SEARCH = "cameras calibrated", "parameters determined", "convergence"
STATED, CLOCKS, LENSES, PASSAGES = "stated poses", "clocks of cameras", "lenses from people", "passages between views"
COMMON_VIEWS = "people in common views"
"""Names of checks."""
MAX_MOVED = 4.0
"""Largest correction of a stated position or yaw, in stated standard deviations."""
MIN_IN_COMMON = 100
"""Number of people in common views below which a camera's pose is not checked by them."""
MIN_CONFIRMED = 0.3
"""Share of the people in common views that must be detected.

With right poses 0.4 (crowds of which half the boxes are missed) to 0.9, with wrong ones mostly below 0.2.
"""
MAX_AMBIGUOUS = 0.2
"""Share of the passages between views that may be ambiguous."""
MAX_BOXES = 60_000
"""Boxes that are used, from the beginning of a recording; more take longer and change little."""


def calibration_of_people(request: CalibrateRequest, job: Job) -> CalibrationResult:
    """Calibrate cameras by people who walk, and microphone arrays by people who speak.

    Returns the scene with the calibrated sensors, checks and figures. InputError for boxes of fewer than two
    cameras, or if these do not determine the poses.
    """
    config = configure(CalibrateConfig(), request.settings)
    inputs = ImageInput(
        TrackInImagesRequest(
            bearings=request.recording, output=request.output, method="sort", scene=request.scene,
            cameras=request.cameras, without=request.without,
        ),
        in_world_time=True,
    )  # fmt: skip
    for line in inputs.notes:
        job.note(line)
    if len(inputs.cameras) < 2:
        raise InputError(
            f"{request.recording}: boxes of one camera, but cameras are calibrated against each "
            "other; give boxes of two or more",
            id="too-few-sensors",
        )
    sound = opened_directions(request, inputs)
    frames = _first_frames(inputs.frames, job)
    metre = 1.0 / METRES[inputs.scene.length_unit] if inputs.scene.length_unit in METRES else 1.0
    estimate = [name for name in ("focal", "radial") if getattr(request, name)]
    try:
        start = _start(request, inputs.cameras, frames, config.person_height * metre)
        cameras = start.cameras
        found = calibrate(
            frames, inputs.scene, cameras, config, metre, estimate, request.seed,
            step=lambda name: console.note(f"calibrate: {name}", job.quiet), sigma_log_focal=start.sigma_log_focal,
        )  # fmt: skip
    except InputError as error:
        raise InputError(f"{request.recording}: {error}") from error
    stated = any(c.has_height for c in cameras)
    arrays = () if sound is None else place_arrays(sound, inputs.scene, found.paths, config, metre)
    scene = with_arrays(_scene(inputs.scene, found, placed=stated), inputs.scene, arrays)
    drawn = None
    if request.picture is not None:
        from .results.picture import picture

        drawn = picture(found, _images(inputs, found), metre)
    summary: dict[str, object] = {
        "people": found.people,
        "mean_height": round(found.mean_height, 3),
        "cameras": {each.camera.name: _figures(each) for each in found.cameras},
        "sigma_all_cameras": _frame(found),
        "error_correlation": round(found.correlation, 2),
    }
    if found.handovers:
        summary["passages"] = {"used": found.handovers, "ambiguous": found.ambiguous}
    if arrays:
        summary["microphone_arrays"] = {each.array.name: array_figures(each) for each in arrays}
    if start.marked:
        summary["marked_points"] = {each.camera.name: _marked_figures(each) for each in start.marked}
    common = _common_views(found, frames, config.person_height * metre)
    checks = *_checks(found, cameras, config, metre), *common, *start.checks(found)
    return CalibrationResult(
        scene, _comment(found, scene.length_unit) + array_comment(arrays, scene.length_unit),
        {**asdict(config), "ignore_poses": request.ignore_poses, "estimate": estimate},
        (*checks, *array_checks(arrays, inputs.scene, placed=stated)), summary,
        input_losses([inputs.opened, sound]), drawn,
    )  # fmt: skip


def _images(inputs: ImageInput, found: Calibrated) -> dict[str, Image]:
    """First image of each camera from the middle of the recording on, by name.

    Args:
        inputs: has the recording; without one, no camera has an image.
        found: has the times of the observations; the middle is their median.

    Returns:
        Images; cameras without an image there, or with a damaged one, are omitted.
    """
    recording, middle_ns = inputs.opened.recording, round(float(np.median(found.seen.time)) * NS)
    out: dict[str, Image] = {}
    for name in () if recording is None else recording.cameras:
        frames = recording.frames([name])  # type: ignore[union-attr]
        frame = next((each for each in frames if each.t_ns >= middle_ns), None)
        if frame is not None:
            try:
                out[name] = frame.decode()
            except InputError as error:
                console.note(f"picture without an image of {name}: {error}")
    return out


class InitialCameras(NamedTuple):
    """Initial cameras of the search.

    Attributes:
        cameras: C cameras, with poses that are stated or follow from marked points.
        sigma_log_focal: (C,) standard deviations of the logarithms of estimated focal lengths; 0: stated.
        marked: results for cameras with marked points.
        guessed: focal lengths by name of cameras of which only the image size is known.
    """

    cameras: list[Camera]
    sigma_log_focal: Floats
    marked: list[MarkedPose]
    guessed: dict[str, FocalEstimate]

    def checks(self, found: Calibrated) -> tuple[Check, ...]:
        """Findings about focal lengths of which only the image size was known before."""
        out = []
        for each in found.cameras:
            if each.estimated and each.camera.name in self.guessed:
                name, focal = each.camera.name, float(each.camera.focal_px[0])
                sigma = focal * float(each.sigma[FOCAL])
                out.append(finding(LENSES, "lens-from-people", sensors=[name], focal=focal, sigma=sigma))
        return outcome(LENSES, out, unless="" if self.guessed else "lenses are stated")


def _start(
    request: CalibrateRequest, cameras: Sequence[Camera], frames: Sequence[FrameDetectionsWithIds], height: float
) -> InitialCameras:
    """Initial poses from marked points, and focal lengths of cameras of which only the image size is known.

    InputError for a camera without a lens and an image size.

    Args:
        request: has the file of marked points, and whether stated poses are ignored.
        cameras: stated cameras.
        frames: boxes of people.
        height: mean height of a person, in scene units.
    """
    out = [replace(c, placed=False) if request.ignore_poses else c for c in cameras]
    sigma = np.zeros(len(out))
    marked: list[MarkedPose] = []
    guessed: dict[str, FocalEstimate] = {}
    points = {} if request.points is None else read_marked_points(request.points, [c.name for c in cameras])
    for c, camera in enumerate(cameras):
        unknown = lens_unknown(camera)
        if camera.name in points:
            asked = with_focal(camera, 1.0) if unknown and camera.image_size is not None else camera
            found = pose_of_points(asked, *points[camera.name])
            out[c], sigma[c] = found.camera, found.sigma_focal
            marked.append(found)
        elif unknown:
            if camera.image_size is None:
                remedy = f"give {option('image_size')} to ingest, or a scene with focal_px and image_size_px"
                raise InputError(f"nothing is known of the lens of camera {camera.name}; {remedy}")
            guess = focal_of_people(camera, tracks_in_images(frames, c, camera), height)
            guessed[camera.name] = guess
            out[c], sigma[c] = with_focal(camera, guess.focal_px), guess.sigma_log
    return InitialCameras(out, sigma, marked, guessed)


def _marked_figures(each: MarkedPose) -> dict[str, object]:
    """Figures of a camera with marked points, for the summary."""
    return {
        "points": each.points,
        "residual_px": round(each.residual_px, 2),
        "sigma_position": [round(float(v), 3) for v in each.sigma_position],
        "focal_px": round(float(each.camera.focal_px[0]), 1),
        "sigma_focal_px": round(each.sigma_focal * float(each.camera.focal_px[0]), 1),
    }


def _first_frames(frames: Iterable[FrameDetectionsWithIds], job: Job) -> list[FrameDetectionsWithIds]:
    """Frames from the beginning, up to the one that reaches `MAX_BOXES` boxes; notes if more follow."""
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
    """Return the scene with the calibrated cameras, their uncertainty as noise, and significant clock offsets.

    `placed`: the result is in the world of the scene; otherwise the room, occluders and other sensors are dropped.
    """
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
    changed = replace(scene, cameras=tuple(cameras), clocks=tuple(clocks.values()), common_noise=_common_noise(found))
    # Where the room and other sensors stand in a frame of the cameras' own is not known
    return changed if placed else replace(changed, room=None, occluders=(), arrays=(), readers=())


def _common_noise(found: Calibrated) -> CommonNoise | None:
    """Standard deviations of all cameras together; those that are undetermined define the world, and are omitted."""
    position, _, yaw, scale = np.where(np.isfinite(found.sigma_frame), found.sigma_frame, 0.0).tolist()
    center = found.center.real, found.center.imag
    return CommonNoise(center, position, yaw, scale) if position or yaw or scale else None


def _sigma_yaw(each: CameraResult) -> float:
    """Standard deviation of the rotation about the vertical [rad], from those about the camera's axes."""
    up = each.camera.rotation[2]
    return float(np.sqrt(np.sum((up * each.sigma[:3]) ** 2)))


def _figures(each: CameraResult) -> dict[str, object]:
    """Figures of one camera for the summary: estimates with standard deviations."""
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
    """Standard deviations of position, yaw and scale common to all cameras, by name; undetermined ones are omitted."""
    x, y, yaw, scale = found.sigma_frame.tolist()
    values = {"x": x, "y": y, "yaw_deg": float(np.degrees(yaw)), "scale": scale}
    return {name: round(value, 4) for name, value in values.items() if np.isfinite(value)}


def _checks(found: Calibrated, stated: Sequence[Camera], config: CalibrateConfig, metre: float) -> tuple[Check, ...]:
    """Checks of the calibration with their findings.

    `stated` are the cameras before the calibration, in the order of `found.cameras`; `metre` is the length of a
    metre in scene units.
    """
    known = any(c.has_height for c in stated)
    return (
        *outcome(CAMERAS, _missing(found), cameras=sum(each.estimated for each in found.cameras)),
        *outcome(PARAMETERS, _loose(found)),
        *outcome(SEARCH, () if found.converged else (finding(SEARCH, "adjustment-not-converged"),)),
        *outcome(STATED, _moved(found, stated, config, metre), unless="" if known else "no poses are stated"),
        *_clocks(found),
        *outcome(
            PASSAGES,
            _passages(found, config),
            unless="" if found.handovers else "cameras share views",
        ),
    )


def _missing(found: Calibrated) -> Iterator[Check]:
    for each in found.cameras:
        if not each.estimated:
            yield finding(CAMERAS, "camera-not-calibrated", sensors=[each.camera.name])


def _loose(found: Calibrated) -> Iterator[Check]:
    """Report parameters that were to be estimated and that the boxes do not determine."""
    for each in found.cameras:
        for name in each.undetermined:
            yield finding(PARAMETERS, "parameter-undetermined", sensors=[each.camera.name], parameter=name)


def _common_views(
    found: Calibrated, frames: Sequence[FrameDetectionsWithIds], person_height: float
) -> tuple[Check, ...]:
    """Check that people whom one calibrated camera places in the image of another are detected there.

    Cameras with fewer than `MIN_IN_COMMON` such people are not checked. `person_height` is in scene units.
    """
    own = [each for each in found.cameras if each.estimated]
    names = [each.camera.name for each in found.cameras]
    parts = [f for f in frames if found.cameras[f.detections.camera].estimated]
    first = min((f.detections.t_ns for f in frames), default=0) / NS
    late, drift = np.array([(each.late_s, 1e-6 * each.drift_ppm) for each in found.cameras]).T
    cameras = [each.camera for each in found.cameras]
    expected, met = detected_by_others(cameras, Clocks(late, drift, first), parts, person_height)
    counts, hits = (expected + expected.T).sum(axis=0), (met + met.T).sum(axis=0)
    shares = {names[c]: hits[c] / counts[c] for c in np.flatnonzero(counts >= MIN_IN_COMMON).tolist()}
    low = {name: share for name, share in shares.items() if share < MIN_CONFIRMED}
    findings = (
        [finding(COMMON_VIEWS, "views-disagree", sensors=list(low), share=max(low.values()), allowed=MIN_CONFIRMED)]
        if low
        else []
    )
    unless = "" if shares else f"{len(own)} cameras share too few people"
    return outcome(COMMON_VIEWS, findings, unless=unless)


def _passages(found: Calibrated, config: CalibrateConfig) -> Iterator[Check]:
    """Findings about people who pass between cameras that share no view."""
    total = found.handovers + found.ambiguous
    if not total:
        return
    yield finding(PASSAGES, "no-common-view", count=found.handovers)
    if config.sigma_height is None or config.sigma_tilt is None:
        yield finding(PASSAGES, "levels-not-stated")
    if found.ambiguous > MAX_AMBIGUOUS * total:
        yield finding(PASSAGES, "passages-ambiguous", count=found.ambiguous, total=total)


def _moved(found: Calibrated, stated: Sequence[Camera], config: CalibrateConfig, metre: float) -> Iterator[Check]:
    """Report cameras with a pose farther from the stated one than `MAX_MOVED` times its standard deviation.

    `stated` are the cameras before the calibration, in the order of `found.cameras`; `metre` is the length of a
    metre in scene units.
    """
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
            late_s, sigma_s = each.late_s, float(sigma[LATE])
            words = offset_words(late_s)
            yield finding(CLOCKS, "clock-offset-found", sensors=name, late_s=late_s, sigma_s=sigma_s, **words)
        if each.is_drifting:
            yield finding(
                CLOCKS, "clock-drift-found", sensors=name, ppm=each.drift_ppm, sigma_ppm=1e6 * float(sigma[DRIFT])
            )
    # The clock that the others are compared with has no standard deviation
    loose = [e.camera.name for e in found.cameras if e.estimated and e.sigma[LATE] > 0.0 and not e.sigma[DRIFT] > 0.0]
    if loose:
        yield finding(CLOCKS, "clock-drift-undetermined", sensors=loose)


def _comment(found: Calibrated, unit: str) -> str:
    """Comment lines with the standard deviations, for the scene file; lengths are in `unit`."""
    lines = [f"Calibrated from {found.people} people by occlog calibrate; standard deviations relative to all cameras:"]
    for each in found.cameras:
        if each.estimated:
            position = ", ".join(f"{v:.3f}" for v in each.sigma[3:6])
            clock = f"clock {each.sigma[LATE]:.4f} s" if each.sigma[LATE] > 0.0 else "clock not estimated"
            lines.append(
                f"{each.camera.name}: position {position} {unit}, yaw {np.degrees(_sigma_yaw(each)):.3f} deg, {clock}"
            )
        else:
            lines.append(f"{each.camera.name}: not calibrated, as it was stated")
    return "".join(f"# {line}\n" for line in lines)
