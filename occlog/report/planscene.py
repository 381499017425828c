"""What does not move on a floor plan: room, occluders, sensors, what they see, their names, the scale."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle

from ..columns import Floats
from ..scene import Camera, Scene
from .labels import place_labels
from .sight import edges_of, places, visible_area
from .style import COLOURS, label


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
    if scene.occluders:
        handles.append(Patch(facecolor=COLOURS["pillar"], edgecolor=COLOURS["wall"], label="static occluder"))
    return handles


def _view(axes: Axes, scene: Scene, camera: Camera, limits: Floats) -> None:
    """Field of view, cut off by occluders and by the room's walls."""
    walls = [edges_of(o.polygon) for o in scene.occluders]
    room = None if scene.room is None else Polygon(scene.room)
    if (
        scene.room is not None
        and room is not None
        and room.get_path().contains_point((camera.ground[0], camera.ground[1]))
    ):
        walls.append(edges_of(scene.room))
    far = float(np.hypot(*(limits[1] - limits[0])))
    blocks = np.concatenate(walls) if walls else np.empty((0, 2, 2))
    area = visible_area(camera.ground, camera.yaw, camera.fov, min(camera.range, far), blocks)
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
            "", xy=(tip[0], tip[1]), xytext=(camera.ground[0], camera.ground[1]), zorder=5.5,
            arrowprops={"arrowstyle": "-|>", "color": COLOURS["ink"], "linewidth": 1.1, "shrinkA": 0,
                        "shrinkB": 0, "mutation_scale": 8},
        )  # fmt: skip
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
        f"{length:g} {unit}", (right - length, low), (-4, -1), textcoords="offset points",
        ha="right", va="bottom", fontsize=8, zorder=7,
    )  # fmt: skip
    return np.array([[right - 1.6 * length, low], [right, low + 3.0 * thickness]])
