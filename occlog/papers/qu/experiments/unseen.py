"""A target that one of two cameras does not see, as target 6 of the video *UnionStation* ([Qu] Sec. 4.2).

Two balls go the same way in camera 2 and hide one another for long; one of them is not in the image of camera 1.  What
is counted is how many of their trackers in camera 2 are off their own ball after they have parted: without that
counterpart, with it where camera 1 sees the ball after all, and with a third camera.
"""

from __future__ import annotations

from occlog.papers import verdicts as v
from occlog.papers.qu.common import ordered, seed_of
from occlog.papers.qu.trial import views_experiment, views_spec
from occlog.papers.verdicts import Execute, PaperRow, Size, StatementVerdict, Table
from occlog.pipeline.sweep.trial import Spec

SCENE = "together-in-second"
UNSEEN = [0]
"""The ball that camera 1 does not see."""
RUNNERS = {
    "IDMOT": {"method": "idmot", "use": 2},
    "BMCT": {"method": "bmct", "use": 2},
    "BMCT, three cameras": {"method": "bmct", "use": 3},
}
SEEN, NOT_SEEN = "seen by camera 1", "not seen by camera 1"


def unseen(size: Size, execute: Execute) -> Table:
    """Table of the two trackers in camera 2 that are off their targets at the end [%], without and with counterpart."""
    found = v.run_trials((NOT_SEEN, SEEN), size, execute, lambda name, run: _spec(size, run, name == NOT_SEEN))
    rows = []
    for x, label in enumerate(RUNNERS, start=1):
        for name, own in found:
            helped = tuple(100.0 * r[f"{label}.unseen_helped"] for r in own)
            extra = {"helped": sum(helped) / len(helped)}
            off = tuple(100.0 * (1.0 - r[f"{label}.pair_end_own"]) for r in own)
            rows.append(PaperRow(f"{label}, {name}", float(x), off, extra, each={"helped": helped}))
    return rows


def _spec(size: Size, run: int, hidden: bool) -> Spec:
    """Specification of a trial on one video; `hidden`: whether camera 1 does not see one ball. `run` gives the seed."""
    more = {"unseen": UNSEEN} if hidden else {}
    balls = {"frames": size.steps, "views": 3, "balls": 2}
    watched = {"unseen": [1, UNSEEN], "pair": [1, [0, 1]]}
    return views_spec(seed_of(size, run), RUNNERS, balls, scene=SCENE, watched=watched, **more)


def judge_unseen(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether BMCT fails more without a counterpart than with one, and less with a third camera."""
    alone, paired = (v.row_of(table, f"BMCT, {name}") for name in (NOT_SEEN, SEEN))
    third = v.row_of(table, f"BMCT, three cameras, {NOT_SEEN}")
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


UNSEEN_COUNTERPARTS = views_experiment(
    item="unseen",
    title="A target that one camera does not see",
    x_label="1 IDMOT, 2 BMCT, 3 BMCT with three cameras",
    y_label="trackers of camera 2 off their targets [%]",
    runs=24,
    steps=120,
    quick=(2, 40),
    compute=unseen,
    judge=judge_unseen,
    note="Two balls of radius 22 px that hide one another for long in camera 2; camera 1 does not see one of them.",
)
"""The failure of BMCT in Sec. 4.2."""
