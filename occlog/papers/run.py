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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
from tqdm import tqdm

from occlog import console
from occlog.errors import InputError, OutputError, UsageError
from occlog.io.files.atomic import check_writable, translate_write_errors, write_bytes
from occlog.papers.ercan.recorded import cmc_files, files_of, recorded_experiments, target_of
from occlog.papers.page import (
    Chart,
    ChartCurve,
    ExperimentPage,
    Paper,
    build_reproduction,
    build_verdicts,
    chart_png,
    picture_png,
)
from occlog.papers.verdicts import EXTRAS, WORDS, Execute, Experiment, StatementVerdict, Table
from occlog.pipeline.sweep.engine import run_all
from occlog.pipeline.sweep.trial import Spec

from .catalogue import PAPERS, RECORDED, TITLES, ExperimentResult, choose, reproduce, size_of
from .page_provenance import PageProvenance, made_by

STORE = "trials.jsonl"
SIZE = re.compile(r"([\w.-]+)=(\d+)x(\d+)")
PAGE = "reproduce.html"
SUMMARY = ("verdicts.html", "verdicts.json")
"""Files over all papers: the page and the verdicts."""


@dataclass(frozen=True, kw_only=True)
class ReproduceRequest:
    """Request of `occlog reproduce`.

    Attributes:
        paper: key of the paper; None: all papers.
        items: keys of experiments.
        everything: whether all experiments are run.
        quick: whether the small form of experiments is run.
        output: folder of the files; None: nothing is written.
        data, bearings, scene: recording: a folder of the CMC data set, or a file of bearings and one of their scene.
        workers: number of processes.
        scheduler: address of a scheduler of other machines; None: this one alone.
        runs, steps: numbers in place of those of the experiments; None: theirs.
        sizes: texts such as `fig12=4x1000`: runs and steps of one experiment.
        seed: seed of all experiments.
        overwrite: whether files that exist are replaced.
        quiet: whether notes and progress are omitted.
        as_json: whether one JSON object is printed in place of text.
    """

    paper: str | None
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


def list_papers(as_json: bool, only: str | None = None) -> None:
    """Print the experiments of all papers, or of the paper `only`.

    Args:
        as_json: whether to print one JSON object of titles.
        only: key of a paper; None: all.

    Raises:
        UsageError: the paper is unknown.
    """
    if only is not None and only not in PAPERS:
        raise UsageError(f"no experiments of {only!r}; there are those of: {', '.join(PAPERS)}", id="unknown-name")
    papers = {p: experiments for p, experiments in PAPERS.items() if only in (None, p)}
    if as_json:
        console.echo_summary({p: {e.item: e.title for e in experiments} for p, experiments in papers.items()}, True)
        return
    for paper, experiments in papers.items():
        click.echo(f"{paper}: {TITLES[paper]}")
        for e in experiments:
            click.echo(f"  {e.item:<6} {e.title} ({e.runs} runs of {e.steps} steps)")
        for item in RECORDED.get(paper, ()):
            click.echo(f"  {item} on recorded detections; requires --data, or --bearings and --scene")


def run_reproduce(request: ReproduceRequest) -> None:
    """Run the experiments of a paper, or of all papers; write files if the request has a folder, print the verdicts."""
    if request.paper is None:
        _run_papers(request)
        return
    findings = _run_paper(request.paper, request, request.output)
    if any(finding.size.quick for finding in findings):
        console.note("--quick: too small to judge by; most verdicts are not decided", request.quiet)
    counts = counts_of(findings)
    if request.as_json:
        items = [f.as_dict() for f in findings]
        made = _made(request.paper, request).as_dict()
        console.echo_summary({"paper": request.paper, "items": items, "counts": counts, "made": made}, True)
    else:
        click.echo(", ".join(f"{n} {word}" for word, n in counts.items()))


