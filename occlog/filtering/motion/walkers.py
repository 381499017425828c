"""Kalman filters of objects that walk with nearly constant velocity, many at once.

The state of an object is its place and its velocity.  Over a time dt the velocity is
disturbed, in each axis and independently, with

    Q = q^2 [dt^3/4  dt^2/2]
            [dt^2/2  dt    ]

which is a constant acceleration of variance q^2 / dt over that time.  At dt = 1 this is the
q^2 [1/4 1/2; 1/2 1] of [Ercan]'s reference scene (q = 1.2); the velocity's variance grows by
q^2 in a unit of time for any dt, so that q means the same at any frame rate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.filtering.gaussian import symmetric


class Walkers(NamedTuple):
    """M objects; the covariance in blocks of two axes."""

    xy: Floats  # (M, 2)
    velocity: Floats  # (M, 2) per unit of time
    cov: Floats  # (M, 2, 2) of xy
    cross: Floats  # (M, 2, 2) of xy (rows) with velocity (columns)
    cov_velocity: Floats  # (M, 2, 2)


def first_seen(xy: Floats, noise: Floats, speed: float) -> Walkers:
    """Start objects at their first measurement, with an unknown velocity.

    Args:
        xy: (M, 2) measured places.
        noise: (M, 2, 2) covariances of the measurements.
        speed: standard deviation of the velocity, per axis.
    """
    M = len(xy)
    unknown = np.broadcast_to(speed**2 * np.eye(2), (M, 2, 2)).copy()
    return Walkers(xy.copy(), np.zeros((M, 2)), noise.copy(), np.zeros((M, 2, 2)), unknown)


def predict(walkers: Walkers, dt: Floats | float, q: float) -> Walkers:
    """Predict the objects a time later: P' = F P F^T + Q in blocks of position and velocity.

    Args:
        walkers: M objects.
        dt: (M,) or one time, >= 0.
        q: strength of the disturbance, as above; >= 0.
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
    """Update the objects by measurements of their places.

    The covariances are formed as products that stay positive semi-definite.

    Args:
        walkers: M objects.
        xy: (M, 2) measured places.
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


def take(walkers: Walkers, rows: object) -> Walkers:
    """Some of the objects: rows chosen by a mask or indices."""
    return Walkers(*(column[rows] for column in walkers))  # type: ignore[call-overload]


def join(first: Walkers, second: Walkers) -> Walkers:
    """The objects of both."""
    return Walkers(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
