"""Small symmetric matrices: inverse by Cholesky's factors, without the cost of a library call."""

from __future__ import annotations

import math

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel


@kernel
def invert(matrix: Floats, out: Floats) -> float:
    """Write the inverse of a symmetric positive definite (n, n) matrix and give the log of its determinant.

    `matrix` and `out` may be the same.

    NaN, and an inverse without meaning, where the matrix is not positive definite.
    """
    n = matrix.shape[0]
    log_determinant = 0.0
    # Cholesky: A = L L', L in the lower triangle of `out`
    for a in range(n):
        for b in range(a + 1):
            total = matrix[a, b]
            for k in range(b):
                total -= out[a, k] * out[b, k]
            if a == b:
                if not total > 0.0:
                    return math.nan
                out[a, a] = math.sqrt(total)
                log_determinant += math.log(total)
            else:
                out[a, b] = total / out[b, b]
    # L^-1 in place, then A^-1 = L^-T L^-1, row by row
    for a in range(n):
        out[a, a] = 1.0 / out[a, a]
        for b in range(a):
            total = 0.0
            for k in range(b, a):
                total -= out[a, k] * out[k, b]
            out[a, b] = total * out[a, a]
    for a in range(n):
        for b in range(a + 1):
            total = 0.0
            for k in range(a, n):
                total += out[k, a] * out[k, b]
            out[a, b] = total
            out[b, a] = total
    return log_determinant
