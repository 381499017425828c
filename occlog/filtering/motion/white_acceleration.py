"""Motion of particles: known acceleration, turns in a plane, white acceleration ([Lee] Sec. 2.1.4).

Particles are (2d, L): d coordinates, then d velocities, for d = 3 in space and 2 in a plane. A known acceleration is an
input; the printed Eq. 2.15 divides by the velocity instead. Also Kalman filters of many objects with nearly constant
velocity. Over a time dt the velocity is disturbed, in each axis independently, with

    Q = q^2 [dt^3/4  dt^2/2]
            [dt^2/2  dt    ]

which is a constant acceleration of variance q^2 / dt over that time.  At dt = 1 this is the
q^2 [1/4 1/2; 1/2 1] of [Ercan]'s reference scene (q = 1.2); the velocity's variance grows by
q^2 in a unit of time for any dt, so that q means the same at any frame rate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import array_kernel, kernel
from occlog.filtering.gaussian import symmetric

from .coordinated_turn import _turned, acceleration_root


class AccelerationModel(NamedTuple):
    """Motion model of a target on d axes, in which three parts act together.

    They are a known acceleration, white acceleration noise, and a coordinated turn by a known lateral acceleration.
    """

    acceleration: Floats  # (d,) known [length/s^2]
    density: Floats  # (d,) of the white acceleration of each axis [length^2/s^3]
    turn: float = 0.0  # lateral acceleration [length/s^2], from the first towards the second axis if positive
    axes: tuple[int, int] = (0, 1)  # of the turn


def known_jump(acceleration: Floats, dt: float) -> Floats:
    """Return (2d,) displacement and velocity change by a known `acceleration` (d,) during `dt` [s]."""
    return np.concatenate([0.5 * dt * dt * acceleration, dt * acceleration])


def motion_noise(motion: AccelerationModel, dt: float) -> Floats:
    """Return (d, 2, 2) lower Cholesky factors of the covariance of the process noise in `dt` [s], one for each axis.

    The covariance is that of position and velocity, in this order, on the axis.
    """
    return np.sqrt(motion.density)[:, None, None] * acceleration_root(1.0, dt)


def moved(
    cloud: Floats, motion: AccelerationModel, dt: float, rng: np.random.Generator, jump: Floats | None = None
) -> Floats:
    """Return particles predicted by dt >= 0 seconds, with noise; a new array (2d, L).

    Args:
        cloud: (2d, L) particles: d coordinates, then d velocities.
        motion: motion model on d axes.
        dt: time [s].
        rng: draws the noise; nothing is drawn where the density is 0 on all axes.
        jump: (2d,) known change of the state in addition; None: none.
    """
    d = len(cloud) // 2
    known = known_jump(motion.acceleration, dt) + (0.0 if jump is None else jump)
    noisy = bool(np.any(motion.density > 0.0))
    normals = half_normals(cloud.shape[1], 2 * d, rng) if noisy else np.empty((2 * d, 0))
    out = drift(cloud, dt, known, motion_noise(motion, dt), normals)
    if motion.turn != 0.0:
        _turn(out, cloud, motion.turn, motion.axes[0], motion.axes[1], dt)
    return out


def moved_back(cloud: Floats, motion: AccelerationModel, dt: float) -> Floats:
    """Return (2d, L) states dt >= 0 seconds before those in `cloud` (2d, L), without noise.

    The inverse of `moved` with noise density 0: exact for a known acceleration or a turn; with both at once it is right
    to first order in dt.
    """
    d = len(cloud) // 2
    out = drift(cloud, -dt, known_jump(motion.acceleration, -dt), np.zeros((d, 2, 2)), np.empty((2 * d, 0)))
    if motion.turn != 0.0:
        _turn(out, cloud, motion.turn, motion.axes[0], motion.axes[1], -dt)
    return out


def half_normals(particles: int, rows: int, rng: np.random.Generator) -> Floats:
    """Return (rows, H) standard normal draws for L particles, H = ceil(L / 2), to be used as antithetic variates.

    Particle l < H takes draw l, particle H + l its negative; each particle has the right distribution. The mean of the
    noise is exactly 0 if L is even; otherwise one draw has no opposite.
    """
    return rng.standard_normal((rows, (particles + 1) // 2))


@array_kernel
def drift(cloud: Floats, dt: float, jump: Floats, root: Floats, normals: Floats) -> Floats:
    """Return (2d, L) states after a step of constant velocity, known change and noise.

    Args:
        cloud: (2d, L) particles: d coordinates, then d velocities.
        dt: time [s].
        jump: (2d,) known change, added to all.
        root: (d, 2, 2) factors from `motion_noise`.
        normals: (2d, H) draws from `half_normals`, or (2d, 0) for no noise.
    """
    d, L, H = cloud.shape[0] // 2, cloud.shape[1], normals.shape[1]
    out = np.empty_like(cloud)
    for k in range(d):
        x, v, nx, nv = cloud[k], cloud[d + k], out[k], out[d + k]
        dx, dv = jump[k], jump[d + k]
        if H == 0:
            for l in range(L):  # noqa: E741 - the papers' letter
                nx[l] = x[l] + dt * v[l] + dx
                nv[l] = v[l] + dv
            continue
        a, b, c = root[k, 0, 0], root[k, 1, 0], root[k, 1, 1]
        m, n = normals[k], normals[d + k]
        for l in range(H):  # noqa: E741
            nx[l] = x[l] + dt * v[l] + dx + a * m[l]
            nv[l] = v[l] + dv + b * m[l] + c * n[l]
        for l in range(L - H):  # noqa: E741
            nx[H + l] = x[H + l] + dt * v[H + l] + dx - a * m[l]
            nv[H + l] = v[H + l] + dv - b * m[l] - c * n[l]
    return out


@kernel
def _turn(out: Floats, before: Floats, lateral: float, i: int, j: int, dt: float) -> None:
    """Add to `out`, in place, what a coordinated turn ([Lee] Eq. 2.14) changes relative to constant velocity.

    Args:
        out: (2d, L) states after the step; changed in place.
        before: (2d, L) states before it, d positions and d velocities.
        lateral: acceleration across the velocity [length/s^2], > 0 from axis i towards axis j.
        i: first axis of the plane of the turn.
        j: second axis.
        dt: time [s].
    """
    d = before.shape[0] // 2
    for l in range(before.shape[1]):  # noqa: E741
        vi, vj = before[d + i, l], before[d + j, l]
        speed = math.sqrt(vi * vi + vj * vj)
        angle = lateral * dt / speed if speed > 0.0 else 0.0
        along, aside, cosine, sine = _turned(angle)
        out[i, l] += dt * ((along - 1.0) * vi - aside * vj)
        out[j, l] += dt * (aside * vi + (along - 1.0) * vj)
        out[d + i, l] += (cosine - 1.0) * vi - sine * vj
        out[d + j, l] += sine * vi + (cosine - 1.0) * vj


def turn_jump(velocity: Floats, lateral: float, dt: float) -> Floats:
    """Return (4,) the change of (a, b, va, vb) by a turn, relative to constant velocity.

    Args:
        velocity: (2,) va, vb before the turn.
        lateral: acceleration across the velocity [length/s^2], > 0: from a towards b.
        dt: time [s].
    """
    out, before = np.zeros((4, 1)), np.concatenate([np.zeros(2), velocity])[:, None]
    _turn(out, before, lateral, 0, 1, dt)
    return out[:, 0]


class Walkers(NamedTuple):
    """Kalman filters of M objects: positions and velocities in the plane, and covariances in three (2, 2) blocks.

    The blocks are of the position, of position (rows) with velocity (columns), and of the velocity.
    """

    xy: Floats  # (M, 2)
    velocity: Floats  # (M, 2) per unit of time
    cov: Floats  # (M, 2, 2) of xy
    cross: Floats  # (M, 2, 2) of xy (rows) with velocity (columns)
    cov_velocity: Floats  # (M, 2, 2)


def initiate(xy: Floats, noise: Floats, speed: float) -> Walkers:
    """Return objects at their first measured positions, with velocity 0 and the standard deviation `speed`.

    Args:
        xy: (M, 2) measured positions.
        noise: (M, 2, 2) covariances of the measurements.
        speed: standard deviation of the velocity per axis.
    """
    M = len(xy)
    unknown = np.broadcast_to(speed**2 * np.eye(2), (M, 2, 2)).copy()
    return Walkers(xy.copy(), np.zeros((M, 2)), noise.copy(), np.zeros((M, 2, 2)), unknown)


def predict(walkers: Walkers, dt: Floats | float, q: float) -> Walkers:
    """Return the objects a time dt later: P' = F P F^T + Q in blocks of position and velocity.

    Per axis Q = q^2 [dt^3/4 dt^2/2; dt^2/2 dt]: an acceleration that is constant during dt, with variance q^2 / dt.

    Args:
        walkers: M objects.
        dt: (M,) times or one time, >= 0.
        q: standard deviation of the change of velocity per axis in a unit of time, >= 0.
    """
    t = np.broadcast_to(np.asarray(dt, dtype=np.float64), (len(walkers.xy),))[:, None, None]
    q2 = q**2 * np.eye(2)
    cross, swapped = walkers.cross, walkers.cross.swapaxes(1, 2)
    return Walkers(
        walkers.xy + t[:, 0] * walkers.velocity,
        walkers.velocity,
        walkers.cov + t * (cross + swapped) + t**2 * walkers.cov_velocity + 0.25 * t**3 * q2,
        cross + t * walkers.cov_velocity + 0.5 * t**2 * q2,
        walkers.cov_velocity + t * q2,
    )


def update(walkers: Walkers, xy: Floats, noise: Floats) -> Walkers:
    """Return the objects after position measurements (Kalman update).

    Covariances are computed as products that stay positive semidefinite.

    Args:
        walkers: M objects.
        xy: (M, 2) measured positions.
        noise: (M, 2, 2) covariances of the measurements, positive definite.
    """
    # Gains of position and velocity: K = P H^T (H P H^T + R)^-1
    inverse = np.linalg.inv(walkers.cov + noise)
    gain = walkers.cov @ inverse
    gain_velocity = walkers.cross.swapaxes(1, 2) @ inverse
    off = (xy - walkers.xy)[:, :, None]
    # Update by the innovation; (I - K) P = K R for the position
    return Walkers(
        walkers.xy + (gain @ off)[:, :, 0],
        walkers.velocity + (gain_velocity @ off)[:, :, 0],
        symmetric(gain @ noise),
        noise @ inverse @ walkers.cross,
        symmetric(walkers.cov_velocity - gain_velocity @ walkers.cross),
    )


def select(walkers: Walkers, rows: object) -> Walkers:
    """Return the objects selected by a mask or by indices `rows`; these are not changed."""
    return Walkers(*(column[rows] for column in walkers))  # type: ignore[call-overload]


def concat(first: Walkers, second: Walkers) -> Walkers:
    """Return the objects of `first` and `second` as one set, in this order."""
    return Walkers(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
