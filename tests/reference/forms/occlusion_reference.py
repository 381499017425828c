"""Occlusion by people with priors ([Ercan] Secs. 4.2-4.3), written plainly with NumPy and SciPy.

It shares no code with occlog.  Tests compare the kernels with it; the benchmark `occlusion`
takes the filter step built on it (`apf_reference.step` with priors) as its baseline.
Loops run over cameras (and over subsets of them) only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

ROOT_2 = np.sqrt(2.0)


@dataclass(frozen=True)
class RefPriors:
    """Gaussian priors of M people."""

    mean: np.ndarray  # (M, 2)
    covariance: np.ndarray  # (M, 2, 2), positive definite
    diameter: float
    improved: bool = True  # the inner integral at the mean of the slab instead of at its middle
    floor: float = 1e-4
    recursion: bool = False  # Eqs. 8-9 instead of cameras that are independent of each other

    @property
    def isotropic(self) -> bool:
        c = self.covariance
        return bool(np.all(c[:, 0, 1] == 0.0) and np.all(c[:, 0, 0] == c[:, 1, 1]))


def hiding(xy, camera, priors):
    """(L, M) q of Eq. 7."""
    d = xy - camera
    r = np.hypot(d[:, 0], d[:, 1])
    u = d / r[:, None]
    v = np.column_stack([-u[:, 1], u[:, 0]])
    mu = priors.mean - camera
    a, b = u @ mu.T, v @ mu.T
    if priors.isotropic:
        s = along = np.sqrt(priors.covariance[:, 0, 0])
        middle = a
    else:
        s2 = np.einsum("li,mij,lj->lm", v, priors.covariance, v)
        s, rho = np.sqrt(s2), np.einsum("li,mij,lj->lm", u, priors.covariance, v) / s2
        along = np.sqrt(np.linalg.det(priors.covariance) / s2)
        middle = a + rho * offset(b, s, priors)
    half = 0.5 * priors.diameter
    across = 0.5 * (erf((half - b) / (ROOT_2 * s)) + erf((half + b) / (ROOT_2 * s)))
    return across * 0.5 * (erf((r[:, None] - middle) / (ROOT_2 * along)) + erf(middle / (ROOT_2 * along)))


def offset(b, s, priors):
    """Where across the sight line, from the prior's mean, the inner integral is taken."""
    half = 0.5 * priors.diameter
    if not priors.improved:
        return -b
    low, high = (-half - b) / s, (half - b) / s
    mass = 0.5 * (erf(high / ROOT_2) - erf(low / ROOT_2))
    density = (np.exp(-0.5 * low**2) - np.exp(-0.5 * high**2)) / np.sqrt(2 * np.pi)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(mass > 0, s * density / mass, -b)
    return np.clip(mean, -half - b, half - b)


def clear(xy, camera, priors):
    """(L,) probability that no one hides the places from a camera."""
    return np.prod(1.0 - hiding(xy, camera, priors), axis=1)


def patterns_disjoint(q):
    """(L, 2^N) p(eta | u) of Eqs. 8-9 from q (L, N, M); bit i of the column is eta_i."""
    L, N, _ = q.shape
    together = np.empty((L, 1 << N))  # all cameras of Q see the place
    for Q in range(1 << N):
        blocked = q[:, [i for i in range(N) if Q >> i & 1]].sum(axis=1)
        together[:, Q] = np.prod(np.maximum(1.0 - blocked, 0.0), axis=1)
    return from_together(together, N)


def from_together(together, N):
    """p(eta) of exactly these cameras, from p_Q of at least these: Eq. 9 one camera at a time."""
    out = together.copy()
    for i in range(N):
        for Q in range(1 << N):
            if not Q >> i & 1:
                out[:, Q] -= out[:, Q | 1 << i]
    return out


def mixture(a, b, patterns):
    """(L,) sum over eta of p(eta) prod_seen a prod_hidden b; a (L, N), b (N,), patterns (L, 2^N)."""
    N = a.shape[1]
    total = np.zeros(len(a))
    for eta in range(1 << N):
        seen = np.array([bool(eta >> i & 1) for i in range(N)])
        total += patterns[:, eta] * np.prod(np.where(seen, a, b), axis=1)
    return total


def independent(a, b, assigned, share, floor):
    """(L,) likelihoods with cameras independent of each other.

    a (L, N) are factors of cameras that no one hides, b (N,) of those that are hidden, and
    share (L, N) the probabilities of the former; cameras that are not `assigned` (L, N) have factor a.
    """
    mixed = np.maximum(share, floor) * a + np.maximum(1.0 - share, floor) * b
    return np.prod(np.where(assigned, mixed, a), axis=1)


def over_patterns(a, b, assigned, chances, floor):
    """(L,) likelihoods by the sum over who sees the place, place by place with the same cameras in view.

    `chances(rows, cameras)` gives p(eta | u) of all patterns (rows, 2^cameras); see `independent`.
    """
    out = np.prod(np.where(assigned, 1.0, a), axis=1)
    for key in np.unique(assigned, axis=0):
        use = np.flatnonzero(key)
        if len(use) == 0:
            continue
        rows = np.flatnonzero((assigned == key).all(axis=1))
        some = a[np.ix_(rows, use)]
        sums = mixture(some, b[use], chances(rows, use))
        out[rows] *= np.maximum(sums, floor * np.prod(np.maximum(some, b[use]), axis=1))
    return out


def among(xy, cameras, a, b, assigned, priors):
    """(L,) likelihoods among people with priors, by the form that they ask for; cameras (N, 2)."""
    if not priors.recursion:
        share = np.column_stack([clear(xy, camera, priors) for camera in cameras])
        return independent(a, b, assigned, share, priors.floor)
    q = np.stack([hiding(xy, camera, priors) for camera in cameras], axis=1)
    return over_patterns(a, b, assigned, lambda rows, use: patterns_disjoint(q[np.ix_(rows, use)]), priors.floor)
