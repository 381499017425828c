"""Measurements of stations in the Kalman filters: against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from tracker_scenes import room100

from occlog.array_types import Floats
from occlog.core.plane import make_floor
from occlog.filtering.gaussian import Gaussian
from occlog.filtering.likelihood.distances import RANGE, RangeMeasurements, residuals
from occlog.filtering.likelihood.measurement_model import LinearisedRows, MeasurementWorld
from occlog.track.methods.apf.model import pack_noise, pack_sensors
from occlog.track.methods.kalman.stations import extended, first_position, innovation_gating, unscented

SCENE = room100(pillar=False)
WORLD = MeasurementWorld(pack_sensors(SCENE), pack_noise(SCENE), make_floor(SCENE.region, []))
NO_ROWS = LinearisedRows(*(np.empty(0, dtype=kind) for kind in (np.int64, np.bool_, np.float64, np.float64, np.bool_)))
PLACES = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
COVARIANCE = np.array([[9.0, 2.0, 1.0, 0.0], [2.0, 6.0, 0.0, 0.5], [1.0, 0.0, 0.6, 0.0], [0.0, 0.5, 0.0, 0.4]])


def ranges(xy: tuple[float, float], off: Floats, sigma: float = 0.5) -> RangeMeasurements:
    """Ranges from four corners, each wrong by `off`."""
    m = len(off)
    far = np.hypot(*(np.array(xy) - PLACES[:m]).T) + off
    none = np.zeros(m)
    return RangeMeasurements(
        np.full(m, RANGE), far, np.full(m, sigma), PLACES[:m], none, PLACES[:m], none, np.arange(m)
    )


def test_the_update_is_that_of_the_information_filter() -> None:
    state = Gaussian(np.array([40.0, 30.0, 0.5, -0.5]), COVARIANCE)
    rows = ranges((41.0, 29.0), np.array([0.3, -0.2, 0.1]))
    after, _ = extended(state, rows)
    away = state.mean[:2] - PLACES[:3]
    far = np.hypot(*away.T)
    H = np.hstack([away / far[:, None], np.zeros((3, 2))])
    information = np.linalg.inv(COVARIANCE) + H.T @ H / 0.25
    np.testing.assert_allclose(after.covariance, np.linalg.inv(information), rtol=1e-9)
    shift = np.linalg.solve(information, H.T @ (rows.value - far) / 0.25)
    np.testing.assert_allclose(after.mean, state.mean + shift, rtol=1e-9)


def test_sigma_points_of_a_narrow_state_give_the_linear_update() -> None:
    state = Gaussian(np.array([40.0, 30.0, 0.5, -0.5]), 1e-6 * COVARIANCE)
    rows = ranges((40.0, 30.0), np.array([1e-3, -2e-3, 1e-3]), sigma=1e-3)
    one, other = extended(state, rows), unscented(state, rows)
    np.testing.assert_allclose(other[0].mean, one[0].mean, atol=1e-8)
    np.testing.assert_allclose(other[0].covariance, one[0].covariance, rtol=1e-3, atol=1e-11)
    assert other[1] == pytest.approx(one[1], abs=1e-3)


def test_nothing_inside_the_gate_leaves_the_state() -> None:
    state = Gaussian(np.array([40.0, 30.0, 0.5, -0.5]), COVARIANCE)
    rows = ranges((41.0, 29.0), np.array([60.0, 70.0, 0.0]))
    assert innovation_gating(state, rows, 5.0).tolist() == [False, False, True]
    for update in (extended, unscented):
        after, score = update(state, rows.take(slice(0, 0)))
        np.testing.assert_allclose(after.mean, state.mean)
        np.testing.assert_allclose(after.covariance, state.covariance)
        assert score == 0.0


def test_the_first_position_is_the_least_squares_fit_of_what_agrees() -> None:
    anywhere = Gaussian(np.array([50.0, 50.0, 0.0, 0.0]), np.diag([850.0, 850.0, 1.0, 1.0]))
    rows = ranges((71.0, 22.0), np.array([0.4, -0.3, 0.5, 40.0]))
    state, used = first_position(anywhere, NO_ROWS, rows, WORLD, 5.0)
    good = rows.take(slice(0, 3))

    def cost(xy: Floats) -> Floats:
        return np.append(residuals(good, xy[None])[0], (xy - 50.0) / np.sqrt(850.0))

    found = least_squares(cost, np.array([70.0, 20.0]), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    np.testing.assert_allclose(state.mean[:2], found, atol=1e-4)
    assert not len(used)
