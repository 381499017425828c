import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import LineString, Point, Polygon

from occlog.core import plane as geo

SQUARE = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
L_ROOM = np.array([[0.0, 0.0], [160.0, 0.0], [160.0, 53.0], [53.0, 53.0], [53.0, 160.0], [0.0, 160.0]])


def star(seed: int, corners: int) -> np.ndarray:
    """A simple polygon that is not convex: random radii at rising angles."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners)) + np.linspace(0, 0.01, corners)
    radius = rng.uniform(5, 50, corners)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


@pytest.mark.parametrize("seed", range(8))
def test_inside_and_sight_agree_with_shapely(seed):
    polygon = star(seed, 3 + seed)
    shape = Polygon(polygon)
    if not shape.is_valid:
        shape = shape.buffer(0)
    points = np.random.default_rng(seed + 100).uniform(-60, 60, (300, 2))
    inside = geo.inside_polygon(points, polygon)
    assert inside.tolist() == [shape.contains(Point(p)) for p in points]
    origin = np.array([-55.0, 13.0])
    blocked = geo.line_of_sight_blocked(origin, points, polygon)
    want = [LineString([origin, p]).intersection(shape).length > 1e-9 for p in points]
    assert blocked.tolist() == want
    assert blocked[inside].all()


def test_winding_does_not_matter():
    points = np.random.default_rng(0).uniform(0, 160, (500, 2))
    origin = np.array([3.0, 150.0])
    assert (geo.inside_polygon(points, L_ROOM) == geo.inside_polygon(points, L_ROOM[::-1].copy())).all()
    assert (
        geo.line_of_sight_blocked(origin, points, L_ROOM)
        == geo.line_of_sight_blocked(origin, points, L_ROOM[::-1].copy())
    ).all()


@pytest.mark.parametrize(
    ("start", "end", "blocked"),
    [
        ((30, 40), (70, 40), False),  # along an edge
        ((30, 30), (70, 70), True),  # through two corners and the middle
        ((30, 50), (50, 30), False),  # touches one corner
        ((20, 40), (40, 40), False),  # ends on a corner
        ((30, 50), (40, 50), False),  # ends on the near border
        ((30, 50), (60, 50), True),  # ends on the far border
        ((30, 50), (41, 50), True),  # ends inside
        ((50, 50), (51, 51), True),  # wholly inside
        ((40, 50), (20, 50), False),  # from the border outwards
        ((40, 50), (50, 40), True),  # from border to border through the inside
        ((40, 40), (60, 60), True),  # corner to corner through the inside
        ((40, 40), (60, 40), False),  # an edge itself
        ((0, 0), (30, 90), False),  # passes by
    ],
)
def test_segment_that_touches_a_square(start, end, blocked):
    for a, b in ((start, end), (end, start)):
        got = geo.line_of_sight_blocked(np.array(a, dtype=float), np.array([b], dtype=float), SQUARE)
        assert got[0] == blocked


def test_segment_over_a_notch_touching_its_corners_is_free():
    notch = np.array([[0.0, 0.0], [6, 0], [6, 2], [4, 2], [4, 1], [2, 1], [2, 2], [0, 2]])
    assert not geo.segment_blocked(-1.0, 2.0, 7.0, 2.0, notch)
    assert geo.segment_blocked(2.5, 1.5, 2.5, 0.5, notch)
    assert not geo.segment_blocked(2.0, 1.5, 4.0, 1.5, notch)  # inside the notch, from wall to wall
    assert geo.segment_blocked(2.0, 1.5, 1.0, 1.5, notch)


@given(st.integers(0, 10_000), st.integers(3, 9))
def test_distance_to_boundary_is_the_least_distance_to_sampled_border_points(seed, corners):
    polygon = star(seed, corners)
    x, y = np.random.default_rng(seed).uniform(-60, 60, 2)
    s = np.linspace(0, 1, 401)[:, None]
    samples = np.concatenate([p + s * (q - p) for p, q in zip(polygon, np.roll(polygon, -1, 0), strict=True)])
    sampled = np.hypot(samples[:, 0] - x, samples[:, 1] - y).min()
    exact = geo.distance_to_boundary(x, y, polygon)
    spacing = 100 / 400
    assert exact <= sampled + 1e-9
    assert sampled <= exact + spacing


def test_area_and_winding():
    assert geo.signed_area(SQUARE) == 400
    assert geo.signed_area(SQUARE[::-1]) == -400
    assert geo.signed_area(L_ROOM + 1e6) == pytest.approx(160 * 53 + 53 * 107)
    assert geo.signed_area(geo.counter_clockwise(SQUARE[::-1])) == 400


def test_packed_polygons_are_found_again():
    vertices, starts = geo.pack_polygons([SQUARE, L_ROOM])
    assert (vertices[starts[1] : starts[2]] == L_ROOM).all()
    vertices, starts = geo.pack_polygons([])
    assert vertices.shape == (0, 2)
    assert starts.tolist() == [0]
