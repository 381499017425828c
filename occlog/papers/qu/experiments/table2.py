"""[Qu] Table 2: particles and time that joint-state filters and BMCT need, and how they grow with the targets.

Each filter runs with several numbers of particles.  It needs as many as give every target
`ENOUGH` effective samples while the trackers stay on their targets (`ROBUST`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.papers import verdicts as v
from occlog.papers.qu.common import seed_of
from occlog.papers.qu.trial import views_experiment, views_spec
from occlog.papers.verdicts import (
    Execute,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    find,
    mean_of,
    power_of,
    sample,
)
from occlog.pipeline.sweep.trial import Spec

BMCT, MCMC, SIR = "BMCT", "MCMC", "joint SIR"
TOTAL, TIME = "total particles", "CPU ms a frame"
LINEAR, NEARLY = 1.3, 1.6
"""Largest exponents of the number of targets that count as linear, and as in part; as in `speed`."""
PRINTED = {"MCMC": {4: 500.0, 5: 1100.0, 6: 2800.0}, "BMCT": {4: 400.0, 5: 500.0, 6: 600.0}}
"""Total particles by number of targets, as printed."""
FPS = {"MCMC": {4: 8.75, 5: 2.55, 6: 0.4}, "BMCT": {4: 14.4, 5: 11.5, 6: 9.75}}
"""Frames a second by number of targets, the middles of the printed ranges."""


def _printed_exponent(values: Mapping[int, float]) -> float:
    """Exponent of the number of targets with which printed values grow; they have no error bar."""
    return power_of([PaperRow("", n, (value, value)) for n, value in values.items()]).value


def judge2(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Qu] Table 2: growth of particles and time of BMCT and joint filters with the targets."""
    out = []
    for what, name, printed in (("particles", TOTAL, PRINTED), ("time", TIME, FPS)):
        sign = 1.0 if printed is PRINTED else -1.0
        rows = v.series(table, f"BMCT, {name}")
        paper = sign * _printed_exponent(printed["BMCT"])
        statement = f"BMCT's need of {what} grows linearly with the targets: exponent of their number."
        out.append(_linear(f"table2-bmct-{what}", statement, paper, rows))
        for f in (MCMC, SIR):
            paper = sign * _printed_exponent(printed["MCMC"]) if f is MCMC else math.nan
            statement = f"The need of the joint filter ({f}) of {what} grows faster than linearly: exponent."
            out.append(
                _faster(
                    f"table2-{f.split()[-1].lower()}-{what}", statement, paper, v.series(table, f"{f}, {name}"), rows
                )
            )
    out.append(_exponential(v.series(table, f"{SIR}, {TOTAL}")))
    for n, paper in PRINTED["MCMC"].items():
        row = v.find(table, f"MCMC, {TOTAL}", n)
        if row is not None and row.runs:
            statement = f"Total particles of MCMC-PF for {n} targets."
            out.append(v.stated(f"table2-mcmc-{n}", statement, paper, mean_of(row)))
    quicker = v.matched(table, f"BMCT, {TIME}", f"MCMC, {TIME}", (4, 5, 6))
    statement = "BMCT is faster than MCMC-PF: CPU time of a frame lower, by [ms]."
    return [*out, v.pairs("table2-faster", statement, quicker)]


def _linear(key: str, statement: str, paper: float, rows: Sequence[PaperRow]) -> StatementVerdict:
    """Verdict on whether the exponent of rows by number of targets is at most `LINEAR`; in part up to `NEARLY`.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        paper: exponent of the printed values.
        rows: particles or time of BMCT, by number of targets.
    """
    rule = f"exponent at most {LINEAR}; in part up to {NEARLY}"
    return v.judge(key, statement, power_of(rows), v.at_most(LINEAR), v.at_most(NEARLY), rule=rule, paper=paper)


def _faster(
    key: str, statement: str, paper: float, rows: Sequence[PaperRow], bmct: Sequence[PaperRow]
) -> StatementVerdict:
    """Verdict on faster than linear growth: the exponent of `rows` is above `LINEAR`; in part if above that of `bmct`.

    Args:
        key: id of the verdict.
        statement: text of the statement.
        paper: exponent of the printed values; NaN: not printed.
        rows: particles or time of the joint filter, by number of targets.
        bmct: particles or time of BMCT, by number of targets.
    """
    own = power_of(bmct).value
    rule = f"exponent above {LINEAR}; in part above that of BMCT, {own:.2f}"
    good, fair = v.above(LINEAR), v.above(min(own, LINEAR))
    return v.judge(key, statement, power_of(rows), good, fair, rule=rule, paper=paper)


