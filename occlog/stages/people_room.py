"""A room in which people of one look walk about and hide one another, seen by two to six cameras.

The cameras stand so far from the part that people walk in that all views hold them whole,
and not in one line: then the views of any three of them say where a point is in the third.
"""

from __future__ import annotations

import math

import numpy as np

from ..core.camera import rotation_from_angles
from ..scene import Camera, Scene, camera_fov

SIDE = 14.0
"""Of the square room [m]."""
CLEARANCE = 4.5
"""People keep this distance from the walls [m]."""
CAMERAS = (
    (0.1, 0.1, 2.8, 500.0),
    (13.9, 0.1, 2.8, 500.0),
    (7.0, 13.9, 3.2, 390.0),
    (0.1, 13.9, 2.6, 500.0),
    (13.9, 13.9, 3.0, 500.0),
    (7.0, 0.1, 2.4, 390.0),
)
"""Place x, y, z [m], and focal length [px] in images of 640 x 480."""
HEIGHT = 0.9
"""Of the point in the middle of the room that all cameras look at [m]."""


def people_room(views: int, size: tuple[int, int], rate_hz: float) -> Scene:
    """The empty room with cameras `view1`, `view2`, ...

    Args:
        views: how many, 1 to 6.
        size: width and height of the images [px]; the cameras see the same for any of the shape 4 : 3,
            and more to the sides, or above and below, for others.
        rate_hz: frames a second.
    """
    return Scene(
        cameras=tuple(_camera(k, size, rate_hz) for k in range(views)),
        room=np.array([[0.0, 0.0], [SIDE, 0.0], [SIDE, SIDE], [0.0, SIDE]]),
        room_height=4.0,
    )


def _camera(number: int, size: tuple[int, int], rate_hz: float) -> Camera:
    x, y, z, focal = CAMERAS[number]
    away = np.array([0.5 * SIDE - x, 0.5 * SIDE - y])
    yaw, pitch = math.atan2(away[1], away[0]), -math.atan2(z - HEIGHT, float(np.hypot(*away)))
    rotation = rotation_from_angles(yaw, pitch, 0.0)
    focal_px = np.full(2, focal * min(size[0] / 640.0, size[1] / 480.0))
    principal = 0.5 * (np.asarray(size, dtype=np.float64) - 1.0)
    return Camera(
        f"view{number + 1}",
        np.array([x, y, z]),
        rotation,
        focal_px,
        principal,
        image_size=size,
        fov=camera_fov(size, focal_px, principal, np.zeros(5), "brown", rotation),
        rate_hz=rate_hz,
    )
