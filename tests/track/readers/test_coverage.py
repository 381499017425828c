"""Virtual sensors: regions against closed forms and Monte Carlo, and the counts of [Lee] Sec. 5.2.3."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose

from occlog.track.methods.readers.virtual_sensors import most_virtual_sensors, region_moments, virtual_sensors


def lens(radius: float, apart: float) -> float:
    """Area of the intersection of two discs of one radius."""
    half = 0.5 * apart
    return 2.0 * radius**2 * math.acos(half / radius) - apart * math.sqrt(radius**2 - half**2)


def test_one_reader_is_a_disc() -> None:
    found = virtual_sensors(np.array([[3.0, -2.0]]), np.array([2.0]))
    assert found.members.tolist() == [[True]]
    assert_allclose(found.area, [4.0 * math.pi], rtol=1e-12)
    assert_allclose(found.centroid, [[3.0, -2.0]], atol=1e-12)
    assert_allclose(found.covariance[0], np.eye(2), atol=1e-3)  # r^2 / 4


def test_two_readers_cut_a_lens() -> None:
    found = virtual_sensors(np.array([[0.0, 0.0], [2.0, 0.0]]), np.array([1.5, 1.5]))
    area = {tuple(m): a for m, a in zip(found.members.tolist(), found.area, strict=True)}
    assert_allclose(area[True, True], lens(1.5, 2.0), rtol=1e-3)
    assert_allclose(area[True, False], math.pi * 1.5**2 - lens(1.5, 2.0), rtol=1e-3)
    assert_allclose(area[True, False], area[False, True], rtol=1e-9)


def test_regions_are_those_of_points_drawn_at_random() -> None:
    rng = np.random.default_rng(1)
    positions, ranges = rng.uniform(0.0, 10.0, (6, 2)), rng.uniform(1.5, 4.0, 6)
    room = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [4.0, 10.0], [4.0, 6.0], [0.0, 6.0]])
    found = virtual_sensors(positions, ranges, room)
    points = rng.uniform(0.0, 10.0, (400_000, 2))
    points = points[shapely.contains_xy(shapely.Polygon(room), points)]
    inside = np.linalg.norm(points[:, None] - positions, axis=2) <= ranges
    tried = 0
    for member, area, centroid, covariance in zip(*found, strict=True):
        own = points[(inside == member).all(axis=1)]
        if len(own) < 2000:
            continue
        tried += 1
        expected, spread = len(own) / len(points) * 84.0, np.cov(own.T)
        assert_allclose(area, expected, rtol=5.0 / math.sqrt(len(own)) + 2e-3)
        assert_allclose(centroid, own.mean(axis=0), atol=5.0 * math.sqrt(np.trace(spread) / len(own)))
        assert_allclose(covariance, spread, atol=0.05 * np.trace(spread))
    assert tried >= 7


def test_moments_of_a_rectangle_with_a_hole_far_from_the_origin() -> None:
    outer, hole = shapely.box(1e6, 1e6, 1e6 + 4.0, 1e6 + 2.0), shapely.box(1e6 + 1.0, 1e6 + 0.5, 1e6 + 2.0, 1e6 + 1.5)
    found = region_moments(outer.difference(hole))
    # By hand: 8 - 1; x about the corner: (8 * 2 - 1.5) / 7
    assert_allclose(found.area, 7.0, rtol=1e-9)
    assert_allclose(found.centroid - 1e6, [(16.0 - 1.5) / 7.0, 1.0], rtol=1e-9)
    xx = (8.0 * (16.0 / 12.0 + 4.0) - (1.0 / 12.0 + 2.25)) / 7.0 - (14.5 / 7.0) ** 2
    yy = (8.0 * (4.0 / 12.0) - 1.0 / 12.0) / 7.0
    assert_allclose(found.covariance, [[xx, 0.0], [0.0, yy]], atol=1e-6)


def test_a_region_of_two_pieces_is_one_virtual_sensor() -> None:
    # The small disc of the second reader cuts the large one's ring, a bar cuts the ring into two pieces
    positions, ranges = np.array([[0.0, 0.0], [0.0, 0.0]]), np.array([3.0, 1.0])
    bar = np.array([[-5.0, -0.5], [5.0, -0.5], [5.0, 0.5], [-5.0, 0.5]])
    found = virtual_sensors(positions, ranges, bar)
    assert sorted(found.members.sum(axis=1).tolist()) == [1, 2]
    assert_allclose(found.centroid, np.zeros((2, 2)), atol=1e-9)


def test_parts_that_no_one_covers_and_slivers_are_none() -> None:
    room = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    touching = virtual_sensors(np.array([[2.0, 5.0], [8.0, 5.0]]), np.array([3.0 - 1e-9, 3.0 - 1e-9]), room)
    assert touching.members.tolist() == [[True, False], [False, True]]


@pytest.mark.parametrize(("readers", "overlap", "count"), [(12, 2, 78), (3, 3, 7), (8, 1, 8), (2, 5, 3)])
def test_most_virtual_sensors_is_a_sum_of_binomials(readers: int, overlap: int, count: int) -> None:
    assert most_virtual_sensors(readers, overlap) == count


def test_three_circles_that_all_overlap_make_seven() -> None:
    angles = np.radians([90.0, 210.0, 330.0])
    positions = np.column_stack([np.cos(angles), np.sin(angles)])
    assert len(virtual_sensors(positions, np.full(3, 1.5)).area) == 7
