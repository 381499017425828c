"""The two failures of IDMOT that [Qu] Sec. 4.1 explains by Fig. 7b, each in its own scene with a control.

Two balls meet in one view, and separate in the other view.  The count is how many of the two trackers are not
on their own target in the last frame of the view in which they met, after they have parted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from occlog.papers import verdicts as v
from occlog.papers.qu.common import ordered, seed_of
from occlog.papers.qu.trial import views_experiment, views_spec
from occlog.papers.verdicts import Execute, PaperRow, Size, StatementVerdict, Table, mean_of
from occlog.pipeline.sweep.trial import Spec

SHOWN = ("mipf", "idmot", "bmct")
"""The methods of Fig. 7."""
OFTEN = 25.0
"""Trackers off their target at the end [%] that count as a failure; a coin toss for each pair has 50."""
ENDS = {"end_other": "on the other", "end_none": "on none"}


class MechanismCase(NamedTuple):
    """Staged scene of two balls that meet in one view.

    Attributes:
        scene: name of the scene.
        view: index of the view in which the balls meet; it is judged.
        label: words for the scene, in the names of series.
        clutter: number of balls in the background.
    """

    scene: str
    view: int
    label: str
    clutter: int = 6


CASES = (
    MechanismCase("together", 0, "same direction, long occlusion"),
    MechanismCase("together", 0, "same direction, no clutter", clutter=0),
    MechanismCase("opposite", 0, "opposite directions"),
    MechanismCase("overtaking", 1, "same line, overtakes"),
    MechanismCase("falling-back", 1, "same line, falls back"),
    MechanismCase("right-angle", 1, "right angle"),
    MechanismCase("row-overtaking", 1, "same epipolar line, overtakes"),
    MechanismCase("row-falling-back", 1, "same epipolar line, falls back"),
)
"""Scenes in the order of the table."""
DIRECTION, LINE, ROW = (CASES[0],), CASES[3:5], CASES[6:]
"""Scenes of the first mechanism, of the second, and of the second without help of the other view."""


def mechanisms(size: Size, execute: Execute) -> Table:
    """Table of the trackers off their own target at the end [%], with the shares of those on the other and on none."""
    found = v.run_trials(CASES, size, execute, lambda case, run: _spec(size, run, case))
    rows = []
    for m in SHOWN:
        for x, (case, own) in enumerate(found, start=1):
            values = tuple(100.0 * (1.0 - r[f"{m}.pair_end_own"]) for r in own)
            each = {name: tuple(100.0 * r[f"{m}.pair_{key}"] for r in own) for key, name in ENDS.items()}
            extra = {name: sum(shares) / len(shares) for name, shares in each.items()}
            rows.append(PaperRow(f"{m.upper()}: {case.label}", float(x), values, extra, each=each))
    return rows


def _spec(size: Size, run: int, case: MechanismCase) -> Spec:
    """Specification of a trial of the methods `SHOWN` on one video of a case; `size` and `run` give the seed."""
    methods = {m: {"method": m} for m in SHOWN}
    balls = {"frames": size.steps, "balls": 2, "background_clutter": case.clutter}
    return views_spec(seed_of(size, run), methods, balls, scene=case.scene, watched={"pair": [case.view, [0, 1]]})


def judge_mechanisms(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether each mechanism makes IDMOT fail, whether its control does not, and whether BMCT helps."""
    out: list[StatementVerdict] = []
    for key, cases, control, what, why in (
        ("direction", DIRECTION, CASES[2], DIRECTION[0].label, "absence of distinct inertia directions"),
        ("line", LINE, CASES[5], "same line", "similar inertia"),
    ):
        idmot, bmct, free = (
            _mean(table, m, of) for m, of in (("IDMOT", cases), ("BMCT", cases), ("IDMOT", (control,)))
        )
        statement = f"IDMOT fails ({what}): trackers off their target after the balls have parted [%]."
        because = f"That is due to the {why}: more trackers off than with {control.label}, by [%]."
        rectified = f"BMCT rectifies it ({what}): fewer trackers off than with IDMOT, by [%]."
        rule, often, seldom = (
            f"at least {OFTEN:g} %; in part a fifth of that",
            v.at_least(OFTEN),
            v.at_least(0.2 * OFTEN),
        )
        out += [
            v.judge(f"fig7-{key}-fails", statement, mean_of(idmot), often, seldom, rule=rule),
            ordered(f"fig7-{key}-cause", because, free, idmot),
            ordered(f"fig7-{key}-bmct", rectified, bmct, idmot),
        ]
    return out + _ends(table)


def _mean(table: Table, method: str, cases: Sequence[MechanismCase], end: str = "") -> PaperRow:
    """Row of the means of a method over some cases, run by run.

    Args:
        table: table of `mechanisms`.
        method: name of the method in it.
        cases: scenes to take the mean of.
        end: value of `ENDS`: the share of trackers that end there; empty: of all that end off their target.
    """
    rows = [v.row_of(table, f"{method}: {case.label}") for case in cases]
    values = [r.each[end] if end else r.values for r in rows]
    return PaperRow(method, math.nan, tuple(math.fsum(x) / len(x) for x in zip(*values, strict=True)))


def _ends(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether labels are exchanged, clutter attracts trackers, and BMCT helps on one epipolar line."""
    out = []
    exchanged, lost = (_mean(table, "IDMOT", LINE, end) for end in ENDS.values())
    statement = "Labels are exchanged (same line): trackers of IDMOT on the other ball, more than on none, by [%]."
    out.append(ordered("fig7-line-exchanged", statement, lost, exchanged))
    some, none = (_mean(table, "IDMOT", (case,), ENDS["end_none"]) for case in CASES[:2])
    statement = "A strong clutter attracts a tracker (same direction): more on no ball than without clutter, by [%]."
    out.append(ordered("fig7-direction-clutter", statement, none, some))
    idmot, bmct = (_mean(table, m, ROW) for m in ("IDMOT", "BMCT"))
    statement = "BMCT rectifies it on an epipolar line, too (same epipolar line): fewer off than with IDMOT, by [%]."
    out.append(ordered("fig7-row-bmct", statement, bmct, idmot))
    return out


MECHANISMS = views_experiment(
    item="fig7-mechanisms",
    title="Two ways in which IDMOT fails",
    x_label="scene: " + ", ".join(f"{k + 1} {case.label}" for k, case in enumerate(CASES)),
    y_label="trackers off their target at the end [%]",
    runs=24,
    steps=120,
    quick=(2, 40),
    compute=mechanisms,
    judge=judge_mechanisms,
    note="Two balls of radius 22 px that meet in one view and are separate in the other. On the same epipolar line the "
    "other view cannot determine one from the other.",
)
"""The mechanisms of Fig. 7b."""
