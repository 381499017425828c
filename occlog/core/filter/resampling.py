"""Resampling of weighted particles."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel


@kernel
def systematic_ancestors(weights: Floats, n: int, u: float) -> Ints:
    """Draw ancestors by systematic resampling: invert the cumulated weights at the points (i + u) / n.

    Args:
        weights: (L,) non-negative, summing to 1 up to rounding.
        n: number of ancestors wanted; need not be L.
        u: one draw from U[0, 1).

    Returns:
        (n,) non-decreasing rows of `weights`; row l appears floor(n w_l) or ceil(n w_l)
        times, n w_l on average.  Where rounding lets the weights sum to less than 1, the
        last particle with weight takes the rest.
    """
    ancestors = np.empty(n, dtype=np.int64)
    # The last particle with weight: no point may fall to one behind it
    last = weights.shape[0] - 1
    while last > 0 and not weights[last] > 0.0:
        last -= 1
    # Walk along the cumulated weights, which end at or above each point
    j = 0
    total = weights[0]
    for i in range(n):
        point = (i + u) / n
        while total <= point and j < last:
            j += 1
            total += weights[j]
        ancestors[i] = j
    return ancestors
