"""[Qu] Table 1: CPU time of the three likelihoods of BMCT."""

from __future__ import annotations

import math

from occlog.papers import verdicts as v
from occlog.papers.qu.common import seed_of
from occlog.papers.qu.trial import views_experiment, views_spec
from occlog.papers.verdicts import Execute, PaperRow, Size, StatementVerdict, Table, quotient_of

LOCAL, INTERACTION, COLLABORATION, STEP = "local", "interaction", "collaboration", "whole step"
PRINTED_MS = {LOCAL: 57.0, INTERACTION: 5.7, COLLABORATION: 3.0}
COLUMNS = {LOCAL: "local_ms", INTERACTION: "interaction_ms", COLLABORATION: "collaboration_ms", STEP: "step_ms"}
SMALL, SOME = 0.2, 0.5
"""Shares of the local likelihood that count as negligible, and as in part."""


def table1(size: Size, execute: Execute) -> Table:
    """Table of the mean CPU time of a frame of both views [ms], for each likelihood and for the whole step."""
    methods = {"bmct": {"method": "bmct", "timed": True}}
    results = execute([views_spec(seed_of(size, run), methods, {"frames": size.steps}) for run in range(size.runs)])
    rows = []
    for x, (name, column) in enumerate(COLUMNS.items(), start=1):
        values = tuple(r[f"bmct.{column}"] for r in results)
        whole = math.fsum(r["bmct.step_ms"] for r in results)
        extra = {"share_of_step": math.fsum(values) / whole, "printed": PRINTED_MS.get(name, math.nan)}
        rows.append(PaperRow(name, float(x), values, extra))
    return rows


def judge1(table: Table) -> list[StatementVerdict]:
    """Verdicts on the costs of collaboration and of interaction relative to the local likelihood ([Qu] Table 1)."""
    local, interaction, collaboration = (v.row_of(table, name) for name in (LOCAL, INTERACTION, COLLABORATION))
    out = []
    for name, row in ((COLLABORATION, collaboration), (INTERACTION, interaction)):
        what = "is negligible" if name == COLLABORATION else "costs much less than the local one"
        statement = f"The {name} likelihood {what}: its time over that of the local likelihood."
        rule = f"at most {SMALL:g}; in part {SOME:g}"
        small, some, printed = v.at_most(SMALL), v.at_most(SOME), PRINTED_MS[name] / PRINTED_MS[LOCAL]
        out.append(v.judge(f"table1-{name}", statement, quotient_of(row, local), small, some, rule=rule, paper=printed))
    statement = "Collaboration costs less than interaction, by [ms] a frame."
    return [*out, v.pairs("table1-order", statement, [(collaboration, interaction)])]


TABLE1 = views_experiment(
    item="table1",
    title="Time of the likelihoods of BMCT",
    x_label="1 local, 2 interaction, 3 collaboration, 4 whole step",
    y_label="CPU time of a frame [ms]",
    runs=5,
    quick=(2, 30),
    compute=table1,
    judge=judge1,
    note="Six balls, two views, 60 particles. The printed times sum to 65.7 ms, 15 frames a second; the printed "
    "speed is 9 to 10.",
)
