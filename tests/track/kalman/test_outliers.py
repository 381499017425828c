"""Joint hypotheses on false bearings against their textbook form, one hypothesis after the other."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from tracker_scenes import room100

from occlog.array_types import Floats
from occlog.core.plane import make_floor
from occlog.filtering.false_bearings import PRIOR_BEARINGS, FalseBearings
from occlog.filtering.gaussian import Gaussian
from occlog.filtering.likelihood.measurement_model import (
    Linearisation,
    LinearisedRows,
    MeasurementWorld,
    linearise,
    measured,
)
from occlog.track.methods.apf.model import pack_noise, pack_sensors
from occlog.track.methods.kalman.outliers import (
    MAX_JOINT_ROWS,
    log_evidence,
    mixture_update,
    moment_matched,
    subsets,
)
from occlog.track.methods.kalman.updates import Updated, by_linearisation

pytestmark = pytest.mark.jit
SCENE = room100(pillar=True)
WORLD = MeasurementWorld(
    pack_sensors(SCENE), pack_noise(SCENE), make_floor(SCENE.region, [o.polygon for o in SCENE.occluders])
)
STATE = Gaussian(
    np.array([20.0, 30.0, 0.5, -0.5]),
    np.array([[9.0, 2.0, 1.0, 0.0], [2.0, 6.0, 0.0, 0.5], [1.0, 0.0, 0.6, 0.0], [0.0, 0.5, 0.0, 0.4]]),
)


def bearings(sensors: list[int], off: list[float]) -> LinearisedRows:
    """Bearings of (21, 31), each off by so many standard deviations of 0.03 rad."""
    n = len(sensors)
    blank = LinearisedRows(
        np.array(sensors), np.zeros(n, dtype=np.bool_), np.zeros(n), np.full(n, 0.03**2), np.ones(n, dtype=np.bool_)
    )
    expected, _ = measured(np.array([[21.0, 31.0]]), blank, WORLD)
    return blank._replace(value=expected[0] + 0.03 * np.array(off))


def update(state: Gaussian, rows: LinearisedRows, near: Linearisation) -> Updated:
    return by_linearisation(state, rows, near, WORLD)


def textbook(rows: LinearisedRows, false: float) -> tuple[Gaussian, Floats]:
    """Mixture over all hypotheses with the equations of a Kalman filter; probabilities that rows are true."""
    near = linearise(STATE.mean[:2], rows, WORLD)
    n, weights, means, covariances, truths = len(rows.sensor), [], [], [], []
    for true in product([False, True], repeat=n):
        kept = np.array(true)
        H = np.hstack([near.H[kept], np.zeros((kept.sum(), 2))])
        S = H @ STATE.covariance @ H.T + np.diag(near.R[kept])
        K = STATE.covariance @ H.T @ np.linalg.inv(S)
        weight = np.prod(np.where(kept, 1.0 - false, false / WORLD.noise.width[rows.sensor]))
        if kept.any():
            weight *= multivariate_normal(np.zeros(kept.sum()), S).pdf(near.residual[kept])
        weights.append(weight)
        means.append(STATE.mean + K @ near.residual[kept])
        covariances.append(STATE.covariance - K @ S @ K.T)
        truths.append(kept)
    w = np.array(weights) / np.sum(weights)
    mean = w @ np.array(means)
    away = np.array(means) - mean
    spread = np.einsum("h,hij->ij", w, np.array(covariances)) + np.einsum("h,hi,hj->ij", w, away, away)
    return Gaussian(mean, spread), w @ np.array(truths)


@pytest.mark.parametrize("off", [[0.5, -1.0, 0.3], [0.5, 6.0, 0.3], [9.0, 0.0, -9.0], [3.0, 3.0, -3.0]])
@pytest.mark.parametrize("false", [0.02, 0.3])
def test_the_update_is_the_mixture_over_all_hypotheses(off: list[float], false: float) -> None:
    rows = bearings([0, 1, 3], off)
    found = mixture_update(STATE, rows, linearise(STATE.mean[:2], rows, WORLD), WORLD, false, update)
    expected, inlier = textbook(rows, false)
    # Hypotheses of a probability below 0.001 are left out
    np.testing.assert_allclose(found.inlier, inlier, atol=4e-3)
    np.testing.assert_allclose(found.done.state.mean, expected.mean, atol=0.02)
    np.testing.assert_allclose(found.done.state.covariance, expected.covariance, atol=0.1)


def test_evidence_is_the_normal_density_of_each_subset() -> None:
    rows = bearings([0, 1, 2, 3], [0.5, 2.0, -7.0, 1.0])
    near, P = linearise(STATE.mean[:2], rows, WORLD), STATE.covariance[:2, :2]
    found = log_evidence(P, near, near.residual, subsets(4))
    for log, true in zip(found.tolist(), subsets(4), strict=True):
        S = near.H[true] @ P @ near.H[true].T + np.diag(near.R[true])
        density = multivariate_normal(np.zeros(true.sum()), S).logpdf(near.residual[true]) if true.any() else 0.0
        assert log == pytest.approx(density, abs=1e-9)


def test_without_false_bearings_it_is_the_plain_update() -> None:
    rows = bearings([0, 1, 3], [0.5, 6.0, 0.3])
    near = linearise(STATE.mean[:2], rows, WORLD)
    found = mixture_update(STATE, rows, near, WORLD, 0.0, update)
    np.testing.assert_array_equal(found.done.state.mean, update(STATE, rows, near).state.mean)
    np.testing.assert_array_equal(found.inlier, np.ones(3))
    # A likely row changes nothing but by the small probability that it is false
    likely = bearings([0, 1, 3], [0.0, 0.0, 0.0])
    near = linearise(STATE.mean[:2], likely, WORLD)
    found = mixture_update(STATE, likely, near, WORLD, 1e-4, update)
    np.testing.assert_allclose(found.done.state.mean, update(STATE, likely, near).state.mean, atol=1e-3)


def test_many_rows_are_taken_in_parts() -> None:
    sensors = [0, 1, 3, 2] * 4
    rows = bearings(sensors, [0.2, -0.5, 0.4, 0.1] * 3 + [30.0, 0.2, 0.1, -0.3])
    assert len(sensors) > MAX_JOINT_ROWS
    found = mixture_update(STATE, rows, linearise(STATE.mean[:2], rows, WORLD), WORLD, 0.1, update)
    assert (found.inlier < 0.5).tolist() == [k == 12 for k in range(16)]
    assert np.hypot(*(found.done.state.mean[:2] - [21.0, 31.0])) < 1.0


def test_moments_of_a_mixture_of_two() -> None:
    one, other = Gaussian(np.zeros(2), np.eye(2)), Gaussian(np.array([2.0, 0.0]), 3.0 * np.eye(2))
    found = moment_matched(np.array([0.75, 0.25]), [one, other])
    np.testing.assert_allclose(found.mean, [0.5, 0.0])
    np.testing.assert_allclose(found.covariance, [[1.5 + 0.75, 0.0], [0.0, 1.5]])


def test_the_probability_of_false_bearings_is_a_posterior_mean() -> None:
    none = FalseBearings()
    assert none.probability(0.01) == pytest.approx(0.01)
    seen = none.counted(np.array([1.0, 0.75, 0.0])).counted(np.ones(77))
    assert seen.bearings == 80
    assert seen.probability(0.01) == pytest.approx((0.01 * PRIOR_BEARINGS + 1.25) / (PRIOR_BEARINGS + 80))
    assert seen.probability(0.0) == 0.0
