"""Perspective cameras: pixels to lines of sight and back, and the planar model of [Ercan] Sec. 3.1.

Camera frame: x to the right, y down, z forward.  A rotation `R` is world-from-camera:
its columns are the camera's axes in world coordinates.  World: x, y on the ground, z up;
yaw from +x towards +y, pitch up, roll clockwise as seen from behind the camera.

Distortion coefficients and models are those of `occlog.core.geometry.lens`.

Estimation of the vertical from camera orientations: cameras are usually mounted so that the horizon is level in the
image: the x axis of the image, to the right, is horizontal, whatever the pitch. The vertical is the direction that is
nearest to perpendicular to the x axes of all cameras. If all cameras have the same viewing direction, their pitch is
undetermined and taken as 0. A camera that hangs upside down has a horizontal x axis, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

from .lens import distort, undistort


def wrap_angle(angle: Floats | float) -> Floats:
    """Return angles [rad] of any shape wrapped to [-pi, pi)."""
    wrapped = (np.asarray(angle, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi
    # The sum may round up to 2 pi itself for angles just below -pi.
    return np.where(wrapped >= np.pi, wrapped - 2.0 * np.pi, wrapped)


def rotation_from_angles(yaw: float, pitch: float, roll: float) -> Floats:
    """Return the (3, 3) world-from-camera rotation of a camera; columns are its axes right, down and forward.

    Args:
        yaw: azimuth of the optical axis, from the world's +x to +y [rad].
        pitch: angle of the optical axis above the horizontal [rad].
        roll: turn about the optical axis, clockwise as seen from behind the camera [rad].
    """
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    forward = np.array([cp * cy, cp * sy, sp])
    right = np.array([sy, -cy, 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.column_stack([c * right + s * down, -s * right + c * down, forward])


def array_rotation(yaw: float, pitch: float, roll: float) -> Floats:
    """Return the (3, 3) world-from-array rotation of a microphone array with the axes x forward, y to the left, z up.

    Args:
        yaw: azimuth of the x axis, from the world's +x to +y [rad].
        pitch: angle of the x axis above the horizontal [rad].
        roll: turn about the x axis, clockwise as seen from behind the array [rad].
    """
    right, down, forward = rotation_from_angles(yaw, pitch, roll).T
    return np.column_stack([forward, -right, -down])


def angles_from_rotation(rotation: Floats) -> tuple[float, float, float]:
    """Return yaw, pitch and roll [rad] of a (3, 3) world-from-camera rotation (inverse of `rotation_from_angles`).

    The yaw is 0 for a camera that points straight up or down.
    """
    right, _, forward = rotation[:, 0], rotation[:, 1], rotation[:, 2]
    flat = float(np.hypot(forward[0], forward[1]))
    yaw = float(np.arctan2(forward[1], forward[0])) if flat > 1e-12 else 0.0
    pitch = float(np.arctan2(forward[2], flat))
    level = rotation_from_angles(yaw, pitch, 0.0)
    roll = float(np.arctan2(right @ level[:, 1], right @ level[:, 0]))
    return yaw, pitch, roll


def pixels_to_rays(
    pixels: Floats, focal_px: Floats, principal_px: Floats, coefficients: Floats, model: str, rotation: Floats
) -> Floats:
    """Return the directions in the world of the lines of sight through pixels.

    Args:
        pixels: (N, 2) image points as recorded (distorted) [px].
        focal_px: (2,) focal lengths [px].
        principal_px: (2,) principal point [px].
        coefficients: distortion coefficients in the order of the model (`occlog.core.geometry.lens`).
        model: distortion model: `brown`, `opencv`, `tsai` or `equidistant`.
        rotation: (3, 3) world-from-camera rotation, z forward.

    Returns:
        (N, 3) direction vectors, not normalised, with unit forward component; NaN outside the usable part of the lens.
    """
    ideal = undistort((pixels - principal_px) / focal_px, coefficients, model)
    return np.column_stack([ideal, np.ones(len(ideal))]) @ rotation.T


def points_to_pixels(
    points: Floats,
    position: Floats,
    focal_px: Floats,
    principal_px: Floats,
    coefficients: Floats,
    model: str,
    rotation: Floats,
) -> Floats:
    """Return the (N, 2) image points as recorded (distorted) [px] of world points; NaN for points behind the camera.

    Args:
        points: (N, 3) in the world.
        position: (3,) position of the camera.
        focal_px: (2,) focal lengths fx, fy [px].
        principal_px: (2,) principal point [px].
        coefficients: distortion coefficients in the order of the model (`occlog.core.geometry.lens`).
        model: distortion model: `brown`, `opencv`, `tsai` or `equidistant`.
        rotation: (3, 3) world-from-camera rotation, z forward.
    """
    local = (points - position) @ rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        ideal = np.where(local[:, 2:] > 0, local[:, :2] / local[:, 2:], np.nan)
    out = np.full_like(ideal, np.nan)
    front = np.isfinite(ideal[:, 0])
    out[front] = distort(ideal[front], coefficients, model) * focal_px + principal_px
    return out


MIN_SQUARED_DISTANCE = 1e-24
"""Lower bound of a squared distance, to avoid division by 0."""


def second_order_variance(away: Floats, covariance: Floats) -> Floats:
    """Return (N,) second-order variances [rad^2] of the azimuths of Gaussian positions from an origin.

    A displacement a along and c across a line of sight of length r changes its azimuth by c / r - a c / r^2: it is
    linear only where r is well above the standard deviation of a, and next to the origin any azimuth is possible
    (second-order filter, Bar-Shalom, Li and Kirubarajan 2001, Estimation, Sec. 10.3.3).

    Args:
        away: (N, 2) means, relative to the origin.
        covariance: (2, 2) or (N, 2, 2) of the positions.
    """
    r2 = np.maximum(np.sum(away**2, axis=1), MIN_SQUARED_DISTANCE)
    e = away / np.sqrt(r2)[:, None]
    along = np.einsum("...i,...ij,...j->...", e, covariance, e)
    across = np.trace(covariance, axis1=-2, axis2=-1) - along
    both = along * across - np.linalg.det(covariance)  # squared covariance of the two
    return np.asarray(np.maximum(along * across + both, 0.0) / r2**2)


TOUCHED_SIGMAS = 3.0
"""A target touches a sensor that is within so many standard deviations of its position."""


def touches(away: Floats, covariance: Floats) -> Bools:
    """Return (N,) booleans: Gaussian positions are at the origin, within `TOUCHED_SIGMAS`.

    Azimuths of a target there are not Gaussian. `away` (N, 2) are means relative to the origin, `covariance` (2, 2) or
    (N, 2, 2) those of the positions; their standard deviation is the geometric mean of both axes.
    """
    mean_variance = np.sqrt(np.maximum(np.linalg.det(covariance), 0.0))
    return np.asarray(np.sum(away**2, axis=1) < TOUCHED_SIGMAS**2 * mean_variance)


def rays_to_azimuth(rays: Floats) -> Floats:
    """Return the azimuths (N,) [rad], from +x to +y and in [-pi, pi), of direction vectors (N, 3) in the world."""
    return wrap_angle(np.arctan2(rays[:, 1], rays[:, 0]))


def azimuth_to_u(azimuth: Floats, yaw: float, focal_px: float) -> Floats:
    """Return the horizontal offset from the image centre [px], positive to the right, of an azimuth in a level image.

    A level image is that of a camera without pitch and roll. The measurement z of [Ercan] Eq. 1 is the negative offset.

    Args:
        azimuth: azimuths in the world [rad], within 90 degrees of the yaw.
        yaw: azimuth of the optical axis [rad].
        focal_px: focal length of the level image [px].
    """
    return -focal_px * np.tan(wrap_angle(azimuth - yaw))


def u_to_azimuth(u_px: Floats, yaw: float, focal_px: float) -> Floats:
    """Return the azimuth [rad, -pi..pi) of a horizontal offset in a level image (inverse of `azimuth_to_u`).

    A level image is that of a camera without pitch and roll.

    Args:
        u_px: offsets from the image centre [px], positive to the right.
        yaw: azimuth of the optical axis [rad].
        focal_px: focal length of the level image [px].
    """
    return wrap_angle(yaw - np.arctan(np.asarray(u_px) / focal_px))


def planar_offsets(xy: Floats, position: Floats, yaw: float) -> tuple[Floats, Floats]:
    """Return the offset h to the left of a camera's optical axis and the distance d along it, [Ercan] Fig. 2.

    With theta = yaw + pi the paper's h = sin(theta)(x1-c1) - cos(theta)(x2-c2) and
    d = -cos(theta)(x1-c1) - sin(theta)(x2-c2).

    Args:
        xy: (N, 2) positions.
        position: (2,) camera centre on the ground.
        yaw: azimuth of the optical axis [rad].

    Returns:
        h (N,) and d (N,) in the unit of xy; d <= 0 behind the camera.
    """
    dx, dy = xy[:, 0] - position[0], xy[:, 1] - position[1]
    c, s = np.cos(yaw), np.sin(yaw)
    return -s * dx + c * dy, c * dx + s * dy


def noise_variance(
    h: Floats,
    d: Floats,
    focal_px: float,
    sigma_position: float,
    sigma_yaw: float,
    sigma_read_px: float | Floats,
) -> Floats:
    """Return the variance [px^2] of a camera's measurement z = f h/d given the position, [Ercan] Eq. 2.

    It is the sum of the effects of errors of the yaw, of the camera's position and of the reading.

    Args:
        h: offset of the position to the side of the optical axis, any shape.
        d: distance along the optical axis, > 0, in the unit and shape of h.
        focal_px: focal length f [px].
        sigma_position: standard deviation of the camera's position, per axis, in the unit of h and d.
        sigma_yaw: standard deviation of the yaw [rad].
        sigma_read_px: standard deviation of the reading in the image [px].
    """
    ratio2 = 1.0 + (h / d) ** 2
    f2 = focal_px**2
    calibration = f2 * ratio2**2 * sigma_yaw**2 + f2 * ratio2 / d**2 * sigma_position**2
    return np.asarray(calibration + np.asarray(sigma_read_px) ** 2)


def intersection_point(centres: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Return the point nearest to all lines of sight (least squares), and its distance along each of them.

    Args:
        centres: (C, D) where the lines begin, as camera centres; in the plane or in space.
        axes: (C, D) unit vectors along the lines, as optical axes.

    Returns:
        (D,) point, and (C,) signed distances along the lines, negative behind the camera; all NaN for parallel lines.
    """
    # Projectors onto the planes across the lines: the distance of X to line i is |A_i (X - c_i)|.
    across = np.eye(centres.shape[1]) - axes[:, :, None] * axes[:, None, :]
    normal = across.sum(axis=0)
    if np.linalg.cond(normal) > 1e9:
        return np.full(centres.shape[1], np.nan), np.full(len(centres), np.nan)
    point = np.linalg.solve(normal, (across @ centres[:, :, None]).sum(axis=0)[:, 0])
    return point, np.asarray(((point - centres) * axes).sum(axis=1))