def _run_papers(request: ReproduceRequest) -> None:
    """Run all experiments of all papers, each paper in its own folder; write and print the numbers of verdicts.

    Raises:
        UsageError: the request names neither a paper nor all, or it has sizes of single experiments.
    """
    if not request.everything:
        raise UsageError("name a paper, or give --all or --list", id="missing-option")
    if request.sizes:
        raise UsageError("--size requires a paper, as several have an experiment of the same name", id="missing-option")
    output = request.output
    if output is not None:
        _make_folder(output)
        for name in SUMMARY:
            check_writable(output / name, request.overwrite)
    found: dict[str, list[ExperimentResult]] = {}
    for paper in PAPERS:
        # Only the papers with experiments on recordings take one
        own = request if paper in RECORDED else replace(request, data=None, bearings=None, scene=None)
        found[paper] = _run_paper(paper, own, None if output is None else output / paper)
    totals = {paper: counts_of(findings) for paper, findings in found.items()}
    totals["all papers"] = counts_of([f for findings in found.values() for f in findings])
    made = _made(None, request)
    summary: dict[str, object] = {
        "papers": {p: {"title": TITLES[p], "items": [f.as_dict() for f in own]} for p, own in found.items()},
        "counts": totals,
        "made": made.as_dict(),
    }
    if output is not None:
        papers = {p: Paper(TITLES[p], [v.as_dict() for f in own for v in f.verdicts]) for p, own in found.items()}
        page = build_verdicts(papers, totals, PAGE, made.text())
        text = json.dumps(summary, indent=2, sort_keys=True) + "\n"
        for name, content in zip(SUMMARY, (page, text), strict=True):
            write_bytes(output / name, content.encode(), request.overwrite)
        console.note(f"wrote {output / SUMMARY[0]}", request.quiet)
    if request.as_json:
        console.echo_summary(summary, True)
    else:
        _print_totals(totals)


def _print_totals(totals: Mapping[str, Mapping[str, int]]) -> None:
    """Print a table of the number of verdicts by word (columns), for each paper and for all."""
    click.echo(f"{'':<11}" + "".join(f"{word:>16}" for word in WORDS))
    for name, counts in totals.items():
        click.echo(f"{name:<11}" + "".join(f"{counts[word]:>16}" for word in WORDS))


def counts_of(findings: Sequence[ExperimentResult]) -> dict[str, int]:
    """Number of statements by the word of their verdict."""
    return {word: sum(v.verdict == word for f in findings for v in f.verdicts) for word in WORDS}


def _made(paper: str | None, request: ReproduceRequest) -> PageProvenance:
    """Provenance of a page: the command with the options that change its results.

    `paper`: key of the paper; None: all papers.
    """
    words = ["reproduce", *([paper] if paper else []), *(["--all"] if request.everything else request.items)]
    words += ["--quick"] if request.quick else []
    for name, value in (("runs", request.runs), ("steps", request.steps)):
        words += [] if value is None else [f"--{name}", str(value)]
    for size in request.sizes:
        words += ["--size", size]
    for name, path in (("data", request.data), ("bearings", request.bearings), ("scene", request.scene)):
        words += [] if path is None else [f"--{name}", path.name]
    return made_by([*words, "--seed", str(request.seed)], request.seed)


def _run_paper(paper: str, request: ReproduceRequest, output: Path | None) -> list[ExperimentResult]:
    """Run the experiments of a paper one after the other; the files of each are written as soon as it is done.

    A folder with finished trials and without a page is that of a run that was stopped: what it has written of single
    experiments is replaced. `output`: folder of the files; None: nothing is written.
    """
    recorded = recorded_of(paper, request)
    _check_names(paper, request, recorded)
    chosen = choose(paper, request.items, everything=request.everything, recorded=recorded)
    own = sizes_of(request.sizes, [e.item for e in chosen])
    overwrite = request.overwrite
    if output is not None:
        overwrite = overwrite or was_stopped(output)
        prepare(output, chosen, overwrite)
    made = _made(paper, request)
    findings: list[ExperimentResult] = []
    for e in chosen:
        runs, steps = own.get(e.item, (request.runs, request.steps))
        size = size_of(e, quick=request.quick, runs=runs, steps=steps, seed=request.seed)
        console.note(f"{paper} {e.item}: {size.runs} runs of {size.steps} steps", request.quiet)
        finding = reproduce(paper, e, size, executor(e, request, output))
        findings.append(finding)
        if output is not None:
            write(output, paper, finding, overwrite, made)
        if not request.as_json:
            _print(finding.verdicts)
    if output is not None:
        write_page(output, paper, findings, overwrite, made)
        console.note(f"wrote {output / PAGE}", request.quiet)
    if request.everything and not recorded and paper in RECORDED:
        left = ", ".join(RECORDED[paper])
        console.note(f"skipped: {left}; they require --data, or --bearings and --scene", request.quiet)
    return findings


