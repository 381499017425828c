"""Fixed errors of poses from bearings: Jacobians, what cannot be observed, and agreement with a plain joint fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import multivariate_normal

from occlog.core.geometry.camera import noise_variance, planar_offsets
from occlog.track.methods.apf.kernels.pose_errors import (
    MIN_DISTANCE_RATIO,
    PRIOR_COUNT,
    LabelledBearings,
    evidence,
    intersection_point,
    jacobians,
    prior_belief,
    residuals,
    solve,
    spread,
    update,
)

PLACES = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0], [50.0, 0.0]])
SIGMA = np.array([1.0, 1.0, 0.01])


def make(seed, scans=60, noise=0.01, sensors=5, sigma=SIGMA):
    """True errors, true places (T, 2) and what the sensors report, each with another noise."""
    rng, sigmas = np.random.default_rng(seed), np.maximum(noise * np.linspace(0.5, 1.5, sensors), 1e-6)
    errors = sigma * rng.standard_normal((sensors, 3))
    path = rng.uniform(15.0, 85.0, (scans, 2))
    out = []
    for xy in path:
        away = xy - PLACES[:sensors] - errors[:, :2]
        bearing = (
            np.arctan2(away[:, 1], away[:, 0]) - errors[:, 2] + (noise > 0.0) * sigmas * rng.standard_normal(sensors)
        )
        out.append(LabelledBearings(np.arange(sensors), bearing, sigmas**2))
    return errors, path, out


def prior(sensors=5):
    return prior_belief(np.full(sensors, SIGMA[0]), np.full(sensors, SIGMA[2]))


def gauges(sensors=5):
    """(3 S, 4) shifts, turn and change of scale of all sensors together."""
    columns = []
    for shift, turn, scale in (((1, 0), 0, 0), ((0, 1), 0, 0), ((0, 0), 1, 0), ((0, 0), 0, 1)):
        place = PLACES[:sensors]
        e = np.zeros((sensors, 3))
        e[:, :2] = shift + turn * np.column_stack([-place[:, 1], place[:, 0]]) + scale * place
        e[:, 2] = turn
        columns.append(e.ravel())
    return np.column_stack(columns)


def test_jacobians_are_the_derivatives_of_the_residuals():
    rng = np.random.default_rng(0)
    xy, mean = np.array([30.0, 40.0]), np.zeros((5, 3))
    sights = LabelledBearings(np.arange(5), np.zeros(5), np.ones(5))
    by_target, by_error = jacobians(xy, PLACES)
    for _ in range(10):
        move, turn = 1e-6 * rng.standard_normal(2), 1e-6 * rng.standard_normal((5, 3))
        before, after = residuals(xy, sights, PLACES, mean), residuals(xy + move, sights, PLACES, mean + turn)
        # Bearings change with the true place and errors; residuals change by the opposite.
        np.testing.assert_allclose(before - after, by_target @ move + np.sum(by_error * turn, axis=1), atol=1e-11)


def test_the_variance_from_errors_is_that_of_eq_2():
    xy = np.array([30.0, 40.0])
    yaw = np.radians(45.0)
    h, d = planar_offsets(xy[None], PLACES[0], yaw)
    in_pixels = noise_variance(h, d, 70.0, 1.0, 0.01, 0.0)
    per_radian = 70.0 * (1.0 + (h / d) ** 2)
    found = spread(xy, np.array([0]), PLACES, prior())
    np.testing.assert_allclose(found * per_radian**2, in_pixels, rtol=1e-12)


def test_the_variance_of_any_covariance_is_that_of_drawn_errors():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((3, 3)) * SIGMA[:, None] * 0.1
    belief = prior(1)._replace(covariance=root @ root.T)
    xy = np.array([30.0, 40.0])
    errors = (root @ rng.standard_normal((3, 100_000))).T
    away = xy - errors[:, :2]
    bearing = np.arctan2(away[:, 1], away[:, 0]) - errors[:, 2]
    # Relative standard error of a variance from 100,000 draws: 0.45 %
    assert spread(xy, np.array([0]), PLACES, belief)[0] == pytest.approx(np.var(bearing), rel=0.02)


def test_lines_without_noise_meet_at_the_target():
    errors, path, scans = make(2, scans=20, noise=0.0)
    for xy, sights in zip(path, scans, strict=True):
        found = intersection_point(sights, PLACES, errors, xy + 5.0)
        assert found is not None
        np.testing.assert_allclose(found, xy, atol=1e-5)


def test_lines_that_do_not_meet_in_front_are_refused():
    sights = LabelledBearings(np.arange(2), np.array([np.pi * 0.9, 0.1]), np.full(2, 1e-4))
    assert intersection_point(sights, PLACES, np.zeros((5, 3)), np.array([50.0, 50.0])) is None


@given(seed=st.integers(0, 10_000))
def test_moving_everything_together_leaves_no_evidence(seed):
    _, path, scans = make(seed, scans=1)
    found = evidence(scans[0], PLACES, np.zeros((5, 3)), path[0])
    if found is not None:
        _, G = found
        scale = np.linalg.norm(G) * np.linalg.norm(gauges(), axis=0)
        assert np.all(np.linalg.norm(G @ gauges(), axis=0) < 1e-9 * scale)


def test_two_bearings_change_nothing():
    _, path, scans = make(3, scans=1)
    two = LabelledBearings(*(column[:2] for column in scans[0]))
    assert update(prior(), two, PLACES, path[0]) is not None
    assert evidence(two, PLACES, np.zeros((5, 3)), path[0]) is None
    after = update(prior(), two, PLACES, path[0])
    np.testing.assert_array_equal(after.covariance, prior().covariance)


def test_what_cannot_be_observed_keeps_its_uncertainty():
    """However many scans: along the gauges the posterior precision is the prior's."""
    _, path, scans = make(4, scans=800)
    belief = prior()
    for xy, sights in zip(path, scans, strict=True):
        belief = update(belief, sights, PLACES, xy)
    D = gauges()
    before, after = (D.T @ np.linalg.solve(b.covariance, D) for b in (prior(), belief))
    np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-6 * np.abs(before).max())
    # The mean position of all cameras stays as uncertain as it was, one camera relative to the others does not.
    shift = np.tile([1.0, 0.0, 0.0], 5) / 5
    assert shift @ belief.covariance @ shift > 0.8 * shift @ prior().covariance @ shift
    relative = gauges()[:, 0] * 0.0
    relative[0], relative[[3, 6, 9, 12]] = 1.0, -0.25
    assert relative @ belief.covariance @ relative < 0.7 * relative @ prior().covariance @ relative


