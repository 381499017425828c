"""Work of `occlog reproduce`: choose experiments, run their trials, write and print what they gave.

Each experiment gets a table (CSV), plots (PNG) and verdicts (JSON); all of them get one page.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
from tqdm import tqdm

from occlog.cli import options
from occlog.errors import InputError, OutputError, UsageError
from occlog.io.files.atomic import check_writable, translate_write_errors, write_bytes
from occlog.papers.ercan.recorded import cmc_files, files_of, target_of
from occlog.papers.ercan.recorded_figures import recorded_experiments
from occlog.papers.page.reproduction import Chart, Curve, Part, build_reproduction, chart_png, picture_png
from occlog.papers.verdicts.model import EXTRAS, Execute, Experiment, Table, Verdict
from occlog.pipeline.sweep.engine import run_all
from occlog.pipeline.sweep.trial import Spec

from .catalogue import PAPERS, RECORDED, TITLES, Finding, choose, reproduce, size_of

STORE = "trials.jsonl"
SIZE = re.compile(r"([\w.-]+)=(\d+)x(\d+)")
PAGE = "reproduce.html"


@dataclass(frozen=True, kw_only=True)
class ReproduceRequest:
    """Request of the command line; the help of the options describes each field."""

    paper: str
    items: Sequence[str]
    everything: bool
    quick: bool
    output: Path | None
    data: Path | None
    bearings: Path | None
    scene: Path | None
    workers: int
    scheduler: str | None
    runs: int | None
    steps: int | None
    sizes: Sequence[str]
    seed: int
    overwrite: bool
    quiet: bool
    as_json: bool


def list_papers(as_json: bool) -> None:
    """Print all papers and their experiments."""
    if as_json:
        options.echo_summary({p: {e.item: e.title for e in experiments} for p, experiments in PAPERS.items()}, True)
        return
    for paper, experiments in PAPERS.items():
        click.echo(f"{paper}: {TITLES[paper]}")
        for e in experiments:
            click.echo(f"  {e.item:<6} {e.title} ({e.runs} runs of {e.steps} steps)")
        for item in RECORDED.get(paper, ()):
            click.echo(f"  {item} on recorded detections; wants --data, or --bearings and --scene")


def run_reproduce(request: ReproduceRequest) -> None:
    """Run the experiments one after the other; the files of each are written as soon as it is done."""
    paper, output = request.paper, request.output
    recorded = recorded_of(request)
    _check_names(request, recorded)
    chosen = choose(paper, request.items, everything=request.everything, recorded=recorded)
    own = sizes_of(request.sizes, [e.item for e in chosen])
    if output is not None:
        prepare(output, chosen, request.overwrite)
    findings: list[Finding] = []
    for e in chosen:
        runs, steps = own.get(e.item, (request.runs, request.steps))
        size = size_of(e, quick=request.quick, runs=runs, steps=steps, seed=request.seed)
        options.note(f"{e.item}: {size.runs} runs of {size.steps} steps", request.quiet)
        finding = reproduce(paper, e, size, executor(e, request))
        findings.append(finding)
        if output is not None:
            write(output, finding, request.overwrite)
        if not request.as_json:
            _print(finding.verdicts)
    if output is not None:
        write_page(output, paper, findings, request.overwrite)
        options.note(f"wrote {output / 'reproduce.html'}", request.quiet)
    if request.everything and not recorded and paper in RECORDED:
        left = ", ".join(RECORDED[paper])
        options.note(f"left out: {left}; they want --data, or --bearings and --scene", request.quiet)
    if any(finding.size.quick for finding in findings):
        options.note("--quick: too small to judge by; the verdicts say little", request.quiet)
    if request.as_json:
        options.echo_summary({"paper": paper, "items": [f.as_dict() for f in findings]}, True)


def recorded_of(request: ReproduceRequest) -> tuple[Experiment, ...]:
    """Experiments on the recording that was given; none without one."""
    _check_recorded(request)
    path = request.data or request.bearings
    try:
        if request.data is not None:
            source = cmc_files(request.data)
        elif request.bearings is not None and request.scene is not None:
            source = files_of(request.bearings, request.scene)
        else:
            return ()
        return recorded_experiments(source, target_of(source))
    except InputError as error:
        message = str(error) if str(path) in str(error) else f"{path}: {error}"
        raise InputError(message) from error


def _check_recorded(request: ReproduceRequest) -> None:
    """Raise UsageError for options of a recording that do not go together."""
    if request.data is not None and (request.bearings is not None or request.scene is not None):
        raise UsageError("--data has its own bearings and scene; leave --bearings and --scene out")
    if (request.bearings is None) != (request.scene is None):
        raise UsageError("--scene goes with --bearings; give both")
    option = "data" if request.data is not None else "bearings" if request.bearings is not None else None
    if option is not None and request.paper in PAPERS and request.paper not in RECORDED:
        raise UsageError(f"{request.paper} has no experiment on a recording; leave --{option} out")


def _check_names(request: ReproduceRequest, recorded: Sequence[Experiment]) -> None:
    """Raise UsageError for a missing choice, and for experiments on a recording that was not given."""
    paper = request.paper
    if paper not in PAPERS:
        return
    wanting = [item for item in request.items if item in RECORDED.get(paper, ()) and not recorded]
    if wanting:
        raise UsageError(f"{wanting[0]} wants a recording; give --data DIR, or --bearings and --scene")
    if not request.items and not request.everything:
        known = ", ".join(e.item for e in (*PAPERS[paper], *recorded))
        raise UsageError(f"name an experiment of {paper} ({known}), or give --all")


def sizes_of(given: Sequence[str], items: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Runs and steps of single experiments, read from texts like `fig12=4x1000`; UsageError for other texts."""
    sizes = {}
    for text in given:
        found = SIZE.fullmatch(text)
        if found is None or int(found[2]) < 2 or int(found[3]) < 10:
            raise UsageError(f"--size {text!r}: give ITEM=RUNSxSTEPS, from 2x10 up, as fig12=4x1000")
        if found[1] not in items:
            raise UsageError(f"--size {text!r}: {found[1]} is not among the experiments to run: {', '.join(items)}")
        sizes[found[1]] = (int(found[2]), int(found[3]))
    return sizes


