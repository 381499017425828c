"""[Ercan] Figs. 14 and 15 on recorded detections that virtual occluders hide."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

from occlog.papers.ercan.recorded.detections import CLEAR, Source, crowd_size, recorded_spec, recorded_trial
from occlog.papers.ercan.recorded.target import Recorded
from occlog.papers.ercan.selection import ALL, BRUTE, CLOSEST, FIXED, GREEDY, HEURISTICS, RANDOM
from occlog.papers.ercan.trial import KNOWN, NONE, PRIOR
from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.model import Execute, Experiment, Row, Size, Table, Verdict
from occlog.pipeline.sweep.trial import Spec

NOBODY = "nobody hides anything"
KINDS = {NONE: "none", PRIOR: "kalman", KNOWN: "known", NOBODY: CLEAR}
ITEMS = ("fig14-recorded", "fig15-recorded")
RUNS = 20
EVERY = 1.0 / 7.5 * 5
"""Seconds between selections, as in the stand-in for the lab."""
Figures = dict[str, float]


def recorded_experiments(source: Source, recorded: Recorded) -> tuple[Experiment, Experiment]:
    """Make the two experiments on a recorded target; the full form uses all of its times."""
    steps, names = len(recorded.places), recorded.cameras
    quick = (2, min(60, steps))
    note = (
        f"Recorded detections, M = {crowd_size(recorded.scene)} virtual people; "
        "error against where the sight lines of all cameras meet."
    )
    by_number = Experiment(
        item=ITEMS[0],
        title="Error and number of cameras, recorded detections",
        x_label="cameras",
        y_label="RMSE [m]",
        runs=RUNS,
        steps=steps,
        quick=quick,
        compute=partial(fig14, source, names),
        judge=judge14,
        note=note,
        trial=recorded_trial,
    )
    by_policy = replace(
        by_number,
        item=ITEMS[1],
        title="Policies of selection, recorded detections",
        x_label="selected cameras",
        compute=partial(fig15, source, names),
        judge=judge15,
    )
    return by_number, by_policy


def fig14(source: Source, names: Sequence[str], size: Size, execute: Execute) -> Table:
    """Compute the RMSE against the number of cameras, the root mean square over all sets of that number."""
    counts = range(2, len(names) + 1)
    sets = [list(some) for n in counts for some in combinations(names, n)]
    trials = [(run, name, cameras) for run in range(size.runs) for name in KINDS for cameras in sets]
    found = execute([recorded_spec(source, size, run, KINDS[name], cameras) for run, name, cameras in trials])
    runs: dict[tuple[int, str], list[list[Figures]]] = {
        (n, name): [[] for _ in range(size.runs)] for n in counts for name in KINDS
    }
    for (run, name, cameras), figures in zip(trials, found, strict=True):
        runs[len(cameras), name][run].append(figures)
    return [_row(name, n, [_over(figures) for figures in own]) for (n, name), own in runs.items()]


def _over(found: Sequence[Figures]) -> Figures:
    """Combine the figures of one run over several sets of cameras: root of the mean square, and means."""
    mean = {name: math.fsum(f[name] for f in found) / len(found) for name in ("rmse_occ", "hidden")}
    return {"rmse": math.sqrt(math.fsum(f["rmse"] ** 2 for f in found) / len(found)), **mean}


def fig15(source: Source, names: Sequence[str], size: Size, execute: Execute) -> Table:
    """Compute the RMSE against the number of selected cameras, with priors and the weak-perspective model."""
    points = list(_selections(len(names)))
    specs = [
        recorded_spec(source, size, run, "kalman", list(names), select=select)
        for run in range(size.runs)
        for _, _, select in points
    ]
    found = execute(specs)
    return [_row(name, k, found[i :: len(points)]) for i, (name, k, _) in enumerate(points)]


def _selections(cameras: int) -> Iterator[tuple[str, float, Spec | None]]:
    policies = {GREEDY: "greedy", BRUTE: "brute-force", FIXED: "fixed", RANDOM: "random", CLOSEST: "closest"}
    for k in range(2, cameras):
        for name, policy in policies.items():
            yield name, k, {"policy": policy, "count": k, "every": EVERY, "patience": 0, "model": "weak"}
    yield ALL, math.nan, None


def _row(name: str, x: float, runs: Sequence[Figures]) -> Row:
    def mean(key: str) -> float:
        values = [r[key] for r in runs if not math.isnan(r[key])]
        return math.fsum(values) / len(values) if values else math.nan

    return Row(name, x, tuple(r["rmse"] for r in runs), {"rmse_occ": mean("rmse_occ"), "hidden": mean("hidden")})


def judge14(table: Table) -> list[Verdict]:
    """Judge the statements about Fig. 14."""
    item = ITEMS[0]
    out = [
        v.pairs(f"{item}-known", "Known positions give a lower error than priors.", v.matched(table, KNOWN, PRIOR)),
        v.pairs(f"{item}-priors", "Priors give a lower error than none.", v.matched(table, PRIOR, NONE)),
    ]
    for key, name in (("known", KNOWN), ("priors", PRIOR), ("none", NONE)):
        said = f"Every further camera lowers the error ({name})."
        out.append(v.pairs(f"{item}-cameras-{key}", said, v.neighbours(v.series(table, name))))
    return out


def judge15(table: Table) -> list[Verdict]:
    """Judge the statements about Fig. 15."""
    item, said = ITEMS[1], "Greedy selection is close to brute force."
    out = [v.close(f"{item}-brute-force", said, v.matched(table, GREEDY, BRUTE))]
    for name in HEURISTICS:
        said = f"Greedy selection is better than the policy `{name}`."
        out.append(v.pairs(f"{item}-{name}", said, v.matched(table, GREEDY, name)))
    points = [pair for name in HEURISTICS for pair in v.matched(table, GREEDY, name)]
    said = "The differences are no larger than the variation over the runs."
    return [*out, v.close(f"{item}-variation", said, points)]
