"""Videos, rows of rates, and comparisons of heavy-tailed means, shared by the experiments on [Qu]."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from occlog.papers import verdicts as v
from occlog.papers.verdicts import PaperRow, Size, StatementVerdict, difference_of
from occlog.pipeline.sweep.trial import Spec

from .trial import views_spec

METHODS = ("mipf", "cmct", "idmot", "bmct")
"""The four methods, from the worst to the best of the paper."""
RATES = {"fr_p": "false positions", "fr_l": "false labels"}
"""The two failure rates: figures of trials, and their names."""
PARTS = 20
"""Parts of equal length of the video, for Fig. 7."""
LITTLE = 1.0
"""Rate [%] below which there is nothing to gain."""
KEPT = ("idf1", "hota", "mota", "frame_ms", "particles", "left", "lost")
"""Figures of trials that tables have also the rates."""


def seed_of(size: Size, run: int) -> int:
    """Seed of the video of a run: the seed of the experiment plus the number of the run plus 1."""
    return size.seed + run + 1


def spec_of(size: Size, run: int, **balls: Any) -> Spec:
    """Specification of a trial of the four methods on the paper's video, or with other balls.

    Args:
        size: number of frames, and the seed of the experiment.
        run: number of the run, which gives the seed of the video.
        **balls: settings of the video that differ from the paper's.
    """
    methods = {m: {"method": m} for m in METHODS}
    return views_spec(seed_of(size, run), methods, {"frames": size.steps, **balls}, parts=PARTS)


def rate_row(
    series: str, x: float, results: Sequence[Mapping[str, float]], label: str, rate: str, *, plotted: bool = True
) -> PaperRow:
    """Row of a table with the rate [%] in every run, its median, and the means of the figures in `KEPT`.

    Args:
        series: name of the row's series.
        x: value of the row along the x axis.
        results: figures of each run by name.
        label: prefix of the method in the names of the figures.
        rate: `fr_p`, the rate of false positions, or `fr_l`, that of false labels.
        plotted: whether the row is in the plot; all rows are in the table.
    """
    values = tuple(100.0 * r[f"{label}.{rate}"] for r in results)
    extra = {"median": float(np.median(values))}
    for name in KEPT:
        given = [r[f"{label}.{name}"] for r in results if not math.isnan(r[f"{label}.{name}"])]
        extra[name] = math.fsum(given) / len(given) if given else math.nan
    each = {"frame_ms": tuple(r[f"{label}.frame_ms"] for r in results)}
    return PaperRow(series, x, values, extra, plotted=plotted, each=each)


def ordered(key: str, statement: str, low: PaperRow, high: PaperRow) -> StatementVerdict:
    """Verdict on whether one mean rate is below another; undecided if both are below `LITTLE`.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        low: row of rates [%] that are to be lower.
        high: row of rates [%] that are to be higher, in the same runs.
    """
    points = [] if high.mean < LITTLE and low.mean < LITTLE else [v.lower(low, high)]
    better = sum(a < b for a, b in zip(low.values, high.values, strict=True))
    worse = sum(a > b for a, b in zip(low.values, high.values, strict=True))
    rule = f"below it by two standard errors, run by run (lower in {better} runs, higher in {worse})"
    left = "" if points else f"; both are below {LITTLE:g} %, so that there is nothing to gain"
    return v.judge_points(key, statement, points, rule=rule + left, shown=difference_of(low, high))


def everywhere(key: str, statement: str, points: Sequence[tuple[PaperRow, PaperRow]]) -> StatementVerdict | None:
    """Verdict on whether one mean is below another at several points; None if nothing can be gained at any of them.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        points: pairs of rows of rates [%], the lower first; those with both means below `LITTLE` are skipped.
    """
    open_ones = [(low, high) for low, high in points if max(low.mean, high.mean) >= LITTLE]
    if not open_ones:
        return None
    left = len(points) - len(open_ones)
    rule = "below it by two standard errors, run by run"
    rule += f" ({left} points skipped, at which there is less than {LITTLE:g} % to gain)" if left else ""
    return v.judge_points(key, statement, [v.lower(low, high) for low, high in open_ones], rule=rule)
