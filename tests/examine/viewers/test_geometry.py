"""Shadows, rotations and dashes against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

from occlog.array_types import Floats
from occlog.core.geometry.camera import rotation_from_angles
from occlog.examine.viewers.drawings.foxglove import point_cloud
from occlog.examine.viewers.drawings.people import Palette, PeopleDrawing, PersonEstimate
from occlog.examine.viewers.drawings.shapes import DrawingGroup, Polyline, dashes, dense, triangles
from occlog.examine.viewers.drawings.world import shadows, walls
from occlog.io.formats.calibration.readers.ros import rotation_quaternion
from occlog.records.scene import Scene

SQUARE = np.array([[2.0, -0.25], [2.5, -0.25], [2.5, 0.25], [2.0, 0.25]])
WIDE = Scene(room=np.array([[-1.0, -20.0], [40.0, -20.0], [40.0, 20.0], [-1.0, 20.0]]))


def shadow(eye: tuple[float, float, float]) -> Floats | None:
    """Of a prism of 1.5 on the square."""
    (found,) = shadows(np.array([eye]), SQUARE[None], np.array([1.5]), walls(WIDE, 1.0))
    return found


def test_a_shadow_ends_where_the_floor_is_seen_over_the_top() -> None:
    # From 3 up over a top at 1.5 the floor is met at twice the distance
    found = shadow((0.0, 0.0, 3.0))
    assert found is not None
    np.testing.assert_allclose([found[:, 0].min(), found[:, 0].max(), found[:, 1].max()], [2.0, 5.0, 0.5])


@pytest.mark.parametrize("eye", [1.0, 1.5])
def test_a_shadow_from_below_the_top_ends_at_the_wall(eye: float) -> None:
    found = shadow((0.0, 0.0, eye))
    assert found is not None
    assert found[:, 0].max() == pytest.approx(40.0)
    assert found[:, 1].max() == pytest.approx(40.0 * 0.25 / 2.0)


def test_a_camera_inside_throws_no_shadow() -> None:
    assert shadow((2.2, 0.0, 1.0)) is None


def test_shadows_of_several_eyes_are_those_of_each_alone() -> None:
    eyes = np.array([[0.0, 0.0, 3.0], [2.2, 0.0, 1.0], [0.0, 0.0, 1.0], [9.0, 3.0, 2.0]])
    bases, heights = SQUARE + np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 2.0], [0.5, 0.0]])[:, None], np.full(4, 1.5)
    together = shadows(eyes, bases, heights, None)
    alone = [shadows(eyes[k : k + 1], bases[k : k + 1], heights[k : k + 1], None)[0] for k in range(4)]
    assert [found is None for found in together] == [False, True, False, False]
    for found, single in zip(together, alone, strict=True):
        np.testing.assert_array_equal(found, single)


@pytest.mark.parametrize("angles", [(0.3, -0.2, 0.1), (np.pi, 0.0, 0.0), (-2.0, 1.4, 3.0), (0.0, 0.0, np.pi)])
def test_quaternions_turn_as_their_matrices_do(angles: tuple[float, float, float]) -> None:
    rotation = rotation_from_angles(*angles)
    x, y, z, w = rotation_quaternion(rotation)
    axis, v = np.array([x, y, z]), np.array([0.3, -1.0, 2.0])
    turned = v + 2.0 * np.cross(axis, np.cross(axis, v) + w * v)
    np.testing.assert_allclose(turned, rotation @ v, atol=1e-12)
    assert np.hypot(np.linalg.norm(axis), w) == pytest.approx(1.0)


def test_dashes_cover_half_of_a_way() -> None:
    (found,) = dashes([np.array([[0.0, 0.0], [10.0, 0.0]])], 0.5)
    ends = found.reshape(-1, 2, 2)
    assert len(ends) == 10
    np.testing.assert_allclose(ends[:, 1, 0] - ends[:, 0, 0], 0.5)


def slowly(way: Floats, wanted: Floats) -> Floats:
    """Points at distances along one way, by `np.interp`."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    return np.column_stack([np.interp(wanted * along[-1], along, way[:, k]) for k in range(way.shape[1])])


def ways_of_several_sizes(axes: int) -> list[Floats]:
    rng = np.random.default_rng(axes)
    ways = [rng.normal(size=(k, axes)) for k in (2, 5, 2, 37, 3, 5)]
    still = rng.normal(size=axes)
    return [*ways, np.array([still, still]), np.array([still, still, still + 1.0, still + 1.0]), 100.0 * ways[3]]


@pytest.mark.parametrize("axes", [2, 3])
def test_points_along_many_ways_at_once_are_those_along_each(axes: int) -> None:
    ways = ways_of_several_sizes(axes)
    points, counts = dense(ways, 0.04, 400)
    assert (counts[6], counts[8]) == (2, 400)
    lengths = [np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in ways]
    np.testing.assert_array_equal(counts, np.clip(np.ceil(np.array(lengths) / 0.04) + 1, 2, 400))
    for way, found in zip(ways, np.split(points, np.cumsum(counts)[:-1]), strict=True):
        np.testing.assert_allclose(found, slowly(way, np.linspace(0.0, 1.0, len(found))), atol=1e-12)
        np.testing.assert_array_equal(found[[0, -1]], way[[0, -1]])


@pytest.mark.parametrize("axes", [2, 3])
def test_dashes_of_many_ways_at_once_are_those_of_each(axes: int) -> None:
    ways = ways_of_several_sizes(axes)
    for way, found in zip(ways, dashes(ways, 0.08), strict=True):
        count = len(found) // 2
        begins = np.arange(count) / count
        wanted = np.column_stack([begins, begins + 0.5 / count]).reshape(-1)
        np.testing.assert_allclose(found, slowly(way, wanted), atol=1e-12)
    assert dashes([], 0.08) == []


def test_triangles_cover_a_polygon_that_is_not_convex() -> None:
    corners = triangles(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]]), 0.5).reshape(-1, 3, 3)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert 0.5 * np.abs(np.cross(a, b)[:, 2]).sum() == pytest.approx(16.0 - 6.0)
    assert (corners[:, :, 2] == 0.5).all()


def person(t_ns: int, target: int) -> PersonEstimate:
    return PersonEstimate(t_ns, target, np.array([t_ns / 1e9, 0.0]), np.eye(2), 0.0, 1.7, 0.5, None, "")


def test_the_crowd_forgets_who_has_gone_and_old_trails() -> None:
    crowd = PeopleDrawing(Palette([1, 2]))
    crowd.add([person(0, 2)])
    for k in range(200):
        crowd.add([person(k * 10**8, 1)])
    assert [p.target for p in crowd.at(199 * 10**8)] == [1]
    assert crowd.find(2) is None
    trail = crowd.trail(1)
    assert trail[0, 0] == pytest.approx(14.9)
    assert len(trail) == 51


@pytest.mark.parametrize(("lines", "each"), [(1, 400), (100, 400), (400, 100), (20_000, 8)])
def test_of_very_many_lines_each_has_fewer_points(lines: int, each: int) -> None:
    long = Polyline(np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]]), (1.0, 0.0, 0.0, 1.0), 1.0)
    cloud = PointCloud.FromString(point_cloud([DrawingGroup("shadows", [long] * lines)], 0, "world"))
    assert len(cloud.data) == lines * each * cloud.point_stride
