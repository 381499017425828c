"""Which cameras were selected when, and the error that was expected of them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from occlog.array_types import Bools, Ints
from occlog.report.content.looks import MOST_SENSORS
from occlog.report.content.model import ReportInput
from occlog.report.content.selections import Selections
from occlog.report.drawing.style import COLOURS, label

from .visibility import label_rows

HEIGHT = 0.72


def cameras_of(data: ReportInput, found: Selections) -> tuple[str, ...]:
    """Cameras in the scene's order, then those that only the diagnostics know."""
    known = () if data.scene is None else tuple(c.name for c in data.scene.cameras)
    return (*known, *sorted(set(found.shares) - set(known)))


def draw_selection(figure: FigureBase, data: ReportInput, found: Selections) -> None:
    """Draw a row for every camera, filled while it was selected, and the share of the time on the right."""
    axes = figure.add_subplot()
    names = cameras_of(data, found)[:MOST_SENSORS]
    shares = []
    for row, name in enumerate(names):
        on = np.array([name in cameras for cameras in found.chosen], dtype=np.bool_)
        _bars(axes, data, found.times, on, -float(row))
        shares.append(f"{100 * found.shares.get(name, 0.0):.0f} %")
    label_rows(axes, [label(n, 18) for n in names], shares)
    axes.set_xlim(0.0, max(data.time.length, 1e-9))
    axes.set_xlabel(data.time.label)


def _bars(axes: Axes, data: ReportInput, times: Ints, on: Bools, y: float) -> None:
    low = y - HEIGHT / 2
    axes.fill_between([0.0, data.time.length], low, low + HEIGHT, color=COLOURS["absent"], linewidth=0)
    if not on.any():
        return
    changes = np.flatnonzero(np.diff(on.astype(np.int8), prepend=0, append=0))
    edges = data.time.of(times[changes])
    filled = np.where(np.arange(len(changes) - 1) % 2 == 0, low + HEIGHT, np.nan)
    axes.stairs(filled, edges, baseline=low, fill=True, color=COLOURS["seen"], linewidth=0)
