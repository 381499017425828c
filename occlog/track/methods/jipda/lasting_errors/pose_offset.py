"""Online estimation of errors of the cameras' orientations, from boxes of the same people in several cameras.

Two angles of each camera, about the vertical and about its horizontal axis, by least squares with the positions of the
people eliminated, as in bundle adjustment (Triggs, McLauchlan, Hartley and Fitzgibbon 2000). The positions of the
cameras are taken as exact, so that the angles are absolute.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import Floats

from ..kernels.body_box import PackedCameras
from ..kernels.lasting_errors.pose_residuals import ANGLES
from .normal_equations import Batches, solve_batches

PRIOR_SIGMA = 0.05
"""Standard deviation of an error of orientation before any box [rad]."""
MIN_ANGLE = 0.007
"""Cameras with a significant error of at least this size [rad] are corrected."""


@dataclass(frozen=True)
class PoseStatistics:
    """Normal equations of the rotations of C cameras in batches of time, and the resulting rotations."""

    rotation: Floats  # (C, 3, 3) world-from-camera of the calibration
    batches: Batches  # sums of `pose_residuals`, as without correction
    angles: Floats  # (C, 2) corrections [rad] about the vertical and the horizontal axis of the camera
    limit: Floats  # (C, 2) least significant angles [rad]; inf: not estimated


def prior_poses(views: PackedCameras) -> PoseStatistics:
    """Create the statistics of C cameras without data."""
    C = len(views.lens)
    angles = np.zeros((C, ANGLES))
    return PoseStatistics(views.rotation, Batches.of(ANGLES * C), angles, angles + np.inf)


def update_poses(known: PoseStatistics, t_ns: int, normal: Floats) -> PoseStatistics:
    """Return the statistics with a time step added; angles are updated when a batch is complete.

    `normal` (2 C, 2 C + 1) are the normal equations from `pose_residuals`, for the time step at `t_ns`.
    """
    normal = normal.copy()
    # As without correction
    normal[:, -1] += normal[:, :-1] @ known.angles.ravel()
    batches = known.batches.add(t_ns, normal)
    known = replace(known, batches=batches)
    if batches.since_ns != t_ns or not len(batches.kept):
        return known
    angles, limit = pose_angles(batches.kept)
    return replace(known, angles=angles, limit=limit)


def pose_angles(batches: Floats) -> tuple[Floats, Floats]:
    """Orientation errors (C, 2) [rad], 0 for cameras without a significant one, and the significance limits (C, 2).

    Args:
        batches: (B, 2 C, 2 C + 1) normal equations, in the order of time.
    """
    d, limit = solve_batches(batches, 1.0 / PRIOR_SIGMA**2)
    # Bodies that are unlike the model move the boxes of all cameras down or up
    tilted = np.flatnonzero(np.isfinite(limit))
    tilted = tilted[tilted % ANGLES == 1]
    d[tilted] -= np.median(d[tilted]) if len(tilted) else 0.0
    d, limit = d.reshape(-1, ANGLES), limit.reshape(-1, ANGLES)
    d[(np.abs(d) < np.maximum(MIN_ANGLE, limit)).all(axis=1)] = 0.0
    return d, limit


def corrected(views: PackedCameras, known: PoseStatistics) -> PackedCameras:
    """Return the packed cameras with orientations corrected by the angles in `known`."""
    rotation, lens = known.rotation.copy(), views.lens.copy()
    for c in np.flatnonzero(known.angles.any(axis=1)).tolist():
        yaw, pitch = known.angles[c]
        vertical = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(pitch), -np.sin(pitch)], [0.0, np.sin(pitch), np.cos(pitch)]])
        rotation[c] = vertical @ rotation[c] @ about_x
    cameras = known.angles.any(axis=1) | (rotation != views.rotation).any(axis=(1, 2))
    lens[cameras, 3:12] = rotation[cameras].reshape(-1, 9)
    return views._replace(rotation=rotation, lens=lens)
