"""Kalman filter and smoother over trajectories, and the sums that EM needs of them.

The E step of Shumway & Stoffer (1982): x_t+1 = A x_t + N(0, Sigma), position measured at
some nodes, z = C x + N(0, R), the trajectories independent and each begun with the same
vague prior.  Everything here is in units of the data: one step of time, one `scale` of length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.jit import kernel

VAGUE = 25.0
"""Variance of each entry of the first state, about the first position measured and no velocity."""


CV = np.kron(np.eye(2), np.array([[1.0, 1.0], [0.0, 1.0]]))
"""A of constant velocity."""


class Sums(NamedTuple):
    """Expectations of products, summed over transitions, given all measurements.

    They are of x_t and of d = x_t+1 - CV x_t, what constant velocity does not explain: sums of
    x_t+1 itself, which may be far from the origin, would lose d by rounding.
    """

    n: int  # transitions
    DD: Floats  # (4, 4) of d d^T
    DX: Floats  # (4, 4) of d x_t^T
    XX: Floats  # (4, 4) of x_t x_t^T
    m: int  # measurements
    E: Floats  # (2, 2) of (z - C x)(z - C x)^T


def smooth(
    first: Bools, seen: Bools, off: Floats, xy: Floats, R: Floats, A: Floats, sigma: Floats
) -> tuple[float, Sums, Floats, Floats]:
    """Log-likelihood, the sums, and (K, 4) means and (K, 4, 4) covariances of the states.

    Args:
        first: (K,) a trajectory begins; true at 0, and every such node is seen.
        seen: (K,) there is a measurement.
        off: (K,) its time after the node, in steps.
        xy: (K, 2) the measurements.
        R: (K, 2, 2) covariances of their errors, positive definite where seen.
        A: (4, 4).
        sigma: (4, 4), positive definite.
    """
    log_likelihood, mean, cov, before, before_cov = _filter(
        first=first, seen=seen, off=off, xy=xy, R=R, A=A, sigma=sigma
    )
    n, DD, DX, XX, m, E = _smooth(
        first=first, seen=seen, off=off, xy=xy, mean=mean, cov=cov, before=before, before_cov=before_cov, A=A, F=CV
    )
    return log_likelihood, Sums(n, DD, DX, XX, m, E), mean, cov


@kernel
def _look(off: float) -> Floats:
    """C of a measurement that is `off` steps after its node."""
    C = np.zeros((2, 4))
    C[0, 0] = C[1, 2] = 1.0
    C[0, 1] = C[1, 3] = off
    return C


@kernel
def _filter(
    first: Bools, seen: Bools, off: Floats, xy: Floats, R: Floats, A: Floats, sigma: Floats
) -> tuple[float, Floats, Floats, Floats, Floats]:
    K = first.shape[0]
    mean, cov = np.empty((K, 4)), np.empty((K, 4, 4))
    before, before_cov = np.empty((K, 4)), np.empty((K, 4, 4))
    total, At, one = 0.0, np.ascontiguousarray(A.T), np.eye(4)
    x, P = np.zeros(4), np.eye(4)
    for k in range(K):
        if first[k]:
            x, P = np.zeros(4), VAGUE * np.eye(4)
            x[0], x[2] = xy[k, 0], xy[k, 1]
        else:
            # Predict
            x = A @ x
            P = A @ P @ At + sigma
        before[k], before_cov[k] = x, P
        if seen[k]:
            # Update, in the form of Joseph, which stays positive
            C = _look(off[k])
            Ct = np.ascontiguousarray(C.T)
            V = C @ P @ Ct + R[k]
            det = V[0, 0] * V[1, 1] - V[0, 1] * V[1, 0]
            inverse = np.array([[V[1, 1], -V[0, 1]], [-V[1, 0], V[0, 0]]]) / det
            e = xy[k] - C @ x
            total -= 0.5 * (e @ inverse @ e + np.log(det)) + np.log(2.0 * np.pi)
            G = P @ Ct @ inverse
            x = x + G @ e
            F = one - G @ C
            P = F @ P @ np.ascontiguousarray(F.T) + G @ R[k] @ np.ascontiguousarray(G.T)
        P = 0.5 * (P + P.T)
        mean[k], cov[k] = x, P
    return total, mean, cov, before, before_cov


@kernel
def _smooth(
    first: Bools,
    seen: Bools,
    off: Floats,
    xy: Floats,
    mean: Floats,
    cov: Floats,
    before: Floats,
    before_cov: Floats,
    A: Floats,
    F: Floats,
) -> tuple[int, Floats, Floats, Floats, int, Floats]:
    """Rauch-Tung-Striebel, backwards; `mean` and `cov` become those given all measurements."""
    K = first.shape[0]
    DD, DX, XX, E = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((2, 2))
    Ft = np.ascontiguousarray(F.T)
    n = m = 0
    for k in range(K - 1, -1, -1):
        if k + 1 < K and not first[k + 1]:
            J = np.ascontiguousarray(np.linalg.solve(before_cov[k + 1], A @ cov[k]).T)
            late, late_cov = mean[k + 1], cov[k + 1]
            mean[k] = mean[k] + J @ (late - before[k + 1])
            P = cov[k] + J @ (late_cov - before_cov[k + 1]) @ np.ascontiguousarray(J.T)
            cov[k] = 0.5 * (P + P.T)
            d = late - F @ mean[k]
            lag = late_cov @ np.ascontiguousarray(J.T)  # covariance of x_t+1 and x_t
            both = lag @ Ft
            DD += late_cov - both - both.T + F @ cov[k] @ Ft + np.outer(d, d)
            DX += lag - F @ cov[k] + np.outer(d, mean[k])
            XX += cov[k] + np.outer(mean[k], mean[k])
            n += 1
        if seen[k]:
            C = _look(off[k])
            e = xy[k] - C @ mean[k]
            E += C @ cov[k] @ np.ascontiguousarray(C.T) + np.outer(e, e)
            m += 1
    return n, DD, DX, XX, m, E
