"""Points inside half-planes, against linear programs."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import linprog

from occlog.track.methods.map.kernels.interior_point import move_inside
from occlog.track.methods.map.kernels.problem import NO_PLANES, HalfPlanes, join_planes, slack


def widest(normal, offset) -> float:
    """Greatest margin by which a point can hold all half-planes (at most 10)."""
    A = np.column_stack([-normal, np.ones(len(normal))])
    found = linprog([0, 0, -1], A_ub=A, b_ub=-offset, bounds=[(None, None), (None, None), (None, 10.0)])
    assert found.status == 0
    return float(found.x[2])


def random_planes(rng, T: int):
    """Up to eight half-planes of each of T states, about points of their own; many contradict each other."""
    count = rng.integers(0, 9, T)
    step = np.repeat(np.arange(T), count)
    angle = rng.uniform(-np.pi, np.pi, len(step))
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    about = 10.0 * rng.normal(size=(T, 2))
    return HalfPlanes(step, normal, np.einsum("mi,mi->m", normal, about[step]) + rng.uniform(-2.0, 1.0, len(step)))


@pytest.mark.parametrize("seed", range(2))
def test_room_is_found_where_there_is_some_and_contradictions_where_there_is_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, margin = 80, 0.1
    planes, X = random_planes(rng, T), 10.0 * rng.normal(size=(T, 4))
    moved, contradictory = move_inside(X, planes, margin)
    found = {True: 0, False: 0}
    for t in range(T):
        own = planes.step == t
        if not own.any():
            assert np.array_equal(moved[t], X[t])
            assert not contradictory[t]
            continue
        room = widest(planes.normal[own], planes.offset[own])
        gap = (slack(planes, moved)[own]).min()
        if room < 0.0:
            assert contradictory[t]
        elif room > 1e-4 * margin:
            assert not contradictory[t]
            assert gap > 0.2499 * min(margin, room)  # margins are tried in steps of four
        if not contradictory[t]:
            assert gap > 0.0
        found[bool(contradictory[t])] += 1
    assert min(found.values()) > 8
    assert np.array_equal(moved[:, 1::2], X[:, 1::2])  # velocities stay


def test_states_inside_stay_and_the_margin_is_held() -> None:
    X = np.array([[0.0, 1.0, 0.0, 2.0], [5.0, 0.0, 0.0, 0.0]])
    planes = HalfPlanes(np.array([0, 1]), np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([-1.0, -4.0]))
    moved, contradictory = move_inside(X, planes, 0.5)
    assert np.array_equal(moved[0], X[0])
    assert not contradictory.any()
    assert 3.0 < moved[1, 0] <= 3.5
    assert_allclose(moved[1, 1:], X[1, 1:])
    assert X[1, 0] == 5.0  # the argument is left alone


def test_a_narrow_strip_takes_a_smaller_margin_and_none_is_a_contradiction() -> None:
    for width, possible in ((0.3, True), (1e-3, True), (0.0, False), (-0.1, False)):
        planes = HalfPlanes(np.array([0, 0]), np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([2.0, -2.0 - width]))
        moved, contradictory = move_inside(np.zeros((1, 4)), planes, 1.0)
        assert contradictory[0] != possible
        if possible:
            assert slack(planes, moved).min() > 0.0


@pytest.mark.parametrize("degrees", [0.1, 1.0, 30.0])
def test_the_room_of_a_narrow_wedge_is_found(degrees: float) -> None:
    """Two cameras back to back that are not quite parallel: there is room, but far away."""
    a = np.radians(degrees)
    planes = HalfPlanes(np.array([0, 0]), np.array([[0.0, 1.0], [np.sin(a), -np.cos(a)]]), np.array([1.0, 1.0]))
    moved, contradictory = move_inside(np.zeros((1, 4)), planes, 0.1)
    assert not contradictory[0]
    assert_allclose(slack(planes, moved).min(), 0.1, rtol=0.1)
    walls = HalfPlanes(np.array([0]), np.array([[-1.0, 0.0]]), np.array([-1.0]))  # x < 1
    _, contradictory = move_inside(np.zeros((1, 4)), join_planes(planes, walls), 0.1)
    assert contradictory[0]


def test_nothing_to_hold() -> None:
    X = np.arange(8.0).reshape(2, 4)
    moved, contradictory = move_inside(X, NO_PLANES, 1.0)
    assert np.array_equal(moved, X)
    assert not contradictory.any()
