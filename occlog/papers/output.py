"""Files of an experiment: its table as CSV, plots as PNG, verdicts as JSON, and one page of all experiments."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path

from occlog.errors import OutputError
from occlog.io.files.atomic import check_writable, translate_write_errors, write_bytes
from occlog.papers.page.reproduction import Chart, Curve, Part, build_reproduction, chart_png, picture_png
from occlog.papers.verdicts.model import EXTRAS, Experiment, Table

from .catalogue import TITLES, Finding

PAGE = "reproduce.html"


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
