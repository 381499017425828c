"""Errors of the three planes' estimates, and how they go together.

Each plane's filter knows its own covariance, but not what its errors share with the others': all three began
from one prior, move by one target's acceleration, and hear one noise, whose projected angles are
correlated (`occlog.core.sight.projected_planes.projected_covariance`).  An estimate that is combined of two planes
has the covariance of the combination, for which their cross-covariance is needed.  It obeys the recursion
of Bar-Shalom (1981) for two tracks,

    P_pq = (I - K_p H_p) (F P_pq F^T + Q_pq) (I - K_q H_q)^T + K_p R_pq K_q^T,

which is run here for all planes at once: the state is the (12,) error of (a, b, va, vb) of xy, yz and zx.  After each
scan the blocks on the diagonal are set to what the particles say (`rescaled`), correlations being kept.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.bounds.in_space import plane_axes
from occlog.core.sight.projected_planes import AXES
from occlog.filtering.motion.white_acceleration import AccelerationModel

from .importance_step import drift_matrix, process_noise

PLANE_ROWS = tuple(slice(4 * p, 4 * p + 4) for p in range(3))
TO_PLANES = np.eye(6)[[k for p in range(3) for k in plane_axes(p)]]
"""(12, 6) from the state in space to those of the planes."""
LEAST = 1e-12
"""Variances below this share of the largest count as so much."""


def begun(covariance: Floats) -> Floats:
    """(12, 12) errors of planes that all begin from one estimate in space, of (6, 6) covariance."""
    return np.asarray(TO_PLANES @ covariance @ TO_PLANES.T)


def moved_errors(errors: Floats, motion: AccelerationModel, dt: float) -> Floats:
    """(12, 12) errors a time dt later; all planes have the noise of one motion."""
    F = np.kron(np.eye(3), drift_matrix(2, dt))
    return np.asarray(F @ errors @ F.T + begun(process_noise(motion, dt)))


def measured_errors(errors: Floats, places: Floats, sensor: Floats, angles: Floats, used: Bools) -> Floats:
    """(12, 12) errors after the directions of one sensor, by the gain that each plane has of its own.

    Args:
        errors: (12, 12) before.
        places: (3, 2) of the target on each plane's axes.
        sensor: (3,) its place.
        angles: (3, 3) covariance of its projected angles.
        used: (3,) the planes that took it in.
    """
    K, H = np.zeros((12, 3)), np.zeros((3, 12))
    for p in np.flatnonzero(used):
        rows = PLANE_ROWS[p]
        a, b = places[p] - sensor[list(AXES[p])]
        square = a * a + b * b
        if square > 0.0:
            h = np.array([-b, a, 0.0, 0.0]) / square
            H[p, rows] = h
            K[rows, p] = errors[rows, rows] @ h / (h @ errors[rows, rows] @ h + angles[p, p])
    kept = np.eye(12) - K @ H
    return np.asarray(kept @ errors @ kept.T + K @ angles @ K.T)


def rescaled(errors: Floats, covariances: dict[int, Floats]) -> Floats:
    """(12, 12) errors whose blocks of some planes are the given (4, 4) covariances.

    The errors of a plane are mapped by the symmetric matrix that changes Gaussians of the one covariance into those
    of the other with the least motion (Olkin and Pukelsheim 1982), so that correlations are changed as little.
    """
    T = np.eye(12)
    for p, covariance in covariances.items():
        rows = PLANE_ROWS[p]
        root, inverse = _roots(errors[rows, rows])
        T[rows, rows] = inverse @ _roots(root @ covariance @ root)[0] @ inverse
    return np.asarray(T @ errors @ T.T)


def woken(errors: Floats, plane: int, combination: Floats) -> Floats:
    """(12, 12) errors where a plane begins from the combined estimate, which is the (6, 12) combination of planes."""
    T = np.eye(12)
    T[PLANE_ROWS[plane]] = TO_PLANES[PLANE_ROWS[plane]] @ combination
    return np.asarray(T @ errors @ T.T)


def combination_of(planes: tuple[int, int], shared: int, shares: Floats) -> Floats:
    """(6, 12) the state in space as a combination of two planes'.

    Args:
        planes: two different ones.
        shared: the axis that both have.
        shares: (2, 2) weights of the two, for position and velocity of that axis.
    """
    W = np.zeros((6, 12))
    for n, p in enumerate(planes):
        for place, k in enumerate(AXES[p]):
            for part in range(2):
                W[k + 3 * part, 4 * p + place + 2 * part] = shares[n, part] if k == shared else 1.0
    return W


def _roots(covariance: Floats) -> tuple[Floats, Floats]:
    """The symmetric root of a covariance, and its inverse."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    sd = np.sqrt(np.maximum(values, max(LEAST * values[-1], 1e-300)))
    return (vectors * sd) @ vectors.T, (vectors / sd) @ vectors.T
