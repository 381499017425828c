"""The `occlog ingest` command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from occlog.cli import options

from .plan import FRAMES, SIZE, IngestPlan

F = TypeVar("F", bound=Callable[..., Any])
CALIBRATIONS = ("auto", "qualisys", "tsai", "projection", "opencv-toml", "opencv-storage")
TRUTHS = ("auto", "csv", "mot", "xml", "caliscope")
DOAS = ("auto", "csv", "frida", "telemetr")

# Names and order of the fields of IngestPlan; several values of one option are given by repeating it.
INPUTS = (
    click.option("--video", multiple=True, metavar="CAM=FILE", help="Video of a camera."),
    click.option("--images", multiple=True, metavar="CAM=FOLDER", help="Images of a camera, in natural order."),
    click.option(
        "--boxes",
        multiple=True,
        metavar="[CAM=]FILE",
        help="Detector boxes: CSV with a header, or MOTChallenge text (then with CAM).",
    ),
    click.option("--mot", multiple=True, metavar="CAM=FILE", help="MOTChallenge detections; the same as --boxes."),
    click.option("--doa", multiple=True, metavar="[ARRAY=]FILE", help="Log of directions of arrival."),
    click.option("--truth", multiple=True, metavar="[CAM=]FILE", help="Ground truth: positions or boxes."),
    click.option(
        "--timestamps",
        multiple=True,
        metavar="[CAM=]FILE",
        help="Times of the frames: one a line, or columns time, frame, camera; before any other source.",
    ),
)
PLACES = (
    click.option("--calibration", multiple=True, type=options.PATH, metavar="FILE", help="Calibration of the cameras."),
    click.option(
        "--calibration-format",
        type=click.Choice(CALIBRATIONS),
        default="auto",
        show_default=True,
        help="Format of the calibration.",
    ),
    click.option(
        "--calibration-unit",
        type=click.Choice(["m", "cm", "mm"]),
        default=None,
        help="Length unit of the calibration. [default: the format's own, or m]",
    ),
    click.option(
        "--image-size",
        type=SIZE,
        default=None,
        metavar="WxH",
        help="Size of the images, for calibrations that do not state it.",
    ),
    click.option(
        "--scene",
        type=options.PATH,
        default=None,
        help="Scene with room, occluders, arrays, and cameras that the calibration lacks.",
    ),
    click.option(
        "--arrays",
        multiple=True,
        metavar="[NAME=]FILE",
        help="Places of direction finders, or microphones of one array.",
    ),
    click.option(
        "--allow-uncalibrated", is_flag=True, help="Take cameras without calibration too; they give no bearings."
    ),
)
SETTINGS = (
    click.option(
        "--start-time",
        multiple=True,
        metavar="[CAM=]TIME",
        help="Date and time (ISO 8601, UTC) or seconds since 1970 of the origin of the times. [default: 0]",
    ),
    click.option("--fps", multiple=True, metavar="[CAM=]RATE", help="Frame rate, where no sidecar gives times."),
    click.option(
        "--frames",
        type=FRAMES,
        default=None,
        metavar="A:B",
        help="Only frames A <= number < B; for boxes also: every camera has all of them.",
    ),
    click.option(
        "--first-number",
        type=click.IntRange(min=0),
        default=None,
        help="Number of frame 0 in names of images and tables. [default: lowest image; 0 in tables]",
    ),
    click.option(
        "--store",
        type=click.Choice(["jpeg", "png", "link"]),
        default=None,
        help="How frames are kept; link: only their times, beside the video. [default: PNG and JPEG files "
        "as they are, all else as jpeg]",
    ),
    click.option(
        "--jpeg-quality", type=click.IntRange(1, 100), default=95, show_default=True, help="Of frames kept as JPEG."
    ),
    click.option(
        "--confidence-scale",
        type=click.FloatRange(min=0, min_open=True),
        default=1.0,
        show_default=True,
        help="Divide the detector's confidences by this.",
    ),
    click.option("--ignore-extra-columns", is_flag=True, help="Skip unknown columns of tables."),
    click.option(
        "--truth-format",
        type=click.Choice(TRUTHS),
        default="auto",
        show_default=True,
        help="Format of the ground truth.",
    ),
    click.option(
        "--doa-format", type=click.Choice(DOAS), default="auto", show_default=True, help="Format of the DOA logs."
    ),
    click.option(
        "--doa-unit",
        type=click.Choice(["deg", "rad"]),
        default=None,
        help="Unit of angles in columns whose name does not state it.",
    ),
    click.option(
        "--doa-convention",
        type=click.Choice(["math", "compass", "array"]),
        default=None,
        help="Azimuth from +x towards +y; clockwise from north (+y); or from the array's own x axis. "
        "[default: the format's own, or math]",
    ),
    click.option("--doa-algorithm", default=None, help="Whose estimates to take, where a log holds several."),
)


def _all_options(command: F) -> F:
    for option in reversed((*INPUTS, *PLACES, *SETTINGS)):
        command = option(command)
    return command


@click.command(name="ingest", short_help="Gather video, detections, DOA logs and calibration into one recording.")
@options.output_opt("Recording (MCAP).")
@_all_options
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(output: Path, overwrite: bool, quiet: bool, as_json: bool, **values: Any) -> int:
    """Gather what cameras and microphone arrays have recorded into one recording.

    The time of a frame comes from --timestamps, else from the time stamps of the video
    file, else from its frame rate; which one it was is told and recorded.  Frames that a
    damaged video has lost are listed, and the exit code is 3.  What a calibration was
    understood to say is printed: look at it.

    \b
      occlog ingest -o walk.mcap --calibration Calib.qca.txt --video cam01=cam01.mp4 --video cam02=cam02.mp4
      occlog ingest -o hall.mcap --calibration calib/ --image-size 1920x1024 --boxes detections.csv --fps 20
    """
    from .run import run_ingest

    plan = IngestPlan.of(output, values)
    options.check_outputs(plan.inputs(), [output], overwrite)
    summary, losses = run_ingest(plan, overwrite=overwrite, quiet=quiet)
    return options.finish(summary, losses, as_json)
