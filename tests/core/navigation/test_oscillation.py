"""Recognition of oscillation, ranges of the distance and of the angle of escape."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.navigation.steering import (
    angle_at,
    angle_inside,
    angle_outside,
    distance_inside,
    distance_outside,
    opposite,
    turned,
)

WAY = math.sqrt(2.0)


@pytest.mark.parametrize(("tolerance", "held"), [(0.0499, False), (0.0501, True)])
def test_forces_are_opposite_up_to_the_tolerance_on_the_cosine(tolerance: float, held: bool):
    angle = math.acos(-0.95)
    before, now = np.array([[3.0, 0.0]]), 7.0 * np.array([[math.cos(angle), math.sin(angle)]])
    assert bool(opposite(before, now, tolerance)[0]) is held


def test_the_printed_equality_holds_for_exactly_opposite_forces_alone():
    before = np.array([[1.0, 0.0], [1.0, 0.0]])
    now = np.array([[-2.0, 0.0], [-2.0, 1e-7]])
    np.testing.assert_array_equal(opposite(before, now, 0.0), [True, False])


def test_a_first_force_or_none_at_all_is_never_opposite():
    before = np.array([[np.nan, np.nan], [0.0, 0.0]])
    assert not opposite(before, np.array([[1.0, 0.0], [1.0, 0.0]]), 0.05).any()


def test_ranges_of_the_distance_meet_at_the_region_of_the_prevention():
    """[Lee] Eqs. 5.27 and 5.28."""
    assert distance_inside(WAY, 0.4) == (0.0, WAY + 0.4)
    assert distance_outside(WAY, 0.4) == (WAY + 0.4, 2.0 * WAY + 0.4)


@pytest.mark.parametrize("radii", [0.1, 0.4, 1.0])
def test_ranges_of_the_angle_are_the_angles_at_the_ends_of_the_distance(radii: float):
    """[Lee] Eqs. 5.31 and 5.32; the largest angle belongs to the smallest distance."""
    inside, outside = angle_inside(WAY, radii), angle_outside(WAY, radii)
    assert inside.low == outside.high == angle_at(distance_outside(WAY, radii).low, radii)
    assert outside.low == angle_at(distance_outside(WAY, radii).high, radii)
    assert inside.high == pytest.approx(math.pi / 2) == angle_at(radii, radii)
    assert outside.low < outside.high < inside.high


def test_a_robot_that_touches_an_obstacle_turns_by_a_right_angle_at_most():
    assert angle_at(0.5, 1.0) == pytest.approx(math.pi / 2)


def test_turned_forces_keep_their_length_and_turn_to_the_left():
    force = np.array([[3.0, 0.0], [0.0, 2.0]])
    np.testing.assert_allclose(turned(force, np.full(2, math.pi / 2)), [[0.0, 3.0], [-2.0, 0.0]], atol=1e-12)
