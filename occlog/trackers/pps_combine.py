"""Two planes' estimates as one in space ([Lee] Sec. 2.2.1, Eqs. 2.17-2.21 and 2.26)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..columns import Floats
from ..core.planes import AXES


class Flat(NamedTuple):
    """What the filter of a plane knows."""

    mean: Floats  # (4,) a, b, va, vb
    covariance: Floats  # (4, 4)
    log_evidence: float  # of the scan: log of the sum of the unnormalised weights
    ess: float


class Joined(NamedTuple):
    """What two planes know of the target in space."""

    mean: Floats  # (6,) x, y, z, vx, vy, vz
    axis: Floats  # (3, 2, 2) covariance of position and velocity on each axis
    covariance: Floats  # (3, 3) of the position


def shared_axis(p: int, q: int) -> int:
    """The axis that two different planes have in common."""
    return next(k for k in AXES[p] if k in AXES[q])


def combine(planes: tuple[int, int], flat: tuple[Flat, Flat], rule: str) -> Joined:
    """The state in space from two planes.

    The axis that both have is a weighted mean.  Both planes have seen the same noise and
    started from the same prior, so that their errors are taken as fully correlated: its standard
    deviation is the weighted mean of the two.  Correlations between axes are those of the
    plane that has both; between the two axes that no used plane has together it is the product of
    their correlations with the common one, as if they were independent given that one.

    Args:
        planes: two different ones.
        flat: what they know.
        rule: `inverse` weighs position and velocity by inverse variance, `planes-weighted` by the sums of the
            unnormalised weights (Eq. 2.19), `equal` evenly (Eq. 2.21).
    """
    k = shared_axis(*planes)
    mean, axis = np.zeros(6), np.zeros((3, 2, 2))
    rows = [[AXES[p].index(k), AXES[p].index(k) + 2] for p in planes]
    shares = _shares(flat, rows, rule)
    for p, f in zip(planes, flat, strict=True):
        for place, i in enumerate(AXES[p]):
            mean[[i, i + 3]] = f.mean[[place, place + 2]]
            axis[i] = f.covariance[np.ix_([place, place + 2], [place, place + 2])]
    mean[[k, k + 3]] = sum(w * f.mean[r] for w, f, r in zip(shares, flat, rows, strict=True))
    axis[k] = _shared_covariance(shares, [f.covariance[np.ix_(r, r)] for f, r in zip(flat, rows, strict=True)])
    return Joined(mean, axis, _position_covariance(planes, flat, axis))


def _shares(flat: tuple[Flat, Flat], rows: list[list[int]], rule: str) -> Floats:
    """(2, 2) weights of the two planes, for position and velocity of the common axis."""
    if rule == "equal":
        return np.full((2, 2), 0.5)
    if rule == "planes-weighted":
        gap = flat[1].log_evidence - flat[0].log_evidence
        first = 1.0 / (1.0 + math.exp(min(gap, 700.0))) if math.isfinite(gap) else 0.5
        return np.array([[first, first], [1.0 - first, 1.0 - first]])
    precision = np.array([1.0 / np.maximum(np.diag(f.covariance)[r], 1e-300) for f, r in zip(flat, rows, strict=True)])
    return np.asarray(precision / precision.sum(axis=0))


def _shared_covariance(shares: Floats, own: list[Floats]) -> Floats:
    """(2, 2) of position and velocity of the common axis."""
    sd = sum(w * np.sqrt(np.diag(c)) for w, c in zip(shares, own, strict=True))
    correlation = sum(float(w[0]) * _correlation(c, 0, 1) for w, c in zip(shares, own, strict=True))
    return np.asarray(np.outer(sd, sd) * np.array([[1.0, correlation], [correlation, 1.0]]))


def _position_covariance(planes: tuple[int, int], flat: tuple[Flat, Flat], axis: Floats) -> Floats:
    """(3, 3), positive semidefinite."""
    k = shared_axis(*planes)
    with_shared = np.ones(3)
    for p, f in zip(planes, flat, strict=True):
        with_shared[next(i for i in AXES[p] if i != k)] = _correlation(f.covariance, 0, 1)
    correlation = np.outer(with_shared, with_shared)
    np.fill_diagonal(correlation, 1.0)
    sd = np.sqrt(axis[:, 0, 0])
    return np.asarray(np.outer(sd, sd) * correlation)


def _correlation(covariance: Floats, i: int, j: int) -> float:
    scale = math.sqrt(covariance[i, i] * covariance[j, j])
    return float(np.clip(covariance[i, j] / scale, -1.0, 1.0)) if scale > 0 else 0.0
