"""Tables of a sweep: a row of figures for every trial, and statistics over the runs of every setting."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit

from .plan import Setting


class Summary(NamedTuple):
    """Statistics of one figure over n runs; NaN where there are too few."""

    n: int
    mean: float
    sd: float  # with n - 1
    se: float  # of the mean
    low: float  # confidence interval of the mean
    high: float


def summarise(values: Sequence[float], confidence: float = 0.95) -> Summary:
    """Summarise a figure over runs, without those in which it is NaN.

    Args:
        values: one for each run.
        confidence: of the interval by Student's t distribution, which holds for means of about normal values.
    """
    good = np.array([v for v in values if not math.isnan(v)], dtype=np.float64)
    n = len(good)
    if n == 0:
        return Summary(0, math.nan, math.nan, math.nan, math.nan, math.nan)
    mean = float(good.mean())
    if n == 1:
        return Summary(1, mean, math.nan, math.nan, math.nan, math.nan)
    sd = float(good.std(ddof=1))
    se = sd / math.sqrt(n)
    reach = float(stdtrit(n - 1, 0.5 + 0.5 * confidence)) * se
    return Summary(n, mean, sd, se, mean - reach, mean + reach)


Row = dict[str, Any]


def trial_rows(settings: Sequence[Setting], results: Sequence[Mapping[str, float]]) -> list[Row]:
    """Make a row for each trial: the varied values, the run and the figures."""
    rows, place = [], 0
    for setting in settings:
        for trial in setting.trials:
            rows.append({**_label(setting), "run": trial["run"], **results[place]})
            place += 1
    return rows


def summary_rows(settings: Sequence[Setting], results: Sequence[Mapping[str, float]]) -> list[Row]:
    """Make a row for each setting and figure: n, mean, sd, se and the 95 % confidence interval of the mean."""
    rows, place = [], 0
    for setting in settings:
        own = results[place : place + len(setting.trials)]
        place += len(setting.trials)
        for name in own[0]:
            found = summarise([result[name] for result in own])
            rows.append({**_label(setting), "figure": name, **found._asdict()})
    return rows


def _label(setting: Setting) -> Row:
    return {
        name: json.dumps(value) if isinstance(value, list | dict) else value for name, value in setting.label.items()
    }


def to_csv(rows: Sequence[Row]) -> bytes:
    """Write rows as CSV with one header, numbers with all their digits."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def to_text(rows: Sequence[Row], figures: Sequence[str]) -> str:
    """Write a table for reading: a line for each setting, mean and half-width of the interval of some figures."""
    lines: dict[tuple[Any, ...], dict[str, str]] = {}
    for row in rows:
        label = {k: v for k, v in row.items() if k not in ("figure", "n", "mean", "sd", "se", "low", "high")}
        line = lines.setdefault(tuple(label.items()), {k: str(v) for k, v in label.items()} | {"runs": str(row["n"])})
        if row["figure"] in figures:
            reach = row["high"] - row["mean"]
            line[row["figure"]] = f"{row['mean']:.4g}" + (f" ± {reach:.2g}" if reach == reach else "")
            line["runs"] = str(max(int(line["runs"]), row["n"]))
    names = list(dict.fromkeys(name for line in lines.values() for name in line))
    table = [names, *([line.get(name, "") for name in names] for line in lines.values())]
    widths = [max(len(row[i]) for row in table) for i in range(len(names))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table)
