"""[Qu] Fig. 7: frames of one synthetic video with the trackers of MIPF, IDMOT and BMCT."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..columns import Bools, Floats
from ..core.epipolar import epipolar_lines
from ..report.shots import Line, Mark, Shot, Shots
from ..trackers.view_method import Geometry
from ..vision.render_balls import BallsFrame
from .model import Size
from .views_follow import Rows, Step, follow
from .views_trial import runner_of
from .views_world import balls_config, geometry_of

SHOWN = ("mipf", "idmot", "bmct")
"""The methods of the figure."""
COLUMNS = 4


class Kept(NamedTuple):
    """The frame of one part of the video in which most of the balls is hidden."""

    step: Step
    visible: float


def fig7_shots(size: Size) -> Shots:
    """The first video; of each quarter the frame in which most is hidden, for each method and view."""
    config = balls_config({"frames": size.steps})
    seed = size.seed + 1
    spec = {"seed": seed}
    kept: dict[int, Kept] = {}

    def seen(step: Step) -> None:
        quarter, visible = step.frame.frame * COLUMNS // config.frames, float(step.frame.share.sum())
        if step.frame.frame and (quarter not in kept or visible < kept[quarter].visible):
            kept[quarter] = Kept(step, visible)

    follow(config, seed, {m: runner_of(config, spec, {"method": m}) for m in SHOWN}, seen)
    steps = [kept[q].step for q in sorted(kept)]
    geometry = geometry_of(config, len(config.views))
    rows = [(m, view) for m in SHOWN for view in range(len(config.views))]
    return Shots(
        "Frames of the synthetic video",
        f"video of seed {seed}; of each quarter the frame in which most is hidden. Dashed outline and ×: not on its "
        "own target; white: trackers that touch; dashed line: that of the other view's estimate, where it helps.",
        tuple(f"{m.upper()}, view {view + 1}" for m, view in rows),
        tuple(tuple(shot_of(step.frame, step.rows[m], view, geometry) for step in steps) for m, view in rows),
    )


def shot_of(frame: BallsFrame, rows: Rows, view: int, geometry: Geometry) -> Shot:
    """One view of a frame with a method's trackers."""
    own = np.flatnonzero(rows.view == view)
    marks = tuple(Mark(int(rows.target[i]), rows.ellipse[i], _good(frame, rows, int(i))) for i in own)
    o = rows.outlines
    touching: Bools = np.zeros((len(rows.view),) * 2, dtype=np.bool_) if o is None else o.touching
    links = tuple((rows.ellipse[i, :2], rows.ellipse[j, :2]) for i in own for j in own if i < j and touching[i, j])
    return Shot(f"frame {frame.frame}", frame.images[view], marks, links, _lines(rows, view, geometry))


def _good(frame: BallsFrame, rows: Rows, i: int) -> bool:
    true: Floats = frame.ellipses[rows.view[i], rows.target[i]]
    radius = float(np.sqrt(true[2] * true[3]))
    return bool(np.hypot(*(rows.ellipse[i, :2] - true[:2])) <= radius)


def _lines(rows: Rows, view: int, geometry: Geometry) -> tuple[Line, ...]:
    """The lines of the views that helped."""
    o, out = rows.outlines, []
    if o is None:
        return ()
    for i in np.flatnonzero(rows.view == view):
        for other in np.flatnonzero(o.helpers[i]):
            there = np.flatnonzero((rows.view == other) & (rows.target == rows.target[i]))
            for k in there:
                line = epipolar_lines(geometry.fundamental[other, view], rows.ellipse[k, :2])
                out.append(Line(int(rows.target[i]), line))
    return tuple(out)
