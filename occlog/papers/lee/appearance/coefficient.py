"""[Lee] Sec. 5.2.1, Figs. 5-10 to 5-14: what the Bhattacharyya coefficient of histograms depends on."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats
from occlog.core.image import bhattacharyya, bias, density
from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, mean_of
from occlog.pipeline.sweep.trial import Spec

BINS = (8, 16, 32, 64, 128, 256)
"""Numbers m of bins."""
ENOUGH = 32
"""Most bins for which the bias is that of the closed form at the values of this experiment."""
GREY = 256
SHIFTS = (0.0, 0.25, 0.5, 0.75)
"""Shifts of the end points [bin widths]."""
WIDE = 4
"""Bins of the histograms with shifted end points."""
MEANS, SPREAD = (100.0, 130.0), 20.0
"""Grey levels of two objects."""
SAME, FEW, WITHOUT = "one object twice", "one object twice, a quarter of the values", "one object twice, bias corrected"
CLOSED = ", closed form"
TWO, MOVED = "two objects", "two objects, end points shifted by [bins]"
LAYOUT, ORDER, BEYOND = "layout changed", "order of the bins changed", "outside of [0, 1]"


def coefficient_trial(spec: Spec) -> dict[str, float]:
    """Draw samples of random densities and measure Bhattacharyya coefficients of their histograms.

    Args:
        spec: `values` (number of values in each histogram), `seed` and `run`.

    Returns:
        `same-M`: two samples of a uniform density of M bins; `few-M`: with a quarter of the values; `same-closed-M`
        and `few-closed-M`: 1 less the bias in closed form; `two-M`: two objects of normal grey levels with
        different means; `shift-S`: the two in bins with end points S widths further; `layout` and `order`: change
        of the coefficient when the pixels of one are permuted, and when the bins of both are; `beyond`: how far any
        coefficient is outside of [0, 1].
    """
    rng = np.random.default_rng(np.random.SeedSequence(int(spec["seed"]), spawn_key=(int(spec["run"]),)))
    n = int(spec["values"])
    out: dict[str, float] = {}
    for m in BINS:
        even = np.full(m, 1.0 / m)
        for name, values in (("same", n), ("few", n // 4)):
            pair = density(rng.multinomial(values, even, size=2))
            out[f"{name}-{m}"] = float(bhattacharyya(pair[:1], pair[1:])[0, 0])
            out[f"{name}-closed-{m}"] = float(1.0 - bias(m, values, values))
    first, second = (np.clip(rng.normal(mean, SPREAD, n), 0, GREY - 1e-9) for mean in MEANS)
    for m in BINS:
        out[f"two-{m}"] = _rho(_histogram(first, m, 0.0), _histogram(second, m, 0.0))
    for shift in SHIFTS:
        out[f"shift-{shift:g}"] = _rho(_histogram(first, WIDE, shift), _histogram(second, WIDE, shift))
    a, b = _histogram(first, 64, 0.0), _histogram(second, 64, 0.0)
    order = rng.permutation(64)
    out["layout"] = abs(_rho(a, _histogram(rng.permutation(second), 64, 0.0)) - _rho(a, b))
    out["order"] = abs(_rho(a[order], b[order]) - _rho(a, b))
    sparse = rng.dirichlet(np.full(64, 0.1), size=40)
    # Without the clipping of the coefficient itself
    raw = np.sqrt(sparse[:20]) @ np.sqrt(sparse[20:]).T
    out["beyond"] = float(np.maximum(np.maximum(-raw, raw - 1.0), 0.0).max())
    return out


def _histogram(grey: Floats, bins: int, shift: float) -> Floats:
    """Histogram of the levels `grey` (n,), 0 to 256, with shares that sum to 1, of `bins` bins.

    The levels are shifted by `shift` bin widths; above 0 there is one bin more.
    """
    width = GREY / bins
    index = np.floor((grey + shift * width) / width).astype(np.int64)
    return density(np.bincount(index, minlength=bins + (shift > 0)))


def _rho(a: Floats, b: Floats) -> float:
    return float(bhattacharyya(a[None], b[None])[0, 0])


def coefficients(size: Size, execute: Execute) -> Table:
    """Table of the coefficients against the number of bins, and of changes that should have no effect.

    Steps are values of each histogram.
    """
    found = execute(
        [{"kind": "lee-coefficient", "values": size.steps, "seed": size.seed, "run": r} for r in range(size.runs)]
    )
    rows = []
    for m in BINS:
        for name, key in ((SAME, "same"), (FEW, "few")):
            rows.append(PaperRow(name, m, tuple(f[f"{key}-{m}"] for f in found)))
            rows.append(PaperRow(f"{name}{CLOSED}", m, tuple(f[f"{key}-closed-{m}"] for f in found)))
        rows.append(PaperRow(WITHOUT, m, tuple(f[f"same-{m}"] + 1.0 - f[f"same-closed-{m}"] for f in found)))
        rows.append(PaperRow(TWO, m, tuple(f[f"two-{m}"] for f in found)))
    rows += [PaperRow(MOVED, s, tuple(f[f"shift-{s:g}"] for f in found), plotted=False) for s in SHIFTS]
    for name, key in ((LAYOUT, "layout"), (ORDER, "order"), (BEYOND, "beyond")):
        rows.append(PaperRow(name, 64, tuple(f[key] for f in found), plotted=False))
    return rows


EXACT = 1e-12
"""Differences up to this are rounding."""


def judge_coefficients(table: Table) -> list[StatementVerdict]:
    """Verdicts on the Bhattacharyya coefficient of histograms ([Lee] Sec. 5.2.1): range, what changes it, bias."""
    two = v.series(table, TWO)
    return [
        _nothing(table, "range", BEYOND, "The coefficient is in the range 0 to 1; farthest outside."),
        _nothing(
            table,
            "layout",
            LAYOUT,
            "Figs. 5-10 to 5-14: candidates that differ in layout alone have equal coefficients (.8039 and .8040 "
            "printed); change when the pixels of one are put in another order.",
            paper=0.0001,
        ),
        _nothing(
            table,
            "order",
            ORDER,
            "The coefficient does not see which colours are neighbours (of this project); change when the bins of both "
            "are put in another order.",
        ),
        v.pairs(
            "width",
            "Histograms depend on the width of the bins: the coefficient of two objects is lower with 256 bins than "
            "with 8 by this.",
            [(two[-1], two[0])],
        ),
        v.pairs(
            "ends",
            f"Histograms depend on the end points of the bins: the coefficient of two objects in {WIDE} bins is "
            "higher by this when these move by half a bin, and no end point is between the objects any more.",
            [(v.row_of(table, MOVED, 0.0), v.row_of(table, MOVED, 0.5))],
        ),
        *_biases(table),
    ]


def _nothing(table: Table, key: str, series: str, statement: str, paper: float | None = None) -> StatementVerdict:
    """Verdict on whether a quantity is 0 in every run, up to rounding.

    Args:
        table: table of the experiment.
        key: id of the verdict.
        series: name of the quantity.
        statement: text of the statement.
        paper: printed number; None: none.
    """
    most = max(v.row_of(table, series).values)
    return v.fact(
        key, statement, holds=most <= EXACT, measured=most, rule=f"at most {EXACT:g} in every run", paper=paper
    )


def _biases(table: Table) -> list[StatementVerdict]:
    """Verdicts on the closed form of the bias by how far below 1 histograms of one object are, and its correction."""
    out = []
    for series, name in ((SAME, "many"), (FEW, "few")):
        for same, closed in v.matched(table, series, f"{series}{CLOSED}"):
            values = round((same.x - 1.0) / (4.0 * (1.0 - closed.mean)))
            statement = (
                f"Two histograms of one object, m = {same.x:g} and {values} values each: below 1 by "
                "(m - 1) / 8 (1 / n1 + 1 / n2) (of this project)."
            )
            below, error = 1.0 - same.mean, same.error
            out.append(v.number(f"bias-{name}-{same.x:g}", statement, 1.0 - closed.mean, below, error, same.runs))
    rows = [row for row in v.series(table, WITHOUT) if row.x <= ENOUGH]
    worst = max(rows, key=lambda row: abs(row.mean - 1.0))
    statement = f"Up to {ENOUGH} bins the coefficient of one object is 1 when its bias is corrected (of this project)."
    rule = "the farthest from 1 is within .001"
    out.append(v.judge("corrected", statement, mean_of(worst), v.Interval(0.999, 1.001), rule=rule, paper=1.0))
    return out


COEFFICIENT = Experiment(
    item="bhattacharyya",
    title="Sec. 5.2.1: the Bhattacharyya coefficient of histograms",
    x_label="number of bins",
    y_label="coefficient",
    runs=400,
    steps=2000,
    quick=(40, 2000),
    compute=coefficients,
    judge=judge_coefficients,
    trial=coefficient_trial,
    note="Steps are values of a histogram. The histograms of Figs. 5-11 to 5-14 are lost; objects are redrawn.",
)
"""Factors that the coefficient depends on."""
