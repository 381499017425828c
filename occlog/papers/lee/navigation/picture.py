"""Picture of a robot's path in its scene, its states distinguished, with the clearance over time below."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from occlog.array_types import NS, Floats
from occlog.records.declared.world import RobotPath
from occlog.records.scene import Scene
from occlog.report.drawing import COLOURS, Style, house_style, label, new_figure, to_png
from occlog.report.plots.floorplan import draw_scale_bar, draw_scene, frame_plan, limits_of

from .config import NavigateConfig
from .obstacle_course import Course


class PathPicture(NamedTuple):
    """Content of the picture of a path.

    Attributes:
        scene, course: room, and obstacles of the robot.
        path: path of the robot.
        goal: (2,) position of the goal.
        config: settings of the robot.
        end: words for how the path ended.
    """

    scene: Scene
    course: Course
    path: RobotPath
    goal: Floats
    config: NavigateConfig
    end: str


SIZE = (7.4, 8.2)
DPI = 110.0
PATH = COLOURS["t0"]
MARKS: dict[str, tuple[str, str, str]] = {
    "oscillating": ("oscillation recognised", "v", COLOURS["t1"]),
    "prevent": ("collision prevented", "s", COLOURS["t3"]),
    "escaping": ("escape", "^", COLOURS["t2"]),
    "guarded": ("step turned by the guard", "D", COLOURS["t4"]),
}
"""Name in the legend, marker and colour of each state other than `free`."""
DOTS = 120
"""Positions of steps are dots on paths of up to this many steps."""
BODIES = 40
"""Outlines of the robot, and of people, that are drawn along a path."""


def path_png(what: PathPicture) -> bytes:
    """Picture of a path as PNG."""
    with house_style():
        return to_png(draw_path(what), DPI, {"Title": f"Path of a robot: {what.end}"})


def draw_path(what: PathPicture) -> Figure:
    """Draw the plan with the path, and the clearance over time below it, as a figure."""
    figure = new_figure(*SIZE)
    plan, below = figure.subplots(2, 1, height_ratios=[5.0, 1.0])
    handles = _plan(plan, what)
    _clearance(below, what)
    figure.suptitle(label(what.end, 90), x=0.015, ha="left", fontsize=10.5, fontweight="bold")
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _plan(axes: Axes, what: PathPicture) -> list[Line2D | Patch]:
    limits = _limits(what)
    handles: list[Line2D | Patch] = list(draw_scene(axes, what.scene, limits))
    handles += _obstacles(axes, what)
    handles += _path(axes, what)
    frame_plan(axes, limits, what.scene.length_unit)
    draw_scale_bar(axes, limits, label(what.scene.length_unit))
    return handles


def _limits(what: PathPicture) -> Floats:
    """(2, 2) lower and upper corner of the plot: room, obstacles and path with a margin."""
    path, discs = what.path, what.course.discs
    points = [
        np.column_stack([path.x, path.y]),
        what.goal[None],
        discs[:, :2] - discs[:, 2:],
        discs[:, :2] + discs[:, 2:],
    ]
    points += [] if what.scene.room is None else [what.scene.room]
    points += [o.polygon for o in what.scene.occluders]
    return limits_of(points)


def _obstacles(axes: Axes, what: PathPicture) -> list[Line2D | Patch]:
    """Draw round obstacles, and the paths of people during the drive; return the entries of the legend."""
    handles: list[Line2D | Patch] = []
    fill: Style = {"facecolor": COLOURS["pillar"], "edgecolor": COLOURS["wall"], "linewidth": 0.8, "zorder": 2.5}
    for x, y, radius in what.course.discs:
        axes.add_patch(Circle((x, y), radius, **fill))
        axes.plot([x], [y], "+", color=COLOURS["ink"], markersize=7, zorder=2.6)
    if len(what.course.discs):
        mark: Style = {"marker": "+", "color": COLOURS["ink"], "linestyle": "none", "label": "obstacle"}
        handles.append(Line2D([], [], **mark))
    if what.course.moving is not None:
        handles += _people(axes, what)
    return handles


def _people(axes: Axes, what: PathPicture) -> list[Line2D | Patch]:
    """Draw the paths of people, with circles at the time of least clearance; return the entries of the legend."""
    moving = what.course.moving
    style: Style = {"color": COLOURS["moving"], "linewidth": 0.8, "alpha": 0.6, "zorder": 2.2}
    assert moving is not None
    obstacle_steps = [moving.at(step) for step in range(len(what.path))]
    xy = np.stack([m.xy for m in obstacle_steps])
    for person in range(xy.shape[1]):
        axes.plot(xy[:, person, 0], xy[:, person, 1], **style)
    step = _nearest_row(what.path)
    for (x, y), radius in zip(obstacle_steps[step].xy, obstacle_steps[step].radius, strict=True):
        if np.isfinite(x):
            axes.add_patch(Circle((x, y), radius, facecolor=COLOURS["moving"], alpha=0.5, edgecolor="none", zorder=2.3))
    return [
        Line2D([], [], label="path of a person", **style),
        Patch(facecolor=COLOURS["moving"], alpha=0.5, label="person, when they were nearest"),
    ]


def _path(axes: Axes, what: PathPicture) -> list[Line2D | Patch]:
    path, radius = what.path, what.config.radius
    few = len(path) <= DOTS
    line: Style = {"color": PATH, "linewidth": 1.6, "zorder": 3.5, "marker": "." if few else None, "markersize": 5}
    axes.plot(path.x, path.y, **line)
    handles: list[Line2D | Patch] = [Line2D([], [], label="path", **line)]
    if radius > 0.0:
        rows = np.unique(np.linspace(0, len(path) - 1, BODIES).round().astype(int))
        for row in rows:
            axes.add_patch(_body(path, int(row), radius, alpha=0.25))
        axes.add_patch(_body(path, _nearest_row(path), radius, alpha=1.0))
        handles.append(Line2D([], [], color=PATH, linewidth=0.8, label="robot, boldly where it was nearest"))
    for state, (name, marker, colour) in MARKS.items():
        rows = np.flatnonzero(path.state == state)
        if len(rows):
            style: Style = {"marker": marker, "color": colour, "linestyle": "none", "markersize": 6, "zorder": 4}
            axes.plot(path.x[rows], path.y[rows], **style)
            handles.append(Line2D([], [], label=name, **style))
    ends: Style = {"linestyle": "none", "markersize": 8, "zorder": 5}
    start: Style = {"marker": "o", "markerfacecolor": COLOURS["halo"], "markeredgecolor": PATH, "markeredgewidth": 1.6}
    goal: Style = {"marker": "*", "color": COLOURS["t5"]}
    axes.plot(path.x[:1], path.y[:1], **start, **ends)
    axes.plot(*what.goal[:, None], **goal, **ends)
    axes.plot(path.x[-1:], path.y[-1:], marker="X", color=PATH, **ends)
    return [
        *handles,
        Line2D([], [], label="start", **start, **ends),
        Line2D([], [], label="goal", **goal, **ends),
        Line2D([], [], label="end of the path", marker="X", color=PATH, **ends),
    ]


def _nearest_row(path: RobotPath) -> int:
    """Row of the path with the least clearance; the first row without obstacles."""
    return int(np.nanargmin(path.clearance)) if np.isfinite(path.clearance).any() else 0


def _body(path: RobotPath, row: int, radius: float, alpha: float) -> Circle:
    """Outline of the robot at a row of the path, with its radius and opacity `alpha` (0 to 1)."""
    at = (float(path.x[row]), float(path.y[row]))
    return Circle(at, radius, fill=False, edgecolor=PATH, linewidth=0.8, alpha=alpha, zorder=3.2)


def _clearance(axes: Axes, what: PathPicture) -> None:
    seconds = (what.path.t_ns - what.path.t_ns[0]) / NS
    axes.plot(seconds, what.path.clearance, color=PATH, linewidth=1.2)
    axes.axhline(0.0, color=COLOURS["ink"], linewidth=0.8)
    axes.set_xlabel("time since start [s]")
    axes.set_ylabel(f"clearance [{label(what.scene.length_unit)}]")
