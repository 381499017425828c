"""How the filter fared: effective sample size, or how well a method without particles knows the position; fallbacks."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from occlog.records.tables import Diagnostics
from occlog.report.content.fared import deviation
from occlog.report.content.model import ReportInput
from occlog.report.drawing.style import COLOURS, target_colour

from .accuracy import line

MOST_TARGETS = 6
FALLBACKS = {
    "sir": ("hidden", "d", "auxiliary stage skipped"),
    "restart": ("t5", "v", "particles drawn anew"),
    "gap": ("t5", "s", "particles drawn anew after a gap"),
    "depleted": ("t1", "d", "fewer than ten effective particles"),
    "unobservable": ("hidden", "d", "position hardly known"),
    "contradiction": ("t5", "v", "constraints contradict each other"),
    "wall": ("t1", "s", "no way around a wall"),
    "unfinished": ("ink", "x", "search did not converge"),
    "doubted": ("t2", "v", "fewer than half of the bearings believed"),
}


def draw_filter(figure: FigureBase, data: ReportInput, diagnostics: Diagnostics) -> None:
    """Draw the effective sample size of each target's filter, with a mark at each fallback.

    A method without particles has none; then the position's standard deviation is drawn.
    """
    axes = figure.add_subplot()
    if data.fared is None or not data.fared.particles:
        _deviation(axes, data)
        _finish(figure, axes, data)
        return
    targets = np.unique(diagnostics.target_id)
    for i, target in enumerate(targets[:MOST_TARGETS]):
        own = diagnostics.take(diagnostics.target_id == target)
        name = f"target {target}" if len(targets) > 1 else "effective sample size"
        line(axes, data.time, own.t_ns, own.ess, color=target_colour(i), linewidth=0.9, label=name)
    _scale(axes, float(diagnostics.ess.min()), float(diagnostics.ess.max()))
    axes.set_ylabel("effective sample size")
    _finish(figure, axes, data)


def _deviation(axes: Axes, data: ReportInput) -> None:
    """The standard deviation of each target's position."""
    tracks = data.tracks
    if tracks is None:
        return
    targets = np.unique(tracks.target_id)
    for i, target in enumerate(targets[:MOST_TARGETS]):
        own = tracks.take(tracks.target_id == target)
        name = f"target {target}" if len(targets) > 1 else "standard deviation of the position"
        line(axes, data.time, own.t_ns, deviation(own), color=target_colour(i), linewidth=0.9, label=name)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(f"standard deviation [{data.unit}]")


def _finish(figure: FigureBase, axes: Axes, data: ReportInput) -> None:
    """Marks, time axis and legend."""
    _fallbacks(axes, data)
    axes.set_xlabel(data.time.label)
    axes.set_xlim(0.0, max(data.time.length, 1e-9))
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)


def _scale(axes: Axes, low: float, high: float) -> None:
    """From zero, or logarithmic where the sizes differ by more than a factor of 20."""
    low = max(low, 1.0)
    if high <= 20.0 * low:
        axes.set_ylim(0.0, 1.1 * max(high, 1.0))
        return
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,)))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(low / 1.8, 1.4 * high)


def _fallbacks(axes: Axes, data: ReportInput) -> None:
    """A row of marks at the lower edge; where there are very many, every k-th is drawn."""
    for kind, found in data.fared.fallbacks.items() if data.fared is not None else ():
        colour, marker, text = FALLBACKS.get(kind, ("ink", "x", kind))
        axes.plot(
            data.time.of(found.t_ns),
            np.full(len(found.t_ns), 0.035),
            marker,
            color=COLOURS[colour],
            markersize=4.5,
            linestyle="none",
            transform=axes.get_xaxis_transform(),
            label=f"{text} ({found.rows} ×)",
        )
