"""Joint likelihood of the reports of several cameras: sums over subsets of cameras, [Ercan] Eqs. 8-9, and exact.

Eq. 8 approximates the rectangles in which an occluder hides a position from different cameras as disjoint. The sum over
subsets Q of m cameras is then the recursion of Eq. 9, evaluated as a binary tree with a camera per level: sums of q
over Q are shared by all subsets below a branch, and negligible branches are pruned. A camera that reports a position
near the particle almost certainly sees it, so that few of the 2^m subsets remain. The exact form computes, for every
occluder, the probability that it blocks each set of cameras at once (`blocking_probability.shares`).
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import array_kernel

from .blocking_probability import shares
from .occlusion_probability import blocking_probabilities
from .priors import Priors

MAX_CAMERAS = 16
"""Cameras in view of one position; there are 2^16 subsets of them."""


@array_kernel
def add_joint(
    total: Floats,
    xy: Floats,
    sensor: Ints,
    a: Floats,
    b: Floats,
    assigned: Bools,
    positions: Floats,
    priors: Priors,
    exact: bool,
    form: int,
    floor: float,
    far: float,
) -> None:
    """Add the log-likelihood of the reports of several cameras to `total` (L,), in place, for each of L positions.

    It is the log of the sum over subsets Q of the cameras of p_Q prod_Q (a - b) prod_not-Q b, [Ercan] Eq. 8, with p_Q
    the probability that no camera of Q is blocked.

    Args:
        total: (L,) log-likelihoods; positions with -inf are omitted.
        xy: (L, 2) positions.
        sensor: (n,) index of the camera of each of n frames, at most one frame of a camera.
        a: (n, L) likelihood of a frame's report if no occluder hides the position.
        b: (n,) likelihood of a frame's report if an occluder does.
        assigned: (n, L) frames that count for a position.
        positions: (S, 2) positions of the cameras.
        priors: priors of the occluders.
        exact: True: p_Q is exact; False: the rectangles of an occluder for different cameras are taken as disjoint (Eq.
            8).
        form: approximation of single blocking probabilities: `PRINTED`, `IMPROVED` or `QUADRATURE`; if not exact.
        floor: least value of the sum, relative to prod max(a, b).
        far: standard deviations at which a normal prior is cut off; if not exact.

    Raises:
        ValueError: more than `MAX_CAMERAS` frames count for a position.
    """
    n, L, M = a.shape[0], xy.shape[0], priors.sigma.shape[0]
    q = np.zeros((n, 1 if exact else M, L))
    rows = np.arange(L)
    for k in range(n):
        if not exact:
            q[k] = blocking_probabilities(xy, rows, positions[sensor[k], 0], positions[sensor[k], 1], priors, form, far)
    for p in range(L):
        use = np.flatnonzero(assigned[:, p])
        if use.shape[0] == 0 or total[p] == -np.inf:
            continue
        if use.shape[0] > MAX_CAMERAS:
            raise ValueError("too many cameras see a position for sums over their subsets; use likelihood=independent")
        if exact:
            # p_Q without the assumption of Eq. 8, then the sum over all Q
            seen = clear_exact(xy[p, 0], xy[p, 1], positions[sensor[use]], priors)
            total[p] += math.log(over_subsets(seen, a[:, p][use], b[use], floor))
        else:
            # p_Q by Eq. 8, the sum by the recursion of Eq. 9
            total[p] += math.log(sum_disjoint(relevant_priors(q, p, use), a[:, p][use], b[use], floor))


@array_kernel
def clear_exact(x: float, y: float, cameras: Floats, priors: Priors) -> Floats:
    """Return the (2^m,) probability for every subset Q of m cameras (a bit mask) that none of Q is blocked at (x, y).

    Args:
        x: position.
        y: position.
        cameras: (m, 2) positions.
        priors: priors of the occluders, which are independent of each other.
    """
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
    """Return the sum over subsets Q of m cameras of p_Q prod_Q (a - b) prod_not-Q b.

    It is at least floor times prod max(a, b).

    Args:
        clear: (2^m,) probability p_Q that no camera of Q is blocked, by bit mask of Q.
        a: (m,) likelihoods of the reports of cameras that are not blocked.
        b: (m,) likelihoods of the reports of cameras that are blocked.
        floor: least value, relative to prod max(a, b).
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


MIN_BRANCH_SHARE = 1e-10
"""Branches below this share of the sum so far, or of its floor, are cut."""
LANES = 4
"""Block size of products over occluders."""


