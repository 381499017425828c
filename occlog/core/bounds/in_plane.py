"""Posterior Cramér-Rao bound of a moving target: the least error covariance of any filter, or of any smoother.

The bound has three parts:

* Fisher information of one measurement about the position, one function for each kind
  of sensor (`camera_information`, `bearing_information`), all by `gaussian_information`;
* a motion model as transition and noise matrices for each step (`known_drift_steps`,
  `constant_velocity_steps`), for steps of any length;
* the recursion over time, for states of any dimension: forwards for filters (`posterior_bound`), forwards
  and backwards for smoothers, which know the future (`smoothing_bound`).

The information is meant at the *true* position.  Averaged over many true paths the
recursion gives the posterior bound of Tichavsky, Muravchik and Nehorai (1998); along one
path it is that bound with the expectation replaced by its one sample.
Which sensors saw the target is taken as given: the information of "not seen" about the
position is not counted.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.geometry.camera import noise_variance, planar_offsets
from occlog.core.numerics.jit import kernel

MAX_INFORMATION_RATIO = 1e10
"""A sum of 1 and more than this has too few digits of the 1 left."""


def gaussian_information(mean_gradient: Floats, variance: Floats, variance_gradient: Floats) -> Floats:
    """Return the Fisher information of scalar measurements z ~ N(m(x), v(x)) about the state x.

    I = grad m grad m^T / v + 1/2 grad v grad v^T / v^2.  The second term states that the
    scatter of z informs about x too where the noise depends on the position.

    Args:
        mean_gradient: (N, n) gradient of the mean.
        variance: (N,) variance, > 0.
        variance_gradient: (N, n) gradient of the variance.

    Returns:
        (N, n, n) information matrices of rank 1 or 2.
    """
    m = mean_gradient / np.sqrt(variance)[:, None]
    v = variance_gradient / (np.sqrt(2.0) * variance)[:, None]
    return np.asarray(m[:, :, None] * m[:, None, :] + v[:, :, None] * v[:, None, :])


def camera_information(
    xy: Floats,
    position: Floats,
    yaw: float,
    focal_px: float,
    sigma_position: float,
    sigma_yaw: float,
    sigma_read_px: Floats,
) -> Floats:
    """Return the Fisher information of a camera's measurement z = f h/d + v about the position, [Ercan] Eq. 1 and 2.

    h is the offset of the target to the left of the optical axis, d its distance along the axis, f the focal length.
    The variance of v depends on the position.

    Args:
        xy: (N, 2) true positions.
        position: (2,) camera centre on the ground.
        yaw: azimuth of the optical axis [rad].
        focal_px: focal length [px].
        sigma_position: standard deviation of the camera's position, in the unit of xy.
        sigma_yaw: standard deviation of the yaw [rad].
        sigma_read_px: (N,) standard deviation of the reading [px].

    Returns:
        (N, 2, 2); zero where the position is not in front of the camera (d <= 0), since such
        a reading cannot come from there.
    """
    h, d = planar_offsets(xy, position, yaw)
    front = d > 0
    h, d = np.where(front, h, 0.0), np.where(front, d, 1.0)
    c, s = np.cos(yaw), np.sin(yaw)
    grad_h, grad_d = np.array([-s, c]), np.array([c, s])
    rho = h / d
    # grad(h/d) = (grad h - (h/d) grad d) / d
    grad_rho = (grad_h - rho[:, None] * grad_d) / d[:, None]
    variance = noise_variance(h, d, focal_px, sigma_position, sigma_yaw, sigma_read_px)
    by_rho = 4.0 * (1.0 + rho**2) * rho * sigma_yaw**2 + 2.0 * rho / d**2 * sigma_position**2
    by_d = -2.0 * (1.0 + rho**2) / d**3 * sigma_position**2
    grad_variance = focal_px**2 * (by_rho[:, None] * grad_rho + by_d[:, None] * grad_d)
    information = gaussian_information(focal_px * grad_rho, variance, grad_variance)
    return np.asarray(np.where(front[:, None, None], information, 0.0))


def bearing_information(xy: Floats, position: Floats, sigma: Floats) -> Floats:
    """Return the Fisher information of an azimuth about the position, for noise that does not depend on the position.

    Args:
        xy: (N, 2) true positions.
        position: (2,) sensor position on the ground.
        sigma: (N,) standard deviation of the azimuth [rad].

    Returns:
        (N, 2, 2); zero at the sensor itself, where an azimuth means nothing.
    """
    delta = xy - position
    r2 = np.sum(delta**2, axis=1)
    away = r2 > 0
    gradient = np.column_stack([-delta[:, 1], delta[:, 0]]) / np.where(away, r2, 1.0)[:, None]
    information = gaussian_information(gradient, sigma**2, np.zeros_like(gradient))
    return np.asarray(np.where(away[:, None, None], information, 0.0))


def known_drift_steps(dt: Floats, sigma_v: float, dimension: int = 2) -> tuple[Floats, Floats]:
    """Return transitions F = I and noise Q = sigma_v^2 dt I of the motion x' = x + drift + v with known drift.

    This is the random-waypoint walker of [Ercan] Eq. 5 with an intended displacement in each step
    known.  A filter has to infer destination and speed, so the bound is below what any filter reaches.

    Args:
        dt: (T,) lengths of the steps [s], >= 0.
        sigma_v: standard deviation of the noise after 1 s, per axis.
        dimension: number of coordinates of the position.

    Returns:
        F and Q, both (T, dimension, dimension).
    """
    eye = np.eye(dimension)
    return np.broadcast_to(eye, (len(dt), dimension, dimension)).copy(), sigma_v**2 * dt[:, None, None] * eye


def constant_velocity_steps(dt: Floats, acceleration_density: float) -> tuple[Floats, Floats]:
    """Return transitions and noise of the constant-velocity model with white acceleration noise.

    Per axis F = [1 dt; 0 1] and Q = q [dt^3/3 dt^2/2; dt^2/2 dt].

    Args:
        dt: (T,) lengths of the steps [s], >= 0.
        acceleration_density: q, power spectral density of the acceleration [length^2/s^3].

    Returns:
        F and Q, both (T, 4, 4), for the state (x, y, vx, vy).
    """
    F = np.broadcast_to(np.eye(4), (len(dt), 4, 4)).copy()
    Q = np.zeros((len(dt), 4, 4))
    for axis in (0, 1):
        position, velocity = axis, axis + 2
        F[:, position, velocity] = dt
        Q[:, position, position] = acceleration_density * dt**3 / 3.0
        Q[:, position, velocity] = Q[:, velocity, position] = acceleration_density * dt**2 / 2.0
        Q[:, velocity, velocity] = acceleration_density * dt
    return F, Q


def posterior_bound(information: Floats, F: Floats, Q: Floats, P0: Floats) -> Floats:
    """Return the posterior Cramér-Rao bound of the error covariance of any filter, at each step.

    The recursion of Tichavsky et al. (1998), J' = D22 - D21 (J + D11)^-1 D12 + I' with
    D11 = F^T Q^-1 F, D12 = D21^T = -F^T Q^-1, D22 = Q^-1.  By the matrix inversion lemma
    J' = (F J^-1 F^T + Q)^-1 + I', which needs no Q^-1, so steps of zero length and
    states that do not move are allowed.

    Args:
        information: (T, n, n) Fisher information of all measurements of a step.
        F: (T, n, n) transition into each step; `F[0]` leads from the prior to the first step.
        Q: (T, n, n) covariance of the motion noise of that transition.
        P0: (n, n) covariance of the prior.

    Returns:
        (T, n, n) bounds J^-1.
    """
    contiguous = (np.ascontiguousarray(a, dtype=np.float64) for a in (information, F, Q, P0))
    return np.asarray(_recursion(*contiguous))


@kernel
def inverse_of_sum(A: Floats, J: Floats) -> Floats:
    """Return (A^-1 + J)^-1 of (n, n) positive semi-definite matrices, either of which may be singular.

    Computed as (1 + A J)^-1 A. If A is so large that the 1 is lost by rounding (as after a gap of years), A is reduced:
    the result hardly depends on it then, and a smaller lower bound is still valid.

    Args:
        A: a covariance, or any other positive semi-definite matrix.
        J: the information that is added to A^-1.
    """
    less = np.ones(A.shape[0])
    for i in range(A.shape[0]):
        if A[i, i] * J[i, i] > MAX_INFORMATION_RATIO:
            less[i] = math.sqrt(MAX_INFORMATION_RATIO / A[i, i] / J[i, i])
    A = A * np.outer(less, less)
    return np.asarray(np.linalg.solve(np.eye(A.shape[0]) + A @ J, A))


@kernel
def _recursion(information: Floats, F: Floats, Q: Floats, P0: Floats) -> Floats:
    """Return the (T, n, n) filtering bounds of the error covariance; the kernel of `posterior_bound`.

    Args:
        information: (T, n, n) Fisher information of all measurements of a step, contiguous like the others.
        F: (T, n, n) transition into each step.
        Q: (T, n, n) covariance of the motion noise of that transition.
        P0: (n, n) covariance of the prior.
    """
    bounds = np.empty_like(information)
    P = P0
    for k in range(information.shape[0]):
        M = F[k] @ P @ F[k].T + Q[k]  # predicted covariance
        P = inverse_of_sum(M, information[k])
        P = 0.5 * (P + P.T)
        bounds[k] = P
    return bounds


def smoothing_bound(information: Floats, F: Floats, Q: Floats, P0: Floats) -> Floats:
    """Return the Cramér-Rao bound of the error covariance of any smoother (which uses all T steps), at each step.

    These are the diagonal blocks of the inverse of the information matrix of the whole trajectory (Tichavsky et al.
    1998, Sec. II), by a forward and a backward recursion. The information of the steps after k about the state at k is
    B_k = F^T (Y^-1 + Q)^-1 F, with Y = I' + B' of the step after it; B_T = 0. With the bound P of filtering the bound
    of smoothing is (P^-1 + B)^-1. Neither Q nor P has to be regular.

    Args:
        information: (T, n, n) Fisher information of all measurements of a step.
        F: (T, n, n) transition into each step; `F[0]` leads from the prior to the first step.
        Q: (T, n, n) covariance of the motion noise of that transition.
        P0: (n, n) covariance of the prior.

    Returns:
        (T, n, n); never above the bounds of filtering (`posterior_bound`), and equal to them at the last step.
    """
    return smoothing_bound_before(posterior_bound(information, F, Q, P0), information, F, Q, np.zeros_like(P0))[0]


def smoothing_bound_before(
    bounds: Floats, information: Floats, F: Floats, Q: Floats, later: Floats
) -> tuple[Floats, Floats]:
    """Return the smoothing bound of a part of a trajectory, given the information of the steps after the part.

    A long trajectory is processed from its last part to its first: the second result for a part is `later` of the part
    before it.

    Args:
        bounds: (T, n, n) filtering bounds of the T steps of the part (`posterior_bound`).
        information: (T, n, n) Fisher information of all measurements of a step.
        F: (T, n, n) transition into each step.
        Q: (T, n, n) covariance of the motion noise of that transition.
        later: (n, n) information of the steps after the part about the state at its last step; 0 if there are none.

    Returns:
        (T, n, n) smoothing bounds, and (n, n) information of the part and all later steps about the state before its
        first step.
    """
    parts = (np.ascontiguousarray(a, dtype=np.float64) for a in (bounds, information, F, Q, later))
    smoothed, before = _backwards(*parts)
    return np.asarray(smoothed), np.asarray(before)


@kernel
def _backwards(bounds: Floats, information: Floats, F: Floats, Q: Floats, later: Floats) -> tuple[Floats, Floats]:
    """Return (T, n, n) smoothing bounds and the (n, n) information before the first step, by a backward recursion.

    The kernel of `smoothing_bound_before`; all arrays are contiguous.

    Args:
        bounds: (T, n, n) filtering bounds.
        information: (T, n, n) Fisher information of all measurements of a step.
        F: (T, n, n) transition into each step.
        Q: (T, n, n) covariance of the motion noise of that transition.
        later: (n, n) information of later steps about the state at the last step.
    """
    smoothed = np.empty_like(bounds)
    B = later
    for k in range(bounds.shape[0] - 1, -1, -1):
        # Combine past and future: (P^-1 + B)^-1
        P = inverse_of_sum(bounds[k], B)
        smoothed[k] = 0.5 * (P + P.T)
        # Pass the information back: (Y^-1 + Q)^-1 = (1 + Y Q)^-1 Y
        Y = information[k] + B
        Z = inverse_of_sum(Y, Q[k])
        B = F[k].T @ (0.5 * (Z + Z.T)) @ F[k]
    return smoothed, B


def polygon_covariance(polygon: Floats) -> Floats:
    """Return the (2, 2) covariance of a point that is uniformly distributed in a simple polygon (K, 2).

    The polygon may have either orientation.
    """
    a = polygon - polygon.mean(axis=0)  # near the origin, so that no digits cancel
    b = np.roll(a, -1, axis=0)
    cross = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
    area = cross.sum() / 2.0
    centroid = cross @ (a + b) / (6.0 * area)
    # Second moments of the triangles (origin, a, b): cross/24 (aa + bb + (a+b)(a+b)^T)
    outer = np.einsum("ki,kj->kij", a, a) + np.einsum("ki,kj->kij", b, b)
    outer += np.einsum("ki,kj->kij", a + b, a + b)
    second = np.einsum("k,kij->ij", cross, outer) / (24.0 * area)
    return np.asarray(second - np.outer(centroid, centroid))
