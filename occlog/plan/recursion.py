"""The expected error of a filter at the end of each way: a recursion of covariances for many targets at a time.

Of the motion the second moments count: those of a velocity that forgets its direction `turns` times a second, an
Ornstein-Uhlenbeck process, and of the noise of a step (`sigma`).  The best *linear* filter of a motion with these
moments is the Kalman filter of that process.  Its covariance is what is computed: of a state (x, y, vx, vy), with the
information of what is seen at every step.  A filter that knows more of the motion than its second moments may be
better; none can know where the target wants to go, as the posterior bound of `occlog evaluate` does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

BLOCK = 1_000_000
"""Places times cells that are summed at a time."""


class Motion(NamedTuple):
    """The second moments of a walk; how they are counted is in `occlog.plan.moments`."""

    speed: float  # root mean square of the velocity, per second
    turns: float  # how often a second the velocity is forgotten
    sigma: float  # noise of the place per axis, gathered in a second


def step_of(motion: Motion, dt: float) -> tuple[float, float, Floats]:
    """One step of an axis: the place gains a v, the velocity becomes b v; and the (2, 2) noise of both."""
    r, variance = motion.turns, 0.5 * motion.speed**2
    b = math.exp(-r * dt)
    a = -math.expm1(-r * dt) / r
    # Integrals of the process over a step; for short steps variance r (2/3 dt^3, dt^2, 2 dt)
    vv = variance * -math.expm1(-2.0 * r * dt)
    xv = variance * r * a * a
    xx = variance * (2.0 * (dt - a) / r - a * a) + motion.sigma**2 * dt
    return a, b, np.array([[xx, xv], [xv, vv]])


def end_covariance(information: Floats, prior: Floats, motion: Motion, dt: float) -> Floats:
    """(N, 2, 2) covariance of the place at the last step of each way; arguments as of `covariances_along`."""
    *_, last = covariances_along(information, prior, motion, dt)
    return last


def covariances_along(information: Floats, prior: Floats, motion: Motion, dt: float) -> Iterator[Floats]:
    """Covariance of the place at each step of each way.

    Args:
        information: (3, N, T) xx, xy, yy of the Fisher information of each step about the place.
        prior: (2, 2) covariance of the place where nothing was seen yet; the velocity is that of the motion.
        motion: of the target.
        dt: between steps [s].

    Yields:
        (N, 2, 2), for each of T steps.
    """
    n, steps = information.shape[1:]
    a, b, q = step_of(motion, dt)
    P = np.zeros((n, 4, 4))
    P[:, :2, :2] = prior
    P[:, 2, 2] = P[:, 3, 3] = 0.5 * motion.speed**2
    F = np.eye(4)
    F[0, 2] = F[1, 3] = a
    F[2, 2] = F[3, 3] = b
    Q = np.kron(q, np.eye(2))
    for t in range(steps):
        if t:
            P = F @ P @ F.T + Q
        P = _updated(P, *information[:, :, t])
        yield np.asarray(P[:, :2, :2])


def _updated(P: Floats, xx: Floats, xy: Floats, yy: Floats) -> Floats:
    """(N, 4, 4) covariances after information about the place: P - P_x S P_x^T, S = (1 + I P_xx)^-1 I."""
    p, q, r = P[:, 0, 0], P[:, 0, 1], P[:, 1, 1]
    # 1 + I P_xx, inverted
    m00, m01 = 1.0 + xx * p + xy * q, xx * q + xy * r
    m10, m11 = xy * p + yy * q, 1.0 + xy * q + yy * r
    det = m00 * m11 - m01 * m10
    S = np.empty((len(P), 2, 2))
    S[:, 0, 0] = (m11 * xx - m01 * xy) / det
    S[:, 0, 1] = S[:, 1, 0] = (m11 * xy - m01 * yy) / det
    S[:, 1, 1] = (m00 * yy - m10 * xy) / det
    gain = P[:, :, :2]
    return np.asarray(P - gain @ S @ gain.transpose(0, 2, 1))


def square_error_in_room(covariance: Floats, at: Floats, floor: Floats, size: Floats) -> Floats:
    """Mean square error where the filter knows that the target is on the floor: of a normal, cut off where it ends.

    Summed over cells of the floor; a normal narrower than a cell is as it is.

    Args:
        covariance: (N, 2, 2) of places, positive definite.
        at: (N, 2) their means.
        floor: (C, 2) middles of the cells of the floor.
        size: (2,) sides of a cell.

    Returns:
        (N,); never above the trace of the covariance.
    """
    out = np.trace(covariance, axis1=1, axis2=2).copy()
    wide = np.flatnonzero(out > float(size @ size) / 4.0)
    grain = np.diag(size**2 / 12.0)  # so that a normal that is thin across the cells is not lost between them
    for rows in np.array_split(wide, max(1, len(wide) * len(floor) // BLOCK)):
        off = floor - at[rows, None]
        exponent = -0.5 * np.einsum("nci,nij,ncj->nc", off, np.linalg.inv(covariance[rows] + grain), off)
        weight = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        mean = np.einsum("nc,nci->ni", weight, off)
        cut = np.einsum("nc,nci,nci->n", weight, off, off) - np.sum(mean**2, axis=1)
        out[rows] = np.minimum(out[rows], cut)
    return np.asarray(out)
