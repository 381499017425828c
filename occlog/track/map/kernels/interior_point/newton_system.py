"""The Newton system of a trajectory in time and memory linear in its length.

The Hessian of the cost is block-tridiagonal: the chain couples neighbours, all else adds a
2 x 2 block in the position of each state.  It is factored as R' R, R upper block-bidiagonal
with blocks R_t on the diagonal and N_t beside them, in one of two ways:

* `factor_sum` sums the Hessian and takes the Cholesky factor of its blocks: quick, and the
  only way for a Hessian that is the difference of large terms.  It fails where the Hessian is
  not positive definite, or so badly scaled that it cannot be told (steps far below a millisecond);
* `factor_rows` makes R by Householder reflections of the rows whose squares the Hessian is the sum of, and
  never forms it, so that twice as many digits are left.  It never fails, and is about three times as slow.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

from ..problem import Steps


@kernel
def _square(U: Floats, out: Floats) -> None:
    """Out = U' U of a lower triangle."""
    for i in range(4):
        for j in range(i + 1):
            v = 0.0
            for k in range(i, 4):
                v += U[k, i] * U[k, j]
            out[i, j] = v
            out[j, i] = v


@kernel
def _cholesky(S: Floats, R: Floats) -> bool:
    """S = R' R with R upper; false if S is not positive definite."""
    for i in range(4):
        v = S[i, i]
        for k in range(i):
            v -= R[k, i] * R[k, i]
        if not v > 1e-15 * S[i, i]:
            return False
        root = math.sqrt(v)
        R[i, i] = root
        for j in range(i):
            R[i, j] = 0.0
        for j in range(i + 1, 4):
            w = S[i, j]
            for k in range(i):
                w -= R[k, i] * R[k, j]
            R[i, j] = w / root
    return True


@kernel
def factor_sum(steps: Steps, H: Floats, R: Floats, N: Floats) -> bool:
    """R and N by Cholesky; false if the Hessian is not positive definite as far as can be told.

    Args:
        steps: the chain.
        H: (T, 3) Hessian of all but the chain's part, by position: xx, xy, yy.
        R: (T, 4, 4) changed in place.
        N: (T, 4, 4) changed in place; the last one is 0.
    """
    T = H.shape[0]
    S, W, B = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    _square(steps.whiten_first, S)
    for t in range(T):
        # S is the block of state t, from which the states before it are eliminated
        S[0, 0] += H[t, 0]
        S[0, 2] += H[t, 1]
        S[2, 0] += H[t, 1]
        S[2, 2] += H[t, 2]
        if t == T - 1:
            N[t] = 0.0
            return _cholesky(S, R[t])
        A = steps.A[steps.kind[t]]
        _square(steps.whiten[steps.kind[t]], W)
        for i in range(4):
            for j in range(4):
                B[i, j] = A[0, i] * W[0, j] + A[1, i] * W[1, j] + A[2, i] * W[2, j] + A[3, i] * W[3, j]
        for i in range(4):
            for j in range(i, 4):
                v = B[i, 0] * A[0, j] + B[i, 1] * A[1, j] + B[i, 2] * A[2, j] + B[i, 3] * A[3, j]
                S[i, j] += v
        if not _cholesky(S, R[t]):
            return False
        for j in range(4):  # N = -R'^-1 A' W
            for i in range(4):
                v = -B[i, j]
                for k in range(i):
                    v -= R[t, k, i] * N[t, k, j]
                N[t, i, j] = v / R[t, i, i]
        for i in range(4):  # Schur complement: the block of the next state
            for j in range(i, 4):
                v = W[i, j]
                for k in range(4):
                    v -= N[t, k, i] * N[t, k, j]
                S[i, j] = v
                S[j, i] = v
    return True


