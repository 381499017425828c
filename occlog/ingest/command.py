"""The `occlog ingest` command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, with_options
from occlog.io.files.atomic import check_outputs

from .plan import FRAMES, SIZE, IngestPlan

F = TypeVar("F", bound=Callable[..., Any])
# Several values of one option are given by repeating it.
INPUTS = (
    click.argument("bags", nargs=-1, type=options.PATH, metavar="[BAG]..."),
    click.option(
        "--topic",
        multiple=True,
        metavar="NAME=TOPIC",
        help="Topic of a bag: images, calibration or boxes of camera NAME, directions of array NAME, or true positions "
        "of target number NAME.",
    ),
    click.option(
        "--topics", multiple=True, type=options.PATH, metavar="FILE", help="The same in a YAML file, `NAME: TOPIC`."
    ),
    click.option("--video", multiple=True, metavar="CAM=FILE", help="Video of a camera."),
    click.option("--images", multiple=True, metavar="CAM=FOLDER", help="Images of a camera, in natural order."),
    click.option(
        "--boxes",
        multiple=True,
        metavar="[CAM=]PATH",
        help="Boxes: CSV, JSON (COCO, supervision, Ultralytics), MOTChallenge text, or a folder of YOLO text.",
    ),
    click.option("--mot", multiple=True, metavar="CAM=FILE", help="MOTChallenge detections; the same as --boxes."),
    click.option("--doa", multiple=True, metavar="[ARRAY=]FILE", help="Log of directions of arrival."),
    click.option("--reads", multiple=True, type=options.PATH, metavar="FILE", help="Log of tags that readers read."),
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
        "--readers", type=options.PATH, default=None, metavar="FILE", help="Places and ranges of the readers of tags."
    ),
)
TIMES = (
    click.option(
        "--start-time",
        multiple=True,
        metavar="[CAM=]TIME",
        help="Date and time (ISO 8601, UTC) or seconds since 1970 of the origin of the times. [default: 0]",
    ),
    click.option(
        "--offset",
        multiple=True,
        metavar="SENSOR=SECONDS",
        help="Added to the times of a sensor whose clock is off: cam2=-0.4s where it is 0.4 s ahead.",
    ),
    click.option("--fps", multiple=True, metavar="[CAM=]RATE", help="Frame rate, where no sidecar gives times."),
    click.option(
        "--frames",
        type=FRAMES,
        default=None,
        metavar="A:B",
        help="Only frames A <= number < B, and true positions of their times; for boxes also: every camera has all of "
        "them.",
    ),
)


def _all_options(command: F) -> F:
    for option in reversed((*INPUTS, *PLACES, *TIMES)):
        command = option(command)
    return command


@click.command(
    name="ingest",
    cls=SettingsCommand,
    short_help="Gather video, detections, DOA logs and calibration into one recording.",
)
@options.output_opt("Recording (MCAP).")
@_all_options
@with_options(IngestPlan)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(output: Path, overwrite: bool, quiet: bool, as_json: bool, **values: object) -> int:
    """Gather what cameras, microphone arrays and readers of tags have recorded into one recording.

    BAG is a bag of ROS 2 (a folder, .mcap or .db3) or an MCAP file of another program; several
    are taken for parts of one. `occlog info BAG` says what would be taken of it.  It may also be the folder of
    WILDTRACK as the data set ships it.

    The time of a frame comes from --timestamps, else from the time stamps of the video
    file, else from its frame rate; which one it was is told and recorded.  Frames that a
    damaged video has lost are listed, and the exit code is 3.  What a calibration was
    understood to say is printed: look at it.

    \b
      occlog ingest -o walk.mcap --calibration Calib.qca.txt --video cam01=cam01.mp4 --video cam02=cam02.mp4
      occlog ingest -o hall.mcap --calibration calib/ --image-size 1920x1024 --boxes detections.csv --fps 20
      occlog ingest bag/ -o walk.mcap --topic front=/cam_front/image_raw/compressed
      occlog ingest -o tags.mcap --readers readers.csv --reads reads.csv --truth truth.csv
    """
    from .run import run_ingest

    plan = IngestPlan.of(output, values)
    check_outputs(plan.inputs(), [output], overwrite)
    summary, losses = run_ingest(plan, overwrite=overwrite, quiet=quiet)
    return console.finish(summary, losses, as_json)
