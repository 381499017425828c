"""Potentials of a goal and of obstacles, and the forces that they exert on a robot ([Lee] Sec. 5.2.2).

Positions are (..., 2); arrays of positions broadcast against each other.

Collisions by aligned robot, obstacle and goal (CAROG), and the force that prevents them ([Lee] Sec. 5.2.2).

A robot aligned with an obstacle and the goal behind it is attracted and repelled along one line. If attraction is
stronger up to the last step before the obstacle, the robot collides, since the step length is constant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats

LEAST = 1e-12
"""Distances count as at least this much, so that a robot on an obstacle's point has a finite force."""


class Field(NamedTuple):
    """Constants of the potential field ([Lee] Eqs. 5.9 and 5.10)."""

    attraction: float  # c_att, above 0
    repulsion: float  # c_rep, at least 0
    attraction_power: int  # m, at least 1
    repulsion_power: int  # n, at least 1
    influence: float  # rho_0: obstacles farther away exert no force


def distance(p: Floats, q: Floats) -> Floats:
    """Return distances (...) between positions p and q (..., 2), which broadcast."""
    return np.asarray(np.hypot(p[..., 0] - q[..., 0], p[..., 1] - q[..., 1]))


def direction(p: Floats, q: Floats) -> Floats:
    """Return unit vectors (..., 2) from q to p, the gradient of their distance ([Lee] Eqs. 5.13, 5.14); 0 if p = q."""
    away = p - q
    length = np.hypot(away[..., 0], away[..., 1])[..., None]
    return np.asarray(np.where(length > 0.0, away / np.where(length > 0.0, length, 1.0), 0.0))


def attractive_potential(p: Floats, goal: Floats, field: Field) -> Floats:
    """Return the potential (...) of the goals (..., 2) at positions p (..., 2): c_att rho^m ([Lee] Eq. 5.9).

    rho is the distance; `field` has the constants c_att and m.
    """
    return np.asarray(field.attraction * distance(p, goal) ** field.attraction_power)


def repulsive_potential(p: Floats, obstacle: Floats, field: Field) -> Floats:
    """Return the potential (...) of obstacles at positions `p` (..., 2): c_rep (1 / rho - 1 / rho_0)^n ([Lee] 5.10).

    It is 0 for distances rho above rho_0. `obstacle` (..., 2) is the point of each obstacle from which distances are
    measured; `field` has the constants.
    """
    rho = np.maximum(distance(p, obstacle), LEAST)
    excess = np.maximum(1.0 / rho - 1.0 / field.influence, 0.0)
    return np.asarray(field.repulsion * excess**field.repulsion_power)


def attractive_force(p: Floats, goal: Floats, field: Field) -> Floats:
    """Return the force (..., 2) of the goals (..., 2) on robots at `p` (..., 2) ([Lee] Eq. 5.11).

    It is minus the gradient of the potential with the constants `field`: it points to the goal, and is 0 on it.
    """
    return -attraction_at(distance(p, goal), field)[..., None] * direction(p, goal)


def repulsive_force(p: Floats, obstacle: Floats, field: Field) -> Floats:
    """Return the force (..., 2) of each obstacle on robots at `p` (..., 2), away from the obstacle ([Lee] Eq. 5.12).

    `obstacle` (..., 2) is the point of each obstacle from which distances are measured. The force is 0 beyond the
    influence.
    """
    return repulsion_at(distance(p, obstacle), field)[..., None] * direction(p, obstacle)


def attraction_at(rho: Floats, field: Field) -> Floats:
    """Return the magnitude (...) of the attractive force at distances rho from the goal: m c_att rho^(m - 1)."""
    m = field.attraction_power
    return np.asarray(m * field.attraction * rho ** (m - 1))


def repulsion_at(rho: Floats, field: Field) -> Floats:
    """Return the magnitude (...) of the repulsive force at distances rho from an obstacle; 0 beyond the influence."""
    n, inverse = field.repulsion_power, 1.0 / np.maximum(rho, LEAST)
    excess = np.maximum(inverse - 1.0 / field.influence, 0.0)
    return np.asarray(np.where(rho <= field.influence, n * field.repulsion * excess ** (n - 1) * inverse**2, 0.0))


ROUNDING = 1e-9
"""Distances count as equal to a limit within this share of it: the printed example has a robot on the limit."""
HALVINGS = 80
"""Steps of bisection: more than a double has bits."""


def aligned(p: Floats, obstacle: Floats, goal: Floats, tolerance: float) -> Bools:
    """Return a mask (...) of obstacles aligned between a robot and its goal ([Lee] Eq. 5.18).

    The equation also holds for a goal between robot and obstacle, which is excluded: the goal must be the farther one.

    Args:
        p: (..., 2) positions of robots.
        obstacle: (..., 2) positions of obstacles.
        goal: (..., 2) goals.
        tolerance: largest length of the difference of the two unit vectors; 0: they must be equal.
    """
    angle = distance(direction(p, obstacle), direction(p, goal))
    return np.asarray((angle <= tolerance) & (distance(p, goal) > distance(p, obstacle)))


def within_reach(rho: Floats, reach: Floats) -> Bools:
    """Return a mask (...) of obstacles at distances rho of at most `reach`, up to rounding ([Lee] Eqs. 5.17 and 5.25).

    `reach` (...) is the length of a step plus the radii of robot and obstacle.
    """
    return np.asarray(rho <= reach * (1.0 + ROUNDING))


def zero_force_distance(behind: Floats, field: Field) -> Floats:
    """Return delta (...), the distance from an obstacle at which forces on an aligned robot cancel ([Lee] Eq. 5.23).

    It is unique, since repulsion decreases with the distance from the obstacle and attraction does not; found by
    bisection, at most the influence distance.

    Args:
        behind: (...) distance of the goal behind the obstacle, at least 0.
        field: constants of the potentials.
    """
    low = np.zeros(np.shape(behind))
    high = np.full(np.shape(behind), field.influence)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        pushed = repulsion_at(middle, field) > attraction_at(behind + middle, field)
        low, high = np.where(pushed, middle, low), np.where(pushed, high, middle)
    return np.asarray(0.5 * (low + high))


def prevented(p: Floats, obstacle: Floats, goal: Floats, reach: Floats, field: Field, tolerance: float) -> Bools:
    """Return a mask (...) where the unit vector away from the obstacle replaces the force ([Lee] Eqs. 5.24 and 5.25).

    There, robot, obstacle and goal are in line, the obstacle is within reach, and the forces cancel only within the
    reach.

    Args:
        p: (..., 2) positions of robots.
        obstacle: (..., 2) points of obstacles from which distances are measured.
        goal: (..., 2) goals.
        reach: (...) length of a step plus the radii of robot and obstacle, s_r T_s + r_r + r_o.
        field: constants of the potentials.
        tolerance: largest difference of the unit vectors to obstacle and goal at which they are in line.
    """
    near = within_reach(distance(p, obstacle), reach) & aligned(p, obstacle, goal, tolerance)
    if not near.any():
        return near
    # (5.25) replaces the force only if the two forces cancel within the reach
    return near & (zero_force_distance(distance(obstacle, goal), field) < reach)
