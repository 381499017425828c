"""The `occlog fuse` command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from occlog.cli import options

from . import options as fuse_options


@click.command(name="fuse", short_help="Remove false detections and recover missed ones, from several cameras.")
@click.argument("bearings", type=options.PATH)
@options.output_opt("Fused bearings (Parquet).")
@click.option("--views", type=options.PATH, default=None, help="The views that the bearings are of (Parquet).")
@click.option("--fused-views", type=options.PATH, default=None, help="Write the views after the fusion (Parquet).")
@options.scene_opt
@fuse_options.of_fuse
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    bearings: Path,
    output: Path,
    views: Path | None,
    fused_views: Path | None,
    scene: Path | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: Any,
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
    from .run import Files, run_fuse

    options.check_outputs([bearings, views, scene], [output, fused_views], overwrite)
    files = Files(bearings, views, scene, output, fused_views, overwrite)
    chosen = {k: v for k, v in values.items() if v is not None}
    summary, losses = run_fuse(files, chosen, quiet)
    return options.finish(summary, losses, as_json)
