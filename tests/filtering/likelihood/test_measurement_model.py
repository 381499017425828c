"""Pixels and bearings of positions: closed forms, derivatives by differences, and the variance of [Ercan] Eq. 2."""

from __future__ import annotations

import numpy as np
import pytest
from tracker_scenes import room100

from occlog.core.plane import make_floor
from occlog.filtering.likelihood.measurement_model import (
    LinearisedRows,
    MeasurementWorld,
    azimuths,
    linearise,
    linearised,
    measured,
    residuals,
)
from occlog.track.methods.apf.model import pack_noise, pack_sensors

SCENE = room100(pillar=True, sigma_position=0.7, sigma_yaw=0.02)
WORLD = MeasurementWorld(
    pack_sensors(SCENE), pack_noise(SCENE), make_floor(SCENE.region, [o.polygon for o in SCENE.occluders])
)
ROWS = LinearisedRows(
    np.array([0, 1, 3, 5]),
    np.array([True, True, False, False]),
    np.zeros(4),
    np.array([4.0, 9.0, 0.03**2, 0.05**2]),
    np.ones(4, dtype=bool),
)
AT = np.array([20.0, 30.0])


def test_pixels_are_of_the_tangent_of_the_angle_to_the_axis_and_bearings_azimuths() -> None:
    found, ahead = measured(np.array([AT, [60.0, 45.0]]), ROWS, WORLD)
    assert ahead.all()
    for value, xy in zip(found, (AT, [60.0, 45.0]), strict=True):
        for n, i in enumerate(ROWS.sensor):
            camera = SCENE.cameras[i]
            azimuth = np.arctan2(*(xy - camera.position[:2])[::-1])
            wanted = camera.focal_px[0] * np.tan(azimuth - camera.yaw) if ROWS.pixel[n] else azimuth
            assert value[n] == pytest.approx(wanted)
        at = [np.arctan2(*(xy - SCENE.cameras[i].position[:2])[::-1]) for i in ROWS.sensor]
        np.testing.assert_allclose(np.sin(azimuths(ROWS._replace(value=value), WORLD) - at), 0.0, atol=1e-12)
    # Behind the cameras there are no pixels, and bearings are all around
    behind = [2.0 * SCENE.cameras[i].position[:2] - AT for i in ROWS.sensor]
    assert [bool(measured(np.array([xy]), ROWS, WORLD)[1][0, n]) for n, xy in enumerate(behind)] == [
        False, False, True, True,
    ]  # fmt: skip


def test_residuals_of_bearings_are_wrapped_and_those_of_pixels_are_not() -> None:
    off = residuals(np.array([-3.0, 3.0, -3.0, 3.0]), ROWS._replace(value=np.array([3.0, -3.0, 3.0, -3.0])))
    np.testing.assert_allclose(off, [6.0, -6.0, 6.0 - 2.0 * np.pi, 2.0 * np.pi - 6.0])


def test_derivatives_are_those_of_the_measurements_and_variances_have_the_errors_of_the_pose() -> None:
    H, variance = linearised(AT, ROWS, WORLD)
    for axis in range(2):
        step = 1e-5 * np.eye(2)[axis]
        ahead, behind = (measured((AT + way * step)[None], ROWS, WORLD)[0][0] for way in (1, -1))
        np.testing.assert_allclose(H[:, axis], (ahead - behind) / 2e-5, rtol=1e-6)
    for n, i in enumerate(ROWS.sensor):
        camera, wanted = SCENE.cameras[i], ROWS.variance[n]
        if ROWS.pixel[n]:
            # Eq. 2, by the angle to the axis and the distance
            away = AT - camera.position[:2]
            cosine = np.cos(np.arctan2(away[1], away[0]) - camera.yaw)
            angle = (0.02 / cosine) ** 2 + (0.7 / (np.hypot(*away) * cosine)) ** 2
            wanted += (camera.focal_px[0] / cosine) ** 2 * angle
        assert variance[n] == pytest.approx(wanted)
    both = linearise(AT, ROWS, WORLD)
    np.testing.assert_array_equal(both.H, H)
    near = AT + np.array([1e-4, -2e-4])
    np.testing.assert_allclose(both.innovation(near), linearise(near, ROWS, WORLD).residual, atol=1e-6)
    np.testing.assert_array_equal(both.take(ROWS.pixel).innovation(near), both.innovation(near)[:2])
