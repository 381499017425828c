"""The few figures on top of a report, and how many rows it was made from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from occlog.console.text import noun
from occlog.evaluate.mot.headline import own_identities
from occlog.records.verdicts import Check, Verdict, all_plausible, counts_of, made_checks
from occlog.report.content.metrics_in_words import Figure, number
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.content.people import People


def plural(count: int, what: str) -> str:
    """`1 target`, `2 targets`."""
    return f"{number(count)} {noun(count, what)}"


def headline(data: ReportInput) -> list[Figure]:
    """The few figures on top of the page: accuracy first, then how much was processed."""
    out = _accuracy(data)
    if data.time.length > 0:
        out.append(Figure("recorded time", number(float(f"{data.time.length:.4g}")), data.time.unit))
    if data.people is not None:
        out += _people(data.people)
    elif data.tracks is not None:
        out.append(Figure("estimates", number(data.rows("tracks")), "", f"of {plural(len(data.targets), 'target')}"))
    looked = data.looked
    if looked is not None and looked.rows:
        share = 100.0 * (looked.seen / looked.rows)
        out.append(Figure("target seen", number(round(share, 1)), "%", f"of {number(looked.rows)} looks"))
    if data.losses:
        lost = sum(loss.count for loss in data.losses)
        out.append(Figure("input lost", number(lost or len(data.losses)), "", "items" if lost else "stretches"))
    return out


def _people(people: People) -> list[Figure]:
    """How many people there were, all in all and at a time, and how many of them nobody saw."""
    at_a_time = number(float(f"{people.mean:.3g}"))
    unseen = number(round(100.0 * people.unseen, 1))
    return [
        Figure("identities", number(people.identities), "", f"{at_a_time} at a time"),
        Figure("predicted", unseen, "%", f"seen by no camera, of {number(people.rows)} estimates"),
    ]


def _accuracy(data: ReportInput) -> list[Figure]:
    """RMSE, bound and their ratio over all targets; without truth, the distance from the sight lines."""
    if own_identities(data.metrics):
        return _pairs(data)
    if data.errors is None or not len(data.errors):
        return _sight(data)
    out = [Figure("RMSE", number(data.figures.errors.rmse()), data.unit, "estimate to truth")]
    if data.bound is not None and len(data.bound):
        rmse, bound = data.beside_bound()
        if bound > 0:
            who = "smoother" if data.smoothed else "filter"
            out.append(Figure("bound", number(bound), data.unit, f"no {who} can do better"))
            out.append(Figure("RMSE / bound", number(round(rmse / bound, 3)), "", "1 is the best possible"))
    return out + _in_space(data)


def _pairs(data: ReportInput) -> list[Figure]:
    """Figures of tracks with identities of their own, of the evaluation."""
    unit = data.unit
    value = {name: found for name, found in data.metrics.items() if isinstance(found, int | float)}
    gate = f"matching per frame, {number(value.get(f'pairs_gate_{unit}'))} {unit} gate"
    shown = (
        ("HOTA", "hota", "", "detection and association"),
        ("IDF1", "idf1", "", "share of rows with the right identity"),
        ("MOTA", "mota", "", "1 is the best possible"),
        ("identity switches", "id_switches", "", ""),
        ("RMSE", f"pairs_rmse_{unit}", unit, gate),
        ("mean NEES", "pairs_nees_mean", "", "2 where covariances are right"),
    )
    return [Figure(name, number(value[key]), of, note) for name, key, of, note in shown if key in value]


def _in_space(data: ReportInput) -> list[Figure]:
    """RMSE in space and over its bound, where heights are known."""
    whole = data.figures.errors.rmse_in_space()
    if math.isnan(whole):
        return []
    rmse, bound = (math.nan, math.nan) if data.bound is None else data.beside_bound(where="_space")
    note = f"{number(round(rmse / bound, 3))} × bound" if bound > 0 else "heights included"
    return [Figure("RMSE in space", number(whole), data.unit, note)]


def _sight(data: ReportInput) -> list[Figure]:
    """RMS distance of the tracks from where the sight lines meet."""
    told = [each for each in data.sight.values() if each.rows]
    rows = sum(each.rows for each in told)
    off = math.sqrt(math.fsum(each.rms**2 * each.rows for each in told) / rows) if rows else math.nan
    return [] if math.isnan(off) else [Figure("off sight lines", number(off), data.unit, "RMS; no truth is given")]


def row_counts(data: ReportInput) -> list[Figure]:
    """How many rows each table has, and the time it covers."""
    out = []
    for name in ("truth", "bearings", "tracks", "diagnostics", "events", "errors", "bound"):
        if getattr(data, name) is None:
            continue
        if not data.rows(name):
            out.append(Figure(name, "0", "rows", "empty"))
            continue
        lasted = TimeAxis(*data.whole[name].span_ns).told
        moments = plural(data.whole[name].times, "time")
        out.append(Figure(name, number(data.rows(name)), "rows", f"{lasted}, {moments}"))
    return out


class CheckRow(NamedTuple):
    """A row of the table of checks."""

    name: str
    stage: str
    result: str
    figures: str
    who: str


def verdict_heading(verdicts: Sequence[Verdict]) -> str:
    """The verdict in a line."""
    return {
        True: "Nothing speaks against these estimates",
        False: "Not to be believed as they are",
        None: "Not checked: nothing is known for or against these estimates",
    }[all_plausible(verdicts)]


def check_rows(verdicts: Sequence[Verdict]) -> list[CheckRow]:
    """What was checked, with results, figures and the reasons of what could not be checked."""
    return [
        CheckRow(check.name, stage, _result(check), _figures(check), affected(check))
        for stage, check in made_checks(verdicts)
    ]


def check_counts(verdicts: Sequence[Verdict]) -> str:
    """How many checks were made, and how they came out."""
    return counts_of(check for _, check in made_checks(verdicts))


def affected(check: Check) -> str:
    """Sensors and targets that a finding is about."""
    targets = [f"target {target}" for target in check.targets]
    return ", ".join([*check.sensors, *targets])


def _result(check: Check) -> str:
    if check.status == "not applicable":
        return f"not applicable: {check.text}"
    return ", ".join([check.status, *([check.id] if check.id else [])])


def _figures(check: Check) -> str:
    words = {name: name.replace("_", " ") for name in check.figures}
    return ", ".join(f"{words[name]} {number(value)}" for name, value in check.figures.items())
