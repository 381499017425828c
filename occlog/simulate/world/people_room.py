"""A room in which people of one look walk about and hide one another, seen by two to six cameras.

The cameras stand so far from the part that people walk in that all views hold them whole,
and not in one line: then the views of any three of them say where a point is in the third.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.seeds import Stage, generator
from occlog.core.sight.camera import rotation_from_angles
from occlog.errors import InputError
from occlog.records.scene import Camera, Scene, camera_fov

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

BODY = np.array([[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (0.0, 1.85)])
"""Corners of a box about a body, from where it stands [m]."""
TRIES, DRAWN = 200, 500
"""Searches for places at which nobody hides another, and places drawn in each."""


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
        name=f"view{number + 1}",
        position=np.array([x, y, z]),
        rotation=rotation,
        focal_px=focal_px,
        principal_px=principal,
        image_size=size,
        fov=camera_fov(size, focal_px, principal, distortion=np.zeros(5), model="brown", rotation=rotation),
        rate_hz=rate_hz,
    )


def people_apart(scene: Scene, people: int, seed: int) -> Floats:
    """(n, 2) places in the middle of the room at which nobody hides another from any camera.

    Args:
        scene: the room.
        people: n.
        seed: of the search.

    Returns:
        The places; InputError where none are found.
    """
    rng = generator(seed, Stage.WORLD_START)
    for _ in range(TRIES):
        places = rng.uniform(CLEARANCE, SIDE - CLEARANCE, (DRAWN, 2))
        boxes = np.stack([_image_boxes(camera, places) for camera in scene.cameras], axis=1)
        free, kept = np.arange(DRAWN), [0]
        while len(kept) < people and len(free := free[_clear(boxes[kept[-1]], boxes[free])]):
            kept.append(int(free[0]))
        if len(kept) == people:
            return places[kept]
    raise InputError(
        f"people: no places found at which {people} people hide nobody from {len(scene.cameras)} cameras; "
        "take fewer of either, or let them overlap in the first frame"
    )


def _image_boxes(camera: Camera, places: Floats) -> Floats:
    """(n, 4) left, top, right, bottom of bodies at places (n, 2)."""
    corners = np.column_stack([places, np.zeros(len(places))])[:, None] + BODY
    pixels = camera.project(corners.reshape(-1, 3)).reshape(len(places), len(BODY), 2)
    return np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)


def _clear(box: Floats, others: Floats) -> Bools:
    """(m,) whether others' boxes (m, V, 4) overlap with none of a body's (V, 4)."""
    apart = (box[:, :2] > others[..., 2:]) | (others[..., :2] > box[:, 2:])
    return np.asarray(apart.any(axis=-1).all(axis=-1))
