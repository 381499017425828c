"""Plots over time: error and bound in total and by axis; filter diagnostics; people; camera selection; coverage.

Filter: effective sample size, or position uncertainty for a method without particles; fallbacks. People: counts,
presence, detecting cameras, possible identity switches. Without truth: distances from triangulated positions and lines
of sight. Coverage: one row per sensor, filled by the share of detections.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, ScalarFormatter

from occlog.array_types import Bools, Floats, Ints
from occlog.records.tables import Bound, Diagnostics, Errors, Events, PeopleTracks, Tracks
from occlog.report.content.accuracy import deviation
from occlog.report.content.coverage import (
    MAX_SENSORS,
    MAX_TARGETS,
    ObservationCoverage,
    Selections,
    SensorSightings,
    scene_order,
)
from occlog.report.content.model import ReportInput, TimeAxis
from occlog.report.content.people import PeopleCount, PeopleStatistics, true_people, usual_step
from occlog.report.content.sight import DirectionErrors, TriangulationDistances
from occlog.report.drawing import COLOURS, Style, broken, envelope, extremes, gaps, label, sensible_top, target_colour

T = TypeVar("T", Errors, Bound, Tracks)
BUCKETS, FEWEST = 350, 80
"""Sections of a line, of each of which the extremes are drawn; those of each target among many, at least."""
OF_ALL = 600
"""Maximum number of points of the lines of all targets together, so that a page of many stays small."""


def draw_accuracy(figure: FigureBase, data: ReportInput, all_errors: Errors, target: int) -> None:
    """Draw a target's error with running RMSE and bound, then a row for each axis: error along x, y and, if known, z.

    `all_errors`: of all targets; `target`: identity in the errors.
    """
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
    along_time(rest[-1], data.time)
    handles, labels = total.get_legend_handles_labels()
    more_handles, more_labels = rest[0].get_legend_handles_labels()
    figure.legend(handles + more_handles, labels + more_labels, loc="outside lower center", ncols=3)


def along_time(axes: Axes, time: TimeAxis) -> None:
    """Let the abscissa be the whole time axis."""
    axes.set_xlim(0.0, max(time.length, 1e-9))
    axes.set_xlabel(time.label)


def of_target(table: T, target: int) -> T:
    """Return the rows of a target; the table itself if it has no other target."""
    own = table.target_id == target
    return table if own.all() else table.take(own)


def axes_of(errors: Errors) -> str:
    """Return the axes with errors: `xy`, or `xyz` if any error of height is known."""
    return "xyz" if np.isfinite(errors.error_z).any() else "xy"


def _distance(
    axes: Axes, data: ReportInput, target: int, errors: Errors, bound: Bound | None, colour: str, buckets: int
) -> None:
    """Draw the distance between estimate and truth, its running RMSE, and both bounds (filtering, smoothing).

    Args:
        axes: drawn on.
        data: running figures and time axis.
        target: its identity.
        errors: errors of the target.
        bound: bound of the target; None: unknown.
        colour: colour of the target.
        buckets: number of sections to which lines are thinned.
    """
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
    """Draw a line over time, thinned to the extremes of `buckets` sections, and broken at gaps.

    `values`: (n,) at the times `t_ns` (n,) [ns]; `time`: converts them to the axis; `style`: keywords of Matplotlib.
    """
    if len(values):
        keep = extremes(values, buckets)
        t, v = broken(t_ns, keep, time.of(t_ns), values)
        axes.plot(t, v, **style)  # type: ignore[arg-type]


def mark_clipped(
    axes: Axes, time: TimeAxis, t_ns: Ints, values: Floats, top: float, unit: str, *, all_there: bool = True
) -> None:
    """Mark values beyond the upper edge of a plot by triangles, with the number of them and the highest one as text.

    Args:
        axes: drawn on.
        time: time axis.
        t_ns: (n,) times [ns].
        values: (n,) values.
        top: upper edge of the axes.
        unit: unit of the values.
        all_there: whether `values` are all, so that their number is stated.
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
    """Draw the signed error along one axis, with two standard deviations by the filter and by the bound.

    Args:
        axes: drawn on.
        data: time axis and unit.
        errors: errors of the target.
        bound: bound of the target; None: unknown.
        tracks: tracks of the target, with covariances; None: unknown.
        name: `x`, `y` or `z`.
        colour: colour of the target.
        buckets: number of sections to which lines are thinned.
    """
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
    """Return times and values, each (n,), without the rows in which the value is NaN."""
    known = np.isfinite(values)
    return t_ns[known], values[known]


