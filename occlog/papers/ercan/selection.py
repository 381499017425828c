"""[Ercan] Figs. 12 and 15: tracking with selected cameras, by each policy; Fig. 14: with and without priors in the lab.

The lab of Figs. 14 and 15 is a simulated stand-in for the paper's.

[Ercan] Sec. 5: the error of tracking against the time between two selections, in the room of Fig. 12.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, Size, StatementVerdict, Table
from occlog.pipeline.sweep.trial import Spec, Values

from .trial import (
    KNOWN,
    L_ORDER,
    LAB_ORDER,
    NONE,
    PRIOR,
    TrialPoint,
    judge_cameras,
    judge_priors,
    judge_worst_case,
    kalman,
    l_room,
    lab,
    names,
    priors_error,
    run_points,
    trial,
    worst_case,
)

GREEDY, BRUTE, FIXED, RANDOM, CLOSEST, ALL = "greedy", "brute force", "fixed", "random", "closest", "all cameras"
WEAK = ", weak perspective"
HEURISTICS = (FIXED, RANDOM, CLOSEST)
L_WORLD = {"occluders": 40}
L_SIGMA = 16.0
"""Deviation of the virtual measurements that gives the paper's RMSE_occ of 11.5 in the L-shaped room."""
LAB_WORLD: Values = {"occluders": 20, "step_s": 1.0 / 7.5, "diameter": 12.0}
LAB_TRACK = {"occluder_diameter": 12.0}
LAB_SIGMA, LAB_Q = 12.8, 24.0
"""Deviation and motion noise that give the paper's RMSE_occ of 12.1 inches in the lab, at 7.5 steps a second."""
LAB_SKIP = 5
"""Steps at the start that the RMSE omits."""
EVERY, LAB_EVERY = 5.0, 5.0 / 7.5
"""Five steps between selections, in the tracker's reference steps of a second."""


def _select(policy: str, count: int, order: Sequence[int], every: float, model: str = "perspective") -> Values:
    return {
        "policy": policy,
        "n_cameras": count,
        "selection_interval": every,
        "max_blind_scans": 0,
        "model": model,
        "camera_order": names(order),
    }


def _policies(k: int, order: Sequence[int], both: bool) -> dict[str, Values]:
    """Settings of the selection of k cameras by each policy, by the name of the series.

    `order` has the numbers of the cameras in the order of the fixed policy; `both`: with both camera models, else
    with the weak-perspective one alone.
    """
    out, every = {}, EVERY if both else LAB_EVERY
    for name, policy in ((GREEDY, "greedy"), (BRUTE, "brute-force")):
        if both:
            out[name] = _select(policy, k, order, every)
        out[name + (WEAK if both else "")] = _select(policy, k, order, every, "weak")
    return out | {p: _select(p, k, order, every, "weak") for p in HEURISTICS if p != FIXED or k <= len(order)}


