"""The loop check of [Qu] Sec. 3.4.2: trackers put on a wrong target, and wrong epipolar lines.

BMCT runs several times on every video: sound, with two trackers of a view exchanged after a while,
and with wrong epipolar lines.

[Qu] Sec. 3.2: iterating between the views where a target is close to others in all of them.

The paper begins with a view at random and tracks there without help, then goes back and forth between the views.  BMCT
has `sweeps` for the number of times; all are run on the same videos, with the same seeds of the trackers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from occlog.papers import verdicts as v
from occlog.papers.qu.common import LITTLE, RATES, ordered, rate_row, seed_of
from occlog.papers.qu.trial import views_experiment, views_spec
from occlog.papers.verdicts import (
    Execute,
    PaperRow,
    Size,
    StatementVerdict,
    Table,
    difference_of,
    sample,
    share_of,
)
from occlog.simulate.balls.config import BallsConfig

SHIFTS = (0, 10, 20, 30, 45, 60, 90)
OTHERS = {"turned by 20 degrees": ["turn", 20], "turned by 90 degrees": ["turn", 90], "not known": "none"}
INJECTED = 3
"""Pairs of trackers that are exchanged in each video, one at a time."""
AT = 0.1
"""Share of the video after which they are exchanged."""
WITHIN = 60
"""Frames within which a wrong tracker should be noticed, or be back on its target."""
MOSTLY = 0.8
"""Share of the wrong trackers that counts as all: what 24 of them can show."""
BMCT, IDMOT = "BMCT", "IDMOT"


def _methods(quick: bool, frames: int) -> dict[str, dict[str, object]]:
    """Settings by label of IDMOT and of BMCT with every shift, every other kind of wrong lines, and every exchange.

    Args:
        quick: whether only some of them are made.
        frames: frames of the video, for the time of the exchange.
    """
    pairs, at = range(1 if quick else INJECTED), max(1, round(AT * frames))
    shifts, balls = SHIFTS[::3] if quick else SHIFTS, BallsConfig().balls
    others = {} if quick else OTHERS
    return {
        "idmot": {"method": "idmot"},
        **{f"shift {d}": {"method": "bmct", "fundamental": ["shift", d] if d else "true"} for d in shifts},
        **{name: {"method": "bmct", "fundamental": kind} for name, kind in others.items()},
        **{f"wrong {k}": {"method": "bmct", "wrong": [1, k, (k + 1) % balls, at]} for k in pairs},
    }


def loop(size: Size, execute: Execute) -> Table:
    """Table of rates [%] of BMCT against the shift of the lines, with other wrong lines, and of injected failures."""
    methods = _methods(size.quick, size.steps)
    specs = [views_spec(seed_of(size, run), methods, {"frames": size.steps}) for run in range(size.runs)]
    results = execute(specs)
    rows = []
    for rate, name in RATES.items():
        rows.append(rate_row(f"{IDMOT}, {name}", math.nan, results, "idmot", rate))
        for label in methods:
            if label.startswith("shift "):
                row = rate_row(f"{BMCT}, {name}", float(label[6:]), results, label, rate)
                rows.append(_alarmed(row, results, label))
            elif label in OTHERS:
                row = rate_row(f"{BMCT}, lines {label}, {name}", math.nan, results, label, rate, plotted=False)
                rows.append(_alarmed(row, results, label))
    return [*rows, *_injected(methods, results)]


def _alarmed(row: PaperRow, results: Sequence[Mapping[str, float]], label: str) -> PaperRow:
    """Copy of a row with the mean figures of the loop check as further columns.

    Args:
        row: row of rates of one method.
        results: figures of each run by name.
        label: prefix of the method in the names of the figures.
    """
    extra = dict(row.extra)
    for name in ("checked", "bad", "false_alarm", "missed"):
        given = [r[f"{label}.{name}"] for r in results if not math.isnan(r[f"{label}.{name}"])]
        extra[name] = math.fsum(given) / len(given) if given else math.nan
    each = {name: tuple(r[f"{label}.{name}"] for r in results) for name in ("bad", "false_alarm")}
    return replace(row, extra=extra, each=each)


def _injected(methods: Iterable[str], results: Sequence[Mapping[str, float]]) -> list[PaperRow]:
    """Rows on the trackers that were exchanged: frames until noticed, until back for good, and whether in time.

    Args:
        methods: labels of the methods; those that begin with `wrong` count.
        results: figures of each run by name.
    """
    labels = [label for label in methods if label.startswith("wrong ")]
    columns = {"noticed": "frames until a wrong tracker is noticed", "returned": "frames until it is back for good"}
    rows = [
        PaperRow(name, math.nan, tuple(r[f"{label}.{key}"] for label in labels for r in results), {}, plotted=False)
        for key, name in columns.items()
    ]
    over = tuple(min(a, b) for a, b in zip(rows[0].values, rows[1].values, strict=True))
    return [
        *(_finite(r) for r in rows),
        PaperRow(OVER, math.nan, tuple(float(x <= WITHIN) for x in over), {}, plotted=False),
    ]


OVER = f"noticed or back within {WITHIN} frames"


def _finite(row: PaperRow) -> PaperRow:
    """Row with the finite values of `row` alone; their share and their median are further columns."""
    kept = tuple(x for x in row.values if math.isfinite(x))
    extra = {"share": len(kept) / row.runs, "median": float(np.median(kept)) if kept else math.nan}
    return PaperRow(row.series, row.x, kept, extra, plotted=row.plotted)


def judge_loop(table: Table) -> list[StatementVerdict]:
    """Verdicts on what the check notices, how often it is wrong, and whether BMCT is inferior to IDMOT."""
    out = [*_noticed(table), *_alarms(table)]
    for rate, name in RATES.items():
        idmot, right = v.row_of(table, f"{IDMOT}, {name}"), v.row_of(table, f"{BMCT}, {name}", 0.0)
        statement = f"With the right lines the rate of {name} of BMCT is below that of IDMOT, by [%]."
        out.append(ordered(f"loop-{rate}-right", statement, right, idmot))
        wrong = [r for r in v.series(table, f"{BMCT}, {name}") if r.x > 0]
        wrong += [r for r in table if r.series.startswith(f"{BMCT}, lines") and r.series.endswith(name)]
        out.append(_not_inferior(rate, name, idmot, wrong))
    return out


def _noticed(table: Table) -> list[StatementVerdict]:
    """Verdict on whether exchanged trackers are noticed, or back, within `WITHIN` frames; empty without such rows."""
    over = v.row_of(table, OVER)
    noticed = next(r for r in table if r.series.startswith("frames until a wrong tracker"))
    statement = (
        f"A tracker that was put on another target is noticed, or finds back, within {WITHIN} frames: share of them "
        f"(noticed: {noticed.extra['share']:.0%}, those after a median of {noticed.extra['median']:.3g} frames)."
    )
    over_all = share_of(round(math.fsum(over.values)), over.runs)
    rule = f"at least {MOSTLY:.0%}; in part half"
    return [v.judge("loop-noticed", statement, over_all, v.at_least(MOSTLY), v.at_least(0.5), rule=rule)]


def _alarms(table: Table) -> list[StatementVerdict]:
    """Verdicts on false alarms with the right lines, and on alarms with lines 45 px or more away, if there are rows."""
    rows = v.series(table, f"{BMCT}, {RATES['fr_p']}")
    out = []
    if rows and rows[0].x == 0.0:
        statement = (
            "False alarms are rare: share of the checks of sound targets with the result bad, with the right lines."
        )
        false, rule = sample(_known(rows[0].each["false_alarm"])), "at most 1 %; in part 5 %"
        out.append(v.judge("loop-false-alarms", statement, false, v.at_most(0.01), v.at_most(0.05), rule=rule))
    far = [r.each["bad"] for r in rows if r.x >= 45.0]
    if far:
        statement = "Wrong lines are noticed: share of the checks with the result bad, with lines 45 px and more away."
        of_runs = [math.fsum(run) / len(run) for run in zip(*far, strict=True)]
        bad, rule = sample(_known(of_runs)), "at least half; in part 20 %"
        out.append(v.judge("loop-wrong-lines", statement, bad, v.at_least(0.5), v.at_least(0.2), rule=rule))
    return out


def _known(values: Iterable[float]) -> list[float]:
    """The values without NaN."""
    return [x for x in values if not math.isnan(x)]


def _not_inferior(rate: str, name: str, idmot: PaperRow, wrong: Sequence[PaperRow]) -> StatementVerdict:
    """Verdict on whether BMCT with wrong lines has no higher rate than IDMOT; the worst difference is shown.

    Args:
        rate: `fr_p` or `fr_l`.
        name: words for this rate.
        idmot: row of IDMOT.
        wrong: rows of BMCT, one for each kind of wrong lines.
    """
    points = [v.StatementPoint(difference_of(idmot, r), v.at_most(LITTLE)) for r in wrong]
    worst = max((p.measure for p in points), key=lambda m: m.value, default=None)
    statement = f"BMCT is never inferior to IDMOT, even with wrong lines: rate of {name} higher at worst by [%]."
    rule = f"higher by less than {LITTLE:g} %, for each kind of wrong lines"
    return v.judge_points(f"loop-{rate}-not-inferior", statement, points, rule=rule, paper=0.0, shown=worst)


LOOP = views_experiment(
    item="loop",
    title="Wrong trackers and wrong epipolar lines (of this project)",
    x_label="shift of the epipolar lines [px]",
    y_label="rate [%]",
    runs=8,
    quick=(2, 40),
    compute=loop,
    judge=judge_loop,
    note="The synthetic video; lines across: IDMOT, which uses no other view.",
)


SWEEPS = (1, 2, 4)


def sweeps(size: Size, execute: Execute) -> Table:
    """Table of the rates of false positions and false labels [%] of BMCT against the number of sweeps over views."""
    methods = {f"bmct {n}": {"method": "bmct", "set": {"sweeps": n}} for n in SWEEPS}
    results = execute([views_spec(seed_of(size, run), methods, {"frames": size.steps}) for run in range(size.runs)])
    return [
        rate_row(name, float(n), results, f"bmct {n}", rate, plotted=True)
        for rate, name in RATES.items()
        for n in SWEEPS
    ]


def judge_sweeps(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether a second sweep helps, and whether more than two gain nothing."""
    out = []
    for rate, name in RATES.items():
        once, twice, often = (v.row_of(table, name, float(n)) for n in SWEEPS)
        statement = f"Iterating gives better estimates: rate of {name} with two sweeps below that with one, by [%]."
        out.append(ordered(f"sweeps-{rate}-helps", statement, twice, once))
        statement = f"Twice is enough: rate of {name} with two sweeps above that with four, by [%]."
        rule = f"by at most {LITTLE:g} %; in part by {2.0 * LITTLE:g} %"
        more, limits = difference_of(often, twice), (v.at_most(LITTLE), v.at_most(2.0 * LITTLE))
        out.append(v.judge(f"sweeps-{rate}-enough", statement, more, *limits, rule=rule))
    return out


SWEEPING = views_experiment(
    item="sweeps",
    title="Iterating between the views",
    x_label="sweeps over the views",
    y_label="rate [%]",
    quick=(2, 40),
    compute=sweeps,
    judge=judge_sweeps,
    note="Six balls of radius 22 px, two views, BMCT.",
)
