"""Lenses from images of a board: read the images, and calibrate each lens."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from occlog.array_types import NS
from occlog.errors import InputError, UsageError, abridged, option
from occlog.io.files.limits import Content, content_of
from occlog.io.files.names import safe_name
from occlog.io.frames.decoders.process import DecodingJob, start_decoder
from occlog.io.frames.streams import list_images
from occlog.io.recording.reader import open_recording
from occlog.records.frames import Image
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.verdicts import Check, finding, outcome
from occlog.runner import Job

from ..request import CalibrateRequest
from ..results.output import CalibrationResult
from .board import CELLS, BoardLens, board_of, lens_of_views, views_of

STEP_S = 0.25
"""Images of a camera that are examined are at least this far apart [s]."""
MIN_COVERAGE, MAX_REPROJECTION_PX = 0.6, 1.0
"""Share of the image with corners at least, and residual at most, without a warning."""
COVERAGE, RESIDUAL = "board coverage", "board residuals"
"""Names of checks."""


def calibration_of_board(request: CalibrateRequest, job: Job) -> CalibrationResult:
    """Calibrate the lens of each camera by images of a board.

    Args:
        request: has the board and the images.
        job: shows the progress.

    Raises:
        UsageError: an option applies to calibration by people only.
        InputError: images are missing, or the views do not determine a lens.
    """
    given: dict[str, object] = {"scene": request.scene, "ignore_poses": request.ignore_poses, "focal": request.focal}
    given |= {
        "radial": request.radial,
        "points": request.points,
        "set": request.settings,
        "picture": request.picture,
        "doa": request.doa,
    }
    for name, value in given.items():
        if value:
            raise UsageError(
                f"{option(name)}: is for boxes of people, and has no effect on a board; leave it out",
                id="not-applicable",
            )
    board = board_of(str(request.board), request.dictionary, request.marker)
    losses: list[Loss] = []
    lenses: list[BoardLens] = []
    try:
        for name in _cameras(request):
            images = job.progress(_images(request.recording, name, losses), name)
            views, size, count = views_of(images, board)
            lenses.append(lens_of_views(name, views, size, board, count))
    except InputError as error:
        raise InputError(f"{request.recording}: {str(error).removeprefix(f'{request.recording}: ')}") from error
    parameters = {"board": request.board, "dictionary": board.dictionary, "marker": board.marker}
    comment = "".join(
        f"# {each.camera.name}: {each.views} views of a board, reprojection {each.reprojection_px:.3f} px\n"
        for each in lenses
    )
    return CalibrationResult(
        Scene(tuple(each.camera for each in lenses)), comment, parameters, _checks(lenses),
        {"cameras": {each.camera.name: _figures(each) for each in lenses}}, tuple(losses),
    )  # fmt: skip


def _cameras(request: CalibrateRequest) -> list[str]:
    """Names of the cameras to calibrate: those of a recording that are selected, or the name of a video or folder.

    UsageError for a name that the recording does not have, InputError if none is left.
    """
    path = request.recording
    if path.is_dir() or content_of(path, "a video or a recording") is not Content.RECORDING:
        return [safe_name(path.stem)]
    names = open_recording(path).cameras
    unknown = [name for name in (*request.cameras, *request.without) if name not in names]
    if unknown:
        raise UsageError(
            f"{option('cameras' if unknown[0] in request.cameras else 'without')} {unknown[0]}: the recording {path} "
            f"has no such camera; it has {abridged(names)}",
            id="unknown-sensor",
        )
    used = [n for n in names if n not in request.without and (not request.cameras or n in request.cameras)]
    if not used:
        raise InputError(f"{path}: has no images of a camera; record the board, or name its video", id="wrong-content")
    return used


def _images(path: Path, name: str, losses: list[Loss]) -> Iterator[Image]:
    """Generate images of the camera `name`, at least `STEP_S` apart; all images of a folder.

    `path` is a recording, a video or a folder; losses of the decoder are added to `losses`.
    """
    last = -np.inf
    if not path.is_dir() and content_of(path, "a video or a recording") is Content.RECORDING:
        for frame in open_recording(path).frames([name]):
            if frame.t_ns - last >= STEP_S * NS:
                last = frame.t_ns
                yield frame.decode()
        return
    job = DecodingJob(kind="video", path=str(path), start=0, stop=None, store="raw", quality=0)
    if path.is_dir():
        files = [(n, str(file)) for n, file in enumerate(list_images(path))]
        job = DecodingJob(kind="images", path=str(path), files=files, store="raw", quality=0)
    with start_decoder(job) as decoder:
        rate = decoder.rate_hz or 25.0
        for each in decoder.delivered():
            at = each.index / rate * NS if each.pos_ns is None else each.pos_ns
            if path.is_dir() or at - last >= STEP_S * NS:
                last = at
                yield each.image
        losses += decoder.losses


def _figures(each: BoardLens) -> dict[str, object]:
    """Return the figures of one calibrated lens for the summary.

    Intrinsics [px] with standard deviations, distortion, reprojection error [px], views used and rejected, and the
    share of the image that the boards covered.
    """
    camera = each.camera
    return {
        "focal_px": [round(float(v), 2) for v in camera.focal_px],
        "sigma_focal_px": [round(float(v), 2) for v in each.sigma_focal],
        "principal_px": [round(float(v), 2) for v in camera.principal_px],
        "sigma_principal_px": [round(float(v), 2) for v in each.sigma_principal],
        "distortion": [round(float(v), 5) for v in camera.distortion],
        "image_size_px": list(camera.image_size or ()),
        "reprojection_px": round(each.reprojection_px, 3),
        "views": each.views,
        "views_rejected": each.rejected,
        "coverage": round(each.coverage, 2),
    }


def _checks(lenses: list[BoardLens]) -> tuple[Check, ...]:
    """Checks of board coverage and reprojection error, with their findings."""
    narrow = (
        finding(
            COVERAGE, "board-coverage", sensors=[e.camera.name], share=e.coverage, allowed=MIN_COVERAGE,
            cells=CELLS[0] * CELLS[1],
        )
        for e in lenses
        if e.coverage < MIN_COVERAGE
    )  # fmt: skip
    large = (
        finding(
            RESIDUAL, "board-residual", sensors=[e.camera.name], residual=e.reprojection_px, allowed=MAX_REPROJECTION_PX
        )
        for e in lenses
        if e.reprojection_px > MAX_REPROJECTION_PX
    )
    return (*outcome(COVERAGE, narrow, cameras=len(lenses)), *outcome(RESIDUAL, large))
