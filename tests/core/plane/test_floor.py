from __future__ import annotations

import numpy as np
import pytest

from occlog.core.plane import floor_moments, inside_polygon, make_floor, on_floor, sample_floor, sample_near

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


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_moments_of_a_rectangle_and_of_one_with_a_hole_are_those_of_its_parts(unit: float) -> None:
    room = unit * np.array([[2.0, -1.0], [11.0, -1.0], [11.0, 6.0], [2.0, 6.0]])
    mean, covariance = floor_moments(make_floor(room, []))
    np.testing.assert_allclose(mean, unit * np.array([6.5, 2.5]), rtol=1e-12)
    np.testing.assert_allclose(covariance, unit**2 * np.diag([81.0, 49.0]) / 12.0, atol=1e-9 * unit**2)
    # Less a square of 1 x 1 about (4, 2): 63 - 1
    hole = unit * np.array([[3.5, 1.5], [4.5, 1.5], [4.5, 2.5], [3.5, 2.5]])
    mean, covariance = floor_moments(make_floor(room, [hole]))
    expected = (63.0 * np.array([6.5, 2.5]) - np.array([4.0, 2.0])) / 62.0
    second = 63.0 * (np.diag([81.0, 49.0]) / 12.0 + np.outer([6.5, 2.5], [6.5, 2.5]))
    second = (second - np.eye(2) / 12.0 - np.outer([4.0, 2.0], [4.0, 2.0])) / 62.0
    np.testing.assert_allclose(mean, unit * expected, rtol=1e-12)
    np.testing.assert_allclose(covariance, unit**2 * (second - np.outer(expected, expected)), atol=1e-9 * unit**2)


@pytest.mark.jit
def test_moments_of_overlapping_walls_that_stick_out_are_those_of_draws() -> None:
    walls = [PILLAR, np.array([[0.5, 0.1], [2.5, 0.6], [0.6, 3.0]]), np.array([[0.5, 3.5], [2.0, 3.5], [2.0, 5.0]])]
    floor, n = make_floor(L_ROOM, walls), 200_000
    xy = sample_floor(n, floor, np.random.default_rng(3))
    mean, covariance = floor_moments(floor)
    away = xy - mean
    products = away[:, :, None] * away[:, None, :]
    assert np.all(np.abs(away.mean(axis=0)) < 4.0 * away.std(axis=0) / np.sqrt(n))  # 4 standard errors
    assert np.all(np.abs(products.mean(axis=0) - covariance) < 4.0 * products.std(axis=0) / np.sqrt(n))


def test_a_floor_without_free_positions_has_no_moments() -> None:
    with pytest.raises(ValueError, match="static occluders fill the room"):
        floor_moments(make_floor(L_ROOM, [np.array([[-1.0, -1.0], [5.0, -1.0], [5.0, 5.0], [-1.0, 5.0]])]))