def was_stopped(folder: Path) -> bool:
    """Whether a folder is that of a run that was stopped: it has finished trials, and no page."""
    return (folder / STORE).is_file() and not (folder / PAGE).exists()


def recorded_of(paper: str, request: ReproduceRequest) -> tuple[Experiment, ...]:
    """Experiments on the recording of the request; none without one.

    Raises:
        UsageError: options do not go together.
        InputError: the recording cannot be used; the message names it.
    """
    _check_recorded(paper, request)
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


def _check_recorded(paper: str, request: ReproduceRequest) -> None:
    """Raise UsageError for options of a recording that do not go together, or that the paper has no experiment for."""
    if request.data is not None and (request.bearings is not None or request.scene is not None):
        raise UsageError(
            "--data has its own bearings and scene; leave --bearings and --scene out", id="conflicting-options"
        )
    if (request.bearings is None) != (request.scene is None):
        raise UsageError("--scene goes with --bearings; give both", id="missing-option")
    option = "data" if request.data is not None else "bearings" if request.bearings is not None else None
    if option is not None and paper in PAPERS and paper not in RECORDED:
        raise UsageError(f"{paper} has no experiment on a recording; leave --{option} out", id="not-applicable")


def _check_names(paper: str, request: ReproduceRequest, recorded: Sequence[Experiment]) -> None:
    """Raise UsageError if no experiment is named, or one on a recording that was not given.

    `recorded`: experiments on the given recording.
    """
    if paper not in PAPERS:
        return
    wanting = [item for item in request.items if item in RECORDED.get(paper, ()) and not recorded]
    if wanting:
        raise UsageError(
            f"{wanting[0]} requires a recording; give --data DIR, or --bearings and --scene", id="missing-option"
        )
    if not request.items and not request.everything:
        known = ", ".join(e.item for e in (*PAPERS[paper], *recorded))
        raise UsageError(f"name an experiment of {paper} ({known}), or give --all", id="missing-option")


def sizes_of(given: Sequence[str], items: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Runs and steps by experiment, from texts like `fig12=4x1000`.

    Args:
        given: the texts.
        items: keys of the experiments that may be named.

    Raises:
        UsageError: a text has another form, too small a number, or names another experiment.
    """
    sizes = {}
    for text in given:
        found = SIZE.fullmatch(text)
        if found is None or int(found[2]) < 2 or int(found[3]) < 10:
            raise UsageError(f"--size {text!r}: give ITEM=RUNSxSTEPS, from 2x10 up, as fig12=4x1000")
        if found[1] not in items:
            raise UsageError(
                f"--size {text!r}: {found[1]} is not among the experiments to run: {', '.join(items)}",
                id="unknown-name",
            )
        sizes[found[1]] = (int(found[2]), int(found[3]))
    return sizes


def executor(experiment: Experiment, request: ReproduceRequest, output: Path | None) -> Execute:
    """Function that runs the trials of an experiment, with progress on standard error.

    `output`: folder where finished trials are kept; None: they are not.
    """
    store = None if output is None else output / STORE

    def execute(specs: Sequence[Spec]) -> list[dict[str, float]]:
        advance, close = _bar(experiment.item, len(specs), request.quiet)
        try:
            return run_all(specs, request.workers, request.scheduler, store, advance, experiment.trial)
        finally:
            close()

    return execute


def _bar(label: str, total: int, quiet: bool) -> tuple[Callable[[int], None] | None, Callable[[], None]]:
    """Functions that advance (by a number of trials) and close a progress bar on standard error.

    The first is None if there is no bar: `quiet` is set, or standard error is no terminal.

    Args:
        label: text before the bar.
        total: number of trials at its end.
        quiet: whether there is no bar.
    """
    if quiet or not sys.stderr.isatty():
        return None, lambda: None
    bar = tqdm(desc=label, total=total, file=sys.stderr, leave=False)

    def advance(finished: int) -> None:
        bar.update(finished)

    return advance, bar.close


def _print(verdicts: Sequence[StatementVerdict]) -> None:
    """Print a line for each verdict: word, id, measured and printed number, statement."""
    for v in verdicts:
        paper = "" if v.paper is None else f", paper {v.paper:.4g}"
        measured = "nothing" if v.measured is None else f"{v.measured:.4g}"
        error = "" if not v.error_bar or math.isnan(v.error_bar) else f" ± {v.error_bar:.2g}"
        click.echo(f"{v.verdict:<15} {v.id:<24} {measured}{error}{paper}: {v.statement}")


def paths(folder: Path, experiments: Sequence[Experiment]) -> list[Path]:
    """Paths of all files that the experiments write into the folder, the page included."""
    out = [folder / f"{e.item}{kind}" for e in experiments for kind in (".csv", ".png", ".json")]
    return out + [plan_path(folder, e, name) for e in experiments for name in e.plans] + [folder / PAGE]


def plan_path(folder: Path, experiment: Experiment, name: str) -> Path:
    """Path of a further picture of an experiment, with the name `name`."""
    return folder / f"{experiment.item}-{name}.png"


def prepare(folder: Path, experiments: Sequence[Experiment], overwrite: bool) -> None:
    """Create the folder and check that every file can be written, before any experiment runs.

    Args:
        folder: folder of the files.
        experiments: experiments to be run.
        overwrite: whether files may exist.
    """
    _make_folder(folder)
    for path in paths(folder, experiments):
        check_writable(path, overwrite)


def _make_folder(folder: Path) -> None:
    """Create a folder, with those it is in; OutputError if it is a file or cannot be created."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; name a folder")
    with translate_write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)


