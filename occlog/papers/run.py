"""What `occlog reproduce` does."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.papers.ercan.recorded import target_of
from occlog.papers.ercan.recorded_figures import recorded_experiments
from occlog.papers.ercan.recorded_files import source_of
from occlog.papers.verdicts.model import Execute, Experiment, Verdict
from occlog.pipeline.sweep.engine import run_all

from .catalogue import PAPERS, RECORDED, TITLES, Finding, choose, reproduce, size_of
from .output import prepare, write, write_page

STORE = "trials.jsonl"
SIZE = re.compile(r"([\w-]+)=(\d+)x(\d+)")


def list_papers(as_json: bool) -> None:
    """Print papers and experiments."""
    if as_json:
        options.echo_summary({p: {e.item: e.title for e in experiments} for p, experiments in PAPERS.items()}, True)
        return
    for paper, experiments in PAPERS.items():
        click.echo(f"{paper}: {TITLES[paper]}")
        for e in experiments:
            click.echo(f"  {e.item:<6} {e.title} ({e.runs} runs of {e.steps} steps)")
        for item in RECORDED.get(paper, ()):
            click.echo(f"  {item} on recorded detections; wants --data, or --bearings and --scene")


def run_reproduce(
    paper: str, items: Sequence[str], everything: bool, output: Path | None, given: Mapping[str, Any]
) -> None:
    """Do the experiments one after the other; what each gave is written as soon as it is there."""
    chosen = choose(paper, items, everything=everything, recorded=recorded_of(paper, given))
    own = sizes_of(given["sizes"], [e.item for e in chosen])
    quiet = bool(given["quiet"])
    if output is not None:
        prepare(output, chosen, given["overwrite"])
    findings: list[Finding] = []
    for e in chosen:
        runs, steps = own.get(e.item, (given["runs"], given["steps"]))
        size = size_of(e, quick=given["quick"], runs=runs, steps=steps, seed=given["seed"])
        options.note(f"{e.item}: {size.runs} runs of {size.steps} steps", quiet)
        finding = reproduce(e, size, executor(e, output, given))
        findings.append(finding)
        if output is not None:
            write(output, finding, given["overwrite"])
        if not given["as_json"]:
            _print(finding.verdicts)
    if output is not None:
        write_page(output, paper, findings, given["overwrite"])
        options.note(f"wrote {output / 'reproduce.html'}", quiet)
    if everything and given["bearings"] is None and given["data"] is None and paper in RECORDED:
        options.note(f"left out: {', '.join(RECORDED[paper])}; they want --data, or --bearings and --scene", quiet)
    if any(finding.size.quick for finding in findings):
        options.note("--quick: too small to judge by; the verdicts say little", quiet)
    if given["as_json"]:
        options.echo_summary({"paper": paper, "items": [f.as_dict() for f in findings]}, True)


def recorded_of(paper: str, given: Mapping[str, Any]) -> tuple[Experiment, ...]:
    """Experiments on the recording that was given; none without one."""
    path: Path | None = given["data"] or given["bearings"]
    _check_recorded(paper, given)
    if path is None:
        return ()
    try:
        source = source_of(given["data"], given["bearings"], given["scene"])
        return recorded_experiments(source, target_of(source))
    except InputError as error:
        told = str(error) if str(path) in str(error) else f"{path}: {error}"
        raise InputError(told) from error


def _check_recorded(paper: str, given: Mapping[str, Any]) -> None:
    """UsageError for options of a recording that do not go together."""
    if given["data"] is not None and (given["bearings"] is not None or given["scene"] is not None):
        raise UsageError("--data has its own bearings and scene; leave --bearings and --scene out")
    if (given["bearings"] is None) != (given["scene"] is None):
        raise UsageError("--scene goes with --bearings; give both")
    option = next((n for n in ("data", "bearings") if given[n] is not None), None)
    if option is not None and paper in PAPERS and paper not in RECORDED:
        raise UsageError(f"{paper} has no experiment on a recording; leave --{option} out")


def sizes_of(given: Sequence[str], items: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Runs and steps of single experiments, from texts like `fig12=4x1000`; UsageError for any other."""
    sizes = {}
    for text in given:
        found = SIZE.fullmatch(text)
        if found is None or int(found[2]) < 2 or int(found[3]) < 10:
            raise UsageError(f"--size {text!r}: give ITEM=RUNSxSTEPS, from 2x10 up, as fig12=4x1000")
        if found[1] not in items:
            raise UsageError(f"--size {text!r}: {found[1]} is not among the experiments to run: {', '.join(items)}")
        sizes[found[1]] = (int(found[2]), int(found[3]))
    return sizes


def executor(experiment: Experiment, output: Path | None, given: Mapping[str, Any]) -> Execute:
    """Runs trials as the options say, with progress on standard error."""

    def execute(specs: list[dict[str, Any]]) -> list[dict[str, float]]:
        store = None if output is None else output / STORE
        told, close = _bar(experiment.item, len(specs), bool(given["quiet"]))
        try:
            return run_all(specs, given["workers"], given["scheduler"], store, told, experiment.trial)
        finally:
            close()

    return execute


def _bar(label: str, total: int, quiet: bool) -> tuple[Callable[[int], None] | None, Callable[[], None]]:
    """A progress bar where standard error is a terminal."""
    import sys

    if quiet or not sys.stderr.isatty():
        return None, lambda: None
    from tqdm import tqdm

    bar = tqdm(desc=label, total=total, file=sys.stderr, leave=False)

    def told(finished: int) -> None:
        bar.update(finished)

    return told, bar.close


def _print(verdicts: Sequence[Verdict]) -> None:
    for v in verdicts:
        said = "" if v.paper is None else f", paper {v.paper:.4g}"
        measured = "nothing" if v.measured is None else f"{v.measured:.4g}"
        error = "" if v.error_bar is None or v.error_bar != v.error_bar else f" ± {v.error_bar:.2g}"
        click.echo(f"{v.verdict:<15} {v.id:<24} {measured}{error}{said}: {v.statement}")
