"""p(eta | u): probability that exactly the cameras of eta see a place among moving occluders ([Ercan] Sec. 4.2).

eta_i = 1 if no occluder hides the place from camera i.  Occluders are independent of each
other.  p_Q, the probability that all cameras of a subset Q see the place, is

    recursion   prod_j (1 - sum_{i in Q} q_ij), factors below 0 taken as 0      (Eq. 8)
    exact       prod_j (1 - P(occluder j is in the union of A_i, i in Q))

Eq. 8 takes the rectangles A_i as disjoint, which they are not near the place, where all of
them end.  From p_Q the recursion of Eq. 9 gives p(eta); written out it is

    p(eta) = sum_{H subset of the hidden} (-1)^|H| p_{seen + H}.

    independent   p(eta) = prod_seen P_i prod_hidden (1 - P_i), P_i = prod_j (1 - q_ij)

needs no subsets.  Each of the three sums to 1 over all eta.  Where Eq. 8 was clipped, Eq. 9
can be below 0, and with more hidden cameras than occluders it is identically 0; `floor`
is the least value given back.

Subsets are numbers from 0 to 2^N - 1, bit i for camera i.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import array_kernel
from occlog.core.occlusion.hidden_together import clear_exact
from occlog.core.occlusion.priors import Priors

MOST_CAMERAS = 16
"""Largest number of cameras of the forms with subsets, of which there are 2^16."""


def recursion(q: Floats, eta: Bools, floor: float = 0.0) -> Floats:
    """Return (L,) p(eta | u) by Eqs. 8-9, at least `floor`.

    Args:
        q: (L, N, M) of `occlog.papers.ercan.formulas.blocking`.
        eta: (N,) true: the camera sees the place.
        floor: least value, >= 0.
    """
    return pattern(seen_by_recursion(q), eta, floor)


def independent(q: Floats, eta: Bools) -> Floats:
    """Return (L,) p(eta | u) with cameras independent of each other, never below 0: q (L, N, M), eta (N,)."""
    seen = np.prod(1.0 - q, axis=2)
    return np.asarray(np.prod(np.where(eta, seen, 1.0 - seen), axis=1), dtype=np.float64)


def exact(xy: Floats, cameras: Floats, priors: Priors, eta: Bools, floor: float = 0.0) -> Floats:
    """Return (L,) p(eta | u) without an assumption about overlaps, at least `floor`.

    Args:
        xy: (L, 2) places.
        cameras: (N, 2) positions.
        priors: of the occluders.
        eta: (N,) true: the camera sees the place.
        floor: least value, >= 0; rounding alone may give -1e-16.
    """
    return pattern(seen_exactly(xy, cameras, priors), eta, floor)


def seen_by_recursion(q: Floats) -> Floats:
    """Return (L, 2^N) p_Q of Eq. 8 from q (L, N, M), with 1 - sum q clipped at 0."""
    L, N, M = q.shape
    _check(N)
    sums = np.zeros((1 << N, L, M))
    for Q in range(1, 1 << N):
        lowest = (Q & -Q).bit_length() - 1
        sums[Q] = sums[Q & (Q - 1)] + q[:, lowest]
    return np.ascontiguousarray(np.prod(np.maximum(1.0 - sums, 0.0), axis=2).T)


def seen_exactly(xy: Floats, cameras: Floats, priors: Priors) -> Floats:
    """Return (L, 2^N) p_Q for places xy (L, 2) and cameras (N, 2), with unions of rectangles."""
    _check(len(cameras))
    return np.asarray(
        _seen_exactly(
            np.ascontiguousarray(xy, dtype=np.float64), np.ascontiguousarray(cameras, dtype=np.float64), priors
        )
    )


def pattern(seen: Floats, eta: Bools, floor: float = 0.0) -> Floats:
    """Return (L,) p(eta) from p_Q (L, 2^N) by Eq. 9 written out, at least `floor`."""
    base, hidden = _number(eta), _number(~np.asarray(eta, dtype=np.bool_))
    total = np.zeros(len(seen))
    H = hidden
    while True:
        total += seen[:, base | H] if H.bit_count() % 2 == 0 else -seen[:, base | H]
        if H == 0:
            return np.maximum(total, floor)
        H = (H - 1) & hidden


def patterns(seen: Floats) -> Floats:
    """Return (L, 2^N) p(eta) of all eta at once from p_Q, not floored; column = sum of eta_i 2^i.

    They sum to p of the empty set, which is 1.
    """
    out = seen.copy()
    columns: Ints = np.arange(seen.shape[1], dtype=np.int64)
    bit = 1
    while bit < seen.shape[1]:
        without = columns[columns & bit == 0]
        out[:, without] -= out[:, without | bit]
        bit <<= 1
    return out


@array_kernel
def _seen_exactly(xy: Floats, cameras: Floats, priors: Priors) -> Floats:
    out = np.empty((xy.shape[0], 1 << cameras.shape[0]))
    for p in range(xy.shape[0]):
        out[p] = clear_exact(xy[p, 0], xy[p, 1], cameras, priors)
    return out


def _number(eta: Bools) -> int:
    """Return the number of the subset of cameras that are true."""
    return sum(1 << i for i, one in enumerate(eta) if one)


def _check(cameras: int) -> None:
    if cameras > MOST_CAMERAS:
        raise ValueError(f"subsets of {cameras} cameras: at most {MOST_CAMERAS} can be computed")
