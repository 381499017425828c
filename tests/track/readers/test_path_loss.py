"""Path loss and shadowing: by hand, and the Kalman filter against the joint Gaussian."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from occlog.track.methods.readers.rssi import PathLoss, no_shadowing, predict_shadowing, update_shadowing

MODEL = PathLoss(
    positions=np.array([[0.0, 0.0, 1.0], [30.0, 0.0, 1.0]]),
    power=np.array([-60.0, -50.0]),
    exponent=2.0,
    noise_db=4.0,
    shadow_db=3.0,
    shadow_s=5.0,
    height=1.0,
    metre=1.0,
)


def test_strength_falls_by_ten_exponents_a_decade() -> None:
    assert_allclose(MODEL.expected(np.array([[10.0, 0.0]]))[0, 0], -80.0)
    assert_allclose(MODEL.strength_at(10.0), [-80.0, -70.0])


def test_distances_are_in_space_and_in_metres() -> None:
    tilted = MODEL._replace(height=4.0)
    assert_allclose(tilted.expected(np.array([[4.0, 0.0]]))[0, 0], -60.0 - 20.0 * np.log10(5.0))
    feet = MODEL._replace(metre=1.0 / 0.3048)
    assert_allclose(feet.strength_at(10.0 / 0.3048), MODEL.strength_at(10.0))


def test_at_the_reader_itself_the_strength_is_that_of_the_nearest_distance() -> None:
    assert_allclose(MODEL.expected(np.array([[0.0, 0.0]]))[0, 0], -40.0)


def test_the_filter_has_the_likelihood_of_the_joint_gaussian() -> None:
    rng = np.random.default_rng(3)
    t, count = np.array([0.0, 1.0, 2.5, 9.0]), np.array([1, 3, 2, 1])
    rssi = -70.0 + 5.0 * rng.standard_normal(4)
    # One hypothesis, one reader: residuals have the covariance of an Ornstein-Uhlenbeck process plus noise
    model = MODEL._replace(positions=MODEL.positions[:1], power=MODEL.power[:1])
    expected = np.full((1, 1), -72.0)
    known, total = no_shadowing(model, 1), 0.0
    for k in range(4):
        if k:
            known = predict_shadowing(model, known, float(t[k] - t[k - 1]))
        known, part = update_shadowing(model, known, expected, rssi[k : k + 1], count[k : k + 1])
        total += float(part[0])
    covariance = 9.0 * np.exp(-np.abs(t[:, None] - t) / 5.0) + np.diag(16.0 / count)
    assert_allclose(total, multivariate_normal(np.full(4, -72.0), covariance).logpdf(rssi), rtol=1e-10)


def test_a_reader_without_a_strength_says_nothing() -> None:
    known = no_shadowing(MODEL, 3)
    after, part = update_shadowing(MODEL, known, np.full((3, 2), -70.0), np.full(2, np.nan), np.array([1, 0]))
    assert_allclose(part, 0.0)
    assert_allclose(after.variance, known.variance)
    assert_allclose(after.mean, 0.0)
