"""Focal length of a camera from the boxes of people who walk: its image size is all that is known.

Boxes of upright people of about one height determine a horizon and the vertical vanishing point, which with square
pixels and a principal point in the middle give the focal length (Lv, Zhao and Nevatia 2006). Heights along one track
must be constant, and those of people differ by a few centimetres: the focal length with the least squares of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.records.scene import Camera, camera_fov

from .ground_plane import ground_plane, whole

FOCAL_WIDTHS = np.exp(np.linspace(np.log(0.4), np.log(3.2), 14))
"""Focal lengths that are tried, in widths of the image: fields of view of 103 to 18 degrees."""
USUAL_WIDTHS, SIGMA_LOG_USUAL = 0.9, 0.35
"""Usual focal length in widths of the image (58 degrees), and the standard deviation of its logarithm among cameras."""
SIGMA_TRACK, SIGMA_PEOPLE = 0.05, 0.06
"""Standard deviations of the logarithm of a height: along a track, and among people."""
STEP_S = 1.0
"""Boxes of a track are thinned to this: errors of a gait last about as long [s]."""
MAX_LOG = 4.0
"""Residuals count up to this many standard deviations."""


class FocalEstimate(NamedTuple):
    """A focal length [px] and the standard deviation of its logarithm; that of cameras in general without boxes."""

    focal_px: float
    sigma_log: float


def focal_of_people(camera: Camera, tracks: Sequence[tuple[Floats, Floats]], person_height: float) -> FocalEstimate:
    """The focal length of a camera.

    Args:
        camera: with an image size.
        tracks: times [s] and boxes (n, 4) of people, left, top, right, bottom [px].
        person_height: mean height of people.
    """
    assert camera.image_size is not None
    width = camera.image_size[0]
    usual = USUAL_WIDTHS * width
    thinned = [boxes[_apart(t)] for t, boxes in tracks]
    own = [part for boxes in thinned if len(part := boxes[whole(camera, boxes)])]
    logs = np.log(FOCAL_WIDTHS * width)
    costs = np.array([_cost(with_focal(camera, float(np.exp(v))), own, person_height) for v in logs])
    costs += ((logs - np.log(usual)) / SIGMA_LOG_USUAL) ** 2
    k = int(np.argmin(costs))
    if not np.isfinite(costs[k]):
        return FocalEstimate(usual, SIGMA_LOG_USUAL)
    k = min(max(k, 1), len(logs) - 2)
    step = float(logs[1] - logs[0])
    left, middle, right = costs[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    if not (np.isfinite(bend) and bend > 0.0):
        return FocalEstimate(usual, SIGMA_LOG_USUAL)
    shift = float(np.clip(0.5 * (left - right) / bend, -1.0, 1.0))
    sigma = float(step * np.sqrt(2.0 / bend))
    return FocalEstimate(float(np.exp(logs[k] + shift * step)), min(sigma, SIGMA_LOG_USUAL))


def lens_unknown(camera: Camera) -> bool:
    """Return whether nothing is known of a lens: the focal length of an uncalibrated camera is a placeholder."""
    return not camera.placed and not camera.principal_px.any()


def with_focal(camera: Camera, focal_px: float) -> Camera:
    """The camera with square pixels, its principal point in the middle and no distortion."""
    size = camera.image_size or (1, 1)
    focal, middle = np.full(2, focal_px), 0.5 * (np.array(size) - 1.0)
    fov = camera_fov(size, focal, middle, np.zeros(5), "brown", np.eye(3))
    return replace(
        camera, focal_px=focal, principal_px=middle, distortion=np.zeros(5), distortion_model="brown", fov=fov
    )


def _apart(t: Floats) -> list[int]:
    """Indices of times that are `STEP_S` apart."""
    kept: list[int] = []
    for k, when in enumerate(t.tolist()):
        if not kept or when - t[kept[-1]] >= STEP_S:
            kept.append(k)
    return kept


def _cost(camera: Camera, tracks: Sequence[Floats], person_height: float) -> float:
    """Squared residuals of heights of people with this lens, over their variances; infinite without a ground plane."""
    every = np.concatenate([np.zeros((0, 4)), *tracks])
    plane = ground_plane(camera, every, person_height)
    if plane is None:
        return np.inf
    rotation = rotation_from_angles(0.0, plane.pitch, plane.roll)
    middle = 0.5 * (every[:, 0] + every[:, 2])
    foot, head = (
        (np.column_stack([middle, every[:, edge]]) - camera.principal_px) / camera.focal_px for edge in (3, 1)
    )
    feet, heads = (np.column_stack([part, np.ones(len(part))]) @ rotation.T for part in (foot, head))
    with np.errstate(divide="ignore", invalid="ignore"):
        away = -plane.height / feet[:, 2] * np.hypot(feet[:, 0], feet[:, 1])
        heights = plane.height + away * heads[:, 2] / np.hypot(heads[:, 0], heads[:, 1])
        logs = np.where((feet[:, 2] < 0.0) & (heights > 0.0), np.log(np.maximum(heights, 1e-9) / person_height), np.nan)
    logs = np.where(np.isfinite(logs), logs, MAX_LOG)
    cost, start = 0.0, 0
    for boxes in tracks:
        part = logs[start : start + len(boxes)]
        start += len(boxes)
        mean = float(np.median(part))
        cost += float((np.minimum(np.abs(part - mean) / SIGMA_TRACK, MAX_LOG) ** 2).sum())
        cost += min(abs(mean) / np.hypot(SIGMA_PEOPLE, SIGMA_TRACK), MAX_LOG) ** 2
    return cost
