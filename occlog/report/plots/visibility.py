"""What each sensor saw when: one row a sensor, filled as far as it saw the target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch

from occlog.array_types import Floats, Ints
from occlog.report.content.looks import MOST_SENSORS, MOST_TARGETS, Looked, Sightings, known_first
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.drawing.style import COLOURS, label

CELLS_OF_ALL, FEWEST_CELLS = 4800, 60
"""Cells of all sensors and targets together, so that a page of many stays small; those of each one, at least."""
HEIGHT = 0.72


def watched(data: ReportInput) -> tuple[int, ...]:
    """Targets that bearings are labelled with; -1 (any object) last and only if there is no other."""
    return () if data.looked is None else data.looked.watched


def sensors(data: ReportInput) -> tuple[str, ...]:
    """Names of all sensors, in the scene's order, then those that only the bearings know."""
    return known_first(data.scene, [] if data.looked is None else data.looked.sensors)


def draw_visibility(
    figure: FigureBase, data: ReportInput, looked: Looked, target: int, most: int = MOST_SENSORS
) -> None:
    """Draw the rows of all sensors, or of the first `most`, for one target; the first sensor is on top."""
    axes = figure.add_subplot()
    names = sensors(data)[:most]
    cells = max(CELLS_OF_ALL // max(len(names) * min(len(looked.watched), MOST_TARGETS), 1), FEWEST_CELLS)
    rows = [coarser(looked.sightings(name, target), cells) for name in names]
    draw_rows(axes, data.time, rows, [label(n, 18) for n in names])
    kinds = (("seen", "target seen"), ("hidden", "frame, target not seen"), ("absent", "no frame"))
    handles = [Patch(facecolor=COLOURS[colour], label=text) for colour, text in kinds]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)


def coarser(found: Sightings, most: int) -> Sightings:
    """The same frames in at most so many cells: neighbours are one, as many as it takes."""
    together = -(-len(found.looked) // most)
    if together <= 1:
        return found
    first = np.arange(0, len(found.looked), together)
    looked, seen = (np.add.reduceat(each, first) for each in (found.looked, found.seen))
    return replace(found, edges=np.append(found.edges[first], found.edges[-1]), looked=looked, seen=seen)


def draw_rows(axes: Axes, time: TimeAxis, rows: Sequence[Sightings], names: Sequence[str]) -> None:
    """Draw a bar for each sensor, with its share of sightings beside it; the first sensor is on top."""
    shares = []
    for row, found in enumerate(rows):
        _bar(axes, time, found, -float(row))
        whose = "any" if found.any_object else "seen"
        shares.append("no frame" if np.isnan(found.share) else f"{_percent(found.share)} {whose}")
    label_rows(axes, names, shares)
    axes.set_xlim(0.0, max(time.length, 1e-9))
    axes.set_xlabel(time.label)


def _percent(share: float) -> str:
    """Whole per cent; never 0 or 100 unless it is exactly that."""
    if 0.0 < share < 1.0:
        return f"{min(max(round(100 * share), 1), 99)} %"
    return f"{100 * share:.0f} %"


def label_rows(axes: Axes, names: Sequence[str], shares: Sequence[str]) -> None:
    """Write the name of each row at the left and its share at the right; the first row is on top."""
    ticks = [-float(i) for i in range(len(names))]
    axes.set_yticks(ticks, names)
    axes.set_ylim(-len(names) + 1 - 0.6, 0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(False)
    axes.spines["left"].set_visible(False)
    right = axes.secondary_yaxis("right")
    right.set_yticks(ticks, shares)
    right.tick_params(length=0, labelsize=8, labelcolor=COLOURS["muted"])
    right.spines["right"].set_visible(False)


def _bar(axes: Axes, time: TimeAxis, found: Sightings, y: float) -> None:
    """Grey where there is no frame, orange where the sensor looked, blue from below as far as it saw."""
    low = y - HEIGHT / 2
    axes.fill_between([0.0, time.length], low, low + HEIGHT, color=COLOURS["absent"], linewidth=0)
    if not len(found.looked):
        return
    edges, share = _merged(found)
    at = time.of(edges)
    frames = np.where(np.isnan(share), np.nan, low + HEIGHT)
    axes.stairs(frames, at, baseline=low, fill=True, color=COLOURS["hidden"], linewidth=0)
    filled = np.where(share > 0, low + HEIGHT * share, np.nan)
    axes.stairs(filled, at, baseline=low, fill=True, color=COLOURS["seen"], linewidth=0)


def _merged(found: Sightings) -> tuple[Ints, Floats]:
    """Borders of the cells and share seen (NaN without frames), neighbours of the same share as one cell."""
    share = np.where(found.looked > 0, found.seen / np.maximum(found.looked, 1), -1.0)
    first = np.concatenate([[True], np.diff(share) != 0])
    edges = np.append(found.edges[:-1][first], found.edges[-1])
    return edges, np.where(share[first] < 0, np.nan, share[first])
