"""Targets that one of two cameras does not see, as target 6 of the video *UnionStation* ([Qu] Sec. 4.2).

Three of six balls are not in the image of camera 1, neither as targets nor before others.  What is counted is how often
their trackers in camera 2 are off their own targets: without counterparts, with counterparts in camera 1 that sees them
after all, and with a third camera.
"""

from __future__ import annotations

from occlog.papers.qu.common import ordered, seed_of
from occlog.papers.qu.trial import run_views_trial, views_spec
from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.model import Execute, Experiment, Row, Size, Table, Verdict
from occlog.pipeline.sweep.trial import Spec

UNSEEN = [0, 1, 2]
"""The balls that camera 1 does not see."""
RUNNERS = {
    "IDMOT": {"method": "idmot", "use": 2},
    "BMCT": {"method": "bmct", "use": 2},
    "BMCT, three cameras": {"method": "bmct", "use": 3},
}
SEEN, NOT_SEEN = "seen by camera 1", "not seen by camera 1"


def unseen(size: Size, execute: Execute) -> Table:
    """Compute the share of frames in which the three trackers of camera 2 are off their targets [%]."""
    results = execute([_spec(size, run, hidden) for hidden in (True, False) for run in range(size.runs)])
    rows = []
    for x, label in enumerate(RUNNERS, start=1):
        for k, name in enumerate((NOT_SEEN, SEEN)):
            own = results[k * size.runs : (k + 1) * size.runs]
            helped = tuple(100.0 * r[f"{label}.unseen_helped"] for r in own)
            extra = {"helped": sum(helped) / len(helped)}
            off = tuple(100.0 * r[f"{label}.unseen_off"] for r in own)
            rows.append(Row(f"{label}, {name}", float(x), off, extra, each={"helped": helped}))
    return rows


def _spec(size: Size, run: int, hidden: bool) -> Spec:
    more = {"unseen": UNSEEN} if hidden else {}
    balls = {"frames": size.steps, "views": 3}
    return views_spec(seed_of(size, run), RUNNERS, balls, watched={"unseen": [1, UNSEEN]}, **more)


def judge_unseen(table: Table) -> list[Verdict]:
    """Judge that BMCT without counterparts does what IDMOT does, fails more than with them, and less with a camera more."""
    alone, paired = (v.find(table, f"BMCT, {name}") for name in (NOT_SEEN, SEEN))
    third = v.find(table, f"BMCT, three cameras, {NOT_SEEN}")
    if alone is None or paired is None or third is None:
        return []
    helped = max(alone.each["helped"])
    return [
        v.fact(
            "unseen-idmot",
            "Without counterpart only IDMOT is done: frames in which another view helped [%].",
            holds=helped == 0.0,
            measured=helped,
            rule="in no frame of any run",
            paper=0.0,
        ),
        ordered(
            "unseen-fails", "BMCT fails where there is no counterpart: more than where there is, by [%].", paired, alone
        ),
        ordered("unseen-cameras", "More cameras avoid such failures: with a third one fewer, by [%].", third, alone),
    ]


UNSEEN_COUNTERPARTS = Experiment(
    item="unseen",
    title="Targets that one camera does not see",
    x_label="1 IDMOT, 2 BMCT, 3 BMCT with three cameras",
    y_label="trackers of camera 2 off their targets [%]",
    runs=12,
    steps=300,
    quick=(2, 40),
    compute=unseen,
    judge=judge_unseen,
    trial=run_views_trial,
    note="Six balls of radius 22 px, of which camera 1 does not see three; those three count.",
)
"""The failure of BMCT in Sec. 4.2."""
