"""Updates of the Kalman filters against their textbook forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from tracker_scenes import room100

from occlog.core.plane import make_floor
from occlog.filtering.gaussian import Gaussian
from occlog.filtering.likelihood.measurement_model import LinearisedRows, MeasurementWorld, linearised, measured
from occlog.track.methods.apf.model import pack_noise, pack_sensors
from occlog.track.methods.kalman import updates
from occlog.track.methods.kalman.config import DESCENT, NONE, VISIBLE, IekfConfig, UkfConfig

pytestmark = pytest.mark.jit
SCENE = room100(pillar=True)
WORLD = MeasurementWorld(
    pack_sensors(SCENE), pack_noise(SCENE), make_floor(SCENE.region, [o.polygon for o in SCENE.occluders])
)
COVARIANCE = np.array([[9.0, 2.0, 1.0, 0.0], [2.0, 6.0, 0.0, 0.5], [1.0, 0.0, 0.6, 0.0], [0.0, 0.5, 0.0, 0.4]])


def rows(sensors: list[int], xy: tuple[float, float], pixel: list[bool], off: float = 0.0) -> LinearisedRows:
    """What sensors measure of a place, each off by so many standard deviations of reading."""
    blank = LinearisedRows(
        np.array(sensors),
        np.array(pixel),
        np.zeros(len(sensors)),
        np.where(pixel, 4.0, 0.03**2),
        np.ones(len(sensors), bool),
    )
    expected, _ = measured(np.array([xy]), blank, WORLD)
    return blank._replace(value=expected[0] + off * np.sqrt(blank.variance))


@pytest.mark.parametrize("distance", [1e-9, 1e-3, 0.3])
def test_next_to_a_sensor_a_sight_line_is_as_wide_as_its_angle_and_the_distance(distance: float) -> None:
    """Linearised at the place alone the line had the width of 0.03 rad at that distance: a variance of 1e-21."""
    at = np.array([0.6, 0.8]) * distance  # from camera 1
    state = Gaussian(np.array([*at, 0.0, 0.0]), COVARIANCE)
    found = updates.linear(state, at, rows([0], (0.6, 0.8), [False]), WORLD).state.covariance[:2, :2]
    e = at / distance
    along = float(e @ found @ e)
    assert along > 4.0
    assert np.linalg.eigvalsh(found)[0] == pytest.approx(0.03**2 * (along + distance**2), rel=0.01)


def test_the_extended_filter_is_its_information_form() -> None:
    state = Gaussian(np.array([20.0, 30.0, 0.5, 0.5]), COVARIANCE)
    given = rows([0, 1, 3], (22.0, 29.0), [True, True, False])
    found = updates.ekf(state, given, WORLD).state
    H, R = linearised(state.mean[:2], given, WORLD)
    H4 = np.hstack([H, np.zeros((3, 2))])
    covariance = np.linalg.inv(np.linalg.inv(COVARIANCE) + (H4.T / R) @ H4)
    off = given.value - measured(state.mean[None, :2], given, WORLD)[0][0]
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-9)
    np.testing.assert_allclose(found.mean, state.mean + covariance @ H4.T @ (off / R), rtol=1e-9)


def test_readings_far_sharper_than_the_state_leave_a_covariance() -> None:
    """Three rows tell two coordinates: what is stated is lost in rounding, and the innovation's covariance singular."""
    state = Gaussian(np.array([20.0, 30.0, 0.5, 0.5]), COVARIANCE)
    given = rows([0, 1, 3], (22.0, 29.0), [False, False, False])
    found = updates.ekf(state, given._replace(variance=np.full(3, 1e-30)), WORLD)
    assert np.isfinite(found.state.mean).all()
    assert np.isfinite(found.score)
    assert np.linalg.eigvalsh(found.state.covariance).min() > 0.0


