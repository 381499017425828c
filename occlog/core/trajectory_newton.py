"""The Newton system of a trajectory in time and memory linear in its length.

The Hessian of the cost is block-tridiagonal: the chain's own part couples neighbours, all
else adds a 2 x 2 block H_t in the position of each state.  Its solution is that of a linear
Gaussian smoothing problem, so it is solved by a Kalman filter forwards and the recursion of
Bryson and Frazier backwards, which is a block factorisation of the same system in which the inverse
of a step's noise never occurs: steps may be as short as they like, and nothing is inverted
that is larger than 2 x 2.
"""

from __future__ import annotations

import numpy as np

from .geometry import Floats
from .jit import kernel
from .trajectory import Steps


@kernel
def _predict(A: Floats, Q: Floats, m: Floats, P: Floats, to_m: Floats, to_P: Floats) -> None:
    """To_m = A m, to_P = A P A' + Q."""
    AP = np.empty((4, 4))
    for i in range(4):
        to_m[i] = A[i, 0] * m[0] + A[i, 1] * m[1] + A[i, 2] * m[2] + A[i, 3] * m[3]
        for j in range(4):
            AP[i, j] = A[i, 0] * P[0, j] + A[i, 1] * P[1, j] + A[i, 2] * P[2, j] + A[i, 3] * P[3, j]
    for i in range(4):
        for j in range(i + 1):
            v = AP[i, 0] * A[j, 0] + AP[i, 1] * A[j, 1] + AP[i, 2] * A[j, 2] + AP[i, 3] * A[j, 3] + Q[i, j]
            to_P[i, j] = v
            to_P[j, i] = v


@kernel
def _gain(H: Floats, P: Floats, M: Floats) -> bool:
    """M = (I + H Pp)^-1 H, Pp the positions' part of P, as xx, xy, yy; false where the Hessian is not positive."""
    a, b, c = P[0, 0], P[0, 2], P[2, 2]
    s00, s01 = 1.0 + H[0] * a + H[1] * b, H[0] * b + H[1] * c
    s10, s11 = H[1] * a + H[2] * b, 1.0 + H[1] * b + H[2] * c
    det = s00 * s11 - s01 * s10
    if not (det > 0.0 and s00 + s11 > 0.0):
        return False
    M[0] = (s11 * H[0] - s01 * H[1]) / det
    M[1] = 0.5 * ((s11 * H[1] - s01 * H[2]) + (s00 * H[1] - s10 * H[0])) / det
    M[2] = (s00 * H[2] - s10 * H[1]) / det
    return True


@kernel
def _update(M: Floats, s: Floats, m: Floats, P: Floats, to_m: Floats, to_P: Floats) -> None:
    """To_m = m + Pc s, to_P = P - Pc M Pc', Pc the columns of the positions."""
    for i in range(4):
        to_m[i] = m[i] + P[i, 0] * s[0] + P[i, 2] * s[1]
        k0, k1 = P[i, 0] * M[0] + P[i, 2] * M[1], P[i, 0] * M[1] + P[i, 2] * M[2]
        for j in range(i + 1):
            v = P[i, j] - k0 * P[j, 0] - k1 * P[j, 2]
            to_P[i, j] = v
            to_P[j, i] = v


