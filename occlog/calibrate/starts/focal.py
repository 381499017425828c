"""Focal length of a camera from boxes of walking people, if only the image size is known.

Boxes of upright people of about one height determine the horizon and the vertical vanishing point, which with square
pixels and a central principal point give the focal length (Lv, Zhao and Nevatia 2006). The height along one track must
be constant, and heights of people differ by a few centimetres: the focal length minimises the squares of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from occlog.array_types import Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.scene import Camera, camera_fov
from occlog.track.methods.jipda.kernels.body_box import pack_views

from ..kernels import expected_boxes
from .ground_plane import ground_plane, whole

STARTS_WIDTHS = (0.6, 0.9, 1.5)
"""Focal lengths that the search starts from, in widths of the image: fields of view of 80, 58 and 37 degrees."""
USUAL_WIDTHS, SIGMA_LOG_USUAL = 0.9, 0.35
"""Usual focal length in widths of the image, and the standard deviation of its logarithm among cameras."""
SIGMA_TRACK, SIGMA_PEOPLE = 0.04, 0.06
"""Standard deviations of the logarithm of a height: along a track, and among people."""
SIGMA_ROLL = np.radians(6.0)
BODY_WIDTHS = 0.3
"""Width of a person in heights."""
STEP_S = 1.0
"""Interval between the boxes of a track that are used [s]: errors of a gait last about as long."""
UNSEEN = 1.0
"""Logarithm of the height of a person with feet above the horizon."""


class FocalEstimate(NamedTuple):
    """A focal length [px] with the standard deviation of its natural logarithm."""

    focal_px: float
    sigma_log: float


def focal_of_people(camera: Camera, tracks: Sequence[tuple[Floats, Floats]], person_height: float) -> FocalEstimate:
    """Estimate the focal length of a camera from tracks of boxes; without suitable boxes the usual one of cameras.

    Args:
        camera: camera with an image size.
        tracks: times [s] and boxes (n, 4) of people: left, top, right, bottom [px].
        person_height: mean height of people, in the scene's unit.
    """
    assert camera.image_size is not None
    width = camera.image_size[0]
    usual = USUAL_WIDTHS * width
    spaced = [boxes[_apart(t)] for t, boxes in tracks]
    own = [part for boxes in spaced if len(part := boxes[whole(camera, boxes)])]
    every = np.concatenate([np.zeros((0, 4)), *own])
    track = np.repeat(np.arange(len(own)), [len(part) for part in own])
    best = None
    for widths in STARTS_WIDTHS:
        plane = ground_plane(with_focal(camera, widths * width), every, person_height)
        if plane is None:
            continue
        start = np.array([np.log(widths * width), plane.pitch, plane.roll, np.log(plane.height)])

        def residuals(values: Floats) -> Floats:
            logs = _log_heights(camera, values, every, person_height)
            mean = np.bincount(track, logs) / np.bincount(track)
            prior = [(values[0] - np.log(usual)) / SIGMA_LOG_USUAL, values[2] / SIGMA_ROLL]
            return np.concatenate([(logs - mean[track]) / SIGMA_TRACK, mean / SIGMA_PEOPLE, prior])

        found = least_squares(residuals, start, loss="soft_l1", f_scale=1.5, max_nfev=60)
        if best is None or found.cost < best.cost:
            best = found
    if best is None:
        return FocalEstimate(usual, SIGMA_LOG_USUAL)
    scale = max(1.0, 2.0 * best.cost / len(best.fun))
    jacobian = np.asarray(best.jac, dtype=np.float64)
    sigma = float(np.sqrt(np.linalg.pinv(jacobian.T @ jacobian)[0, 0] * scale))
    return FocalEstimate(float(np.exp(best.x[0])), min(sigma, SIGMA_LOG_USUAL))


def _log_heights(camera: Camera, values: Floats, boxes: Floats, person_height: float) -> Floats:
    """(n,) logarithms of the heights of people, estimated from boxes, over the mean height; `UNSEEN` above the horizon.

    Args:
        camera: camera, of which the image size is used.
        values: (4,) log of the focal length [px], pitch, roll [rad], and log of the height of the camera.
        boxes: (n, 4) left, top, right, bottom [px].
        person_height: mean height, in the unit of the camera's height.
    """
    focal, tall = float(np.exp(values[0])), float(np.exp(values[3]))
    posed = replace(
        with_focal(camera, focal),
        position=np.array([0.0, 0.0, tall]), rotation=rotation_from_angles(0.0, *values[1:3].tolist()),
    )  # fmt: skip
    lens = pack_views([posed]).lens
    n = len(boxes)
    state, expected = np.zeros((n, 6)), np.zeros((n, 4))
    state[:, 4], state[:, 5] = person_height, BODY_WIDTHS * person_height
    foot = boxes[:, 3].copy()
    # The lower edge is that of the body's outline, nearer than its middle: the foot is moved until the edges agree
    for _ in range(3):
        rays = posed.rays(np.column_stack([0.5 * (boxes[:, 0] + boxes[:, 2]), foot]))
        down = rays[:, 2] < 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            state[:, :2] = np.where(down[:, None], rays[:, :2] * (-tall / rays[:, 2])[:, None], tall * 1e3)
        expected_boxes(lens, np.zeros(n, dtype=np.int64), state, np.zeros(n), expected)
        foot = np.where(np.isfinite(expected[:, 3]), foot + boxes[:, 3] - expected[:, 3], foot)
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log((boxes[:, 3] - boxes[:, 1]) / (expected[:, 3] - expected[:, 1]))
    return np.where(down & np.isfinite(logs), logs, UNSEEN)


def lens_unknown(camera: Camera) -> bool:
    """Whether a camera has no calibration at all, so that its focal length is a placeholder."""
    return not camera.placed and not camera.principal_px.any()


def with_focal(camera: Camera, focal_px: float) -> Camera:
    """Return the camera with a focal length [px], square pixels, central principal point and no distortion."""
    size = camera.image_size or (1, 1)
    focal, middle = np.full(2, focal_px), 0.5 * (np.array(size) - 1.0)
    fov = camera_fov(size, focal, middle, np.zeros(5), "brown", np.eye(3))
    return replace(
        camera, focal_px=focal, principal_px=middle, distortion=np.zeros(5), distortion_model="brown", fov=fov
    )


def _apart(t: Floats) -> list[int]:
    """Indices of a subset of the increasing times t (n,) [s], at least `STEP_S` apart."""
    kept: list[int] = []
    for k, when in enumerate(t.tolist()):
        if not kept or when - t[kept[-1]] >= STEP_S:
            kept.append(k)
    return kept