def write(folder: Path, paper: str, finding: ExperimentResult, overwrite: bool, made: PageProvenance) -> None:
    """Write table, plot, further pictures and verdicts of one experiment.

    Args:
        folder: folder of the files.
        paper: key of the paper.
        finding: result of the experiment.
        overwrite: whether files that exist are replaced.
        made: provenance.
    """
    item = finding.experiment.item
    write_bytes(folder / f"{item}.csv", table_csv(finding.table).encode(), overwrite)
    write_bytes(folder / f"{item}.png", chart_png(chart(finding)), overwrite)
    for name, plan in finding.plans.items():
        write_bytes(plan_path(folder, finding.experiment, name), picture_png(plan), overwrite)
    verdicts = {"paper": paper, **finding.as_dict(), "made": made.as_dict()}
    text = json.dumps(verdicts, indent=2, sort_keys=True) + "\n"
    write_bytes(folder / f"{item}.json", text.encode(), overwrite)


def write_page(
    folder: Path, paper: str, findings: Sequence[ExperimentResult], overwrite: bool, made: PageProvenance
) -> None:
    """Write the HTML page of all experiments of a paper.

    Args:
        folder: folder of the page.
        paper: key of the paper.
        findings: results of the experiments.
        overwrite: whether a page that exists is replaced.
        made: provenance.
    """
    parts = [
        ExperimentPage(chart(f), _size(f), [x.as_dict() for x in f.verdicts], _cells(f.table), f.plans)
        for f in findings
    ]
    write_bytes(folder / PAGE, build_reproduction(TITLES[paper], parts, made.text()).encode(), overwrite)


def table_csv(table: Table) -> str:
    """Table as CSV: series, x, runs, mean, standard deviation, standard error, further figures, values."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows(_cells(table))
    return out.getvalue()


def _cells(table: Table) -> list[list[str]]:
    """Cells of a table as text, the heads in the first row."""
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
    """Number with six digits; empty for NaN."""
    return "" if math.isnan(value) else f"{value:.6g}"


def chart(finding: ExperimentResult) -> Chart:
    """Content of the plot: a curve for each plotted series, by rising x; rows without x are lines across."""
    e, curves = finding.experiment, []
    for name in dict.fromkeys(r.series for r in finding.table if r.plotted):
        own = [r for r in finding.table if r.series == name and r.runs and r.plotted]
        across = [r.mean for r in own if math.isnan(r.x)]
        rows = sorted((r for r in own if not math.isnan(r.x)), key=lambda r: r.x)
        if own:
            curves.append(
                ChartCurve(
                    name, x=[r.x for r in rows], y=[r.mean for r in rows], sd=[r.sd for r in rows], across=across
                )
            )
    return Chart(item=e.item, title=e.title, x_label=e.x_label, y_label=e.y_label, curves=curves, note=e.note)


def _size(finding: ExperimentResult) -> str:
    """Sentence for the page on the size of an experiment, compared with its full form."""
    size, e = finding.size, finding.experiment
    if (size.runs, size.steps) == (e.runs, e.steps):
        return f"{size.runs} runs of {size.steps} steps, the full form."
    quick = " A quick run: too small to judge by." if size.quick else ""
    return f"{size.runs} runs of {size.steps} steps; the full form has {e.runs} of {e.steps}.{quick}"