def executor(experiment: Experiment, request: ReproduceRequest) -> Execute:
    """Return what runs the trials of an experiment as the options say, with progress on standard error."""
    store = None if request.output is None else request.output / STORE

    def execute(specs: Sequence[Spec]) -> list[dict[str, float]]:
        advance, close = _bar(experiment.item, len(specs), request.quiet)
        try:
            return run_all(specs, request.workers, request.scheduler, store, advance, experiment.trial)
        finally:
            close()

    return execute


def _bar(label: str, total: int, quiet: bool) -> tuple[Callable[[int], None] | None, Callable[[], None]]:
    """Make a progress bar where standard error is a terminal; return what advances it and what closes it."""
    if quiet or not sys.stderr.isatty():
        return None, lambda: None
    bar = tqdm(desc=label, total=total, file=sys.stderr, leave=False)

    def advance(finished: int) -> None:
        bar.update(finished)

    return advance, bar.close


def _print(verdicts: Sequence[Verdict]) -> None:
    for v in verdicts:
        paper = "" if v.paper is None else f", paper {v.paper:.4g}"
        measured = "nothing" if v.measured is None else f"{v.measured:.4g}"
        error = "" if v.error_bar is None or math.isnan(v.error_bar) else f" ± {v.error_bar:.2g}"
        click.echo(f"{v.verdict:<15} {v.id:<24} {measured}{error}{paper}: {v.statement}")


def paths(folder: Path, experiments: Sequence[Experiment]) -> list[Path]:
    """Return all files that the experiments write into the folder."""
    out = [folder / f"{e.item}{kind}" for e in experiments for kind in (".csv", ".png", ".json")]
    return out + [plan_path(folder, e, name) for e in experiments for name in e.plans] + [folder / PAGE]


def plan_path(folder: Path, experiment: Experiment, name: str) -> Path:
    """Return the file of a floor plan, or of frames."""
    return folder / f"{experiment.item}-{name}.png"


def prepare(folder: Path, experiments: Sequence[Experiment], overwrite: bool) -> None:
    """Make the folder and check that every file can be written, before any experiment runs."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; name a folder")
    with translate_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for path in paths(folder, experiments):
        check_writable(path, overwrite)


def write(folder: Path, finding: Finding, overwrite: bool) -> None:
    """Write table, plot, further pictures and verdicts of one experiment."""
    item = finding.experiment.item
    write_bytes(folder / f"{item}.csv", table_csv(finding.table).encode(), overwrite)
    write_bytes(folder / f"{item}.png", chart_png(chart(finding)), overwrite)
    for name, plan in finding.plans.items():
        write_bytes(plan_path(folder, finding.experiment, name), picture_png(plan), overwrite)
    text = json.dumps(finding.as_dict(), indent=2, sort_keys=True) + "\n"
    write_bytes(folder / f"{item}.json", text.encode(), overwrite)


def write_page(folder: Path, paper: str, findings: Sequence[Finding], overwrite: bool) -> None:
    """Write the page of all experiments."""
    parts = [Part(chart(f), _size(f), [x.as_dict() for x in f.verdicts], _cells(f.table), f.plans) for f in findings]
    write_bytes(folder / PAGE, build_reproduction(TITLES[paper], parts).encode(), overwrite)


def table_csv(table: Table) -> str:
    """Return the table as CSV: series, x, runs, mean, standard deviation, standard error, further figures, values."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows(_cells(table))
    return out.getvalue()


def _cells(table: Table) -> list[list[str]]:
    further = [n for n in EXTRAS if any(n in r.extra for r in table)]
    further += sorted({n for r in table for n in r.extra} - set(EXTRAS))
    head = ["series", "x", "runs", "mean", "sd", "standard_error", *further, "values"]
    rows = [
        [
            r.series,
            _text(r.x),
            str(r.runs),
            *map(_text, (r.mean, r.sd, r.error)),
            *(_text(r.extra.get(n, math.nan)) for n in further),
            " ".join(_text(v) for v in r.values),
        ]
        for r in table
    ]
    return [head, *rows]


def _text(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6g}"


def chart(finding: Finding) -> Chart:
    """Return the plot's content: a curve for each plotted series, by rising x; rows without x are lines across."""
    e, curves = finding.experiment, []
    for name in dict.fromkeys(r.series for r in finding.table if r.plotted):
        own = [r for r in finding.table if r.series == name and r.runs and r.plotted]
        across = [r.mean for r in own if math.isnan(r.x)]
        rows = sorted((r for r in own if not math.isnan(r.x)), key=lambda r: r.x)
        if own:
            curves.append(
                Curve(name, x=[r.x for r in rows], y=[r.mean for r in rows], sd=[r.sd for r in rows], across=across)
            )
    return Chart(item=e.item, title=e.title, x_label=e.x_label, y_label=e.y_label, curves=curves, note=e.note)


def _size(finding: Finding) -> str:
    size, e = finding.size, finding.experiment
    if (size.runs, size.steps) == (e.runs, e.steps):
        return f"{size.runs} runs of {size.steps} steps, the full form."
    quick = " A quick look: too small to judge by." if size.quick else ""
    return f"{size.runs} runs of {size.steps} steps; the full form has {e.runs} of {e.steps}.{quick}"
