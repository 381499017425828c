"""Experiments of this project on the example of [Rahimi]: false bearings, and consistency of the covariance."""

from __future__ import annotations

import math
from collections.abc import Iterable

from occlog.papers import verdicts as v
from occlog.papers.verdicts import (
    Execute,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    estimate,
    exact,
    mean_of,
    quotient,
)
from occlog.pipeline.sweep.trial import Values

from .trial import sparse_experiment, sparse_spec

SQUARE, HUBER, CAUCHY = "square", "huber", "cauchy"
LINEAR, SQUARE_LINEAR = "cauchy, linear start", "square, linear start"
SQUARE_ROOM, CAUCHY_ROOM = "square, room and ranges", "cauchy, room and ranges"
ROOM = {"wall_constraints": True, "known_range": True}
WAYS: dict[str, Values] = {
    SQUARE: {},
    HUBER: {"loss": "huber"},
    CAUCHY: {"loss": "cauchy"},
    LINEAR: {"loss": "cauchy", "initialisation": "linear"},
    SQUARE_LINEAR: {"initialisation": "linear"},
    SQUARE_ROOM: ROOM,
    CAUCHY_ROOM: {"loss": "cauchy", **ROOM},
}
CLEAN = {HUBER: SQUARE, CAUCHY: SQUARE, LINEAR: SQUARE, SQUARE: SQUARE, CAUCHY_ROOM: SQUARE_ROOM}
"""Each way with false bearings, and the reference for its error with clean data."""
SHARES = (0.0, 10.0, 20.0)
"""False bearings in per cent of the measurements."""
LOSES = 0.15
"""Share of the error that false bearings may add."""
SAME = 1e-4
"""Largest difference of two errors that count as equal, by the tolerance of the search [m]."""