def joint_fit(scans, starts, sensors=5):
    """Trajectory and errors by a plain least-squares fit of everything: the textbook form."""

    def miss(values):
        e = (values[: 3 * sensors].reshape(sensors, 3)) * SIGMA
        path = values[3 * sensors :].reshape(-1, 2)
        rows = [values[: 3 * sensors]]
        for xy, s in zip(path, scans, strict=True):
            away = xy - PLACES[s.sensor] - e[s.sensor, :2]
            rows.append((s.bearing + e[s.sensor, 2] - np.arctan2(away[:, 1], away[:, 0])) / np.sqrt(s.variance))
        return np.concatenate(rows)

    found = least_squares(miss, np.concatenate([np.zeros(3 * sensors), np.ravel(starts)]), x_scale="jac")
    J = found.jac
    covariance = np.linalg.inv(J.T @ J)[: 3 * sensors, : 3 * sensors]
    scale = np.tile(SIGMA, sensors)
    return (found.x[: 3 * sensors].reshape(sensors, 3)) * SIGMA, covariance * np.outer(scale, scale)


@pytest.mark.parametrize("seed", [5, 6])
def test_solving_all_scans_agrees_with_a_plain_joint_fit(seed):
    _, path, scans = make(seed, scans=40, noise=0.003)
    found = solve(prior(), scans, PLACES, path)
    mean, covariance = joint_fit(scans, path)
    deviation = np.sqrt(np.diag(covariance)).reshape(5, 3)
    scale = found.scale
    assert scale < 1.4
    assert np.max(np.abs(found.mean - mean) / deviation) < 0.25
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)).reshape(5, 3), deviation, rtol=0.1 + scale - 1.0)


@pytest.mark.jit
@pytest.mark.parametrize("how", ["update", "solve"])
def test_estimates_are_consistent_with_the_true_errors(how):
    """The normalised squared error is chi-squared with 15 degrees of freedom: over 6 runs its mean is 15 +- 2.2."""
    squares, scales = [], []
    for seed in range(6):
        errors, path, scans = make(100 + seed, scans=100, noise=0.02)
        belief = prior()
        if how == "update":
            for xy, sights in zip(path, scans, strict=True):
                belief = update(belief, sights, PLACES, xy)
        else:
            belief = solve(belief, scans, PLACES, path)
        miss = (belief.mean - errors).ravel()
        squares.append(miss @ np.linalg.solve(belief.covariance, miss))
        scales.append(belief.scale)
    assert 8.4 < np.mean(squares) < 21.6  # within 3 standard errors
    assert np.mean(scales) < 1.1


