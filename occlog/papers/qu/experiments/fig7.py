"""[Qu] Fig. 7: trackers of MIPF, IDMOT and BMCT that leave their targets, counted and drawn in frames of one video."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.fundamental import epipolar_lines
from occlog.measure.epipolar.views import ViewGeometry
from occlog.papers import verdicts as v
from occlog.papers.plots import EpipolarLine, FigureImage, Mark, Shots
from occlog.papers.qu.common import PARTS, ordered, spec_of
from occlog.papers.qu.tracker_runs import FollowedFrame, follow
from occlog.papers.qu.trial import runner_of, views_experiment
from occlog.papers.qu.world import geometry_of
from occlog.papers.verdicts import Execute, PaperRow, Size, StatementVerdict, Table, mean_of, share_of
from occlog.simulate.balls.config import BallsConfig
from occlog.simulate.balls.video import BallsFrame
from occlog.track.methods.images.interface import TrackerOutlines

SHOWN = ("mipf", "idmot", "bmct")
"""The methods of the figure."""
COLUMNS = 4
ALL = 0.7
"""Share of the videos that counts as all: what twelve videos without an exception can show."""
MANY = 100.0 / 3.0
"""Share of the trackers [%] that counts as many."""


class MostHidden(NamedTuple):
    """Frame of one quarter of the video in which most of the balls is hidden: `step`, with its trackers.

    `visible`: sum of the balls' visible shares over all views.
    """

    step: FollowedFrame
    visible: float  # sum of the balls' visible shares


def fig7_shots(size: Size) -> Shots:
    """Picture of the first video: of each quarter the frame in which most is hidden, for each method and view."""
    config = BallsConfig(frames=size.steps)
    seed = size.seed + 1
    spec = {"seed": seed}
    kept: dict[int, MostHidden] = {}

    def keep(step: FollowedFrame) -> None:
        quarter, visible = step.frame.frame * COLUMNS // config.frames, float(step.frame.share.sum())
        if step.frame.frame and (quarter not in kept or visible < kept[quarter].visible):
            kept[quarter] = MostHidden(step, visible)

    follow(config, seed, {m: runner_of(config, spec, {"method": m}) for m in SHOWN}, keep)
    steps = [kept[q].step for q in sorted(kept)]
    geometry = geometry_of(config, config.views)
    rows = [(m, view) for m in SHOWN for view in range(config.views)]
    return Shots(
        "Frames of the synthetic video",
        f"video of seed {seed}; of each quarter the frame in which most is hidden. Dashed outline and ×: not on its "
        "own target; white: trackers that touch; dashed line: that of the other view's estimate, where it helps.",
        tuple(f"{m.upper()}, view {view + 1}" for m, view in rows),
        tuple(tuple(shot_of(step.frame, step.rows[m], view, geometry) for step in steps) for m, view in rows),
    )


def shot_of(frame: BallsFrame, rows: TrackerOutlines, view: int, geometry: ViewGeometry) -> FigureImage:
    """Picture of one view of a frame with a method's trackers, their links and epipolar lines.

    Args:
        frame: images and true outlines.
        rows: the method's trackers of all views in this frame.
        view: index of the view.
        geometry: fundamental matrices between views.
    """
    own = np.flatnonzero(rows.view == view)
    marks = tuple(Mark(int(rows.target_id[i]), rows.ellipse[i], _good(frame, rows, int(i))) for i in own)
    links = tuple((rows.ellipse[i, :2], rows.ellipse[j, :2]) for i in own for j in own if i < j and rows.touching[i, j])
    return FigureImage(
        f"frame {frame.frame}", frame.images[view], marks=marks, links=links, lines=_lines(rows, view, geometry)
    )


def _good(frame: BallsFrame, rows: TrackerOutlines, i: int) -> bool:
    """Whether the tracker in row i of `rows` has its centre within the radius of its own target in the frame."""
    true: Floats = frame.ellipses[rows.view[i], rows.target_id[i]]
    radius = float(np.sqrt(true[2] * true[3]))
    return bool(np.hypot(*(rows.ellipse[i, :2] - true[:2])) <= radius)


def _lines(rows: TrackerOutlines, view: int, geometry: ViewGeometry) -> tuple[EpipolarLine, ...]:
    """Epipolar lines in `view` of those estimates in other views that help its trackers in this frame."""
    out = []
    for i in np.flatnonzero(rows.view == view):
        for other in np.flatnonzero(rows.assisting_views[i]):
            there = np.flatnonzero((rows.view == other) & (rows.target_id == rows.target_id[i]))
            for k in there:
                line = epipolar_lines(geometry.fundamental[other, view], rows.ellipse[k, :2])
                out.append(EpipolarLine(int(rows.target_id[i]), line))
    return tuple(out)


def fig7(size: Size, execute: Execute) -> Table:
    """Table of the trackers that are not on their target [%], by twentieth of the video, and in its last frame."""
    results = execute([spec_of(size, run) for run in range(size.runs)])
    rows = []
    for m in SHOWN:
        for k in range(PARTS):
            values = tuple(100.0 * r[f"{m}.off_{k}"] for r in results)
            if not math.isnan(values[0]):  # a short video has fewer parts
                rows.append(PaperRow(m.upper(), (k + 0.5) * size.steps / PARTS, values))
        rows.append(
            PaperRow(
                f"{m.upper()}, last frame",
                math.nan,
                tuple(100.0 * r[f"{m}.off_end"] for r in results),
                {},
                plotted=False,
            )
        )
    return rows


def judge7(table: Table) -> list[StatementVerdict]:
    """Verdicts on the statements about [Qu] Fig. 7: how many trackers of MIPF, IDMOT and BMCT leave their targets."""
    end = {m: next(r for r in table if r.series == f"{m.upper()}, last frame") for m in SHOWN}
    hijacked, n = end["mipf"], end["mipf"].runs
    failed = sum(x > 0 for x in end["idmot"].values)
    whole = sum(x == 0 for x in end["bmct"].values)
    statement = (
        "IDMOT has improved the performance: share of trackers off their target at the end lower than MIPF's, by [%]."
    )
    better = "BMCT rectifies these problems: share of trackers off their target at the end lower than IDMOT's, by [%]."
    return [
        v.judge(
            "fig7-hijacked",
            "MIPF: many trackers are hijacked and lose their target: share at the end [%].",
            mean_of(hijacked),
            v.above(MANY),
            v.above(10.0),
            rule="above a third; in part above 10 %",
        ),
        ordered("fig7-idmot", statement, end["idmot"], end["mipf"]),
        v.judge(
            "fig7-idmot-fails",
            "IDMOT still has failures: share of the videos that end with a tracker off its target.",
            share_of(failed, n),
            v.at_least(0.5),
            v.at_least(0.1),
            rule="at least half of the videos; in part a tenth",
        ),
        ordered("fig7-bmct", better, end["bmct"], end["idmot"]),
        v.judge(
            "fig7-all",
            "BMCT tracks all targets: share of the videos that end with all trackers on their targets.",
            share_of(whole, n),
            v.at_least(ALL),
            v.at_least(0.5 * ALL),
            rule=f"at least {ALL:.0%} of the videos; in part half of that",
        ),
    ]


FIG7 = views_experiment(
    item="fig7",
    title="What happens to the trackers",
    x_label="frame",
    y_label="trackers off their target [%]",
    quick=(2, 50),
    compute=fig7,
    judge=judge7,
    plans={"frames": fig7_shots},
    note="The same videos; balls that no camera sees count, too.",
)