@pytest.mark.parametrize("pixel", [True, False])
def test_sigma_points_of_the_place_are_those_of_the_whole_state(pixel: bool) -> None:
    """Julier and Uhlmann 1997: 2 n + 1 points of n = 4, kappa = 3 - n."""
    state, given = Gaussian(np.array([20.0, 30.0, 0.5, 0.5]), COVARIANCE), rows([1], (22.0, 29.0), [pixel])
    found = updates.ukf(state, given, WORLD, UkfConfig()).state
    root = np.linalg.cholesky(3.0 * COVARIANCE)
    points = state.mean + np.vstack([np.zeros(4), root.T, -root.T])
    w = np.array([-1.0 / 3.0, *[1.0 / 6.0] * 8])
    z = measured(points[:, :2], given, WORLD)[0][:, 0]
    mean = w @ z
    S = w @ (z - mean) ** 2 + linearised(state.mean[:2], given, WORLD)[1][0]
    K = (w * (z - mean)) @ (points - state.mean) / S
    np.testing.assert_allclose(found.mean, state.mean + K * (given.value[0] - mean), rtol=1e-9)
    np.testing.assert_allclose(found.covariance, COVARIANCE - S * np.outer(K, K), atol=1e-9)


def test_points_that_a_camera_cannot_see_teach_nothing_and_leave_a_covariance() -> None:
    """Camera 2 at (50, 0) points up past the pillar [40, 60]^2; the state is next to its shadow, or in it."""
    beside = Gaussian(np.array([38.0, 75.0, 0.0, 0.0]), 4.0 * COVARIANCE)
    given = rows([1], (34.0, 75.0), [True])
    every = updates.ukf(beside, given, WORLD, UkfConfig())
    some = updates.ukf(beside, given, WORLD, UkfConfig(sigma_points=VISIBLE))
    assert every.fallback == some.fallback == ""
    assert np.trace(every.state.covariance) < np.trace(some.state.covariance) <= np.trace(beside.covariance)
    assert np.linalg.eigvalsh(some.state.covariance)[0] > 0.0
    hidden = Gaussian(np.array([50.0, 80.0, 0.0, 0.0]), 0.1 * COVARIANCE)
    none = updates.ukf(hidden, given, WORLD, UkfConfig(sigma_points=VISIBLE))
    assert none.fallback == updates.NO_SIGMA_POINTS
    np.testing.assert_array_equal(none.state.covariance, hidden.covariance)


def test_the_iterated_filter_ends_at_the_most_probable_place() -> None:
    """Bearings alone, whose variance does not depend on the place: the minimum by another search."""
    state, given = Gaussian(np.array([20.0, 30.0, 0.5, 0.5]), 4.0 * COVARIANCE), rows([0, 1], (27.0, 26.0), [False] * 2)
    config = IekfConfig(visibility_constraint=NONE, max_iterations=100)
    found = updates.iekf(state, given, WORLD, config, np.empty((0, 2)))
    best = minimize(
        lambda x: updates.map_cost(np.asarray(x)[None], state, given, WORLD)[0],
        state.mean[:2],
        method="Nelder-Mead",
        options={"xatol": 1e-7, "fatol": 1e-12},
    )
    np.testing.assert_allclose(found.state.mean[:2], best.x, atol=1e-3)
    H, R = linearised(found.state.mean[:2], given, WORLD)
    H4 = np.hstack([H, np.zeros((2, 2))])
    covariance = np.linalg.inv(np.linalg.inv(state.covariance) + (H4.T / R) @ H4)
    np.testing.assert_allclose(found.state.covariance, covariance, rtol=1e-3)


def test_a_prediction_that_no_camera_can_see_ends_a_search_from_it_alone() -> None:
    """The prediction is in the shadow of the pillar: nothing is feasible there; where bearings cross it is."""
    state, given = (
        Gaussian(np.array([50.0, 70.0, 0.0, 0.0]), 60.0 * COVARIANCE),
        rows([1, 5], (73.0, 70.0), [True, True]),
    )
    crossing = np.array([[73.0, 70.0]])
    alone = updates.iekf(state, given, WORLD, IekfConfig(visibility_constraint=DESCENT), crossing)
    several = updates.iekf(state, given, WORLD, IekfConfig(), crossing)
    assert (alone.fallback, several.fallback) == (updates.INFEASIBLE, "")
    np.testing.assert_array_equal(alone.state.mean, updates.ekf(state, given, WORLD).state.mean)
    assert np.hypot(*(several.state.mean[:2] - crossing[0])) < 1.5
