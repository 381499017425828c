"""The `occlog detect` command."""

from __future__ import annotations

import os
from pathlib import Path

import click

from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, add_options, given, options_of, with_options
from occlog.measure.fuse.config import FuseConfig

from .config import DetectConfig

OF_FUSION = [
    *options_of(FuseConfig, only=("sigma", "window_s"), under="fuse"),
    *options_of(FuseConfig, only=("p_miss", "p_false")),
]
"""Options that only the fusion takes."""


@click.command(
    name="detect",
    cls=SettingsCommand,
    short_help="Reduce the frames of a recording to bearings.",
)
@click.argument("recording", type=options.INPUT)
@options.output_opt("Bearings of the targets (Parquet).")
@click.option("--views", type=options.PATH, default=None, help="Every people-sized region of every frame (Parquet).")
@options.scene_opt
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Only these cameras.")
@click.option(
    "--target",
    "references",
    type=options.INPUT,
    default=None,
    metavar="JSON",
    help="Appearances of the targets, as `occlog simulate --render` attaches them. [default: the attached]",
)
@click.option(
    "--target-box",
    "boxes",
    multiple=True,
    metavar="[ID:]CAM:FRAME:X,Y,W,H",
    help="A box [px] around a target in one frame, from which its appearance is learnt; may be repeated.",
)
@click.option(
    "--near",
    type=options.INPUT,
    default=None,
    metavar="TRACKS",
    help="Look for each target only around where its track says that it is, by the time before the frame.",
)
@click.option(
    "--learn/--no-learn",
    default=True,
    show_default=True,
    help="Look through the recording first, for what it shows when nobody is there.",
)
@with_options(DetectConfig)
@click.option("--fuse", is_flag=True, help="Fuse the detections of the cameras: remove false, recover missed.")
@add_options(OF_FUSION)
@options.workers_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    recording: Path,
    output: Path,
    views: Path | None,
    scene: Path | None,
    only: str,
    references: Path | None,
    boxes: tuple[str, ...],
    near: Path | None,
    learn: bool,
    fuse: bool,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Reduce the frames of RECORDING to bearings of its targets.

    Each camera's foreground is split into people-sized regions, and the target told from the others by
    its appearance; without one, it is the largest region. A frame without the target gives a row
    "looked, not seen". A recording with detector boxes instead of video gives one candidate bearing a box
    (target_id -1); one with simulated bearings gives these.

    \b
      occlog detect walk.mcap -o bearings.parquet --views views.parquet
      occlog detect walk.mcap -o bearings.parquet --views views.parquet --fuse
      occlog detect hall.mcap -o bearings.parquet --target-box cam1:120:310,95,40,110 --background knn
    """
    from occlog.cli.values import parse_names

    from .run import DetectRequest, run_detect

    options.check_outputs([recording, scene, references, near], [output, views], overwrite)
    request = DetectRequest(
        recording=recording,
        scene=scene,
        only=parse_names(only),
        references=references,
        boxes=boxes,
        learn=learn,
        near=near,
        settings=given(DetectConfig, values),
        workers=workers or os.cpu_count() or 1,
        fusion=given(FuseConfig, values) if fuse else None,
    )
    if not fuse:
        _refuse_options_of_fusion(values)
    summary, losses = run_detect(request, output, views, overwrite, quiet)
    return options.finish(summary, losses, as_json)


def _refuse_options_of_fusion(values: dict[str, object]) -> None:
    """Usage error for an option that only the fusion takes; the height of a person is an option of detection, too."""
    for option in OF_FUSION:
        if values[str(option.name)] is not None:
            raise click.UsageError(f"{option.opts[0]} is an option of the fusion; add --fuse")
