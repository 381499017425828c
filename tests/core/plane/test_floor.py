from __future__ import annotations

import numpy as np
import pytest

from occlog.core.plane import inside_polygon, make_floor, on_floor, sample_floor, sample_near

L_ROOM = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [1.0, 1.0], [1.0, 4.0], [0.0, 4.0]])
PILLAR = np.array([[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.8]])

OTHER = np.add(PILLAR, [2.0, 0.0])


def test_the_floor_is_the_room_without_its_walls():
    floor = make_floor(L_ROOM, [PILLAR, OTHER])
    xy = np.random.default_rng(0).uniform(-1, 5, (5000, 2))
    expected = inside_polygon(xy, L_ROOM) & ~inside_polygon(xy, PILLAR) & ~inside_polygon(xy, OTHER)
    np.testing.assert_array_equal(on_floor(xy, *floor), expected)


@pytest.mark.jit
def test_places_are_spread_evenly_over_the_floor():
    floor = make_floor(L_ROOM, [PILLAR])
    n = 40_000
    xy = sample_floor(n, floor, np.random.default_rng(1))
    assert xy.shape == (n, 2)
    assert on_floor(xy, *floor).all()
    # Area: 7 for the room less 0.36; the horizontal arm beyond x = 1 has 3.
    share = np.mean(xy[:, 0] > 1.0)
    p = 3.0 / 6.64
    assert abs(share - p) < 4.0 * np.sqrt(p * (1 - p) / n)  # 4 standard errors


@pytest.mark.parametrize("n", [0, 1, 7])
def test_any_number_of_places_can_be_asked_for(n):
    assert sample_floor(n, make_floor(L_ROOM, []), np.random.default_rng(2)).shape == (n, 2)


def test_a_room_full_of_walls_is_refused():
    floor = make_floor(L_ROOM, [np.array([[-1.0, -1.0], [5.0, -1.0], [5.0, 5.0], [-1.0, 5.0]])])
    with pytest.raises(ValueError, match="only 0 of 10 random positions were free"):
        sample_floor(10, floor, np.random.default_rng(3))


def test_places_near_points_are_on_the_floor_and_evenly_within_the_distance():
    floor = make_floor(L_ROOM, [])
    low = L_ROOM.min(axis=0) + 0.15 * np.ptp(L_ROOM, axis=0)
    xy = sample_near(np.tile(low, (4000, 1)), 0.1, floor, np.random.default_rng(4))
    r = np.hypot(*(xy - low).T)
    assert r.max() <= 0.1
    assert np.mean(r < 0.1 * np.sqrt(0.5)) == pytest.approx(0.5, abs=0.03)
    assert on_floor(xy, *floor).all()


def test_a_point_far_off_the_floor_gets_a_place_anywhere_on_it():
    floor = make_floor(L_ROOM, [])
    xy = sample_near(np.full((50, 2), 1e6), 1.0, floor, np.random.default_rng(5))
    assert on_floor(xy, *floor).all()
    assert sample_near(np.empty((0, 2)), 1.0, floor, np.random.default_rng(6)).shape == (0, 2)
