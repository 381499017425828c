"""Motion and update of people: against a Kalman filter, and mixtures of two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.array_types import NS, Floats
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.target_set import (
    CONSTANT_VELOCITY,
    DUPLICATE_DISTANCE_WIDTHS,
    DUPLICATE_EXISTENCE_RATIO,
    DUPLICATE_TIME_S,
    MANOEUVRE,
    MIN_SIZE_RATIO,
    POSTURE_CHANGE,
    TargetSet,
    _transitions,
    apply_exclusion_prior,
    duplicate_tracks,
    predict,
    select,
    tentative_targets,
    update,
)

RNG = np.random.default_rng(0)


def covariance(n: int) -> Floats:
    """(n, 6, 6) positive definite matrices."""
    half = RNG.normal(size=(n, 6, 8))
    return 0.01 * half @ half.swapaxes(1, 2)


NO_ERROR = (0.0, 1.0)
"""Variance and correlation time of no common error."""


def some(n: int = 3):
    """People at random places."""
    mean = RNG.normal(size=(n, 6))
    mean[:, 4:] = np.abs(mean[:, 4:]) + 1.0
    return tentative_targets(mean, covariance(n), np.full(n, 0.9), np.full(n, 2.0), 0, 0)


def test_people_who_walk_on_are_predicted_as_by_a_kalman_filter() -> None:
    config, people, dt = JipdaConfig(), some(), 0.4
    after = predict(people, 0, dt=dt, leaving=np.zeros(3), turning=1e-12, bending=1e-12, common=NO_ERROR, config=config)
    F, Q, q = np.eye(6), np.zeros((6, 6)), config.process_noise_density
    F[0, 2] = F[1, 3] = dt
    for a in (0, 1):
        Q[a, a], Q[a + 2, a + 2], Q[a, a + 2], Q[a + 2, a] = q * dt**3 / 3, q * dt, q * dt**2 / 2, q * dt**2 / 2
    np.testing.assert_allclose(after.mean, people.mean @ F.T, atol=1e-9)
    expected = F @ people.covariance @ F.T + Q
    np.testing.assert_allclose(after.covariance[:, :4, :4], expected[:, :4, :4], atol=1e-9)


def test_many_short_steps_are_one_long_one() -> None:
    config, people = JipdaConfig(), some()
    once = predict(people, 0, dt=0.5, leaving=np.zeros(3), turning=1e-12, bending=1e-12, common=NO_ERROR, config=config)
    for _ in range(50):
        people = predict(
            people, 0, dt=0.01, leaving=np.zeros(3), turning=1e-12, bending=1e-12, common=NO_ERROR, config=config
        )
    np.testing.assert_allclose(people.covariance, once.covariance, rtol=1e-6, atol=1e-9)


def test_existence_falls_with_the_rate_of_leaving() -> None:
    after = predict(
        some(1), 0, dt=3.0, leaving=np.array([0.1]), turning=0.05, bending=1e-3, common=NO_ERROR, config=JipdaConfig()
    )
    assert after.existence[0] == pytest.approx(0.9 * np.exp(-0.3))


def test_people_out_of_all_images_leave_sooner() -> None:
    people = some(2)
    people = replace(people, seen_ns=np.array([0, 1_500_000_000]))
    after = predict(
        people,
        2_000_000_000,
        dt=1.0,
        leaving=np.full(2, 0.01),
        turning=0.05,
        bending=1e-3,
        common=NO_ERROR,
        config=JipdaConfig(),
    )
    assert after.existence[0] < 0.6 * 0.9 + 0.01
    assert after.existence[1] == pytest.approx(0.9 * np.exp(-0.01))


def test_a_factor_updates_as_a_kalman_filter_does() -> None:
    people = some()
    H, R, z = RNG.normal(size=(2, 6)), np.diag([0.04, 0.09]), RNG.normal(size=2)
    information = np.repeat((H.T @ np.linalg.inv(R) @ H)[None], 3, axis=0)
    vector = np.repeat((H.T @ np.linalg.inv(R) @ z)[None], 3, axis=0)
    after = update(people, information, vector, 0.0, JipdaConfig())
    for i in range(3):
        P = people.covariance[i]
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        np.testing.assert_allclose(after.mean[i], people.mean[i] + K @ (z - H @ people.mean[i]), rtol=1e-7)
        np.testing.assert_allclose(after.covariance[i], P - K @ H @ P, rtol=1e-6, atol=1e-10)


def test_sway_is_noise_of_the_place() -> None:
    people, sway = some(1), 0.02
    H = np.zeros((2, 6))
    H[0, 0] = H[1, 1] = 1.0
    information, vector = (H.T @ H / 0.01)[None], (H.T @ np.array([1.0, 2.0]) / 0.01)[None]
    after = update(people, information, vector, sway, JipdaConfig())
    R = 0.01 + sway
    plain = update(people, (H.T @ H / R)[None], (H.T @ np.array([1.0, 2.0]) / R)[None], 0.0, JipdaConfig())
    np.testing.assert_allclose(after.mean, plain.mean, rtol=1e-9)
    np.testing.assert_allclose(after.covariance, plain.covariance, rtol=1e-7, atol=1e-12)


def test_a_turn_makes_the_manoeuvre_probable_and_is_followed() -> None:
    config = JipdaConfig()
    people = tentative_targets(
        np.array([[0.0, 0.0, 1.2, 0.0, 1.7, 0.5]]), 1e-3 * np.eye(6)[None], np.ones(1) * 0.9, np.ones(1), 0, 0
    )
    H = np.zeros((2, 6))
    H[0, 0] = H[1, 1] = 1.0
    place, seen = np.zeros(2), []
    for k in range(20):
        place = place + 0.1 * (np.array([1.2, 0.0]) if k < 8 else np.array([0.0, 1.2]))
        people = predict(
            people, 0, dt=0.1, leaving=np.zeros(1), turning=0.05, bending=1e-3, common=NO_ERROR, config=config
        )
        people = update(people, (H.T @ H / 4e-4)[None], (H.T @ place / 4e-4)[None], 0.0, config)
        seen.append(people.model[0, MANOEUVRE])
    assert max(seen[:8]) < 0.2
    assert max(seen[8:14]) > 0.7
    assert np.hypot(*(people.mean[0, :2] - place)) < 0.1
    assert people.model.sum() == pytest.approx(1.0)
    assert people.model[0, CONSTANT_VELOCITY] >= 0.0


def test_models_change_by_their_rates() -> None:
    config, turning = JipdaConfig(posture_change_duration_s=3.0, manoeuvre_duration_s=0.7), 0.2
    rates = np.array([[-0.22, 1 / 0.7, 1 / 3.0], [0.2, -1 / 0.7 - 0.02, 0.0], [0.02, 0.02, -1 / 3.0]])
    dt = 1e-5
    np.testing.assert_allclose((_transitions(dt, turning, 0.02, config) - np.eye(3)) / dt, rates, atol=2e-5)
    for dt in (0.0, 0.04, 1.0, 1e6):
        to = _transitions(dt, turning, 0.02, config)
        np.testing.assert_allclose(to.sum(axis=0), 1.0, rtol=1e-12)
        assert (to >= 0.0).all()
    # After long the share of people who are bent is what the two rates make it
    np.testing.assert_allclose(to[POSTURE_CHANGE], 3.0 / 53.0, rtol=1e-9)


def test_whoever_falls_is_followed_down_and_up_again() -> None:
    config, seen = JipdaConfig(), []
    mean = np.array([[0.0, 0.0, 0.0, 0.0, 1.7, 0.5]])
    people = tentative_targets(mean, 1e-3 * np.eye(6)[None], np.ones(1) * 0.9, np.ones(1), 0, 0)
    H = np.zeros((2, 6))
    H[0, 4] = H[1, 5] = 1.0
    for k in range(60):
        body = np.array([1.7, 0.5] if k < 10 or k >= 45 else [0.45, 1.2])
        people = predict(
            people, 0, dt=0.1, leaving=np.zeros(1), turning=0.05, bending=1e-3, common=NO_ERROR, config=config
        )
        people = update(people, (H.T @ H / 4e-3)[None], (H.T @ body / 4e-3)[None], 0.0, config)
        seen.append((people.model[0, POSTURE_CHANGE], np.abs(people.mean[0, 4:] - body).max()))
    bends, off = np.array(seen).T
    assert bends[:10].max() < 0.01
    assert bends[10:12].min() > 0.9
    assert off[12:45].max() < 0.1
    # Whoever lies still, or has got up, does not bend
    assert bends[[30, 44, 59]].max() < 0.01
    assert off[59] < 0.05


def test_no_body_is_smaller_than_a_share_of_the_usual_one() -> None:
    config, people = JipdaConfig(), some(1)
    information, vector = np.zeros((1, 6, 6)), np.zeros((1, 6))
    information[0, [4, 5], [4, 5]], vector[0, 4:] = 1e6, -1e6
    after = update(people, information, vector, 0.0, config)
    np.testing.assert_allclose(
        after.mean[0, 4:], [MIN_SIZE_RATIO * config.person_height, MIN_SIZE_RATIO * config.person_width], rtol=1e-6
    )


def three_people() -> TargetSet:
    """Two who stand where one person stands, and a third; no one is confirmed."""
    mean = np.zeros((3, 6))
    mean[:, 5], mean[1, 0], mean[2, 0] = 0.5, DUPLICATE_DISTANCE_WIDTHS * 0.5 * 0.99, 1.0
    return tentative_targets(mean, covariance(3), np.array([0.6, 0.9, 0.9]), np.ones(3), 0, 0)


def test_people_who_are_not_confirmed_are_doubles_at_once() -> None:
    people = three_people()
    np.testing.assert_array_equal(duplicate_tracks(people, 0)[1], [True, False, False])
    confirmed = replace(people, id=np.array([7, -1, -1]))
    np.testing.assert_array_equal(duplicate_tracks(confirmed, 0)[1], [False, True, False])
    people.mean[1, 0] = DUPLICATE_DISTANCE_WIDTHS * 0.5 * 1.01
    assert not duplicate_tracks(people, 0)[1].any()
    assert not duplicate_tracks(select(people, np.array([0])), 0)[1].any()


def test_confirmed_people_are_doubles_when_they_have_been_together_for_long() -> None:
    people = replace(three_people(), id=np.arange(3), existence=np.array([0.9, 0.9, 0.9]))
    first, last = int(5 * NS), int((5 + DUPLICATE_TIME_S) * NS)
    # They were apart at 5 s, and are together from then on
    people, out = duplicate_tracks(replace(people, mean=people.mean * [3, 1, 1, 1, 1, 1]), first)
    assert not out.any()
    people = replace(people, mean=people.mean / [3, 1, 1, 1, 1, 1])
    people, out = duplicate_tracks(people, last - 1)
    assert not out.any()
    # The younger one goes, but for a much surer one
    np.testing.assert_array_equal(duplicate_tracks(people, last)[1], [False, True, False])
    doubtful = replace(people, existence=np.array([0.9 * DUPLICATE_EXISTENCE_RATIO - 0.01, 0.9, 0.9]))
    np.testing.assert_array_equal(duplicate_tracks(doubtful, last)[1], [True, False, False])


def head_on() -> TargetSet:
    """Two people who walk up to each other, 0.8 m apart."""
    mean = np.array([[0.0, 0.0, 1.0, 0.0, 1.7, 0.5], [0.8, 0.0, -1.0, 0.0, 1.7, 0.5]])
    matrix = np.diag([0.02, 0.02, 0.1, 0.1, 0.01, 0.01])
    return tentative_targets(mean, np.stack([matrix, matrix]), np.full(2, 0.95), np.full(2, 5.0), 0, 0)


def test_who_would_walk_through_somebody_is_expected_to_stop_or_to_turn() -> None:
    config, people = JipdaConfig(), head_on()
    free = people
    for _ in range(4):
        free = predict(free, 0, dt=0.1, leaving=np.zeros(2), turning=0.1, bending=1e-9, common=NO_ERROR, config=config)
        people = apply_exclusion_prior(
            predict(people, 0, dt=0.1, leaving=np.zeros(2), turning=0.1, bending=1e-9, common=NO_ERROR, config=config),
            config.exclusion_radius,
        )
    # Where they would have met they are still before each other, and slower
    np.testing.assert_allclose(free.mean[:, 0], 0.4, atol=1e-9)
    assert people.mean[1, 0] - people.mean[0, 0] > 0.5 * config.exclusion_radius
    np.testing.assert_allclose(free.mean[:, 2], [1.0, -1.0], atol=1e-9)
    assert people.mean[0, 2] < 0.95
    # Who manoeuvres could have got out of the way; both alike
    assert (people.model[:, MANOEUVRE] > free.model[:, MANOEUVRE]).all()
    np.testing.assert_allclose(people.mean[0, :2] + people.mean[1, :2], [0.8, 0.0], atol=1e-9)
    assert (np.linalg.eigvalsh(people.covariance) > 0.0).all()


@pytest.mark.parametrize("n", [0, 1])
def test_no_one_keeps_apart_from_no_one(n: int) -> None:
    people = some(n)
    assert apply_exclusion_prior(people, 0.22) is people
