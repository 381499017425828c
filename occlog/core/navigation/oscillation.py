"""Oscillation of a robot before an obstacle: how it is recognised, and the angle of escape ([Lee] Sec. 5.2.2).

csc is printed where arcsin is meant.  The largest angle is that of the *smallest* distance at which the robot can be,
where the text says that the maximum of the distance should be considered.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats


class Range(NamedTuple):
    """The ends of a range."""

    low: float
    high: float


def opposite(previous: Floats, force: Floats, tolerance: float) -> Bools:
    """(...) whether two successive total forces (..., 2) have opposite directions ([Lee] Eq. 5.26).

    Args:
        previous: force one step before; NaN: there was none, which is never opposite.
        force: the force now.
        tolerance: the cosine of the angle between the two may exceed -1 by this much.
    """
    lengths = np.hypot(previous[..., 0], previous[..., 1]) * np.hypot(force[..., 0], force[..., 1])
    product = np.sum(previous * force, axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray((product <= -(1.0 - tolerance) * lengths) & (lengths > 0.0))


def distance_inside(way: float, radii: float) -> Range:
    """Range of d_osc for a robot that escapes inside the region of prevention ([Lee] Eq. 5.27); the low end is open.

    Args:
        way: s_r T_s, length of a step.
        radii: r_r + r_o.
    """
    return Range(0.0, way + radii)


def distance_outside(way: float, radii: float) -> Range:
    """Range of d_osc for a robot that escapes outside the region ([Lee] Eq. 5.28); the low end is open."""
    return Range(way + radii, 2.0 * way + radii)


def angle_at(d: float, radii: float) -> float:
    """theta_osc, by which a robot at a distance d passes an obstacle just so ([Lee] Eqs. 5.29 and 5.30) [rad]."""
    return math.asin(min(1.0, radii / d))


def angle_inside(way: float, radii: float) -> Range:
    """Range of the angle of a robot that escapes inside the region ([Lee] Eq. 5.31); the high end is open."""
    return Range(angle_at(way + radii, radii), 0.5 * math.pi)


def angle_outside(way: float, radii: float) -> Range:
    """Range of the angle of a robot that escapes outside the region ([Lee] Eq. 5.32); the high end is open."""
    return Range(angle_at(2.0 * way + radii, radii), angle_at(way + radii, radii))


def turned(force: Floats, angle: Floats) -> Floats:
    """(..., 2) forces turned by angles (...) to the left, their lengths kept ([Lee] Eqs. 5.33 and 5.34)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = force[..., 0], force[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)
