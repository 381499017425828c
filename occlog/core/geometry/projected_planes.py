"""Directions in space projected on the planes xy, yz and zx: angles, variances, and which planes to use.

A sensor measures the azimuth theta from its +x towards its +y and the polar angle phi
from its +z, both with Gaussian noise, independent of each other.  The planes are those of
the world, whatever the sensor's pose, so that angles of several sensors meet in one
plane.  The angle of a plane with the axes (a, b) is atan2(b, a), with
xy: atan2(y, x), yz: atan2(z, y), zx: atan2(x, z) ([Lee] Sec. 2.1.2).

Arrays end in the plane's axis: index 0 is xy, 1 is yz, 2 is zx (`PLANES`).  Leading axes
(`...`) are times, sensors or both and broadcast.  A rotation is world-from-sensor, (..., 3, 3).
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints

from .camera import wrap_angle

PLANES = ("xy", "yz", "zx")
AXES = ((0, 1), (1, 2), (2, 0))  # of each plane: the angle runs from the first to the second
XY, YZ, ZX = range(3)
FIRST, SECOND, NORMAL = [0, 1, 2], [1, 2, 0], [2, 0, 1]
# At k sigma from a plane's normal the first-order variance is too small by 1/k^2 where the sight
# line is as uncertain along as across, and by 3/k^2 at worst.
BLIND_SIGMAS = 5.0


def polar_from_elevation(elevation: Floats) -> Floats:
    """Return polar angles [rad] from +z for elevations [rad] above the xy plane."""
    return np.pi / 2.0 - elevation


def direction(theta: Floats, phi: Floats) -> Floats:
    """Return unit vectors (..., 3) for azimuths theta and polar angles phi [rad], which broadcast."""
    s = np.sin(phi)
    return np.stack(np.broadcast_arrays(s * np.cos(theta), s * np.sin(theta), np.cos(phi)), axis=-1)


def direction_angles(vector: Floats) -> tuple[Floats, Floats]:
    """Return azimuths [rad, -pi..pi) and polar angles from +z [rad, 0..pi], each (...), of vectors (..., 3).

    The vectors may have any length.
    """
    theta = wrap_angle(np.arctan2(vector[..., 1], vector[..., 0]))
    return theta, np.arctan2(np.hypot(vector[..., 0], vector[..., 1]), vector[..., 2])


def projected_angles(vector: Floats) -> Floats:
    """Return (..., 3) angles [rad, -pi..pi) on the planes xy, yz and zx of vectors (..., 3) of any length in the world.

    They are atan2(y, x), atan2(z, y) and atan2(x, z).
    """
    return wrap_angle(np.arctan2(vector[..., SECOND], vector[..., FIRST]))


def projected_angle_gradients(vector: Floats) -> Floats:
    """Return the gradients of the three projected angles by the components of the vector, [Lee] Eq. 2.35 to 2.38.

    grad atan2(b, a) = (a e_b - b e_a) / (a^2 + b^2).

    Args:
        vector: (..., 3) in the world, of any length.

    Returns:
        (..., 3, 3): second-last axis the plane xy, yz, zx; last axis x, y, z. Zero for a plane to which the vector is
        normal.
    """
    a, b = vector[..., FIRST], vector[..., SECOND]
    square = a**2 + b**2
    square = np.where(square > 0, square, 1.0)
    gradient = np.zeros((*vector.shape, 3))
    gradient[..., range(3), FIRST] = -b / square
    gradient[..., range(3), SECOND] = a / square
    return gradient


def projected_covariance(
    theta: Floats,
    phi: Floats,
    sigma_theta: float | Floats,
    sigma_phi: float | Floats,
    rotation: Floats,
    *,
    pole_term: bool = False,
) -> Floats:
    """Return the first-order covariance of the three projected angles (xy, yz, zx) of one sensor.

    With s = sin phi and c = cos phi, for a sensor with the world's axes and both sigmas equal, the variances are
    sigma^2 times 1, (s^2 c^2 cos^2 theta + sin^2 theta) / (1 - s^2 cos^2 theta)^2 and (s^2 c^2 sin^2 theta + cos^2
    theta) / (1 - s^2 sin^2 theta)^2 (Figs. 2-2 and 2-3 of [Lee] as formulas). First order does not hold near a plane's
    normal (`blind_planes`). Near the sensor's z axis it falls to zero for the azimuth while the true variance does not,
    since phi is noisy too.

    Args:
        theta: (...) measured azimuth in the sensor's frame [rad].
        phi: (...) measured polar angle in the sensor's frame [rad].
        sigma_theta: standard deviations of theta [rad], one or (...).
        sigma_phi: standard deviations of phi [rad], one or (...).
        rotation: (..., 3, 3) world-from-sensor rotation.
        pole_term: use sin^2 phi + cos^2 phi sigma_phi^2 in place of sin^2 phi, which corrects the error near the z
            axis, for filters with measured angles.

    Returns:
        (..., 3, 3) [rad^2] of rank 2, as the sensor measures two angles.
    """
    spread = np.sin(phi) ** 2 + (np.cos(phi) * sigma_phi) ** 2 * pole_term
    sigmas = np.stack([sigma_theta * np.sqrt(spread), np.full(np.shape(phi), sigma_phi)], axis=-1)
    scaled = _tangent_gradients(theta, phi, rotation) * sigmas[..., None, :]
    return np.asarray(scaled @ np.swapaxes(scaled, -1, -2))


def blind_planes(
    theta: Floats, phi: Floats, sigma_theta: float | Floats, sigma_phi: float | Floats, rotation: Floats
) -> Bools:
    """Return (..., 3) whether a line of sight is within 5 sigma of the normal of each plane: xy, yz, zx.

    Either direction along the line counts. Sigma is the larger of the line's two standard deviations, sin(phi)
    sigma_theta and sigma_phi.

    Args:
        theta: (...) azimuths in the sensor's frame [rad].
        phi: (...) polar angles from the sensor's +z [rad].
        sigma_theta: standard deviation of theta [rad].
        sigma_phi: standard deviation of phi [rad].
        rotation: (..., 3, 3) world-from-sensor rotation.
    """
    world = _in_world(theta, phi, rotation)
    from_normal = np.arctan2(np.hypot(world[..., FIRST], world[..., SECOND]), np.abs(world[..., NORMAL]))
    sigma = np.maximum(np.sin(phi) * sigma_theta, sigma_phi)
    return np.asarray(from_normal < BLIND_SIGMAS * sigma[..., None])


def _tangent_gradients(theta: Floats, phi: Floats, rotation: Floats) -> Floats:
    """Return (..., 3, 2) gradients of the projected angles by arcs [rad] of the line of sight.

    Rows are the planes xy, yz, zx; columns are arcs in the directions of rising theta and of rising phi.

    Args:
        theta: (...) azimuths in the sensor's frame [rad].
        phi: (...) polar angles from the sensor's +z [rad].
        rotation: (..., 3, 3) world-from-sensor rotation.
    """
    s, c = np.sin(phi), np.cos(phi)
    to_theta = np.stack([-np.sin(theta), np.cos(theta), np.zeros_like(s)], axis=-1)
    to_phi = np.stack([c * np.cos(theta), c * np.sin(theta), -s], axis=-1)
    tangents = rotation @ np.stack([to_theta, to_phi], axis=-1)
    return np.asarray(projected_angle_gradients(_in_world(theta, phi, rotation)) @ tangents)


def _in_world(theta: Floats, phi: Floats, rotation: Floats) -> Floats:
    """Return unit vectors (..., 3) in the world of lines of sight.

    Args:
        theta: (...) azimuths in the sensor's frame [rad].
        phi: (...) polar angles from the sensor's +z [rad].
        rotation: (..., 3, 3) world-from-sensor rotation.
    """
    return np.asarray((rotation @ direction(theta, phi)[..., None])[..., 0])


def select_by_variance(variance: Floats, blind: Bools) -> Ints:
    """Return the two projected angles of least variance on different planes, among all sensors ([Lee] Sec. 2.2.3).

    The rule ignores the correlation of the two: where the line of sight has no component along their shared axis, two
    planes of one sensor are redundant.

    Args:
        variance: (..., S, 3) of the projected angles of S sensors on xy, yz, zx [rad^2]; NaN: no measurement.
        blind: (..., S, 3) planes that must not be chosen.

    Returns:
        (..., 2, 2) rows (sensor, plane), the least variance first; (-1, -1) where no plane is left. Of equal ones the
        first sensor and the first plane are taken. Planes: 0 for xy, 1 for yz, 2 for zx.
    """
    cost = np.where(blind | np.isnan(variance), np.inf, variance)
    sensor = np.argmin(cost, axis=-2)  # the best one for each plane
    least = np.min(cost, axis=-2)
    plane = np.argsort(least, axis=-1, kind="stable")[..., :2]
    chosen = np.stack([np.take_along_axis(sensor, plane, -1), plane], axis=-1)
    usable = np.isfinite(np.take_along_axis(least, plane, -1))
    return np.where(usable[..., None], chosen, -1)


def select_as_printed(phi: Floats) -> Ints:
    """Return the two planes of the rule printed in [Lee] Sec. 2.2.1 and 2.2.3; it is no better than a random choice.

    A sensor prefers yz where 45 < phi < 135 deg and zx elsewhere. With one sensor the other plane is always xy. With
    several, the first sensor's preferred plane is combined with that of the first sensor that prefers another plane; if
    all prefer one plane, with xy of the first sensor.

    Args:
        phi: (..., S) measured polar angles [rad].

    Returns:
        (..., 2, 2) rows (sensor, plane), with planes 0 for xy, 1 for yz, 2 for zx.
    """
    preferred = np.where((phi > np.pi / 4.0) & (phi < 0.75 * np.pi), YZ, ZX)
    other = preferred != preferred[..., :1]
    second = np.argmax(other, axis=-1)  # 0 where missing
    plane = np.where(np.any(other, axis=-1), np.take_along_axis(preferred, second[..., None], -1)[..., 0], XY)
    first_row = np.stack([np.zeros_like(second), preferred[..., 0]], axis=-1)
    return np.stack([first_row, np.stack([second, plane], axis=-1)], axis=-2)
