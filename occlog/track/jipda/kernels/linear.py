"""Small symmetric matrices: inverse by Cholesky's factors, without the cost of a library call."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel


@kernel
def invert(matrix: Floats, out: Floats) -> float:
    """Write the inverse of a symmetric positive definite (n, n) matrix and give the log of its determinant.

    NaN, and an inverse without meaning, where the matrix is not positive definite.
    """
    n = matrix.shape[0]
    lower = np.zeros((n, n))
    log_determinant = 0.0
    # Cholesky: A = L L'
    for a in range(n):
        for b in range(a + 1):
            total = matrix[a, b]
            for k in range(b):
                total -= lower[a, k] * lower[b, k]
            if a == b:
                if not total > 0.0:
                    return math.nan
                lower[a, a] = math.sqrt(total)
                log_determinant += math.log(total)
            else:
                lower[a, b] = total / lower[b, b]
    # L^-1 in place, then A^-1 = L^-T L^-1
    for a in range(n):
        lower[a, a] = 1.0 / lower[a, a]
        for b in range(a):
            total = 0.0
            for k in range(b, a):
                total -= lower[a, k] * lower[k, b]
            lower[a, b] = total * lower[a, a]
    for a in range(n):
        for b in range(a + 1):
            total = 0.0
            for k in range(a, n):
                total += lower[k, a] * lower[k, b]
            out[a, b] = total
            out[b, a] = total
    return log_determinant
