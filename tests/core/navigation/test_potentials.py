"""Forces are the negative gradients of the potentials; limits of the influence."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.navigation.forces import (
    Field,
    attractive_force,
    attractive_potential,
    direction,
    repulsive_force,
    repulsive_potential,
)

PRINTED = Field(0.5, 5.0, 2, 2, influence=10.0)
FIELDS = [Field(0.5, 5.0, m, n, influence=10.0) for m in (1, 2, 3) for n in (1, 2, 3)]


def gradient(potential, p: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Central differences of a potential at (N, 2) places."""
    shifts = step * np.eye(2)
    return np.stack([(potential(p + s) - potential(p - s)) / (2.0 * step) for s in shifts], axis=-1)


@pytest.mark.parametrize("field", FIELDS)
def test_forces_are_negative_gradients_of_the_potentials(field: Field):
    rng = np.random.default_rng(1)
    goal, obstacle = np.array([6.0, 6.0]), np.array([8.0, 8.0])
    p = rng.uniform(0.0, 20.0, (200, 2))
    rho = np.hypot(*(p - obstacle).T)
    p = p[(rho > 0.3) & (np.abs(rho - field.influence) > 0.01) & (np.hypot(*(p - goal).T) > 0.3)]
    attracted = gradient(lambda at: attractive_potential(at, goal, field), p)
    repelled = gradient(lambda at: repulsive_potential(at, obstacle, field), p)
    np.testing.assert_allclose(attractive_force(p, goal, field), -attracted, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(repulsive_force(p, obstacle, field), -repelled, rtol=1e-5, atol=1e-7)


def test_forces_of_the_printed_example_are_those_of_its_formulas():
    """[Lee] Eqs. 5.21 and 5.22: -rho, and 10 (1/rho - 1/10) / rho^2."""
    p = np.array([9.0, 9.0])
    near, far = np.sqrt(2.0), np.sqrt(18.0)
    out = np.array([1.0, 1.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(attractive_force(p, np.array([6.0, 6.0]), PRINTED), -far * out)
    push = 10.0 * (1.0 / near - 0.1) / near**2
    np.testing.assert_allclose(repulsive_force(p, np.array([8.0, 8.0]), PRINTED), push * out)


def test_obstacles_repel_up_to_their_influence_and_no_farther():
    linear = PRINTED._replace(repulsion_power=1)
    at, beyond = np.array([[10.0, 0.0]]), np.array([[np.nextafter(10.0, 11.0), 0.0]])
    origin = np.zeros(2)
    assert repulsive_force(at, origin, linear)[0, 0] == pytest.approx(0.05)
    np.testing.assert_array_equal(repulsive_force(beyond, origin, linear), 0.0)
    np.testing.assert_array_equal(repulsive_potential(beyond, origin, PRINTED), 0.0)


def test_a_robot_on_its_goal_or_on_an_obstacle_has_finite_forces():
    here = np.array([3.0, 4.0])
    np.testing.assert_array_equal(direction(here, here), 0.0)
    for field in FIELDS:
        np.testing.assert_array_equal(attractive_force(here, here, field), 0.0)
        np.testing.assert_array_equal(repulsive_force(here, here, field), 0.0)


def test_places_and_obstacles_broadcast():
    p, obstacles = np.zeros((3, 1, 2)), np.ones((4, 2))
    assert repulsive_force(p, obstacles, PRINTED).shape == (3, 4, 2)
    assert attractive_potential(p, obstacles, PRINTED).shape == (3, 4)
