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
    """Normal equations of the rotations of C cameras in batches of time, and the resulting corrections.

    `rotation` (C, 3, 3) is world-from-camera of the calibration, `batches` the sums for uncorrected cameras, `angles`
    (C, 2) the corrections [rad] about the vertical and the camera's horizontal axis (0: none), `limit` (C, 2) the least
    significant angles (infinite: not estimated).
    """

    rotation: Floats  # (C, 3, 3) world-from-camera of the calibration
    batches: Batches  # sums of `pose_residuals`, as without correction
    angles: Floats  # (C, 2) corrections [rad] about the vertical and the horizontal axis of the camera
    limit: Floats  # (C, 2) least significant angles [rad]; inf: not estimated


def prior_poses(views: PackedCameras) -> PoseStatistics:
    """Return the rotation statistics of the packed cameras without data: no corrections, infinite limits."""
    C = len(views.lens)
    angles = np.zeros((C, ANGLES))
    return PoseStatistics(views.rotation, Batches.of(ANGLES * C), angles, angles + np.inf)


def update_poses(known: PoseStatistics, t_ns: int, normal: Floats) -> PoseStatistics:
    """Return the rotation statistics with a time step added; angles are solved again when a batch is complete.

    Args:
        known: statistics before; not changed.
        t_ns: time of the time step.
        normal: (2 C, 2 C + 1) normal equations from `pose_residuals` about the corrected cameras.
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
    """Return the orientation errors (C, 2) [rad] of the cameras, and the least significant ones (C, 2) [rad].

    Columns: about the vertical, and about the camera's horizontal axis. Cameras with no significant angle of at least
    `MIN_ANGLE` get 0; a limit is infinite where nothing was estimated. The median over the cameras is subtracted from
    the second angle, since bodies unlike the model tilt all cameras alike.

    Args:
        batches: (B, 2 C, 2 C + 1) normal equations as rows (N, b), in the order of time.
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
    """Return the packed cameras with corrected orientations, by the calibration and the angles (C, 2) in `known`.

    A camera is turned by the first angle about the world's vertical and by the second about its own x axis; `views` is
    not changed.
    """
    rotation, lens = known.rotation.copy(), views.lens.copy()
    for c in np.flatnonzero(known.angles.any(axis=1)).tolist():
        yaw, pitch = known.angles[c]
        vertical = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(pitch), -np.sin(pitch)], [0.0, np.sin(pitch), np.cos(pitch)]])
        rotation[c] = vertical @ rotation[c] @ about_x
    cameras = known.angles.any(axis=1) | (rotation != views.rotation).any(axis=(1, 2))
    lens[cameras, 3:12] = rotation[cameras].reshape(-1, 9)
    return views._replace(rotation=rotation, lens=lens)
