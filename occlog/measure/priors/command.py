"""The `occlog priors` command: where moving occluders are."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.io.files.atomic import check_outputs

from .config import AcousticConfig, HullConfig, KalmanConfig


@click.group(name="priors", short_help="Find where moving occluders are, for `track --occluders`.")
def command() -> None:
    """Find where moving occluders are, for `occlog track --occluders`.

    \b
      occlog priors kalman room.mcap -o occluders.parquet
      occlog track room.mcap -o tracks.parquet --occluders occluders.parquet
    """


@command.command(name="kalman", cls=SettingsCommand, short_help="From positions, true or measured.")
@click.argument("positions", type=options.INPUT)
@options.output_opt("Occluders (Parquet).")
@options.scene_opt
@click.option("--measured", is_flag=True, help="POSITIONS are real measurements: no noise is added.")
@with_options(KalmanConfig)
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
    **values: object,
) -> int:
    """Priors from POSITIONS (a recording with truth, or a table of truth or tracks) by a Kalman filter each.

    Of truth the objects of the role `occluder` are used. Without --measured, noise is added to their true
    places first, as in experiments with virtual occluders.

    \b
      occlog priors kalman room.mcap -o occluders.parquet --sigma 8 --q 1.2 --seed 1
      occlog priors kalman badges.parquet --measured --sigma 0.2 -o occluders.parquet
    """
    from .run import KalmanRequest, run_kalman

    check_outputs([positions, scene], [output], overwrite)
    request = KalmanRequest(
        positions=positions,
        scene=scene,
        settings=given(KalmanConfig, values),
        measured=measured,
        without=without,
        seed=seed,
    )
    summary, losses = run_kalman(request, output, overwrite, quiet)
    return console.finish(summary, losses, as_json)


@command.command(
    name="hull",
    cls=SettingsCommand,
    settings=lambda: HullConfig,
    short_help="From the views of several cameras: their visual hull.",
)
@click.argument("views", type=options.INPUT)
@options.output_opt("Occluders: Gaussians (Parquet).")
@click.option("--hulls", type=options.PATH, default=None, help="The polygons themselves (Parquet).")
@options.scene_opt
@click.option(
    "--bearings",
    type=options.INPUT,
    default=None,
    help="Bearings made along with VIEWS, which tell frames without anybody from missing ones.",
)
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Use only these cameras.")
@click.option("--without", default="", metavar="A,B,...", help="Leave these cameras out.")
@with_options(HullConfig)
@options.set_opt("speed=2")
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
    settings: tuple[str, ...],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Priors from VIEWS (of `occlog detect --views`): where the cones of what cameras see meet.

    Polygons that no camera needs (phantoms) are left out. Where clusters are not told apart, the tracked
    target's own polygon is there, too: `occlog track --set own_gate=3` leaves it out.

    \b
      occlog priors hull views.parquet --scene hall.mcap -o occluders.parquet --hulls hulls.parquet
    """
    from occlog.cli.values import parse_names, parse_setting

    from .run import Cameras, HullRequest, run_hull

    check_outputs([views, scene, bearings], [output, hulls], overwrite)
    request = HullRequest(
        views=views,
        bearings=bearings,
        scene=scene,
        cameras=Cameras(only=parse_names(only), without=parse_names(without)),
        settings=dict(parse_setting(text) for text in settings) | given(HullConfig, values),
    )
    summary, losses = run_hull(request, output, hulls, overwrite, quiet)
    return console.finish(summary, losses, as_json)


@command.command(
    name="acoustic",
    cls=SettingsCommand,
    settings=lambda: AcousticConfig,
    short_help="From directions of arrival at microphone arrays.",
)
@click.argument("doa", type=options.INPUT)
@options.output_opt("Occluders (Parquet).")
@options.scene_opt
@with_options(AcousticConfig)
@options.set_opt("min_crossing=0.2")
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def acoustic(
    doa: Path,
    output: Path,
    scene: Path | None,
    settings: tuple[str, ...],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Priors from DOA (a table of directions of arrival, or a recording with them) of two arrays or more.

    \b
      occlog priors acoustic talk.mcap -o occluders.parquet --window 0.05
    """
    from occlog.cli.values import parse_setting

    from .run import run_acoustic

    check_outputs([doa, scene], [output], overwrite)
    chosen = dict(parse_setting(text) for text in settings) | given(AcousticConfig, values)
    summary, losses = run_acoustic(doa, scene, chosen, output, overwrite, quiet)
    return console.finish(summary, losses, as_json)
