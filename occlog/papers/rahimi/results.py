"""[Rahimi] Figs. 4 and 5: errors along the trajectories, with and without the field-of-view constraints."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from occlog.array_types import Floats
from occlog.papers import verdicts as v
from occlog.papers.plots import EstimatedPath, PlanFigure
from occlog.papers.verdicts import (
    Execute,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    difference_of,
    estimate,
    exact,
    quotient_of,
    share_of,
)

from .example import HALF, sparse_scene
from .search import error, panel, ranked
from .trial import BINS, Solved, sightings, solve_problem, sparse_experiment, sparse_spec

ALL, SEEN, BETWEEN, BEYOND = "whole trajectory", "seen", "between sightings", "before the first or after the last"
WITH, WITHOUT, ROOM = "in front of the cameras", "without constraints", "in the room and in range, too"
KINDS = {
    WITHOUT: {"in_front_constraint": False},
    WITH: {"in_front_constraint": True},
    ROOM: {"in_front_constraint": True, "wall_constraints": True, "known_range": True},
}
CLOSE = 0.1
"""Median error, as a share of the room's side, up to which an estimate counts as close."""
SOME = 0.05
"""Share of the problems from which something that should not occur does occur."""
CRITICAL = 0.1
"""Reduction of the error, as a share of it, from which the constraints count as critical."""


def fig4(size: Size, execute: Execute) -> Table:
    """Table of the RMSE [m] of tenths of the trajectories, of the whole, and of its seen and unseen parts.

    The rows `BETWEEN` and `BEYOND` have the problems with both kinds of unseen parts only.
    """
    results = execute([sparse_spec(size, run) for run in range(size.runs)])
    whole = tuple(r["rmse"] for r in results)
    median, half = median_of(whole)
    both = [r for r in results if not math.isnan(r["between"]) and not math.isnan(r["beyond"])]
    return [
        *(PaperRow(ALL, (k + 0.5) / BINS, tuple(r[f"part_{k}"] for r in results)) for k in range(BINS)),
        PaperRow(ALL, math.nan, whole, {"median": median, "median_error": half}),
        PaperRow(SEEN, math.nan, tuple(r["seen"] for r in results)),
        PaperRow(BETWEEN, math.nan, tuple(r["between"] for r in both)),
        PaperRow(BEYOND, math.nan, tuple(r["beyond"] for r in both)),
    ]


def median_of(values: Sequence[float]) -> tuple[float, float]:
    """Median of `values`, and half the width of its 68 % interval by order statistics."""
    n, ordered = len(values), sorted(values)
    off = 0.5 * math.sqrt(n)
    low, high = max(0, math.floor(0.5 * n - off)), min(n - 1, math.ceil(0.5 * n + off) - 1)
    return float(np.median(ordered)), 0.5 * (ordered[high] - ordered[low])


