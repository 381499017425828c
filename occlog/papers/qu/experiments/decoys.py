"""CMCT attaches to wrong targets near the epipolar line, [Qu] Sec. 4.2.

"Using an epipolar line to direct the sample distribution and (re)initialize the targets is problematic.  When there are
several candidate targets in the vicinity of the epipolar lines, the trackers may attach to wrong targets".  Four balls
go side by side and never touch.  As after a loss one tracker of view 1 is put on the bare wall, nearer to a neighbour
than to its target.  The four are on one epipolar line, or in a column, so that the line distinguishes them.
"""

from __future__ import annotations

import numpy as np

from occlog.papers import verdicts as v
from occlog.papers.qu.common import ordered, seed_of
from occlog.papers.qu.staged import staged_paths
from occlog.papers.qu.trial import views_experiment, views_spec
from occlog.papers.verdicts import Execute, PaperRow, Size, StatementVerdict, Table, mean_of
from occlog.pipeline.sweep.trial import Spec, Values
from occlog.settings import configure
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.motion import ball_cameras

SCENES = {"decoys-on-line": "on the line", "decoys-off-line": "off the line"}
METHODS: dict[str, Values] = {
    "CMCT": {"method": "cmct"},
    "CMCT, 30 px along the line": {"method": "cmct", "set": {"sigma_along_line_px": 30.0}},
    "BMCT": {"method": "bmct"},
}
BALLS = 4
AT = 0.1
"""Share of the video after which the tracker is diverted."""
NEARER = 0.65
"""Offset of the decoy from the target towards its neighbour [distances of the two]; 0.5: in the middle."""
ASIDE = 1.3
"""Lateral offset of the decoy, so that it is on neither [distances of the two]."""
MAY = 10.0
"""Trackers [%] on a wrong target at the end that show that they may attach to one."""


def decoys(size: Size, execute: Execute) -> Table:
    """Table of the runs in which the diverted tracker is on a wrong target at the end [%]; x is the scene, from 1."""
    found = v.run_trials(SCENES, size, execute, lambda scene, run: _spec(size, run, scene))
    rows = []
    for label in METHODS:
        for x, (scene, own) in enumerate(found, start=1):
            wrong = tuple(100.0 * r[f"{label}.diverted_end_other"] for r in own)
            none = sum(100.0 * r[f"{label}.diverted_end_none"] for r in own) / size.runs
            rows.append(PaperRow(f"{label}, others {SCENES[scene]}", float(x), wrong, {"on none": none}))
    return rows


def _spec(size: Size, run: int, scene: str) -> Spec:
    """Specification of a trial of all methods on one staged video, with one tracker put beside its nearest neighbour.

    `size` and `run` give the seed; `scene`: a key of `SCENES`.
    """
    balls = {"frames": size.steps, "balls": BALLS}
    config, seed, frame = configure(BallsConfig(), balls), seed_of(size, run), max(1, round(AT * size.steps))
    positions = ball_cameras(config)[0].project(staged_paths(config, seed, scene).centres[frame])
    away = positions[1:] - positions[0]
    near = away[int(np.argmin(np.linalg.norm(away, axis=1)))]
    # Towards the middle of the image
    aside = ASIDE * np.array([-near[1], near[0]])
    put = positions[0] + NEARER * near
    middle = np.array([0.5 * config.width, 0.5 * config.height])
    put = put + (aside if aside @ (middle - put) > 0.0 else -aside)
    diverted = {"view": 0, "target": 0, "frame": frame, "x": float(put[0]), "y": float(put[1])}
    methods = {label: {**own, "diverted": diverted} for label, own in METHODS.items()}
    return views_spec(seed, methods, balls, scene=scene, watched={"diverted": [0, [0]]})


def judge_decoys(table: Table) -> list[StatementVerdict]:
    """Verdicts on whether trackers of CMCT attach to wrong targets near the epipolar line, and those of BMCT less."""
    out = []
    on, off = (f"others {name}" for name in SCENES.values())
    bmct = v.row_of(table, f"BMCT, {on}")
    for key, label in zip(("own", "wide"), list(METHODS)[:2], strict=True):
        wrong, free = v.row_of(table, f"{label}, {on}"), v.row_of(table, f"{label}, {off}")
        statement = f"{label} may attach to wrong targets near the epipolar line: share of trackers after a loss [%]."
        rule = f"at least {MAY:g} %; in part half of that"
        out += [
            v.judge(f"cmct-{key}-wrong", statement, mean_of(wrong), v.at_least(MAY), v.at_least(0.5 * MAY), rule=rule),
            ordered(
                f"cmct-{key}-line",
                f"The line is the cause ({label}): more than with others off it, by [%].",
                free,
                wrong,
            ),
            ordered(f"cmct-{key}-bmct", f"BMCT attaches to wrong targets less than {label}, by [%].", bmct, wrong),
        ]
    return out


DECOYS = views_experiment(
    item="cmct",
    title="Wrong targets near the epipolar line",
    x_label="others: 1 on the line, 2 off the line",
    y_label="trackers on a wrong target [%]",
    runs=24,
    steps=100,
    quick=(2, 40),
    compute=decoys,
    judge=judge_decoys,
    note="Four balls side by side that never touch; a tracker is put on the wall, nearest to a wrong one.",
)
"""The statement on CMCT of Sec. 4.2."""
