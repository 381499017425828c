"""Collisions by aligned robot, obstacle and goal (CAROG), and the force that prevents them ([Lee] Sec. 5.2.2).

A robot whose way to the goal leads straight through an obstacle is pulled and pushed along one line.  If the pull is
the stronger one up to the last step before the obstacle, the robot drives into it: a constant step does not shrink.
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats

from .potentials import Field, attraction_at, direction, distance, repulsion_at

ROUNDING = 1e-9
"""Distances count as equal to a limit within this share of it: the printed example has a robot on the limit."""
HALVINGS = 80
"""Steps of bisection: more than a double has bits."""


def aligned(p: Floats, obstacle: Floats, goal: Floats, tolerance: float) -> Bools:
    """(...) whether an obstacle stands between a robot and its goal in one line ([Lee] Eq. 5.18).

    The equation holds, too, for a goal between robot and obstacle, where nothing is in the way: the
    goal must be the farther one of the two.

    Args:
        p: (..., 2) places of robots.
        obstacle: (..., 2) places of obstacles.
        goal: (..., 2) goals.
        tolerance: largest length of the difference of the two unit vectors; 0: they must be equal.
    """
    apart = distance(direction(p, obstacle), direction(p, goal))
    return np.asarray((apart <= tolerance) & (distance(p, goal) > distance(p, obstacle)))


def within_reach(rho: Floats, reach: Floats) -> Bools:
    """(...) whether obstacles at distances rho are within a step and the radii ([Lee] Eqs. 5.17 and 5.25)."""
    return np.asarray(rho <= reach * (1.0 + ROUNDING))


def zero_force_distance(behind: Floats, field: Field) -> Floats:
    """(...) delta, the distance from an obstacle at which the two forces on an aligned robot cancel ([Lee] Eq. 5.23).

    Args:
        behind: (...) distance of the goal behind the obstacle, at least 0.
        field: constants of the potentials.

    Returns:
        The distance, at most the influence: beyond it nothing pushes.  Between, the push falls and the pull does not,
        so that there is one such distance.
    """
    low = np.zeros(np.shape(behind))
    high = np.full(np.shape(behind), field.influence)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        pushed = repulsion_at(middle, field) > attraction_at(behind + middle, field)
        low, high = np.where(pushed, middle, low), np.where(pushed, high, middle)
    return np.asarray(0.5 * (low + high))


def prevented(p: Floats, obstacle: Floats, goal: Floats, reach: Floats, field: Field, tolerance: float) -> Bools:
    """(...) where the force is replaced by the unit vector away from the obstacle ([Lee] Eqs. 5.24 and 5.25).

    Args:
        p: (..., 2) places of robots.
        obstacle: (..., 2) points of obstacles from which distances are measured.
        goal: (..., 2) goals.
        reach: (...) s_r T_s + r_r + r_o.
        field: constants of the potentials.
        tolerance: of `aligned`.
    """
    near = within_reach(distance(p, obstacle), reach) & aligned(p, obstacle, goal, tolerance)
    if not near.any():
        return near
    # (5.25) replaces the force only if the two forces cancel within the reach
    return near & (zero_force_distance(distance(obstacle, goal), field) < reach)
