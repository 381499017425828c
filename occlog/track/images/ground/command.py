"""The `occlog ground` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.io.files.atomic import check_outputs

from .config import GroundConfig


@click.command(
    name="ground",
    cls=SettingsCommand,
    settings=lambda: GroundConfig,
    short_help="Bring tracks in the images of calibrated cameras together in the world.",
)
@click.argument("view_tracks", type=options.INPUT)
@options.output_opt("Tracks (Parquet).")
@options.scene_opt
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Use only these cameras.")
@with_options(GroundConfig)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A setting, e.g. height=0.8; may be repeated.",
)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    view_tracks: Path,
    output: Path,
    scene: Path | None,
    only: str,
    window_s: float | None,
    settings: tuple[str, ...],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Find where the targets of VIEW_TRACKS (Parquet) are in the world, with covariance.

    At each time the centres of a target's ellipses in all views give its place. A view that is on
    something else is left out where two others or more agree; two views that contradict each other give
    no place. A target that one view alone shows is placed at a height, that of the middle of a person;
    set another, or 0 to leave such times out.

    \b
      occlog ground view_tracks.parquet --scene scene.yaml -o tracks.parquet
      occlog ground view_tracks.parquet --scene hall.mcap --set height=0 -o tracks.parquet
    """
    from occlog.cli.values import parse_names, parse_setting

    from .run import GroundFiles, run_ground

    check_outputs([view_tracks, scene], [output], overwrite)
    files = GroundFiles(view_tracks, scene, output, overwrite)
    values: dict[str, object] = dict(parse_setting(text) for text in settings)
    values |= given(GroundConfig, {"window_s": window_s})
    summary, losses = run_ground(files, parse_names(only), values, quiet)
    return console.finish(summary, losses, as_json)
