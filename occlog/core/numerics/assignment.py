"""One-to-one assignments: least cost within a gate (global nearest neighbour), or greatest weight."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from occlog.array_types import Floats, Ints


def assign(cost: Floats, gate: float) -> tuple[Ints, Ints]:
    """Return a one-to-one assignment: the maximum number of pairs within the gate, then the least total cost.

    Args:
        cost: (n, m), >= 0; may be infinite.
        gate: largest cost of a pair; pairs that cost more are not made.

    Returns:
        (k,) rows, ascending, and (k,) columns of the pairs.
    """
    cost = np.asarray(cost, dtype=np.float64)
    if not cost.size:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    # One pair beyond the gate must cost more than any number of pairs within it.
    capped = np.where(cost <= gate, cost, 1e6 * (gate * min(cost.shape) + 1.0))
    rows, columns = linear_sum_assignment(capped)
    good = cost[rows, columns] <= gate
    return rows[good].astype(np.int64), columns[good].astype(np.int64)


def maximum_weight_matching(rows: Ints, columns: Ints, weights: Floats) -> Ints:
    """Return the one-to-one pairs of rows and columns with the greatest total weight, among given candidates.

    Time and memory grow with the number of candidate pairs rather than with rows times columns.

    Args:
        rows: (n,) row of each candidate pair, >= 0.
        columns: (n,) its column, >= 0; no pair comes twice.
        weights: (n,) finite weights; pairs of 0 or less are not made.

    Returns:
        (k,) indices of the selected candidates, sorted by row.
    """
    able = np.flatnonzero(np.asarray(weights) > 0)
    if not len(able):
        return able
    left, row = np.unique(rows[able], return_inverse=True)
    right, column = np.unique(columns[able], return_inverse=True)
    n, m, top = len(left), len(right), float(np.max(weights[able]))
    # A row without a partner is paired with a column of its own, which weighs nothing; the library takes no cost of 0
    cost = np.concatenate([2.0 * top - weights[able], np.full(n, 2.0 * top)])
    edges = np.stack([np.concatenate([row, np.arange(n)]), np.concatenate([column, m + np.arange(n)])])
    # SciPy before 1.15 takes no positions of 64 bits
    graph = csr_array((cost, tuple(edges.astype(np.int32))), shape=(n, m + n))
    made = min_weight_full_bipartite_matching(graph)[1]
    pairs: Ints = able[made[row] == column]
    return pairs[np.argsort(rows[pairs])]
