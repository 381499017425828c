"""The `occlog plan` command."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.cli.values import POSITIVE, parse_setting
from occlog.errors import UsageError
from occlog.io.files.atomic import check_outputs

from .config import PlanConfig

RANKINGS = ("candidates", "added", "without")
"""Lists of sensors in the summary."""


@click.command(
    name="plan",
    cls=SettingsCommand,
    settings=lambda: PlanConfig,
    short_help="Expected errors of sensors, and what one more would help.",
)
@click.argument("scene", type=options.INPUT)
@options.output_opt("The map (Parquet).", required=False)
@click.option("--picture", type=options.PATH, default=None, help="Draw the map (PNG or SVG, by the name).")
@click.option("--report", type=options.PATH, default=None, help="Write a page with map, figures and rankings (HTML).")
@click.option(
    "--candidates",
    type=options.INPUT,
    default=None,
    metavar="FILE",
    help="A scene file whose cameras and arrays are places for one more; they are ranked.",
)
@click.option(
    "--along-walls",
    metavar="CAMERA",
    default=None,
    help="Rank places along the walls for a camera like this one of the scene (lens, height, noise) that looks at the "
    "middle of the room.",
)
@click.option(
    "--spacing",
    type=POSITIVE,
    default=None,
    metavar="LENGTH",
    help="Of places along a wall, at most. [default: a sixteenth of all walls]",
)
@click.option(
    "--add",
    type=click.IntRange(min=1),
    default=None,
    metavar="N",
    help="Add N of the candidates one after the other, each time the one that helps most.",
)
@click.option("--remove", is_flag=True, help="Rank the scene's own sensors by how little they are needed.")
@click.option(
    "--paths",
    type=options.INPUT,
    default=None,
    metavar="FILE",
    help="Tracks, or a recording with the truth: the floor counts by where these people were.",
)
@with_options(PlanConfig)
@options.set_opt("window_s=12")
@options.seed_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    scene: Path,
    output: Path | None,
    picture: Path | None,
    report: Path | None,
    candidates: Path | None,
    along_walls: str | None,
    spacing: float | None,
    add: int | None,
    remove: bool,
    paths: Path | None,
    settings: tuple[str, ...],
    seed: int,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Tell what errors are to be expected of the cameras and arrays of SCENE (YAML, or a recording that holds one).

    For each place of the floor: the root mean square error of a filter that has followed a target there, and how
    probable it is that no, one, or several sensors see the target, among --people who walk about and hide it.  The
    error is that of a filter that knows how often the walkers turn, along ways to each place; no recording is made.

    \b
      occlog plan examples/room.yaml --people 6 --within 0.3 -o plan.parquet --picture plan.png
      occlog plan examples/room.yaml --people 6 --along-walls southwest --add 2 --report plan.html
      occlog plan examples/room.yaml --density 0.2 --remove --json
    """
    from .run import PlanRequest, run_plan

    if candidates is not None and along_walls is not None:
        raise UsageError("--candidates and --along-walls exclude each other; name all places in one file")
    if candidates is None and along_walls is None and add is not None:
        raise UsageError("--add adds candidates; give --candidates or --along-walls")
    if spacing is not None and along_walls is None:
        raise UsageError("--spacing is of places along the walls; add --along-walls")
    request = PlanRequest(
        scene=scene,
        output=output,
        picture=picture,
        report=report,
        candidates=candidates,
        along_walls=along_walls,
        spacing=spacing,
        add=add or 0,
        remove=remove,
        paths=paths,
        overwrite=overwrite,
    )
    check_outputs(request.inputs, [output, picture, report], overwrite)
    wanted: dict[str, object] = dict(parse_setting(text) for text in settings)
    wanted |= given(PlanConfig, values)
    summary, losses = run_plan(request, wanted, seed, quiet=quiet)
    if not as_json:
        summary |= {name: _in_a_line(summary[name]) for name in RANKINGS if name in summary}
    return console.finish(summary, losses, as_json)


def _in_a_line(rows: object) -> str:
    """Names and errors of sensors, as a person reads them."""
    assert isinstance(rows, list)
    errors = [next(value for name, value in row.items() if name.startswith("rmse_")) for row in rows]
    return ", ".join(f"{row['name']} {error:.3g}" for row, error in zip(rows, errors, strict=True))
