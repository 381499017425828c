"""Lens models: against OpenCV, closed forms, and there and back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from occlog.core.geometry.lens import (
    MAX_ANGLE,
    distort,
    fold_radius,
    is_straight,
    is_usable,
    to_usable,
    undistort,
    usable_disc,
)

COMPLETE = np.array([0.5, -0.3, 0.001, -0.002, 0.02, 0.75, -0.35, 0.01, 0.01, -0.002, -0.008, 0.003, 0.04, -0.03])
GRID = np.stack(np.meshgrid(np.linspace(-0.7, 0.7, 11), np.linspace(-0.4, 0.4, 9)), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("count", [5, 8, 12, 14])
def test_the_complete_model_is_that_of_opencv(count: int) -> None:
    coefficients = COMPLETE * (np.arange(14) < count)
    points = np.column_stack([GRID, np.ones(len(GRID))])
    wanted = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), coefficients[: max(count, 5)])[0]
    found = distort(GRID, coefficients, "opencv")
    np.testing.assert_allclose(found, wanted.reshape(-1, 2), atol=1e-12)
    np.testing.assert_allclose(undistort(found, coefficients, "opencv"), GRID, atol=1e-10)


def test_five_coefficients_are_browns_lens() -> None:
    five = np.array([-0.25, 0.08, 0.001, -0.002, 0.01])
    whole = np.concatenate([five, np.zeros(9)])
    np.testing.assert_allclose(distort(GRID, whole, "opencv"), distort(GRID, five, "brown"), atol=1e-15)
    np.testing.assert_allclose(undistort(GRID, whole, "opencv"), undistort(GRID, five, "brown"), atol=1e-9)


def test_strong_pincushion_distortion_that_a_fixed_point_does_not_undo() -> None:
    whole = np.zeros(14)
    whole[0] = 1.2
    bent = distort(1.2 * GRID, whole, "opencv")
    np.testing.assert_allclose(undistort(bent, whole, "opencv"), 1.2 * GRID, atol=1e-9)
    with np.errstate(all="ignore"):
        assert not np.allclose(undistort(bent, whole[:5], "brown"), 1.2 * GRID, atol=1e-3)


@pytest.mark.parametrize("k1", [-0.1, -0.28, -1.0])
def test_a_lens_with_k1_alone_folds_where_its_derivative_vanishes(k1: float) -> None:
    """d/dr (r + k1 r^3) = 0 at r = 1 / sqrt(-3 k1)."""
    fold = 1.0 / np.sqrt(-3.0 * k1)
    found = fold_radius(np.array([k1, 0, 0, 0, 0]), "brown", 2.0 * fold)
    assert fold * 0.98 < found <= fold
    assert np.isinf(fold_radius(np.array([k1, 0, 0, 0, 0]), "brown", 0.9 * fold))
    assert np.isinf(fold_radius(np.array([-k1, 0, 0, 0, 0]), "brown", 2.0 * fold))


def test_a_fisheye_is_used_up_to_80_degrees() -> None:
    coefficients = np.array([-0.03, 0.004, -0.002, 0.0003, 0.0])
    disc = usable_disc(coefficients)
    assert disc.angle == MAX_ANGLE
    t = MAX_ANGLE
    assert disc.radius == pytest.approx(t * (1 - 0.03 * t**2 + 0.004 * t**4 - 0.002 * t**6 + 0.0003 * t**8))
    points = np.array([[0.99 * disc.radius, 0.0], [0.0, 1.01 * disc.radius], [2.0, 2.0]])
    assert is_usable(points, coefficients, "equidistant").tolist() == [True, False, False]
    ideal = undistort(points, coefficients, "equidistant")
    assert np.isfinite(ideal[:, 0]).tolist() == [True, False, False]
    edge = undistort(to_usable(points, coefficients, "equidistant"), coefficients, "equidistant")
    np.testing.assert_allclose(np.hypot(*edge[1:].T), np.tan(MAX_ANGLE), rtol=1e-6)
    np.testing.assert_allclose(edge[0], ideal[0])


def test_a_fisheye_that_folds_is_used_up_to_there() -> None:
    """theta - 0.3 theta^3 turns at theta = 1 / sqrt(0.9)."""
    disc = usable_disc(np.array([-0.3, 0.0, 0.0, 0.0, 0.0]))
    assert disc.angle == pytest.approx(1.0 / np.sqrt(0.9), abs=0.003)


def test_a_fisheye_without_coefficients_is_not_straight() -> None:
    assert not is_straight(np.zeros(5), "equidistant")
    assert is_straight(np.zeros(14), "opencv")
    assert is_usable(GRID, np.zeros(5), "brown").all()
