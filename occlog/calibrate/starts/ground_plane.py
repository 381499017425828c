"""Ground plane of one camera from the boxes of upright people: pitch, roll and height of the camera.

A person has the feet on the ground and the head above them. Boxes of people at several distances determine the
inclination of the camera and its height, in heights of people (Lv, Zhao and Nevatia 2006; Liu, Collins and Liu 2011).
Yaw and ground position are undetermined: results are in the level frame of the camera, with the origin on the ground
below it, x forward and z up.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from occlog.array_types import Bools, Floats
from occlog.core.geometry.camera import angles_from_rotation, rotation_from_angles
from occlog.records.scene import Camera
from occlog.track.people.camera_checks.pair_overlap import BORDER_PX, ideal, located_by_ends, upright

MIN_BOXES = 30
"""Minimum number of whole boxes that determine a ground plane."""
MAX_BOXES = 3000
"""Boxes that are used at most, evenly spread."""
SIGMA_HEAD = 0.06
"""Standard deviation of the head in an image, in heights of the box: people differ, and walk."""
SIGMA_ANGLE = np.radians(6.0)
"""Standard deviation of the pitch and roll of a rough pose; of the roll, too, without a pose."""
SIGMA_LOG_HEIGHT = 0.3
"""Standard deviation of the logarithm of the height of a rough pose."""
PITCHES = np.radians([-5.0, -15.0, -30.0, -50.0])
HEIGHTS = np.array([1.5, 3.0, 6.0])
"""Starts without a pose: pitches, and heights of the camera in heights of people."""
MIN_SLOPE = 1e-3
"""Least slope of a line of sight that meets the ground, downwards."""


class GroundPlane(NamedTuple):
    """Ground plane (z = 0) in the frame of a camera, by the camera's inclination and height above it.

    Attributes:
        pitch: pitch of the camera [rad], negative downwards.
        roll: roll of the camera [rad].
        height: height of the camera, in the scene's unit.
        rms: robust root mean square of the heads' residuals, in heights of the box.
        boxes: number of boxes used.
    """

    pitch: float
    roll: float
    height: float
    rms: float
    boxes: int

    def positions(self, camera: Camera, boxes: Floats) -> Floats:
        """(n, 2) ground positions of the feet of boxes (n, 4: left, top, right, bottom [px]); NaN above the horizon.

        In the level frame of the camera: origin on the ground below it, x forward.
        """
        level = replace(
            camera,
            position=np.array([0.0, 0.0, self.height]),
            rotation=rotation_from_angles(0.0, self.pitch, self.roll),
        )
        feet, head = upright(level, boxes)
        return located_by_ends(level, feet, head, 0.0)[:, :2]


def whole(camera: Camera, boxes: Floats) -> Bools:
    """(n,) mask of boxes that no border of the image truncates."""
    inside = boxes[:, 3] - boxes[:, 1] > 0.0
    if camera.image_size is None:
        return np.asarray(inside)
    size = np.array(camera.image_size) - 1.0
    return np.asarray(inside & (boxes[:, :2] > BORDER_PX).all(axis=1) & (boxes[:, 2:] < size - BORDER_PX).all(axis=1))


def ground_plane(camera: Camera, boxes: Floats, person_height: float) -> GroundPlane | None:
    """Estimate the ground plane of a camera from boxes of upright people.

    Args:
        camera: camera with intrinsics; its pose, if known, is the start of the search and a prior.
        boxes: (n, 4) left, top, right, bottom [px].
        person_height: mean height of people, in the scene's unit.

    Returns:
        None: fewer than `MIN_BOXES` boxes are whole.
    """
    used = boxes[whole(camera, boxes)]
    if len(used) < MIN_BOXES:
        return None
    used = used[np.unique(np.linspace(0, len(used) - 1, MAX_BOXES).round().astype(np.int64))]
    foot, head = _ends(camera, used)
    tall = foot[:, 1] - head[:, 1]
    known = camera.placed and camera.position[2] > 0.0
    if known:
        _, pitch, roll = angles_from_rotation(camera.rotation)
        starts = [np.array([pitch, roll, np.log(camera.position[2])])]
        sigma = np.array([SIGMA_ANGLE, SIGMA_ANGLE, SIGMA_LOG_HEIGHT])
    else:
        starts = [np.array([p, 0.0, np.log(h * person_height)]) for p in PITCHES for h in HEIGHTS]
        sigma = np.array([np.inf, SIGMA_ANGLE, np.inf])
    scale = SIGMA_HEAD * np.sqrt(len(used))

    def residuals(values: Floats) -> Floats:
        R = rotation_from_angles(0.0, values[0], values[1])
        ray = foot @ R.T
        away = np.exp(values[2]) / np.maximum(-ray[:, 2], MIN_SLOPE)
        top = np.column_stack([away[:, None] * ray[:, :2], np.full(len(ray), person_height - np.exp(values[2]))]) @ R
        off = (top[:, 1] / np.maximum(top[:, 2], 1e-6) - head[:, 1]) / tall
        prior = (values - starts[0]) / sigma if known else np.array([0.0, values[1] / SIGMA_ANGLE, 0.0])
        # The mean of the residuals against priors of about one degree of freedom each: errors of people last
        return np.concatenate([np.clip(off, -5.0, 5.0) / scale, 0.1 * prior])

    found = [
        least_squares(residuals, start, loss="soft_l1", f_scale=1.5 * SIGMA_HEAD / scale, max_nfev=60)
        for start in starts
    ]
    best = min(found, key=lambda each: float(each.cost))
    off = residuals(best.x)[: len(used)] * scale
    rms = float(1.4826 * np.median(np.abs(off)))
    pitch, roll, log_height = best.x.tolist()
    return GroundPlane(pitch, roll, float(np.exp(log_height)), rms, len(used))


def _ends(camera: Camera, boxes: Floats) -> tuple[Floats, Floats]:
    """(n, 3) lines of sight of the feet and of the heads in the camera's frame, scaled to 1 along the optical axis.

    `boxes` (n, 4) are left, top, right, bottom [px].
    """
    middle = 0.5 * (boxes[:, 0] + boxes[:, 2])
    foot, head = (ideal(camera, np.column_stack([middle, boxes[:, edge]])) for edge in (3, 1))
    one = np.ones((len(boxes), 1))
    return np.hstack([foot, one]), np.hstack([head, one])
