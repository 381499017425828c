"""Robustness of the methods of [Qu] to motions other than straight paths: a random walk, and targets that manoeuvre.

[Qu] Sec. 4.1 states that the balls "move independently" and not how.  The videos of a run start equally and differ in
the motion alone.  `REMEDY` is BMCT with settings for targets that manoeuvre; they were chosen on the seeds 1001 to
1006.
"""

from __future__ import annotations

from occlog.papers import verdicts as v
from occlog.papers.qu.common import LITTLE, METHODS, RATES, everywhere, rate_row, seed_of
from occlog.papers.qu.trial import views_experiment, views_spec
from occlog.papers.verdicts import Execute, PaperRow, Size, StatementVerdict, Table, difference_of, mean_of
from occlog.pipeline.sweep.trial import Spec
from occlog.simulate.balls.config import MOTIONS

REMEDY = "bmct, remedy"
SETTINGS = {"sigma_px": 4.0, "keep_velocity": 0.7, "inertia": 1.0}
"""Settings of the remedy: more noise, a faster velocity update, and less weight on going on as before."""
LOW = 8.0
"""Largest rate of false labels [%] with which targets count as tracked; this project's criterion for Table 3."""


def motion(size: Size, execute: Execute) -> Table:
    """Table of false position and false label rates [%] of every method at every motion; x: 1 + index in `MOTIONS`."""
    found = v.run_trials(MOTIONS, size, execute, lambda motion, run: _spec(size, run, motion))
    return [
        rate_row(f"{label}, {name}", float(x), own, label, rate, plotted=rate == "fr_l")
        for rate, name in RATES.items()
        for label in (*METHODS, REMEDY)
        for x, (_, own) in enumerate(found, start=1)
    ]


def _spec(size: Size, run: int, motion: str) -> Spec:
    """Specification of a trial of all methods, and the remedy, on a video with the motion `motion`.

    `size` and `run` give the seed.
    """
    methods = {m: {"method": m} for m in METHODS} | {REMEDY: {"method": "bmct", "set": SETTINGS}}
    return views_spec(seed_of(size, run), methods, {"frames": size.steps, "ball_motion": motion})


def judge_motion(table: Table) -> list[StatementVerdict]:
    """Verdicts on BMCT against IDMOT at every motion, on whether it tracks manoeuvring targets, and on the remedy."""
    out = []
    for rate, name in RATES.items():
        statement = (
            f"BMCT is robust in different conditions: rate of {name} below that of IDMOT at every motion, by [%]."
        )
        out.append(everywhere(f"motion-{rate}", statement, v.matched(table, f"bmct, {name}", f"idmot, {name}")))
        for k, motion in enumerate(MOTIONS):
            plain, better = (v.row_of(table, f"{label}, {name}", k + 1.0) for label in ("bmct", REMEDY))
            out += _of_motion(rate, name, motion, plain, better)
    return [verdict for verdict in out if verdict is not None]


def _of_motion(rate: str, name: str, motion: str, plain: PaperRow, better: PaperRow) -> list[StatementVerdict]:
    """Verdicts on BMCT and its remedy at one motion.

    Args:
        rate: `fr_p` or `fr_l`.
        name: words for this rate.
        motion: one of `MOTIONS`.
        plain: row of BMCT.
        better: row of BMCT with the remedy.
    """
    key, out = f"motion-{motion}-{rate}", []
    if rate == "fr_l":
        statement = f"BMCT tracks the targets ({motion}): rate of {name} [%]."
        rule = f"at most {LOW:g} %; in part {2.0 * LOW:g} %"
        out.append(
            v.judge(f"{key}-followed", statement, mean_of(plain), v.at_most(LOW), v.at_most(2.0 * LOW), rule=rule)
        )
    if motion == "manoeuvre":
        statement = f"The remedy helps ({motion}): rate of {name} below that of BMCT, by [%]."
        rule = "above 0 by two standard errors, run by run"
        return [*out, v.judge(f"{key}-remedy", statement, difference_of(better, plain), v.above(0.0), rule=rule)]
    statement = f"The remedy costs nothing ({motion}): rate of {name} higher than that of BMCT, by [%]."
    rule = f"by at most {LITTLE:g} %; in part by {2.0 * LITTLE:g} %"
    worse = difference_of(plain, better)
    return [*out, v.judge(f"{key}-cost", statement, worse, v.at_most(LITTLE), v.at_most(2.0 * LITTLE), rule=rule)]


MOTION = views_experiment(
    item="motion",
    title="Straight ways, a random walk and manoeuvres",
    x_label="motion: 1 straight, 2 random walk, 3 manoeuvre",
    y_label="rate of false labels [%]",
    quick=(2, 40),
    compute=motion,
    judge=judge_motion,
    note="Six balls of radius 22 px, two views. Random walk: 3 px a frame along each axis; manoeuvre: accelerations of "
    "1 px/frame^2 along each axis, at most 6 px a frame. The remedy was chosen on other seeds.",
)
"""Statements about robustness, with the motion varied."""
