"""The `occlog appearance` command: how people look from several sides."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.io.files.atomic import check_outputs

from .config import LearnConfig


@click.group(name="appearance", short_help="Learn how people look from several sides.")
def command() -> None:
    """Learn how people look from several sides, for `occlog label --gallery` ([Lee] Sec. 5.2.1).

    \b
      occlog appearance learn hall.mcap --tracks tracks.parquet -o gallery.parquet
      occlog label later.mcap --gallery gallery.parquet --tracks later.parquet -o matches.parquet
    """


@command.command(name="learn", cls=SettingsCommand, short_help="Learn a gallery from boxes and their images.")
@click.argument("recording", type=options.INPUT)
@options.output_opt("The gallery (Parquet).")
@click.option("--boxes", type=options.INPUT, default=None, help="Boxes (Parquet). [default: those of RECORDING]")
@click.option(
    "--views", type=options.INPUT, default=None, help="Views of `occlog detect` (Parquet), whose colours count."
)
@click.option(
    "--tracks",
    type=options.INPUT,
    default=None,
    help="Tracks or truth: who is where. [default: the truth of RECORDING, or the floor below boxes that have an "
    "identity]",
)
@click.option("--labelled", is_flag=True, help="The identities of boxes are those of the tracks.")
@options.scene_opt
@with_options(LearnConfig)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def learn(
    recording: Path,
    output: Path,
    boxes: Path | None,
    views: Path | None,
    tracks: Path | None,
    labelled: bool,
    scene: Path | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Learn a gallery from RECORDING: the colours of each target, apart by the side from which it is seen.

    The side is the angle between where a person heads, by the tracks, and the camera; left and right are taken
    for the same. Boxes are of the tracks in whose places they are, unless they bring the tracks' identities.

    \b
      occlog appearance learn hall.mcap -o gallery.parquet
      occlog appearance learn hall.mcap --boxes boxes.parquet --tracks tracks.parquet -o gallery.parquet
      occlog appearance learn hall.mcap --views views.parquet --tracks tracks.parquet -o gallery.parquet
    """
    from occlog.errors import UsageError

    from .inputs import SightingFiles
    from .run import run_learn

    if boxes is not None and views is not None:
        raise UsageError("--boxes and --views are two sources of boxes; give one of them")
    check_outputs([recording, boxes, views, tracks, scene], [output], overwrite)
    files = SightingFiles(boxes=boxes or views or recording, images=recording, tracks=tracks, scene=scene)
    summary, losses = run_learn(files, labelled, given(LearnConfig, values), output, overwrite, quiet)
    return console.finish(summary, losses, as_json)
