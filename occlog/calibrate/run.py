"""Run of `occlog calibrate`: calibrate by people or by a board, write the scene, and report how sure it is."""

from __future__ import annotations

from occlog import console
from occlog.io.files.atomic import write_bytes
from occlog.io.formats.calibration.outputs import format_of
from occlog.io.formats.calibration.writer import check_calibration
from occlog.records.losses import Loss
from occlog.records.verdicts import summary_of, texts_of
from occlog.runner import Job

from .request import CalibrateRequest
from .results.output import CalibrationResult, write_scene


def run_calibrate(request: CalibrateRequest, job: Job) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Calibrate by a board or by people, and write scene and picture.

    Args:
        request: inputs, outputs and settings.
        job: writes the outputs and has the messages.

    Returns:
        Summary with the checks, and losses of the inputs.
    """
    form = format_of(request.output)
    if form is not None:
        check_calibration(request.output, form, job.overwrite)
    found = _calibration(request, job)
    made = job.provenance(found.parameters, found.losses).with_checks(found.checks)
    if request.picture is not None and found.picture is not None:
        write_bytes(request.picture, found.picture, job.overwrite)
    write_scene(request.output, found.scene, found.comment, job)
    console.note_findings(texts_of(made.judged, "calibrate"), job.quiet)
    summary = {"scene": str(request.output), **({} if request.picture is None else {"picture": str(request.picture)})}
    return {**summary, **found.summary, **summary_of(made.judged)}, found.losses


def _calibration(request: CalibrateRequest, job: Job) -> CalibrationResult:
    """Calibrate by images of a board if the request names one, else by boxes of people.

    Only the code of that calibration is imported.
    """
    if request.board is not None:
        from .boards.from_board import calibration_of_board

        return calibration_of_board(request, job)
    from .from_people import calibration_of_people

    return calibration_of_people(request, job)
