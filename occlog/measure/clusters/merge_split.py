"""Merge and split clusters while the penalised objective (`person_size.worth`) rises.

A group is a row (n, x, y, xx, xy, yy): pixels, mean and scatter about it, like a cell.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel

from .em import Statistics
from .person_size import Prior, place, worth

NEIGHBOUR2 = 16.0  # squared Mahalanobis distance up to which two clusters may be merged


@kernel
def union(a: Floats, b: Floats) -> Floats:
    """Two groups as one."""
    n = a[0] + b[0]
    share = b[0] / n
    dx, dy = b[1] - a[1], b[2] - a[2]
    reduced = a[0] * share
    out = np.empty(6)
    out[0], out[1], out[2] = n, a[1] + share * dx, a[2] + share * dy
    out[3] = a[3] + b[3] + reduced * dx * dx
    out[4] = a[4] + b[4] + reduced * dx * dy
    out[5] = a[5] + b[5] + reduced * dy * dy
    return out


@kernel
def groups_of(statistics: Statistics) -> Floats:
    """(K, 6) groups of the clusters."""
    out = np.empty((statistics.means.shape[0], 6))
    out[:, 0] = statistics.mass[:-1]
    out[:, 1:3] = statistics.means
    out[:, 3:] = statistics.scatter
    return out


@kernel
def group_worth(g: Floats, prior: Prior) -> float:
    """Worth of a group; 0 for one without pixels."""
    return worth(g[0], g[1], g[2], g[3], g[4], g[5], prior) if g[0] > 0.0 else 0.0


@kernel
def merge(groups: Floats, covs: Floats, entropy: Floats, prior: Prior) -> Floats:
    """The groups (K, 6) after merging, best first, every pair whose union raises the objective.

    The union must be worth more than both and the entropy between them: pixels that lie
    between two clusters are explained by both of them together, and by each only in part.

    Args:
        groups: pixels, means and scatter of the clusters, by responsibilities.
        covs: (K, 3) their covariances in the mixture; only near pairs are tried.
        entropy: (K, K) from `occlog.measure.clusters.em.shared_entropy`.
        prior: of the camera.
    """
    groups, entropy = groups.copy(), entropy.copy()
    worths = np.array([group_worth(groups[k], prior) for k in range(groups.shape[0])])
    while True:
        # Search: the pair of neighbours whose union gains most
        best, best_a, best_b = 0.0, -1, -1
        for a in range(groups.shape[0]):
            for b in range(a):
                if groups[a, 0] > 0.0 and groups[b, 0] > 0.0 and _near(groups[a], groups[b], covs[a], covs[b]):
                    apart = worths[a] + worths[b] + entropy[a, b]
                    gain = group_worth(union(groups[a], groups[b]), prior) - apart
                    if gain > best:
                        best, best_a, best_b = gain, a, b
        if best_a < 0:
            return groups[np.flatnonzero(groups[:, 0] > 0.0)]
        groups[best_a] = union(groups[best_a], groups[best_b])
        groups[best_b, 0] = 0.0
        worths[best_a] = group_worth(groups[best_a], prior)
        # The entropy between the union and a third group is at least the sum of both
        entropy[best_a] += entropy[best_b]
        entropy[:, best_a] = entropy[best_a]


@kernel
def _near(a: Floats, b: Floats, cov_a: Floats, cov_b: Floats) -> bool:
    dx, dy = b[1] - a[1], b[2] - a[2]
    xx, xy, yy = cov_a[0] + cov_b[0], cov_a[1] + cov_b[1], cov_a[2] + cov_b[2]
    return bool((yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy) <= NEIGHBOUR2)


@kernel
def split(cells: Floats, labels: Ints, groups: Floats, prior: Prior) -> Floats:
    """The groups (K, 6) after cutting in two every one whose halves are worth more than the whole.

    The cut is a line along the axis of a person, at the best of all places.

    Args:
        cells: (N, 6) cell table.
        labels: (N,) group of each cell, -1 = none.
        groups: from the labels or from responsibilities: one that is not cut stays as it is.
        prior: of the camera.
    """
    out = np.empty((2 * groups.shape[0], 6))
    n_out = 0
    for k in range(groups.shape[0]):
        mine = cells[np.flatnonzero(labels == k)]
        halves = _halves(mine, place(prior, groups[k, 1], groups[k, 2]), prior)
        for half in halves:
            out[n_out] = half
            n_out += 1
        if halves.shape[0] == 0:
            out[n_out] = groups[k]
            n_out += 1
    return out[:n_out].copy()


@kernel
def _halves(cells: Floats, at: int, prior: Prior) -> Floats:
    """(2, 6) best halves of cells cut along a person's axis; (0, 6) if the whole is worth more."""
    # Direction across a person: the minor axis of its covariance.
    xx, xy, yy = prior.cov[at]
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi
    # Sweep: statistics of all cells left and right of every cut
    order = np.argsort(math.cos(angle) * cells[:, 1] + math.sin(angle) * cells[:, 2], kind="mergesort")
    n = cells.shape[0]
    from_left, from_right = np.zeros((n + 1, 6)), np.zeros((n + 1, 6))
    for i in range(n):
        from_left[i + 1] = union(cells[order[i]], from_left[i])
        from_right[n - 1 - i] = union(cells[order[n - 1 - i]], from_right[n - i])
    best, best_cut = 0.0, -1
    whole = group_worth(from_left[n], prior)
    for i in range(1, n):
        gain = group_worth(from_left[i], prior) + group_worth(from_right[i], prior) - whole
        if gain > best:
            best, best_cut = gain, i
    out = np.empty((2 if best_cut >= 0 else 0, 6))
    if best_cut >= 0:
        out[0], out[1] = from_left[best_cut], from_right[best_cut]
    return out
