"""Errors in the fields of [Lee] Figs. 3-4 and 3-7 against noise and cameras asked: Figs. 3-4, 3-6, 3-14, Table 3.1."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.papers import verdicts as v
from occlog.papers.verdicts import (
    Execute,
    Experiment,
    Measure,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    bootstrapped,
    mean_of,
    sample,
)
from occlog.pipeline.sweep.trial import Values

from .trial import cooperation_spec, cooperation_trial

THESIS, JOINT = "as in the thesis", "joint association"
FORMS = {THESIS: "thesis", JOINT: "joint"}
PERIODS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
QUICK_PERIODS = (2.0, 20.0)
GRID = (2.0, 4.0, 6.0, 10.0, 16.0, 25.0, 50.0, 100.0)
QUICK_GRID = (2.0, 6.0, 20.0, 100.0)
SPREADS = (0.5, 1.0, 2.0)
MEAN = "mean of the objects"
NONE, PRINTED, EDGE, SPREAD, PERIODIC = "none", "printed triggers", "count change", "spread", "periodic"
STEPS_BETWEEN = "steps between requests"
FIGURES = ("frames", "requests", "fixes", "period")
RESAMPLES = 1000
VARIANCES = (0.0, 0.5, 1.5, 5.0)
"""Variances of the noise in Fig. 3-4 [deg^2]."""
LEAST_VARIANCE = 0.01
"""Variance that represents 0 [deg^2]: no weight can be had for bearings without any error."""
LARGEST = VARIANCES[-1]
"""Variance of Figs. 3-5 and 3-6 [deg^2]."""
LARGEST_RMS = {1: 3.98, 2: 9.80, 3: 1.08}
"""RMS errors of the objects at that variance without cameras [m]."""
CONDITIONS = {
    "count": ("3.14", "fig3.7-count"),
    "bearing": ("3.15", "fig3.13-bearing"),
    "ellipse": ("3.16", "fig3.11-ellipse"),
}
"""Equation of each printed trigger by its cause, and the id of the verdict that it fires where the others do not."""
TABLE = {1: (7.54, 1.38), 2: (3.70, 0.24), 3: (5.54, 0.32)}
"""RMS errors of Table 3.1 [m] without cameras and with the printed triggers."""
BETWEEN = 4.55
"""Average time between requests of the printed triggers, Table 3.1(b) [steps]."""
AVERAGE = 5.59
"""Average RMS error without cameras, Table 3.1 [m]."""


def by_variance(size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the variance without cameras: mean of the objects, and each one in the thesis' form."""
    rows = []
    for (name, x), own in v.run_trials(
        product(FORMS, VARIANCES),
        size,
        execute,
        lambda p, run: cooperation_spec(size, run, "open", FORMS[p[0]], variance=max(p[1], LEAST_VARIANCE)),
    ):
        rows.append(PaperRow(f"{MEAN}, {name}", x, v.values_of(own, "rmse")))
        if name == THESIS:
            rows += [PaperRow(f"object {k}", x, v.values_of(own, f"rmse_{k}"), plotted=False) for k in LARGEST_RMS]
    return rows


def judge_variance(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Lee] Fig. 3-4: the error grows with the variance of the bearings; printed errors."""
    out = []
    for name, key in FORMS.items():
        rows = v.series(table, f"{MEAN}, {name}")
        statement = (
            f"With each larger variance of the noise the error is larger ({name}; mean of the three objects) [m]."
        )
        out.append(v.pairs(f"fig3.4-grows-{key}", statement, list(pairwise(rows))))
        statement = f"With the largest variance the error is larger than with none ({name}) [m]."
        out.append(v.pairs(f"fig3.4-ends-{key}", statement, [(rows[0], rows[-1])] if rows else []))
    for k, value in LARGEST_RMS.items():
        row = v.row_of(table, f"object {k}", LARGEST)
        statement = f"RMS error of object {k} with variance 5 (its path is lost; each run draws another) [m]."
        out.append(v.stated(f"fig3.4-{k}", statement, value, mean_of(row)))
    return out


def trials(
    size: Size,
    execute: Execute,
    points: Sequence[tuple[str, str, float, Values]],
    scene: str = "field",
    variance: float | None = None,
) -> Table:
    """Run the trials of all points; return a row for each, with the RMSE of each run and the means of other figures.

    Args:
        size: runs and steps.
        execute: runs the trials.
        points: (series, form of the filter, x, settings); an x of NaN becomes the mean number of frames.
        scene: name of the environment.
        variance: variance of its noise [deg^2]; None: that of the scene.
    """
    rows = []
    for (series, _, x, settings), own in v.run_trials(
        points, size, execute, lambda p, run: cooperation_spec(size, run, scene, p[1], variance=variance, **p[3])
    ):
        extra = {name: _mean([r[name] for r in own]) for name in (*FIGURES, "rmse_1", "rmse_2", "rmse_3")}
        extra["limit"] = float(settings.get("request_sigma", math.nan))
        extra |= {f"frames_{k}": r["frames"] for k, r in enumerate(own)}
        each = {f"alone_{c}": v.values_of(own, f"alone_{c}") for c in CONDITIONS}
        x_value = extra["frames"] if math.isnan(x) else x
        rows.append(PaperRow(series, x_value, v.values_of(own, "rmse"), extra, each=each))
    return rows


def _mean(values: Sequence[float]) -> float:
    good = [x for x in values if not math.isnan(x)]
    return math.fsum(good) / len(good) if good else math.nan


def by_period(size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the period of asking cameras, in the environment of [Lee] Fig. 3-4."""
    periods = QUICK_PERIODS if size.quick else PERIODS
    points: list[tuple[str, str, float, Values]] = [
        (name, form, p, {"cooperate": "periodic", "period_s": p}) for name, form in FORMS.items() for p in periods
    ]
    return trials(size, execute, points, scene="open", variance=LARGEST)


