"""Gaussian filtering: prediction, update by linear measurements, Rauch-Tung-Striebel smoother."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

MIN_RELATIVE_VARIANCE = 1e-13
"""Smallest variance of a measurement as a share of its predicted variance: less is lost in rounding their sum."""


class Gaussian(NamedTuple):
    """Mean and covariance of a state, in the plane x, y, vx, vy."""

    mean: Floats  # (n,)
    covariance: Floats  # (n, n)


class PosteriorRecord(NamedTuple):
    """Posterior of a filter after a scan, with the time since the record before [s], for the backward pass.

    `begun`: the filter was initiated by this scan, so that earlier records do not count.
    """

    after: Gaussian
    dt: float  # since the link before [s]
    begun: bool  # initiated by this scan: what was known before does not count


Transition = Callable[[float], tuple[Floats, Floats]]
"""(n, n) matrices F and Q of a linear motion over a time [s]."""


def symmetric(matrix: Floats) -> Floats:
    """Return the mean of matrices (..., n, n) and their transposes, to remove the asymmetry of rounding."""
    return 0.5 * (matrix + matrix.swapaxes(-1, -2))


def predicted(state: Gaussian, F: Floats, Q: Floats) -> Gaussian:
    """Return a Gaussian state after a linear motion: mean F x, covariance F P F^T + Q.

    Args:
        state: Gaussian before.
        F: (n, n) transition matrix.
        Q: (n, n) covariance of the process noise.
    """
    return Gaussian(F @ state.mean, F @ state.covariance @ F.T + Q)


def updated(state: Gaussian, H: Floats, innovation: Floats, R: Floats) -> tuple[Gaussian, float]:
    """Return a Gaussian state after linear measurements with independent noise (Joseph form), and their log-likelihood.

    Args:
        state: the prediction.
        H: (m, n) derivatives of the measurements.
        innovation: (m,) measurements minus what the prediction expects.
        R: (m,) variances.
    """
    expected_spread = H @ state.covariance @ H.T
    R = np.maximum(R, MIN_RELATIVE_VARIANCE * np.diagonal(expected_spread))
    S = expected_spread + np.diag(R)
    K = np.linalg.solve(S, H @ state.covariance).T
    left = np.eye(len(state.mean)) - K @ H
    covariance = left @ state.covariance @ left.T + (K * R) @ K.T
    return Gaussian(state.mean + K @ innovation, symmetric(covariance)), log_normal(innovation, S)


def log_normal(off: Floats, S: Floats) -> float:
    """Return the log density of N(0, S) at the residuals `off` (m,), with the covariance S (m, m)."""
    _, volume = np.linalg.slogdet(S)
    return float(-0.5 * (off @ np.linalg.solve(S, off) + volume + len(off) * math.log(2.0 * math.pi)))


def rts_smooth(links: Sequence[PosteriorRecord], transition: Transition) -> list[Gaussian]:
    """Return a smoothed state for each record, by the recursion of Rauch, Tung and Striebel (1965).

    A record with `begun` separates the states before it from those after it.

    Args:
        links: filtered states of a target in the order of time, at least one.
        transition: returns transition matrix F and process noise Q for a time step [s].
    """
    out: list[Gaussian] = []
    later, ahead = links[-1].after, None
    for link in reversed(links):
        own = link.after
        if ahead is None or ahead.begun:
            later = own
        else:
            F, Q = transition(ahead.dt)
            P = F @ own.covariance @ F.T + Q
            # Gain: P_k F' (F P_k F' + Q)^-1
            G = np.linalg.solve(P, F @ own.covariance).T
            covariance = own.covariance + G @ (later.covariance - P) @ G.T
            later = Gaussian(own.mean + G @ (later.mean - F @ own.mean), symmetric(covariance))
        out.append(later)
        ahead = link
    return out[::-1]
