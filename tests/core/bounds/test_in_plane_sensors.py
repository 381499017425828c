"""Fisher information of the sensors against the likelihood itself, and estimators against the bound."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.array_types import Floats
from occlog.core.bounds import in_plane as crlb
from occlog.core.geometry.camera import noise_variance, planar_offsets, wrap_angle

POSITION, YAW, FOCAL = np.array([2.0, -1.0]), 0.7, 70.0
NOISE = (1.0, 0.03, 2.0)  # sigma_position, sigma_yaw, sigma_read_px


def mean_and_variance(xy: Floats) -> tuple[Floats, Floats]:
    """m and v of [Ercan] Eq. 1 and 2 at (N, 2) positions."""
    h, d = planar_offsets(xy, POSITION, YAW)
    return FOCAL * h / d, noise_variance(h, d, FOCAL, NOISE[0], NOISE[1], NOISE[2])


def log_likelihood(z: Floats, xy: Floats) -> Floats:
    m, v = mean_and_variance(xy)
    return -0.5 * np.log(2 * np.pi * v) - 0.5 * (z - m) ** 2 / v


def place(distance: float, offset: float) -> Floats:
    """Position at a distance along and an offset to the left of the optical axis."""
    c, s = np.cos(YAW), np.sin(YAW)
    return POSITION + distance * np.array([c, s]) + offset * np.array([-s, c])


def score(z: Floats, xy: Floats) -> Floats:
    """(N, 2) numerical gradient of the log-likelihood of (N,) measurements at one position."""
    step = 1e-5
    columns = []
    for axis in np.eye(2) * step:
        high, low = log_likelihood(z, (xy + axis)[None]), log_likelihood(z, (xy - axis)[None])
        columns.append((high - low) / (2 * step))
    return np.column_stack(columns)


def camera(xy: Floats, noise: tuple[float, float, float] = NOISE) -> Floats:
    return crlb.camera_information(xy, POSITION, YAW, FOCAL, noise[0], noise[1], np.full(len(xy), noise[2]))


@pytest.mark.parametrize(("distance", "offset"), [(10.0, 0.0), (10.0, 6.0), (3.0, -2.5), (60.0, 20.0)])
def test_camera_information_is_the_integral_of_the_squared_score(distance: float, offset: float) -> None:
    xy = place(distance, offset)
    (m,), (v,) = mean_and_variance(xy[None])
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    z = m + np.sqrt(v) * nodes
    s = score(z, xy)
    expected = np.einsum("q,qi,qj->ij", weights / weights.sum(), s, s)
    np.testing.assert_allclose(camera(xy[None])[0], expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_camera_information_is_the_covariance_of_the_score(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = place(rng.uniform(5, 50), rng.uniform(-4, 4))
    (m,), (v,) = mean_and_variance(xy[None])
    s = score(m + np.sqrt(v) * rng.normal(size=40_000), xy)
    products = s[:, :, None] * s[:, None, :]
    error_bar = products.std(axis=0) / np.sqrt(len(s))
    assert np.all(np.abs(products.mean(axis=0) - camera(xy[None])[0]) < 4 * error_bar)


@pytest.mark.parametrize(("distance", "offset"), [(10.0, 6.0), (3.0, -2.5)])
def test_camera_information_is_minus_the_mean_curvature(distance: float, offset: float) -> None:
    xy, step = place(distance, offset), 1e-3
    (m,), (v,) = mean_and_variance(xy[None])
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    z = m + np.sqrt(v) * nodes
    curvature = np.empty((2, 2))
    for i, a in enumerate(np.eye(2) * step):
        for j, b in enumerate(np.eye(2) * step):
            corners = [(1, a + b), (-1, a - b), (-1, b - a), (1, -a - b)]
            second = sum(sign * log_likelihood(z, (xy + d)[None]) for sign, d in corners) / (4 * step**2)
            curvature[i, j] = weights @ second / weights.sum()
    np.testing.assert_allclose(camera(xy[None])[0], -curvature, rtol=1e-4, atol=1e-7)


def test_variance_term_is_there_and_small_on_the_axis() -> None:
    xy = place(10.0, 0.0)[None]
    along = np.array([np.cos(YAW), np.sin(YAW)])
    # On the axis the mean tells nothing along the sight line, the growing noise does a little
    information = along @ camera(xy)[0] @ along
    v = FOCAL**2 * (NOISE[1] ** 2 + NOISE[0] ** 2 / 100) + NOISE[2] ** 2
    assert information == pytest.approx(0.5 * (2 * FOCAL**2 * NOISE[0] ** 2 / 1000) ** 2 / v**2)
    assert along @ camera(xy, (0.0, 0.0, 2.0))[0] @ along == pytest.approx(0.0, abs=1e-12)


def test_behind_the_camera_there_is_no_information() -> None:
    behind = np.array([place(-5.0, 1.0), place(0.0, 3.0), place(5.0, 0.0)])
    information = camera(behind)
    assert not information[:2].any()
    assert information[2].any()


def test_camera_with_read_noise_equals_a_bearing_sensor_of_the_same_angle_noise() -> None:
    xy = np.array([place(8.0, 3.0), place(20.0, -15.0), place(5.0, 0.0)])
    h, d = planar_offsets(xy, POSITION, YAW)
    sigma = 2.0 / FOCAL / (1 + (h / d) ** 2)  # d bearing = dz / (f (1 + z^2/f^2))
    np.testing.assert_allclose(
        camera(xy, (0.0, 0.0, 2.0)), crlb.bearing_information(xy, POSITION, sigma), rtol=1e-10, atol=1e-15
    )


def test_bearing_information_by_hand() -> None:
    # 2 away in x with 0.1 rad: (1/2)^2 / 0.1^2 = 25 across, nothing along; nothing at the sensor itself
    xy = np.array([[2.0, 0.0], [0.0, 0.0]])
    information = crlb.bearing_information(xy, np.zeros(2), np.array([0.1, 0.1]))
    np.testing.assert_allclose(information[0], [[0, 0], [0, 25.0]], atol=1e-12)
    assert not information[1].any()


@given(st.floats(0.5, 50.0), st.floats(-1.0, 1.0), st.floats(-3.1, 3.1), st.floats(-20, 20))
def test_information_turns_with_the_world(distance: float, slope: float, turn: float, shift: float) -> None:
    xy = place(distance, slope * distance)
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s], [s, c]])
    turned = crlb.camera_information(
        (R @ xy + shift)[None], R @ POSITION + shift, YAW + turn, FOCAL, NOISE[0], NOISE[1], np.array([2.0])
    )[0]
    np.testing.assert_allclose(turned, R @ camera(xy[None])[0] @ R.T, rtol=1e-6, atol=1e-9)


SENSORS = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
SIGMA = 0.02


def azimuths(xy: Floats) -> Floats:
    delta = xy[..., None, :] - SENSORS
    return np.arctan2(delta[..., 1], delta[..., 0])


def test_maximum_likelihood_of_a_standing_target_reaches_the_bound_and_not_less() -> None:
    rng, xy, runs = np.random.default_rng(5), np.array([6.0, 5.0]), 2000
    z = azimuths(xy) + SIGMA * rng.normal(size=(runs, 3))
    estimate = np.broadcast_to(xy, (runs, 2)).copy()
    for _ in range(10):  # Gauss-Newton from the truth
        delta = estimate[:, None] - SENSORS
        H = np.stack([-delta[..., 1], delta[..., 0]], axis=-1) / np.sum(delta**2, axis=-1)[..., None]
        residual = wrap_angle(z - azimuths(estimate))
        normal = np.einsum("rki,rkj->rij", H, H)
        estimate += np.linalg.solve(normal, np.einsum("rki,rk->ri", H, residual)[..., None])[..., 0]
    information = sum(crlb.bearing_information(xy[None], p, np.array([SIGMA]))[0] for p in SENSORS)
    squared = np.sum((estimate - xy) ** 2, axis=1)
    ratio = squared.mean() / np.trace(np.linalg.inv(information))
    error_bar = squared.std() / np.sqrt(runs) / squared.mean()
    assert 1 - 3 * error_bar < ratio < 1.05 + 3 * error_bar


def test_extended_kalman_filter_stays_above_the_posterior_bound() -> None:
    rng, runs, steps, dt, sigma_v = np.random.default_rng(9), 400, 40, 0.5, 0.2
    P0, x = np.eye(2), np.array([5.0, 5.0]) + rng.normal(size=(runs, 2))
    estimate, P = np.broadcast_to([5.0, 5.0], (runs, 2)).copy(), np.broadcast_to(P0, (runs, 2, 2)).copy()
    squared, information = np.empty((runs, steps)), np.zeros((steps, 2, 2))
    for k in range(steps):
        x = x + sigma_v * np.sqrt(dt) * rng.normal(size=(runs, 2))
        for p in SENSORS:
            information[k] += crlb.bearing_information(x, p, np.full(runs, SIGMA)).mean(axis=0)
        z = azimuths(x) + SIGMA * rng.normal(size=(runs, 3))
        P = P + sigma_v**2 * dt * np.eye(2)
        delta = estimate[:, None] - SENSORS
        H = np.stack([-delta[..., 1], delta[..., 0]], axis=-1) / np.sum(delta**2, axis=-1)[..., None]
        S = H @ P @ H.transpose(0, 2, 1) + SIGMA**2 * np.eye(3)
        K = P @ H.transpose(0, 2, 1) @ np.linalg.inv(S)
        estimate = estimate + (K @ wrap_angle(z - azimuths(estimate))[..., None])[..., 0]
        P = P - K @ H @ P
        squared[:, k] = np.sum((estimate - x) ** 2, axis=1)
    bound = crlb.posterior_bound(information, *crlb.known_drift_steps(np.full(steps, dt), sigma_v), P0)
    per_run = squared[:, 5:].mean(axis=1)
    ratio = per_run.mean() / np.trace(bound[5:], axis1=1, axis2=2).mean()
    error_bar = per_run.std() / np.sqrt(runs) / per_run.mean()
    assert 1 - 3 * error_bar < ratio < 1.1 + 3 * error_bar
