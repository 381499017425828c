"""The `occlog fuse` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options

from .config import FuseConfig


@click.command(
    name="fuse",
    cls=SettingsCommand,
    settings=lambda: FuseConfig,
    short_help="Remove false detections and recover missed ones, from several cameras.",
)
@click.argument("bearings", type=options.PATH)
@options.output_opt("Fused bearings (Parquet).")
@click.option("--views", type=options.PATH, default=None, help="The views that the bearings are of (Parquet).")
@click.option("--fused-views", type=options.PATH, default=None, help="Write the views after the fusion (Parquet).")
@options.scene_opt
@with_options(FuseConfig)
@options.set_opt("reach=3")
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    bearings: Path,
    output: Path,
    views: Path | None,
    fused_views: Path | None,
    scene: Path | None,
    settings: tuple[str, ...],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Fuse the detections of several cameras in BEARINGS (Parquet, or a recording that holds bearings).

    Detections of one target are brought together on the ground. Where enough cameras agree, a camera
    that missed the target gets its detection back (cause `recovered`); a detection that the others
    contradict becomes "looked, not seen" (cause `removed`). Candidates (target_id -1) are grouped first.
    `occlog detect --fuse` does the same while it detects.

    \b
      occlog fuse bearings.parquet --views views.parquet --scene walk.mcap -o fused.parquet --fused-views both.parquet
      occlog fuse labelled.parquet --scene hall.mcap -o fused.parquet --p-miss 0.3 --p-false 0.05
    """
    from occlog.cli.values import parse_setting

    from .run import FuseFiles, run_fuse

    options.check_outputs([bearings, views, scene], [output, fused_views], overwrite)
    files = FuseFiles(
        bearings=bearings, views=views, scene=scene, output=output, fused_views=fused_views, overwrite=overwrite
    )
    chosen = dict(parse_setting(text) for text in settings) | given(FuseConfig, values)
    summary, losses = run_fuse(files, chosen, quiet)
    return options.finish(summary, losses, as_json)
