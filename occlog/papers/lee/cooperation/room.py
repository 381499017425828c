"""[Lee] Figs. 3-18 to 3-21: times at which two sensors in a room ask cameras, and errors of the final positions."""

from __future__ import annotations

import math
from collections.abc import Callable

from occlog.papers import verdicts as v
from occlog.papers.verdicts import Execute, Experiment, PaperRow, Size, StatementVerdict, Table, mean_of
from occlog.pipeline.sweep.trial import Spec

from .trial import BIN, cooperation_spec, cooperation_trial

WITH, WITHOUT = "with cameras", "without"
NAMES = ("A1", "A2")
RATE = 100.0
"""Steps a second."""
CERTAIN = 0.9
"""Share of the steps with a request from which a trigger counts as permanent."""


def shares(first: int, last: int) -> Callable[[Size, Execute], Table]:
    """Create a function that computes the table of the share of steps with requests, for steps `first` to `last`.

    The shares are over bins of `BIN` steps; x is the time of a bin's middle [s].
    """

    def compute(size: Size, execute: Execute) -> Table:
        table = []
        for a, name in enumerate(NAMES):
            for way in (WITH, WITHOUT):
                results = execute(_specs(size, a, way))
                for n in range(first // BIN, min(last, size.steps) // BIN):
                    values = tuple(r[f"share_{n}"] for r in results)
                    table.append(PaperRow(f"{name}, {way}", (n + 0.5) * BIN / RATE, values))
        return table

    return compute


def _specs(size: Size, array: int, way: str) -> list[Spec]:
    return [
        cooperation_spec(size, r, "room", "thesis", array, way == WITH, cooperate="printed") for r in range(size.runs)
    ]


def finals(size: Size, execute: Execute) -> Table:
    """Table of position errors [m] at the last step, with and without cameras, for each target that an array hears."""
    table = []
    for a, name in enumerate(NAMES):
        for way in (WITH, WITHOUT):
            results = execute(_specs(size, a, way))
            for k in (1, 2, 3):
                values = tuple(r[f"final_{k}"] for r in results if f"final_{k}" in r)
                if values and not any(math.isnan(x) for x in values):
                    table.append(PaperRow(f"{name}, {way}", float(k), values))
    return table


def _average(table: Table, series: str, since: float, until: float) -> PaperRow | None:
    """Row of the means of a series over times from `since` to before `until` [s], run by run; None without times."""
    rows = [r for r in v.series(table, series) if since <= r.x < until]
    if not rows:
        return None
    values = tuple(math.fsum(x) / len(x) for x in zip(*(r.values for r in rows), strict=True))
    return PaperRow(series, 0.5 * (since + until), values)


def judge_shares(key: str, since: float, until: float) -> Callable[[Table], list[StatementVerdict]]:
    """Create a function that judges [Lee]'s statement that an array asks cameras less often if it uses their answers.

    The function takes a table of the share of steps in which the filter of an array asks cameras for positions, with
    and without use of the answers. It returns a verdict for each of the arrays A1 and A2 that the table has.

    Args:
        key: begin of the verdicts' ids.
        since: begin of the interval over which the shares are averaged [s].
        until: its end, excluded [s].
    """

    def judge(table: Table) -> list[StatementVerdict]:
        out = []
        for name in NAMES:
            used, left = (_average(table, f"{name}, {way}", since, until) for way in (WITH, WITHOUT))
            if used is not None and left is not None:
                statement = f"{name} asks less often if it gets answers ({since:g} to {until:g} s)."
                out.append(v.pairs(f"{key}-{name}", statement, [(used, left)]))
        return out

    return judge


def judge_silence(table: Table) -> list[StatementVerdict]:
    """Verdicts on the statements about [Lee] Fig. 3-19: fewer requests with answers, and that silence makes A1 ask."""
    out = judge_shares("fig3.19", 7.0, 11.0)(table)
    row = _average(table, f"A1, {WITH}", 5.0, 7.0)
    if row is not None:
        statement = (
            "While object 1 is silent A1 asks: number of objects and of measurements differ (share of the steps)."
        )
        out.insert(0, _certain("fig3.19-silence", statement, row))
    return out


def _certain(key: str, statement: str, row: PaperRow) -> StatementVerdict:
    rule = f"share of at least {CERTAIN:g}; in part from 0.5"
    return v.judge(key, statement, mean_of(row), v.at_least(CERTAIN), v.at_least(0.5), rule=rule)


def judge_final(table: Table) -> list[StatementVerdict]:
    """Verdicts on the statement of [Lee] Fig. 3-21 that with cameras the last positions are nearer to the truth."""
    out = []
    for name in NAMES:
        points = v.matched(table, f"{name}, {WITH}", f"{name}, {WITHOUT}")
        if points:
            statement = f"Final positions of {name} are nearer to the truth with cameras."
            out.append(v.pairs(f"fig3.21-{name}", statement, points))
    return out


NOTE = (
    "Printed triggers, one filter a sensor; ranges, speeds and cameras that are not printed are in the documentation."
)


def _figure(
    item: str, title: str, first: int, last: int, judge: Callable[[Table], list[StatementVerdict]]
) -> Experiment:
    return Experiment(
        item=item,
        title=title,
        x_label="time [s]",
        y_label="share of steps with a request",
        runs=30,
        steps=last + 1,
        quick=(2, min(last, first + 200) + 1),
        compute=shares(first, last),
        judge=judge,
        note=NOTE,
        trial=cooperation_trial,
    )


ROOM_EXPERIMENTS = (
    _figure("fig3.18", "Requests from 0 to 5 s", first=0, last=500, judge=judge_shares("fig3.18", 0.0, 5.0)),
    _figure("fig3.19", "Requests from 5 to 11 s", first=500, last=1100, judge=judge_silence),
    _figure("fig3.20", "Requests from 11 to 19 s", first=1100, last=1900, judge=judge_shares("fig3.20", 11.0, 19.0)),
    Experiment(
        item="fig3.21",
        title="Errors of the final positions",
        x_label="object",
        y_label="error [m]",
        runs=30,
        steps=1901,
        quick=(2, 101),
        compute=finals,
        judge=judge_final,
        note=NOTE,
        trial=cooperation_trial,
    ),
)
