"""The `occlog epipolar` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.io.files.atomic import check_outputs

from .config import EpipolarConfig


@click.command(
    name="epipolar",
    cls=SettingsCommand,
    short_help="Find how pairs of views see the same point, or check it.",
)
@click.argument("recording", type=options.INPUT, required=False)
@options.output_opt("Fundamental matrices (JSON), or a copy of the recording that holds them (MCAP).", required=False)
@options.scene_opt
@click.option(
    "--matches",
    type=options.INPUT,
    default=None,
    metavar="FILE",
    help="Points that two views both show: CSV, sensor_a,sensor_b,xa_px,ya_px,xb_px,yb_px.",
)
@click.option(
    "--from-tracks",
    "tracks",
    type=options.INPUT,
    default=None,
    metavar="FILE",
    help="Take the centres of targets in two views for matches: view tracks (Parquet), or a recording or "
    "table with true boxes.",
)
@click.option(
    "--fundamental",
    type=options.INPUT,
    default=None,
    metavar="FILE",
    help="Use these matrices (JSON, or a recording that holds some).",
)
@click.option("--check", is_flag=True, help="Say how well the matches agree with the matrices or the poses.")
@with_options(EpipolarConfig)
@click.option("--cameras", "only", default="", metavar="A,B,...", help="Only pairs of these cameras.")
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    recording: Path | None,
    output: Path | None,
    scene: Path | None,
    matches: Path | None,
    tracks: Path | None,
    fundamental: Path | None,
    check: bool,
    only: str,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Find the fundamental matrix of each pair of views: where a point of one view can be in the other.

    It comes from --matches (or --from-tracks) where they are given, else from the poses of the scene.
    Matches of one plane (people's feet), of a line, from one place, or too few are refused.
    Where a scene tells lens distortion, it is taken off the points first.

    With RECORDING and an output that ends in .mcap, a copy of the recording holds the matrices, and
    `occlog track` finds them there.

    \b
      occlog epipolar --scene scene.yaml -o epipolar.json
      occlog epipolar --matches matches.csv -o epipolar.json
      occlog epipolar walk.mcap --matches matches.csv -o walk_epipolar.mcap
      occlog epipolar --check --matches matches.csv --fundamental epipolar.json
    """
    from occlog.errors import ExitCode

    from .run import EpipolarRequest, run_epipolar

    request = EpipolarRequest(
        recording=recording,
        scene=scene,
        matches=matches,
        tracks=tracks,
        fundamental=fundamental,
        check=check,
        only=only,
        config=EpipolarConfig(**given(EpipolarConfig, values)),
    )
    check_outputs(request.inputs, [output], overwrite)
    summary, losses, agree = run_epipolar(request, output, overwrite, quiet)
    code = console.finish(summary if as_json else {**summary, "pairs": []}, losses, as_json)
    for name, figures in () if as_json else summary["pairs"].items():
        click.echo(f"{name}: {_line(figures)}")
    return code if agree else ExitCode.THRESHOLD


def _line(figures: dict[str, object]) -> str:
    """Figures of one pair for a person."""
    return ", ".join(f"{k.replace('_', ' ')} {f'{v:.3g}' if isinstance(v, float) else v}" for k, v in figures.items())
