"""Figures of two runs: errors over time with their difference, and who follows whom."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D

from occlog.report.content.model import TimeAxis
from occlog.report.drawing.style import COLOURS, Style, label, target_colour
from occlog.report.drawing.thin import sensible_top
from occlog.report.plots.accuracy import line

from .comparison.accuracy import OverTime
from .comparison.identities import Piece

MOST_LIVES = 20
"""People who have rows of their own."""
MOST_PIECES = 300
"""Of one person that are drawn."""
LEAST = 0.01
"""Share of the distance at which tracks meet that axes of errors show at least."""
STYLES: dict[str, Style] = {
    "A": {"color": COLOURS["seen"], "linewidth": 1.2},
    "B": {"color": COLOURS["bound"], "linewidth": 1.2, "linestyle": (0, (5, 1.2))},
}
"""How lines of the runs are drawn: by colour, and by dashes where there is none."""


class Life(NamedTuple):
    """A person whom tracks of both runs follow."""

    name: str
    a: tuple[Piece, ...]
    b: tuple[Piece, ...]


def draw_errors(figure: FigureBase, time: TimeAxis, found: OverTime, near: float, unit: str) -> None:
    """Draw errors of both runs, their difference below, and how many targets each has not found, lowest.

    Args:
        figure: is drawn into.
        time: axis.
        found: errors.
        near: a track meets a target this near: axes show a hundredth of it at least.
        unit: of lengths.
    """
    errors, difference, missed = figure.subplots(3, 1, sharex=True, height_ratios=[2.0, 1.2, 1.2])
    both = np.flatnonzero(np.isfinite(found.a))
    t_ns = found.t_ns[both]
    for letter, values in (("A", found.a[both]), ("B", found.b[both])):
        line(errors, time, t_ns, values, label=letter, **STYLES[letter])
    errors.set_ylim(0.0, max(sensible_top(found.a[both], found.b[both]), LEAST * near))
    errors.set_ylabel(f"error [{label(unit)}]")
    change = found.b[both] - found.a[both]
    line(difference, time, t_ns, change, color=COLOURS["ink"], linewidth=0.9)
    difference.axhline(0.0, color=COLOURS["muted"], linewidth=0.8, zorder=1)
    top = max(sensible_top(np.abs(change)), LEAST * near)
    difference.set_ylim(-top, top)
    difference.set_ylabel("B \N{MINUS SIGN} A")
    for letter, count in (("A", found.missed_a), ("B", found.missed_b)):
        line(missed, time, found.t_ns, count.astype(np.float64), **STYLES[letter])
    missed.set_ylim(bottom=0.0, top=max(1.0, 1.1 * float(max(found.missed_a.max(), found.missed_b.max()))))
    missed.set_ylabel("not found")
    missed.yaxis.get_major_locator().set_params(integer=True)
    missed.set_xlim(0.0, max(time.length, 1e-9))
    missed.set_xlabel(time.label)
    figure.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncols=2)


def draw_lives(figure: FigureBase, time: TimeAxis, lives: Sequence[Life]) -> None:
    """Draw two bars for each person, of A above that of B; a bar changes its colour where another track follows."""
    axes = figure.add_subplot()
    for place, life in enumerate(lives):
        for letter, pieces, offset in (("A", life.a, 0.21), ("B", life.b, -0.21)):
            y = offset - float(place)
            _bar(axes, time, pieces[:MOST_PIECES], y)
            axes.text(-0.006, y, letter, transform=axes.get_yaxis_transform(), ha="right", va="center", fontsize=7.5)
    axes.set_yticks(-np.arange(len(lives), dtype=float), [label(life.name, 18) for life in lives])
    axes.tick_params(axis="y", length=0, pad=14)
    axes.set_ylim(-len(lives) + 0.4, 0.6)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)
    axes.set_xlim(0.0, max(time.length, 1e-9))
    axes.set_xlabel(time.label)
    mark = Line2D([], [], linestyle="", marker="|", color=COLOURS["ink"], label="another track from here on")
    figure.legend(handles=[mark], loc="outside lower center")


def _bar(axes: Axes, time: TimeAxis, pieces: Sequence[Piece], y: float) -> None:
    """Pieces of one person in one run, with the number of the track where there is room."""
    tracks = list(dict.fromkeys(piece.track for piece in pieces))
    for before, piece in zip((None, *pieces), pieces, strict=False):
        start, end = time.of(np.array([piece.start_ns, piece.end_ns])).tolist()
        length = max(end - start, 0.002 * time.length)
        colour = target_colour(tracks.index(piece.track))
        axes.broken_barh([(start, length)], (y - 0.17, 0.34), facecolor=colour, linewidth=0, alpha=0.8)
        if before is not None and before.track != piece.track:
            axes.plot([start, start], [y - 0.21, y + 0.21], color=COLOURS["ink"], linewidth=1.4)
        if length > 0.05 * time.length:
            text = str(piece.track)
            axes.text(start + length / 2, y, text, ha="center", va="center", fontsize=7, color=COLOURS["halo"])
