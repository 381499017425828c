"""Rows of one sensor say nothing of the distance."""

from __future__ import annotations

import numpy as np
import pytest
from tracker_scenes import room100

from occlog.core.plane import make_floor
from occlog.filtering.gaussian import Gaussian
from occlog.filtering.likelihood.measurement_model import LinearisedRows, MeasurementWorld, measured
from occlog.track.methods.apf.model import pack_noise, pack_sensors
from occlog.track.methods.kalman import updates
from occlog.track.methods.kalman.config import NONE, IekfConfig
from occlog.track.methods.kalman.updates import polar_update

pytestmark = pytest.mark.jit
SCENE = room100()
WORLD = MeasurementWorld(pack_sensors(SCENE), pack_noise(SCENE), make_floor(SCENE.region, []))
AT = np.array([40.0, 30.0])
"""50 from camera 1, which is at the origin."""


def row(xy: np.ndarray, *, pixel: bool, sd: float) -> LinearisedRows:
    """What camera 1 measures of a place, without noise."""
    blank = LinearisedRows(np.array([0]), np.array([pixel]), np.zeros(1), np.array([sd**2]), np.ones(1, bool))
    return blank._replace(value=measured(xy[None], blank, WORLD)[0][0])


@pytest.mark.parametrize("pixel", [True, False])
def test_a_narrow_state_is_updated_as_by_the_extended_filter(pixel: bool) -> None:
    """To first order coordinates do not matter."""
    rng = np.random.default_rng(3)
    root = 1e-3 * rng.normal(size=(4, 4))
    state = Gaussian(np.array([*AT, 0.3, -0.2]), root @ root.T)
    given = row(AT + np.array([1e-3, -1e-3]), pixel=pixel, sd=2.0 if pixel else 1e-5)
    found, linear = polar_update(state, given, WORLD), updates.ekf(state, given, WORLD).state
    assert found is not None
    np.testing.assert_allclose(found.mean, linear.mean, atol=2e-7)
    np.testing.assert_allclose(found.covariance, linear.covariance, rtol=2e-3, atol=2e-10)


def test_the_posterior_is_that_of_azimuth_and_log_distance() -> None:
    """A wedge, 10 % of the distance and 0.2 rad wide, by integration over a grid of both."""
    azimuth, spread, noise, off = np.arctan2(30.0, 40.0), (0.2, 0.1), 0.1, 0.15
    frame = 50.0 * np.array([[-0.6, 0.8], [0.8, 0.6]])
    covariance = np.eye(4)
    covariance[:2, :2] = frame @ np.diag(np.square(spread)) @ frame.T
    c, s = np.cos(azimuth + off), np.sin(azimuth + off)
    found = polar_update(
        Gaussian(np.array([*AT, 0.0, 0.0]), covariance),
        row(50.0 * np.array([c, s]), pixel=False, sd=noise),
        WORLD,
    )
    assert found is not None
    grid = azimuth + np.linspace(-1.0, 1.0, 4001)
    weight = np.exp(-0.5 * ((grid - azimuth) / spread[0]) ** 2 - 0.5 * ((grid - azimuth - off) / noise) ** 2)
    mean = float(weight @ grid / weight.sum())
    variance = float(weight @ (grid - mean) ** 2 / weight.sum())
    np.testing.assert_allclose(found.mean[:2], 50.0 * np.array([np.cos(mean), np.sin(mean)]), rtol=1e-6)
    turned = 50.0 * np.array([[-np.sin(mean), np.cos(mean)], [np.cos(mean), np.sin(mean)]])
    expected = turned @ np.diag([variance, spread[1] ** 2]) @ turned.T
    np.testing.assert_allclose(found.covariance[:2, :2], expected, rtol=1e-6)


def test_many_looks_of_one_camera_do_not_draw_the_estimate_to_it() -> None:
    """100 noisy bearings of a target that stands: the distance and its standard deviation stay as they were."""
    rng = np.random.default_rng(1)
    state = Gaussian(np.array([*AT, 0.0, 0.0]), np.diag([200.0, 200.0, 0.1, 0.1]))
    given = row(AT, pixel=False, sd=0.03)
    for off in 0.03 * rng.normal(size=100):
        noisy = given._replace(value=given.value + off)
        state = updates.iekf(state, noisy, WORLD, IekfConfig(visibility_constraint=NONE), np.empty((0, 2))).state
    out = state.mean[:2] / np.hypot(*state.mean[:2])
    assert np.hypot(*state.mean[:2]) == pytest.approx(50.0, rel=1e-6)
    assert np.sqrt(out @ state.covariance[:2, :2] @ out) == pytest.approx(np.sqrt(200.0), rel=1e-6)
    # across: the mean of 100 bearings next to a prior that is far wider
    across = np.array([-out[1], out[0]])
    assert np.sqrt(across @ state.covariance[:2, :2] @ across) == pytest.approx(50.0 * 0.003, rel=0.01)


@pytest.mark.parametrize(("x", "none"), [(0.0, True), (0.9, True), (1.1, False)])
def test_a_prediction_around_the_sensor_has_no_azimuth(x: float, none: bool) -> None:
    state = Gaussian(np.array([x, 0.0, 0.0, 0.0]), np.eye(4))
    assert (polar_update(state, row(AT, pixel=True, sd=2.0), WORLD) is None) == none
