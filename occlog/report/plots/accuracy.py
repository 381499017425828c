"""Error and bound over time, in total and for each axis, that of the height too where it is known."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from occlog.array_types import Floats, Ints
from occlog.records.tables import Bound, Errors, Tracks
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.drawing.style import COLOURS, label, target_colour
from occlog.report.drawing.thin import broken, envelope, extremes, gaps, sensible_top

T = TypeVar("T", Errors, Bound, Tracks)
BUCKETS, FEWEST = 350, 80
"""Stretches of a line, of each of which the extremes are drawn; those of each target among many, at least."""
OF_ALL = 600
"""The same of the lines of all targets together, so that a page of many stays small."""


def draw_accuracy(figure: FigureBase, data: ReportInput, all_errors: Errors, target: int) -> None:
    """Draw distance with running RMSE and bound, then a row for each axis: error along x, y and, if known, z."""
    errors = of_target(all_errors, target)
    names = axes_of(errors)
    total, *rest = figure.subplots(1 + len(names), 1, sharex=True, height_ratios=[2.0, *[1.0] * len(names)])
    bound = None if data.bound is None else of_target(data.bound, target)
    track = data.followers.get(target, target)
    tracks = None if data.tracks is None or track is None else of_target(data.tracks, track)
    colour = COLOURS["ink"] if track is None else target_colour(data.targets.index(track))
    buckets = max(FEWEST, min(BUCKETS, OF_ALL // len(data.targets)))
    _distance(total, data, target, errors=errors, bound=bound, colour=colour, buckets=buckets)
    for axes, name in zip(rest, names, strict=True):
        _axis_error(axes, data, errors=errors, bound=bound, tracks=tracks, name=name, colour=colour, buckets=buckets)
    rest[-1].set_xlabel(data.time.label)
    rest[-1].set_xlim(0.0, max(data.time.length, 1e-9))
    handles, labels = total.get_legend_handles_labels()
    more_handles, more_labels = rest[0].get_legend_handles_labels()
    figure.legend(handles + more_handles, labels + more_labels, loc="outside lower center", ncols=3)


def of_target(table: T, target: int) -> T:
    """Rows of a target; the table itself where it has no others."""
    own = table.target_id == target
    return table if own.all() else table.take(own)


def axes_of(errors: Errors) -> str:
    """Axes along which there are errors: x, y and, where any height is known, z."""
    return "xyz" if np.isfinite(errors.error_z).any() else "xy"


def _distance(
    axes: Axes, data: ReportInput, target: int, errors: Errors, bound: Bound | None, colour: str, buckets: int
) -> None:
    """Distance between estimate and truth, its running RMSE, and the bound on both, that of smoothing too."""
    time, figures = data.time, data.figures
    assert data.errors is not None
    line(axes, time, errors.t_ns, errors.error, buckets, color=colour, linewidth=0.8, alpha=0.65, label="error")
    rms = figures.errors_so_far[data.errors.target_id == target]
    line(axes, time, errors.t_ns, rms, buckets, color=colour, linewidth=2.0, label="RMSE so far")
    shown = [errors.error, rms]
    if data.bound is not None and bound is not None and len(bound):
        on_rmse, smoothed = figures.bound_so_far[data.bound.target_id == target].T
        line(axes, time, bound.t_ns, bound.bound, buckets, color=COLOURS["bound"], linewidth=0.8, label="bound")
        line(
            axes,
            time,
            bound.t_ns,
            on_rmse,
            buckets,
            color=COLOURS["bound"],
            linewidth=2.0,
            linestyle=(0, (4, 1.5)),
            label="bound on the RMSE so far",
        )
        shown += [bound.bound, on_rmse]
        if figures.bound.smooths(target):
            style = {"color": COLOURS["bound"], "linewidth": 1.6, "linestyle": (0, (1, 1.5))}
            line(axes, time, bound.t_ns, smoothed, buckets, label="the same of smoothing", **style)
    axes.set_ylabel(f"error [{label(data.unit)}]")
    top = sensible_top(*shown)
    axes.set_ylim(0.0, top)
    all_there = data.whole["errors"].every == 1
    mark_clipped(axes, time, t_ns=errors.t_ns, values=errors.error, top=top, unit=data.unit, all_there=all_there)


def line(axes: Axes, time: TimeAxis, t_ns: Ints, values: Floats, buckets: int = BUCKETS, **style: object) -> None:
    """One line, thinned to the extremes of so many stretches, broken at gaps."""
    if len(values):
        keep = extremes(values, buckets)
        t, v = broken(t_ns, keep, time.of(t_ns), values)
        axes.plot(t, v, **style)  # type: ignore[arg-type]


def mark_clipped(
    axes: Axes, time: TimeAxis, t_ns: Ints, values: Floats, top: float, unit: str, *, all_there: bool = True
) -> None:
    """Marks at the upper edge where values leave the drawing, with the highest one in words.

    How many there are is said only if the values are `all_there`.
    """
    over = np.flatnonzero(values > top)
    if not len(over):
        return
    keep = over[extremes(values[over], 40)]
    axes.plot(time.of(t_ns[keep]), np.full(len(keep), top), "^", color=COLOURS["ink"], markersize=4, clip_on=False)
    worst = int(over[np.argmax(values[over])])
    steps = "step" if len(over) == 1 else "steps"
    when = f"{time.of(t_ns[worst : worst + 1])[0]:.4g} {time.unit}"
    above = f"{len(over)} {steps} above" if all_there else "above"
    text = f"{above}, up to {values[worst]:.3g} {label(unit)} at {when}"
    axes.set_title(text, loc="right", fontsize=8, fontweight="normal", color=COLOURS["muted"])


def _axis_error(
    axes: Axes,
    data: ReportInput,
    errors: Errors,
    bound: Bound | None,
    tracks: Tracks | None,
    name: str,
    colour: str,
    buckets: int,
) -> None:
    """Signed error along one axis with what the filter and the bound say of its spread; heights where known."""
    # Columns alone: of a long run tables are large
    t_ns, values = _known(errors.t_ns, getattr(errors, f"error_{name}"))
    shown = [np.abs(values)]
    if tracks is not None:
        of, variance = _known(tracks.t_ns, getattr(tracks, f"cov_{name}{name}"))
        if len(of):
            spread = 2.0 * np.sqrt(np.maximum(variance, 0.0))
            _band(axes, time=data.time, t_ns=of, spread=spread, colour=colour, buckets=buckets)
            shown.append(spread)
    if bound is not None:
        of, variance = _known(bound.t_ns, getattr(bound, f"bound_{name}{name}"))
        if len(of):
            spread = 2.0 * np.sqrt(np.maximum(variance, 0.0))
            style = {"color": COLOURS["bound"], "linewidth": 0.9, "linestyle": (0, (4, 1.5))}
            line(axes, data.time, of, spread, buckets, label="± 2 × bound of the axis", **style)
            line(axes, data.time, of, -spread, buckets, **style)
            shown.append(spread)
    line(axes, data.time, t_ns, values, buckets, color=colour, linewidth=0.8)
    axes.axhline(0.0, color=COLOURS["muted"], linewidth=0.6, zorder=1)
    axes.set_ylabel(f"{name} error [{label(data.unit)}]")
    top = sensible_top(*shown)
    axes.set_ylim(-top, top)


def _known(t_ns: Ints, values: Floats) -> tuple[Ints, Floats]:
    """Times and values where these are known."""
    known = np.isfinite(values)
    return t_ns[known], values[known]


def _band(axes: Axes, time: TimeAxis, t_ns: Ints, spread: Floats, colour: str, buckets: int) -> None:
    """The filter's own +-2 standard deviations, one piece between gaps."""
    named = "± 2 standard deviations of the filter"
    for piece in np.split(np.arange(len(t_ns)), np.flatnonzero(gaps(t_ns))):
        share = max(4, buckets * len(piece) // len(t_ns))
        t, low, high = envelope(time.of(t_ns[piece]), -spread[piece], spread[piece], share)
        axes.fill_between(t, low, high, color=colour, alpha=0.16, linewidth=0, label=named)
        named = ""
