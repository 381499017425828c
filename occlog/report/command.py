"""The `occlog report` command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import click

from occlog import console
from occlog.cli import options
from occlog.cli.setting_options import VariantCommand
from occlog.errors import UsageError

from .options import PAGE, VARIANTS, chosen

if TYPE_CHECKING:
    from occlog.records.columns import Table


T = TypeVar("T", bound="Table")


def shared() -> list[click.Parameter]:
    """Parameters of all kinds."""
    return command.params


@click.command(
    cls=VariantCommand,
    name="report",
    short_help="Show a run as one offline page and a picture.",
    variants=VARIANTS,
    choose=lambda args: chosen(args, shared()),
    default=PAGE,
    shows_default=True,
    what="kind",
    chosen_by="report [--recording PATH]",
)
@click.argument("tracks", type=options.INPUT, required=False)
@options.scene_opt
@click.option("--truth", type=options.INPUT, default=None, help="True positions: a recording or a table.")
@click.option(
    "--png",
    type=options.PATH,
    default=None,
    help="Also write the main figures as a picture; with --frame that frame, drawn over.",
)
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(**given: Any) -> int:
    """Show TRACKS and what else is given as one page: floor plan, errors and bound, what each sensor saw.

    TRACKS may be a run folder: then everything in it is shown that is not named otherwise.
    Without TRACKS the scene alone is drawn.  Two of them are shown side by side, with their differences.

    \b
      occlog report run/ -o report.html --png report.png
      occlog report run/old run/new -o beside.html --markdown beside.md
      occlog report tracks.parquet --scene scene.yaml --bearings bearings.parquet -o report.html
      occlog report --scene scene.yaml -o scene.html
      occlog report view_tracks.parquet --recording balls.mcap --truth balls.mcap --video balls.webm

    With --recording no page is made: TRACKS, in images or of the world, and true boxes are drawn over the frames.
    """
    from occlog.records.verdicts import summary_of, texts_of

    from .inputs import Paths, from_folder
    from .run import run_report

    as_json, quiet = given.pop("as_json"), given.pop("quiet")
    if "recording" in given:
        from occlog.report.overlay.command import run_overlay
        from occlog.report.overlay.pictures import Asked

        return console.finish(*run_overlay(Asked(**given), quiet=quiet), as_json)
    if "other" in given:
        return _beside(given, quiet=quiet, as_json=as_json)
    title, strict = given.pop("title"), given.pop("strict")
    if given["output"] is None:
        raise UsageError("no output: give -o (the page), or --recording with --video or --frame")
    paths = from_folder(Paths(**given))
    data, unseen = run_report(paths, title)
    for loss in data.losses:
        if loss not in unseen:
            console.note(f"lost earlier: {loss}", quiet)
    if data.strangers:
        console.note(
            f"warning: bearings of {', '.join(map(repr, data.strangers[:4]))}, not in the scene, are counted and not "
            "drawn; give the scene that they were made in",
            quiet,
        )
    console.note_findings(texts_of(data.verdicts, "report"), quiet)
    summary: dict[str, object] = {
        "page": paths.output,
        "png": paths.png,
        "markdown": paths.markdown,
        "targets": len(data.targets),
    }
    summary |= {name: data.rows(name) for name in TABLES if getattr(data, name) is not None}
    summary |= {"not_in_scene": list(data.strangers)} if data.strangers else {}
    summary = {k: v for k, v in summary.items() if v is not None} | summary_of(data.verdicts)
    code = console.finish(summary, unseen, as_json)
    return console.strict_code(code, data.plausible, strict)


def _beside(given: dict[str, Any], *, quiet: bool, as_json: bool) -> int:
    """Two runs side by side, from the values of the options."""
    from occlog.cli.setting_options import given as given_settings

    from .beside.config import BesideConfig
    from .beside.run import Asked, run_beside
    from .beside.summary import summary_of

    strict = given.pop("strict")
    if given["output"] is None:
        raise UsageError("no output: give -o (the page)")
    if given.pop("png") is not None:
        raise UsageError("--png: of two runs there is a page alone; leave it out")
    config = BesideConfig(**given_settings(BesideConfig, given))
    asked = Asked(**{name: value for name, value in given.items() if not hasattr(config, name)}, config=config)
    found = run_beside(asked)
    for whose, loss in found.losses:
        console.note(f"lost earlier in {whose}: {loss}", quiet)
    for letter, side in found.sides:
        for stage, check in side.data.findings:
            console.note(f"{letter}: {check.severity}: {stage}: {check.text}", quiet)
    summary = summary_of(found, asked)
    return console.strict_code(console.finish(summary, (), as_json), summary.get("plausible"), strict)


TABLES = ("tracks", "bearings", "truth", "errors", "bound", "diagnostics", "events", "occluders")
