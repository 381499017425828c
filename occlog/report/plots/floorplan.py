"""The floor plan: room, occluders, sensors and what they see, priors of moving occluders, true and estimated paths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch, Polygon

from occlog.array_types import Floats, Ints
from occlog.core.metrics.errors import CHI2_95_2D
from occlog.records.columns import rows_by_label
from occlog.records.scene import Scene
from occlog.records.tables import Hulls, Occluders, Tracks, Truth
from occlog.report.content.model import ReportInput
from occlog.report.content.plane_of_sight import places
from occlog.report.drawing.style import COLOURS, Style, label, target_colour
from occlog.report.drawing.thin import broken, thin_path

from .planscene import draw_scale_bar, draw_scene, frame_plan, name_sensors

NOBODY = np.zeros(0, dtype=np.int64)
"""Rows of an identity that is not there."""
ELLIPSES, ELLIPSES_OF_ALL = 24, 480
"""Ellipses along the path of a target at most, and of all targets together; each takes as much as 25 points."""
PATH_POINTS = 1400
"""Stretches of the paths of all targets, of each of which extremes are drawn; each target has at most half of them."""
FEWEST_POINTS = 12
MOST_MOVING_OCCLUDERS = 8
MOST_NAMES = 6
TRUE_PATH: Style = {"color": COLOURS["ink"], "linewidth": 1.0, "linestyle": (0, (4, 2))}


FAR = 10.0
"""Cameras farther from the room than so many times its size are not drawn, but named."""
LONG = 15.0
RECENT = 6.0
"""A path longer than `LONG` times the plan's diagonal is drawn faint but for its last `RECENT` diagonals."""
MOMENTS = 8
"""Times at which priors are drawn; more hide each other."""


def draw_floorplan(figure: FigureBase, data: ReportInput) -> None:
    """Draw the floor plan into a figure, with a legend below it."""
    axes = figure.add_subplot()
    limits = plan_limits(data)
    handles: list[Line2D | Patch] = []
    near, far = (None, []) if data.scene is None else near_scene(data.scene)
    if near is not None:
        handles += draw_scene(axes, near, limits)
    if far:
        handles.append(Line2D([], [], linestyle="none", label=f"far away: {label(', '.join(far), 40)}"))
    if data.truth is not None:
        handles += _moving_occluders(axes, data.truth)
    if data.occluders is not None:
        handles += draw_priors(axes, data.occluders)
    handles += _paths(axes, data)
    frame_plan(axes, limits, data.unit)
    bar = draw_scale_bar(axes, limits, label(data.unit))
    if near is not None:
        name_sensors(axes, near, limits, bar)
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))