def _band(axes: Axes, time: TimeAxis, t_ns: Ints, spread: Floats, colour: str, buckets: int) -> None:
    """Draw the filter's band of +-2 standard deviations about 0, broken at gaps.

    Args:
        axes: drawn on.
        time: time axis.
        t_ns: (n,) times [ns].
        spread: (n,) two standard deviations.
        colour: colour of the target.
        buckets: number of sections to which the band is thinned.
    """
    named = "± 2 standard deviations of the filter"
    for piece in np.split(np.arange(len(t_ns)), np.flatnonzero(gaps(t_ns))):
        share = max(4, buckets * len(piece) // len(t_ns))
        t, low, high = envelope(time.of(t_ns[piece]), -spread[piece], spread[piece], share)
        axes.fill_between(t, low, high, color=colour, alpha=0.16, linewidth=0, label=named)
        named = ""


MAX_PLOTTED_TARGETS = 6
FALLBACKS = {
    "sir": ("hidden", "d", "auxiliary stage skipped"),
    "restart": ("t5", "v", "particles redrawn"),
    "gap": ("t5", "s", "particles redrawn after a gap"),
    "depleted": ("t1", "d", "fewer than ten effective particles"),
    "unobservable": ("hidden", "d", "position hardly known"),
    "infeasible_constraints": ("t5", "v", "constraints contradict each other"),
    "no_path": ("t1", "s", "no way around a wall"),
    "not_converged": ("ink", "x", "search did not converge"),
    "few_inliers": ("t2", "v", "fewer than half of the bearings accepted"),
    "rival_mode": ("t2", "d", "another trajectory nearly as probable"),
}


def draw_filter(figure: FigureBase, data: ReportInput, diagnostics: Diagnostics) -> None:
    """Draw the effective sample size of each target's filter over time, with a mark at each fallback.

    For a method without particles the position's standard deviation is drawn instead.
    """
    axes = figure.add_subplot()
    if data.filter_diagnostics is None or not data.filter_diagnostics.particles:
        _deviation(axes, data)
        _finish(figure, axes, data)
        return
    _each_target(axes, data, diagnostics, diagnostics.ess, "effective sample size")
    _scale(axes, float(diagnostics.ess.min()), float(diagnostics.ess.max()))
    axes.set_ylabel("effective sample size")
    _finish(figure, axes, data)


def _deviation(axes: Axes, data: ReportInput) -> None:
    """Draw the standard deviation of each target's position, up to `MAX_PLOTTED_TARGETS`; nothing without tracks."""
    tracks = data.tracks
    if tracks is None:
        return
    _each_target(axes, data, tracks, deviation(tracks), "standard deviation of the position")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(f"standard deviation [{data.unit}]")


def _each_target(axes: Axes, data: ReportInput, table: Tracks | Diagnostics, values: Floats, alone: str) -> None:
    """Draw a line for each of the first targets of a table; `alone`: its name where there is no other target."""
    targets = np.unique(table.target_id)
    for i, target in enumerate(targets[:MAX_PLOTTED_TARGETS]):
        own = table.target_id == target
        name = f"target {target}" if len(targets) > 1 else alone
        line(axes, data.time, table.t_ns[own], values[own], color=target_colour(i), linewidth=0.9, label=name)


def _finish(figure: FigureBase, axes: Axes, data: ReportInput) -> None:
    """Add marks of fallbacks, time axis and legend to a plot of the filter."""
    _fallbacks(axes, data)
    along_time(axes, data.time)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)


def _scale(axes: Axes, low: float, high: float) -> None:
    """Scale an ordinate from zero, or logarithmically if the largest value, `high`, exceeds 20 times `low`."""
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
    """Draw marks of the filter's fallbacks at the lower edge, by kind, with their numbers in the legend."""
    for kind, found in data.filter_diagnostics.fallbacks.items() if data.filter_diagnostics is not None else ():
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


DOTS = 120
DOT_COLOURS = ("t0", "t3", "t2", "t1", "t5", "t4")
DOT_MARKERS = ("o", "s", "^", "v", "D", "P")


