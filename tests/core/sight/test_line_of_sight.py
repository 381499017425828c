import numpy as np
import pytest
from shapely.geometry import LineString, Point

from occlog.core.sight.line_of_sight import behind_objects, behind_walls, in_view


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
