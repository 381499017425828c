"""`occlog view`: show a run or a recording in an installed viewer."""

from __future__ import annotations

from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.options import Finite
from occlog.examine.export.formats import PROGRAMS

every_opt = click.option(
    "--every",
    type=Finite(1e-3, 1e6),
    default=None,
    metavar="SECONDS",
    help="For viewers: minimum time between images, drawings and numbers in the file. [default: all]",
)


@click.command(name="view", short_help="Show a run or a recording in Rerun, Foxglove or Lichtblick.")
@click.argument("file", type=options.INPUT)
@click.option(
    "-o",
    "--output",
    type=options.PATH,
    default=None,
    help="File that the viewer opens (MCAP). [default: a temporary file, removed when the viewer ends]",
)
@click.option(
    "--recording", type=options.INPUT, default=None, help="Recording with images and scene, if the run folder has none."
)
@options.scene_opt
@click.option(
    "--viewer",
    default=None,
    metavar="PROGRAM",
    help=f"Name or path of the viewer. [default: the first that is installed of {', '.join(PROGRAMS)}]",
)
@every_opt
@click.option("--print", "only_print", is_flag=True, help="Write the file (-o), print the viewer's command, and end.")
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    file: Path,
    output: Path | None,
    recording: Path | None,
    scene: Path | None,
    viewer: str | None,
    every: float | None,
    only_print: bool,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Show FILE, a run folder, a recording or a table, in a viewer: images, the plan, people, numbers, events.

    The viewer is an external program on this machine; nothing is sent over a network and no server is started.

    \b
      occlog view run/
      occlog view run/ --recording hall.mcap --viewer foxglove
      occlog view run/ -o run.mcap --print
    """
    from .opened import ViewRequest, run_view

    request = ViewRequest(file, output, recording, scene, viewer, only_print, overwrite, every)
    summary, losses = run_view(request, quiet=quiet)
    return console.finish(summary, losses, as_json)
