"""Visual refinement: by hand for cameras at a right angle, exact where it must be, and covariances that hold."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.array_types import Floats
from occlog.track.methods.readers.refine import FORMS, TagSightings, refine

CAMERAS, YAWS = np.array([[0.0, 5.0], [5.0, 0.0]]), np.array([0.0, 0.5 * np.pi])
"""In the middle of the left and of the bottom wall, as in [Lee] Fig. 5-36."""


def sights(xy: Floats, sigma: float = 1e-3, noise: Floats | float = 0.0) -> TagSightings:
    to = xy[:, None, :] - CAMERAS
    bearing = np.arctan2(to[..., 1], to[..., 0]) + noise
    return TagSightings(CAMERAS, YAWS, bearing, np.full(bearing.shape, sigma))


def test_equation_5_39_by_hand() -> None:
    # Coarse (4, 6), truth (6, 7): camera 1 sees slope 2 / 6, camera 2 slope 1 / 7 to the right
    found = refine(np.array([[4.0, 6.0]]), np.eye(2)[None], sights(np.array([[6.0, 7.0]])), "printed-1")
    assert_allclose(found.xy, [[5.0 + 6.0 / 7.0, 5.0 + 4.0 * 2.0 / 6.0]])


def test_equation_5_40_by_hand() -> None:
    found = refine(np.array([[4.0, 6.0]]), np.eye(2)[None], sights(np.array([[6.0, 7.0]])), "parallel")
    du1, du2 = 4.0 * 2.0 / 6.0 - 1.0, 6.0 / 7.0 + 1.0
    assert_allclose(found.xy, [[4.0 + du2 * (6.0 + du1) / 6.0, 6.0 + du1 * (4.0 + du2) / 4.0]])


@pytest.mark.parametrize("form", FORMS)
def test_a_position_that_is_right_stays(form: str) -> None:
    xy = np.array([[3.0, 4.0], [8.0, 6.0]])
    found = refine(xy, np.tile(0.5 * np.eye(2), (2, 1, 1)), sights(xy), form)
    assert_allclose(found.xy, xy, atol=1e-9)
    assert found.used.all()


def test_rays_cross_at_the_truth_wherever_the_coarse_position_is() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(1.0, 9.0, (500, 2))
    coarse = np.clip(xy + 0.7 * rng.standard_normal(xy.shape), 0.1, 9.9)
    found = refine(coarse, np.tile(0.5 * np.eye(2), (500, 1, 1)), sights(xy, 1e-5), "rays")
    assert np.percentile(np.linalg.norm(found.xy - xy, axis=1), 99) < 1e-3


def test_the_covariance_of_rays_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform(2.0, 8.0, (4000, 2))
    coarse = xy + 0.6 * rng.standard_normal(xy.shape)
    seen = sights(xy, 0.03, 0.03 * rng.standard_normal((4000, 2)))
    found = refine(coarse, np.tile(0.36 * np.eye(2), (4000, 1, 1)), seen, "rays")
    error = found.xy - xy
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error)
    assert abs(nees.mean() - 2.0) < 0.25


def test_one_camera_makes_the_position_better_across_its_line_alone() -> None:
    xy = np.array([[6.0, 7.0]])
    one = sights(xy, 0.01)
    one.bearing[:, 1] = np.nan
    found = refine(np.array([[5.0, 6.0]]), np.eye(2)[None], one, "rays")
    assert found.used.tolist() == [[True, False]]
    away = xy[0] - CAMERAS[0]
    along = away / np.linalg.norm(away)
    assert along @ found.covariance[0] @ along > 0.9
    assert np.linalg.det(found.covariance[0]) < 0.02
    # Equations 5.39 and 5.40 want two
    assert_allclose(refine(np.array([[5.0, 6.0]]), np.eye(2)[None], one, "parallel").xy, [[5.0, 6.0]])


@pytest.mark.parametrize("form", FORMS)
def test_nothing_seen_changes_nothing(form: str) -> None:
    nothing = TagSightings(CAMERAS, YAWS, np.full((1, 2), np.nan), np.full((1, 2), np.nan))
    found = refine(np.array([[5.0, 6.0]]), np.eye(2)[None], nothing, form)
    assert_allclose(found.xy, [[5.0, 6.0]])
    assert_allclose(found.covariance, np.eye(2)[None])
    assert not found.used.any()


def test_a_camera_behind_the_position_is_not_used_by_planes() -> None:
    found = refine(np.array([[-1.0, 6.0]]), np.eye(2)[None], sights(np.array([[6.0, 7.0]])), "printed-1")
    assert not found.used.any()
    assert_allclose(found.xy, [[-1.0, 6.0]])
