"""Lines of sight of detections, their intersection and the motion of an object, against textbook forms in matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.array_types import NS, Floats
from occlog.measure.fuse.kernels import (
    NEAREST,
    LocalDirections,
    MotionEstimate,
    PositionWithCovariance,
    ahead,
    begin,
    corrected_by_line,
    corrected_by_place,
    deviations,
    meet,
    misfit,
    points,
)

AT = PositionWithCovariance(np.array([3.0, 4.0]), np.array([[0.3, 0.1], [0.1, 0.2]]))
ORIGINS = np.array([[0.0, -1.0], [6.0, 1.0], [-2.0, 5.0]])
OFF = np.array([0.1, -0.05, 0.2])
"""Errors of the azimuths of lines from `ORIGINS` to `AT`."""
FURTHER = np.array([0.5, math.nan, -0.3])
"""Errors of their distances; NaN: unknown."""


def sights(off: Floats = OFF, further: Floats = FURTHER) -> LocalDirections:
    """Lines of sight with errors of the azimuth and of the distance."""
    away = AT.xy - ORIGINS
    return LocalDirections(
        sensor=np.arange(3),
        origin=ORIGINS,
        azimuth=np.arctan2(away[:, 1], away[:, 0]) + off,
        sigma=np.array([0.02, 0.03, 0.05]),
        distance=np.hypot(*away.T) + further,
        sigma_distance=np.where(np.isnan(further), math.nan, [0.4, 0.5, 0.6]),
    )


def axes_of(azimuth: float) -> Floats:
    """Rows: unit vectors across (left) and along a line."""
    return np.array([[-math.sin(azimuth), math.cos(azimuth)], [math.cos(azimuth), math.sin(azimuth)]])


def test_deviations_are_offsets_in_the_axes_of_each_line() -> None:
    sight = sights()
    offset, variance = deviations(sight, AT)
    for row in range(3):
        away = AT.xy - ORIGINS[row]
        turned = axes_of(sight.azimuth[row]) @ away
        known = row != 1
        np.testing.assert_allclose(offset[row], [-turned[0], (sight.distance[row] - turned[1]) if known else 0.0])
        r = math.hypot(*away)
        wanted = [(r * sight.sigma[row]) ** 2, sight.sigma_distance[row] ** 2 if known else 0.0]
        np.testing.assert_allclose(variance[row], wanted)
    for turn, finite in ((0.5 * math.pi - 1e-9, True), (0.5 * math.pi + 1e-9, False), (-0.5 * math.pi - 1e-9, False)):
        assert np.isfinite(deviations(sights(np.full(3, turn)), AT)[0][:, 0]).tolist() == [finite] * 3
    # A position at the sensor counts as a micrometre off
    near = deviations(sight, PositionWithCovariance(ORIGINS[0], AT.cov))
    assert near[1][0, 0] == pytest.approx((NEAREST * 0.02) ** 2)


def test_the_misfit_is_the_mahalanobis_distance_with_the_covariances_of_both() -> None:
    sight = sights()
    offset, variance = deviations(sight, AT)
    for extra in (0.0, 0.7):
        got = misfit(sight, AT, extra)
        for row in range(3):
            T = axes_of(sight.azimuth[row])
            S = T @ (AT.cov + extra * np.eye(2)) @ T.T + np.diag(variance[row])
            e = offset[row] if row != 1 else offset[row, :1]
            assert got[row] == pytest.approx(e @ np.linalg.solve(S[: len(e), : len(e)], e))
    assert misfit(sights(np.array([0.1, math.pi, 0.2])), AT)[1] == math.inf


def test_points_have_the_covariance_of_polar_coordinates() -> None:
    sight = sights().take(np.array([2, 0]))
    xy, cov = points(sight)
    for row in range(2):
        T = axes_of(sight.azimuth[row])
        np.testing.assert_allclose(xy[row], sight.origin[row] + sight.distance[row] * T[1])
        spread = np.diag([(sight.distance[row] * sight.sigma[row]) ** 2, sight.sigma_distance[row] ** 2])
        np.testing.assert_allclose(cov[row], T.T @ spread @ T, atol=1e-15)


def test_detections_meet_where_lines_cross_or_else_in_the_weighted_mean_of_those_with_a_distance() -> None:
    found = meet(sights(0.0 * OFF), 0.1)
    assert found is not None
    np.testing.assert_allclose(found.xy, AT.xy, atol=1e-9)
    information = np.zeros((2, 2))
    for row in range(3):
        across = axes_of(sights(0.0 * OFF).azimuth[row])[0]
        information += np.outer(across, across) / (math.hypot(*(AT.xy - ORIGINS[row])) * sights().sigma[row]) ** 2
    np.testing.assert_allclose(found.cov, np.linalg.inv(information), rtol=1e-6)
    # Lines at smaller angles than the limit
    sight = sights()
    xy, cov = points(sight.take(np.array([0, 2])))
    weights = np.linalg.inv(cov)
    total = np.linalg.inv(weights[0] + weights[1])
    other = meet(sight, 1.57)
    assert other is not None
    np.testing.assert_allclose(other.cov, total)
    np.testing.assert_allclose(other.xy, total @ (weights[0] @ xy[0] + weights[1] @ xy[1]))
    assert meet(sights(further=np.full(3, math.nan)), 1.57) is None


def moving() -> MotionEstimate:
    """A state with correlations of all entries."""
    half = np.random.default_rng(0).normal(size=(4, 4))
    return MotionEstimate(5 * NS, np.array([2.6, 4.3, 0.7, -0.4]), 0.3 * half @ half.T)


def test_a_target_begins_at_rest_and_is_predicted_with_white_acceleration() -> None:
    first = begin(7, AT, 1.5)
    assert first.t_ns == 7
    np.testing.assert_array_equal(first.mean, [3.0, 4.0, 0.0, 0.0])
    np.testing.assert_array_equal(first.cov[:2, :2], AT.cov)
    np.testing.assert_array_equal(first.cov[2:, 2:], 2.25 * np.eye(2))
    assert not first.cov[:2, 2:].any()
    now, t = moving(), 1.7
    later = ahead(now, 5 * NS + round(t * NS), 0.6)
    F, Q, one = np.eye(4), np.zeros((4, 4)), np.eye(2)
    F[:2, 2:] = t * one
    Q[:2, :2], Q[:2, 2:], Q[2:, :2], Q[2:, 2:] = t**3 / 3 * one, t**2 / 2 * one, t**2 / 2 * one, t * one
    assert later.t_ns == 6_700_000_000
    np.testing.assert_allclose(later.mean, F @ now.mean)
    np.testing.assert_allclose(later.cov, F @ now.cov @ F.T + 0.6 * Q)
    np.testing.assert_array_equal(later.position.xy, later.mean[:2])
    np.testing.assert_array_equal(later.position.cov, later.cov[:2, :2])


def updated(state: MotionEstimate, H: Floats, innovation: Floats, R: Floats) -> MotionEstimate:
    """The update of the Kalman filter in information form."""
    cov = np.linalg.inv(np.linalg.inv(state.cov) + H.T @ np.linalg.solve(R, H))
    return MotionEstimate(state.t_ns, state.mean + cov @ H.T @ np.linalg.solve(R, innovation), cov)


def test_updates_are_those_of_the_information_filter() -> None:
    now = moving()
    pairs = [(corrected_by_place(now, AT), updated(now, np.eye(2, 4), AT.xy - now.mean[:2], AT.cov))]
    # Lines one after the other, of which the second points away
    sight, wanted = sights(np.array([0.1, 2.0, 0.2])), now
    for row in (0, 2):
        away = wanted.mean[:2] - ORIGINS[row]
        r, beta = math.hypot(*away), math.atan2(away[1], away[0])
        H = np.array([[*axes_of(beta)[0], 0.0, 0.0]])
        off = np.array([r * math.sin(sight.azimuth[row] - beta)])
        wanted = updated(wanted, H, off, np.array([[(r * sight.sigma[row]) ** 2]]))
    pairs.append((corrected_by_line(now, sight), wanted))
    for got, want in pairs:
        assert got.t_ns == now.t_ns
        np.testing.assert_allclose(got.mean, want.mean, rtol=1e-9)
        np.testing.assert_allclose(got.cov, want.cov, rtol=1e-9, atol=1e-12)