def plan_limits(data: ReportInput) -> Floats:
    """(2, 2) lower and upper corner of what is drawn: the scene whole, the paths but for a few outliers."""
    points = []
    if data.scene is not None:
        points += [data.scene.room] if data.scene.room is not None else []
        points += [o.polygon for o in data.scene.occluders]
        points += [p[None] for p in places(near_scene(data.scene)[0]).values()]
    paths = [t for t in (data.tracks, data.truth) if t is not None and len(t)]
    for xy in (np.column_stack([table.x, table.y]) for table in paths):
        points.append(np.percentile(xy, [0.5, 99.5], axis=0) if len(xy) > 200 else xy)
    if data.scene is not None and data.scene.room is None and not paths:
        points.append(_ahead(data.scene))
    if not points:
        return np.array([[0.0, 0.0], [1.0, 1.0]])
    everything = np.vstack(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    # A path along a line still gets a plan that is not a line.
    size = max(float((high - low).max()), 1e-6)
    grow = np.maximum(0.3 * size - (high - low), 0.0) / 2.0 + 0.06 * size
    return np.array([low - grow, high + grow])


def near_scene(scene: Scene) -> tuple[Scene, list[str]]:
    """The scene without cameras so far from its room that this would be a dot, and their names."""
    if scene.room is None:
        return scene, []
    low, high = scene.room.min(axis=0), scene.room.max(axis=0)
    most = FAR * float((high - low).max())
    far = [c.name for c in scene.cameras if c.placed and np.abs(c.ground - 0.5 * (low + high)).max() > most]
    return replace(scene, cameras=tuple(c for c in scene.cameras if c.name not in far)), far


def _ahead(scene: Scene) -> Floats:
    """(N, 2) points in front of the cameras, about as far as they are from each other."""
    cameras = [c for c in scene.cameras if c.placed]
    at = np.array([c.ground for c in cameras]).reshape(-1, 2)
    spread = float(np.ptp(at, axis=0).max()) if len(at) else 0.0
    ahead = np.array([[np.cos(c.yaw), np.sin(c.yaw)] for c in cameras]).reshape(-1, 2)
    return np.asarray(at + (1.2 * spread if spread > 0 else 5.0) * ahead)


def outside(data: ReportInput) -> int:
    """How many estimates lie outside the drawing."""
    if data.tracks is None:
        return 0
    (x0, y0), (x1, y1) = plan_limits(data)
    x, y = data.tracks.x, data.tracks.y
    return int(np.count_nonzero((x < x0) | (x > x1) | (y < y0) | (y > y1)))


def bold_from(data: ReportInput) -> int | None:
    """Time [ns] from which paths are drawn boldly; None where they are short enough to be drawn so from the start."""
    limits = plan_limits(data)
    diagonal = float(np.hypot(*(limits[1] - limits[0])))
    starts = []
    there = [(table, dict(rows_by_label(table.target_id))) for table in (data.truth, data.tracks) if table is not None]
    for target in data.targets:
        for table, rows_of in there:
            rows = rows_of.get(target, NOBODY)
            if len(rows) < 2:
                continue
            steps = np.hypot(np.diff(table.x[rows]), np.diff(table.y[rows]))
            to_go = np.cumsum(steps[::-1])[::-1]
            if to_go[0] > LONG * diagonal:
                starts.append(int(table.t_ns[rows[np.flatnonzero(to_go > RECENT * diagonal)[-1]]]))
            break
    return min(starts) if starts else None


def _moving_occluders(axes: Axes, truth: Truth) -> list[Line2D | Patch]:
    rows_of = _rows_of(truth, "occluder")
    if not rows_of or len(rows_of) > MOST_MOVING_OCCLUDERS:
        return []
    style: Style = {"color": COLOURS["muted"], "linewidth": 0.6, "alpha": 0.45, "zorder": 2.2}
    for rows in rows_of.values():
        _line(axes, truth, rows, PATH_POINTS // 2, **style)
    return [Line2D([], [], label="moving occluder", **style)]


def _rows_of(truth: Truth, role: str) -> dict[int, Ints]:
    """Rows of each identity of a role."""
    those = np.flatnonzero(truth.role == role)
    return {identity: those[rows] for identity, rows in rows_by_label(truth.target_id[those])}


def _line(axes: Axes, table: Tracks | Truth, rows: Ints, points: int, **style: Any) -> None:
    """One path, thinned, broken at gaps."""
    part = table.take(rows)
    keep = thin_path(np.column_stack([part.x, part.y]), points)
    x, y = broken(part.t_ns, keep, part.x, part.y)
    axes.plot(x, y, **style)


def _path(axes: Axes, table: Tracks | Truth, rows: Ints, since: int | None, points: int, **style: Any) -> None:
    """One path; what is older than `since` is faint."""
    if since is not None:
        faint = {"color": style["color"], "linewidth": 0.4, "alpha": 0.3, "zorder": 2.8}
        _line(axes, table, rows[table.t_ns[rows] <= since], points, **faint)
        rows = rows[table.t_ns[rows] >= since]
    _line(axes, table, rows, points, **style)


def _paths(axes: Axes, data: ReportInput) -> list[Line2D | Patch]:
    since = bold_from(data)
    points = max(PATH_POINTS // max(len(data.targets), 2), FEWEST_POINTS)
    ellipses = min(ELLIPSES, ELLIPSES_OF_ALL // max(len(data.targets), 1))
    handles: list[Line2D | Patch] = []
    estimated = {} if data.tracks is None else dict(rows_by_label(data.tracks.target_id))
    for i, target in enumerate(data.targets):
        colour = target_colour(i)
        if data.tracks is not None:
            _estimate(axes, data.tracks, estimated.get(target, NOBODY), since, colour, points, ellipses)
            name = "estimated path" if len(data.targets) == 1 else f"target {target}, estimated"
            handles += [Line2D([], [], color=colour, linewidth=1.8, label=name)] if i < MOST_NAMES else []
    if data.truth is not None:
        true = _rows_of(data.truth, "target")
        # Of those that nobody tracks, too, where names do not tell who is tracked
        for target in data.targets if data.same_names else true:
            rows = true.get(target, NOBODY)
            _path(axes, data.truth, rows, since, points, zorder=4, **TRUE_PATH)
            if data.tracks is None:
                _ends(axes, data.truth.take(rows), COLOURS["ink"])
    return handles + (_path_handles(data) if data.targets else [])


def _path_handles(data: ReportInput) -> list[Line2D | Patch]:
    """What the legend says of all paths."""
    mark: Style = {"color": COLOURS["ink"], "linestyle": "none", "markersize": 6}
    out: list[Line2D | Patch] = []
    if data.truth is not None:
        out.append(Line2D([], [], label="true path", **TRUE_PATH))
    if data.tracks is not None:
        out.append(Patch(facecolor="none", edgecolor=target_colour(0), alpha=0.8, label="95 % ellipse of the estimate"))
    out.append(Line2D([], [], marker="o", markerfacecolor=COLOURS["halo"], label="start", **mark))
    return [*out, Line2D([], [], marker="X", label="end", **mark)]


def _estimate(
    axes: Axes, tracks: Tracks, rows: Ints, since: int | None, colour: str, points: int, ellipses: int
) -> None:
    _path(axes, tracks, rows, since, points, color=colour, linewidth=1.8, zorder=3.5)
    own = tracks.take(rows if since is None else rows[tracks.t_ns[rows] >= since])
    if not len(own):
        return
    for row in np.unique(np.linspace(0, len(own) - 1, ellipses).round().astype(int)):
        if np.isnan(own.cov_xx[row]):  # tracks of another program
            continue
        style: Style = {"fill": False, "edgecolor": colour, "linewidth": 0.8, "alpha": 0.75, "zorder": 3.2}
        axes.add_patch(confidence_ellipse(own, int(row), **style))
    _ends(axes, tracks.take(rows), colour)


def confidence_ellipse(rows: Tracks | Occluders, row: int, **style: Any) -> Ellipse:
    """Ellipse that holds an object with 95 % probability if its place is Gaussian; a known place has no area."""
    covariance = np.array([[rows.cov_xx[row], rows.cov_xy[row]], [rows.cov_xy[row], rows.cov_yy[row]]])
    values, vectors = np.linalg.eigh(covariance)
    minor, major = 2.0 * np.sqrt(CHI2_95_2D * np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    return Ellipse((float(rows.x[row]), float(rows.y[row])), float(major), float(minor), angle=angle, **style)


def _ends(axes: Axes, path: Tracks | Truth, colour: str) -> None:
    style: Style = {"linestyle": "none", "zorder": 5, "markersize": 7}
    edge: Style = {"markerfacecolor": COLOURS["halo"], "markeredgecolor": colour, "markeredgewidth": 1.6}
    axes.plot(path.x[:1], path.y[:1], "o", **edge, **style)
    axes.plot(path.x[-1:], path.y[-1:], "X", color=colour, **style)


def draw_priors(axes: Axes, priors: Occluders | Hulls) -> list[Line2D | Patch]:
    """Draw the priors of a few moments, evenly spread over those that have any; what the legend says of them."""
    there = priors.take(priors.occluder_id >= 0)
    if not len(there):
        return []
    style: Style = {"facecolor": COLOURS["moving"], "edgecolor": COLOURS["moving"], "linewidth": 0.6}
    shown = there.take(np.isin(there.t_ns, moments(there.t_ns)))
    if isinstance(shown, Hulls):
        kind, patches = "hull of a moving occluder", _polygons(shown, style)
    else:
        kind, rows = "95 % ellipse of a moving occluder", range(len(shown))
        patches = [confidence_ellipse(shown, row, alpha=0.16, zorder=2.4, **style) for row in rows]
    for patch in patches:
        axes.add_patch(patch)
    return [Patch(label=kind, alpha=0.3, **style)]


def moments(t_ns: Ints) -> Ints:
    """The times at which priors are drawn."""
    times = np.unique(t_ns)
    if not len(times):
        return times
    some: Ints = times[np.unique(np.linspace(0, len(times) - 1, MOMENTS).round().astype(int))]
    return some


def _polygons(hulls: Hulls, style: Style) -> list[Patch]:
    """One patch a polygon."""
    first = np.flatnonzero(hulls.corner == 0)
    corners = np.split(np.column_stack([hulls.x, hulls.y]), first[1:])
    return [Polygon(xy, closed=True, alpha=0.22, zorder=2.4, **style) for xy in corners]
