"""Errors in space on scenes worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evaluate_scenes import both, heights, scene, tracks, truth

from occlog.core.metrics.errors import CHI2_95_3D, normalised_squared_errors_in_space
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate

T4 = [0.0, 1.0, 2.0, 3.0]


def test_four_frames_by_hand() -> None:
    true = truth(T4, [10, 10], z=[1.0, 1.5, 2.0, 2.5])
    found = heights(tracks(T4, [[13, 14], [10, 10], [11, 10], [10, 8]], var=4.0), [1.0, 2.5, 2.0, 1.5], (0, 0, 1.0))
    result = evaluate(found, true, None, scene())
    m, e = result.metrics, result.errors
    # errors (3, 4, 0) (0, 0, 1) (1, 0, 0) (0, -2, -1)
    np.testing.assert_allclose(e.error_z, [0, 1, 0, -1], atol=1e-12)
    np.testing.assert_allclose(e.error_space, [5, 1, 1, math.sqrt(5)])
    np.testing.assert_allclose(e.truth_z, [1.0, 1.5, 2.0, 2.5])
    np.testing.assert_allclose(e.nees_space, [25 / 4, 1, 1 / 4, 1 + 1])
    assert m["rmse_space_m"] == pytest.approx(math.sqrt((25 + 1 + 1 + 5) / 4))
    assert m["rmse_z_m"] == pytest.approx(math.sqrt(2 / 4))
    assert m["rmse_m"] == pytest.approx(math.sqrt((25 + 0 + 1 + 4) / 4))
    assert m["error_space_mean_m"] == pytest.approx((5 + 1 + 1 + math.sqrt(5)) / 4)
    assert m["error_space_median_m"] == pytest.approx((1 + math.sqrt(5)) / 2)
    assert m["error_space_max_m"] == 5.0
    assert m["bias_z_m"] == pytest.approx(0.0, abs=1e-12)
    assert m["nees_space_mean"] == pytest.approx((6.25 + 1 + 0.25 + 2) / 4)
    assert (m["nees_space_share_95"], m["nees_space_singular"], m["estimates_space"]) == (1.0, 0, 4)
    assert m["rmse_space_target_0_m"] == m["rmse_space_m"]


def test_covariances_with_the_height_count() -> None:
    found = heights(tracks([0.0], [11, 12], var=2.0), 4.0, (0.5, -0.3, 1.5))
    m = evaluate(found, truth([0.0], [10, 10], z=1.0), None, scene()).metrics
    P, e = np.array([[2, 0, 0.5], [0, 2, -0.3], [0.5, -0.3, 1.5]]), np.array([1.0, 2.0, 3.0])
    assert m["nees_space_mean"] == pytest.approx(e @ np.linalg.inv(P) @ e)


def test_height_counts_only_where_both_are_known() -> None:
    true = both(truth(T4, [10, 10], 0, z=[1.0, np.nan, np.nan, 1.0]), truth(T4, [5, 5], 1))
    found = both(heights(tracks(T4, [10, 10], 0), [1.5, 1, 1, np.nan]), heights(tracks(T4, [5, 5], 1), 2.0))
    result = evaluate(found, true, None, scene())
    first = result.errors.take(result.errors.target_id == 0)
    assert np.isfinite(first.error_z).tolist() == [True, False, False, False]
    assert result.metrics["estimates_space"] == 1
    assert result.metrics["estimates"] == 8
    assert "rmse_z_target_1_m" not in result.metrics
    assert result.metrics["rmse_z_m"] == pytest.approx(0.5)


def test_true_heights_are_interpolated_under_the_same_limit() -> None:
    true = truth([0.0, 0.5, 1.0, 3.0], [10, 10], z=[1.0, np.nan, 2.0, 4.0])
    found, limit = heights(tracks([0.25, 1.0, 2.0, 3.0], [10, 10]), 0.0), EvaluateConfig(max_gap_s=1.0)
    errors = evaluate(found, true, None, scene(), limit).errors
    np.testing.assert_allclose(errors.truth_z, [1.25, 2.0, 4.0])  # no truth at all at 2 s
    usual = evaluate(found, true, None, scene()).errors  # 0.75 s: heights are 1 s apart
    np.testing.assert_allclose(usual.truth_z, [np.nan, 2.0, 4.0])


def test_tracks_on_the_ground_have_no_figures_in_space() -> None:
    result = evaluate(tracks(T4, [10, 10]), truth(T4, [10, 10], z=1.0), None, scene())
    assert not [name for name in result.metrics if "space" in name or "_z" in name]
    assert np.isnan(result.errors.error_space).all()
    np.testing.assert_array_equal(result.errors.truth_z, 1.0)


def test_settled_figures_are_given_in_space_too() -> None:
    found = heights(tracks(T4, [10, 10]), [9.0, 1.0, 1.0, 3.0])
    m = evaluate(found, truth(T4, [10, 10], z=1.0), None, scene(), EvaluateConfig(settling_s=1.0)).metrics
    assert m["settled_rmse_z_m"] == pytest.approx(math.sqrt(4 / 3))
    assert m["settled_rmse_space_m"] == m["settled_rmse_z_m"]


@pytest.mark.parametrize("seed", range(3))
def test_consistent_errors_have_mean_nees_3_and_95_per_cent_inside(seed: int) -> None:
    """4000 draws: chi-square of 3 has variance 6, so 4 standard errors are 0.155; of the share 0.014."""
    rng, n = np.random.default_rng(seed), 4000
    root = rng.standard_normal((n, 3, 3)) * np.array([1.0, 10.0, 0.01])[:, None]
    P = root @ np.swapaxes(root, 1, 2) + 1e-6 * np.eye(3)
    e = np.einsum("nij,nj->ni", np.linalg.cholesky(P), rng.standard_normal((n, 3)))
    nees = normalised_squared_errors_in_space(e, P)
    direct = np.array([v @ np.linalg.inv(m) @ v for v, m in zip(e, P, strict=True)])
    good = np.isfinite(nees)
    assert good.mean() > 0.99
    np.testing.assert_allclose(nees[good], direct[good], rtol=1e-6)
    assert abs(nees[good].mean() - 3.0) < 4 * math.sqrt(6 / n)
    assert abs(np.mean(nees[good] <= CHI2_95_3D) - 0.95) < 4 * math.sqrt(0.95 * 0.05 / n)


def test_singular_or_unknown_covariances_have_no_nees() -> None:
    P = np.array([np.eye(3), np.diag([1.0, 1.0, 0.0]), np.ones((3, 3)), np.full((3, 3), np.nan)])
    nees = normalised_squared_errors_in_space(np.ones((4, 3)), P)
    np.testing.assert_array_equal(np.isfinite(nees), [True, False, False, False])
    assert nees[0] == 3.0
