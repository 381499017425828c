"""[Ercan] Fig. 14: error with and without priors, in a simulated stand-in for the paper's lab."""

from __future__ import annotations

from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.model import Execute, Experiment, Size, Table, Verdict
from occlog.papers.verdicts.trials import KNOWN, NONE, PRIOR, Point, judge_worst_case, kalman, run_points, worst_case

from .scenes import LAB_ORDER, lab, names
from .selection import LAB_Q, LAB_SIGMA, LAB_WORLD, lab_trial, priors_error


def fig14(size: Size, execute: Execute) -> Table:
    """Compute the RMSE against the number of cameras, for known positions, priors and neither."""
    counts = (2, 5, 9) if size.quick else tuple(range(1, 10))
    kinds = {NONE: {"kind": "none"}, PRIOR: kalman(LAB_SIGMA, LAB_Q), KNOWN: kalman(0.0)}
    points = [
        Point(name, n, lab_trial(size, priors, cameras=names(LAB_ORDER[:n])))
        for n in counts
        for name, priors in kinds.items()
    ]
    return [*run_points(points, size, execute), worst_case(lab(), LAB_WORLD, size)]


def judge14(table: Table) -> list[Verdict]:
    """Judge the statements about Fig. 14."""
    known_none = v.matched(table, KNOWN, NONE)
    out = [
        v.pairs("fig14-known", "Known positions give a lower error than priors.", v.matched(table, KNOWN, PRIOR)),
        v.pairs("fig14-priors", "Priors give a lower error than none.", v.matched(table, PRIOR, NONE)),
        v.close("fig14-small", "The difference is small against the variation over the runs.", known_none),
    ]
    for key, name in (("known", KNOWN), ("priors", PRIOR), ("none", NONE)):
        said = f"Every further camera lowers the error ({name})."
        out.append(v.pairs(f"fig14-cameras-{key}", said, v.neighbours(v.series(table, name))))
    return [*out, *priors_error("fig14", table, 12.1), *judge_worst_case(table, "fig14", 77.5)]


FIG14 = Experiment(
    item="fig14",
    title="Error and number of cameras, stand-in for the lab",
    x_label="cameras",
    y_label="RMSE [in]",
    runs=50,
    steps=200,
    quick=(2, 60),
    compute=fig14,
    judge=judge14,
    note="Simulated: 16 cameras of 47 degrees, M = 20.",
)
