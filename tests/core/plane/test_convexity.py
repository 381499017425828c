"""Convex pieces and pockets of polygons: shapely and random points as references."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import LineString, Polygon
from shapely.ops import unary_union

from occlog.core.plane import convex_pieces, inside_polygon, line_of_sight_blocked, pockets, signed_area

L_SHAPE = np.array([[0.0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]])
SQUARE = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])


def star(points: int, inner: float):
    """Spikes of length 1 about a core of radius `inner`."""
    angle = np.pi * np.arange(2 * points) / points + 0.1
    radius = np.where(np.arange(2 * points) % 2 == 0, 1.0, inner)
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def comb(teeth: int, width: float):
    """A bar with teeth that point upwards."""
    top = [(x, y) for k in range(teeth) for x, y in ((k, 1.0), (k, 3.0), (k + width, 3.0), (k + width, 1.0))]
    return np.array([(0.0, 0.0), (teeth - 1 + width, 0.0), *reversed(top)])[:-1]


def spiral(turns: int):
    """A corridor of width 1 that winds inwards."""
    way, at, length = [np.zeros(2)], np.zeros(2), 4.0 * turns
    for k in range(4 * turns - 1):
        at = at + length * np.array([(1, 0), (0, 1), (-1, 0), (0, -1)][k % 4])
        way.append(at)
        length -= 2.0 if k % 2 else 0.0
    return np.array(LineString(way).buffer(0.3, cap_style="flat", join_style="mitre").exterior.coords)[:-1]


SHAPES = {
    "L": L_SHAPE,
    "clockwise L": L_SHAPE[::-1],
    "star": star(7, 0.3),
    "thin star": star(12, 0.02),
    "comb": comb(6, 0.4),
    "needles": comb(9, 1e-3),
    "spiral": spiral(3),
    "far": L_SHAPE + np.array([5e5, 4.4e6]),
    "tiny": 1e-4 * star(5, 0.4),
    "U": np.array([[0.0, 0], [5, 0], [5, 4], [4, 4], [4, 1], [1, 1], [1, 4], [0, 4]]),
}


def is_convex(piece) -> bool:
    """No corner turns right, by more than rounding."""
    size = np.ptp(piece, axis=0).prod()
    for a, b, c in zip(piece, np.roll(piece, -1, axis=0), np.roll(piece, -2, axis=0), strict=True):
        if (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) < -1e-11 * size:
            return False
    return True


def check_pieces(polygon, rng) -> list:
    """Convex, counter-clockwise, disjoint, and together the polygon."""
    want, pieces = Polygon(polygon), convex_pieces(polygon)
    assert want.is_valid
    made = [Polygon(p) for p in pieces]
    assert all(p.exterior.is_ccw for p in made)
    assert all(is_convex(p) for p in pieces)
    assert sum(p.area for p in made) == pytest.approx(want.area, rel=1e-9)
    for a, b in itertools.combinations(made, 2):
        assert a.intersection(b).area < 1e-9 * want.area
    assert unary_union(made).symmetric_difference(want).area < 1e-9 * want.area
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    xy = rng.uniform(low, high, (400, 2))
    count = np.sum([inside_polygon(xy, p) for p in pieces], axis=0)
    np.testing.assert_array_equal(count, inside_polygon(xy, np.ascontiguousarray(polygon)))  # each in one piece only
    return pieces


@pytest.mark.parametrize("name", SHAPES)
def test_pieces_of_known_shapes(name: str) -> None:
    polygon = np.ascontiguousarray(SHAPES[name])
    pieces = check_pieces(polygon, np.random.default_rng(0))
    assert 2 <= len(pieces) <= len(polygon) - 2


def test_a_corner_on_the_side_of_a_triangle() -> None:
    """The inner corner of this L is on the line between two others."""
    check_pieces(np.array([[0.0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]), np.random.default_rng(3))


def test_a_convex_polygon_is_itself() -> None:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    for polygon in (SQUARE, np.column_stack([np.cos(angle), 3 * np.sin(angle)]), SQUARE[:3]):
        for given_ in (polygon, polygon[::-1]):
            pieces = convex_pieces(given_)
            assert len(pieces) == 1
            np.testing.assert_array_equal(pieces[0], polygon if given_ is polygon else given_[::-1])


def test_straight_corners_make_nothing_concave_and_no_empty_pieces() -> None:
    many = np.array([[0.0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [0.7, 2], [0, 2], [0, 1]])
    assert len(convex_pieces(many)) == 1
    corners = []
    for a, b in zip(L_SHAPE, np.roll(L_SHAPE, -1, axis=0), strict=True):
        corners += [a, 0.3 * a + 0.7 * b]
    pieces = check_pieces(np.array(corners), np.random.default_rng(1))
    assert all(Polygon(p).area > 1e-6 for p in pieces)


@given(
    st.lists(st.tuples(st.floats(0.05, 1.0), st.floats(0.2, 1.0)), min_size=3, max_size=20), st.integers(0, 2**32 - 1)
)
def test_any_polygon_around_a_place(spokes: list[tuple[float, float]], seed: int) -> None:
    """Corners by rising angle at any distances make a simple polygon, mostly not a convex one."""
    radius, gap = np.array(spokes).T
    angle = 2 * np.pi * np.cumsum(gap) / gap.sum()
    if np.max(np.diff(np.append(angle, angle[0] + 2 * np.pi))) >= np.pi - 1e-3:
        return  # the place would be outside
    check_pieces(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]), np.random.default_rng(seed))


@pytest.mark.jit
@given(st.lists(st.tuples(st.integers(1, 3), st.integers(0, 4)), min_size=2, max_size=8))
def test_towers_whose_walls_meet_in_line(towers: list[tuple[int, int]]) -> None:
    """Right angles only, with corners on one line and towers of the same height."""
    x, corners = 0.0, []
    for width, height in towers:
        corners += [(x, 1.0 + height), (x + width, 1.0 + height)]
        x += width
    corners += [(x, 0.0), (0.0, 0.0)]
    check_pieces(np.array(corners, float)[::-1], np.random.default_rng(2))


L_ROOM = np.array([[0.0, 0.0], [160.0, 0.0], [160.0, 53.0], [53.0, 53.0], [53.0, 160.0], [0.0, 160.0]])
SQUARE = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])


def star_room(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(10, 50, 12)[:, None]


def test_a_convex_room_has_none():
    assert pockets(SQUARE) == []
    halved = np.insert(SQUARE, 1, [50.0, 0.0], axis=0)  # a corner in the middle of a side
    assert pockets(halved) == []


@pytest.mark.parametrize("room", [L_ROOM, L_ROOM[::-1], np.roll(L_ROOM, 4, axis=0)])
def test_the_l_shaped_room_has_one(room):
    (pocket,) = pockets(room)
    assert signed_area(pocket) == pytest.approx(0.5 * 107 * 107)
    assert {tuple(p) for p in pocket} == {(160.0, 53.0), (53.0, 53.0), (53.0, 160.0)}


@pytest.mark.parametrize("seed", range(6))
def test_pockets_fill_the_hull_and_block_what_leaves_the_room(seed):
    room = star_room(seed)
    shape = Polygon(room)
    parts = pockets(room)
    assert sum(signed_area(p) for p in parts) == pytest.approx(shape.convex_hull.area - shape.area)
    points = np.random.default_rng(seed).uniform(-50, 50, (400, 2))
    points = points[inside_polygon(points, room)]
    origin, others = points[0], points[1:]
    blocked = np.any([line_of_sight_blocked(origin, others, p) for p in parts], axis=0)
    leaves = [LineString([origin, p]).difference(shape).length > 1e-9 for p in others]
    assert blocked.tolist() == leaves
