"""Headings of paths, viewing angles and their bins, on examples that can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.appearance.sightings import angle_bins, at_times, path_of, viewing_angles

SECOND = 1_000_000_000
UNKNOWN = np.full((5, 2), np.nan)


def test_heading_is_that_of_the_velocity_or_of_the_way():
    t = np.arange(5) * SECOND
    xy = np.column_stack([np.arange(5.0), np.zeros(5)])
    for velocity in (np.tile([2.0, 0.0], (5, 1)), UNKNOWN):
        path = path_of(t, xy, velocity, SECOND, 0.3)
        assert path.heading.tolist() == [[1.0, 0.0]] * 5


def test_who_stands_heads_nowhere():
    t, xy = np.arange(5) * SECOND, np.zeros((5, 2))
    assert np.isnan(path_of(t, xy, UNKNOWN, SECOND, 0.0).heading).all()
    assert np.isnan(path_of(t, xy, np.tile([0.29, 0.0], (5, 1)), SECOND, 0.3).heading).all()
    assert np.isfinite(path_of(t, xy, np.tile([0.3, 0.0], (5, 1)), SECOND, 0.3).heading).all()


def test_one_row_has_no_heading_and_equal_times_count_once():
    path = path_of(np.array([3]), np.zeros((1, 2)), UNKNOWN[:1], SECOND, 0.3)
    assert np.isnan(path.heading).all()
    twice = path_of(np.array([3, 3]), np.array([[0.0, 0.0], [1.0, 2.0]]), UNKNOWN[:2], SECOND, 0.3)
    assert twice.xy.tolist() == [[1.0, 2.0]]


def test_no_one_is_there_before_after_and_in_gaps():
    path = path_of(np.array([0, 1, 5]) * SECOND, np.zeros((3, 2)), np.ones((3, 2)), SECOND, 0.3)
    found = at_times({7: path}, np.array([-1, 0, 1, 3, 5, 6]) * SECOND, SECOND)
    assert found.identity.tolist() == [7]
    assert found.there[:, 0].tolist() == [False, True, True, False, True, False]


def test_angle_is_that_between_heading_and_camera_on_either_side():
    camera = np.zeros(2)
    xy = np.array([[5.0, 0.0]] * 5)
    heading = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [np.nan, np.nan]])
    angle = viewing_angles(xy, heading, camera)
    assert angle[:4] == pytest.approx([0.0, np.pi, np.pi / 2, np.pi / 2])
    assert np.isnan(angle[4])
    assert np.isnan(viewing_angles(camera, np.array([1.0, 0.0]), camera))


def test_bins_are_the_nearest_of_front_to_back():
    step = np.pi / 6  # N = 7
    angle = np.array([0.0, 0.49 * step, 0.51 * step, 3.0 * step, 5.49 * step, 5.51 * step, np.pi, np.nan])
    assert angle_bins(angle, 7).tolist() == [1, 1, 2, 4, 6, 7, 7, 0]
    assert angle_bins(angle[[0, 3, 6, 7]], 2).tolist() == [1, 2, 2, 0]  # the side itself is nearer to neither
    assert angle_bins(angle, 1).tolist() == [1] * 8
