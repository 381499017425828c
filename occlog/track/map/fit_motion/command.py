"""The `occlog fit-motion` command: a motion model from trajectories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.io.files.atomic import check_outputs
from occlog.settings import configure

from .config import FitConfig


@click.command(
    name="fit-motion",
    cls=SettingsCommand,
    short_help="Identify a motion model from trajectories, for `track --method map`.",
)
@click.argument("positions", type=options.INPUT, nargs=-1, required=True)
@options.output_opt("The model (JSON).")
@with_options(FitConfig)
@click.option(
    "--target",
    "targets",
    type=int,
    multiple=True,
    metavar="ID",
    help="Use this object only; may be repeated. [default: all, of truth those of role target]",
)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    positions: tuple[Path, ...],
    output: Path,
    targets: tuple[int, ...],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **own: Any,
) -> int:
    """Identify A and Sigma of linear Gaussian motion from POSITIONS: truth or tracks, tables or recordings.

    The model says how a target moves: x' = A x + noise of covariance Sigma, x position and velocity of both axes.
    Positions may be noisy, at unequal times and with gaps; the noise is told apart from the motion.

    \b
      occlog fit-motion room.mcap -o motion.json --step 0.25
      occlog fit-motion monday.parquet tuesday.parquet -o motion.json --form damped --noise 0.1
    """
    from .run import FitRequest, run_fit

    request = FitRequest(positions, configure(FitConfig(), given(FitConfig, own)), targets)
    check_outputs(positions, [output], overwrite)
    summary, losses = run_fit(request, output, overwrite, quiet)
    return console.finish(summary, losses, as_json)
