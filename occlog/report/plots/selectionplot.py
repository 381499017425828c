"""Which cameras were selected when, and the error that was expected of them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from occlog.array_types import Bools, Floats, Ints
from occlog.records.tables import Diagnostics, Errors, Tracks
from occlog.report.content.model import ReportInput
from occlog.report.drawing.style import COLOURS, label

from .visibility import MOST_ROWS

HEIGHT = 0.72


def selected_targets(diagnostics: Diagnostics | None) -> tuple[int, ...]:
    """Targets for which cameras were selected."""
    if diagnostics is None:
        return ()
    rows = np.isfinite(diagnostics.predicted_mse)
    return tuple(int(t) for t in np.unique(diagnostics.target_id[rows]))


def spans(diagnostics: Diagnostics, target: int) -> tuple[Ints, list[frozenset[str]], Floats]:
    """Selections of one target.

    Returns:
        (n + 1,) times of the selections and the last scan [ns]; the cameras of each; (n,) expected RMSE.
    """
    own = diagnostics.take(diagnostics.target_id == target)
    rows = np.flatnonzero(np.isfinite(own.predicted_mse))
    times = np.append(own.t_ns[rows], own.t_ns[-1:])
    names = [frozenset(own.selected[r].split(",")) for r in rows.tolist()]
    return times, names, np.sqrt(own.predicted_mse[rows])


def expected_and_found(diagnostics: Diagnostics, data: ReportInput, target: int) -> tuple[float, float, str]:
    """RMS of the error expected at selections, and of what came out right then; NaN and a word if nothing is known.

    What came out is the error where there is truth, else the spread that the filter states.
    """
    own = diagnostics.take((diagnostics.target_id == target) & np.isfinite(diagnostics.predicted_mse))
    expected = float(np.sqrt(own.predicted_mse.mean())) if len(own) else float("nan")
    if isinstance(data.errors, Errors) and len(data.errors):
        rows = np.isin(data.errors.t_ns, own.t_ns) & (data.errors.target_id == target)
        if rows.any():
            return expected, float(np.sqrt(np.mean(data.errors.error[rows] ** 2))), "error"
    tracks: Tracks | None = data.tracks
    if tracks is not None and len(tracks):
        rows = np.isin(tracks.t_ns, own.t_ns) & (tracks.target_id == target)
        if rows.any():
            return expected, float(np.sqrt(np.mean(tracks.cov_xx[rows] + tracks.cov_yy[rows]))), "stated spread"
    return expected, float("nan"), ""


def cameras_of(data: ReportInput, chosen: list[frozenset[str]]) -> tuple[str, ...]:
    """Cameras in the scene's order, then those that only the diagnostics know."""
    known = () if data.scene is None else tuple(c.name for c in data.scene.cameras)
    found = sorted(frozenset().union(*chosen) - frozenset(known)) if chosen else []
    return (*known, *found)


def draw_selection(figure: FigureBase, data: ReportInput, diagnostics: Diagnostics, target: int) -> None:
    """Draw a row for every camera, filled while it was selected, and the share of the time on the right."""
    axes = figure.add_subplot()
    times, chosen, _ = spans(diagnostics, target)
    names = cameras_of(data, chosen)[:MOST_ROWS]
    whole = max(float(times[-1] - times[0]), 1.0)
    shares = []
    for row, name in enumerate(names):
        on = np.array([name in cameras for cameras in chosen], dtype=np.bool_)
        _bars(axes, data, times, on, -float(row))
        shares.append(f"{100 * float(np.diff(times)[on].sum()) / whole:.0f} %")
    ticks = [-float(i) for i in range(len(names))]
    axes.set_yticks(ticks, [label(n, 18) for n in names])
    axes.set_ylim(-len(names) + 1 - 0.6, 0.6)
    axes.set_xlim(0.0, max(data.time.length, 1e-9))
    axes.set_xlabel(data.time.label)
    axes.tick_params(axis="y", length=0)
    axes.grid(False)
    axes.spines["left"].set_visible(False)
    right = axes.secondary_yaxis("right")
    right.set_yticks(ticks, shares)
    right.tick_params(length=0, labelsize=8, labelcolor=COLOURS["muted"])
    right.spines["right"].set_visible(False)


def _bars(axes: Axes, data: ReportInput, times: Ints, on: Bools, y: float) -> None:
    low = y - HEIGHT / 2
    axes.fill_between([0.0, data.time.length], low, low + HEIGHT, color=COLOURS["absent"], linewidth=0)
    if not on.any():
        return
    changes = np.flatnonzero(np.diff(on.astype(np.int8), prepend=0, append=0))
    edges = data.time.of(times[changes])
    filled = np.where(np.arange(len(changes) - 1) % 2 == 0, low + HEIGHT, np.nan)
    axes.stairs(filled, edges, baseline=low, fill=True, color=COLOURS["seen"], linewidth=0)