@array_kernel
def sum_disjoint(q: Floats, a: Floats, b: Floats, floor: float) -> float:
    """Return the sum over subsets Q of m cameras of p_Q prod_Q (a - b) prod_not-Q b, by the recursion of [Ercan] Eq. 9.

    p_Q = prod_j max(0, 1 - sum_Q q_ij) is the probability that no camera of Q is blocked (Eq. 8). The sum is at least
    floor times prod max(a, b).

    Args:
        q: (m, M) probabilities that occluder j blocks camera i.
        a: (m,) likelihoods of the reports of cameras that are not blocked.
        b: (m,) likelihoods of the reports of cameras that are blocked.
        floor: least value, relative to prod max(a, b), >= 0.
    """
    m = a.shape[0]
    scale: Floats = np.maximum(a, b)
    largest = 1.0
    for i in range(m):
        largest *= scale[i]
    if largest == 0.0:
        return 0.0
    # Cameras with one light branch come first, so that most of the tree is cut near its root
    order = by_weight((a - b) / scale, b / scale)
    sums: Floats = np.empty((m + 1, q.shape[1]))
    weight, branch = np.ones(m + 1), np.zeros(m, dtype=np.int64)
    sums[0] = 0.0
    level, total = 0, 0.0
    while level >= 0:
        # Leaf: add weight times p_Q (Eq. 8)
        if level == m:
            total += float(weight[m]) * joint_visibility(sums[m])
            level -= 1
            continue
        i, turn = order[level], branch[level]
        # Both branches done: back to the level above
        if turn == 2:
            branch[level] = 0
            level -= 1
            continue
        # Branch 0: camera i is in Q and sees the position; branch 1: it is not in Q
        branch[level] += 1
        w = weight[level] * ((a[i] - b[i]) if turn == 0 else b[i]) / scale[i]
        if abs(w) <= MIN_BRANCH_SHARE * max(abs(total), floor):
            continue
        weight[level + 1] = w
        if turn == 0:
            for j in range(q.shape[1]):
                sums[level + 1, j] = sums[level, j] + q[i, j]
        else:
            sums[level + 1] = sums[level]
        level += 1
    return max(total, floor) * largest


@array_kernel
def by_weight(seeing: Floats, hidden: Floats) -> Ints:
    """Return the (m,) order of cameras in which a binary tree is pruned most: those with one negligible branch first.

    Args:
        seeing: (m,) factor of the branch in which the camera is not blocked.
        hidden: (m,) factor of the other branch.
    """
    m = seeing.shape[0]
    order, key = np.empty(m, dtype=np.int64), np.empty(m)
    for i in range(m):
        light, index = min(abs(seeing[i]), abs(hidden[i])), i
        while index > 0 and key[index - 1] > light:
            order[index], key[index] = order[index - 1], key[index - 1]
            index -= 1
        order[index], key[index] = i, light
    return order


@array_kernel
def joint_visibility(sums: Floats) -> float:
    """Return the probability that no camera of a set is blocked: prod_j max(0, 1 - sums_j).

    `sums` (M,) are, for each occluder, the sums of its blocking probabilities over the cameras of the set.
    """
    p0, p1, p2, p3 = 1.0, 1.0, 1.0, 1.0
    whole = sums.shape[0] - sums.shape[0] % LANES
    for j in range(0, whole, LANES):
        p0 *= max(0.0, 1.0 - sums[j])
        p1 *= max(0.0, 1.0 - sums[j + 1])
        p2 *= max(0.0, 1.0 - sums[j + 2])
        p3 *= max(0.0, 1.0 - sums[j + 3])
    for j in range(whole, sums.shape[0]):
        p0 *= max(0.0, 1.0 - sums[j])
    return (p0 * p1) * (p2 * p3)


@array_kernel
def relevant_priors(q: Floats, p: int, use: Ints) -> Floats:
    """Return the (m, K) blocking probabilities at position p for cameras `use` (m,), without occluders that block none.

    Args:
        q: (n, M, L) probability that occluder j hides position p from camera k.
        p: index of the position.
        use: (m,) indices of cameras.
    """
    out = np.empty((use.shape[0], q.shape[1]))
    K = 0
    for j in range(q.shape[1]):
        most = 0.0
        for k in range(use.shape[0]):
            out[k, K] = q[use[k], j, p]
            most = max(most, out[k, K])
        if most > 0.0:
            K += 1
    return out[:, :K]
