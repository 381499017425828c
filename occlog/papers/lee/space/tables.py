"""[Lee] Tables 2.1 and 2.2: ways to combine two planes, with right models and with a wrong one for 50 s."""

from __future__ import annotations

import functools
import math

from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, mean_of
from occlog.pipeline.sweep.trial import Spec

from .scenarios import root_mean
from .worlds import AXIS_NAMES, TABLE, space_spec, space_trial

EQUAL, WEIGHTED, INVERSE, DIRECT = "equal", "planes-weighted", "inverse variance", "direct3d"
WAYS = {
    EQUAL: ("pps", {"combining": "equal"}),
    WEIGHTED: ("pps", {"combining": "planes-weighted"}),
    INVERSE: ("pps", {"combining": "inverse"}),
    DIRECT: ("direct3d", {}),
}
PRINTED = {
    "2.1": {EQUAL: (1.8267, 0.5673, 1.6134), WEIGHTED: (1.7258, 0.5378, 1.6235)},
    "2.2": {EQUAL: (1.7958, 17.3250, 1.5783), WEIGHTED: (1.6459, 0.6243, 1.6431)},
}
PARTICLES = 1000
MEAN = 4.0
"""x of the average over the three components."""


def table_of(name: str, size: Size, execute: Execute) -> Table:
    """Table of the RMSE of each component and their average, as [Lee] Table 2.1 or 2.2 (`name`), by way to combine.

    The printed rule selects the planes.
    """

    def spec(way: str, run: int) -> Spec:
        method, settings = WAYS[way]
        own = {"selection": "printed", **settings, "wrong": name == "2.2"} if method == "pps" else settings
        return space_spec(size, run, TABLE, method=method, particles=PARTICLES, **own)

    rows = []
    for way, results in v.run_trials(WAYS, size, execute, spec):
        extra = {"xy_yz": math.fsum(r["xy_yz"] for r in results) / size.runs}
        parts = []
        for j, a in enumerate(AXIS_NAMES):
            square = [math.fsum(r[f"{a}_{k}"] for k in range(size.steps)) / size.steps for r in results]
            parts.append(root_mean(square))
            rows.append(PaperRow(way, j + 1.0, parts[-1], extra))
        rows.append(PaperRow(way, MEAN, tuple(sum(p) / 3.0 for p in zip(*parts, strict=True)), extra))
    return rows


def judge_table(name: str, table: Table) -> list[StatementVerdict]:
    """Verdicts on [Lee] Table 2.1 or 2.2 (`name`): how ways to combine planes compare, and the printed errors."""
    key = f"table{name}"
    out = []
    weighted, equal, inverse = (v.row_of(table, way, 2.0) for way in (WEIGHTED, EQUAL, INVERSE))
    if name == "2.1":
        statement = "With right models both combinations are equal: difference of the RMSE of y [m]."
        out.append(v.close(f"{key}-alike", statement, [(weighted, equal)]))
    else:
        statement = (
            "With a wrong model in one plane for 50 s the weights by planes keep the track: RMSE of y lower by [m]."
        )
        out.append(v.pairs(f"{key}-weighted", statement, [(weighted, equal)]))
        statement = (
            "Inverse variances do not notice a wrong model (of this project): RMSE of y lower with weights by planes."
        )
        out.append(v.pairs(f"{key}-inverse", statement, [(weighted, inverse)]))
    for way, printed in PRINTED[name].items():
        for j, value in enumerate(printed):
            row = v.row_of(table, way, j + 1.0)
            statement = f"RMSE of {AXIS_NAMES[j]} [m], {way} (the initial spread of the filters is not in the thesis)."
            out.append(v.stated(f"{key}-{way}-{AXIS_NAMES[j]}", statement, value, mean_of(row)))
    return out


def _experiment(name: str, title: str) -> Experiment:
    return Experiment(
        item=f"table{name}",
        title=title,
        x_label="component: 1 x, 2 y, 3 z, 4 their average",
        y_label="RMSE [m]",
        runs=100,
        steps=166,
        quick=(2, 80),
        compute=functools.partial(table_of, name),
        judge=functools.partial(judge_table, name),
        note="The plane yz takes its target for straight from 50 to 100 s." if name == "2.2" else "",
        trial=space_trial,
    )


TABLES = (
    _experiment("2.1", "Combining of planes with right models"),
    _experiment("2.2", "Combining of planes, one with a wrong model for 50 s"),
)
