"""Videos, rows of rates, and comparisons of heavy-tailed means, shared by the experiments on [Qu]."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from occlog.array_types import Floats
from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.model import Row, Size, Verdict
from occlog.pipeline.sweep.trial import Spec

from .trial import views_spec

METHODS = ("mipf", "cmct", "idmot", "bmct")
"""The four methods, from the worst to the best of the paper."""
RATES = {"fr_p": "false positions", "fr_l": "false labels"}
"""The two failure rates: figures of trials, and their names."""
PARTS = 20
"""Parts of equal length of the video, for Fig. 7."""
DRAWS = 4000
"""Bootstrap samples of the runs."""
SURE = 0.84
"""Share of the samples that must agree; that of a normal mean within one standard error above 0."""
LITTLE = 1.0
"""Rate [%] below which there is nothing to gain."""
KEPT = ("idf1", "hota", "mota", "frame_ms", "particles", "left", "lost")
"""Figures of trials that tables have besides the rates."""


def seed_of(size: Size, run: int) -> int:
    """Return the seed of a run's video: 1, 2, ... by default."""
    return size.seed + run + 1


def spec_of(size: Size, run: int, **balls: Any) -> Spec:
    """Describe a trial of the four methods on the paper's video, or on one with other balls."""
    methods = {m: {"method": m} for m in METHODS}
    return views_spec(seed_of(size, run), methods, {"frames": size.steps, **balls}, parts=PARTS)


def rate_row(
    series: str, x: float, results: Sequence[Mapping[str, float]], label: str, rate: str, *, plotted: bool = True
) -> Row:
    """Make the row of a rate [%] of every run, with its median and the means of the other figures."""
    values = tuple(100.0 * r[f"{label}.{rate}"] for r in results)
    extra = {"median": float(np.median(values))}
    for name in KEPT:
        given = [r[f"{label}.{name}"] for r in results if not math.isnan(r[f"{label}.{name}"])]
        extra[name] = math.fsum(given) / len(given) if given else math.nan
    return Row(series, x, values, extra, plotted=plotted)


def ordered(key: str, statement: str, low: Row, high: Row) -> Verdict:
    """Judge by bootstrap over the runs that one mean is below another, where runs may be far from normal."""
    gaps = np.subtract(high.values, low.values)
    sure = bootstrap_share(gaps)
    better, worse = int(np.sum(gaps > 0)), int(np.sum(gaps < 0))
    gap, error = v.difference(low, high)
    word = v.REPRODUCED if gap > 0 and sure >= SURE else v.IN_PART if gap > 0 else v.NOT
    rule = (
        f"above 0 in at least {SURE:.0%} of bootstrap samples of the runs (here {sure:.0%}); in part if above 0; "
        f"lower in {better} runs, higher in {worse}"
    )
    return Verdict(key, statement, paper=None, measured=gap, error_bar=error, runs=low.runs, verdict=word, rule=rule)


def everywhere(key: str, statement: str, points: Sequence[tuple[Row, Row]]) -> Verdict | None:
    """Judge that one mean is below another at several points; None where nothing can be gained at any of them.

    Args:
        key: id of the verdict.
        statement: its text.
        points: the lower and the higher row [%] of each; those whose higher mean is below `LITTLE` are left out.
    """
    open_ones = [(low, high) for low, high in points if high.mean >= LITTLE]
    if not open_ones:
        return None
    single = [ordered(key, statement, low, high) for low, high in open_ones]
    held = [x.verdict == v.REPRODUCED for x in single]
    found = [v.difference(low, high) for low, high in open_ones]
    error = math.sqrt(math.fsum(e * e for _, e in found)) / len(found)
    left = f"; {len(points) - len(found)} left out, at which there is less than {LITTLE:g} % to gain"
    rule = f"above 0 in {SURE:.0%} of bootstrap samples of the runs: {sum(held)} of {len(held)} points"
    mean = math.fsum(gap for gap, _ in found) / len(found)
    runs = min(low.runs for low, _ in open_ones)
    return Verdict(
        key,
        statement,
        paper=None,
        measured=mean,
        error_bar=error,
        runs=runs,
        verdict=v.share(held),
        rule=rule + (left if len(points) > len(found) else ""),
    )


def bootstrap_share(gaps: Floats) -> float:
    """Return the share of samples of the runs, drawn with repetition, whose mean is above 0."""
    rng = np.random.default_rng(len(gaps))
    drawn = rng.integers(0, len(gaps), (DRAWS, len(gaps)))
    return float(np.mean(gaps[drawn].mean(axis=1) > 0.0))
