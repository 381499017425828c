"""[Rahimi] Fig. 3: refinement of a trajectory by the search, and its number of iterations."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from occlog.papers import verdicts as v
from occlog.papers.plots import EstimatedPath, PlanFigure, PlanPanel
from occlog.papers.verdicts import Execute, PaperRow, Size, StatementVerdict, Table, exact, sample, share_of

from .example import sparse_scene
from .trial import Solved, sightings, solve_problem, sparse_experiment, sparse_spec

RAY, DISTANCE, PLACE, MOVING = "off the rays", "distance error", "error", "problems that go on"
SHOWN = (0, 1, 3, 9, 11, 17)
"""Iterations that the paper shows."""
PAPER_ITERATIONS = 17.0
MOST, HALF_OF_THEM = 0.9, 0.5
"""Shares of the problems that count as all, as fifty problems can show, and as in part."""
LEFT = 0.1
"""A figure has settled when this share of its whole change, or less, is left."""


def fig3(size: Size, execute: Execute) -> Table:
    """Table of residuals and errors after every iteration, over those of the start, and of the problems that go on."""
    results = execute([sparse_spec(size, run) for run in range(size.runs)])
    last = int(max(r["iterations"] for r in results))
    rows = []
    for name, key in ((RAY, "ray"), (DISTANCE, "distance"), (PLACE, "place")):
        for k in range(last + 1):
            values = [r.get(f"{key}_{k}", r[f"{key}_{int(r['iterations'])}"]) for r in results]
            shares = tuple(x / r[f"{key}_0"] for x, r in zip(values, results, strict=True))
            rows.append(PaperRow(name, k, shares, {"absolute": math.fsum(values) / len(values)}))
    rows += [PaperRow(MOVING, k, tuple(map(float, _moving(results, k)))) for k in range(last + 1)]
    rows[0].extra["start_off"] = max(r["start_off"] for r in results)
    return rows


def _moving(results: Sequence[Mapping[str, float]], k: int) -> list[bool]:
    """Whether each problem goes on after iteration k; one that does not converge goes on for ever.

    `results`: figures of each problem.
    """
    return [k < r["iterations"] or not r["converged"] for r in results]


def settled(values: Sequence[float]) -> int:
    """First iteration from which on values stay within `LEFT` of their whole change from the last one."""
    change = abs(values[0] - values[-1])
    late = [k for k, x in enumerate(values) if abs(x - values[-1]) > LEFT * change]
    return late[-1] + 1 if late else 0


def judge3(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Rahimi] Fig. 3, and Secs. 5 and 6: start, course and convergence of the search."""
    ray, distance, position = (np.array([r.values for r in v.series(table, n)]) for n in (RAY, DISTANCE, PLACE))
    runs = ray.shape[1]
    lined, placed = ([settled(column.tolist()) for column in x.T] for x in (ray, distance))
    rays = PaperRow(RAY, math.nan, tuple(map(float, lined)))
    distances = PaperRow(DISTANCE, math.nan, tuple(map(float, placed)))
    then = PaperRow(DISTANCE, math.nan, tuple(float(distance[k, i]) for i, k in enumerate(lined)))
    end, start, best = (PaperRow("", math.nan, tuple(x.tolist())) for x in (distance[-1], position[0], position[-1]))
    return [
        _start(table[0].extra["start_off"], runs),
        v.pairs(
            "fig3-rays",
            "The points are on the rays, by this many iterations, before their distances are right.",
            [(rays, distances)],
        ),
        v.pairs(
            "fig3-prior",
            "Then the prior pulls them to the right distances: that error falls, by this share of its first value.",
            [(end, then)],
        ),
        v.pairs(
            "fig3-closer",
            "The refined trajectory is closer to the truth than the start, by this share of the start's error.",
            [(best, start)],
        ),
        *_iterations(v.series(table, MOVING)),
    ]


def _start(off: float, runs: int) -> StatementVerdict:
    """Verdict on whether the search starts as the paper states; `off`: largest deviation [m] in any problem."""
    statement = (
        "The search starts with seen points 1 m along the axes and unseen ones at the origin: largest deviation [m]."
    )
    rule = "below 1e-6 m in every problem"
    return v.judge("fig3-start", statement, exact(off, runs), v.below(1e-6), rule=rule, paper=0.0)


def _iterations(moving: Sequence[PaperRow]) -> list[StatementVerdict]:
    """Verdicts on whether every problem converges, and after how many iterations.

    `moving`: rows by iteration, 1 for each problem that goes on after it, else 0.
    """
    open_ = round(math.fsum(moving[-1].values))
    runs = moving[-1].runs
    counts = [math.fsum(values) for values in zip(*(r.values for r in moving), strict=True)]
    statement = (
        f"Iterations until it has converged (median {float(np.median(counts)):g}, most {max(counts):g}; "
        "the paper shows one problem)."
    )
    converged, rule = share_of(runs - open_, runs), f"at least {MOST:.0%}; in part at least {HALF_OF_THEM:.0%}"
    most, half = v.at_least(MOST), v.at_least(HALF_OF_THEM)
    return [
        v.judge("fig3-converges", "Problems converge: share of them.", converged, most, half, rule=rule),
        v.stated("fig3-iterations", statement, PAPER_ITERATIONS, sample(counts)),
    ]


@functools.lru_cache(maxsize=4)
def ranked(size: Size) -> tuple[Solved, ...]:
    """Solutions of all problems, by rising error; the last few results are kept."""
    solved = [solve_problem(sparse_spec(size, run)) for run in range(size.runs)]
    return tuple(sorted(solved, key=error))


def error(solved: Solved) -> float:
    """RMSE of an estimate over all steps [m]."""
    return float(np.sqrt(np.mean(np.sum((solved.xy - solved.true_xy) ** 2, axis=1))))


def panel(title: str, solved: Solved, *estimates: EstimatedPath) -> PlanPanel:
    """Drawing of a problem, with a title and the given estimates; without any, with the solution."""
    at = sightings(solved.problem.bearings, solved.tracks.t_ns)
    seen = np.isin(np.arange(len(solved.tracks)), at.state)
    return PlanPanel(title, solved.true_xy, seen, estimates or (EstimatedPath("estimate", solved.xy),))


def iterations_plan(size: Size) -> PlanFigure:
    """Picture of the problem of median error after some iterations."""
    solved = ranked(size)[size.runs // 2]
    last = len(solved.iterates) - 1
    shown = [k for k in SHOWN if k < last] + [last]
    panels = [panel(f"iteration {k}", solved, EstimatedPath("estimate", solved.iterates[k])) for k in shown]
    panels[-1] = panels[-1]._replace(title=f"iteration {last}, the last one")
    caption = (
        f"the problem of median error ({error(solved):.2f} m RMSE) after some iterations; dots are times at which a "
        "camera saw the target."
    )
    return PlanFigure("Refinement of a trajectory", caption, sparse_scene(known_range=True), tuple(panels[:6]))


FIG3 = sparse_experiment(
    item="fig3",
    title="Refinement of a trajectory",
    x_label="iteration",
    y_label="share of the start's value",
    compute=fig3,
    judge=judge3,
    note="Residuals of the bearings, errors of the distances from the cameras, errors of all positions.",
    plans={"iterations": iterations_plan},
)
