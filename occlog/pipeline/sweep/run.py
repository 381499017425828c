"""`occlog sweep`: plan the trials, run them, and write the tables.

One table has the figures of every trial, another statistics over the runs of every setting.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import click
import msgspec
import numpy as np
from scipy.special import stdtrit

from occlog import __version__, console
from occlog.console.notes import begin_work, note_files
from occlog.errors import ExitCode, OutputError, OutputExistsError, UsageError, option
from occlog.io.files.atomic import alone_with, translate_write_errors, write_bytes
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import installed_versions
from occlog.io.files.texts.documents import read_json, write_json
from occlog.pipeline.csv_text import to_csv
from occlog.pipeline.progress import shown_progress

from .engine import TrialError, run_all
from .plan import Setting, check_values, read_sweep, settings_of

CONFIDENCE = 0.95
"""Probability of the intervals of means."""
STORE = "trials.jsonl"
MADE = "sweep.json"
RESULTS = ("trials.csv", "summary.csv", "timings.csv")
TIMINGS = ("track_seconds",)
"""Figures that differ from run to run; the other files of a sweep have the same bytes each time."""
Row = dict[str, object]


def run_sweep(
    path: Path,
    folder: Path,
    *,
    workers: int,
    scheduler: str | None,
    jobs: Mapping[str, str],
    figures: tuple[str, ...],
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run all trials of a sweep file and write the tables; return the exit code.

    Args:
        path: sweep file.
        folder: folder of the results.
        workers: number of local processes.
        scheduler: address or name of a cluster to use instead; None: local processes.
        jobs: settings of jobs, for schedulers that run jobs.
        figures: names of the figures in the printed table.
        overwrite: replace another sweep in the folder.
        quiet: no progress bar.
        as_json: print JSON.
    """
    spec = read_sweep(path)
    settings = settings_of(path, spec)
    check_values(path, spec, settings)
    trials = [trial for setting in settings for trial in setting.trials]
    made = {
        "program": "occlog",
        "version": __version__,
        "versions": installed_versions(),
        "sweep": msgspec.to_builtins(spec),
        "inputs": [list(i) for i in hash_inputs([path, path.parent / spec.scene])],
    }
    note_files([path, path.parent / spec.scene], [folder])
    begin_work()
    _make(folder)
    with alone_with(folder, "sweep"):
        _prepare(folder, made, overwrite)
        with shown_progress("sweep", "trial", len(trials), quiet) as progress:
            try:
                results = run_all(trials, workers, scheduler, folder / STORE, progress, jobs=jobs)
            except TrialError as error:
                raise TrialError(f"{path}: scene {spec.scene}: {error}") from error
        unknown = [name for name in figures if name not in results[0]]
        summary = summary_rows(settings, results)
        rows = [row.as_row() for row in summary if row.figure not in TIMINGS]
        figures_of = [{k: v for k, v in result.items() if k not in TIMINGS} for result in results]
        times_of = [{k: result[k] for k in TIMINGS} for result in results]
        write_bytes(folder / "trials.csv", to_csv(trial_rows(settings, figures_of)), overwrite=True)
        write_bytes(folder / "summary.csv", to_csv(rows), overwrite=True)
        write_bytes(folder / "timings.csv", to_csv(trial_rows(settings, times_of)), overwrite=True)
    if unknown:
        raise UsageError(
            f"{option('figures')}: no figure {unknown[0]!r}; there are: {', '.join(results[0])}", id="unknown-name"
        )
    if as_json:
        console.echo_summary({"sweep": str(folder), "trials": len(trials), "settings": rows}, as_json=True)
    else:
        click.echo(to_text(summary, figures))
        click.echo(f"\n{len(trials)} trials; {folder / 'trials.csv'}, {folder / 'summary.csv'}")
    return ExitCode.DONE


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error


def _prepare(folder: Path, made: dict[str, object], overwrite: bool) -> None:
    """Make the folder ready for a sweep.

    OutputExistsError if it has another one, unless `overwrite` removes its results. `made`: what identifies the sweep,
    written into the folder.
    """
    marker = folder / MADE
    if marker.exists() and msgspec.json.decode(msgspec.json.encode(read_json(marker))) == msgspec.to_builtins(made):
        return
    if any((folder / name).exists() for name in (MADE, STORE, *RESULTS)) and not overwrite:
        raise OutputExistsError(f"{folder}: holds another sweep; give another folder")
    for name in (STORE, *RESULTS):
        with translate_write_errors(folder / name):
            (folder / name).unlink(missing_ok=True)
    write_json(marker, made, overwrite=True)


