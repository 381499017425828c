"""What decides on a robot's next step, at the places of the printed example."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.navigation.forces import Field
from occlog.core.navigation.steering import NearbyObstacles, Steering, SteeringState, StepRules, steer

FIELD = Field(0.5, 5.0, 2, 2, influence=10.0)
GOAL, OBSTACLE = np.array([[6.0, 6.0]]), np.array([[[8.0, 8.0]]])
OUT = np.array([1.0, 1.0]) / math.sqrt(2.0)
NONE = np.full((1, 2), np.nan)
STEPS = StepRules(way=math.sqrt(2.0), radius=0.0, prevent=True, escape="none", side="left", aligned=0.1, opposite=0.05)


def around(radius: float = 0.0) -> NearbyObstacles:
    return NearbyObstacles(nearest=OBSTACLE, radius=np.array([radius]), size=np.array([radius]), way=np.zeros(1))


def steered(at: float, steps: StepRules = STEPS, previous: np.ndarray = NONE, radius: float = 0.0) -> Steering:
    """At (at, at) on the diagonal."""
    return steer(np.array([[at, at]]), GOAL, around(radius), FIELD, steps, previous)


def test_the_total_force_of_the_printed_example_leads_to_the_obstacle_up_to_8_9():
    """[Lee] Fig. 5-26 (c): negative from (14, 14) to (8.9, 8.9); exactly, to (8.9082, 8.9082)."""
    original = STEPS._replace(prevent=False)
    along = {at: float(steered(at, original).total[0] @ OUT) for at in (14.0, 12.0, 9.0, 8.9083, 8.9082, 8.5)}
    assert [value < 0.0 for value in along.values()] == [True, True, True, True, False, False]


def test_a_collision_is_prevented_one_step_before_the_obstacle():
    """[Lee] Eq. 5.24: at (9, 9) the force leads back to (10, 10), at (10, 10) it does not."""
    near, far = steered(9.0), steered(10.0)
    assert near.state[0] == SteeringState.PREVENT
    np.testing.assert_allclose(near.total[0], OUT)
    assert far.state[0] == SteeringState.FREE
    assert float(far.total[0] @ OUT) < 0.0


def test_radii_widen_the_region():
    """[Lee] Eq. 5.25."""
    wide = STEPS._replace(radius=0.75)
    assert steered(10.0, wide, radius=0.65).state[0] == SteeringState.FREE
    assert steered(10.0, wide, radius=0.70).state[0] == SteeringState.PREVENT


def test_oscillation_is_recognised_and_distinguished_from_escapes():
    toward = -OUT[None]
    plain = steered(9.0, previous=toward)
    assert plain.recognised[0]
    assert plain.state[0] == SteeringState.PREVENT
    away = steered(10.0, previous=OUT[None])
    assert (away.recognised[0], away.state[0]) == (True, SteeringState.OSCILLATING)


def test_the_escape_inside_turns_by_a_right_angle():
    escape = STEPS._replace(escape="inside")
    done = steered(9.0, escape, previous=-OUT[None])
    assert done.state[0] == SteeringState.ESCAPING
    np.testing.assert_allclose(done.total[0], [-OUT[1], OUT[0]])
    right = steered(9.0, escape._replace(side="right"), previous=-OUT[None])
    np.testing.assert_allclose(right.total[0], [OUT[1], -OUT[0]])


def test_the_escape_inside_waits_until_the_robot_is_inside():
    waiting = steered(10.0, STEPS._replace(escape="inside"), previous=OUT[None])
    assert waiting.state[0] == SteeringState.OSCILLATING


def test_the_escape_outside_turns_by_the_largest_angle_of_its_range():
    escape = STEPS._replace(escape="outside", radius=0.2)
    plain = steered(10.0, STEPS._replace(radius=0.2), previous=OUT[None], radius=0.2)
    done = steered(10.0, escape, previous=OUT[None], radius=0.2)
    assert done.state[0] == SteeringState.ESCAPING
    angle = math.atan2(*np.flip(done.total[0])) - math.atan2(*np.flip(plain.total[0]))
    assert angle == pytest.approx(math.asin(0.4 / (math.sqrt(2.0) + 0.4)))
    assert np.hypot(*done.total[0]) == pytest.approx(np.hypot(*plain.total[0]))


def test_a_point_never_escapes_outside():
    done = steered(10.0, STEPS._replace(escape="outside"), previous=OUT[None])
    assert done.state[0] == SteeringState.OSCILLATING


def test_the_escape_outside_is_for_robots_within_a_step_of_the_region():
    escape = STEPS._replace(escape="outside", radius=0.2)
    assert steered(10.4, escape, OUT[None], radius=0.2).state[0] == SteeringState.OSCILLATING
    assert steered(10.2, escape, OUT[None], radius=0.2).state[0] == SteeringState.ESCAPING


def test_a_free_side_is_the_one_farther_from_other_obstacles():
    other = np.array([[[8.0, 8.0], [8.0, 11.0]]])
    flat = np.zeros(2)
    beside = NearbyObstacles(nearest=other, radius=flat, size=flat, way=flat)
    escape = STEPS._replace(escape="inside", side="free", aligned=0.5)
    done = steer(np.array([[9.0, 9.0]]), GOAL, beside, FIELD, escape, -OUT[None])
    assert done.state[0] == SteeringState.ESCAPING
    assert done.total[0, 1] < 0.0 < done.total[0, 0]


def test_forces_of_several_obstacles_add_up_and_none_leave_the_attraction():
    twice = NearbyObstacles(
        nearest=np.repeat(OBSTACLE, 2, axis=1), radius=np.zeros(2), size=np.zeros(2), way=np.zeros(2)
    )
    once = steered(12.0).repulsive
    np.testing.assert_allclose(steer(np.array([[12.0, 12.0]]), GOAL, twice, FIELD, STEPS, NONE).repulsive, 2.0 * once)
    flat = np.zeros(0)
    alone = NearbyObstacles(nearest=np.zeros((1, 0, 2)), radius=flat, size=flat, way=flat)
    done = steer(np.array([[12.0, 12.0]]), GOAL, alone, FIELD, STEPS._replace(escape="inside"), OUT[None])
    np.testing.assert_array_equal(done.total, done.attractive)
    assert done.state[0] == SteeringState.OSCILLATING
