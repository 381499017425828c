"""The `occlog reproduce` command."""

from __future__ import annotations

from typing import Any

import click

from occlog.cli import options
from occlog.errors import ExitCode


@click.command(name="reproduce", short_help="Reproduce the experiments of a paper and judge its statements.")
@click.argument("paper", required=False)
@click.argument("items", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="All experiments of the paper; without a paper, of all papers.")
@click.option("--list", "listing", is_flag=True, help="Name the experiments of the paper, or of all papers, and stop.")
@click.option("--quick", is_flag=True, help="Small version: few runs of few steps; most verdicts are not decided.")
@click.option(
    "-o",
    "--output",
    type=options.PATH,
    default=None,
    metavar="DIR",
    help="Folder for tables (CSV), plots (PNG), verdicts (JSON) and one page (HTML).",
)
@click.option(
    "--data",
    type=options.PATH,
    default=None,
    metavar="DIR",
    help="Folder of cmc_detections as shipped, for the experiments on recorded detections.",
)
@click.option(
    "--bearings",
    type=options.INPUT,
    default=None,
    help="Bearings for the experiments on recorded detections, instead of --data; give --scene too.",
)
@click.option(
    "--scene", type=options.INPUT, default=None, help="Scene (YAML or a recording) with the cameras of --bearings."
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Number of processes on this machine; results do not depend on it.",
)
@click.option(
    "--scheduler", default=None, metavar="ADDRESS", help="Use the workers of this Dask scheduler instead of --workers."
)
@click.option("--runs", type=click.IntRange(min=2), default=None, help="Runs per point. [default: those of the paper]")
@click.option("--steps", type=click.IntRange(min=10), default=None, help="Steps per run. [default: those of the paper]")
@click.option(
    "--size",
    "sizes",
    multiple=True,
    metavar="ITEM=RUNSxSTEPS",
    help="Runs and steps of one experiment, as fig12=4x1000; may be repeated.",
)
@options.seed_opt
@options.overwrite_opt
@options.quiet_opt
@options.json_opt
def command(paper: str | None, listing: bool, as_json: bool, **given: Any) -> int:
    """Reproduce the experiments ITEMS of PAPER, and judge its statements.

    Each statement gets a verdict: reproduced, in part, not reproduced, or not decided if the error bar is too
    large; with its location and words in the paper, the measured value, its standard error and the number of runs.
    With -o, finished trials are kept in DIR/trials.jsonl, and a stopped run resumes from there. Without a paper,
    --all runs all papers, each in its own folder in DIR, and counts the verdicts.

    \b
      occlog reproduce --list
      occlog reproduce ercan fig6 --quick -o out/
      occlog reproduce ercan --all --workers 8 -o reproduced/
      occlog reproduce --all --workers 8 -o papers/
      occlog reproduce ercan fig14-recorded --data cmc_detections/ -o recorded/
    """
    from .run import ReproduceRequest, list_papers, run_reproduce

    if listing:
        list_papers(as_json, paper)
        return ExitCode.DONE
    run_reproduce(ReproduceRequest(paper=paper, as_json=as_json, **given))
    return ExitCode.DONE