@kernel
def newton_step(steps: Steps, X: Floats, g: Floats, H: Floats, dX: Floats) -> bool:
    """The step dX that minimises the quadratic model of the cost about X; false if the model has no minimum.

    Args:
        steps: the chain.
        X: (T, 4) states.
        g: (T, 2) gradient of all but the chain's part, by position.
        H: (T, 3) its Hessian: xx, xy, yy.
        dX: (T, 4) changed in place.
    """
    T = X.shape[0]
    ms, Ps, Ms, ss = np.empty((T, 4)), np.empty((T, 4, 4)), np.empty((T, 3)), np.empty((T, 2))
    m, P = np.empty(4), np.empty((4, 4))
    for t in range(T):
        if t == 0:
            ms[0] = steps.mean - X[0]
            Ps[0] = steps.spread
        else:
            kind = steps.kind[t - 1]
            A = steps.A[kind]
            _predict(A, steps.sigma[kind], m, P, ms[t], Ps[t])
            for i in range(4):  # what the chain misses by at X
                ms[t, i] += A[i, 0] * X[t - 1, 0] + A[i, 1] * X[t - 1, 1] + A[i, 2] * X[t - 1, 2]
                ms[t, i] += A[i, 3] * X[t - 1, 3] - X[t, i]
        if not _gain(H[t], Ps[t], Ms[t]):
            return False
        # s = (I + H Pp)^-1 (-g - H m) = -(g + M (m - Pp g)): no division by det again
        p0 = ms[t, 0] - Ps[t, 0, 0] * g[t, 0] - Ps[t, 0, 2] * g[t, 1]
        p1 = ms[t, 2] - Ps[t, 2, 0] * g[t, 0] - Ps[t, 2, 2] * g[t, 1]
        ss[t, 0] = -g[t, 0] - Ms[t, 0] * p0 - Ms[t, 1] * p1
        ss[t, 1] = -g[t, 1] - Ms[t, 1] * p0 - Ms[t, 2] * p1
        _update(Ms[t], ss[t], ms[t], Ps[t], m, P)
    la, back = np.zeros(4), np.zeros(4)
    for t in range(T - 1, -1, -1):
        if t < T - 1:
            A = steps.A[steps.kind[t]]
            for j in range(4):
                back[j] = A[0, j] * la[0] + A[1, j] * la[1] + A[2, j] * la[2] + A[3, j] * la[3]
            la[:] = back
        q0, q1 = 0.0, 0.0
        for i in range(4):
            q0 += Ps[t, i, 0] * la[i]
            q1 += Ps[t, i, 2] * la[i]
        la[0] += ss[t, 0] - Ms[t, 0] * q0 - Ms[t, 1] * q1
        la[2] += ss[t, 1] - Ms[t, 1] * q0 - Ms[t, 2] * q1
        for i in range(4):
            dX[t, i] = ms[t, i]
            for j in range(4):
                dX[t, i] += Ps[t, i, j] * la[j]
    return True


@kernel
def covariances(steps: Steps, H: Floats, out: Floats) -> bool:
    """Blocks (T, 4, 4) on the diagonal of the inverse Hessian, into `out`; false if it is not positive definite.

    Args:
        steps: the chain.
        H: (T, 3) Hessian of all but the chain's part, by position.
        out: changed in place.
    """
    T = H.shape[0]
    Ms = np.empty((T, 3))
    nothing, none, m = np.zeros(4), np.zeros(2), np.empty(4)
    P = np.empty((4, 4))
    for t in range(T):
        if t == 0:
            out[0] = steps.spread
        else:
            kind = steps.kind[t - 1]
            _predict(steps.A[kind], steps.sigma[kind], nothing, P, m, out[t])
        if not _gain(H[t], out[t], Ms[t]):
            return False
        _update(Ms[t], none, nothing, out[t], m, P)
    La = np.zeros((4, 4))
    F = np.empty((4, 4))
    for t in range(T - 1, -1, -1):
        if t < T - 1:
            A = steps.A[steps.kind[t]]
            La = A.T @ La @ A
        # I - C' M Pc'
        F[:] = np.eye(4)
        for j in range(4):
            p, q = out[t, j, 0], out[t, j, 2]
            F[0, j] -= Ms[t, 0] * p + Ms[t, 1] * q
            F[2, j] -= Ms[t, 1] * p + Ms[t, 2] * q
        La = F @ La @ F.T
        La[0, 0] += Ms[t, 0]
        La[0, 2] += Ms[t, 1]
        La[2, 0] += Ms[t, 1]
        La[2, 2] += Ms[t, 2]
        S = out[t] - out[t] @ La @ out[t]
        out[t] = 0.5 * (S + S.T)
    return True