def test_errors_that_are_drawn_again_are_noticed():
    """White noise of 1.5 times the stated variance: nothing is learned that is not there, and the scale is found."""
    rng = np.random.default_rng(7)
    belief = prior()
    for _ in range(600):
        xy = rng.uniform(15.0, 85.0, 2)
        away = xy - PLACES
        bearing = np.arctan2(away[:, 1], away[:, 0]) + 0.02 * np.sqrt(1.5) * rng.standard_normal(5)
        belief = update(belief, LabelledBearings(np.arange(5), bearing, np.full(5, 0.02**2)), PLACES, xy)
    # 1800 residuals: relative standard error 3 %
    assert belief.scale == pytest.approx(1.5, abs=0.15)
    assert np.sqrt(np.mean(belief.mean[:, 2] ** 2)) < 0.005
    assert belief.counted > PRIOR_COUNT


def test_a_false_bearing_is_not_learned_from():
    _, path, scans = make(8, scans=50, noise=0.005)
    belief = prior()
    for xy, sights in zip(path, scans, strict=True):
        belief = update(belief, sights, PLACES, xy)
    false = scans[0]._replace(bearing=scans[0].bearing + np.array([0.5, 0, 0, 0, 0]))
    np.testing.assert_array_equal(update(belief, false, PLACES, path[0]).mean, belief.mean)


def test_a_sensor_without_errors_keeps_none():
    errors, path, scans = make(9, sigma=SIGMA * np.ones((5, 1)) * np.array([[0], [1], [1], [1], [1]]))
    sigma = np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    belief = prior_belief(sigma, 0.01 * sigma)
    assert np.all(errors[0] == 0.0)
    solved = solve(belief, scans, PLACES, path)
    for xy, sights in zip(path, scans, strict=True):
        belief = update(belief, sights, PLACES, xy)
    for found in (belief, solved):
        np.testing.assert_array_equal(found.mean[0], 0.0)
        np.testing.assert_array_equal(found.blocks[0], 0.0)
        assert np.all(np.isfinite(found.covariance))


def test_residuals_are_the_shorter_way_round():
    sights = LabelledBearings(np.zeros(3, dtype=np.int64), np.array([3.0, -3.0, 1.0]), np.ones(3))
    behind = np.array([-50.0, 0.0])  # at a bearing of pi
    want = [3.0 - np.pi, np.pi - 3.0, 1.0 + np.pi - 2 * np.pi]
    np.testing.assert_allclose(residuals(behind, sights, PLACES[:1], np.zeros((1, 3))), want, atol=1e-12)


@pytest.mark.parametrize(("share", "found"), [(0.99, False), (1.01, True)])
def test_a_target_much_nearer_to_one_sensor_than_to_the_others_is_refused(share, found):
    """From sensors 100 apart the target is next to the first one, at `share * NEAREST` of its distance to the other."""
    positions = np.array([[0.0, 0.0], [100.0, 0.0]])
    ratio = share * MIN_DISTANCE_RATIO
    target = np.array([0.0, 100.0 * ratio / np.sqrt(1.0 - ratio**2)])
    away = target - positions
    sights = LabelledBearings(np.arange(2), np.arctan2(away[:, 1], away[:, 0]), np.full(2, 1e-6))
    assert (intersection_point(sights, positions, np.zeros((2, 3)), target * 1.02) is not None) == found


def test_an_update_is_the_kalman_filters_with_odds_against_errors_that_are_drawn_again_at_each_time():
    """With the evidence y = G (e - m) + n as the measurement, of which n has the learned scale."""
    _, path, scans = make(11, scans=12, noise=0.002)
    belief = prior()._replace(excess=30.0, counted=9.0)
    for sights, start in zip(scans, path, strict=True):
        y, G = evidence(sights, PLACES, belief.mean, start)
        scale, m, C, one = belief.scale, belief.mean.ravel(), belief.covariance, np.eye(len(y))
        assert scale > 1.0
        S = G @ C @ G.T + scale * one
        covariance = np.linalg.inv(np.linalg.inv(C) + G.T @ G / scale)
        own, white = (multivariate_normal(np.zeros(len(y)), V) for V in (S, (G * belief.prior) @ G.T + one))
        got = update(belief, sights, PLACES, start)
        np.testing.assert_allclose(got.covariance, covariance, rtol=1e-5, atol=1e-12)
        np.testing.assert_allclose(got.mean.ravel(), m + covariance @ G.T @ y / scale, rtol=1e-5, atol=1e-9)
        assert got.log_odds == pytest.approx(belief.log_odds + own.logpdf(y) - white.logpdf(y + G @ m))
        assert got.excess == pytest.approx(belief.excess + y @ np.linalg.solve(G @ C @ G.T + one, y))
        assert got.counted == belief.counted + len(y)
        belief = got
    # The errors are fixed
    assert belief.log_odds > 10.0