def draw_sight(figure: FigureBase, data: ReportInput, target: int) -> None:
    """Draw the distance of a target's track from triangulated positions, and bearing residuals [deg] below."""
    found = data.sight[target]
    handles: list[Line2D] = []
    if found.rows:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.2, 1.0])
        handles += _plot_distance(above, data, found, target_colour(data.targets.index(target)))
    else:
        below = figure.add_subplot()
    handles += _residuals(below, data, data.residuals[target].drawn)
    along_time(below, data.time)
    if handles:
        figure.legend(handles=handles[:20], loc="outside lower center", ncols=min(len(handles), 6))


def _plot_distance(axes: Axes, data: ReportInput, found: TriangulationDistances, colour: str) -> list[Line2D]:
    t_ns, distance = found.t_ns, found.distance
    line(axes, data.time, t_ns, distance, color=colour, linewidth=0.8, alpha=0.7, label="distance")
    line(axes, data.time, t_ns, found.so_far, color=colour, linewidth=2.0, label="RMS so far")
    top = sensible_top(distance)
    axes.set_ylim(0.0, top)
    mark_clipped(axes, data.time, t_ns=t_ns, values=distance, top=top, unit=data.unit, all_there=found.every == 1)
    axes.set_ylabel(f"distance [{label(data.unit)}]")
    return [handle for handle in axes.get_legend_handles_labels()[0] if isinstance(handle, Line2D)]


def _residuals(axes: Axes, data: ReportInput, found: DirectionErrors) -> list[Line2D]:
    """Draw bearing residuals [deg] as dots, with a marker for each sensor; return the entries of the legend."""
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
    axes.set_ylabel("off line of sight [°]")
    return handles


CELLS_OF_ALL, MIN_CELLS = 4800, 60
"""Cells of all sensors and targets together, so that a page of many stays small; those of each one, at least."""
HEIGHT = 0.72


def watched(data: ReportInput) -> tuple[int, ...]:
    """Return the labels of bearings for which observation coverage is drawn; -1 (any object) only without others.

    Empty without bearings, and for tracks of all people if all bearings are detections, which would show every sensor
    as detecting at all times.
    """
    coverage = data.coverage
    if coverage is None or (data.people_tracks is not None and coverage.seen == coverage.rows):
        return ()
    return coverage.watched


def sensors(data: ReportInput) -> tuple[str, ...]:
    """Return the names of all sensors: in the order of the scene, then those in bearings only."""
    return scene_order(data.scene, [] if data.coverage is None else data.coverage.sensors)


