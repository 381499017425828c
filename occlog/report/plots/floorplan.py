"""Floor plan: room, occluders, sensors with fields of view, priors of moving occluders, true and estimated paths.

Names next to points are placed without overlap.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch, Polygon, Rectangle

from occlog.array_types import Floats, Ints
from occlog.core.metrics.errors import CHI2_95_2D
from occlog.records.columns import rows_by_label
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Hulls, Occluders, Tracks, Truth
from occlog.report.content.model import ReportInput
from occlog.report.content.sight import edges_of, sensor_positions, visible_area
from occlog.report.drawing import COLOURS, Style, broken, label, target_colour, thin_path

FONT_SIZE = 8.5
"""Size of names [points]."""
CHARACTER = 0.62
"""Mean width of a character in units of the font's size."""


def place_labels(axes: Axes, points: Floats, texts: list[str], limits: Floats, keep_free: list[Floats]) -> None:
    """Write a name next to each point, where it covers least, preferably on the side away from the centre.

    Args:
        axes: where to draw; its limits must be set to `limits`, with equal scales.
        points: (N, 2) in data coordinates.
        texts: N names.
        limits: (2, 2) lower and upper corner of the axes.
        keep_free: boxes, (2, 2) lower and upper corner in data coordinates, that no name should cover.
    """
    window = axes.get_window_extent()
    extent = limits[1] - limits[0]
    # Points of the font a unit of the data takes; the axes keep equal scales inside their box.
    scale = 72.0 / float(axes.figure.dpi) * min(window.width / extent[0], window.height / extent[1])
    centre = limits.mean(axis=0)
    mark = np.array([[-5.0, -5.0], [5.0, 5.0]])
    taken = [np.array([p, p]) * scale + mark for p in points] + [box * scale + 0.4 * mark for box in keep_free]
    for point, text in zip(points, texts, strict=True):
        shape = np.array([CHARACTER * FONT_SIZE * len(text), FONT_SIZE])
        offsets = _offsets(point - centre, shape)
        boxes = [point * scale + o + np.array([-shape / 2, shape / 2]) for o in offsets]
        costs = [
            1000.0 * sum(_overlap(b, other) for other in taken) + 30.0 * _beyond(b, limits * scale) + i
            for i, b in enumerate(boxes)
        ]
        best = int(np.argmin(costs))
        taken.append(boxes[best])
        axes.annotate(
            text,
            (point[0], point[1]),
            (offsets[best][0], offsets[best][1]),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=FONT_SIZE,
            color=COLOURS["ink"],
            zorder=8,
            annotation_clip=False,
            bbox={"facecolor": COLOURS["halo"], "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
        )


def _offsets(outward: Floats, shape: Floats) -> list[Floats]:
    """Return possible offsets (2,) [points] of a label's centre from its point: eight directions at two distances.

    Those towards `outward` (2,) come first. `shape`: (2,) width and height of the label.
    """
    angles = np.arange(8) * np.pi / 4
    first = float(np.arctan2(outward[1], outward[0]))
    order = np.argsort(np.abs(np.angle(np.exp(1j * (angles - first)))), kind="stable")
    unit = np.column_stack([np.cos(angles[order]), np.sin(angles[order])])
    return [u * (shape / 2 + gap) for gap in (7.0, 16.0) for u in unit]


def _overlap(a: Floats, b: Floats) -> float:
    side = np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])
    return float(max(side[0], 0.0) * max(side[1], 0.0))


def _beyond(box: Floats, limits: Floats) -> float:
    """Return how far a label's box extends beyond limits, summed over both axes.

    Both are (2, 2): lower and upper corner.
    """
    return float(np.maximum(limits[0] - box[0], 0.0).sum() + np.maximum(box[1] - limits[1], 0.0).sum())


def frame_plan(axes: Axes, limits: Floats, unit: str) -> None:
    """Set limits, equal scales and axis titles, in `unit`, of a plan, and remove the grid.

    `limits`: (2, 2) lower and upper corner of the plan.
    """
    axes.grid(False)
    axes.set_xlim(limits[0, 0], limits[1, 0])
    axes.set_ylim(limits[0, 1], limits[1, 1])
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(f"x [{label(unit)}]")
    axes.set_ylabel(f"y [{label(unit)}]")


