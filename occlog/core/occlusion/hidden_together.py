"""Joint likelihood of what several cameras report: sums over subsets of cameras, [Ercan] Eqs. 8-9 and exact.

Eq. 8 takes the rectangles in which an occluder hides a place from different cameras as
disjoint.  The exact form does not: it computes, for every occluder, the probability that it blocks
each set of cameras at once (`blocking_shares`).
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import array_kernel

from .blocking_shares import shares
from .hidden import hiding_all
from .hidden_disjoint import sum_disjoint, that_matter
from .priors import Priors

MOST = 16
"""Cameras in view of one place; there are 2^16 subsets of them."""


@array_kernel
def add_joint(
    total: Floats,
    xy: Floats,
    sensor: Ints,
    a: Floats,
    b: Floats,
    assigned: Bools,
    places: Floats,
    priors: Priors,
    exact: bool,
    form: int,
    floor: float,
    far: float,
) -> None:
    """Add the log of the sum over subsets of cameras to `total` (L,), in place.

    See `occlog.core.filter.likelihood_occluded`.

    Args:
        total: (L,) log-likelihoods.
        xy: (L, 2) places.
        sensor: (n,) sensors of the looks.
        a: (n, L) factors where no occluder hides the place.
        b: (n,) factors where one does.
        assigned: (n, L) looks that count for a place; at most `MOST` of them.
        places: (S, 2) positions of the sensors.
        priors: of the occluders.
        exact: without the assumption of Eq. 8.
        form: of q, if not exact.
        floor: least value, relative.
        far: standard deviations at which a prior counts as over, if not exact.
    """
    n, L, M = a.shape[0], xy.shape[0], priors.sigma.shape[0]
    q = np.zeros((n, 1 if exact else M, L))
    rows = np.arange(L)
    for k in range(n):
        if not exact:
            q[k] = hiding_all(xy, rows, places[sensor[k], 0], places[sensor[k], 1], priors, form, far)
    for p in range(L):
        use = np.flatnonzero(assigned[:, p])
        if use.shape[0] == 0 or total[p] == -np.inf:
            continue
        if use.shape[0] > MOST:
            raise ValueError("too many cameras see a place for sums over their subsets; use likelihood=independent")
        if exact:
            # p_Q without the assumption of Eq. 8, then the sum over all Q
            seen = clear_exact(xy[p, 0], xy[p, 1], places[sensor[use]], priors)
            total[p] += math.log(over_subsets(seen, a[:, p][use], b[use], floor))
        else:
            # p_Q by Eq. 8, the sum by the recursion of Eq. 9
            total[p] += math.log(sum_disjoint(that_matter(q, p, use), a[:, p][use], b[use], floor))


@array_kernel
def clear_exact(x: float, y: float, cameras: Floats, priors: Priors) -> Floats:
    """(2^m,) probability that no camera of Q (as bits) is blocked, for every subset Q of the (m, 2) cameras."""
    m = cameras.shape[0]
    out = np.ones(1 << m)
    for j in range(priors.sigma.shape[0]):
        pattern = shares(x, y, cameras, priors, j)
        # P(no camera of Q is blocked by j) = sum over the sets in the complement of Q: subset sums, bit by bit
        for bit in range(m):
            for s in range(1 << m):
                if (s >> bit) & 1:
                    pattern[s] += pattern[s ^ (1 << bit)]
        # Occluders are independent of each other (step (c) of Eq. 8)
        for Q in range(1 << m):
            out[Q] *= min(1.0, max(0.0, pattern[((1 << m) - 1) ^ Q]))
    return out


@array_kernel
def over_subsets(clear: Floats, a: Floats, b: Floats, floor: float) -> float:
    """Sum over subsets Q of p_Q prod_Q (a - b) prod_not-Q b, not below floor times prod max(a, b).

    Args:
        clear: (2^m,) p_Q.
        a: (m,) factors of cameras that are not blocked.
        b: (m,) factors of cameras that are.
        floor: least value, relative.
    """
    m = a.shape[0]
    scale: Floats = np.maximum(a, b)
    largest = 1.0
    for i in range(m):
        largest *= scale[i]
    if largest == 0.0:
        return 0.0
    total = 0.0
    for Q in range(1 << m):
        term = clear[Q]
        for i in range(m):
            term *= (a[i] - b[i] if (Q >> i) & 1 else b[i]) / scale[i]
        total += term
    return max(total, floor) * largest
