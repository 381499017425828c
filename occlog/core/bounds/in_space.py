"""Cramér-Rao bounds of a target in space seen by sensors of directions, [Lee] Sec. 2.3.

One recursion, [Lee] Eq. 2.30 with a finite prior (`in_plane.posterior_bound`), gives two bounds: the
*direct* one, of the state (x, y, z, vx, vy, vz) with azimuth and polar angle, and the one
of a *plane*, of the state (a, b, va, vb) with one projected angle, where (a, b) are the
plane's axes (`projected_planes.AXES`): (x, y), (y, z) or (z, x).

A known acceleration is an input: it moves the path and leaves the Jacobian that of the
constant velocity, unlike the printed (2.32), (2.33) and (2.39).  The information is meant
at the true positions.  The direct bound, cut to a plane's axes, is never above that plane's;
two planes of a sensor with their covariance give the direct one again, and two planes taken
as independent give no bound.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.geometry.projected_planes import (
    AXES,
    blind_planes,
    direction_angles,
    projected_covariance,
)

from .in_plane import (
    bearing_information,
    constant_velocity_steps,
    gaussian_information,
    posterior_bound,
    smoothing_bound,
)


def sight_angles(xyz: Floats, position: Floats, rotation: Floats) -> tuple[Floats, Floats]:
    """Return azimuths (N,) and polar angles (N,) [rad] of world positions, in a sensor's frame.

    The azimuth is from the sensor's +x to its +y, the polar angle from its +z.

    Args:
        xyz: (N, 3) positions in the world.
        position: (3,) position of the sensor.
        rotation: (3, 3) world-from-sensor rotation.
    """
    return direction_angles((xyz - position) @ rotation)


def direction_information(
    xyz: Floats, position: Floats, rotation: Floats, sigma_theta: float | Floats, sigma_phi: float | Floats
) -> Floats:
    """Return the Fisher information of an azimuth and a polar angle about the position, [Lee] Eq. 2.40 and 2.41.

    Args:
        xyz: (N, 3) true positions.
        position: (3,) of the sensor.
        rotation: (3, 3) world-from-sensor.
        sigma_theta: standard deviation of the azimuth [rad], > 0, one or (N,); inf: not measured.
        sigma_phi: standard deviation of the polar angle [rad], > 0, one or (N,); inf: not measured.

    Returns:
        (N, 3, 3) of rank 2; zero on the sensor's own z axis, where an azimuth means nothing.
    """
    # Gradients of both angles in the sensor's frame (Eq. 2.41 with its rows in order), turned to the world
    x, y, z = ((xyz - position) @ rotation).T
    flat2 = x**2 + y**2
    off_axis = flat2 > 0
    flat2 = np.where(off_axis, flat2, 1.0)
    flat, square = np.sqrt(flat2), flat2 + z**2
    by_theta = np.column_stack([-y, x, np.zeros_like(x)]) / flat2[:, None]
    by_phi = np.column_stack([x * z / flat, y * z / flat, -flat]) / square[:, None]
    none = np.zeros_like(by_theta)
    information = gaussian_information(by_theta @ rotation.T, np.full(len(x), np.square(sigma_theta)), none)
    information = information + gaussian_information(by_phi @ rotation.T, np.full(len(x), np.square(sigma_phi)), none)
    return np.where(off_axis[:, None, None], information, 0.0)


def ground_information(information: Floats) -> Floats:
    """Return the information about (x, y) when nothing is known of z: the Schur complement over z.

    Of a direction this is the information of its azimuth about the world's z axis, with the
    first-order variance of that azimuth whatever the sensor's pose: the unknown height takes up
    all the information of the elevation.

    Args:
        information: (N, 3, 3) positive semi-definite.

    Returns:
        (N, 2, 2); where there is no information about z, the block of x and y as it is.
    """
    flat, both, up = information[:, :2, :2], information[:, :2, 2], information[:, 2, 2]
    informed = up > 0
    taken = both[:, :, None] * both[:, None, :] / np.where(informed, up, 1.0)[:, None, None]
    return np.asarray(np.where(informed[:, None, None], flat - taken, flat))


def plane_information(xyz: Floats, position: Floats, plane: int, variance: Floats) -> Floats:
    """Return the Fisher information of a projected angle about the position in its plane, [Lee] Eq. 2.34 to 2.38.

    Args:
        xyz: (N, 3) true positions.
        position: (3,) position of the sensor.
        plane: 0 for xy, 1 for yz, 2 for zx.
        variance: (N,) variance of the angle [rad^2], > 0; inf where the line of sight is too near the plane's normal.

    Returns:
        (N, 2, 2) of rank 1, in the order of the plane's axes (x, y; y, z; or z, x); zero where the variance is
        infinite.
    """
    axes = list(AXES[plane])
    return bearing_information(xyz[:, axes], position[axes], np.sqrt(variance))


def plane_variance(
    xyz: Floats, position: Floats, rotation: Floats, sigma_theta: float, sigma_phi: float, plane: int
) -> Floats:
    """Return the (N,) first-order variances [rad^2] of the angle projected on a plane, at true positions.

    Infinite where the line of sight is within 5 sigma of the plane's normal, and on the sensor's own z axis.

    Args:
        xyz: (N, 3) true positions.
        position: (3,) position of the sensor.
        rotation: (3, 3) world-from-sensor rotation.
        sigma_theta: standard deviation of the azimuth [rad].
        sigma_phi: standard deviation of the polar angle [rad].
        plane: 0 for xy, 1 for yz, 2 for zx.
    """
    theta, phi = sight_angles(xyz, position, rotation)
    noise = (sigma_theta, sigma_phi, rotation)
    variance = projected_covariance(theta, phi, *noise)[:, plane, plane]
    on_axis = ~np.any((xyz - position) @ rotation[:, :2], axis=1)
    return np.where(blind_planes(theta, phi, *noise)[:, plane] | on_axis, np.inf, variance)


def motion_bound(
    information: Floats, dt: Floats, P0: Floats, acceleration_density: float = 0.0, *, smoothed: bool = False
) -> Floats:
    """Return the posterior Cramér-Rao bound for a constant velocity, [Lee] Eq. 2.30, at each step.

    Args:
        information: (T, d, d) Fisher information about the position of all measurements of a step, summed over the
            sensors; d is 3, or 2 in a plane.
        dt: (T,) times [s] to each step from the one before, the first from the prior, >= 0.
        P0: (2d, 2d) finite covariance of the prior, positions first, then velocities.
        acceleration_density: power spectral density of the white acceleration [length^2/s^3]; 0 in [Lee].
        smoothed: True for the bound of smoothers, which use all steps (`in_plane.smoothing_bound`); False for that of
            filters.

    Returns:
        (T, 2d, 2d) bounds of the error covariance.
    """
    return (smoothing_bound if smoothed else posterior_bound)(*motion_steps(information, dt, acceleration_density), P0)


def motion_steps(information: Floats, dt: Floats, acceleration_density: float = 0.0) -> tuple[Floats, Floats, Floats]:
    """Return the information, transition and noise matrices that `posterior_bound` takes, for a constant velocity.

    Args:
        information: (T, d, d) Fisher information about the position at each step; d is 3, or 2 in a plane.
        dt: (T,) times [s] to each step from the one before, the first from the prior, >= 0.
        acceleration_density: power spectral density of the white acceleration [length^2/s^3].

    Returns:
        Information about the state (positions, then velocities), transition matrices and covariances of the process
        noise, each (T, 2d, 2d).
    """
    d = information.shape[1]
    full = np.zeros((len(dt), 2 * d, 2 * d))
    full[:, :d, :d] = information
    F, Q = (_each_axis(m, d) for m in constant_velocity_steps(dt, acceleration_density))
    return full, F, Q


def direct_bound(
    xyz: Floats,
    dt: Floats,
    sensors: tuple[Floats, Floats],
    sigmas: tuple[float, float],
    P0: Floats,
    used: Bools | None = None,
    acceleration_density: float = 0.0,
) -> Floats:
    """Return the (T, 6, 6) filtering bounds of the state in space with both angles of each sensor, [Lee] Sec. 2.3.2.

    The state is (x, y, z, vx, vy, vz) with a constant velocity.

    Args:
        xyz: (T, 3) true positions.
        dt: (T,) times [s] to each step from the one before, the first from the prior, >= 0.
        sensors: positions (S, 3) and world-from-sensor rotations (S, 3, 3).
        sigmas: standard deviations of azimuth and polar angle [rad].
        P0: (6, 6) covariance of the prior.
        used: (T, S) which sensors measured at each step; all if None.
        acceleration_density: power spectral density of the white acceleration [length^2/s^3].
    """
    each = [direction_information(xyz, p, R, *sigmas) for p, R in zip(*sensors, strict=True)]
    return motion_bound(_total(each, used), dt, P0, acceleration_density)


def plane_bound(
    xyz: Floats,
    dt: Floats,
    sensors: tuple[Floats, Floats],
    sigmas: tuple[float, float],
    P0: Floats,
    plane: int,
    used: Bools | None = None,
    acceleration_density: float = 0.0,
) -> Floats:
    """Return the (T, 4, 4) filtering bounds of a plane's state by the projected angles of all sensors, [Lee] 2.3.1.

    The state is (a, b, va, vb) on the axes (a, b) of the plane: (x, y), (y, z) or (z, x). A sensor that views along the
    plane's normal adds no information.

    Args:
        xyz: (T, 3) true positions.
        dt: (T,) times [s] to each step from the one before, the first from the prior, >= 0.
        sensors: positions (S, 3) and world-from-sensor rotations (S, 3, 3).
        sigmas: standard deviations of azimuth and polar angle [rad].
        P0: (4, 4) covariance of the prior.
        plane: 0 for xy, 1 for yz, 2 for zx.
        used: (T, S) which sensors measured the angle of this plane at each step; all if None.
        acceleration_density: power spectral density of the white acceleration [length^2/s^3].
    """
    each = [
        plane_information(xyz, p, plane, plane_variance(xyz, p, R, *sigmas, plane))
        for p, R in zip(*sensors, strict=True)
    ]
    return motion_bound(_total(each, used), dt, P0, acceleration_density)


def plane_axes(plane: int) -> list[int]:
    """Return the indices in (x, y, z, vx, vy, vz) of a plane's state (a, b, va, vb).

    `plane` is 0 for (a, b) = (x, y), 1 for (y, z), 2 for (z, x).
    """
    a, b = AXES[plane]
    return [a, b, a + 3, b + 3]


def accelerated_path(state: Floats, acceleration: Floats, dt: Floats) -> Floats:
    """Return the (T, 2d) states after steps of known acceleration, x' = x + v dt + a dt^2/2 ([Lee] Eq. 2.15, no A/V).

    Args:
        state: (2d,) at the start, positions first.
        acceleration: (T, d) in each step.
        dt: (T,) lengths of the steps [s].
    """
    d = acceleration.shape[1]
    gained = np.cumsum(acceleration * dt[:, None], axis=0)
    before = state[d:] + gained - acceleration * dt[:, None]
    moved = np.cumsum(before * dt[:, None] + 0.5 * acceleration * dt[:, None] ** 2, axis=0)
    return np.column_stack([state[:d] + moved, state[d:] + gained])


def _total(each: list[Floats], used: Bools | None) -> Floats:
    """Return the (T, d, d) sum over S sensors of their Fisher information.

    Args:
        each: (T, d, d) Fisher information of each sensor about the position.
        used: (T, S) which sensors measured at each step; all if None.
    """
    stacked = np.stack(each, axis=1)
    if used is not None:
        stacked = np.where(used[:, :, None, None], stacked, 0.0)
    return np.asarray(stacked.sum(axis=1))


def _each_axis(matrices: Floats, d: int) -> Floats:
    """Return (T, 2d, 2d) block matrices for d independent axes, positions first, from those of a plane's state.

    Args:
        matrices: (T, 4, 4) matrices of the state (x, y, vx, vy), with equal blocks of x and y.
        d: number of axes.
    """
    one = matrices[:, ::2, ::2]
    return np.asarray(np.einsum("tij,kl->tikjl", one, np.eye(d)).reshape(len(one), 2 * d, 2 * d))