def draw_scene(axes: Axes, scene: Scene, limits: Floats) -> list[Line2D | Patch]:
    """Draw the static parts of a scene; return the entries of the legend.

    `limits`: (2, 2) lower and upper corner of the plan.
    """
    handles: list[Line2D | Patch] = []
    if scene.room is not None:
        axes.add_patch(Polygon(scene.room, facecolor=COLOURS["room"], edgecolor="none", zorder=0.5))
        axes.add_patch(Polygon(scene.room, fill=False, edgecolor=COLOURS["wall"], linewidth=1.6, zorder=2.6))
    cameras = [c for c in scene.cameras if c.placed]
    for camera in cameras:
        _view(axes, scene, camera, limits)
    for occluder in scene.occluders:
        axes.add_patch(
            Polygon(occluder.polygon, facecolor=COLOURS["pillar"], edgecolor=COLOURS["wall"], linewidth=0.8, zorder=2.5)
        )
    if cameras:
        handles.append(_cameras(axes, cameras, limits))
        handles.append(Patch(facecolor=COLOURS["view"], alpha=0.35, label="field of view"))
    if scene.arrays:
        at = np.array([a.position[:2] for a in scene.arrays])
        handles += axes.plot(
            at[:, 0], at[:, 1], "D", color=COLOURS["ink"], markersize=6, zorder=6, label="microphone array"
        )
    if scene.readers:
        at = np.array([r.position[:2] for r in scene.readers])
        handles += axes.plot(
            at[:, 0], at[:, 1], "^", color=COLOURS["ink"], markersize=6, zorder=6, label="reader of tags"
        )
    if scene.occluders:
        handles.append(Patch(facecolor=COLOURS["pillar"], edgecolor=COLOURS["wall"], label="static occluder"))
    return handles


def view_area(scene: Scene, camera: Camera, far: float) -> Floats:
    """Return the polygon (K, 2) of the floor that a camera sees, up to the distance `far`.

    It is cut off by static occluders, and by the room's walls if the camera is inside.
    """
    walls = [edges_of(o.polygon) for o in scene.occluders]
    if scene.room is not None and Polygon(scene.room).get_path().contains_point(tuple(camera.ground)):
        walls.append(edges_of(scene.room))
    blocks = np.concatenate(walls) if walls else np.empty((0, 2, 2))
    return visible_area(
        origin=camera.ground, yaw=camera.yaw, fov=camera.fov, reach=min(camera.range, far), walls=blocks
    )


def _view(axes: Axes, scene: Scene, camera: Camera, limits: Floats) -> None:
    """Draw a camera's field of view, cut off by occluders and walls.

    `limits`: (2, 2) lower and upper corner of the plan.
    """
    area = view_area(scene, camera, float(np.hypot(*(limits[1] - limits[0]))))
    wedge = Polygon(
        area,
        facecolor=COLOURS["view"],
        alpha=min(0.1, 1.2 / len(scene.cameras)),
        edgecolor=COLOURS["view"],
        linewidth=0.7,
        zorder=1.0,
    )
    axes.add_patch(wedge)
    if scene.room is not None:
        wedge.set_clip_path(Polygon(scene.room, transform=axes.transData))


def _cameras(axes: Axes, cameras: list[Camera], limits: Floats) -> Line2D:
    """Draw cameras as squares, with short arrows along their optical axes; return the entry of the legend.

    `limits`: (2, 2) lower and upper corner of the plan.
    """
    for camera in cameras:
        tip = _tip(camera, limits)
        axes.annotate(
            "",
            xy=(tip[0], tip[1]),
            xytext=(camera.ground[0], camera.ground[1]),
            zorder=5.5,
            arrowprops={
                "arrowstyle": "-|>",
                "color": COLOURS["ink"],
                "linewidth": 1.1,
                "shrinkA": 0,
                "shrinkB": 0,
                "mutation_scale": 8,
            },
        )
    at = np.array([c.ground for c in cameras])
    line: Line2D
    (line,) = axes.plot(
        at[:, 0], at[:, 1], "s", color=COLOURS["ink"], markersize=5, zorder=6, label="camera, optical axis"
    )
    return line