def draw_visibility(
    figure: FigureBase, data: ReportInput, coverage: ObservationCoverage, target: int, most: int = MAX_SENSORS
) -> None:
    """Draw a row for each of the first `most` sensors: when it detected the target; the first sensor is on top."""
    names = sensors(data)[:most]
    cells = max(CELLS_OF_ALL // max(len(names) * min(len(coverage.watched), MAX_TARGETS), 1), MIN_CELLS)
    rows = [coarser(coverage.sightings(name, target), cells) for name in names]
    _draw_rows(figure, data.time, rows, names, ("target seen", "frame, target not seen", "no frame"))


def coarser(found: SensorSightings, most: int) -> SensorSightings:
    """Return the counts of a sensor with neighbouring intervals merged, so that at most `most` remain."""
    together = -(-len(found.observed) // most)
    if together <= 1:
        return found
    first = np.arange(0, len(found.observed), together)
    observed, seen = (np.add.reduceat(each, first) for each in (found.observed, found.seen))
    return replace(found, edges=np.append(found.edges[first], found.edges[-1]), observed=observed, seen=seen)


def _draw_rows(
    figure: FigureBase, time: TimeAxis, rows: Sequence[SensorSightings], names: Sequence[str], words: Sequence[str]
) -> None:
    """Draw a bar for each sensor over time, with its name and its share of detections; the first sensor is on top.

    `words`: legend of the parts of a bar: detected, not detected, no frame.
    """
    axes = figure.add_subplot()
    shares = []
    for row, found in enumerate(rows):
        _bar(axes, time, found, -float(row))
        kind = "any" if found.any_object else "seen"
        shares.append("no frame" if np.isnan(found.share) else f"{_percent(found.share)} {kind}")
    label_rows(axes, names, shares)
    along_time(axes, time)
    parts = zip(("seen", "hidden", "absent"), words, strict=True)
    handles = [Patch(facecolor=COLOURS[colour], label=text) for colour, text in parts]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)


def _percent(share: float) -> str:
    """Return a share, 0 to 1, as text in whole per cent; 0 and 100 only if exact."""
    if 0.0 < share < 1.0:
        return f"{min(max(round(100 * share), 1), 99)} %"
    return f"{100 * share:.0f} %"


def label_rows(axes: Axes, names: Sequence[str], shares: Sequence[str]) -> None:
    """Write the names of rows on the left and texts (`shares`) on the right of a plot; the first row is on top."""
    ticks = [-float(i) for i in range(len(names))]
    axes.set_yticks(ticks, [label(n, 18) for n in names])
    axes.set_ylim(-len(names) + 1 - 0.6, 0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(False)
    axes.spines["left"].set_visible(False)
    right = axes.secondary_yaxis("right")
    right.set_yticks(ticks, shares)
    right.tick_params(length=0, labelsize=8, labelcolor=COLOURS["muted"])
    right.spines["right"].set_visible(False)


def _bar(axes: Axes, time: TimeAxis, found: SensorSightings, y: float) -> None:
    """Draw a sensor's bar at the ordinate y: grey without frames, else orange, blue up to the share of detections."""
    low = y - HEIGHT / 2
    axes.fill_between([0.0, time.length], low, low + HEIGHT, color=COLOURS["absent"], linewidth=0)
    if not len(found.observed):
        return
    edges, share = _merged(found)
    at = time.of(edges)
    frames = np.where(np.isnan(share), np.nan, low + HEIGHT)
    axes.stairs(frames, at, baseline=low, fill=True, color=COLOURS["hidden"], linewidth=0)
    filled = np.where(share > 0, low + HEIGHT * share, np.nan)
    axes.stairs(filled, at, baseline=low, fill=True, color=COLOURS["seen"], linewidth=0)


def _merged(found: SensorSightings) -> tuple[Ints, Floats]:
    """Return interval borders [ns] and the share of detections (NaN without frames), equal neighbours merged."""
    share = np.where(found.observed > 0, found.seen / np.maximum(found.observed, 1), -1.0)
    first = np.concatenate([[True], np.diff(share) != 0])
    edges = np.append(found.edges[:-1][first], found.edges[-1])
    return edges, np.where(share[first] < 0, np.nan, share[first])


LONGEST_GAP = 1.5
"""A row of a track lasts until the next one, but at most this many usual periods."""
SEEN, SINGLE_VIEW, COASTING = "seen", "view", "hidden"
"""Colours of people of whom several cameras, one camera or none has a box."""


def draw_crowd(figure: FigureBase, data: ReportInput, tracks: PeopleTracks, found: PeopleStatistics) -> None:
    """Draw the number of people over time above, and a row for each of the longest tracks below.

    `tracks`: rows of the people; `found`: their statistics.
    """
    people, events = found.drawn, data.events
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, max(0.16 * len(people), 0.6)))
    _counts(above, data, found.crowd)
    for index, identity in enumerate(people.tolist()):
        _life(below, data.time, tracks.take(tracks.target_id == identity), -float(index))
    _doubts(below, data.time, people, events)
    below.set_yticks(-np.arange(len(people), dtype=float), [str(i) for i in people.tolist()])
    below.tick_params(axis="y", length=0, labelsize=min(8.0, 330.0 / max(len(people), 1) ** 0.95))
    below.set_ylim(-len(people) + 0.4, 0.6)
    below.set_ylabel("identity")
    below.grid(False)
    below.spines["left"].set_visible(False)
    along_time(below, data.time)
    figure.legend(handles=_legend(data, events), loc="outside lower center", ncols=4)


def draw_seen_by(figure: FigureBase, data: ReportInput, found: PeopleStatistics) -> None:
    """Draw for each camera, over time, the share of the people that it has a box of."""
    names = found.cameras[:MAX_SENSORS]
    rows = [found.sightings(name) for name in names]
    words = ("share of the people there that it sees", "the others", "no person present")
    _draw_rows(figure, data.time, rows, names, words)


def _counts(axes: Axes, data: ReportInput, found: PeopleCount) -> None:
    if data.truth is not None:
        times, number = true_people(data.truth, data.whole["truth"].at)
        line(axes, data.time, times, number, color=COLOURS["muted"], linewidth=2.6, alpha=0.5)
    line(axes, data.time, found.t_ns, found.people, color=COLOURS["ink"], linewidth=1.1)
    line(axes, data.time, found.t_ns, found.seen, color=COLOURS[SEEN], linewidth=0.9)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
    axes.set_ylabel("people")


