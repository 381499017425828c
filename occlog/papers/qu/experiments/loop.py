"""The loop check of [Qu] Sec. 3.4.2: trackers put on a wrong target, and wrong epipolar lines.

BMCT runs several times on every video: sound, with two trackers of a view exchanged after a while,
and with wrong epipolar lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from occlog.papers.qu.common import RATES, SURE, bootstrap_share, ordered, rate_row, seed_of
from occlog.papers.qu.trial import run_views_trial, views_spec
from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.model import Execute, Experiment, Row, Size, Table, Verdict
from occlog.simulate.balls.config import BallsConfig

SHIFTS = (0, 10, 20, 30, 45, 60, 90)
OTHERS = {"turned by 20 degrees": ["turn", 20], "turned by 90 degrees": ["turn", 90], "not known": "none"}
INJECTED = 3
"""Pairs of trackers that are exchanged in each video, one at a time."""
AT = 0.1
"""Share of the video after which they are exchanged."""
WITHIN = 60
"""Frames within which a wrong tracker should be noticed, or be back on its target."""
BMCT, IDMOT = "BMCT", "IDMOT"


def _methods(quick: bool, frames: int) -> dict[str, dict[str, object]]:
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
    """Compute rates [%] of BMCT against the shift of the lines, with other wrong lines, and with injected failures."""
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


def _alarmed(row: Row, results: Sequence[Mapping[str, float]], label: str) -> Row:
    """Return the row with the mean figures of the loop check."""
    extra = dict(row.extra)
    for name in ("checked", "bad", "false_alarm", "missed"):
        given = [r[f"{label}.{name}"] for r in results if not math.isnan(r[f"{label}.{name}"])]
        extra[name] = math.fsum(given) / len(given) if given else math.nan
    return Row(row.series, row.x, row.values, extra, plotted=row.plotted)


def _injected(methods: Iterable[str], results: Sequence[Mapping[str, float]]) -> list[Row]:
    labels = [label for label in methods if label.startswith("wrong ")]
    columns = {"noticed": "frames until a wrong tracker is noticed", "returned": "frames until it is back for good"}
    rows = [
        Row(name, math.nan, tuple(r[f"{label}.{key}"] for label in labels for r in results), {}, plotted=False)
        for key, name in columns.items()
    ]
    over = tuple(min(a, b) for a, b in zip(rows[0].values, rows[1].values, strict=True))
    return [
        *(_finite(r) for r in rows),
        Row(OVER, math.nan, tuple(float(x <= WITHIN) for x in over), {}, plotted=False),
    ]


OVER = f"noticed or back within {WITHIN} frames"


def _finite(row: Row) -> Row:
    """Return the row of its finite values, with their share and median."""
    kept = tuple(x for x in row.values if math.isfinite(x))
    extra = {"share": len(kept) / row.runs, "median": float(np.median(kept)) if kept else math.nan}
    return Row(row.series, row.x, kept, extra, plotted=row.plotted)


def judge_loop(table: Table) -> list[Verdict]:
    """Judge what the check notices, how often it is wrong, and whether BMCT is inferior to IDMOT."""
    out = [*_noticed(table), *_alarms(table)]
    for rate, name in RATES.items():
        idmot, right = v.find(table, f"{IDMOT}, {name}"), v.find(table, f"{BMCT}, {name}", 0.0)
        if idmot is None or right is None:
            continue
        said = f"With the right lines the rate of {name} of BMCT is below that of IDMOT, by [%]."
        out.append(ordered(f"loop-{rate}-right", said, right, idmot))
        wrong = [r for r in v.series(table, f"{BMCT}, {name}") if r.x > 0]
        wrong += [r for r in table if r.series.startswith(f"{BMCT}, lines") and r.series.endswith(name)]
        out.append(_not_inferior(rate, name, idmot, wrong))
    return out


def _noticed(table: Table) -> list[Verdict]:
    over = v.find(table, OVER)
    noticed = next((r for r in table if r.series.startswith("frames until a wrong tracker")), None)
    if over is None or noticed is None:
        return []
    word = v.REPRODUCED if over.mean >= 0.9 else v.IN_PART if over.mean >= 0.5 else v.NOT
    said = (
        f"A tracker that was put on another target is noticed, or finds back, within {WITHIN} frames: share of them "
        f"(noticed: {noticed.extra['share']:.0%}, those after a median of {noticed.extra['median']:.3g} frames)."
    )
    return [
        Verdict(
            "loop-noticed",
            said,
            paper=None,
            measured=over.mean,
            error_bar=over.error,
            runs=over.runs,
            verdict=word,
            rule="at least 90 %; in part half",
        )
    ]


def _alarms(table: Table) -> list[Verdict]:
    rows = v.series(table, f"{BMCT}, {RATES['fr_p']}")
    out = []
    if rows and rows[0].x == 0.0:
        false = rows[0].extra["false_alarm"]
        word = v.REPRODUCED if false <= 0.01 else v.IN_PART if false <= 0.05 else v.NOT
        said = "False alarms are rare: share of the checks of sound targets that say bad, with the right lines."
        out.append(
            Verdict(
                "loop-false-alarms",
                said,
                paper=None,
                measured=false,
                error_bar=None,
                runs=rows[0].runs,
                verdict=word,
                rule="at most 1 %; in part 5 %",
            )
        )
    far = [r for r in rows if r.x >= 45.0]
    if far:
        bad = math.fsum(r.extra["bad"] for r in far) / len(far)
        word = v.REPRODUCED if bad >= 0.5 else v.IN_PART if bad >= 0.2 else v.NOT
        said = "Wrong lines are noticed: share of the checks that say bad, with lines 45 px and more away."
        out.append(
            Verdict(
                "loop-wrong-lines",
                said,
                paper=None,
                measured=bad,
                error_bar=None,
                runs=far[0].runs,
                verdict=word,
                rule="at least half; in part 20 %",
            )
        )
    return out


def _not_inferior(rate: str, name: str, idmot: Row, wrong: Sequence[Row]) -> Verdict:
    """Judge that no rate is higher by more than chance: the reverse order does not hold by the rule of `ordered`."""
    gaps = [np.subtract(r.values, idmot.values) for r in wrong]
    held = [bootstrap_share(gap) < SURE for gap in gaps]
    worst = max(range(len(gaps)), key=lambda i: float(np.mean(gaps[i]))) if gaps else None
    gap, error = (None, None) if worst is None else v.difference(idmot, wrong[worst])
    said = f"BMCT is never inferior to IDMOT, even with wrong lines: rate of {name} higher at worst by [%]."
    rule = f"not above it in {SURE:.0%} of bootstrap samples: {sum(held)} of {len(held)} kinds of wrong lines"
    return Verdict(
        f"loop-{rate}-not-inferior",
        said,
        paper=0.0,
        measured=gap,
        error_bar=error,
        runs=idmot.runs,
        verdict=v.share(held),
        rule=rule,
    )


LOOP = Experiment(
    item="loop",
    title="Wrong trackers and wrong epipolar lines (of this project)",
    x_label="shift of the epipolar lines [px]",
    y_label="rate [%]",
    runs=8,
    steps=400,
    quick=(2, 40),
    compute=loop,
    judge=judge_loop,
    trial=run_views_trial,
    note="The synthetic video; lines across: IDMOT, which uses no other view.",
)
