"""Scenes with coordinates of maps, brought near the origin: sums of squares lose digits at millions of metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from occlog.array_types import Floats

from .scene import Camera, Scene

SIDE = 1024.0
"""Scenes are moved by multiples of this, in units of length: those that are near stay, and nothing is rounded."""


def map_origin(cameras: Sequence[Camera]) -> Floats:
    """(2,) point of the grid of `SIDE` that is nearest to the middle of the cameras, of which there is one at least."""
    return np.asarray(SIDE * np.round(np.mean([c.ground for c in cameras], axis=0) / SIDE))


def camera_from(camera: Camera, origin: Floats) -> Camera:
    """A camera, with its place as seen from a (2,) origin."""
    return replace(camera, position=camera.position - np.append(origin, 0.0))


def scene_from(scene: Scene, origin: Floats) -> Scene:
    """A scene, with all places as seen from a (2,) origin."""
    by = np.append(origin, 0.0)
    return replace(
        scene,
        cameras=tuple(camera_from(c, origin) for c in scene.cameras),
        arrays=tuple(replace(a, position=a.position - by) for a in scene.arrays),
        readers=tuple(replace(r, position=r.position - by) for r in scene.readers),
        occluders=tuple(replace(o, polygon=o.polygon - origin) for o in scene.occluders),
        room=None if scene.room is None else scene.room - origin,
    )
