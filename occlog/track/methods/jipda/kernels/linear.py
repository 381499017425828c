"""Inverse, Cholesky factor and eigenvalues of small symmetric matrices, without library calls."""

from __future__ import annotations

import math

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

SWEEPS = 30
"""Most sweeps of rotations; a few are enough."""
OFF_DIAGONAL_TOLERANCE = 1e-15
"""Off-diagonal entries below this share of the diagonal count as zero."""


@kernel
def invert(matrix: Floats, out: Floats) -> float:
    """Write the inverse of a symmetric positive definite (n, n) matrix; return the log determinant.

    `matrix` and `out` may be the same. Returns NaN, with an undefined inverse, if the matrix is not positive definite.
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


@kernel
def cholesky(matrix: Floats, out: Floats) -> None:
    """Write the lower Cholesky factor L (n, n), L L' = `matrix`, of a symmetric positive definite matrix to `out`."""
    n = matrix.shape[0]
    for a in range(n):
        for b in range(n):
            total = matrix[a, b]
            for k in range(min(a, b)):
                total -= out[a, k] * out[b, k]
            if a == b:
                out[a, a] = math.sqrt(total)
            else:
                out[a, b] = total / out[b, b] if a > b else 0.0


@kernel
def eigen(matrix: Floats, axes: Floats) -> None:
    """Diagonalise a symmetric matrix (n, n) in place by Jacobi rotations; write its eigenvectors to `axes` (n, n).

    The diagonal of `matrix` becomes the eigenvalues, in no order; column k of `axes` is the k-th unit eigenvector.
    """
    n = matrix.shape[0]
    for a in range(n):
        for b in range(n):
            axes[a, b] = 1.0 if a == b else 0.0
    for _ in range(SWEEPS):
        rotated = False
        for a in range(n - 1):
            for b in range(a + 1, n):
                if abs(matrix[a, b]) <= OFF_DIAGONAL_TOLERANCE * math.sqrt(abs(matrix[a, a] * matrix[b, b])):
                    continue
                rotated = True
                # The smaller angle that makes the entry zero (Golub and Van Loan, Sec. 8.5)
                tau = (matrix[b, b] - matrix[a, a]) / (2.0 * matrix[a, b])
                t = math.copysign(1.0, tau) / (abs(tau) + math.sqrt(1.0 + tau * tau))
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = t * c
                for k in range(n):
                    x, y = matrix[k, a], matrix[k, b]
                    matrix[k, a], matrix[k, b] = c * x - s * y, s * x + c * y
                for k in range(n):
                    x, y = matrix[a, k], matrix[b, k]
                    matrix[a, k], matrix[b, k] = c * x - s * y, s * x + c * y
                    x, y = axes[k, a], axes[k, b]
                    axes[k, a], axes[k, b] = c * x - s * y, s * x + c * y
        if not rotated:
            return
