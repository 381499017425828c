"""[Ercan] Sec. 5: the error of tracking against the time between two selections, in the room of Fig. 12."""

from __future__ import annotations

from itertools import pairwise

from occlog.papers.verdicts import verdicts as v
from occlog.papers.verdicts.model import Execute, Experiment, Size, Table, Verdict

from .scenes import L_ORDER, l_room, names
from .selection import GREEDY, L_SIGMA, L_WORLD
from .trial import Point, kalman, run_points, trial

COUNT = 3
PERIODS, QUICK_PERIODS = (1, 5, 25), (1, 25)
"""Steps between selections; those of Fig. 12 are 5."""


def by_period(size: Size, execute: Execute) -> Table:
    """Compute the RMSE with greedily selected cameras against the steps between selections; runs share their worlds."""
    points = []
    for every in QUICK_PERIODS if size.quick else PERIODS:
        select = {"policy": "greedy", "count": COUNT, "every": float(every), "patience": 0, "model": "perspective"}
        spec = trial(l_room(), size, L_WORLD, kalman(L_SIGMA), select={**select, "order": names(L_ORDER)})
        points.append(Point(GREEDY, float(every), spec))
    return run_points(points, size, execute)


def judge(table: Table) -> list[Verdict]:
    """Judge that the error is lower with more frequent selections."""
    rows = v.series(table, GREEDY)
    said = "Selecting anew more often gives better tracking: RMSE lower with the shorter time, by."
    return [v.pairs("selection-period", said, list(pairwise(rows)))]


SELECTION_PERIOD = Experiment(
    item="selection-period",
    title="Error and time between selections",
    x_label="steps between selections",
    y_label="RMSE",
    runs=10,
    steps=1000,
    quick=(2, 60),
    compute=by_period,
    judge=judge,
    note="Three of twelve cameras by the greedy policy, in the L-shaped room of Fig. 12 with 40 occluders.",
)