class Summary(NamedTuple):
    """Statistics of one figure over n runs; NaN with too few runs.

    `sd`: standard deviation (n - 1); `se`: standard error of the mean; `low`, `high`: 95 % confidence interval of the
    mean.
    """

    n: int
    mean: float
    sd: float  # with n - 1
    se: float  # of the mean
    low: float  # confidence interval of the mean
    high: float


class SummaryRow(NamedTuple):
    """Statistics of one figure over the runs of one setting.

    Attributes:
        label: the varied values by name.
        figure: name of the figure.
        summary: statistics over the runs.
    """

    label: Row  # the varied values by name
    figure: str
    summary: Summary

    def as_row(self) -> Row:
        """Return the row as it is written to `summary.csv`: varied values, figure, statistics, by column."""
        return {**self.label, "figure": self.figure, **self.summary._asdict()}


def summarise(values: Sequence[float]) -> Summary:
    """Return statistics of one figure over runs; NaN values are omitted.

    The 95 % confidence interval of the mean is that of Student's t distribution, for approximately normal values.

    Args:
        values: one for each run.
    """
    good = np.array([v for v in values if not math.isnan(v)], dtype=np.float64)
    n = len(good)
    if n == 0:
        return Summary(n=0, mean=math.nan, sd=math.nan, se=math.nan, low=math.nan, high=math.nan)
    mean = float(good.mean())
    if n == 1:
        return Summary(n=1, mean=mean, sd=math.nan, se=math.nan, low=math.nan, high=math.nan)
    sd = float(good.std(ddof=1))
    se = sd / math.sqrt(n)
    reach = float(stdtrit(n - 1, 0.5 + 0.5 * CONFIDENCE)) * se
    return Summary(n=n, mean=mean, sd=sd, se=se, low=mean - reach, high=mean + reach)


def trial_rows(settings: Sequence[Setting], results: Sequence[Mapping[str, float]]) -> list[Row]:
    """Return a table row for each trial: values of the varied settings, number of the run, and metrics.

    `results`: metrics of all trials; those of the runs of a combination of settings follow each other.
    """
    rows, index = [], 0
    for setting in settings:
        for trial in setting.trials:
            rows.append({**_label(setting), "run": trial["run"], **results[index]})
            index += 1
    return rows


def summary_rows(settings: Sequence[Setting], results: Sequence[Mapping[str, float]]) -> list[SummaryRow]:
    """Return a row for each setting and figure: n, mean, sd, se and 95 % confidence interval of the mean.

    `results`: figures of all trials, in the order of the settings and their runs.
    """
    rows: list[SummaryRow] = []
    index = 0
    for setting in settings:
        own = results[index : index + len(setting.trials)]
        index += len(setting.trials)
        rows += [SummaryRow(_label(setting), name, summarise([result[name] for result in own])) for name in own[0]]
    return rows


def _label(setting: Setting) -> Row:
    return {
        name: json.dumps(value) if isinstance(value, list | dict) else value for name, value in setting.label.items()
    }


def to_text(rows: Sequence[SummaryRow], figures: Sequence[str]) -> str:
    """Return a table as text: a line for each setting, with mean and half-width of the 95 % interval of each figure.

    `figures`: names of the figures to show.
    """
    lines: dict[tuple[object, ...], dict[str, str]] = {}
    for row in rows:
        label, found = {k: str(v) for k, v in row.label.items()}, row.summary
        line = lines.setdefault(tuple(row.label.items()), label | {"runs": str(found.n)})
        if row.figure in figures:
            reach = found.high - found.mean
            line[row.figure] = f"{found.mean:.4g}" + ("" if math.isnan(reach) else f" ± {reach:.2g}")
            line["runs"] = str(max(int(line["runs"]), found.n))
    names = list(dict.fromkeys(name for line in lines.values() for name in line))
    table = [names, *([line.get(name, "") for name in names] for line in lines.values())]
    widths = [max(len(row[i]) for row in table) for i in range(len(names))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table)
