"""A position that cameras found as a measurement of particles, and the variance that two cameras would give it.

[Lee] Sec. 3.2.2 puts the position found in the place of the estimate's and keeps the velocity;
`moved_to` does so with the particles.  `updated` takes the position for a measurement: a particle's
position and velocity follow as far as the cloud's covariance says that they go together.

States are [x, vx, y, vy].
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

PLACE = (0, 2)
"""Rows of the position in a state."""


def moved_to(states: Floats, place: Floats, covariance: Floats, normals: Floats) -> Floats:
    """(L, 4) states at positions drawn about the place, with their velocities as they were.

    Args:
        states: (L, 4).
        place: (2,) that cameras found.
        covariance: (2, 2) of it, positive semi-definite.
        normals: (L, 2) standard normal draws.
    """
    out = states.copy()
    out[:, PLACE] = place + normals @ root(covariance).T
    return out


def updated(states: Floats, place: Floats, covariance: Floats, normals: Floats) -> Floats:
    """(L, 4) states after the position was measured: each particle is moved by the gain of the cloud's covariance.

    This is the ensemble form of the Kalman filter: every particle has a measurement of its
    own, drawn about the place.  The cloud's mean and covariance become those of the Kalman
    filter, up to the chance of the draws.  A cloud without extent stays where it is.

    Arguments as for `moved_to`.
    """
    P = np.cov(states.T, bias=True)
    S = P[np.ix_(PLACE, PLACE)] + covariance
    # The pseudo-inverse, as cameras may be exact and the cloud may be a point.
    gain = P[:, PLACE] @ np.linalg.pinv(S, hermitian=True)
    # Draws without mean: the ensemble's mean is then the Kalman filter's.
    noise = (normals - normals.mean(axis=0)) @ root(covariance).T
    return np.asarray(states + (place + noise - states[:, PLACE]) @ gain.T)


def root(covariance: Floats) -> Floats:
    """(2, 2) symmetric root of a covariance; what is below zero by rounding counts as zero."""
    values, axes = np.linalg.eigh(covariance)
    return np.asarray((axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)


def expected_variance(place: Floats, origins: Floats, sigmas: Floats) -> float:
    """Trace of the covariance with which two sight lines would tell a place; inf where they do not cross.

    Args:
        place: (2,).
        origins: (2, 2) of the two cameras.
        sigmas: (2,) of their bearings [rad], > 0.
    """
    away = place - origins
    r2 = np.maximum((away**2).sum(axis=1), 1e-300)
    g = np.column_stack([-away[:, 1], away[:, 0]]) / (r2 * sigmas)[:, None]
    information = g.T @ g
    det = float(np.linalg.det(information))
    trace = float(np.trace(information))
    return trace / det if det > 1e-12 * trace * trace else float("inf")