HESSIAN, KNOWN, MOMENT = "mode, hessian", "mode, hessian; distances known", "mode, moment"
INVARIANT, INVARIANT_ROOM, RIGHT = "invariant", "invariant; room and ranges", "consistent"
ESTIMATES: dict[str, tuple[str, Values]] = {
    HESSIAN: ("nees", {}),
    KNOWN: ("nees_known", {}),
    MOMENT: ("nees", {"covariance": "moment"}),
    INVARIANT: ("nees", {"estimate": "invariant"}),
    INVARIANT_ROOM: ("nees", {"estimate": "invariant", **ROOM}),
}
"""Figure of the trial, and settings of `map`, by kind of estimate and covariance."""
FIT_STEPS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Steps at which the motion is identified [s]."""
LONGEST = FIT_STEPS[-1]
RIGHT_WITHIN = (1.4, 2.8)
"""Mean normalised squared errors of a covariance that is right: within a factor of 1.4 of 2."""


def false(size: Size, execute: Execute) -> Table:
    """Table of the RMSE [m] against the share of false bearings [%], for each loss, start and set of constraints."""
    points = [(name, share) for name in WAYS for share in (SHARES[:2] if size.quick else SHARES)]
    rows = []
    for (name, share), own in v.run_trials(
        points, size, execute, lambda p, run: sparse_spec(size, run, false=p[1] / 100.0, **WAYS[p[0]])
    ):
        extra = {"converged": math.fsum(r["converged"] for r in own) / size.runs}
        extra["iterations"] = math.fsum(r["iterations"] for r in own) / size.runs
        rows.append(PaperRow(name, share, tuple(r["rmse"] for r in own), extra))
    return rows


def judge_false(table: Table) -> list[StatementVerdict]:
    """Verdicts on what 10 % of false bearings add to the error with clean data (statements of this project)."""
    clean = v.find(table, SQUARE, 0.0)
    out = []
    for name, base in CLEAN.items():
        row, own = v.find(table, name, 10.0), v.find(table, base, 0.0)
        if row is not None and own is not None:
            out.append(_adds(f"false-{name.replace(', ', '-').replace(' ', '-')}", name, own, row))
    start = v.matched(table, CAUCHY, LINEAR, (10.0,))
    statement = "Robust costs must start from the axes: with a linear fit the error is higher by this much [m]."
    out.append(v.pairs("false-start", statement, start))
    other = v.find(table, SQUARE_LINEAR, 0.0)
    if other is not None and clean is not None:
        off = max(abs(a - b) for a, b in zip(clean.values, other.values, strict=True))
        statement = "For squares and clean data the start does not matter: largest difference of the RMSE [m]."
        rule = f"below {SAME:g} m in every problem"
        out.append(v.judge("false-start-squares", statement, exact(off, clean.runs), v.below(SAME), rule=rule))
    return out


def _adds(key: str, name: str, clean: PaperRow, row: PaperRow) -> StatementVerdict:
    """Verdict on what false bearings add to the mean RMSE, as a share of the clean error.

    Args:
        key: id of the verdict.
        name: words for the method.
        clean: row without false bearings.
        row: row of the same problems with 10 % of them.
    """
    ratio, error = quotient(row, clean)
    statement = (
        f"10 % of false bearings add less than {LOSES:.0%} to the mean RMSE with clean data ({name}): share added."
    )
    rule = f"below {LOSES:.0%}; in part below twice that"
    added = estimate(ratio - 1.0, error, row.runs)
    return v.judge(key, statement, added, v.below(LOSES), v.below(2.0 * LOSES), rule=rule)


def covariance(size: Size, execute: Execute) -> Table:
    """Table of the mean normalised squared error against the step at which the motion is identified [s].

    Errors with the inverse Hessian at the mode are too large for a plot: that of the longest step is a line across.
    """
    steps = (FIT_STEPS[0], LONGEST) if size.quick else FIT_STEPS
    points = [(name, s) for name in ESTIMATES for s in steps]
    rows = []
    for (name, step), own in v.run_trials(
        points, size, execute, lambda p, run: sparse_spec(size, run, fit_step_s=p[1], **ESTIMATES[p[0]][1])
    ):
        extra = {key: math.fsum(r[key] for r in own) / size.runs for key in ("known", "unflagged", "rmse")}
        extra["acceleration"] = sparse_spec(size, 0, fit_step_s=step)["track"]["process_noise_velocity"]
        values = _finite(r[ESTIMATES[name][0]] for r in own)
        if name != HESSIAN:
            rows.append(PaperRow(name, step, values, extra))
        elif step == LONGEST:
            rows.append(PaperRow(name, math.nan, values, extra))
    return [*rows, PaperRow(RIGHT, math.nan, (2.0, 2.0))]


def _finite(values: Iterable[float]) -> tuple[float, ...]:
    """The values without NaN and infinite ones."""
    return tuple(x for x in values if math.isfinite(x))


def judge_covariance(table: Table) -> list[StatementVerdict]:
    """Verdicts on this project's statement about the covariance: the mean normalised squared error is 2."""
    out = []
    for name in ESTIMATES:
        for row in table:
            step = LONGEST if math.isnan(row.x) else row.x
            if row.series == name and step in (FIT_STEPS[0], LONGEST):
                key = f"covariance-{name.replace(';', '').replace(',', '').replace(' ', '-')}-{step:g}s"
                out.append(_consistent(key, f"{name}; motion identified at {step:g} s", row))
    return out


def _consistent(key: str, what: str, row: PaperRow) -> StatementVerdict:
    """Verdict on a mean normalised squared error against 2; errors within a problem depend on each other.

    The error bar is therefore that of the problems' means.

    Args:
        key: id of the verdict.
        what: words for the case.
        row: means, one for each problem.
    """
    statement = f"The normalised squared error is 2 in the mean, as the covariance states ({what})."
    low, high = RIGHT_WITHIN
    rule = f"from {low:g} to {high:g}; in part within a factor of 2"
    return v.judge(key, statement, mean_of(row), v.Interval(low, high), v.Interval(1.0, 4.0), rule=rule, paper=2.0)


FALSE = sparse_experiment(
    item="false",
    title="False bearings",
    x_label="false bearings [%]",
    y_label="RMSE [m]",
    compute=false,
    judge=judge_false,
    note="False bearings are drawn uniformly from the camera's field of view.",
)
COVARIANCE = sparse_experiment(
    item="covariance",
    title="Consistency of the covariance",
    x_label="step at which the motion is identified [s]",
    y_label="mean normalised squared error",
    compute=covariance,
    judge=judge_covariance,
    note="Times that are not flagged; distances known: their standard deviation is at most half of them.",
)
