"""The `occlog compare` command."""

from __future__ import annotations

import json
from pathlib import Path

import click

from occlog import console
from occlog.cli import options
from occlog.cli.values import Finite
from occlog.console.text import as_bytes
from occlog.errors import ExitCode, UsageError
from occlog.io.files.atomic import check_outputs


@click.command(name="compare", short_help="Say whether runs on the same recordings differ, with intervals.")
@click.argument("methods", nargs=-1, type=options.PATH, required=True)
@click.option(
    "--truth",
    type=options.PATH,
    default=None,
    help="True positions: a recording or a table; a folder of such, by the names of run folders. "
    "[default: recording.mcap of each run folder]",
)
@click.option(
    "--figure",
    "figures",
    multiple=True,
    metavar="NAME",
    help="Only this figure, such as idf1; may be repeated; a wrong name lists all.  [default: all]",
)
@click.option(
    "--fail-if",
    multiple=True,
    metavar="CONDITION",
    help="Exit with 6 if a later method is worse than the first, e.g. 'idf1 worse' or 'idf1 worse by 0.01', "
    "or if that cannot be decided; may be repeated.",
)
@click.option(
    "--match-distance",
    type=Finite(0, 1e9, min_open=True),
    default=None,
    metavar="LENGTH",
    help="A track meets a target this near.  [default: 1 m]",
)
@click.option("--markdown", type=options.PATH, default=None, help="Also write the table as Markdown.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of what is drawn at random.")
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(
    methods: tuple[Path, ...],
    truth: Path | None,
    figures: tuple[str, ...],
    fail_if: tuple[str, ...],
    match_distance: float | None,
    markdown: Path | None,
    seed: int,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Compare METHODS, each a table of tracks, a run folder or a folder of run folders, with the first of them.

    Tracks are on the ground, of one target or of many, and are compared with the truth and with each other in the same
    frames.  Verdicts and confidence intervals are of an exact test, which exchanges recordings of the runs where there
    are eight or more, and else stretches of time.

    \b
      occlog compare run/old run/new --truth hall.mcap
      occlog compare results/jipda results/feet --truth recordings/ --fail-if 'idf1 worse' --markdown compare.md
    """
    from occlog.io.files.atomic import write_bytes

    from . import text
    from .run import parse_condition, run_compare

    if len(methods) < 2:
        raise UsageError("name two methods at least: the one that others are compared with comes first")
    conditions = [parse_condition(each) for each in fail_if]
    if markdown is not None:
        check_outputs([path for path in methods if path.is_file()], (markdown,), overwrite)
    found = run_compare(methods, truth, figures, conditions, match_distance, seed)
    if markdown is not None:
        write_bytes(markdown, as_bytes(text.markdown(found, methods)), overwrite)
    told = json.dumps(text.as_dict(found, methods), indent=2) if as_json else text.table(found, methods)
    click.echo(told)
    for loss in found.losses:
        console.note(f"lost earlier: {loss}", quiet)
    for line in found.failed:
        click.echo(f"occlog: --fail-if {line}", err=True)
    return ExitCode.THRESHOLD if found.failed else ExitCode.DONE
