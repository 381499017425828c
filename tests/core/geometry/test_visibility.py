"""Visibility kernels against the plain geometry kernels, which have tests of their own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import LineString, Point

from occlog.core.geometry.visibility import behind_objects, behind_walls, in_view, make_sensors, seen_from
from occlog.core.plane import line_of_sight_blocked

WALLS = {
    "square": np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]]),
    "clockwise triangle": np.array([[2.0, 7.0], [3.0, 9.0], [5.0, 7.5]]),
    "hook": np.array([[7.0, 1.0], [9.0, 1.0], [9.0, 4.0], [8.5, 4.0], [8.5, 1.5], [7.5, 1.5], [7.5, 4.0], [7.0, 4.0]]),
    "sliver": np.array([[1.0, 1.0], [3.0, 5.0], [3.0, 5.01]]),
}


def slowly(xy, position, yaw, fov, reach, walls):
    dx, dy = xy[:, 0] - position[0], xy[:, 1] - position[1]
    h, d = -np.sin(yaw) * dx + np.cos(yaw) * dy, np.cos(yaw) * dx + np.sin(yaw) * dy
    seen = in_view(h, d, fov, reach)
    for wall in walls:
        seen &= ~line_of_sight_blocked(position, xy, wall)
    return seen


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("fov_deg", [20.0, 90.0, 179.0, 200.0, 360.0])
def test_what_is_seen_agrees_with_the_plain_geometry(seed, fov_deg):
    rng = np.random.default_rng(seed)
    walls = list(WALLS.values())
    position, yaw, reach = rng.uniform(-2, 12, 2), rng.uniform(-np.pi, np.pi), rng.choice([6.0, np.inf])
    fov = np.radians(fov_deg)
    xy = np.ascontiguousarray(rng.uniform(-3, 13, (1000, 2)))
    sensors = make_sensors(position[None], np.array([yaw]), np.array([fov]), np.array([reach]), [walls])
    np.testing.assert_array_equal(seen_from(xy, 0, sensors), slowly(xy, position, yaw, fov, reach, walls))


@given(
    x=st.integers(-2, 12),
    y=st.integers(-2, 12),
    name=st.sampled_from(sorted(WALLS)),
    px=st.integers(-4, 26),
    py=st.integers(-4, 26),
)
def test_quick_tests_of_walls_never_change_the_answer(x, y, name, px, py):
    # A grid puts places on edges, corners, and sight lines along walls.
    position, xy = np.array([x, y], dtype=float), np.array([[px, py]]) / 2.0
    sensors = make_sensors(position[None], np.zeros(1), np.full(1, np.nan), np.full(1, np.inf), [[WALLS[name]]])
    assert seen_from(xy, 0, sensors)[0] == (not line_of_sight_blocked(position, xy, WALLS[name])[0])


def test_a_sensor_without_an_axis_sees_all_around_within_its_range():
    sensors = make_sensors(np.zeros((1, 2)), np.zeros(1), np.full(1, np.nan), np.array([5.0]), [[]])
    xy = np.array([[-4.9, 0.0], [0.0, 0.0], [0.0, -5.1], [3.0, 4.0]])
    assert seen_from(xy, 0, sensors).tolist() == [True, True, False, True]


def test_nothing_behind_a_camera_is_seen_whatever_its_field_of_view():
    xy = np.array([[0.0, 1.0], [-1e-12, 3.0], [1e-12, 3.0], [-2.0, 0.5]])
    sensors = make_sensors(np.zeros((1, 2)), np.zeros(1), np.array([2 * np.pi]), np.full(1, np.inf), [[]])
    assert seen_from(xy, 0, sensors).tolist() == [False, False, True, False]


def test_each_sensor_has_walls_of_its_own():
    square = WALLS["square"]
    at = np.array([[0.0, 5.0], [0.0, 5.0], [10.0, 5.0]])
    sensors = make_sensors(
        at, np.array([0.0, 0.0, np.pi]), np.full(3, 1.0), np.full(3, np.inf), [[square], [], [square]]
    )
    xy = np.array([[8.0, 5.0], [2.0, 5.0]])
    assert [seen_from(xy, i, sensors).tolist() for i in range(3)] == [[False, True], [True, True], [True, False]]


def test_the_limits_of_range_and_field_of_view_are_seen():
    ahead = make_sensors(np.zeros((1, 2)), np.zeros(1), np.array([np.pi / 2]), np.array([5.0]), [[]])
    xy = np.array([[5.0, 0.0], [5.0 + 1e-9, 0.0], [2.0, 2.0 - 1e-9], [2.0, 2.0 + 1e-9], [2.0, 1e-9 - 2.0], [0.0, 0.0]])
    assert seen_from(xy, 0, ahead).tolist() == [True, False, True, False, True, False]


def test_a_place_on_the_near_side_of_a_wall_is_seen_and_one_just_behind_it_is_not():
    sensors = make_sensors(
        np.array([[0.0, 5.0]]), np.zeros(1), np.array([1.0]), np.array([np.inf]), [[WALLS["square"]]]
    )
    xy = np.array([[4.0, 5.0], [4.0 + 1e-6, 5.0], [6.0 + 1e-6, 5.0]])
    assert seen_from(xy, 0, sensors).tolist() == [True, False, False]


@pytest.mark.parametrize("seed", range(5))
def test_an_object_hides_when_its_centre_is_in_the_rectangle_of_fig_3(seed):
    rng = np.random.default_rng(seed)
    xy, others = rng.uniform(-20, 20, (60, 2)), rng.uniform(-20, 20, (60, 9, 2))
    origin, diameter = rng.uniform(-20, 20, 2), 3.33
    want = []
    for x, group in zip(xy, others, strict=True):
        rectangle = LineString([origin, x]).buffer(diameter / 2, cap_style="flat")
        want.append(any(rectangle.contains(Point(c)) for c in group))
    assert behind_objects(origin, xy, others, diameter).tolist() == want
    assert 0 < sum(want) < 60


def test_absent_objects_hide_nothing():
    others = np.full((3, 2, 2), np.nan)
    assert not behind_objects(np.zeros(2), np.ones((3, 2)), others, 5.0).any()
    assert not behind_objects(np.zeros(2), np.ones((3, 2)), np.empty((3, 0, 2)), 5.0).any()


def test_field_of_view_range_and_behind():
    h = np.array([0.0, 1.0, 1.01, -1.0, 0.0, 0.0, np.nan])
    d = np.array([5.0, 1.0, 1.0, 1.0, -5.0, 11.0, 1.0])
    assert in_view(h, d, np.pi / 2, 10.0).tolist() == [True, True, False, True, False, False, False]


def test_the_limits_of_field_of_view_and_range_are_seen():
    assert in_view(np.array([3.0]), np.array([4.0]), np.pi, 5.0).all()
    assert not in_view(np.array([3.0]), np.array([4.0]), np.pi, np.nextafter(5.0, 0.0)).any()
    assert in_view(np.tan(0.25) * np.ones(1), np.ones(1), 0.5 + 1e-9, np.inf).all()
    assert not in_view(np.tan(0.25) * np.ones(1), np.ones(1), 0.5 - 1e-9, np.inf).any()
    assert not in_view(np.ones(1), np.zeros(1), 2.0 * np.pi, np.inf).any()


def test_an_object_on_the_border_of_the_rectangle_hides_nothing():
    point, diameter = np.array([[10.0, 0.0]]), 2.0
    inside = [(5.0, 0.999), (5.0, -0.999), (1e-9, 0.0), (10.0 - 1e-9, 0.0)]
    border = [(5.0, 1.0), (5.0, -1.0), (0.0, 0.0), (10.0, 0.0)]
    for centre in inside:
        assert behind_objects(np.zeros(2), point, np.array([[centre]]), diameter).all()
    for centre in border:
        assert not behind_objects(np.zeros(2), point, np.array([[centre]]), diameter).any()


def test_any_wall_hides():
    walls = [
        np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]]),
        np.array([[3.0, -1.0], [4.0, -1.0], [4.0, 1.0]]),
    ]
    points = np.array([[3.0, 3.0], [0.0, 3.0], [6.0, 0.0]])
    assert behind_walls(np.zeros(2), points, walls).tolist() == [True, False, True]
    assert not behind_walls(np.zeros(2), points, []).any()
