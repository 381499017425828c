"""Where there is no truth: how far the track is from where the sight lines meet, and from each of them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D

from occlog.report.content.model import ReportInput
from occlog.report.content.off_sight import Distances
from occlog.report.content.plane_of_sight import Residuals
from occlog.report.drawing.style import COLOURS, Style, label, target_colour
from occlog.report.drawing.thin import extremes, sensible_top

from .accuracy import line, mark_clipped

DOTS = 120
DOT_COLOURS = ("t0", "t3", "t2", "t1", "t5", "t4")
DOT_MARKERS = ("o", "s", "^", "v", "D", "P")


def draw_sight(figure: FigureBase, data: ReportInput, target: int) -> None:
    """Draw the distance to the meeting point, and each sensor's residual in degrees below it."""
    found = data.sight[target]
    handles: list[Line2D] = []
    if found.rows:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.2, 1.0])
        handles += _distance(above, data, found, target_colour(data.targets.index(target)))
    else:
        below = figure.add_subplot()
    handles += _residuals(below, data, data.residuals[target].drawn)
    below.set_xlabel(data.time.label)
    below.set_xlim(0.0, max(data.time.length, 1e-9))
    if handles:
        figure.legend(handles=handles[:20], loc="outside lower center", ncols=min(len(handles), 6))


def _distance(axes: Axes, data: ReportInput, found: Distances, colour: str) -> list[Line2D]:
    t_ns, distance = found.t_ns, found.distance
    line(axes, data.time, t_ns, distance, color=colour, linewidth=0.8, alpha=0.7, label="distance")
    line(axes, data.time, t_ns, found.so_far, color=colour, linewidth=2.0, label="RMS so far")
    top = sensible_top(distance)
    axes.set_ylim(0.0, top)
    mark_clipped(axes, data.time, t_ns=t_ns, values=distance, top=top, unit=data.unit, all_there=found.every == 1)
    axes.set_ylabel(f"distance [{label(data.unit)}]")
    return [handle for handle in axes.get_legend_handles_labels()[0] if isinstance(handle, Line2D)]


def _residuals(axes: Axes, data: ReportInput, found: Residuals) -> list[Line2D]:
    """Residuals as dots, one mark a sensor; handles for the legend."""
    degrees = np.degrees(found.residual)
    handles = []
    for i, name in enumerate(found.names):
        rows = np.flatnonzero(found.sensor == i)
        if not len(rows):
            continue
        keep = rows[extremes(degrees[rows], DOTS)]
        style: Style = {
            "marker": DOT_MARKERS[i % 6],
            "color": COLOURS[DOT_COLOURS[i % 6]],
            "linestyle": "none",
            "markeredgewidth": 0,
        }
        axes.plot(data.time.of(found.t_ns[keep]), degrees[keep], markersize=2.6, alpha=0.7, **style)
        handles.append(Line2D([], [], markersize=6, label=label(name, 18), **style))
    top = sensible_top(np.abs(degrees))
    axes.set_ylim(-top, top)
    axes.axhline(0.0, color=COLOURS["muted"], linewidth=0.6, zorder=1)
    axes.set_ylabel("off sight line [°]")
    return handles
