"""How far the place that boxes show is from where a smooth walk leads: Student's t, its scale learned.

People sway, bend, start and stop; cameras are calibrated not quite alike.  The place is therefore that of the walk
plus e, which has a Student's t distribution with `NU` degrees of freedom: given a weight w it is normal with the
variance s^2 / w in each axis.  The weights and s^2 are found by expectation maximisation (Lange, Little and Taylor
1989, Eqs. 4 and 5) with the walk as it follows from all other places.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats

NU = 3.0
FIRST = 0.03
"""s at first [m]."""
MOST = 0.2
"""s at most [m]."""
LEAST = 1e-3
"""s at least [m]."""
ENOUGH = 50
"""With fewer places the scale stays as it is."""
STEPS = 5


def scatter(J: Floats, h: Floats, mean: Floats, covariance: Floats, scale: float, metre: float) -> tuple[Floats, float]:
    """Variances (n,) of the places about the walk, per axis, and their scale s^2 anew.

    Args:
        J: (n, 6, 6) information of each place.
        h: (n, 6) its vector.
        mean: (n, 6) the walk at the same moments, without the place.
        covariance: (n, 6, 6) of the same.
        scale: s^2 before.
        metre: in the scene's unit.
    """
    if not len(J):
        return np.zeros(0), scale
    # The place by its boxes alone, its body being the walk's
    A, v = J.copy(), h.copy()
    for k in range(2, 6):
        weight = 1.0 / covariance[:, k, k]
        A[:, k, k] += weight
        v[:, k] += weight * mean[:, k]
    for k in range(2):
        A[:, k, k] += 1e-6 / metre**2
        v[:, k] += 1e-6 / metre**2 * mean[:, k]
    C = np.linalg.inv(A)
    off = (np.einsum("nij,nj->ni", C, v) - mean)[:, :2]
    S = C[:, :2, :2] + covariance[:, :2, :2]
    own = np.full(len(J), scale)
    one = np.eye(2)
    for _ in range(STEPS):
        # Expectation of e' e, and of the weight
        gain = own[:, None, None] * np.linalg.inv(S + own[:, None, None] * one)
        e = np.einsum("nij,nj->ni", gain, off)
        square = (e**2).sum(axis=1) + own * (2.0 - np.trace(gain, axis1=1, axis2=2))
        weight = (NU + 2.0) / (NU + square / scale)
        # Maximisation
        if len(J) >= ENOUGH:
            scale = float(np.clip(0.5 * np.mean(weight * square), (LEAST * metre) ** 2, (MOST * metre) ** 2))
        own = scale / weight
    return own, scale