def _exponential(rows: Sequence[PaperRow]) -> StatementVerdict:
    """Verdict on whether the particles of joint SIR grow by a constant factor for every target.

    So it is if the logarithm of the particles is fitted better by a line over the number of targets than over its
    logarithm: the ratio of the squared residuals in each run is below 1.

    Args:
        rows: one for each number of targets (`x`); `values` are the total particles of each run.
    """
    statement = (
        "Joint-state methods grow exponentially with the targets (joint SIR): squares left by a constant factor for "
        "every target, over those left by a power of their number."
    )
    rule = "below 1: a factor fits better than a power"
    left: list[float] = []
    x = np.array([row.x for row in rows])
    for k in range(rows[0].runs if len(rows) >= 3 else 0):
        y = np.log([row.values[k] for row in rows])
        by_factor, by_power = (np.polyfit(abscissa, y, 1, full=True)[1].item() for abscissa in (x, np.log(x)))
        left.append(by_factor / by_power if by_power > 0.0 else math.nan)
    return v.judge("table2-sir-exponential", statement, sample(left), v.below(1.0), rule=rule)


VIEWS = 2
ENOUGH = 30.0
"""Effective samples that a target has to have: those of BMCT with the paper's 50 particles a tracker."""
ROBUST = 0.10
"""Largest mean rate of false positions."""


class FilterVariant(NamedTuple):
    """A filter, and the numbers of particles that it is tried with.

    Attributes:
        name: name in the table.
        method: value of the setting `method`.
        settings: its further settings.
        joint: one state of all targets in a view; false: every target has its own particles.
        tried: values of the setting `particles`, about those needed, from the number of targets.
    """

    name: str
    method: str
    settings: Mapping[str, object]
    joint: bool
    tried: Callable[[int], Sequence[int]]

    def total(self, targets: int, particles: float) -> float:
        """Number of particles of all trackers in all views, for a number of `targets`.

        `particles`: those of each tracker, or of the joint state.
        """
        return VIEWS * particles * (1 if self.joint else targets)


class Tried(NamedTuple):
    """Rows of trials with one number of particles: effective samples of a target, and CPU time of a frame [ms]."""

    ess: PaperRow  # effective samples of a target
    ms: PaperRow  # CPU time of a frame


FILTERS = {
    BMCT: FilterVariant(BMCT, method="bmct", settings={}, joint=False, tried=lambda targets: (24, 48, 96)),  # noqa: ARG005
    MCMC: FilterVariant(
        MCMC, method="mcmc", settings={}, joint=True, tried=lambda targets: [k * targets for k in (45, 90, 180)]
    ),
    SIR: FilterVariant(
        SIR,
        method="mcmc",
        settings={"sampler": "sir"},
        joint=True,
        tried=lambda targets: [round(20.0 * 1.45**targets * k) for k in (1, 2, 4)],
    ),
}
"""The filters by name."""


def table2(size: Size, execute: Execute) -> Table:
    """Table of what each filter needs at each number of targets; the trials behind it are in the table alone."""
    counts = (2, 4, 6) if size.quick else (2, 3, 4, 5, 6, 8)
    found = v.run_trials(counts, size, execute, lambda n, run: _spec(size, run, n))
    table, raw = [], []
    for f in FILTERS.values():
        needs, times = [], []
        for n, results in found:
            trials = [_trial(f, n, k, results) for k in f.tried(n)]
            raw += [row for trial in trials for row in trial]
            need, spent = needed(trials)
            needs.append(PaperRow(f"{f.name}, {TOTAL}", n, need, _extra(f, n, trials, need), plotted=False))
            times.append(PaperRow(f"{f.name}, {TIME}", n, spent, _fps(f, n, spent), plotted=False))
        table += [*_relative(f"{f.name}, particles", needs), *_relative(f"{f.name}, time", times), *needs, *times]
    return [*table, *_printed(counts), *raw]


def _printed(counts: Sequence[int]) -> list[PaperRow]:
    """Rows of the paper's numbers of particles of the joint filter, relative to that of 4 targets.

    `counts`: numbers of targets of the experiment; others are omitted.
    """
    unit, name = PRINTED[MCMC][4], "MCMC-PF as printed, particles"
    return [PaperRow(name, n, (value / unit,)) for n, value in PRINTED[MCMC].items() if n in counts]


def _spec(size: Size, run: int, targets: int) -> Spec:
    """Specification of a trial of all filters, with all numbers of particles, on one video.

    `size` and `run` give the seed; `targets`: number of balls.
    """
    methods = {
        f"{f.name}-{k}": {"method": f.method, "set": {**f.settings, "particles": k}}
        for f in FILTERS.values()
        for k in f.tried(targets)
    }
    return views_spec(seed_of(size, run), methods, {"frames": size.steps, "balls": targets, "views": VIEWS})


