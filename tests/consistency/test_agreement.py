"""Shares of bearings not believed and normalised squared residuals, over parts and sensors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.consistency.bearings import MIN_RESIDUAL_VARIANCE, ResidualStatistics, SensorConsistency, pose_shares
from occlog.records.scene import Camera, Scene, camera_rotation
from occlog.records.tables import Residuals, Tracks


def rows(n: int, doubted: int = 0, residual: float = 1.0, sensor: str = "cam1", expected: float = 1.0) -> Residuals:
    believed = np.ones(n)
    believed[:doubted] = 0.0
    return Residuals.of(
        t_ns=np.arange(n),
        target_id=np.zeros(n, dtype=np.int32),
        sensor=np.full(n, sensor),
        residual=np.where(believed > 0.5, residual, 50.0),
        expected_variance=np.full(n, expected),
        inlier_probability=believed,
    )


def collected(*parts: Residuals, poses: dict[str, float] | None = None) -> ResidualStatistics:
    made = ResidualStatistics()
    for part in parts:
        made.add(part, poses)
    return made


def test_no_residuals_say_nothing() -> None:
    made = collected(Residuals.empty())
    assert made.figures() == {}
    assert math.isnan(made.doubted)
    assert math.isnan(made.nis.value)
    assert math.isnan(SensorConsistency().doubted)


def test_figures_add_up_over_parts_and_sensors() -> None:
    made = collected(rows(10, 2), rows(10, 0, 2.0, "cam2"), rows(5, 1))
    found = made.figures()
    assert (found["bearings"], found["rejected_bearings"]) == (25, 3)
    assert found["nis"] == pytest.approx((12 + 40) / 22)
    assert (made.sensors["cam1"].bearings, made.sensors["cam1"].inliers) == (15, 12)
    assert made.sensors["cam1"].doubted == pytest.approx(0.2)


def test_bearings_that_an_estimate_goes_through_do_not_count() -> None:
    assert collected(rows(50, residual=9.0, expected=0.99 * MIN_RESIDUAL_VARIANCE)).nis.degrees == 0.0
    assert collected(rows(50, residual=9.0, expected=MIN_RESIDUAL_VARIANCE)).nis.value == pytest.approx(
        81 / MIN_RESIDUAL_VARIANCE
    )


def test_errors_of_a_pose_are_one_error_however_many_bearings_there_are() -> None:
    rng = np.random.default_rng(0)
    part = rows(10_000, residual=1.0)
    part = Residuals.of(
        **{c.name: getattr(part, c.name) for c in Residuals.columns()} | {"residual": rng.normal(size=10_000)}
    )
    assert collected(part).nis.error < 0.05
    # Of a bearing whose variance is all the pose's there is one square
    assert collected(part, poses={"cam1": 1.0}).nis.degrees == pytest.approx(1.0, rel=0.01)
    assert collected(part, poses={"cam1": 0.5}).nis.degrees == pytest.approx(4.0, rel=0.05)


def test_the_pose_s_share_is_that_of_eq_2_at_the_median_distance() -> None:
    def camera(name: str, position: float, yaw: float) -> Camera:
        return Camera(
            name,
            np.zeros(3),
            camera_rotation(0.0, 0.0, 0.0),
            np.array([100.0, 100.0]),
            np.zeros(2),
            sigma_position=position,
            sigma_yaw=yaw,
            sigma_read_px=2.0,
        )

    n = 3
    zeros = dict.fromkeys(("y", "vx", "vy", "cov_xy"), np.zeros(n))
    tracks = Tracks.of(
        t_ns=np.arange(n),
        target_id=np.zeros(n, np.int32),
        x=[1.0, 10.0, 90.0],
        cov_xx=np.ones(n),
        cov_yy=np.ones(n),
        **zeros,
    )
    scene = Scene((camera("exact", 0.0, 0.0), camera("turned", 0.0, 0.02), camera("moved", 0.2, 0.0)))
    assert pose_shares(tracks, scene) == {"turned": pytest.approx(0.5), "moved": pytest.approx(0.5)}
    assert pose_shares(Tracks.empty(), scene) == {}


def test_the_largest_noise_of_a_target_s_motion_is_kept() -> None:
    made = ResidualStatistics()
    for factor in (2.0, 5.0, 3.0):
        made.moves(7, factor)
    assert made.noise == {7: 5.0}
