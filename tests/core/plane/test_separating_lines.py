"""Lines between segments and polygons, and ways around polygons: shapely as reference."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from shapely.geometry import LineString, Point, Polygon

from occlog.core.plane import nearest_edge, offset, offset_point, route, separate, spread_along

SQUARE = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
L_SHAPE = np.array([[0.0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]])
WEDGE = np.array([[0.0, 0], [6, 0.5], [0, 1]])


def blob(rng, n: int):
    """A random convex polygon."""
    cloud = rng.normal(size=(n, 2))
    return np.ascontiguousarray(cloud[ConvexHull(cloud).vertices])


def widest_gap(a, b, polygon, angles: int = 20_000) -> float:
    """Largest width of a strip between segment and polygon over many directions."""
    phi = np.linspace(0, 2 * np.pi, angles, endpoint=False)
    n = np.column_stack([np.cos(phi), np.sin(phi)])
    return float(np.max(np.minimum(n @ a, n @ b) - np.max(n @ polygon.T, axis=1)))


@pytest.mark.parametrize("seed", range(4))
def test_a_gap_if_and_only_if_segment_and_polygon_are_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = blob(rng, 4 + 3 * seed)
    start, end = rng.normal(scale=2.0, size=(2, 300, 2))
    end[:100] = start[:100] + 0.2 * rng.normal(size=(100, 2))
    found, shape, both = separate(start, end, polygon), Polygon(polygon), 0
    for i in range(len(start)):
        away = LineString([start[i], end[i]]).distance(shape)
        assert (found.gap[i] > 0.0) == (away > 0.0)
        assert found.gap[i] <= away + 1e-12  # a strip between them cannot be wider than they are apart
        both |= 1 if away > 0.0 else 2
        n = found.normal[i]
        assert np.hypot(*n) == pytest.approx(1.0)
        assert found.support[i] == pytest.approx(np.max(polygon @ n))
        assert min(start[i] @ n, end[i] @ n) - found.support[i] == pytest.approx(found.gap[i], abs=1e-12)
    assert both == 3


def test_gap_is_the_distance_where_a_side_faces_the_other() -> None:
    """Beside an edge it is the distance, beyond a corner a bit less; overlaps are as deep as the best shift out."""
    cases = [
        ((2.0, -0.5), (3.0, 0.5), 1.0),  # next to the right edge
        ((-0.5, 1.5), (0.5, 1.5), 0.5),  # parallel to the upper edge
        ((3.0, 1.0), (1.0, 3.0), np.sqrt(2.0)),  # a corner faces the segment
        ((0.9, 0.0), (5.0, 0.0), -0.1),  # 0.1 inside
        ((-3.0, 0.0), (3.0, 0.0), -1.0),  # right through
        ((-5.0, 0.5), (5.0, 0.5), -0.5),
    ]
    start, end = (np.array([c[i] for c in cases]) for i in (0, 1))
    want = np.array([c[2] for c in cases])
    np.testing.assert_allclose(separate(start, end, SQUARE).gap, want, atol=1e-12)
    np.testing.assert_allclose(separate(end, start, SQUARE).gap, want, atol=1e-12)
    for a, b, gap in zip(start[:3], end[:3], want[:3], strict=True):
        assert LineString([a, b]).distance(Polygon(SQUARE)) == pytest.approx(gap)


@pytest.mark.parametrize("seed", range(3))
def test_depth_of_an_overlap_is_the_least_over_all_directions(seed: int) -> None:
    """Axes of edges and of the segment are all that count for overlaps: the support of the difference is there."""
    rng = np.random.default_rng(seed)
    polygon = blob(rng, 12)
    start, end = rng.normal(scale=0.5, size=(2, 40, 2))
    found = separate(start, end, polygon)
    inside = np.flatnonzero(found.gap < 0)
    assert len(inside) > 10
    for i in inside:
        assert found.gap[i] == pytest.approx(widest_gap(start[i], end[i], polygon), abs=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_points_are_segments_without_length(seed: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = blob(rng, 9)
    xy = rng.normal(scale=1.5, size=(200, 2))
    found, shape = separate(xy, xy, polygon), Polygon(polygon)
    for p, gap in zip(xy, found.gap, strict=True):
        away, deep = Point(p).distance(shape), Point(p).distance(shape.exterior)
        if away == 0.0:
            assert gap == pytest.approx(-deep)
        else:
            assert 0.0 < gap <= away + 1e-12
    assert separate(np.empty((0, 2)), np.empty((0, 2)), polygon).gap.shape == (0,)


def around(corners, rng):
    """A place outside a polygon."""
    shape = Polygon(corners)
    while True:
        xy = rng.uniform(corners.min(axis=0) - 2, corners.max(axis=0) + 2)
        if shape.distance(Point(xy)) > 0.1:
            return xy


@pytest.mark.parametrize("corners", [SQUARE, L_SHAPE, WEDGE], ids=["square", "L", "wedge"])
@pytest.mark.parametrize("ccw", [True, False])
def test_a_route_leads_around_and_keeps_away(corners, ccw: bool) -> None:
    rng, shape, away = np.random.default_rng(5), Polygon(corners), 0.05
    least = 0.0 if corners is WEDGE else 0.99 * away  # a sharp corner is cut by the bounded offset
    for _ in range(60):
        a, b = around(corners, rng), around(corners, rng)
        way = route(corners, a, b, away, ccw=ccw)
        assert LineString(way).distance(shape) > least
        for end, given_ in ((way[0], a), (way[-1], b)):
            assert Point(end).distance(shape) == pytest.approx(away)
            assert np.hypot(*(end - given_)) <= Point(given_).distance(shape) + away + 1e-9


@pytest.mark.parametrize("corners", [SQUARE, L_SHAPE], ids=["square", "L"])
def test_both_ways_together_go_once_around(corners) -> None:
    """There and back the other way is a ring about the polygon: counter-clockwise first, then back."""
    rng = np.random.default_rng(6)
    for _ in range(60):
        a, b = around(corners, rng), around(corners, rng)
        there, back = (route(corners, a, b, 0.05, ccw=c) for c in (True, False))
        if len(there) == len(back) == 2:  # both at the same corner: there is nothing to go around
            np.testing.assert_array_equal(there, back)
            continue
        ring = np.vstack([there, back[::-1]])
        angle = np.arctan2(*(ring - corners[[0, 1, -1]].mean(axis=0)).T[::-1])
        turned = np.diff(np.unwrap(np.append(angle, angle[0])))
        assert turned.sum() == pytest.approx(2 * np.pi)


def test_the_nearest_edge_and_the_place_next_to_it() -> None:
    k, xy = nearest_edge(SQUARE, np.array([3.0, 0.25]), 0.1)
    assert k == 1
    np.testing.assert_allclose(xy, [1.1, 0.25])
    np.testing.assert_allclose(offset_point(SQUARE, 2, np.array([0.5, 1.0]), 0.1), [0.5, 1.1])


@pytest.mark.parametrize("corners", [SQUARE, L_SHAPE], ids=["square", "L"])
def test_offset_moves_the_edges(corners) -> None:
    want = Polygon(corners).buffer(0.1, join_style="mitre")
    assert Polygon(offset(corners, 0.1)).symmetric_difference(want).area < 1e-9


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=2, max_size=7), st.integers(1, 40))
def test_places_spread_along_a_way(corners: list[tuple[float, float]], steps: int) -> None:
    way = np.array(corners)
    a, places, b = way[0], way[1:-1], way[-1]
    found = spread_along(a, places, b, steps)
    if steps < len(way) - 1:
        assert found is None
        return
    assert found is not None
    assert found.shape == (steps - 1, 2)
    full, at = np.vstack([a, found, b]), 0
    for place in way[1:]:  # every place is hit, in order
        hit = np.flatnonzero(np.hypot(*(full[at:] - place).T) < 1e-9)
        assert len(hit)
        at += int(hit[0])
    length = np.hypot(*np.diff(way, axis=0).T).sum()
    assert np.hypot(*np.diff(full, axis=0).T).sum() == pytest.approx(length, abs=1e-9)  # nothing next to the way


def test_steps_are_about_equal_where_there_are_many() -> None:
    a, b = np.zeros(2), np.array([3.0, 1.0])
    found = spread_along(a, np.array([[3.0, 0.0]]), b, 400)
    assert found is not None
    steps = np.hypot(*np.diff(np.vstack([a, found, b]), axis=0).T)
    np.testing.assert_allclose(steps, 0.01, rtol=0.02)