MIN_AXIS_SPREAD = 0.03
"""x axes determine the vertical if the second smallest eigenvalue of their mean square is above this (10 degrees
apart)."""
ROLLED = np.radians(30.0)
"""Cameras of an upright world are rolled less than this, in the median."""
LOOKS_UP = np.radians(45.0)
"""Cameras of an upright world are tilted up by less than this, in the median."""
LEVEL = np.radians(10.0)
"""Horizons that are level to this agree on a vertical ..."""
TILTED = np.radians(15.0)
"""... and a world that is tilted more than this against it is not upright."""


class Vertical(NamedTuple):
    """Estimate of the vertical of a world from the orientations of cameras, and how well it is determined.

    It is the up direction, whether the cameras differ enough to determine it, and the median roll that remains.
    """

    up: Floats  # (3,) unit vector in the world
    certain: bool  # the x axes differ enough; else pitches are taken for 0
    roll: float  # median roll of the cameras against it [rad]


def vertical(rotations: Floats) -> Vertical:
    """Return the direction that is nearest to perpendicular to the image x axes of all cameras (which should be level).

    If the x axes are nearly parallel, it is the mean up axis of the images, made perpendicular to them. The sign is
    that of most images' up axes.

    Args:
        rotations: (C, 3, 3) world-from-camera rotations, C >= 1.
    """
    x, up = rotations[:, :, 0], -rotations[:, :, 1]
    mean = up.mean(axis=0)
    values, vectors = np.linalg.eigh(x.T @ x / len(x))
    certain = bool(values[1] > MIN_AXIS_SPREAD)
    if certain:
        found = vectors[:, 0]
    else:  # perpendicular to the common x axis, in the middle of the image's vertical axes
        axis = vectors[:, 2]
        found = mean - (mean @ axis) * axis
        if np.linalg.norm(found) < 1e-6:
            found = vectors[:, 0]
    found = found / np.linalg.norm(found)
    if np.median(up @ found) < 0.0:
        found = -found
    return Vertical(np.asarray(found), certain, float(np.median(_roll(rotations, found))))


