"""The `occlog priors` command: where moving occluders are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from occlog.cli import options

POSITIVE = click.FloatRange(min=0, min_open=True)
NOT_NEGATIVE = click.FloatRange(min=0)


def seconds(name: str, field: str, text: str) -> Any:
    """An option for a time."""
    return click.option(name, field, type=NOT_NEGATIVE, default=None, metavar="SECONDS", help=text)


@click.group(name="priors", short_help="Find where moving occluders are, for `track --occluders`.")
def command() -> None:
    """Find where moving occluders are, for `occlog track --occluders`.

    \b
      occlog priors kalman room.mcap -o occluders.parquet
      occlog track room.mcap -o tracks.parquet --occluders occluders.parquet
    """


@command.command(name="kalman", short_help="From positions, true or measured.")
@click.argument("positions", type=options.PATH)
@options.output_opt("Occluders (Parquet).")
@options.scene_opt
@click.option("--measured", is_flag=True, help="POSITIONS are real measurements: no noise is added.")
@click.option(
    "--sigma",
    type=NOT_NEGATIVE,
    default=None,
    metavar="LENGTH",
    help="Standard deviation of a measurement, per axis; 0: places are known. [default: 8, or 0.3 m; "
    "0 for --measured tracks, added to their own covariance]",
)
@click.option(
    "--q", type=POSITIVE, default=None, help="Change of the velocity in a second, per axis. [default: 1.2, or 0.6 m]"
)
@seconds("--silence", "silence_s", "Leave out who is not measured for so long. [default: 2]")
@click.option("--without", type=int, multiple=True, metavar="ID", help="Leave this object out; may be repeated.")
@options.seed_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def kalman(
    positions: Path,
    output: Path,
    scene: Path | None,
    measured: bool,
    without: tuple[int, ...],
    seed: int,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: Any,
) -> int:
    """Priors from POSITIONS (a recording with truth, or a table of truth or tracks) by a Kalman filter each.

    Of truth the objects of the role `occluder` are used. Without --measured, noise is added to their true
    places first, as in experiments with virtual occluders.

    \b
      occlog priors kalman room.mcap -o occluders.parquet --sigma 8 --q 1.2 --seed 1
      occlog priors kalman badges.parquet --measured --sigma 0.2 -o occluders.parquet
    """
    from .run import run_kalman

    options.check_outputs([positions, scene], [output], overwrite)
    chosen = {name: value for name, value in values.items() if value is not None}
    summary, losses = run_kalman(positions, scene, chosen, measured, without, seed, output, overwrite, quiet)
    return options.finish(summary, losses, as_json)


@command.command(name="hull", short_help="From the views of several cameras: their visual hull.")
@click.argument("views", type=options.PATH)
@options.output_opt("Occluders: Gaussians (Parquet).")
@click.option("--hulls", type=options.PATH, default=None, help="The polygons themselves (Parquet).")
@options.scene_opt
@click.option(
    "--bearings",
    type=options.PATH,
    default=None,
    help="Bearings made along with VIEWS, which tell frames without anybody from missing ones.",
)
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Use only these cameras.")
@click.option("--without", default="", metavar="A,B,...", help="Leave these cameras out.")
@click.option(
    "--misses", type=click.IntRange(min=0), default=None, help="Cameras that may overlook somebody. [default: 1]"
)
@click.option("--least", type=click.IntRange(min=1), default=None, help="Cameras that must see an object. [default: 2]")
@click.option(
    "--dilate",
    type=NOT_NEGATIVE,
    default=None,
    metavar="RADIANS",
    help="Added to both sides of every run. [default: 0.01]",
)
@click.option(
    "--smallest", type=NOT_NEGATIVE, default=None, metavar="AREA", help="Of a polygon. [default: 1, or 0.02 m^2]"
)
@seconds("--persist", "persist_s", "A polygon must have been there so long. [default: 0.2]")
@seconds("--hold", "hold_s", "How long a certain polygon is kept when it is not there. [default: 0.3]")
@seconds("--memory", "memory_s", "How long proof against phantoms holds. [default: 2]")
@seconds("--window", "window_s", "Frames so close together are of one moment. [default: 0]")
@click.option(
    "--exclude-targets/--include-targets",
    "exclude_targets",
    default=None,
    help="Leave out clusters that are known to be of a target. [default: exclude]",
)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def hull(
    views: Path,
    output: Path,
    hulls: Path | None,
    scene: Path | None,
    bearings: Path | None,
    only: str,
    without: str,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: Any,
) -> int:
    """Priors from VIEWS (of `occlog detect --views`): where the cones of what cameras see meet.

    Polygons that no camera needs (phantoms) are left out. Where clusters are not told apart, the tracked
    target's own polygon is there, too: `occlog track --set own_gate=3` leaves it out.

    \b
      occlog priors hull views.parquet --scene hall.mcap -o occluders.parquet --hulls hulls.parquet
    """
    from .run import Cameras, run_hull

    options.check_outputs([views, scene, bearings], [output, hulls], overwrite)
    chosen = {name: value for name, value in values.items() if value is not None}
    cameras = Cameras.of(only, without)
    summary, losses = run_hull(views, bearings, scene, cameras, chosen, output, hulls, overwrite, quiet)
    return options.finish(summary, losses, as_json)


@command.command(name="acoustic", short_help="From directions of arrival at microphone arrays.")
@click.argument("doa", type=options.PATH)
@options.output_opt("Occluders (Parquet).")
@options.scene_opt
@click.option("--gate", type=POSITIVE, default=None, help="Standard deviations. [default: 3]")
@click.option(
    "--q", type=POSITIVE, default=None, help="Change of the velocity in a second, per axis. [default: 1.2, or 0.6 m]"
)
@seconds("--persist", "persist_s", "A source must have been heard so long. [default: 0.3]")
@seconds("--silence", "silence_s", "Leave out who is not heard for so long. [default: 2]")
@seconds("--window", "window_s", "Directions so close together are of one moment. [default: 0]")
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def acoustic(
    doa: Path, output: Path, scene: Path | None, overwrite: bool, quiet: bool, as_json: bool, **values: Any
) -> int:
    """Priors from DOA (a table of directions of arrival, or a recording with them) of two arrays or more.

    \b
      occlog priors acoustic talk.mcap -o occluders.parquet --window 0.05
    """
    from .run import run_acoustic

    options.check_outputs([doa, scene], [output], overwrite)
    chosen = {name: value for name, value in values.items() if value is not None}
    summary, losses = run_acoustic(doa, scene, chosen, output, overwrite, quiet)
    return options.finish(summary, losses, as_json)
