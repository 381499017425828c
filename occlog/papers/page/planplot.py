"""Floor plans of one room side by side, each with a true path and its estimates."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from occlog.array_types import Bools, Floats
from occlog.records.scene import Scene
from occlog.report.drawing.style import COLOURS, Style, house_style, label, new_figure, target_colour, to_png
from occlog.report.plots.planscene import draw_scene, frame_plan


class EstimatedPath(NamedTuple):
    """An estimated path."""

    name: str  # in the legend
    xy: Floats  # (T, 2)


class Panel(NamedTuple):
    """One drawing of the room, with T places of the target."""

    title: str
    truth: Floats  # (T, 2)
    seen: Bools  # (T,) true: a camera saw the target, and estimates have a dot
    estimates: tuple[EstimatedPath, ...]


class Plan(NamedTuple):
    """A picture of panels of equal size and limits."""

    title: str
    caption: str
    scene: Scene
    panels: tuple[Panel, ...]
    columns: int = 3


WIDTH, HEIGHT = 3.4, 3.5
"""Size of a panel [inch]."""
MOST = 1.3
"""Distance from the room's middle up to which paths are drawn, in halves of the room's extent."""
TRUE_PATH: Style = {"color": COLOURS["ink"], "linewidth": 1.0, "linestyle": (0, (4, 2)), "zorder": 4.0}


def draw_plan(plan: Plan) -> Figure:
    """Draw all panels with the same limits, and one legend below them."""
    columns = min(plan.columns, len(plan.panels))
    rows = math.ceil(len(plan.panels) / columns)
    figure = new_figure(WIDTH * columns, HEIGHT * rows + 0.4)
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


def plan_limits(plan: Plan) -> Floats:
    """Return the lower and the upper corner (2, 2) of the room and its paths, these cut at `MOST`."""
    low, high = plan.scene.region.min(axis=0), plan.scene.region.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    paths = [xy for p in plan.panels for xy in (p.truth, *(e.xy for e in p.estimates))]
    everything = np.clip(np.vstack([low, high, *paths]), middle - MOST * half, middle + MOST * half)
    margin = 0.04 * float((high - low).max())
    return np.array([everything.min(axis=0) - margin, everything.max(axis=0) + margin])


def _paths(axes: Axes, panel: Panel) -> list[Line2D]:
    """Draw the true path with its start, and the estimates with dots where the target was seen."""
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


def plan_png(plan: Plan) -> bytes:
    """Return the picture as PNG."""
    with house_style():
        return to_png(draw_plan(plan), 110.0, {"Title": plan.title})
