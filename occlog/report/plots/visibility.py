"""What each sensor saw when: one row a sensor, filled as far as it saw the target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch

from occlog.array_types import Bools, Floats, Ints
from occlog.records.tables import UNLABELLED, Bearings
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.drawing.style import COLOURS, label

CELLS = 500
MOST_ROWS = 60
HEIGHT = 0.72


@dataclass(frozen=True, eq=False)
class Sightings:
    """One sensor's frames and how many of them saw the target.

    Attributes:
        sensor: its name.
        edges: (C + 1,) borders of the cells [ns].
        looked: (C,) frames in each cell; 0 = no frame.
        seen: (C,) frames in each cell that saw the target.
        any_object: whether they tell of candidates that may be of any object, not of a named target.
    """

    sensor: str
    edges: Ints
    looked: Ints
    seen: Ints
    any_object: bool = False

    @property
    def share(self) -> float:
        """Share of the frames that saw the target; NaN without frames."""
        frames = int(self.looked.sum())
        return float(self.seen.sum()) / frames if frames else float("nan")


def sightings(bearings: Bearings, sensor: str, target: int) -> Sightings:
    """Frames of one sensor, one cell a frame or, over long recordings, `CELLS` cells of equal time.

    A sensor that names no target has its candidates counted, as a filter is offered them.
    """
    own = bearings.sensor == sensor
    rows = own & (bearings.target_id == target)
    free = target != UNLABELLED and not (own & (bearings.target_id != UNLABELLED)).any()
    rows = own & (bearings.target_id == UNLABELLED) if free else rows
    # Several candidates of one frame are one look.
    times, frame = np.unique(bearings.t_ns[rows], return_inverse=True)
    seen = np.bincount(frame, bearings.seen[rows], len(times)) > 0
    if not len(times):
        return Sightings(sensor, np.zeros(1, np.int64), np.empty(0, np.int64), np.empty(0, np.int64))
    period = int(np.median(np.diff(times))) if len(times) > 1 else 0
    if len(times) <= CELLS:
        return Sightings(sensor, *_frame_cells(times, seen, max(period, 1)), free)
    edges = np.linspace(times[0], times[-1] + max(period, 1), CELLS + 1).astype(np.int64)
    cell = np.searchsorted(edges, times, side="right") - 1
    looked = np.bincount(cell, minlength=CELLS)[:CELLS]
    return Sightings(
        sensor=sensor,
        edges=edges,
        looked=looked,
        seen=np.bincount(cell, seen, CELLS)[:CELLS].astype(np.int64),
        any_object=free,
    )


def _frame_cells(times: Ints, seen: Bools, period: int) -> tuple[Ints, Ints, Ints]:
    """Each frame lasts until the next one, but at most half as long again as usual; then nothing."""
    longest = period + period // 2
    ends = np.append(np.minimum(times[1:], times[:-1] + longest), times[-1] + period)
    edges = np.unique(np.concatenate([times, ends]))
    start = edges[:-1]
    row = np.searchsorted(times, start, side="right") - 1
    inside = start < ends[row]
    return edges, inside.astype(np.int64), (inside & seen[row]).astype(np.int64)


def watched(data: ReportInput) -> tuple[int, ...]:
    """Targets that bearings are labelled with; -1 (any object) last and only if there is no other."""
    if data.bearings is None or not len(data.bearings):
        return ()
    labels = [int(i) for i in np.unique(data.bearings.target_id)]
    return tuple(i for i in labels if i != UNLABELLED) or tuple(labels)


def sensors(data: ReportInput) -> tuple[str, ...]:
    """Names of all sensors, in the scene's order, then those that only the bearings know."""
    known: list[str] = []
    if data.scene is not None:
        known = [c.name for c in data.scene.cameras] + [a.name for a in data.scene.arrays]
    found = [] if data.bearings is None else [str(n) for n in np.unique(data.bearings.sensor)]
    return (*known, *(n for n in found if n not in known))


def draw_visibility(
    figure: FigureBase, data: ReportInput, bearings: Bearings, target: int, most: int = MOST_ROWS
) -> None:
    """Draw the rows of all sensors, or of the first `most`, for one target; the first sensor is on top."""
    axes = figure.add_subplot()
    names = sensors(data)[:most]
    rows = [sightings(bearings, name, target) for name in names]
    draw_rows(axes, data.time, rows, [label(n, 18) for n in names])
    kinds = (("seen", "target seen"), ("hidden", "frame, target not seen"), ("absent", "no frame"))
    handles = [Patch(facecolor=COLOURS[colour], label=text) for colour, text in kinds]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)


def draw_rows(axes: Axes, time: TimeAxis, rows: Sequence[Sightings], names: Sequence[str]) -> None:
    """Draw a bar for each sensor, with its share of sightings beside it; the first sensor is on top."""
    shares = []
    for row, found in enumerate(rows):
        _bar(axes, time, found, -float(row))
        whose = "any" if found.any_object else "seen"
        shares.append("no frame" if np.isnan(found.share) else f"{_percent(found.share)} {whose}")
    _rows(axes, list(names), shares)
    axes.set_xlim(0.0, max(time.length, 1e-9))
    axes.set_xlabel(time.label)


def _percent(share: float) -> str:
    """Whole per cent; never 0 or 100 unless it is exactly that."""
    if 0.0 < share < 1.0:
        return f"{min(max(round(100 * share), 1), 99)} %"
    return f"{100 * share:.0f} %"


def _rows(axes: Axes, names: list[str], shares: list[str]) -> None:
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
