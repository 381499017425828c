"""The `occlog navigate` command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import SettingsCommand, given, with_options
from occlog.cli.values import AT_LEAST_0, AnyFinite, parse_setting
from occlog.errors import UsageError
from occlog.io.files.atomic import check_outputs

from .config import NavigateConfig

if TYPE_CHECKING:
    from .course import Disc

STRICT = "Exit code 6 if the robot collides or does not reach its goal. The path is written all the same."


class Numbers(click.ParamType):  # type: ignore[type-arg,unused-ignore]
    """Numbers with commas, between a least and a greatest count of them."""

    def __init__(self, name: str, least: int, most: int) -> None:
        self.name, self.least, self.most = name, least, most

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """The numbers; a usage error for other texts and for numbers that are not finite."""
        if isinstance(value, tuple):
            return value
        parts = str(value).split(",")
        if not self.least <= len(parts) <= self.most:
            self.fail(f"{value!r}: want {self.name}", param, ctx)
        return tuple(AnyFinite().convert(part.strip(), param, ctx) for part in parts)


PLACE, DISC = Numbers("X,Y", 2, 2), Numbers("X,Y or X,Y,RADIUS", 2, 3)


@click.command(
    name="navigate",
    cls=SettingsCommand,
    settings=lambda: NavigateConfig,
    short_help="Drive a robot through a scene, around obstacles and tracked people.",
)
@click.argument("scene", type=options.INPUT)
@click.option("--from", "start", type=PLACE, required=True, metavar="X,Y", help="Where the robot starts.")
@click.option("--to", "goal", type=PLACE, required=True, metavar="X,Y", help="Where it is to go.")
@options.output_opt("The path (Parquet).")
@click.option("--picture", type=options.PATH, default=None, help="Also draw the path in the scene (PNG).")
@click.option(
    "--obstacles",
    type=options.INPUT,
    default=None,
    help="People to avoid, who move: tracks, or a recording with the truth.",
)
@click.option(
    "--obstacle",
    "discs",
    type=DISC,
    multiple=True,
    metavar="X,Y[,RADIUS]",
    help="A round obstacle beside those of the scene; may be repeated.",
)
@click.option(
    "--after",
    type=AT_LEAST_0,
    default=0.0,
    metavar="SECONDS",
    help="Start so long after the first row of --obstacles. [default: 0]",
)
@with_options(NavigateConfig)
@options.set_opt("repulsion=0.05")
@click.option("--strict", is_flag=True, help=STRICT)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    scene: Path,
    start: tuple[float, float],
    goal: tuple[float, float],
    output: Path,
    picture: Path | None,
    obstacles: Path | None,
    discs: tuple[tuple[float, ...], ...],
    after: float,
    settings: tuple[str, ...],
    strict: bool,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **values: object,
) -> int:
    """Drive a robot through SCENE (YAML, or a recording that holds one) by potential fields.

    The goal pulls, obstacles push, and every --step seconds the robot takes the direction of the sum, at constant
    speed (Lee 2009, Sec. 5.2.2).  Where an obstacle stands in line with the goal a step could end in it: --force
    prevent turns away before.  The robot then goes to and fro, which is recognised; --escape leaves the line.

    The path ends at the goal, with a collision, where everything repeats itself for ever, or after --steps.

    \b
      occlog navigate examples/room.yaml --from 1,2.6 --to 7,2.6 -o path.parquet --picture path.png
      occlog navigate examples/room.yaml --from 1,1 --to 7,5 --obstacles tracks.parquet -o path.parquet --strict
    """
    from .run import NavigateRequest, run_navigate

    request = NavigateRequest(
        scene=scene,
        start=start,
        goal=goal,
        discs=tuple(_disc(d) for d in discs),
        obstacles=obstacles,
        start_s=after,
        output=output,
        picture=picture,
        overwrite=overwrite,
    )
    if after and obstacles is None:
        raise UsageError("--after is a time of --obstacles; add them")
    check_outputs(request.inputs, [output, picture], overwrite)
    wanted: dict[str, object] = dict(parse_setting(text) for text in settings)
    wanted |= given(NavigateConfig, values)
    summary, losses, reached = run_navigate(request, wanted, quiet=quiet)
    return console.strict_code(console.finish(summary, losses, as_json), reached, strict)


def _disc(numbers: tuple[float, ...]) -> Disc:
    """A round obstacle; UsageError for a negative radius."""
    from .course import Disc

    if len(numbers) > 2 and numbers[2] < 0.0:
        raise UsageError(f"--obstacle {','.join(f'{n:g}' for n in numbers)}: the radius must be at least 0")
    return Disc(*numbers)
