"""Pose of a camera, and its focal length if unknown, from world points marked in its image."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from occlog.array_types import Floats
from occlog.core.geometry.lens import undistort
from occlog.errors import InputError, option
from occlog.io.formats.calibration.readers.homography import ground_pose
from occlog.records.scene import Camera, camera_fov

MIN_POINTS = 4
SIGMA_MARK_PX = 3.0
"""Standard deviation of a mark, where the residuals of few points do not show it."""
MAX_RESIDUAL_PX = 30.0
"""Largest residual of a point."""
MAX_SIGMA_FOCAL = 0.3
"""Largest standard deviation of a focal length, as its share."""
FLAT = 1e-3
"""Points with a smaller ratio of their extents are on a line."""


class MarkedPose(NamedTuple):
    """Pose and intrinsics of a camera estimated from marked points.

    Attributes:
        camera: camera with its pose.
        sigma_position: (3,) standard deviations, in the unit of the points.
        sigma_focal: relative standard deviation of the focal length; 0: it was given.
        residual_px: root mean square of the residuals.
        points: number of points.
    """

    camera: Camera
    sigma_position: Floats
    sigma_focal: float
    residual_px: float
    points: int


def pose_of_points(camera: Camera, pixels: Floats, points: Floats) -> MarkedPose:
    """Estimate the pose of a camera by least squares over marked points, and its focal length if unknown.

    Args:
        camera: camera with its lens; a focal length of 1 px or less means unknown: it is estimated with square
            pixels, a principal point in the middle and no distortion.
        pixels: (n, 2) marks in the image.
        points: (n, 3) positions in the world; all with z = 0 if the focal length is unknown.

    Raises:
        InputError: too few points, points on a line, a point with a residual above `MAX_RESIDUAL_PX`, a camera
            below the floor, or an undetermined focal length.
    """
    where, n = f"camera {camera.name}", len(points)
    if n < MIN_POINTS:
        raise InputError(
            f"{where}: {n} marked points; {MIN_POINTS} at least are needed: mark more points", id="insufficient-data"
        )
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not extent[1] > FLAT * extent[0]:
        raise InputError(
            f"{where}: the marked points are on a line; mark points all over the floor", id="insufficient-data"
        )
    known = float(camera.focal_px[0]) > 1.0
    start = _with_lens(camera, pixels, points) if known else _without_lens(camera, pixels, points)
    spread = float(extent[0])

    def changed(values: Floats) -> Camera:
        return replace(
            start,
            rotation=start.rotation @ cv2.Rodrigues(values[:3])[0],
            position=start.position + spread * values[3:6],
            focal_px=start.focal_px * np.exp(values[6] if len(values) > 6 else 0.0),
        )

    def residuals(values: Floats) -> Floats:
        away = changed(values).project(points) - pixels
        return np.asarray(np.where(np.isfinite(away), away, 1e4).ravel())

    found = least_squares(residuals, np.zeros(6 if known else 7), method="lm" if 2 * n >= 7 else "trf")
    done = changed(found.x)
    off = np.linalg.norm(found.fun.reshape(-1, 2), axis=1)
    worst = int(np.argmax(off))
    if off[worst] > MAX_RESIDUAL_PX:
        x, y = points[worst, :2].tolist()
        raise InputError(
            f"{where}: the point at ({x:g}, {y:g}) is {off[worst]:.0f} px off the others (limit {MAX_RESIDUAL_PX:g}); "
            "check its position, and that the axes are right-handed",
            id="invalid-calibration",
        )
    if done.position[2] <= 0.0:
        raise InputError(
            f"{where}: the marked points put the camera below the floor; the axes of the floor must be right-handed",
            id="invalid-calibration",
        )
    # A residual of few points is uncertain: that of a mark counts as four of them
    freedom = max(2 * n - len(found.x), 0)
    variance = (float(found.fun @ found.fun) + 4.0 * SIGMA_MARK_PX**2) / (freedom + 4.0)
    jacobian = np.asarray(found.jac, dtype=np.float64)
    sigma = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)) * variance)
    sigma_focal = 0.0 if known else float(sigma[6])
    if sigma_focal > MAX_SIGMA_FOCAL:
        raise InputError(
            f"{where}: the focal length is uncertain by {sigma_focal:.0%}; mark more points, near and far, or "
            "give focal_px in the scene",
            id="insufficient-data",
        )
    size = done.image_size or (0, 0)
    fov = camera_fov(size, done.focal_px, done.principal_px, done.distortion, done.distortion_model, done.rotation)
    rms = float(np.sqrt(np.mean(off**2)))
    return MarkedPose(replace(done, fov=fov, placed=True), spread * sigma[3:6], sigma_focal, rms, n)


def _with_lens(camera: Camera, pixels: Floats, points: Floats) -> Camera:
    """Initial pose with known focal length: perspective-n-point (SQPnP, Terzakis and Lourakis 2020).

    InputError if no pose fits. `pixels` (n, 2) are the marks in the image, `points` (n, 3) those in the world.
    """
    ideal = undistort((pixels - camera.principal_px) / camera.focal_px, camera.distortion, camera.distortion_model)
    good = np.isfinite(ideal).all(axis=1)
    found = False
    if np.count_nonzero(good) >= MIN_POINTS:
        found, turn, shift = cv2.solvePnP(points[good], ideal[good], np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    if not found:
        raise InputError(
            f"camera {camera.name}: no pose fits the marked points; check them, and the lens", id="invalid-calibration"
        )
    rotation = cv2.Rodrigues(turn)[0]
    return replace(camera, rotation=rotation.T, position=-(rotation.T @ shift).ravel(), placed=True)


def _without_lens(camera: Camera, pixels: Floats, points: Floats) -> Camera:
    """Initial pose and focal length of a camera from the homography of the floor, without distortion.

    InputError without an image size, for points above the floor, or if no focal length fits. `pixels` (n, 2) are the
    marks in the image, `points` (n, 3) those in the world.
    """
    if camera.image_size is None:
        raise InputError(
            f"camera {camera.name}: has no image size; give {option('image_size')} to ingest, or add image_size_px to "
            "the scene",
            id="missing-image-size",
        )
    if points[:, 2].any():
        raise InputError(
            f"camera {camera.name}: points with z need a focal length; give focal_px in the scene", id="missing-value"
        )
    middle = 0.5 * (np.array(camera.image_size) - 1.0)
    matrix, _ = cv2.findHomography(points[:, :2], pixels)
    pose = None if matrix is None else ground_pose(matrix, middle)
    if pose is None:
        raise InputError(
            f"camera {camera.name}: no focal length fits the marked points; check them, or give focal_px in the scene",
            id="invalid-calibration",
        )
    return replace(
        camera, focal_px=np.full(2, pose.focal), principal_px=middle, rotation=pose.rotation.T, position=pose.centre,
        distortion=np.zeros(5), distortion_model="brown", placed=True,
    )  # fmt: skip