@kernel
def _reflect(M: Floats, rows: int, columns: int, start: int, count: int) -> None:
    """Make `count` columns of M from `start` on upper triangular from the row of equal number on, by reflections."""
    for c in range(count):
        j, norm2 = start + c, 0.0
        for i in range(c, rows):
            norm2 += M[i, j] * M[i, j]
        if norm2 == 0.0:
            continue
        alpha = -math.copysign(math.sqrt(norm2), M[c, j])
        head = M[c, j] - alpha
        scale = 1.0 / (alpha * head)  # -2 / |v|^2 with v = (head, rest)
        M[c, j] = alpha
        for k in range(j + 1, columns):
            v = head * M[c, k]
            for i in range(c + 1, rows):
                v += M[i, j] * M[i, k]
            v *= scale
            M[c, k] += v * head
            for i in range(c + 1, rows):
                M[i, k] += v * M[i, j]
        for i in range(c + 1, rows):
            M[i, j] = 0.0


@kernel
def factor_rows(steps: Steps, H: Floats, R: Floats, N: Floats) -> None:
    """R and N by reflections, for H that is positive semi-definite.

    Args:
        steps: the chain.
        H: (T, 3) Hessian of all but the chain's part, by position: xx, xy, yy.
        R: (T, 4, 4) changed in place.
        N: (T, 4, 4) changed in place; the last one is 0.
    """
    T = H.shape[0]
    M, rest = np.empty((10, 8)), np.empty((6, 4))
    before = steps.whiten_first.copy()
    for t in range(T):
        # Rows: what is known of state t, its measurements as a root of H, and the step to t + 1
        M[:] = 0.0
        M[:4, :4] = before
        M[4, 0] = math.sqrt(max(H[t, 0], 0.0))
        M[4, 2] = H[t, 1] / M[4, 0] if M[4, 0] > 0.0 else 0.0
        M[5, 2] = math.sqrt(max(H[t, 2] - M[4, 2] ** 2, 0.0))
        if t == T - 1:
            _reflect(M, 6, 4, 0, 4)
            R[t] = M[:4, :4]
            N[t] = 0.0
            return
        A, U = steps.A[steps.kind[t]], steps.whiten[steps.kind[t]]
        for i in range(4):
            for j in range(4):
                v = 0.0
                for k in range(i + 1):
                    v += U[i, k] * A[k, j]
                M[6 + i, j] = -v
                M[6 + i, 4 + j] = U[i, j]
        _reflect(M, 10, 8, 0, 4)
        R[t] = M[:4, :4]
        N[t] = M[:4, 4:]
        rest[:] = M[4:, 4:]
        _reflect(rest, 6, 4, 0, 4)
        before[:] = rest[:4]


@kernel
def solve(R: Floats, N: Floats, b: Floats, x: Floats) -> None:
    """X of R' R x = b; (T, 4) both, x changed in place."""
    T = R.shape[0]
    for t in range(T):  # forward: R' y = b
        for i in range(4):
            v = b[t, i]
            for k in range(i):
                v -= R[t, k, i] * x[t, k]
            if t > 0:
                for k in range(4):
                    v -= N[t - 1, k, i] * x[t - 1, k]
            x[t, i] = v / R[t, i, i]
    for t in range(T - 1, -1, -1):  # backward: R x = y
        for i in range(3, -1, -1):
            v = x[t, i]
            for k in range(i + 1, 4):
                v -= R[t, i, k] * x[t, k]
            if t < T - 1:
                for k in range(4):
                    v -= N[t, i, k] * x[t + 1, k]
            x[t, i] = v / R[t, i, i]


@kernel
def inverse_blocks(R: Floats, N: Floats, out: Floats) -> None:
    """Blocks on the diagonal of the inverse of R' R into `out` (T, 4, 4): the covariance of each state."""
    T = R.shape[0]
    inverse, E = np.zeros((4, 4)), np.empty((4, 4))
    for t in range(T - 1, -1, -1):
        for j in range(4):
            for i in range(3, -1, -1):
                v = 1.0 if i == j else 0.0
                for k in range(i + 1, 4):
                    v -= R[t, i, k] * inverse[k, j]
                inverse[i, j] = v / R[t, i, i]
        out[t] = inverse @ inverse.T
        if t < T - 1:
            E[:] = inverse @ np.ascontiguousarray(N[t])
            out[t] += E @ out[t + 1] @ E.T
        for i in range(4):
            for j in range(i):
                v = 0.5 * (out[t, i, j] + out[t, j, i])
                out[t, i, j] = v
                out[t, j, i] = v