def other_up_axis(rotations: Floats) -> str | None:
    """Return the signed axis of the world (`y`, `-y`, `x`, `-x` or `-z`) that is up in all images, if z is not.

    None if z is up, if no axis is, and without cameras. The image x axes of all cameras are horizontal to `LEVEL` with
    respect to the axis, and the median pitch is downward by at most `LOOKS_UP`. Cameras that view the ground from
    above, or hang upside down, are consistent with z up.

    Args:
        rotations: (C, 3, 3) world-from-camera rotations.
    """
    x, up, forward = rotations[:, :, 0], -rotations[:, :, 1], rotations[:, :, 2]
    level = np.abs(x) < np.sin(LEVEL)
    upright = (level[:, 2] & (up[:, 2] > -np.sin(LEVEL))).all()
    if not len(rotations) or (upright and np.median(forward[:, 2]) < 0.0):
        return None
    for name, axis, sign in (("y", 1, 1.0), ("-y", 1, -1.0), ("x", 0, 1.0), ("-x", 0, -1.0), ("-z", 2, -1.0)):
        pitch = np.arcsin(np.clip(sign * np.median(forward[:, axis]), -1.0, 1.0))
        if (level[:, axis] & (sign * up[:, axis] > 0.0)).all() and -LOOKS_UP < pitch < 0.0:
            return name
    return None