def _tip(camera: Camera, limits: Floats) -> Floats:
    """Return the end (2,) of the arrow along a camera's optical axis.

    Its length is 0.05 times the longer side of the plan with the lower and upper corner `limits` (2, 2).
    """
    length = 0.05 * float((limits[1] - limits[0]).max())
    return np.asarray(camera.ground + length * np.array([np.cos(camera.yaw), np.sin(camera.yaw)]))


def name_sensors(axes: Axes, scene: Scene, limits: Floats, bar: Floats) -> None:
    """Write the names of all sensors, clear of the optical axes and the scale bar.

    `limits`, `bar`: (2, 2) lower and upper corner of the plan and of the scale bar's box.
    """
    names: dict[tuple[float, float], list[str]] = {}
    for name, xy in sensor_positions(scene).items():
        names.setdefault((float(xy[0]), float(xy[1])), []).append(label(name, 16))
    texts = [label(", ".join(group), 40) for group in names.values()]
    arrows = [np.sort([c.ground, _tip(c, limits)], axis=0) for c in scene.cameras if c.placed]
    place_labels(axes, np.array(list(names)).reshape(-1, 2), texts, limits, [bar, *arrows])


def draw_scale_bar(axes: Axes, limits: Floats, unit: str) -> Floats:
    """Draw a scale bar in the lower right corner; return its box with the label: (2, 2) lower and upper corner.

    `limits`: (2, 2) lower and upper corner of the plan, in `unit`.
    """
    size = limits[1] - limits[0]
    goal = 0.15 * float(size.max())
    power = 10.0 ** np.floor(np.log10(goal))
    length = max(k * power for k in (1.0, 2.0, 5.0) if k * power <= goal)
    right, low = limits[1, 0] - 0.02 * size[0], limits[0, 1] + 0.015 * size[1]
    thickness = 0.006 * float(size.max())
    axes.add_patch(Rectangle((right - length, low), length, thickness, color=COLOURS["ink"], zorder=7))
    axes.annotate(
        f"{length:g} {unit}",
        (right - length, low),
        (-4, -1),
        textcoords="offset points",
        ha="right",
        va="bottom",
        fontsize=8,
        zorder=7,
    )
    return np.array([[right - 1.6 * length, low], [right, low + 3.0 * thickness]])


NO_ROWS = np.zeros(0, dtype=np.int64)
"""Rows of an identity that is not there."""
ELLIPSES, ELLIPSES_OF_ALL = 24, 480
"""Ellipses along the path of a target at most, and of all targets together; each takes as much as 25 points."""
PATH_POINTS = 1400
"""Sections of the paths of all targets, of each of which extremes are drawn; each target has at most half of them."""
MIN_POINTS = 12
MAX_MOVING_OCCLUDERS = 8
MAX_NAMES = 6
TRUE_PATH: Style = {"color": COLOURS["ink"], "linewidth": 1.0, "linestyle": (0, (4, 2))}


MAX_CAMERA_DISTANCE_ROOMS = 10.0
"""Cameras farther from the room than this many times its size are not drawn, but named."""
LONG = 15.0
RECENT = 6.0
"""A path longer than `LONG` times the plan's diagonal is drawn faint but for its last `RECENT` diagonals."""
MAX_DRAWN_TIMES = 8
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
    """Return lower and upper corner (2, 2) of the floor plan: the scene without far cameras, and paths.

    Outliers of paths, beyond their 0.5 % and 99.5 % quantiles, may be outside.
    """
    points = []
    if data.scene is not None:
        points += [data.scene.room] if data.scene.room is not None else []
        points += [o.polygon for o in data.scene.occluders]
        points += [p[None] for p in sensor_positions(near_scene(data.scene)[0]).values()]
    paths = [t for t in (data.tracks, data.truth) if t is not None and len(t)]
    for xy in (np.column_stack([table.x, table.y]) for table in paths):
        points.append(np.percentile(xy, [0.5, 99.5], axis=0) if len(xy) > 200 else xy)
    if data.scene is not None and data.scene.room is None and not paths:
        points.append(_ahead(data.scene))
    if not points:
        return np.array([[0.0, 0.0], [1.0, 1.0]])
    return limits_of(points)


