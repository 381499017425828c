"""Potentials of a goal and of obstacles, and the forces that they exert on a robot ([Lee] Sec. 5.2.2).

Places are (..., 2); arrays of places broadcast against each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats

LEAST = 1e-12
"""Distances count as at least this much, so that a robot on an obstacle's point has a finite force."""


class Field(NamedTuple):
    """Constants of the potentials ([Lee] Eqs. 5.9 and 5.10)."""

    attraction: float  # c_att, above 0
    repulsion: float  # c_rep, at least 0
    attraction_power: int  # m, at least 1
    repulsion_power: int  # n, at least 1
    influence: float  # rho_0: obstacles farther away exert no force


def distance(p: Floats, q: Floats) -> Floats:
    """(...) distances rho between places (..., 2)."""
    return np.asarray(np.hypot(p[..., 0] - q[..., 0], p[..., 1] - q[..., 1]))


def direction(p: Floats, q: Floats) -> Floats:
    """(..., 2) unit vectors from q to p, the gradient of their distance ([Lee] Eqs. 5.13, 5.14); 0 where p is q."""
    away = p - q
    length = np.hypot(away[..., 0], away[..., 1])[..., None]
    return np.asarray(np.where(length > 0.0, away / np.where(length > 0.0, length, 1.0), 0.0))


def attractive_potential(p: Floats, goal: Floats, field: Field) -> Floats:
    """(...) potential of the goal at places p ([Lee] Eq. 5.9)."""
    return np.asarray(field.attraction * distance(p, goal) ** field.attraction_power)


def repulsive_potential(p: Floats, obstacle: Floats, field: Field) -> Floats:
    """(...) potential of obstacles at places p ([Lee] Eq. 5.10); 0 beyond the influence."""
    rho = np.maximum(distance(p, obstacle), LEAST)
    excess = np.maximum(1.0 / rho - 1.0 / field.influence, 0.0)
    return np.asarray(field.repulsion * excess**field.repulsion_power)


def attractive_force(p: Floats, goal: Floats, field: Field) -> Floats:
    """(..., 2) force of the goal ([Lee] Eq. 5.11); it points to the goal, and is 0 on it."""
    return -attraction_at(distance(p, goal), field)[..., None] * direction(p, goal)


def repulsive_force(p: Floats, obstacle: Floats, field: Field) -> Floats:
    """(..., 2) force of each obstacle ([Lee] Eq. 5.12); it points away from the obstacle."""
    return repulsion_at(distance(p, obstacle), field)[..., None] * direction(p, obstacle)


def attraction_at(rho: Floats, field: Field) -> Floats:
    """(...) strength of the attractive force at distances from the goal."""
    m = field.attraction_power
    return np.asarray(m * field.attraction * rho ** (m - 1))


def repulsion_at(rho: Floats, field: Field) -> Floats:
    """(...) strength of the repulsive force at distances from an obstacle; 0 beyond the influence."""
    n, inverse = field.repulsion_power, 1.0 / np.maximum(rho, LEAST)
    excess = np.maximum(inverse - 1.0 / field.influence, 0.0)
    return np.asarray(np.where(rho <= field.influence, n * field.repulsion * excess ** (n - 1) * inverse**2, 0.0))
