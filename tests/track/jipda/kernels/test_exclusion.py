"""Where two people may be: against a measurement of their distance, and what must not change."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from occlog.array_types import Floats
from occlog.track.methods.jipda.kernels.exclusion import apply_exclusion

S = 0.22


def normal(rng: np.random.Generator, n: int) -> Floats:
    """(n, n) covariance of some decimetres."""
    half = rng.normal(size=(n, n + 2))
    return 0.01 * half @ half.T


def one_of(
    mean: Floats, covariance: Floats, position: Floats, spread: Floats, existence: float
) -> tuple[Floats, Floats, float]:
    """Mean, covariance and share of the first of two people."""
    means, covariances = np.zeros((2, 1, 6)), np.tile(np.eye(6), (2, 1, 1, 1))
    means[0, 0], covariances[0, 0], weight = mean, covariance, np.ones((2, 1))
    positions, spreads = np.array([mean[:2], position]), np.array([covariance[:2, :2], spread])
    means[1, 0, :2], covariances[1, 0, :2, :2] = position, spread
    apply_exclusion(means, covariances, weight, positions, spreads, np.array([0.3, existence]), S)
    return means[0, 0], covariances[0, 0], float(weight[0, 0])


@pytest.mark.parametrize("seed", range(3))
def test_moments_are_those_of_the_difference_of_two_gaussians(seed: int) -> None:
    """exp(-d^2 / 2 s^2) is a measurement of the zero vector d, with the covariance s^2 I, in the joint state."""
    rng = np.random.default_rng(seed)
    mean, covariance, spread = rng.normal(0.0, 0.3, 6), normal(rng, 6), normal(rng, 2)
    position, existence = mean[:2] + rng.normal(0.0, 0.2, 2), rng.uniform(0.3, 1.0)
    got, got_covariance, share = one_of(mean, covariance, position, spread, existence)
    m, P = np.concatenate([mean, position]), block_diag(covariance, spread)
    H = np.zeros((2, 8))
    H[:, :2], H[:, 6:] = np.eye(2), -np.eye(2)
    innovation = H @ P @ H.T + S**2 * np.eye(2)
    gain = P @ H.T @ np.linalg.inv(innovation)
    near, near_covariance = m - gain @ H @ m, P - gain @ H @ P
    Z = existence * 2.0 * np.pi * S**2 * multivariate_normal.pdf(H @ m, np.zeros(2), innovation)
    wanted = (m - Z * near) / (1.0 - Z)
    second = (P + np.outer(m, m) - Z * (near_covariance + np.outer(near, near))) / (1.0 - Z)
    assert share == pytest.approx(1.0 - Z)
    np.testing.assert_allclose(got, wanted[:6], rtol=1e-9)
    np.testing.assert_allclose(got_covariance, (second - np.outer(wanted, wanted))[:6, :6], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(("distance", "changed"), [(0.99, True), (1.01, False)])
def test_pairs_farther_apart_than_four_deviations_of_their_difference_are_left_out(
    distance: float, changed: bool
) -> None:
    # Traces of both covariances and s^2; existence 1 and a wide spread across leave a share at this distance
    covariance, spread = np.diag([0.01, 0.3, 0.1, 0.1, 0.01, 0.01]), np.diag([0.02, 0.4])
    away = distance * 4.0 * np.sqrt(0.01 + 0.3 + 0.02 + 0.4 + S**2)
    share = one_of(np.zeros(6), covariance, np.array([0.0, away]), spread, 1.0)[2]
    assert (share < 1.0) == changed


def test_the_third_person_counts_as_the_others_do() -> None:
    covariance = np.tile(0.01 * np.eye(6), (3, 1, 1, 1))
    means, weight = np.zeros((3, 1, 6)), np.ones((3, 1))
    means[1, 0, :2], means[2, 0, :2] = 9.0, 0.1
    position, spread = means[:, 0, :2].copy(), covariance[:, 0, :2, :2].copy()
    apply_exclusion(means, covariance, weight, position, spread, np.full(3, 0.9), S)
    assert weight[0, 0] == pytest.approx(weight[2, 0])
    assert weight[0, 0] < weight[1, 0] == 1.0


def test_no_one_there_and_no_one_near_change_nothing() -> None:
    rng = np.random.default_rng(0)
    mean, covariance, spread = rng.normal(size=6), normal(rng, 6), normal(rng, 2)
    for place, existence in ((mean[:2] + 0.1, 0.0), (mean[:2] + 50.0, 1.0)):
        got, got_covariance, share = one_of(mean, covariance, place, spread, existence)
        np.testing.assert_allclose(got, mean, atol=1e-12)
        np.testing.assert_allclose(got_covariance, covariance, atol=1e-12)
        assert share == 1.0


@pytest.mark.parametrize("sigma", [1e-4, 1e-2, 1.0])
def test_two_at_one_place_stay_where_they_are_and_their_places_are_less_sure(sigma: float) -> None:
    covariance, spread = sigma**2 * np.eye(6), sigma**2 * np.eye(2)
    got, got_covariance, share = one_of(np.zeros(6), covariance, np.zeros(2), spread, 1.0 - 1e-6)
    np.testing.assert_allclose(got, 0.0, atol=1e-12)
    assert 0.0 < share < 1.0
    assert (np.linalg.eigvalsh(got_covariance) > 0.0).all()
    assert got_covariance[0, 0] > covariance[0, 0]


def test_who_walks_up_to_somebody_slows_down() -> None:
    # Place and velocity go together, as after a prediction
    covariance = np.diag([0.02, 0.02, 0.2, 0.2, 0.01, 0.01])
    covariance[0, 2] = covariance[2, 0] = 0.04
    mean = np.array([-0.2, 0.0, 1.0, 0.0, 1.7, 0.5])
    got, _, share = one_of(mean, covariance, np.zeros(2), 0.02 * np.eye(2), 1.0)
    assert got[0] < mean[0] - 0.03
    assert got[2] < mean[2] - 0.06
    np.testing.assert_allclose(got[[1, 3, 4, 5]], mean[[1, 3, 4, 5]], atol=1e-12)
    assert share < 0.9


def test_the_order_of_two_people_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    means, covariances = rng.normal(0.0, 0.2, (2, 2, 6)), np.array([[normal(rng, 6) for _ in "ab"] for _ in "ab"])
    place, spread, existence = means[:, 0, :2].copy(), covariances[:, 0, :2, :2].copy(), np.array([0.9, 0.6])
    a, A, w = means.copy(), covariances.copy(), np.full((2, 2), 0.5)
    apply_exclusion(a, A, w, place, spread, existence, S)
    b, B, v = means[::-1].copy(), covariances[::-1].copy(), np.full((2, 2), 0.5)
    apply_exclusion(b, B, v, place[::-1].copy(), spread[::-1].copy(), existence[::-1].copy(), S)
    np.testing.assert_allclose(a, b[::-1])
    np.testing.assert_allclose(A, B[::-1])
    np.testing.assert_allclose(w, v[::-1])
