"""Floor plans of one room side by side, each with a true path and its estimates.

Frames of a video with trackers drawn on them, in rows and columns of one picture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats
from occlog.records.scene import Scene
from occlog.report.drawing import COLOURS, Style, house_style, label, new_figure, target_colour, to_png
from occlog.report.plots.floorplan import draw_scene, frame_plan


class EstimatedPath(NamedTuple):
    """Estimated path of a target: its name in the legend, and positions `xy` (T, 2) in scene units."""

    name: str  # in the legend
    xy: Floats  # (T, 2)


class PlanPanel(NamedTuple):
    """One drawing of the room, with T positions of the target, in scene units.

    Attributes:
        title: text above the drawing.
        truth: (T, 2) true positions.
        seen: (T,) true where a camera saw the target; estimates have a dot there.
        estimates: estimated paths.
    """

    title: str
    truth: Floats
    seen: Bools
    estimates: tuple[EstimatedPath, ...]


class PlanFigure(NamedTuple):
    """A picture of panels of equal size and limits.

    Attributes:
        title, caption: texts of the picture.
        scene: room that every panel shows.
        panels: drawings, row by row.
        columns: panels in a row, at most.
    """

    title: str
    caption: str
    scene: Scene
    panels: tuple[PlanPanel, ...]
    columns: int = 3


PLAN_WIDTH, HEIGHT = 3.4, 3.5
"""Size of a panel [inch]."""
MOST = 1.3
"""Distance from the room's middle up to which paths are drawn, in halves of the room's extent."""
TRUE_PATH: Style = {"color": COLOURS["ink"], "linewidth": 1.0, "linestyle": (0, (4, 2)), "zorder": 4.0}


def draw_plan(plan: PlanFigure) -> Figure:
    """Figure of all panels with the same limits, and one legend below them."""
    columns = min(plan.columns, len(plan.panels))
    rows = math.ceil(len(plan.panels) / columns)
    figure = new_figure(PLAN_WIDTH * columns, HEIGHT * rows + 0.4)
    limits = plan_limits(plan)
    handles: Style = {}
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, panel in zip(grid.flat, plan.panels, strict=False):
        for handle in [*draw_scene(axes, plan.scene, limits), *_paths(axes, panel)]:
            handles.setdefault(str(handle.get_label()), handle)
        frame_plan(axes, limits, plan.scene.length_unit)
        axes.set_title(label(panel.title, 44))
    for axes in grid.flat[len(plan.panels) :]:
        axes.set_visible(False)
    figure.legend(handles=list(handles.values()), loc="outside lower center", ncols=min(len(handles), 2 * columns))
    return figure


def plan_limits(plan: PlanFigure) -> Floats:
    """Lower and upper corner, rows of (2, 2), of the room and all paths, these cut at `MOST`; in scene units."""
    low, high = plan.scene.region.min(axis=0), plan.scene.region.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    paths = [xy for p in plan.panels for xy in (p.truth, *(e.xy for e in p.estimates))]
    everything = np.clip(np.vstack([low, high, *paths]), middle - MOST * half, middle + MOST * half)
    margin = 0.04 * float((high - low).max())
    return np.array([everything.min(axis=0) - margin, everything.max(axis=0) + margin])


def _paths(axes: Axes, panel: PlanPanel) -> list[Line2D]:
    """Draw the true path with its start, and estimates with dots where the target was seen; handles for the legend."""
    handles = axes.plot(panel.truth[:, 0], panel.truth[:, 1], label="true path", **TRUE_PATH)
    handles += axes.plot(
        panel.truth[:1, 0],
        panel.truth[:1, 1],
        "o",
        color=COLOURS["ink"],
        markerfacecolor=COLOURS["halo"],
        markersize=5,
        zorder=6,
        label="its start",
    )
    for i, estimate in enumerate(panel.estimates):
        # Earlier paths are wider, so that they show below later paths that agree with them.
        colour, width = target_colour(i), 1.2 + 2.0 * (len(panel.estimates) - 1 - i)
        handles += axes.plot(
            estimate.xy[:, 0], estimate.xy[:, 1], color=colour, linewidth=width, zorder=3.5, label=estimate.name
        )
        seen = estimate.xy[panel.seen]
        axes.plot(seen[:, 0], seen[:, 1], ".", color=colour, markersize=4, zorder=3.6)
    return handles


def plan_png(plan: PlanFigure) -> bytes:
    """Floor plans with their paths as PNG."""
    with house_style():
        return to_png(draw_plan(plan), 110.0, {"Title": plan.title})


class Mark(NamedTuple):
    """Outline of a tracker in an image.

    Attributes:
        target: number of its target.
        ellipse: (5,) centre x, y [px], half axes [px], angle of the first axis [rad].
        good: whether the tracker is on its own target.
    """

    target: int
    ellipse: Floats
    good: bool


class EpipolarLine(NamedTuple):
    """Epipolar line of a target's estimate in another view.

    Attributes:
        target: number of the target.
        line: (3,) coefficients; points x, y [px] of the line satisfy line . (x, y, 1) = 0.
    """

    target: int
    line: Floats


class FigureImage(NamedTuple):
    """An image, and what is drawn over it.

    Attributes:
        title: text above the image.
        image: (H, W, 3) BGR.
        marks: outlines of trackers.
        links: pairs of centres (2,) [px] of trackers that touch.
        lines: epipolar lines.
    """

    title: str
    image: NDArray[np.uint8]
    marks: tuple[Mark, ...]
    links: tuple[tuple[Floats, Floats], ...]
    lines: tuple[EpipolarLine, ...]


class Shots(NamedTuple):
    """Picture of images in rows and columns.

    Attributes:
        title, caption: texts of the picture.
        rows: names of the rows.
        shots: images of each row; all have the size of the first.
    """

    title: str
    caption: str
    rows: tuple[str, ...]
    shots: tuple[tuple[FigureImage, ...], ...]


SHOT_WIDTH = 2.3
"""Width of an image [inch]."""
BRIGHT = ("#56b4e9", "#e69f00", "#33d17a", "#cc79a7", "#f0e442", "#ff6b4a", "#b19cff", "#9fe8e0")
"""Colours of targets with contrast on photographs; they repeat."""
DPI = 110.0


def bright(target: int) -> str:
    """Bright colour (`#rrggbb`) of the target with number `target`."""
    return BRIGHT[target % len(BRIGHT)]


def draw_shots(shots: Shots) -> Figure:
    """Figure of all images, with the name of each row at its left."""
    rows, columns = len(shots.shots), max(len(r) for r in shots.shots)
    height, width = shots.shots[0][0].image.shape[:2]
    figure = new_figure(SHOT_WIDTH * columns + 0.3, (SHOT_WIDTH * height / width + 0.2) * rows)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for name, line, row in zip(shots.rows, grid, shots.shots, strict=True):
        for axes, shot in zip(line, row, strict=False):
            _draw(axes, shot)
        line[0].text(-0.03, 0.5, label(name), transform=line[0].transAxes, rotation=90, ha="right", va="center")
    return figure


def _draw(axes: Axes, shot: FigureImage) -> None:
    """Draw an image into `axes`, and over it links, epipolar lines and outlines."""
    height, width = shot.image.shape[:2]
    axes.imshow(shot.image[..., ::-1], interpolation="nearest")
    axes.set_title(label(shot.title, 40))
    for a, b in shot.links:
        axes.plot([a[0], b[0]], [a[1], b[1]], color="white", linewidth=1.3)
    for line in shot.lines:
        _line(axes, line, width, height)
    for mark in shot.marks:
        _mark(axes, mark)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)


def _line(axes: Axes, line: EpipolarLine, width: int, height: int) -> None:
    """Draw the part of an epipolar line inside an image of `width` and `height` [px] into `axes`."""
    ends = ends_of(line.line, width, height)
    if ends is not None:
        axes.plot(*ends.T, color=bright(line.target), linewidth=0.9, linestyle=(0, (4, 2)))


def ends_of(line: Floats, width: int, height: int) -> Floats | None:
    """Two points (2, 2) at which a line crosses the image's border [px]; None for a line outside.

    Args:
        line: (3,) coefficients a, b, c of a x + b y + c = 0.
        width: width of the image [px].
        height: height of the image [px].
    """
    a, b, c = line.tolist()
    points = []
    for x in (-0.5, width - 0.5):
        if b and -0.5 <= (y := -(a * x + c) / b) <= height - 0.5:
            points.append((x, y))
    for y in (-0.5, height - 0.5):
        if a and -0.5 < (x := -(b * y + c) / a) < width - 0.5:
            points.append((x, y))
    distinct = sorted(set(points))
    return np.array([distinct[0], distinct[-1]]) if len(distinct) > 1 else None


def _mark(axes: Axes, mark: Mark) -> None:
    """Draw the outline of a tracker with its number: dashed, and with a cross, if it is not on its target."""
    x, y, a, b, rho = mark.ellipse.tolist()
    style = "-" if mark.good else (0, (2, 1.5))
    axes.add_patch(
        Ellipse(
            (x, y),
            2.0 * a,
            2.0 * b,
            angle=float(np.degrees(rho)),
            fill=False,
            edgecolor=bright(mark.target),
            linewidth=1.6,
            linestyle=style,
        )
    )
    text = str(mark.target) if mark.good else f"{mark.target} ×"
    axes.text(
        x,
        y,
        text,
        color=bright(mark.target),
        ha="center",
        va="center",
        fontsize=8,
        fontweight="bold",
        path_effects=[withStroke(linewidth=2.0, foreground="black")],
        clip_on=True,
    )


def shots_png(shots: Shots) -> bytes:
    """Picture of images as PNG."""
    with house_style():
        return to_png(draw_shots(shots), DPI, {"Title": shots.title})
