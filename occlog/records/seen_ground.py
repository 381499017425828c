"""The part of the ground that the sensors of a scene can see: where targets can be if the scene has no room.

How far a camera sees is its `range`.  Where the scene gives none, it is the least of

* the distance at which a person is a fiftieth of the field of view wide or high (`PERSON` over `LEAST_SHARE` of the
  field of view), but at least twice the extent of all sensors;
* the farthest ground in the image, of a camera that looks down and whose image ends below the horizon.

A microphone array without a `range` hears `HEARING`, and at least twice the extent of all sensors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import shapely

from occlog.array_types import Floats
from occlog.core.sight.camera import pixels_to_rays
from occlog.core.sight.view_prior import ViewPrior
from occlog.settings import METRES

if TYPE_CHECKING:
    from .scene import Camera, Scene

MARGIN = 1.0
"""Width of the strip around the sensors that counts as near them, beside a tenth of their extent."""
PERSON = 1.7
"""Height of a person [m]."""
LEAST_SHARE = 0.02
"""A camera sees a person who takes up so much of its field of view."""
HEARING = 20.0
"""How far an array without a `range` hears [m]."""
STEP = np.pi / 16
"""Angle between neighbouring corners of a wedge's rim, at most."""
BELOW_HORIZON = np.radians(0.5)
"""An image whose upper border is less than this below the horizon shows the ground to any distance."""


def box_around(scene: Scene) -> tuple[Floats, Floats]:
    """(2,) lowest and (2,) highest corner of a box around all sensors, widened by 1 unit and a tenth."""
    places = np.array([s.position[:2] for s in scene.sensors])
    low, high = places.min(axis=0), places.max(axis=0)
    pad = MARGIN + 0.1 * float(np.max(high - low))
    return low - pad, high + pad


def view_prior(scene: Scene) -> ViewPrior:
    """Where targets can be, by what each sensor with a pose can see; by all of them where none has one.

    Args:
        scene: with at least one sensor.
    """
    low, high = box_around(scene)
    cameras, arrays = scene.cameras, scene.arrays
    placed = np.array([c.placed for c in cameras] + [True] * len(arrays))
    placed |= not placed.any()
    least = 2.0 * float(np.hypot(*(high - low)))
    metre = 1.0 / METRES.get(scene.length_unit, 1.0)
    far = [sight_limit(c, least, metre if scene.length_unit in METRES else None) for c in cameras]
    far += [a.range if np.isfinite(a.range) else max(HEARING * metre, least) for a in arrays]
    return ViewPrior(
        origin=np.array([c.position[:2] for c in cameras] + [a.position[:2] for a in arrays], dtype=np.float64),
        axis=np.array([c.yaw for c in cameras] + [a.yaw for a in arrays], dtype=np.float64),
        fov=np.array([min(c.fov, 2.0 * np.pi) for c in cameras] + [2.0 * np.pi] * len(arrays), dtype=np.float64),
        far=np.array(far, dtype=np.float64),
        share=placed / np.count_nonzero(placed),
        low=low,
        high=high,
    )


def sight_limit(camera: Camera, least: float, metre: float | None) -> float:
    """How far a camera sees a target, in the scene's unit.

    Args:
        camera: with a pose.
        least: twice the extent of the sensors; a person's size does not limit the sight to less.
        metre: a metre in the scene's unit; None: a unit of its own, in which half the camera's height, where it is
            known, stands for the size of a target.
    """
    if np.isfinite(camera.range):
        return camera.range
    height = float(camera.position[2])
    size = PERSON * metre if metre is not None else 0.5 * abs(height) if height else PERSON
    far = max(size / (LEAST_SHARE * min(camera.fov, 2.0 * np.pi)), least)
    upper = highest_elevation(camera)
    if height > size and upper is not None and upper < -BELOW_HORIZON:
        far = min(far, height / np.tan(-upper))
    return float(far)


def highest_elevation(camera: Camera) -> float | None:
    """Highest elevation [rad] of a sight line through the image's border; None: the image's size is not known."""
    if camera.image_size is None:
        return None
    w, h = camera.image_size
    across, down = np.linspace(-0.5, w - 0.5, 33), np.linspace(-0.5, h - 0.5, 33)
    sides = [np.column_stack([np.full(33, x), down]) for x in (-0.5, w - 0.5)]
    ends = [np.column_stack([across, np.full(33, y)]) for y in (-0.5, h - 0.5)]
    border = np.vstack(sides + ends)
    rays = pixels_to_rays(
        border, camera.focal_px, camera.principal_px, camera.distortion, camera.distortion_model, camera.rotation
    )
    return float(np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])).max())


def seen_region(prior: ViewPrior) -> Floats:
    """(K, 2) convex polygon, counter-clockwise, that holds all that sensors see and the box around them.

    Targets cross the gaps between views, so the region has none.
    """
    (x0, y0), (x1, y1) = prior.low, prior.high
    points = [np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), prior.origin]
    seeing = prior.share > 0.0
    for origin, axis, fov, far in zip(*(part[seeing] for part in prior[:4]), strict=True):
        n = max(int(np.ceil(fov / STEP)), 1)
        turn = axis + np.linspace(-0.5 * fov, 0.5 * fov, n + 1)
        rim = far / np.cos(0.5 * fov / n)  # the chords of the rim lie outside the circle
        points.append(origin + rim * np.column_stack([np.cos(turn), np.sin(turn)]))
    hull = shapely.convex_hull(shapely.MultiPoint(np.concatenate(points)))
    return np.asarray(shapely.geometry.polygon.orient(hull).exterior.coords)[:-1].astype(np.float64)
