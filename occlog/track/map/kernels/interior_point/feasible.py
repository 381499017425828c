"""Points strictly inside half-planes: where an interior point method can start."""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.jit import kernel

from ..problem import HalfPlanes

ROUNDS = 200
"""Rounds of projections for one margin; then the corners are tried, which takes time cubic in the constraints."""
THINNEST = 1e-6
"""Margin, as a share of the first one, below which a state's constraints count as contradictory."""


def move_inside(X: Floats, planes: HalfPlanes, margin: float) -> tuple[Floats, Bools]:
    """States moved as little as needed to hold all half-planes with a margin, each state for itself.

    Args:
        X: (T, 4) states; only positions change.
        planes: M half-planes, by rising step.
        margin: wanted distance to each, > 0; where there is not so much room, less is taken.

    Returns:
        X and (T,) bool: which states cannot hold all of theirs.
    """
    out = np.array(X, dtype=np.float64)
    contradictory = np.zeros(len(X), dtype=np.bool_)
    if len(planes.step):
        _project(out, planes, margin, contradictory)
    return out, contradictory


@kernel
def _project(X: Floats, planes: HalfPlanes, margin: float, contradictory: Bools) -> None:
    """Projections onto the farthest violated half-plane of each state, with an ever smaller margin."""
    M = planes.step.shape[0]
    first = 0
    while first < M:
        t, last = planes.step[first], first
        while last < M and planes.step[last] == t:
            last += 1
        want = margin
        while want >= margin * THINNEST:
            if _reach(X, planes, first, last, want):
                break
            want *= 0.25
        contradictory[t] = want < margin * THINNEST
        first = last


@kernel
def _reach(X: Floats, planes: HalfPlanes, first: int, last: int, want: float) -> bool:
    """Move one state until its half-planes first .. last - 1 hold by `want`; false if they cannot."""
    t = planes.step[first]
    for _ in range(ROUNDS):
        worst, which = 0.0, -1
        for m in range(first, last):
            lack = want + planes.offset[m] - planes.normal[m, 0] * X[t, 0] - planes.normal[m, 1] * X[t, 2]
            if lack > worst:
                worst, which = lack, m
        if which < 0:
            return True
        # A little too far, so that corners are reached in finitely many moves.
        X[t, 0] += 1.1 * worst * planes.normal[which, 0]
        X[t, 2] += 1.1 * worst * planes.normal[which, 1]
    return _corner(X, planes, first, last, want)


@kernel
def _corner(X: Floats, planes: HalfPlanes, first: int, last: int, want: float) -> bool:
    """Move one state to the nearest corner of what its half-planes leave with a margin; false if there is none.

    Projections take very long into a narrow wedge; what has room has a corner, but for a strip.
    """
    t, n, nearest = planes.step[first], planes.normal, np.inf
    x, y = X[t, 0], X[t, 2]
    for i in range(first, last):
        for j in range(first, i):
            det = n[i, 0] * n[j, 1] - n[i, 1] * n[j, 0]
            if abs(det) < 1e-12:
                continue
            a, b = planes.offset[i] + want, planes.offset[j] + want
            u, v = (a * n[j, 1] - b * n[i, 1]) / det, (b * n[i, 0] - a * n[j, 0]) / det
            away = (u - x) ** 2 + (v - y) ** 2
            if away < nearest and _least(planes, first, last, u, v) > 0.5 * want:  # want, but for rounding
                nearest, X[t, 0], X[t, 2] = away, u, v
    return bool(nearest < np.inf)


@kernel
def _least(planes: HalfPlanes, first: int, last: int, u: float, v: float) -> float:
    """Smallest slack of some half-planes at a point."""
    least = np.inf
    for m in range(first, last):
        least = min(least, planes.normal[m, 0] * u + planes.normal[m, 1] * v - planes.offset[m])
    return float(least)
