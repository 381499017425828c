"""Nearest points and least distances during a step, against many points in between."""

from __future__ import annotations

import numpy as np

from occlog.core.navigation.forces import direction, distance
from occlog.core.navigation.obstacles import (
    edges,
    least_to_points,
    least_to_segments,
    nearest_on_discs,
    nearest_on_polygons,
    nearest_on_segments,
)
from occlog.core.plane import pack_polygons

RNG = np.random.default_rng(5)
SHARES = np.linspace(0.0, 1.0, 2001)


def along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(2001, ...) points from a to b."""
    return a + SHARES.reshape(-1, *([1] * a.ndim)) * (b - a)


def test_nearest_points_on_segments_are_nearer_than_all_others():
    xy, segments = RNG.normal(size=(20, 2)), RNG.normal(size=(7, 2, 2))
    rho = distance(xy[:, None], nearest_on_segments(xy, segments))
    tried = distance(xy[:, None], along(segments[:, 0], segments[:, 1])[:, None]).min(axis=0)
    assert (rho <= tried + 1e-12).all()
    np.testing.assert_allclose(rho, tried, atol=5e-3)


def test_a_segment_without_length_is_a_point():
    point = np.array([[[1.0, 2.0], [1.0, 2.0]]])
    np.testing.assert_array_equal(nearest_on_segments(np.zeros((1, 2)), point)[0, 0], [1.0, 2.0])


def test_nearest_points_on_polygons_are_on_their_nearest_edges():
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    found = nearest_on_polygons(np.array([[3.0, 1.0], [1.0, -4.0]]), *pack_polygons([square, square + 10.0]))
    np.testing.assert_allclose(found, [[[2.0, 1.0], [10.0, 10.0]], [[1.0, 0.0], [10.0, 10.0]]])


def test_nearest_points_on_discs_are_on_the_border_or_just_behind_a_place_inside():
    positions = np.array([[3.0, 0.0], [0.5, 0.0]])
    found = nearest_on_discs(positions, np.zeros((2, 2)), np.array([1.0, 0.0]))
    np.testing.assert_allclose(found[:, 0], [[1.0, 0.0], [0.5, 0.0]], atol=1e-6)
    np.testing.assert_allclose(found[:, 1], 0.0)
    np.testing.assert_allclose(direction(positions, found[:, 0]), [[1.0, 0.0], [1.0, 0.0]])


def test_least_distances_to_moving_points_are_those_of_the_whole_step():
    start, end = RNG.normal(size=(2, 6, 2))
    first, last = RNG.normal(size=(2, 4, 2))
    tried = distance(along(start, end)[:, :, None], along(first, last)[:, None]).min(axis=0)
    least = least_to_points(start, end, first, last)
    assert (least <= tried + 1e-12).all()
    np.testing.assert_allclose(least, tried, atol=5e-3)


def test_least_distances_to_segments_are_zero_where_a_step_crosses_one():
    start, end = RNG.normal(size=(2, 30, 2))
    segments = RNG.normal(size=(10, 2, 2))
    tried = np.stack([distance(p[:, None], nearest_on_segments(p, segments)) for p in along(start, end)]).min(axis=0)
    least = least_to_segments(start, end, segments)
    assert (least == 0.0).any()
    assert (least <= tried + 1e-12).all()
    np.testing.assert_allclose(least, tried, atol=5e-3)


def test_edges_close_the_polygon():
    triangle = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    np.testing.assert_array_equal(edges(triangle)[2], [[0.0, 1.0], [0.0, 0.0]])
