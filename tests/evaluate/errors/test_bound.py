"""The bound table: which bearings count, when, with which noise, and the ratio of RMSE to it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evaluate_scenes import FOCAL, array, both, camera, directions, pixels, scene, seconds, tracks, truth

from occlog.core.bounds import in_plane as crlb
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Bound, Tracks, Truth

T5 = [0.0, 1.0, 2.0, 3.0, 4.0]
NAN = math.nan
EAST = camera("east", 0.0, 10.0, 0.0)
NORTH = camera("north", 10.0, 0.0, 90.0)
BOTH = scene(EAST, NORTH)


def bound_of(
    bearings: Bearings, true: Truth, made_scene: Scene = BOTH, found: Tracks | None = None, **options
) -> Bound:
    return evaluate(found, true, bearings, made_scene, EvaluateConfig(**options)).bound


def test_one_step_by_hand() -> None:
    # Target 10 in front of either camera: each gives (f / d)^2 / sigma^2 = 100 across its axis; prior 1
    bearings = both(pixels(EAST, [0.0], [0]), pixels(NORTH, [0.0], [0]))
    bound = bound_of(bearings, truth([0.0], [10, 10]), prior_covariance=(1.0, 0.0, 1.0))
    assert (bound.bound_xx[0], bound.bound_yy[0]) == (pytest.approx(1 / 101), pytest.approx(1 / 101))
    assert bound.bound_xy[0] == pytest.approx(0.0, abs=1e-15)
    assert bound.bound[0] == pytest.approx(math.sqrt(2 / 101))
    assert bound.n_detected[0] == 2


def test_prior_is_the_spread_of_the_room() -> None:
    bound = bound_of(pixels(EAST, [0.0], [NAN]), truth([0.0], [10, 10]))
    assert bound.bound_xx[0] == pytest.approx(20**2 / 12)
    assert bound.bound_yy[0] == pytest.approx(20**2 / 12)
    assert bound.n_detected[0] == 0


def test_time_without_sight_adds_the_noise_of_the_walk() -> None:
    bound = bound_of(
        pixels(EAST, [0.0, 0.5, 4.0], [NAN] * 3),
        truth(T5, [10, 10]),
        prior_covariance=(1.0, 0.0, 2.0),
        process_noise_position=0.5,
    )
    np.testing.assert_allclose(bound.bound_xx, 1.0 + 0.25 * np.array([0.0, 0.5, 4.0]))
    np.testing.assert_allclose(bound.bound_yy, 2.0 + 0.25 * np.array([0.0, 0.5, 4.0]))


def test_default_noise_of_the_walk_follows_the_length_unit() -> None:
    rows, true = pixels(EAST, [0.0, 1.0], [NAN, NAN]), truth(T5, [10, 10])
    metres = bound_of(rows, true, scene(EAST), prior_covariance=(1.0, 0.0, 1.0))
    units = bound_of(rows, true, scene(EAST, unit="unit"), prior_covariance=(1.0, 0.0, 1.0))
    assert metres.bound_xx[1] == pytest.approx(1 + 0.05**2)
    assert units.bound_xx[1] == pytest.approx(1 + 0.33**2)


def test_asynchronous_sensors_are_taken_in_at_their_own_times() -> None:
    true = truth(T5, [[8, 9], [9, 9], [10, 9], [11, 9], [12, 9]])
    bearings = both(pixels(EAST, [0.0, 1.7], [12, 10]), pixels(NORTH, [0.3, 1.7, 3.9], [-20, -3, 20]))
    bound = bound_of(bearings, true, process_noise_position=0.4)
    assert bound.t_ns.tolist() == seconds([0.0, 0.3, 1.7, 3.9]).tolist()
    assert bound.n_detected.tolist() == [1, 1, 2, 1]
    xy = np.array([[8, 9], [8.3, 9], [9.7, 9], [11.9, 9]])
    one = np.ones(1)
    e = [crlb.camera_information(p[None], EAST.ground, 0.0, 100.0, 0, 0, one)[0] for p in xy]
    n = [crlb.camera_information(p[None], NORTH.ground, np.pi / 2, 100.0, 0, 0, one)[0] for p in xy]
    P, expected = np.eye(2) * 400 / 12, []
    for dt, J in zip([0.0, 0.3, 1.4, 2.2], [e[0], n[1], e[2] + n[2], n[3]], strict=True):
        P = np.linalg.inv(np.linalg.inv(P + 0.16 * dt * np.eye(2)) + J)
        expected.append(P)
    np.testing.assert_allclose(bound.bound_xx, [p[0, 0] for p in expected], rtol=1e-6)
    np.testing.assert_allclose(bound.bound_xy, [p[0, 1] for p in expected], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(bound.bound_yy, [p[1, 1] for p in expected], rtol=1e-6)


def test_noise_is_eq_2_with_the_bearings_own_reading() -> None:
    shaky = camera("east", 0.0, 10.0, 0.0, sigma_position=0.5, sigma_yaw=0.02, sigma_read_px=77.0)
    xy = np.array([12.0, 13.0])
    bound = bound_of(
        pixels(shaky, [0.0], [-25.0], sigma_px=3.0), truth([0.0], xy), scene(shaky), prior_covariance=(4, 0, 4)
    )
    J = crlb.camera_information(xy[None], shaky.ground, 0.0, 100.0, 0.5, 0.02, np.array([3.0]))[0]
    P = np.linalg.inv(np.eye(2) / 4 + J)
    assert bound.bound[0] == pytest.approx(math.sqrt(np.trace(P)))


def test_sensors_without_pixels_count_by_their_angle() -> None:
    made_scene = scene(EAST, arrays=(array("ear", 10.0, 0.0),))
    bearings = both(
        directions("ear", [0.0], [math.pi / 2], 0.1), directions("east", [0.0], [0.0], 0.2)
    )  # the camera's rows have no pixels either
    bound = bound_of(bearings, truth([0.0], [10, 10]), made_scene, prior_covariance=(1.0, 0.0, 1.0))
    assert bound.bound_xx[0] == pytest.approx(1 / (1 + 1 / (10 * 0.1) ** 2))
    assert bound.bound_yy[0] == pytest.approx(1 / (1 + 1 / (10 * 0.2) ** 2))


def test_a_sensor_more_never_raises_the_bound() -> None:
    rng, true = np.random.default_rng(0), truth(range(20), np.random.default_rng(1).uniform(8, 14, (20, 2)))
    east = pixels(EAST, range(20), np.where(rng.random(20) < 0.7, 0.0, NAN))
    north = pixels(NORTH, range(20), np.where(rng.random(20) < 0.7, 0.0, NAN))
    few, more = bound_of(east, true), bound_of(both(east, north), true)
    assert np.all(more.bound <= few.bound + 1e-12)
    assert more.bound[-1] < 0.9 * few.bound[-1]


def test_candidates_count_where_they_are_near_the_truth() -> None:
    true = truth(T5[:2], [10, 10])
    labelled = bound_of(pixels(EAST, T5[:2], [1, NAN]), true)
    candidates = both(pixels(EAST, [0.0, 0.0], [1, 40], target=-1), pixels(EAST, [1.0], [40], target=-1))
    unlabelled = bound_of(candidates, true)
    assert unlabelled.n_detected.tolist() == [1, 0]
    np.testing.assert_array_equal(unlabelled.bound, labelled.bound)


def test_labelled_bearing_of_a_target_out_of_view_does_not_count() -> None:
    bound = bound_of(pixels(EAST, [0.0, 1.0], [0, 0]), truth([0.0, 1.0], [[2, 19], [10, 11]]))
    assert bound.n_detected.tolist() == [0, 1]  # behind 45 degrees; then in view though 10 sigma away


def test_held_out_sensors_do_not_count() -> None:
    bearings = both(pixels(EAST, T5, [0] * 5), pixels(NORTH, T5, [0] * 5))
    found = tracks(T5, [10, 10])
    bound = bound_of(bearings, truth(T5, [10, 10]), found=found, held_out=("north",))
    assert bound.n_detected.tolist() == [1] * 5


def test_rows_at_the_times_of_the_estimates_only() -> None:
    found = tracks([0.5, 2.0, 3.0], [10, 10])
    bound = bound_of(pixels(EAST, T5, [0] * 5), truth(T5, [10, 10]), found=found)
    assert bound.t_ns.tolist() == seconds([0.5, 2.0, 3.0]).tolist()
    assert bound.n_detected.tolist() == [0, 1, 1]
    all_of_it = bound_of(pixels(EAST, T5, [0] * 5), truth(T5, [10, 10]))
    np.testing.assert_allclose(bound.bound[1:], all_of_it.bound[2:4])


def test_no_rows_where_the_truth_is_not_known() -> None:
    bearings = pixels(EAST, [0.0, 1.0, 3.0, 4.0, 9.0], [0] * 5)
    bound = bound_of(bearings, truth([0.0, 1.0, 4.0], [10, 10]))
    assert bound.t_ns.tolist() == seconds([0.0, 1.0, 4.0]).tolist()


def test_constant_velocity_knows_less_than_a_walk_with_known_drift() -> None:
    bearings = both(pixels(EAST, T5, [0] * 5), pixels(NORTH, T5, [0] * 5))
    true = truth(T5, [10, 10])
    cv = bound_of(bearings, true, motion="cv", process_noise_density=0.01, sigma_initial_velocity=1.0)
    F, Q = crlb.constant_velocity_steps(np.array([0.0, 1, 1, 1, 1]), 0.01)
    J = np.zeros((5, 4, 4))
    J[:, 0, 0] = J[:, 1, 1] = 100.0
    P = crlb.posterior_bound(J, F, Q, np.diag([400 / 12, 400 / 12, 1.0, 1.0]))
    np.testing.assert_allclose(cv.bound_xx, P[:, 0, 0], rtol=1e-9)
    assert cv.bound[-1] > bound_of(bearings, true, process_noise_position=0.0).bound[-1]


def test_defaults_of_constant_velocity_are_as_long_in_feet() -> None:
    metres, feet = EvaluateConfig.in_unit("m"), EvaluateConfig.in_unit("ft")
    assert feet.sigma_initial_velocity == pytest.approx(metres.sigma_initial_velocity / 0.3048)
    assert feet.process_noise_density == pytest.approx(metres.process_noise_density / 0.3048**2)


def test_ratio_is_over_the_times_that_both_have() -> None:
    # The first estimate comes before the first observation, so there is no bound for it
    found = tracks([0.0, 1.0, 2.0], [[20, 20], [10, 11], [10, 10]])
    bearings = both(pixels(EAST, [1.0, 2.0], [0, 0]), pixels(NORTH, [1.0, 2.0], [0, 0]))
    result = evaluate(
        found,
        truth(T5, [10, 10]),
        bearings,
        BOTH,
        EvaluateConfig(prior_covariance=(1.0, 0.0, 1.0), process_noise_position=0.0),
    )
    m = result.metrics
    mean_trace = (2 / 101 + 2 / 201) / 2
    assert m["bound_estimates"] == 2
    assert m["bound_rmse_m"] == pytest.approx(math.sqrt(mean_trace))
    assert m["bound_ratio"] == pytest.approx(math.sqrt(0.5 / mean_trace))
    assert m["bound_ratio_target_0"] == m["bound_ratio"]
    assert m["rmse_m"] == pytest.approx(math.sqrt((200 + 1 + 0) / 3))


def test_two_targets_have_their_own_bounds() -> None:
    true = both(truth(T5, [10, 10], 0), truth(T5, [14, 12], 1))
    bearings = both(pixels(EAST, T5, [0] * 5, 0), pixels(EAST, T5, [NAN] * 5, 1))
    found = both(tracks(T5, [10, 11], 0), tracks(T5[:2], [14, 15], 1))
    result = evaluate(found, true, bearings, BOTH)
    seen = {k: result.bound.n_detected[result.bound.target_id == k].tolist() for k in (0, 1)}
    assert seen == {0: [1] * 5, 1: [0, 0]}
    m, b = result.metrics, result.bound.bound
    assert m["bound_rmse_m"] == pytest.approx(math.sqrt(np.sum(b**2) / 7))
    assert m["bound_ratio"] == pytest.approx(math.sqrt((5 * 1 + 2 * 9) / 7) / m["bound_rmse_m"])


def test_settled_figures_have_their_own_ratio() -> None:
    bearings = both(pixels(EAST, T5, [0] * 5), pixels(NORTH, T5, [0] * 5))
    result = evaluate(
        tracks(T5, [[15, 15], [10, 11], [10, 11], [10, 11], [10, 11]]),
        truth(T5, [10, 10]),
        bearings,
        BOTH,
        EvaluateConfig(settling_s=1.0),
    )
    m, late = result.metrics, result.bound.bound[1:]
    assert m["settled_bound_rmse_m"] == pytest.approx(math.sqrt(np.mean(late**2)))
    assert m["settled_bound_ratio"] == pytest.approx(1.0 / m["settled_bound_rmse_m"])


@pytest.mark.jit
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.statistics)])
def test_a_filter_stated_the_drift_stays_above_the_bound(seed: int) -> None:
    """An extended Kalman filter stated the drift, over many walks: mean squared error at least the mean bound."""
    rng, runs, steps, sigma_v = np.random.default_rng(seed), 60, 30, 0.3
    squared, bounds = np.empty((runs, steps)), np.empty((runs, steps))
    for run in range(runs):
        drift = 0.1 * np.sin(0.3 * np.arange(steps))[:, None] * np.array([1.0, -0.5])
        x0 = np.array([10.0, 10.0]) + rng.normal(size=2)
        x = x0 + np.cumsum(drift + sigma_v * rng.normal(size=(steps, 2)) * (np.arange(steps) > 0)[:, None], axis=0)
        u = {"east": -FOCAL * (x[:, 1] - 10) / x[:, 0], "north": FOCAL * (x[:, 0] - 10) / x[:, 1]}
        noisy = {k: v + rng.normal(size=steps) for k, v in u.items()}
        t = range(steps)
        bearings = both(pixels(EAST, t, noisy["east"]), pixels(NORTH, t, noisy["north"]))
        found = bound_of(bearings, truth(t, x), prior_covariance=(1.0, 0.0, 1.0), process_noise_position=sigma_v)
        bounds[run] = found.bound**2
        squared[run] = np.sum((extended_kalman(noisy, drift, sigma_v) - x) ** 2, axis=1)
    per_run = squared.mean(axis=1) / bounds.mean()
    error_bar = per_run.std() / math.sqrt(runs)
    assert 1 - 3 * error_bar < per_run.mean() < 1.15 + 3 * error_bar


def extended_kalman(u: dict[str, np.ndarray], drift: np.ndarray, sigma_v: float) -> np.ndarray:
    x, P, out = np.array([10.0, 10.0]), np.eye(2), []
    for k in range(len(drift)):
        x, P = x + drift[k], P + (sigma_v**2 * np.eye(2) if k else 0.0)
        predicted = np.array([-FOCAL * (x[1] - 10) / x[0], FOCAL * (x[0] - 10) / x[1]])
        H = FOCAL * np.array(
            [
                [(x[1] - 10) / x[0] ** 2, -1 / x[0]],
                [1 / x[1], -(x[0] - 10) / x[1] ** 2],
            ]
        )
        S = H @ P @ H.T + np.eye(2)
        K = P @ H.T @ np.linalg.inv(S)
        x = x + K @ (np.array([u["east"][k], u["north"][k]]) - predicted)
        P = P - K @ H @ P
        out.append(x)
    return np.array(out)


def test_bound_of_smoothing_stands_next_to_that_of_filtering() -> None:
    # One axis: seen at 0 s and 2 s with information 100 each, prior 1, noise of the walk 0.25 a second
    bearings = pixels(EAST, [0.0, 2.0], [0, 0])
    found = tracks([0.0, 1.0, 2.0], [10, 10.3], 0)
    place = evaluate(
        found,
        truth(T5, [10, 10]),
        bearings,
        BOTH,
        EvaluateConfig(prior_covariance=(1, 0, 1), process_noise_position=0.5),
    )
    one = 1 / 101
    late = 1 / (1 / (one + 0.5) + 100)
    np.testing.assert_allclose(place.bound.bound_yy, [one, one + 0.25, late])
    middle = 1 / (1 / (one + 0.25) + 1 / (0.25 + 0.01))
    np.testing.assert_allclose(place.bound.smoothed_yy, [1 / (101 + 1 / 0.51), middle, late])
    np.testing.assert_allclose(place.bound.smoothed**2, place.bound.smoothed_xx + place.bound.smoothed_yy)
    least = math.sqrt(np.mean(place.bound.smoothed**2))
    assert place.metrics["smoothed_bound_rmse_m"] == pytest.approx(least)
    assert place.metrics["smoothed_bound_ratio"] == pytest.approx(0.3 / least)
    assert place.metrics["smoothed_bound_ratio"] > place.metrics["bound_ratio"]
    assert "tracks_smoothed" not in place.metrics
