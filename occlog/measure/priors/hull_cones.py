"""Cameras on the ground plane: the visible part of the room, and the cones of scan-line runs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from occlog.array_types import Floats
from occlog.core.sight.camera import wrap_angle
from occlog.records.scene import Camera, Scene

STEP = np.pi / 6
"""Largest angle between neighbouring corners of the far side of a wedge."""


class HullCamera(NamedTuple):
    """A camera with the part of the room in which it can see an object."""

    camera: Camera
    visible: shapely.Geometry
    far: float  # beyond everything, seen from the camera


def hull_camera(camera: Camera, scene: Scene) -> HullCamera:
    """The camera's field of view and range within the room, without what static occluders hide from it."""
    room = shapely.Polygon(scene.region)
    far = 1.0 + 2.0 * float(np.hypot(*(scene.region - camera.ground).T).max())
    visible = shapely.intersection(room, wedge(camera.ground, camera.yaw, camera.fov, far))
    if np.isfinite(camera.range):
        visible = shapely.intersection(visible, shapely.Point(camera.ground).buffer(camera.range, quad_segs=32))
    for wall in scene.blockers(camera.ground):
        visible = shapely.difference(visible, shadow(camera.ground, wall, far))
    return HullCamera(camera, visible, far)


def wedge(origin: Floats, axis: float, width: float, far: float) -> shapely.Geometry:
    """Polygon of the directions within `width` / 2 of `axis` [rad], to a distance of at least `far`."""
    width = min(width, 2.0 * np.pi)
    n = max(int(np.ceil(width / STEP)), 1)
    angles = axis + np.linspace(-0.5 * width, 0.5 * width, n + 1)
    rim = origin + far / np.cos(0.5 * width / n) * np.column_stack([np.cos(angles), np.sin(angles)])
    if width >= 2.0 * np.pi:
        return shapely.Polygon(rim[:-1])
    return shapely.make_valid(shapely.Polygon(np.vstack([origin, rim])))


def shadow(origin: Floats, wall: Floats, far: float) -> shapely.Geometry:
    """What a polygon hides from a point outside it, to a distance of at least `far`, itself included."""
    parts = [shapely.Polygon(wall)]
    for a, b in zip(wall, np.roll(wall, -1, axis=0), strict=True):
        rays = np.array([a, b]) - origin
        distance = np.hypot(*rays.T)
        if distance.min() == 0.0:
            continue
        # Both rays are made so long that the line between their ends is beyond `far`.
        cosine = np.clip(rays[0] @ rays[1] / distance.prod(), -1.0, 1.0)
        half = np.sqrt(max(0.5 * (1.0 + cosine), 1e-6))
        ends = origin + rays / distance[:, None] * (far / half)
        parts.append(shapely.make_valid(shapely.Polygon([a, b, ends[1], ends[0]])))
    return shapely.union_all(parts)


def runs(boxes: Floats, camera: Camera, dilate: float) -> Floats:
    """(B, 2) centre and width [rad] of the azimuths that boxes cover, each dilated to both sides.

    The azimuths are those of the undistorted, levelled image at half the height of each box.

    Args:
        boxes: (B, 4) left, top, width, height [px].
        camera: with a pose.
        dilate: angle added to either side [rad].
    """
    middle = boxes[:, 1] + 0.5 * boxes[:, 3]
    left = camera.bearings(np.column_stack([boxes[:, 0], middle]))
    right = camera.bearings(np.column_stack([boxes[:, 0] + boxes[:, 2], middle]))
    half = 0.5 * wrap_angle(left - right)
    return np.column_stack([wrap_angle(right + half), 2.0 * (np.abs(half) + dilate)])


def cones(view: HullCamera, of_runs: Floats) -> list[shapely.Geometry]:
    """Cones of runs (B, 2) within what the camera can see; runs that overlap make one cone."""
    parts = [wedge(view.camera.ground, centre, width, view.far) for centre, width in _merged(of_runs)]
    return [shapely.intersection(part, view.visible) for part in parts]


def _merged(of_runs: Floats) -> list[tuple[float, float]]:
    """Runs that overlap as one; (centre, width), by rising lower end."""
    spans = sorted((float(c - 0.5 * w), float(c + 0.5 * w)) for c, w in of_runs)
    out: list[list[float]] = []
    for low, high in spans:
        if out and low <= out[-1][1]:
            out[-1][1] = max(out[-1][1], high)
        else:
            out.append([low, high])
    # The last may reach around to the first.
    while len(out) > 1 and out[-1][1] - 2.0 * np.pi >= out[0][0]:
        first = out.pop(0)
        out[-1][1] = max(out[-1][1], first[1] + 2.0 * np.pi)
    return [(0.5 * (low + high), min(high - low, 2.0 * np.pi)) for low, high in out]
