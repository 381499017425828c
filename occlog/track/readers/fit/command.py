"""The `occlog fit-readers` command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.io.files.atomic import check_outputs

from .config import FitReadersConfig


@click.command(
    name="fit-readers",
    cls=SettingsCommand,
    short_help="Learn how strongly readers read tags, for `track --method rssi` and `virtual`.",
)
@click.argument("recordings", type=options.INPUT, nargs=-1, required=True)
@options.output_opt("Path losses (JSON).")
@options.scene_opt
@with_options(FitReadersConfig)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    recordings: tuple[Path, ...],
    output: Path,
    scene: Path | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **own: Any,
) -> int:
    """Learn path losses, shadowing and coverage from RECORDINGS with reads of tags and their true positions.

    Each reader has its own strength at 1 m; exponent, noise and shadowing are common. The range of the virtual
    sensors is the one with the least error. Track other recordings of the same readers with what was learned.

    \b
      occlog fit-readers monday.mcap tuesday.mcap -o readers.json
      occlog track wednesday.mcap --method rssi --path-loss readers.json -o tags.parquet
    """
    from .run import FitRequest, run_fit_readers

    request = FitRequest(recordings, scene, given(FitReadersConfig, own))
    check_outputs(request.paths, [output], overwrite)
    summary, losses = run_fit_readers(request, output, overwrite, quiet)
    return console.finish(summary, losses, as_json)