def is_upright(rotations: Floats) -> bool:
    """Return whether z can be the vertical of a world, given C camera rotations (C, 3, 3), world-from-camera.

    True without cameras.

    It cannot if another axis is up in all images (`other_up_axis`); if most cameras are rolled by more than `ROLLED` or
    are tilted up by more than `LOOKS_UP`; if most hang upside down and are tilted up; or if the horizons of three or
    more agree, to `LEVEL`, on a vertical that is more than `TILTED` off.
    """
    if not len(rotations):
        return True
    if other_up_axis(rotations) is not None:
        return False
    z = np.array([0.0, 0.0, 1.0])
    pitch = np.median(np.arcsin(np.clip(rotations[:, 2, 2], -1.0, 1.0)))
    over = float(np.median(-rotations[:, 2, 1])) < 0.0
    roll = float(np.median(_roll(rotations, z)))
    if roll > ROLLED or pitch > LOOKS_UP or (over and pitch > 0.0):
        return False
    found = vertical(rotations)
    off = float(np.arccos(np.clip(abs(found.up[2]), 0.0, 1.0)))
    # Two horizons agree on a vertical in any case
    return not (len(rotations) > 2 and found.certain and found.roll < LEVEL and off > TILTED)


def looks_away(centres: Floats, rotations: Floats) -> bool:
    """Return whether cameras have what they observe behind them, as in a misread left-handed world.

    True if the optical axes of two or more cameras meet behind every camera; or, of one camera or several with parallel
    axes, if all are upside down, point upwards and are above the ground z = 0. False for cameras that are upright with
    one above the ground, such as rigs that face outwards.

    Args:
        centres: (C, 3) positions of the cameras, C >= 1.
        rotations: (C, 3, 3) world-from-camera rotations.
    """
    if is_upright(rotations) and (centres[:, 2] >= 0.0).any():
        return False
    _, along = intersection_point(centres, rotations[:, :, 2])
    if len(centres) > 1 and np.isfinite(along).all():
        return bool((along < 0.0).all())
    return bool(((rotations[:, 2, 1] > 0.0) & (rotations[:, 2, 2] > 0.0) & (centres[:, 2] > 0.0)).all())


def turn_upright(up: Floats) -> Floats:
    """Return the (3, 3) smallest rotation that maps the up direction (3,), of any length, to the z axis.

    An up direction that is straight down is turned about x.

    Raises:
        ValueError: the vector has no length or is not finite.
    """
    length = float(np.linalg.norm(up))
    if not length > 0.0 or not np.isfinite(length):
        raise ValueError("up has no direction")
    x, y, z = np.asarray(up, dtype=np.float64) / length
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula for the axis up x z
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))


def _roll(rotations: Floats, up: Floats) -> Floats:
    """Return the (C,) absolute roll angles [rad] of cameras: of their image x axes to the horizontal, 0 to pi / 2.

    Args:
        rotations: (C, 3, 3) world-from-camera rotations.
        up: (3,) unit vector of the vertical.
    """
    return np.asarray(np.arcsin(np.clip(np.abs(rotations[:, :, 0] @ up), 0.0, 1.0)))
