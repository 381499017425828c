import numpy as np
import pytest
from shapely.geometry import LineString, Polygon

from occlog.core.plane.polygons import inside_polygon, sight_blocked, signed_area
from occlog.core.plane.room_pockets import pockets

L_ROOM = np.array([[0.0, 0.0], [160.0, 0.0], [160.0, 53.0], [53.0, 53.0], [53.0, 160.0], [0.0, 160.0]])
SQUARE = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])


def star(seed: int) -> np.ndarray:
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
    room = star(seed)
    shape = Polygon(room)
    parts = pockets(room)
    assert sum(signed_area(p) for p in parts) == pytest.approx(shape.convex_hull.area - shape.area)
    points = np.random.default_rng(seed).uniform(-50, 50, (400, 2))
    points = points[inside_polygon(points, room)]
    origin, others = points[0], points[1:]
    blocked = np.any([sight_blocked(origin, others, p) for p in parts], axis=0)
    leaves = [LineString([origin, p]).difference(shape).length > 1e-9 for p in others]
    assert blocked.tolist() == leaves
