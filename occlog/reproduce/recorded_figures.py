"""[Ercan] Figs. 14 and 15 on recorded detections with virtual occluders thrown over them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import combinations

from ..trackers.select import SelectConfig
from . import verdicts as v
from .model import Execute, Experiment, Row, Size, Table, Verdict
from .recorded import CLEAR, Crowd, crowd_of, crowd_size, trial
from .recorded_target import Recorded
from .selection import ALL, BRUTE, CLOSEST, FIXED, GREEDY, HEURISTICS, RANDOM
from .trials import KNOWN, NONE, PRIOR

NOBODY = "nobody hides anything"
KINDS = {NONE: "none", PRIOR: "kalman", KNOWN: "known", NOBODY: CLEAR}
ITEMS = ("fig14-recorded", "fig15-recorded")
RUNS = 20
EVERY = 1.0 / 7.5 * 5
"""Seconds between selections, as in the stand-in for the lab."""
Figures = dict[str, float]
Line = tuple[str, float, list[Figures]]
"""Series, x and the figures of every run."""


def recorded_experiments(recorded: Recorded) -> tuple[Experiment, Experiment]:
    """The two experiments on a recorded target; all of its times are used."""
    steps = len(recorded.places)
    quick = (2, min(60, steps))
    note = (
        f"Recorded detections, M = {crowd_size(recorded.scene)} virtual people; "
        "error against where the sight lines of all cameras meet."
    )
    return (
        Experiment(ITEMS[0], "Error and number of cameras, recorded detections", "cameras", "RMSE [m]", RUNS, steps,
                   quick, partial(fig14, recorded), judge14, note=note),
        Experiment(ITEMS[1], "Policies of selection, recorded detections", "selected cameras", "RMSE [m]", RUNS,
                   steps, quick, partial(fig15, recorded), judge15, note=note),
    )  # fmt: skip


def fig14(recorded: Recorded, size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """RMSE against the number of cameras, each the root mean square over all sets of so many."""
    names = recorded.cameras
    lines: list[Line] = [(name, n, []) for n in range(2, len(names) + 1) for name in KINDS]
    for run in range(size.runs):
        crowd = crowd_of(recorded, size.seed + run)
        for name, n, runs in lines:
            runs.append(_over(recorded, crowd, list(combinations(names, int(n))), KINDS[name], size, run))
    return [_row(*line) for line in lines]


def _over(
    recorded: Recorded, crowd: Crowd, sets: Sequence[Sequence[str]], kind: str, size: Size, run: int
) -> Figures:  # fmt: skip
    """Figures of one run over several sets of cameras: the root of the mean square, and means."""
    found = [trial(recorded, crowd, kind, cameras, size, size.seed + run) for cameras in sets]
    mean = {name: math.fsum(f[name] for f in found) / len(found) for name in ("rmse_occ", "hidden")}
    return {"rmse": math.sqrt(math.fsum(f["rmse"] ** 2 for f in found) / len(found)), **mean}


def fig15(recorded: Recorded, size: Size, execute: Execute) -> Table:  # noqa: ARG001
    """RMSE against the number of selected cameras, with priors and the weak-perspective model."""
    names = recorded.cameras
    lines: list[tuple[Line, SelectConfig | None]] = [((name, k, []), s) for name, k, s in _selections(len(names))]
    for run in range(size.runs):
        crowd = crowd_of(recorded, size.seed + run)
        for (_, _, runs), select in lines:
            runs.append(trial(recorded, crowd, "kalman", names, size, size.seed + run, select))
    return [_row(*line) for line, _ in lines]


def _selections(cameras: int) -> Iterator[tuple[str, float, SelectConfig | None]]:
    policies = {GREEDY: "greedy", BRUTE: "brute-force", FIXED: "fixed", RANDOM: "random", CLOSEST: "closest"}
    for k in range(2, cameras):
        for name, policy in policies.items():
            yield name, k, SelectConfig(policy, k, EVERY, "weak")
    yield ALL, math.nan, None


def _row(name: str, x: float, runs: Sequence[Figures]) -> Row:
    def mean(key: str) -> float:
        values = [r[key] for r in runs if not math.isnan(r[key])]
        return math.fsum(values) / len(values) if values else math.nan

    return Row(name, x, tuple(r["rmse"] for r in runs), {"rmse_occ": mean("rmse_occ"), "hidden": mean("hidden")})


def judge14(table: Table) -> list[Verdict]:
    """Statements about Fig. 14."""
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
    """Statements about Fig. 15."""
    item, said = ITEMS[1], "Greedy selection is close to brute force."
    out = [v.close(f"{item}-brute-force", said, v.matched(table, GREEDY, BRUTE))]
    for name in HEURISTICS:
        said = f"Greedy selection is better than the policy `{name}`."
        out.append(v.pairs(f"{item}-{name}", said, v.matched(table, GREEDY, name)))
    points = [pair for name in HEURISTICS for pair in v.matched(table, GREEDY, name)]
    said = "The differences are no larger than the variation over the runs."
    return [*out, v.close(f"{item}-variation", said, points)]
