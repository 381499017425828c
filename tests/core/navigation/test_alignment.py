"""Conditions of a collision by aligned robot, obstacle and goal, and the distance at which forces cancel."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.navigation.forces import (
    Field,
    aligned,
    attraction_at,
    prevented,
    repulsion_at,
    within_reach,
    zero_force_distance,
)

PRINTED = Field(0.5, 5.0, 2, 2, influence=10.0)
ORIGIN, GOAL = np.zeros(2), np.array([-2.0, 0.0])


def at(angle: float, radius: float = 1.0) -> np.ndarray:
    return radius * np.array([np.cos(angle), np.sin(angle)])


def test_the_forces_of_the_printed_example_cancel_at_1_2844():
    """The thesis rounds the place to (8.9, 8.9) and prints 1.27."""
    delta = float(zero_force_distance(np.array(np.sqrt(8.0)), PRINTED))
    assert delta == pytest.approx(1.2844478, abs=1e-7)
    assert 8.0 + delta / np.sqrt(2.0) == pytest.approx(8.9082418, abs=1e-7)


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_pull_and_push_are_equal_at_the_distance_unless_it_is_the_influence(m: int, n: int):
    field = Field(0.5, 5.0, m, n, influence=10.0)
    behind = np.array([0.0, 0.5, 3.0, 50.0])
    delta = zero_force_distance(behind, field)
    pull, push = attraction_at(behind + delta, field), repulsion_at(delta, field)
    inner = delta < field.influence * (1.0 - 1e-12)
    np.testing.assert_allclose(push[inner], pull[inner], rtol=1e-9)
    assert (repulsion_at(delta[~inner], field) >= pull[~inner] * (1.0 - 1e-9)).all()


def test_without_repulsion_forces_cancel_nowhere_but_on_the_obstacle():
    none = PRINTED._replace(repulsion=0.0)
    assert float(zero_force_distance(np.array(1.0), none)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("tolerance", "held"), [(0.0999, False), (0.1001, True)])
def test_alignment_holds_up_to_the_tolerance_on_unit_vectors(tolerance: float, held: bool):
    # The goal is so far that only the direction from the obstacle turns: a chord of 0.1
    robot = at(2.0 * np.arcsin(0.05))
    assert bool(aligned(robot, ORIGIN, np.array([-1e9, 0.0]), tolerance)) is held


def test_a_goal_before_the_obstacle_is_not_behind_it():
    robot, between = np.array([2.0, 0.0]), np.array([1.0, 0.0])
    assert not aligned(robot, ORIGIN, between, 0.1)
    assert aligned(robot, ORIGIN, GOAL, 0.0)


def test_reach_is_a_step_and_the_radii():
    rho = np.array([1.5, 1.5 * (1.0 + 1e-10), 1.5 * (1.0 + 1e-8)])
    np.testing.assert_array_equal(within_reach(rho, np.full(3, 1.5)), [True, True, False])


def test_the_force_is_replaced_only_where_forces_cancel_within_the_reach():
    goal = np.array([-np.sqrt(8.0), 0.0])
    robot = np.array([[1.2, 0.0]])
    assert prevented(robot, ORIGIN, goal, np.array([1.2845]), PRINTED, 0.0)[0]
    assert not prevented(robot, ORIGIN, goal, np.array([1.2844]), PRINTED, 0.0)[0]
    assert not prevented(np.array([[1.3, 0.0]]), ORIGIN, goal, np.array([1.2845]), PRINTED, 0.0)[0]
