"""Sum over the subsets of cameras that are not blocked, by the recursion of [Ercan] Eqs. 8-9.

Eq. 8 takes the rectangles of different cameras as disjoint.  The sum over subsets Q of m cameras is
walked as a tree with a camera a level: the sums of q over Q are shared by all subsets below a
branch, and branches too light to matter are cut.  A camera that reports a place near the
particle almost certainly sees it, so few of the 2^m subsets remain.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import array_kernel

CUT = 1e-10
"""Branches below this share of the sum so far, or of its floor, are cut."""
LANES = 4
"""Products of so many occluders are formed side by side."""


@array_kernel
def sum_disjoint(q: Floats, a: Floats, b: Floats, floor: float) -> float:
    """Sum over subsets Q of p_Q prod_Q (a - b) prod_not-Q b, not below floor times prod max(a, b).

    p_Q = prod_j max(0, 1 - sum_Q q_ij) is the probability that no camera of Q is blocked (Eq. 8).

    Args:
        q: (m, M) probabilities that occluder j blocks camera i.
        a: (m,) factors of cameras that are not blocked.
        b: (m,) factors of cameras that are.
        floor: least value, relative, > 0 or 0.
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
            total += float(weight[m]) * clear(sums[m])
            level -= 1
            continue
        i, turn = order[level], branch[level]
        # Both branches done: back to the level above
        if turn == 2:
            branch[level] = 0
            level -= 1
            continue
        # Branch 0: camera i is in Q and sees the place; branch 1: it is not in Q
        branch[level] += 1
        w = weight[level] * ((a[i] - b[i]) if turn == 0 else b[i]) / scale[i]
        if abs(w) <= CUT * max(abs(total), floor):
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
    """(m,) cameras in the order in which they rule out most: those with one light branch first."""
    m = seeing.shape[0]
    order, key = np.empty(m, dtype=np.int64), np.empty(m)
    for i in range(m):
        light, place = min(abs(seeing[i]), abs(hidden[i])), i
        while place > 0 and key[place - 1] > light:
            order[place], key[place] = order[place - 1], key[place - 1]
            place -= 1
        order[place], key[place] = i, light
    return order


@array_kernel
def clear(sums: Floats) -> float:
    """prod_j max(0, 1 - sums_j)."""
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
def that_matter(q: Floats, p: int, use: Ints) -> Floats:
    """(m, K) of (n, M, L) q at place p for cameras `use`, without occluders that block none of them."""
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