def judge4(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Rahimi] Fig. 4: the estimate is close to the truth, and worst at both ends and beyond sightings."""
    whole = _mean_row(table, ALL)
    parts = np.array([r.values for r in v.series(table, ALL)])
    ends = PaperRow("ends", math.nan, _rms(parts[[0, -1]]))
    middle = PaperRow("middle", math.nan, _rms(parts[1:-1]))
    between, beyond = v.row_of(table, BETWEEN), v.row_of(table, BEYOND)
    median, side = whole.extra["median"], 2.0 * HALF
    rule = f"at most {CLOSE:.0%} of the room's side; in part up to twice that"
    statement = (
        f"The estimated trajectory is close to the true one: median RMSE [m] of the problems (mean {whole.mean:.3g})."
    )
    near, fair = v.at_most(CLOSE * side), v.at_most(2.0 * CLOSE * side)
    out = [
        v.judge(
            "fig4-close", statement, estimate(median, whole.extra["median_error"], whole.runs), near, fair, rule=rule
        ),
        v.pairs("fig4-ends", "The first and last tenth are worse than the rest, by this much [m].", [(middle, ends)]),
    ]
    if between.runs:
        statement = "Errors before the first or after the last detection are larger than between two [m]."
        out.append(v.pairs("fig4-beyond", statement, [(between, beyond)]))
    return out


def _rms(parts: Floats) -> tuple[float, ...]:
    """Root mean squares over the rows of `parts` (parts, runs), one for each run."""
    return tuple(np.sqrt(np.mean(parts**2, axis=0)).tolist())


def problems_plan(size: Size) -> PlanFigure:
    """Picture of problems from the best to the worst."""
    solved = ranked(size)
    ranks = sorted({round(q * (len(solved) - 1)) for q in (0.05, 0.25, 0.5, 0.75, 0.9, 1.0)})
    panels = tuple(panel(f"{k + 1} of {len(solved)}: RMSE {error(solved[k]):.2f} m", solved[k]) for k in ranks)
    caption = "problems by rising error; dots are times at which a camera saw the target."
    return PlanFigure("More problems", caption, sparse_scene(known_range=True), panels)


def fig5(size: Size, execute: Execute) -> Table:
    """Table of the RMSE [m] of every problem with each kind of constraints, by rising error without; and the means."""
    found = v.run_trials(KINDS, size, execute, lambda name, run: sparse_spec(size, run, **KINDS[name]))
    order = sorted(range(size.runs), key=lambda run: found[0][1][run]["rmse"])
    rows = []
    for name, own in found:
        for rank, run in enumerate(order, start=1):
            extra = {key: own[run][key] for key in ("behind", "measurements", "converged", "iterations")}
            rows.append(PaperRow(name, rank, (own[run]["rmse"],), {"problem": float(run + 1), **extra}))
        rows.append(PaperRow(name, math.nan, tuple(r["rmse"] for r in own)))
    return rows


def _mean_row(table: Table, name: str) -> PaperRow:
    """Row of all problems in a series, the one without x."""
    return next(r for r in table if r.series == name and math.isnan(r.x))


def judge5(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Rahimi] Fig. 5: field-of-view constraints keep paths before the cameras and lower the error."""
    low, high, room = (_mean_row(table, name) for name in (WITH, WITHOUT, ROOM))
    behind = {name: [r.extra["behind"] for r in v.series(table, name)] for name in (WITH, WITHOUT)}
    n, (kept, lost) = low.runs, (sum(b > 0 for b in behind[name]) for name in (WITH, WITHOUT))
    points, of = sum(behind[WITHOUT]), sum(r.extra["measurements"] for r in v.series(table, WITHOUT))
    gap = difference_of(low, high)
    ratio = quotient_of(low, high)
    saved = estimate(1.0 - ratio.value, ratio.error, ratio.runs)
    return [
        v.judge(
            "fig5-behind",
            "Without the constraints the dynamics pull trajectories behind cameras that saw the "
            f"target: share of the problems ({points:.0f} of {of:.0f} measurements).",
            share_of(lost, n),
            v.at_least(SOME),
            v.above(0.0),
            rule=f"at least {SOME:.0%} of the problems; in part if any",
        ),
        v.judge(
            "fig5-front",
            "With them no trajectory is behind a camera that saw the target: problems in which one is.",
            exact(float(kept), n),
            v.at_most(0.0),
            rule="none",
            paper=0.0,
        ),
        v.judge(
            "fig5-no-worse",
            "The error is no worse with the constraints: lower by so much [m].",
            gap,
            v.at_least(-v.NEGLIGIBLE * high.mean),
            rule=f"higher by less than {v.NEGLIGIBLE:.0%}",
        ),
        v.judge(
            "fig5-critical",
            "The constraints are critical in recovering the trajectories: share by which the mean "
            "RMSE is lower with them.",
            saved,
            v.above(CRITICAL),
            v.above(0.0),
            rule=f"above {CRITICAL:.0%}; in part above 0",
        ),
        v.pairs(
            "fig5-room",
            "Known walls help (Secs. 7 and 8): the error is lower if room and ranges are constraints, "
            "too, by this much [m].",
            [(room, low)],
        ),
    ]


def constraints_plan(size: Size) -> PlanFigure:
    """Picture of the problems that have most points behind cameras without the constraints."""
    free = [solve_problem(sparse_spec(size, run, in_front_constraint=False)) for run in range(size.runs)]
    worst = sorted(range(size.runs), key=lambda run: -_behind(free[run]))[:3]
    panels = []
    for run in [r for r in worst if _behind(free[r])] or worst[:1]:
        held = solve_problem(sparse_spec(size, run))
        title = f"problem {run + 1}: {_behind(free[run])} points behind"
        panels.append(panel(title, held, EstimatedPath(WITH, held.xy), EstimatedPath(WITHOUT, free[run].xy)))
    caption = "the problems that have most points behind a camera that saw the target, if nothing keeps them before it."
    return PlanFigure("With the constraints and without them", caption, sparse_scene(known_range=True), tuple(panels))


def _behind(solved: Solved) -> int:
    """Number of the measurements at times when the solution is behind the camera."""
    at = sightings(solved.problem.bearings, solved.tracks.t_ns)
    return int(np.count_nonzero(np.sum((solved.xy[at.state] - at.position) * at.axis, axis=1) <= 0.0))


FIG4 = sparse_experiment(
    item="fig4",
    title="Error along the trajectory",
    x_label="part of the trajectory",
    y_label="RMSE [m]",
    compute=fig4,
    judge=judge4,
    note="Steps of 0.5 s; the room is 10 m wide.",
    plans={"problems": problems_plan},
)
FIG5 = sparse_experiment(
    item="fig5",
    title="With the field-of-view constraints and without",
    x_label="problem, by rising error",
    y_label="RMSE [m]",
    compute=fig5,
    judge=judge5,
    note="Lines across are means.",
    plans={"constraints": constraints_plan},
)