def _trial(f: FilterVariant, targets: int, particles: int, results: Sequence[Mapping[str, float]]) -> Tried:
    """Rows of effective samples and time of every run; x is the total number of particles.

    Args:
        f: the filter.
        targets: number of targets.
        particles: number of particles of a tracker, or of the joint state.
        results: figures of each run by name.
    """
    found = {q: tuple(r[f"{f.name}-{particles}.{q}"] for r in results) for q in ("ess", "fr_p", "fr_l", "frame_ms")}
    rates = {q: math.fsum(found[q]) / len(results) for q in ("fr_p", "fr_l")}
    name, x = f"{f.name}, {targets} targets", f.total(targets, particles)
    return Tried(
        PaperRow(f"{name}: effective samples", x, found["ess"], rates, plotted=False),
        PaperRow(f"{name}: {TIME}", x, found["frame_ms"], plotted=False),
    )


def needed(trials: Sequence[Tried]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """In every run the total particles of which `ENOUGH` are effective for a target, and the CPU time of a frame [ms].

    Between the numbers tried, and beyond, effective samples and time are taken as powers of the number. The result is
    at least the number from which on targets are tracked (`ROBUST`); both are empty where there is no such number.

    Args:
        trials: results by rising number of particles.
    """
    robust = _robust(trials)
    if math.isinf(robust):
        return (), ()
    need, spent = [], []
    x = np.log([t.ess.x for t in trials])
    for run in range(trials[0].ess.runs):
        ess = np.log([t.ess.values[run] for t in trials])
        log_need = max(_line(ess, x, math.log(ENOUGH)), math.log(robust) if robust else -math.inf)
        need.append(math.exp(log_need))
        spent.append(math.exp(_line(x, np.log([t.ms.values[run] for t in trials]), log_need)))
    return tuple(need), tuple(spent)


def _robust(trials: Sequence[Tried]) -> float:
    """Least total number tried from which on the rate of false positions is at most `ROBUST`; 0: all, inf: none."""
    low = [t.ess.extra["fr_p"] <= ROBUST for t in trials]
    if all(low):
        return 0.0
    first = len(low) - low[::-1].index(False)
    return trials[first].ess.x if first < len(low) else math.inf


def _line(x: Floats, y: Floats, at: float) -> float:
    """Interpolate y (n,) over rising x (n,) at the position `at`, or extrapolate from the two nearest points."""
    k = int(np.clip(np.searchsorted(x, at), 1, len(x) - 1))
    step = max(x[k] - x[k - 1], 1e-9)
    return float(y[k - 1] + (y[k] - y[k - 1]) * (at - x[k - 1]) / step)


def _extra(f: FilterVariant, targets: int, trials: Sequence[Tried], need: Sequence[float]) -> dict[str, float]:
    """Further columns of a row: the printed number, and both rates at the number tried nearest to the mean need.

    Args:
        f: the filter.
        targets: number of targets.
        trials: results of each number tried.
        need: number of particles needed in each run; empty: none suffices, and the result is empty.
    """
    if not need:
        return {}
    middle = math.fsum(need) / len(need)
    near = min((t.ess for t in trials), key=lambda row: abs(math.log(row.x / middle)))
    printed = PRINTED.get(f.name, {}).get(targets, math.nan)
    return {"printed": printed, "fr_p": near.extra["fr_p"], "fr_l": near.extra["fr_l"]}


def _fps(f: FilterVariant, targets: int, spent: Sequence[float]) -> dict[str, float]:
    """Further columns of a row: frames (of all views) a second, and the printed ones at a number of `targets`.

    `spent`: CPU time of a frame in each run [ms]; empty: the result is empty.
    """
    if not spent:
        return {}
    return {"fps": 1e3 * len(spent) / math.fsum(spent), "printed": FPS.get(f.name, {}).get(targets, math.nan)}


def _relative(name: str, rows: Sequence[PaperRow]) -> list[PaperRow]:
    """Rows under a new name, divided by their mean at 4 targets; empty without that."""
    unit = find(list(rows), rows[0].series, 4)
    if unit is None or not unit.runs:
        return []
    return [PaperRow(name, row.x, tuple(value / unit.mean for value in row.values)) for row in rows if row.runs]


TABLE2 = views_experiment(
    item="table2",
    title="Particles and time that are needed",
    x_label="targets",
    y_label="needed, 1: at 4 targets",
    runs=6,
    steps=100,
    quick=(2, 15),
    compute=table2,
    judge=judge2,
    note=f"As many particles as give each target {ENOUGH:g} effective ones and at most {ROBUST:.0%} false positions.",
)
"""Particles and time that the joint filters of a view need, and BMCT."""