def judge_period(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Lee] Fig. 3-6: the shorter the period of asking cameras, the smaller the error."""
    out = []
    for name, key in FORMS.items():
        rows = v.series(table, name)
        statement = f"The closer the visual period is to the acoustic one, the smaller the error ({name})."
        out.append(v.pairs(f"fig3.6-{key}", statement, list(pairwise(rows))))
    return out


def by_policy(size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the number of camera frames that are requested, for every policy."""
    grid = QUICK_GRID if size.quick else GRID
    points: list[tuple[str, str, float, Values]] = []
    for name, form in FORMS.items():
        points.append((f"{NONE}, {name}", form, math.nan, {}))
        points += [(f"{PERIODIC}, {name}", form, math.nan, {"cooperate": "periodic", "period_s": p}) for p in grid]
        points.append((f"{PRINTED}, {name}", form, math.nan, {"cooperate": "printed"}))
        points.append((f"{EDGE}, {name}", form, math.nan, {"cooperate": "count"}))
        points += [(f"{SPREAD}, {name}", form, math.nan, {"cooperate": "spread", "request_sigma": s}) for s in SPREADS]
    return trials(size, execute, points)


def judge_policy(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Lee] Fig. 3-14: the error without cameras, what each trigger adds, whether triggers save frames."""
    out = []
    none = v.row_of(table, f"{NONE}, {THESIS}")
    statement = "Without cameras the average error is 5.59 m."
    out.append(v.stated("fig3.14-none", statement, AVERAGE, mean_of(none)))
    for row in v.series(table, f"{PRINTED}, {THESIS}"):
        for cause, (equation, key) in CONDITIONS.items():
            statement = f"({equation}) asks where the other two conditions do not: requests of a run by it alone."
            alone = sample(row.each[f"alone_{cause}"])
            out.append(v.judge(key, statement, alone, v.above(0.0), rule="above 0 in the mean over the runs"))
    for name, key in FORMS.items():
        period = v.series(table, f"{PERIODIC}, {name}")
        for policy, code in ((PRINTED, "printed"), (EDGE, "count"), (SPREAD, "spread")):
            for row in v.series(table, f"{policy}, {name}"):
                limit = row.extra.get("limit", math.nan)
                tail = "" if math.isnan(limit) else f"-{limit:g}"
                which = f"{policy} ({name}, {row.extra['frames']:.0f} frames, {row.mean:.2f} m)"
                out.append(_cheaper(f"fig3.14-{key}-{code}{tail}", which, row, period))
    return out


def _cheaper(key: str, which: str, row: PaperRow, period: list[PaperRow]) -> StatementVerdict:
    """Verdict on whether a policy requests fewer frames than the period of equal error, by bootstrap over the runs.

    Args:
        key: id of the verdict.
        which: words for the policy.
        row: row of the policy.
        period: rows of the periods.
    """
    statement = f"Asks for fewer frames than the period of equal error: {which}; frames saved."
    rule = "above 0 (bootstrap over runs)"
    return v.judge(key, statement, saved_frames(row, period), v.above(0.0), rule=rule)


def saved_frames(row: PaperRow, period: list[PaperRow]) -> Measure:
    """Number of frames of the period of equal error less that of a policy, with its bootstrap error.

    A bootstrap sample has the same runs of the policy and of all periods. NaN if no period has such an error.
    """
    errors, own = np.array([r.values for r in period]), np.array(row.values)
    frames, own_frames = np.array([_frames(r) for r in period]), _frames(row)

    def saved(runs: Ints) -> float:
        return _saved(errors=own, frames=own_frames, of_periods=errors, frames_of=frames, runs=runs)

    return bootstrapped(row.runs, saved, RESAMPLES)


def _frames(row: PaperRow) -> Floats:
    return np.array([row.extra[f"frames_{k}"] for k in range(row.runs)])


def _saved(errors: Floats, frames: Floats, of_periods: Floats, frames_of: Floats, runs: Ints) -> float:
    """Frames saved in a sample of runs, by linear interpolation of log frames over log error.

    NaN if the error is outside the range of those of the periods.

    Args:
        errors: (R,) errors of a policy, by run.
        frames: (R,) its numbers of frames.
        of_periods: (K, R) errors of K periods.
        frames_of: (K, R) their numbers of frames.
        runs: indices of the runs in the sample.
    """
    wanted = math.log(errors[runs].mean())
    known, cost = np.log(of_periods[:, runs].mean(axis=1)), np.log(np.maximum(frames_of[:, runs].mean(axis=1), 0.5))
    order = np.argsort(known)
    if not known[order[0]] <= wanted <= known[order[-1]]:
        return math.nan
    return math.exp(float(np.interp(wanted, known[order], cost[order]))) - float(frames[runs].mean())


def by_object(size: Size, execute: Execute) -> Table:
    """Table of the RMSE of each object, without cameras and with the printed triggers, and steps between requests."""
    ways: dict[str, Values] = {NONE: {}, PRINTED: {"cooperate": "printed"}}
    rows: Table = []
    asked: tuple[float, ...] = ()
    for name, own in v.run_trials(
        ways, size, execute, lambda name, run: cooperation_spec(size, run, "field", "thesis", **ways[name])
    ):
        extra = {f: _mean([r[f] for r in own]) for f in FIGURES}
        rows += [PaperRow(name, float(k), tuple(r[f"rmse_{k}"] for r in own if f"rmse_{k}" in r), extra) for k in TABLE]
        asked = tuple(size.steps / r["requests"] for r in own if r["requests"])  # in the end those of PRINTED
    return [*rows, PaperRow(STEPS_BETWEEN, math.nan, asked, plotted=False)]


def judge_object(table: Table) -> list[StatementVerdict]:
    """Verdicts on the printed errors of single objects, and the mean time between requests, in [Lee] Table 3.1."""
    out = []
    for n, (name, text) in enumerate(((NONE, "without cameras"), (PRINTED, "with the printed triggers"))):
        for k, values in TABLE.items():
            row = v.row_of(table, name, float(k))
            if row.values and not math.isnan(row.mean):
                statement = f"RMS error of object {k} {text} [m]."
                out.append(v.stated(f"table3.1-{k}-{n}", statement, values[n], mean_of(row)))
    between = v.row_of(table, STEPS_BETWEEN)
    statement = "Average time between requests of the printed triggers, of any object [steps]."
    out.append(v.stated("table3.1-period", statement, BETWEEN, mean_of(between)))
    return out


NOTE = (
    "Filter of the thesis with the weights put right; unprinted parts (motion noise, cameras, which way the "
    "turns go) are stated in the documentation. A frame is one picture of one camera."
)
OPEN_NOTE = (
    "Filter of the thesis with the weights put right. The paths of Fig. 3-4 are lost: each run draws paths from the "
    "printed starts; the sensor is at the origin."
)
_experiment = functools.partial(Experiment, runs=100, steps=201, quick=(4, 80), trial=cooperation_trial)
FIG3_4 = _experiment(
    item="fig3.4",
    title="Error against the variance of the noise, without cameras",
    x_label="variance [deg^2]",
    y_label="RMSE [m]",
    compute=by_variance,
    judge=judge_variance,
    note=f"{OPEN_NOTE} A variance of {LEAST_VARIANCE:g} is used for 0.",
)
FIG3_6 = _experiment(
    item="fig3.6",
    title="Error against the period of asking cameras",
    x_label="period [s]",
    y_label="RMSE [m]",
    compute=by_period,
    judge=judge_period,
    note=f"{OPEN_NOTE} The variance is 5 deg^2, as in Fig. 3-4(d); a frame is one picture of one camera.",
)
FIG3_14 = _experiment(
    item="fig3.14",
    title="Error against frames asked for",
    x_label="frames asked for in 200 s",
    y_label="RMSE [m]",
    runs=30,
    compute=by_policy,
    judge=judge_policy,
    note=NOTE,
)
TABLE3_1 = _experiment(
    item="table3.1",
    title="Errors of the objects",
    x_label="object",
    y_label="RMSE [m]",
    compute=by_object,
    judge=judge_object,
    note=NOTE,
)
OPEN_EXPERIMENTS = (FIG3_4, FIG3_6)
FIELD_EXPERIMENTS = (FIG3_14, TABLE3_1)
