"""Shadows, rotations and dashes against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.sight.camera import rotation_from_angles
from occlog.examine.viewers.people import Crowd, Palette, Person
from occlog.examine.viewers.plan import shadow
from occlog.examine.viewers.sensors import quaternion
from occlog.examine.viewers.shapes import dashes, triangles
from occlog.records.scene import Scene

SQUARE = np.array([[2.0, -0.25], [2.5, -0.25], [2.5, 0.25], [2.0, 0.25]])
WIDE = Scene(room=np.array([[-1.0, -20.0], [40.0, -20.0], [40.0, 20.0], [-1.0, 20.0]]))


def test_a_shadow_ends_where_the_floor_is_seen_over_the_top() -> None:
    # From 3 up over a top at 1.5 the floor is met at twice the distance
    found = shadow(np.array([0.0, 0.0, 3.0]), SQUARE, 1.5, WIDE, 1.0)
    assert found is not None
    np.testing.assert_allclose([found[:, 0].min(), found[:, 0].max(), found[:, 1].max()], [2.0, 5.0, 0.5])


@pytest.mark.parametrize("eye", [1.0, 1.5])
def test_a_shadow_from_below_the_top_ends_at_the_wall(eye: float) -> None:
    found = shadow(np.array([0.0, 0.0, eye]), SQUARE, 1.5, WIDE, 1.0)
    assert found is not None
    assert found[:, 0].max() == pytest.approx(40.0)
    assert found[:, 1].max() == pytest.approx(40.0 * 0.25 / 2.0)


def test_a_camera_inside_throws_no_shadow() -> None:
    assert shadow(np.array([2.2, 0.0, 1.0]), SQUARE, 1.5, WIDE, 1.0) is None


@pytest.mark.parametrize("angles", [(0.3, -0.2, 0.1), (np.pi, 0.0, 0.0), (-2.0, 1.4, 3.0), (0.0, 0.0, np.pi)])
def test_quaternions_turn_as_their_matrices_do(angles: tuple[float, float, float]) -> None:
    rotation = rotation_from_angles(*angles)
    x, y, z, w = quaternion(rotation)
    axis, v = np.array([x, y, z]), np.array([0.3, -1.0, 2.0])
    turned = v + 2.0 * np.cross(axis, np.cross(axis, v) + w * v)
    np.testing.assert_allclose(turned, rotation @ v, atol=1e-12)
    assert np.hypot(np.linalg.norm(axis), w) == pytest.approx(1.0)


def test_dashes_cover_half_of_a_way() -> None:
    ends = dashes(np.array([[0.0, 0.0], [10.0, 0.0]]), 0.5).reshape(-1, 2, 2)
    assert len(ends) == 10
    np.testing.assert_allclose(ends[:, 1, 0] - ends[:, 0, 0], 0.5)


def test_triangles_cover_a_polygon_that_is_not_convex() -> None:
    corners = triangles(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]]), 0.5).reshape(-1, 3, 3)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert 0.5 * np.abs(np.cross(a, b)[:, 2]).sum() == pytest.approx(16.0 - 6.0)
    assert (corners[:, :, 2] == 0.5).all()


def person(t_ns: int, target: int) -> Person:
    return Person(t_ns, target, np.array([t_ns / 1e9, 0.0]), np.eye(2), 0.0, 1.7, 0.5, None, "")


def test_the_crowd_forgets_who_has_gone_and_old_trails() -> None:
    crowd = Crowd(Palette([1, 2]))
    crowd.add([person(0, 2)])
    for k in range(200):
        crowd.add([person(k * 10**8, 1)])
    assert [p.target for p in crowd.at(199 * 10**8)] == [1]
    assert crowd.find(2) is None
    trail = crowd.trail(1)
    assert trail[0, 0] == pytest.approx(14.9)
    assert len(trail) == 51