def fig12(size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the number of selected cameras in the L-shaped room."""
    counts = (2, 4, 6) if size.quick else (2, 3, 4, 5, 6)
    scene, priors = l_room(), kalman(L_SIGMA)
    points = [
        TrialPoint(name, k, trial(scene, size, L_WORLD, priors, select=select))
        for k in counts
        for name, select in _policies(k, L_ORDER, both=True).items()
    ]
    points.append(TrialPoint(ALL, math.nan, trial(scene, size, L_WORLD, priors)))
    return [*run_points(points, size, execute), worst_case(scene, L_WORLD, size)]


def judge12(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 12: greedy selection of cameras against brute force, heuristics and all cameras."""
    six, everything = v.find(table, GREEDY, 6), v.find(table, ALL)
    out = [
        v.close("fig12-brute-force", "Greedy selection is close to brute force.", v.matched(table, GREEDY, BRUTE)),
        *_heuristics("fig12", table),
        _worst_of(table),
        v.close(
            "fig12-weak-greedy",
            "The weak-perspective model does as well (greedy).",
            v.matched(table, GREEDY, GREEDY + WEAK),
        ),
        v.close(
            "fig12-weak-brute",
            "The weak-perspective model does as well (brute force).",
            v.matched(table, BRUTE, BRUTE + WEAK),
        ),
    ]
    if six is not None and everything is not None:
        statement = "Six cameras selected greedily do as well as all twelve."
        out.append(v.close("fig12-six", statement, [(everything, six)]))
    return [*out, *priors_error("fig12", table, 11.5), *judge_worst_case(table, "fig12", 47.9)]


def _worst_of(table: Table) -> StatementVerdict:
    others = [n for n in (GREEDY, BRUTE, RANDOM, CLOSEST) if v.series(table, n)]
    points = [pair for name in others for pair in v.matched(table, name, FIXED)]
    return v.pairs("fig12-fixed-worst", "A fixed choice is the worst of all.", points)


def _heuristics(item: str, table: Table) -> list[StatementVerdict]:
    return [
        v.pairs(
            f"{item}-{name}",
            f"Greedy selection is better than the policy `{name}`.",
            v.matched(table, GREEDY, name),
        )
        for name in HEURISTICS
    ]


def lab_trial(size: Size, priors: Values, **more: Any) -> Spec:
    """Specification of a trial in the stand-in for the lab; its RMSE leaves out the first `LAB_SKIP` steps.

    Args:
        size: steps, particles and seed.
        priors: kind of priors.
        **more: further values of the trial.
    """
    return trial(lab(), size, LAB_WORLD, priors, track=LAB_TRACK, skip=LAB_SKIP, **more)


def fig15(size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the number of selected cameras in the lab, with the weak-perspective model."""
    counts = (2, 4) if size.quick else (2, 3, 4, 5, 6)
    priors = kalman(LAB_SIGMA, LAB_Q)
    points = [
        TrialPoint(name, k, lab_trial(size, priors, select=select))
        for k in counts
        for name, select in _policies(k, LAB_ORDER, both=False).items()
    ]
    points.append(TrialPoint(ALL, math.nan, lab_trial(size, priors)))
    return [*run_points(points, size, execute), worst_case(lab(), LAB_WORLD, size)]


def judge15(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 15: greedy selection of cameras in the lab against brute force and heuristics."""
    return [*judge_greedy("fig15", table), *priors_error("fig15", table, 12.1)]


def judge_greedy(item: str, table: Table) -> list[StatementVerdict]:
    """Verdicts on greedy selection against brute force and heuristics, and on the size of the differences."""
    statement = "Greedy selection is close to brute force."
    points = [pair for name in HEURISTICS for pair in v.matched(table, GREEDY, name)]
    return [
        v.close(f"{item}-brute-force", statement, v.matched(table, GREEDY, BRUTE)),
        *_heuristics(item, table),
        v.close(f"{item}-variation", "The differences are no larger than the variation over the runs.", points),
    ]


FIG12 = Experiment(
    item="fig12",
    title="Policies of selection, L-shaped room",
    x_label="selected cameras",
    y_label="RMSE",
    runs=10,
    steps=4000,
    quick=(2, 60),
    compute=fig12,
    judge=judge12,
    note="M = 40, selection every 5 steps.",
)
_in_the_lab = functools.partial(
    Experiment,
    y_label="RMSE [in]",
    runs=50,
    steps=200,
    quick=(2, 60),
    note="Simulated: 16 cameras of 47 degrees, M = 20.",
)
FIG15 = _in_the_lab(
    item="fig15",
    title="Policies of selection, stand-in for the lab",
    x_label="selected cameras",
    compute=fig15,
    judge=judge15,
)


def fig14(size: Size, execute: Execute) -> Table:
    """Table of the RMSE against the number of cameras, for known positions of occluders, priors, and neither."""
    counts = (2, 5, 9) if size.quick else tuple(range(1, 10))
    kinds: dict[str, Values] = {NONE: {"kind": "none"}, PRIOR: kalman(LAB_SIGMA, LAB_Q), KNOWN: kalman(0.0)}
    points = [
        TrialPoint(name, n, lab_trial(size, priors, cameras=names(LAB_ORDER[:n])))
        for n in counts
        for name, priors in kinds.items()
    ]
    return [*run_points(points, size, execute), worst_case(lab(), LAB_WORLD, size)]


def judge14(table: Table) -> list[StatementVerdict]:
    """Verdicts on [Ercan] Fig. 14: priors of occluders and more cameras lower the error."""
    known_none = v.matched(table, KNOWN, NONE)
    return [
        *judge_priors("fig14", table),
        v.close("fig14-small", "The difference is small against the variation over the runs.", known_none),
        *judge_cameras("fig14", table),
        *priors_error("fig14", table, 12.1),
        *judge_worst_case(table, "fig14", 77.5),
    ]


FIG14 = _in_the_lab(
    item="fig14",
    title="Error and number of cameras, stand-in for the lab",
    x_label="cameras",
    compute=fig14,
    judge=judge14,
)


COUNT = 3
PERIODS, QUICK_PERIODS = (1, 5, 25), (1, 25)
"""Steps between selections; those of Fig. 12 are 5."""


def by_period(size: Size, execute: Execute) -> Table:
    """Table of the RMSE with greedily selected cameras against the number of steps between selections.

    Runs of one number have the same world for all periods.
    """
    points = []
    for every in map(float, QUICK_PERIODS if size.quick else PERIODS):
        select = _select("greedy", COUNT, L_ORDER, every)
        points.append(TrialPoint(GREEDY, every, trial(l_room(), size, L_WORLD, kalman(L_SIGMA), select=select)))
    return run_points(points, size, execute)


def judge(table: Table) -> list[StatementVerdict]:
    """Verdict, as a list, on whether the RMSE is lower the more often cameras are selected; table of `by_period`."""
    rows = v.series(table, GREEDY)
    statement = "Selecting again more often gives better tracking: RMSE lower with the shorter time, by."
    return [v.pairs("selection-period", statement, list(pairwise(rows)))]


SELECTION_PERIOD = Experiment(
    item="selection-period",
    title="Error and time between selections",
    x_label="steps between selections",
    y_label="RMSE",
    runs=10,
    steps=1000,
    quick=(2, 60),
    compute=by_period,
    judge=judge,
    note="Three of twelve cameras by the greedy policy, in the L-shaped room of Fig. 12 with 40 occluders.",
)
