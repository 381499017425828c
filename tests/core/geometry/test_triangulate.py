"""Where sight lines meet: against a general optimiser, Monte Carlo, by hand, and a published field example."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from occlog.array_types import Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.triangulate import (
    DISAGREEING,
    NEAR_PARALLEL,
    TOO_FEW,
    TRIANGULATED,
    TriangulatedPoint,
    triangulate,
)

CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def azimuths_of(xy: Floats, origins: Floats) -> Floats:
    return np.arctan2(xy[1] - origins[:, 1], xy[0] - origins[:, 0])


def meet(origins: Floats, azimuths: Floats, sigma: float = 0.01, **options: object) -> TriangulatedPoint:
    """One scan of lines of equal accuracy."""
    sigmas = np.full(len(azimuths), sigma)
    return triangulate(origins, azimuths, sigmas, np.array([0, len(azimuths)]), **options)  # type: ignore[arg-type]


def test_two_lines_by_hand() -> None:
    found = meet(CORNERS[:2], np.radians([45.0, 135.0]), sigma=0.1)
    np.testing.assert_allclose(found.xy[0], [5.0, 5.0])
    # Lines at right angles, both sqrt(50) away: 0.1^2 * 50 along each line's normal
    np.testing.assert_allclose(found.covariance[0], 0.5 * np.eye(2), atol=1e-12)
    np.testing.assert_allclose(found.residual, 0.0, atol=1e-12)


@pytest.mark.parametrize("loss", ["gauss", "huber", "cauchy"])
@given(x=st.floats(-8, 18), y=st.floats(-8, 18), turn=st.floats(-3.2, 3.2))
def test_exact_lines_meet_at_the_target_for_any_turn(loss: str, x: float, y: float, turn: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    R, xy = np.array([[c, -s], [s, c]]), np.array([x, y])
    if np.linalg.norm(CORNERS - xy, axis=1).min() < 0.1:
        return
    found = meet(CORNERS @ R.T, azimuths_of(R @ xy, CORNERS @ R.T), loss=loss)
    assert found.status[0] == TRIANGULATED
    np.testing.assert_allclose(found.xy[0], R @ xy, atol=1e-6)


@pytest.mark.parametrize("loss", ["gauss", "huber", "cauchy"])
@pytest.mark.parametrize("seed", range(5))
def test_against_a_general_optimiser(loss: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    origins, xy, sigma = rng.uniform(-10, 10, (6, 2)), rng.uniform(-5, 5, 2), rng.uniform(0.01, 0.05, 6)
    z = azimuths_of(xy, origins) + sigma * rng.normal(size=6)
    found = triangulate(origins, z, sigma, np.array([0, 6]), loss=loss)
    name, scale = {"gauss": ("linear", 1.0), "huber": ("huber", 1.345), "cauchy": ("cauchy", 2.385)}[loss]
    best = least_squares(
        lambda p: np.asarray(wrap_angle(z - azimuths_of(p, origins))) / sigma,
        xy,
        loss=name,
        f_scale=scale,
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-12,
    )
    np.testing.assert_allclose(found.xy[0], best.x, atol=2e-5)


def test_covariance_is_that_of_repeated_trials() -> None:
    rng, xy, sigma, runs = np.random.default_rng(1), np.array([3.0, 7.0]), 0.01, 5000
    z = azimuths_of(xy, CORNERS) + sigma * rng.normal(size=(runs, 4))
    found = triangulate(np.tile(CORNERS, (runs, 1)), z.ravel(), np.full(4 * runs, sigma), np.arange(runs + 1) * 4)
    assert (found.status == TRIANGULATED).all()
    sample = np.cov(found.xy.T)
    # A sample variance scatters by sqrt(2 / runs) = 2 %; 4 of these
    np.testing.assert_allclose(found.covariance.mean(axis=0), sample, rtol=0.08, atol=0.08 * sample[0, 0])
    chi2 = np.sum((found.residual.reshape(runs, 4) / sigma) ** 2, axis=1)
    assert abs(chi2.mean() - 2.0) < 4 * 2.0 / np.sqrt(runs)  # 4 lines - 2 coordinates


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_robust_forms_pull_away_from_one_wild_line(loss: str) -> None:
    xy = np.array([4.0, 6.0])
    origins = np.vstack([CORNERS, [[5.0, -3.0]]])
    z = azimuths_of(xy, origins)
    z[2] += 0.5  # 50 sigma
    plain = np.linalg.norm(meet(origins, z).xy[0] - xy)
    robust = np.linalg.norm(meet(origins, z, loss=loss).xy[0] - xy)
    assert plain > 0.8
    assert robust < {"huber": 0.1, "cauchy": 0.01}[loss]


def test_cauchy_ignores_a_line_that_looks_away() -> None:
    xy = np.array([4.0, 6.0])
    z = azimuths_of(xy, CORNERS)
    z[0] = wrap_angle(z[0] + np.pi)
    found = meet(CORNERS, z, loss="cauchy")
    assert found.status[0] == TRIANGULATED
    np.testing.assert_allclose(found.xy[0], xy, atol=0.01)


def test_refusals() -> None:
    few = meet(CORNERS[:1], np.array([0.3]))
    none = meet(CORNERS[:0], np.zeros(0))
    parallel = meet(CORNERS[:2], np.radians([90.0, 94.0]))
    baseline = meet(CORNERS[:2], np.array([0.0, np.pi]))
    apart = meet(CORNERS[:2], np.radians([135.0, 45.0]))  # meet below, behind both
    assert [r.status[0] for r in (few, none, parallel, baseline, apart)] == [
        TOO_FEW,
        TOO_FEW,
        NEAR_PARALLEL,
        NEAR_PARALLEL,
        DISAGREEING,
    ]
    for refused in (few, parallel, baseline, apart):
        assert np.isnan(refused.xy).all()
        assert np.isnan(refused.covariance).all()
        assert np.isnan(refused.residual).all()


def test_crossing_limit() -> None:
    z = np.radians([90.0, 96.0])
    assert meet(CORNERS[:2], z).status[0] == TRIANGULATED
    assert meet(CORNERS[:2], z, min_crossing=np.radians(7.0)).status[0] == NEAR_PARALLEL


def test_wild_line_does_not_lend_its_crossing_to_parallel_ones() -> None:
    # Two lines agree on a far target at 0.6 degrees; the third crosses both well, far from there
    origins = np.array([[0.0, 0.0], [1.0, 0.0], [5.0, 5.0]])
    z = azimuths_of(np.array([0.5, 100.0]), origins)
    z[2] = 0.0
    assert meet(origins, z, sigma=1e-4, loss="cauchy").status[0] != TRIANGULATED


def test_scans_of_unequal_length_are_kept_apart() -> None:
    targets = np.array([[3.0, 3.0], [7.0, 2.0]])
    origins = np.vstack([CORNERS[:2], CORNERS[:1], CORNERS[1:]])
    z = np.concatenate([azimuths_of(targets[0], CORNERS[:2]), [0.1], azimuths_of(targets[1], CORNERS[1:])])
    found = triangulate(origins, z, np.full(6, 0.01), np.array([0, 2, 3, 6]))
    assert found.status.tolist() == [TRIANGULATED, TOO_FEW, TRIANGULATED]
    np.testing.assert_allclose(found.xy[[0, 2]], targets, atol=1e-9)
    assert np.isnan(found.residual[2])


def test_more_accurate_lines_count_more() -> None:
    z = np.radians([45.0, 135.0, -130.0])
    sharp = triangulate(CORNERS[:3], z, np.array([1e-4, 1e-4, 0.1]), np.array([0, 3]))
    np.testing.assert_allclose(sharp.xy[0], [5.0, 5.0], atol=1e-3)


def test_unknown_loss() -> None:
    with pytest.raises(ValueError, match="gauss, huber, cauchy"):
        meet(CORNERS, np.zeros(4), loss="median")


@pytest.mark.parametrize(("left_out", "published"), [(5, (7.23, 1.98)), (None, (5.87, 1.13))])
def test_published_field_example(shared_data: Path, left_out: int | None, published: tuple[float, float]) -> None:
    """Lenth (1981), Table 1: published fixes from eight radio bearings; his noise is von Mises, not Gaussian."""
    rows = np.loadtxt(shared_data / "telemetr_bearings" / "lenth.dat", skiprows=1, usecols=(1, 2, 3))
    if left_out is not None:
        rows = np.delete(rows, left_out, axis=0)
        found = meet(rows[:, :2], np.asarray(wrap_angle(np.radians(90.0 - rows[:, 2]))), sigma=0.05)
        np.testing.assert_allclose(found.xy[0], published, atol=0.01)
    else:
        # The outlier drags the plain fix far off; the robust one stays where Lenth's Andrews estimate is
        z = np.asarray(wrap_angle(np.radians(90.0 - rows[:, 2])))
        assert np.linalg.norm(meet(rows[:, :2], z, sigma=0.05).xy[0] - published) < 0.6
        np.testing.assert_allclose(meet(rows[:, :2], z, sigma=0.05, loss="cauchy").xy[0], (7.21, 1.97), atol=0.05)


@pytest.mark.parametrize("loss", ["gauss", "huber", "cauchy"])
def test_lines_that_cross_behind_one_of_their_sensors_do_not_meet(loss: str) -> None:
    # The line of (10, 0) crosses that of the origin ahead of it, at (5, 0), but behind (10, 0)
    assert meet(np.array([[0.0, 0.0], [10.0, 5.0]]), np.radians([0.0, 45.0]), loss=loss).status[0] == DISAGREEING
    assert meet(np.array([[10.0, 5.0], [0.0, 0.0]]), np.radians([45.0, 0.0]), loss=loss).status[0] == DISAGREEING
    # Two lines nearly parallel in addition: every crossing at a wide angle is behind the second sensor
    origins = np.array([[0.0, 0.0], [10.0, 5.0], [0.0, 1.0]])
    assert meet(origins, np.radians([0.0, 45.0, 1.0]), loss=loss).status[0] == DISAGREEING


def test_a_crossing_at_the_least_angle_is_taken_and_one_just_below_is_not() -> None:
    z = np.radians([90.0, 96.0])
    crossing = z[1] - z[0]
    assert meet(CORNERS[:2], z, min_crossing=crossing * (1.0 - 1e-9)).status[0] == TRIANGULATED
    assert meet(CORNERS[:2], z, min_crossing=crossing * (1.0 + 1e-9)).status[0] == NEAR_PARALLEL
    assert meet(CORNERS[:2], np.radians([90.0, 95.001])).status[0] == TRIANGULATED  # the default is 5 degrees
    assert meet(CORNERS[:2], np.radians([90.0, 94.999])).status[0] == NEAR_PARALLEL


@pytest.mark.parametrize("seed", range(5))
def test_the_weighted_residuals_have_no_slope_at_the_position(seed: int) -> None:
    """Sensors side by side and a far target: the errors of both coordinates go together."""
    rng = np.random.default_rng(seed)
    origins, xy, sigma = np.column_stack([np.linspace(0, 8, 5), rng.uniform(-1, 1, 5)]), np.array([20.0, 15.0]), 0.01
    found = meet(origins, azimuths_of(xy, origins) + sigma * rng.normal(size=5), sigma)
    away = found.xy[0] - origins
    gradient = np.column_stack([-away[:, 1], away[:, 0]]) / np.sum(away**2, axis=1)[:, None] / sigma
    slope = gradient.T @ (found.residual / sigma)
    # in standard deviations of the position
    assert slope @ found.covariance[0] @ slope < 1e-12
