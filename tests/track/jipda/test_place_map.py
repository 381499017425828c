"""Where people come from and leave."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.track.methods.jipda.target_set import (
    MIN_BIRTH_RATIO,
    birth_intensity,
    birth_velocity,
    empty_map,
    target_death_rate_at,
    update_map,
)

NONE = np.zeros((0, 2))
DOOR, HALL = np.array([[0.0, 0.0]]), np.array([[10.0, 5.0]])


def known(metre: float = 1.0):
    """A map of a hall where people stand, and of a door by which they come and leave."""
    out = empty_map(metre)
    for _ in range(50):
        out = update_map(out, 1.0, people=np.vstack([DOOR, HALL, HALL]) * metre, existence=np.ones(3),
                    left=DOOR * metre, came=DOOR * metre, velocity=np.array([[1.2, 0.0]]) * metre)  # fmt: skip
    return out


def test_nothing_is_known_at_first() -> None:
    empty = empty_map(1.0)
    np.testing.assert_allclose(target_death_rate_at(empty, HALL, 0.02), 0.02)
    everywhere, at = birth_intensity(empty, 0.005, 20.0)
    assert everywhere == 0.005
    assert len(at) == 0
    mean, covariance = birth_velocity(empty, HALL, 0.9)
    np.testing.assert_array_equal(mean, 0.0)
    np.testing.assert_allclose(covariance[0], 0.81 * np.eye(2))


@pytest.mark.parametrize("metre", [1.0, 100.0])
def test_people_leave_by_the_door_and_not_from_the_hall(metre: float) -> None:
    assert target_death_rate_at(known(metre), DOOR * metre, 0.3)[0] > 0.8
    assert target_death_rate_at(known(metre), HALL * metre, 0.3)[0] < 0.02


def test_people_come_by_the_door_with_the_velocity_of_those_before() -> None:
    learned = known()
    everywhere, at = birth_intensity(learned, 0.005, 20.0)
    assert everywhere == pytest.approx(0.005 * 20.0 / 70.0)
    # One a second, all of it around the door
    assert at.sum() * 2.0 * np.pi == pytest.approx(50.0 / 70.0)
    mean, covariance = birth_velocity(learned, DOOR, 0.9)
    assert mean[0, 0] == pytest.approx(1.2, abs=0.1)
    assert covariance[0, 0, 0] < 0.2


def test_arrivals_never_become_impossible() -> None:
    learned = empty_map(1.0)
    for _ in range(3):
        learned = update_map(learned, 1e4, people=NONE, existence=np.zeros(0), left=NONE, came=NONE, velocity=NONE)
    assert birth_intensity(learned, 0.005, 20.0)[0] == pytest.approx(MIN_BIRTH_RATIO * 0.005)
