"""Data association by global nearest neighbours: one-to-one assignment of least cost within a gate."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Floats, Ints


def assign(cost: Floats, gate: float) -> tuple[Ints, Ints]:
    """Assign rows to columns one to one: as many pairs as the gate lets, and of these the least sum of costs.

    Args:
        cost: (n, m), >= 0; may be infinite.
        gate: largest cost of a pair; pairs that cost more are not made.

    Returns:
        (k,) rows, rising, and (k,) columns of the pairs.
    """
    cost = np.asarray(cost, dtype=np.float64)
    if not cost.size:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    # One pair beyond the gate must cost more than any number of pairs within it.
    capped = np.where(cost <= gate, cost, 1e6 * (gate * min(cost.shape) + 1.0))
    rows, columns = linear_sum_assignment(capped)
    good = cost[rows, columns] <= gate
    return rows[good].astype(np.int64), columns[good].astype(np.int64)