def _life(axes: Axes, time: TimeAxis, own: PeopleTracks, y: float) -> None:
    """Draw a person's presence as a bar at the ordinate y, coloured by whether several, one or no camera detects them.

    `own`: rows of the person.
    """
    last = max(int(LONGEST_GAP * usual_step(own.t_ns)), 1)
    ends = np.append(np.minimum(own.t_ns[1:], own.t_ns[:-1] + last), own.t_ns[-1] + last)
    kind = np.where(own.seen_by == "", 2, np.where(np.char.find(own.seen_by, ",") < 0, 1, 0))
    # Neighbours of one kind are one piece
    first = np.concatenate([[True], (np.diff(kind) != 0) | (own.t_ns[1:] > ends[:-1])])
    begins, stops, kinds = own.t_ns[first], ends[np.append(first[1:], True)], kind[first]
    for index, colour in enumerate((SEEN, SINGLE_VIEW, COASTING)):
        mine = kinds == index
        spans = np.column_stack([time.of(begins[mine]), time.of(stops[mine]) - time.of(begins[mine])])
        axes.broken_barh(spans.tolist(), (y - HEIGHT / 2, HEIGHT), facecolor=COLOURS[colour], linewidth=0)


def _doubts(axes: Axes, time: TimeAxis, people: Ints, events: Events | None) -> None:
    """Mark possible identity switches in the rows of the identities `people` (n,); nothing without events (None)."""
    if events is None:
        return
    doubts = events.take((events.kind == "possible_switch") & np.isin(events.target_id, people))
    index_of = {identity: row for row, identity in enumerate(people.tolist())}
    rows = [-float(index_of[i]) for i in doubts.target_id.tolist()]
    axes.plot(time.of(doubts.t_ns), rows, "x", color=COLOURS["t5"], markersize=4.5, markeredgewidth=1.4)


def _legend(data: ReportInput, events: Events | None) -> list[Patch | Line2D]:
    kinds = ((SEEN, "seen by several cameras"), (SINGLE_VIEW, "by one camera"), (COASTING, "by none: predicted"))
    out: list[Patch | Line2D] = [Patch(facecolor=COLOURS[colour], label=text) for colour, text in kinds]
    if events is not None and (events.kind == "possible_switch").any():
        out.append(Line2D([], [], linestyle="", marker="x", color=COLOURS["t5"], label="may have been exchanged"))
    out.append(Line2D([], [], color=COLOURS["ink"], linewidth=1.1, label="people there"))
    out.append(Line2D([], [], color=COLOURS[SEEN], linewidth=0.9, label="seen by a camera"))
    if data.truth is not None and (data.truth.role == "target").any():
        out.append(Line2D([], [], color=COLOURS["muted"], linewidth=2.6, alpha=0.5, label="truth"))
    return out


def cameras_of(data: ReportInput, found: Selections) -> tuple[str, ...]:
    """Return the names of the cameras: those of the scene in order, then those in the selections only."""
    known = () if data.scene is None else tuple(c.name for c in data.scene.cameras)
    return (*known, *sorted(set(found.shares) - set(known)))


def draw_selection(figure: FigureBase, data: ReportInput, found: Selections) -> None:
    """Draw a row for each camera, filled while it is selected, with its share of time on the right."""
    axes = figure.add_subplot()
    names = cameras_of(data, found)[:MAX_SENSORS]
    shares = []
    for row, name in enumerate(names):
        on = np.array([name in cameras for cameras in found.chosen], dtype=np.bool_)
        _bars(axes, data, found.times, on, -float(row))
        shares.append(f"{100 * found.shares.get(name, 0.0):.0f} %")
    label_rows(axes, names, shares)
    along_time(axes, data.time)


def _bars(axes: Axes, data: ReportInput, times: Ints, on: Bools, y: float) -> None:
    low = y - HEIGHT / 2
    axes.fill_between([0.0, data.time.length], low, low + HEIGHT, color=COLOURS["absent"], linewidth=0)
    if not on.any():
        return
    changes = np.flatnonzero(np.diff(on.astype(np.int8), prepend=0, append=0))
    edges = data.time.of(times[changes])
    filled = np.where(np.arange(len(changes) - 1) % 2 == 0, low + HEIGHT, np.nan)
    axes.stairs(filled, edges, baseline=low, fill=True, color=COLOURS["seen"], linewidth=0)
