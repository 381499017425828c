"""Fixed parts of a floor plan: room, occluders, sensors, their fields of view, their names, the scale.

Names beside points are moved until they do not cover each other.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle

from occlog.array_types import Floats
from occlog.records.scene import Camera, Scene
from occlog.report.content.plane_of_sight import edges_of, places, visible_area
from occlog.report.drawing.style import COLOURS, label

FONT_SIZE = 8.5
"""Size of names [points]."""
CHARACTER = 0.62
"""Mean width of a character in units of the font's size."""


def place_labels(axes: Axes, points: Floats, texts: list[str], limits: Floats, keep_free: list[Floats]) -> None:
    """Write a name at each point, on the side where it is free, outward first.

    Args:
        axes: where to draw; its limits must be set to `limits`, with equal scales.
        points: (N, 2) in data coordinates.
        texts: N names.
        limits: (2, 2) lower and upper corner of the axes.
        keep_free: boxes (2, 2) in data coordinates that no name should cover.
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
    """Centres of the label relative to its point: eight directions at two distances, outward first."""
    angles = np.arange(8) * np.pi / 4
    first = float(np.arctan2(outward[1], outward[0]))
    order = np.argsort(np.abs(np.angle(np.exp(1j * (angles - first)))), kind="stable")
    unit = np.column_stack([np.cos(angles[order]), np.sin(angles[order])])
    return [u * (shape / 2 + gap) for gap in (7.0, 16.0) for u in unit]


def _overlap(a: Floats, b: Floats) -> float:
    side = np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])
    return float(max(side[0], 0.0) * max(side[1], 0.0))


def _beyond(box: Floats, limits: Floats) -> float:
    """How far a label sticks out of the axes."""
    return float(np.maximum(limits[0] - box[0], 0.0).sum() + np.maximum(box[1] - limits[1], 0.0).sum())


def frame_plan(axes: Axes, limits: Floats, unit: str) -> None:
    """Set the limits (2, 2) of a plan, x and y to the same scale, and name its axes; no grid."""
    axes.grid(False)
    axes.set_xlim(limits[0, 0], limits[1, 0])
    axes.set_ylim(limits[0, 1], limits[1, 1])
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(f"x [{label(unit)}]")
    axes.set_ylabel(f"y [{label(unit)}]")


def draw_scene(axes: Axes, scene: Scene, limits: Floats) -> list[Line2D | Patch]:
    """Draw what does not move; handles for the legend."""
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
    """(K, 2) polygon of the floor that a camera sees, to a distance `far` at most.

    It is cut off by occluders, and by the room's walls if the camera is in the room.
    """
    walls = [edges_of(o.polygon) for o in scene.occluders]
    if scene.room is not None and Polygon(scene.room).get_path().contains_point(tuple(camera.ground)):
        walls.append(edges_of(scene.room))
    blocks = np.concatenate(walls) if walls else np.empty((0, 2, 2))
    return visible_area(
        origin=camera.ground, yaw=camera.yaw, fov=camera.fov, reach=min(camera.range, far), walls=blocks
    )


def _view(axes: Axes, scene: Scene, camera: Camera, limits: Floats) -> None:
    """Field of view, cut off by occluders and by the room's walls."""
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
    """Cameras as dots with their optical axes as short lines."""
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
    """End of the arrow along a camera's optical axis."""
    length = 0.05 * float((limits[1] - limits[0]).max())
    return np.asarray(camera.ground + length * np.array([np.cos(camera.yaw), np.sin(camera.yaw)]))


def name_sensors(axes: Axes, scene: Scene, limits: Floats, bar: Floats) -> None:
    """Write the names of all sensors, clear of arrows and of the scale bar's box."""
    names: dict[tuple[float, float], list[str]] = {}
    for name, xy in places(scene).items():
        names.setdefault((float(xy[0]), float(xy[1])), []).append(label(name, 16))
    texts = [label(", ".join(group), 40) for group in names.values()]
    arrows = [np.sort([c.ground, _tip(c, limits)], axis=0) for c in scene.cameras if c.placed]
    place_labels(axes, np.array(list(names)).reshape(-1, 2), texts, limits, [bar, *arrows])


def draw_scale_bar(axes: Axes, limits: Floats, unit: str) -> Floats:
    """A bar of a round length in the lower right corner, outside the room where there is space; its box."""
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