def limits_of(points: list[Floats]) -> Floats:
    """Return the (2, 2) lower and upper corner of a plan of points, arrays (n, 2), with a margin."""
    everything = np.vstack(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    # A path along a line still gets a plan that is not a line.
    size = max(float((high - low).max()), 1e-6)
    grow = np.maximum(0.3 * size - (high - low), 0.0) / 2.0 + 0.06 * size
    return np.array([low - grow, high + grow])


def near_scene(scene: Scene) -> tuple[Scene, list[str]]:
    """Return the scene without cameras so distant that the room would be a dot, and the names of the removed ones.

    They are farther from the room's centre than `MAX_CAMERA_DISTANCE_ROOMS` times its size, on an axis. Without a room
    none is removed.
    """
    if scene.room is None:
        return scene, []
    low, high = scene.room.min(axis=0), scene.room.max(axis=0)
    most = MAX_CAMERA_DISTANCE_ROOMS * float((high - low).max())
    far = [c.name for c in scene.cameras if c.placed and np.abs(c.ground - 0.5 * (low + high)).max() > most]
    return replace(scene, cameras=tuple(c for c in scene.cameras if c.name not in far)), far


def _ahead(scene: Scene) -> Floats:
    """Return points (N, 2) in front of N cameras, at 1.2 times the extent of the cameras."""
    cameras = [c for c in scene.cameras if c.placed]
    at = np.array([c.ground for c in cameras]).reshape(-1, 2)
    spread = float(np.ptp(at, axis=0).max()) if len(at) else 0.0
    ahead = np.array([[np.cos(c.yaw), np.sin(c.yaw)] for c in cameras]).reshape(-1, 2)
    return np.asarray(at + (1.2 * spread if spread > 0 else 5.0) * ahead)


def outside(data: ReportInput) -> int:
    """Return the number of drawn estimates outside the limits of the plan."""
    if data.tracks is None:
        return 0
    (x0, y0), (x1, y1) = plan_limits(data)
    x, y = data.tracks.x, data.tracks.y
    return int(np.count_nonzero((x < x0) | (x > x1) | (y < y0) | (y > y1)))


def bold_from(data: ReportInput) -> int | None:
    """Return the time [ns] from which paths are drawn boldly, if some are very long; None: whole paths are."""
    limits = plan_limits(data)
    diagonal = float(np.hypot(*(limits[1] - limits[0])))
    starts = []
    there = [(table, dict(rows_by_label(table.target_id))) for table in (data.truth, data.tracks) if table is not None]
    for target in data.targets:
        for table, rows_of in there:
            rows = rows_of.get(target, NO_ROWS)
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
    if not rows_of or len(rows_of) > MAX_MOVING_OCCLUDERS:
        return []
    style: Style = {"color": COLOURS["muted"], "linewidth": 0.6, "alpha": 0.45, "zorder": 2.2}
    for rows in rows_of.values():
        _line(axes, truth, rows, PATH_POINTS // 2, **style)
    return [Line2D([], [], label="moving occluder", **style)]


def _rows_of(truth: Truth, role: str) -> dict[int, Ints]:
    """Return the row numbers of each identity with a role (`target` or `occluder`) in a truth."""
    those = np.flatnonzero(truth.role == role)
    return {identity: those[rows] for identity, rows in rows_by_label(truth.target_id[those])}


def _line(axes: Axes, table: Tracks | Truth, rows: Ints, points: int, **style: Any) -> None:
    """Draw the path given by the row numbers `rows` (n,) of a table, broken at gaps.

    It is cut into `points` sections, of each of which only the extremes are drawn.
    """
    part = table.take(rows)
    keep = thin_path(np.column_stack([part.x, part.y]), points)
    x, y = broken(part.t_ns, keep, part.x, part.y)
    axes.plot(x, y, **style)


def _path(axes: Axes, table: Tracks | Truth, rows: Ints, since: int | None, points: int, **style: Any) -> None:
    """Draw the path given by the row numbers `rows` (n,) of a table; parts before `since` [ns] are faint (None: none).

    It is broken at gaps, and cut into `points` sections, of each of which only the extremes are drawn.
    """
    if since is not None:
        faint = {"color": style["color"], "linewidth": 0.4, "alpha": 0.3, "zorder": 2.8}
        _line(axes, table, rows[table.t_ns[rows] <= since], points, **faint)
        rows = rows[table.t_ns[rows] >= since]
    _line(axes, table, rows, points, **style)


def _paths(axes: Axes, data: ReportInput) -> list[Line2D | Patch]:
    since = bold_from(data)
    points = max(PATH_POINTS // max(len(data.targets), 2), MIN_POINTS)
    ellipses = min(ELLIPSES, ELLIPSES_OF_ALL // max(len(data.targets), 1))
    handles: list[Line2D | Patch] = []
    estimated = {} if data.tracks is None else dict(rows_by_label(data.tracks.target_id))
    for i, target in enumerate(data.targets):
        colour = target_colour(i)
        if data.tracks is not None:
            _estimate(axes, data.tracks, estimated.get(target, NO_ROWS), since, colour, points, ellipses)
            name = "estimated path" if len(data.targets) == 1 else f"target {target}, estimated"
            handles += [Line2D([], [], color=colour, linewidth=1.8, label=name)] if i < MAX_NAMES else []
    if data.truth is not None:
        true = _rows_of(data.truth, "target")
        # Untracked ones as well, if names do not determine who is tracked
        for target in data.targets if data.same_names else true:
            rows = true.get(target, NO_ROWS)
            _path(axes, data.truth, rows, since, points, zorder=4, **TRUE_PATH)
            if data.tracks is None:
                _ends(axes, data.truth.take(rows), COLOURS["ink"])
    return handles + (_path_handles(data) if data.targets else [])


def _path_handles(data: ReportInput) -> list[Line2D | Patch]:
    """Return the entries of the legend for all paths."""
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
    """Return the 95 % confidence ellipse of the position in a row as a patch; it has no area if the covariance is 0."""
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
    """Draw the priors of moving occluders at a few evenly spaced times; return the entries of the legend."""
    there = priors.take(priors.occluder_id >= 0)
    if not len(there):
        return []
    style: Style = {"facecolor": COLOURS["moving"], "edgecolor": COLOURS["moving"], "linewidth": 0.6}
    shown = there.take(np.isin(there.t_ns, drawn_times(there.t_ns)))
    if isinstance(shown, Hulls):
        kind, patches = "hull of a moving occluder", _polygons(shown, style)
    else:
        kind, rows = "95 % ellipse of a moving occluder", range(len(shown))
        patches = [confidence_ellipse(shown, row, alpha=0.16, zorder=2.4, **style) for row in rows]
    for patch in patches:
        axes.add_patch(patch)
    return [Patch(label=kind, alpha=0.3, **style)]


def drawn_times(t_ns: Ints) -> Ints:
    """Return the times [ns] at which occluder priors are drawn: up to `MAX_DRAWN_TIMES` of `t_ns`, evenly spaced."""
    times = np.unique(t_ns)
    if not len(times):
        return times
    some: Ints = times[np.unique(np.linspace(0, len(times) - 1, MAX_DRAWN_TIMES).round().astype(int))]
    return some


def _polygons(hulls: Hulls, style: Style) -> list[Patch]:
    """Return a patch of this style for each polygon of the hulls."""
    first = np.flatnonzero(hulls.corner == 0)
    corners = np.split(np.column_stack([hulls.x, hulls.y]), first[1:])
    return [Polygon(xy, closed=True, alpha=0.22, zorder=2.4, **style) for xy in corners]
