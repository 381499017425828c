"""Filters that begin in a scene without a room."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.records.scene import Camera, MicrophoneArray, Scene, camera_rotation
from occlog.scans.grouping import Scan
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.model import (
    lines_of_sight,
    max_destination_distance,
    pack_noise,
    pack_scan,
    pack_sensors,
    read_noise,
)

pytestmark = pytest.mark.jit

SECOND = 1_000_000_000


def camera(name: str, x: float, y: float, yaw_deg: float, **more) -> Camera:
    rotation = camera_rotation(np.radians(yaw_deg), 0.0, 0.0)
    return Camera(name, np.array([x, y, 1.5]), rotation, np.full(2, 800.0), np.full(2, 400.0), (801, 801), **more)


def observations(scene: Scene, target: np.ndarray, t_ns: int, sigma_px: float = 2.0) -> Scan:
    """Exact pixels of a target in all cameras."""
    away = target - np.array([c.ground for c in scene.cameras])
    bearing = np.arctan2(away[:, 1], away[:, 0])
    n = len(bearing)
    return Scan.of(
        t_ns,
        range(n),
        target_id=np.zeros(n),
        bearing=bearing,
        sigma=np.full(n, sigma_px / 800.0),
        u_px=[c.u_px(bearing[i : i + 1])[0] for i, c in enumerate(scene.cameras)],
        sigma_px=np.full(n, sigma_px),
    )


def followed(scene: Scene, path: np.ndarray, seed: int = 0) -> np.ndarray:
    """(T,) distances of the estimates from a path at 5 Hz."""
    rng = np.random.default_rng(seed)
    state = apf.init(scene, ApfConfig.in_unit(scene.length_unit), rng)
    errors = []
    for k, place in enumerate(path):
        state, estimate = apf.step(state, observations(scene, place, k * SECOND // 5), rng)
        errors.append(float(np.hypot(*(estimate.xy - place))))
    return np.array(errors)


PAIRS = {
    "parallel": (camera("a", 0.0, 0.0, 0.0), camera("b", 0.0, 2.0, 0.0)),
    "facing": (camera("a", 0.0, -1.0, 0.0), camera("b", 25.0, 2.0, 180.0)),
    "at right angles": (camera("a", 0.0, 0.0, 0.0), camera("b", 12.0, -12.0, 90.0)),
}


@pytest.mark.parametrize("pair", PAIRS)
def test_a_target_beyond_the_box_of_two_cameras_is_found_in_the_first_scan(pair):
    path = np.array([12.0, 1.0]) + 0.2 * np.column_stack([np.zeros(10), np.arange(10)]) * 1.2
    errors = followed(Scene(cameras=PAIRS[pair]), path)
    # Parallel cameras 2 m apart tell a distance of 12 m to 0.25 m
    assert errors.max() < (0.9 if pair == "parallel" else 0.25)


def test_feet_and_metres_give_the_same_track():
    path = np.array([12.0, 1.0]) + np.zeros((5, 2))
    k = 1.0 / 0.3048
    far = tuple(camera(c.name, *(k * c.ground), np.degrees(c.yaw)) for c in PAIRS["at right angles"])
    assert followed(Scene(cameras=far, length_unit="ft"), k * path).max() < 0.25 * k


def test_sight_lines_have_the_errors_of_reading_yaw_and_place():
    c = camera("a", 1.0, 2.0, 30.0, sigma_yaw=0.01, sigma_position=0.2)
    scene = Scene(cameras=(c,), arrays=(MicrophoneArray("m", np.array([5.0, 5.0, 1.0])),))
    scan = Scan.of(
        0,
        [0, 1],
        bearing=[np.radians(40.0), 1.0],
        sigma=[0.003, 0.05],
        u_px=[c.u_px(np.array([np.radians(40.0)]))[0], np.nan],
        sigma_px=[2.0, np.nan],
    )
    packed = pack_scan(scan, read_noise(scene), use_score=False)
    assert scene.views is not None
    found = lines_of_sight(packed, pack_sensors(scene), pack_noise(scene), scene.views)
    np.testing.assert_allclose(found.azimuth, [np.radians(40.0), 1.0])
    np.testing.assert_allclose(found.sigma, [np.hypot(2.0 / 800.0 * np.cos(np.radians(10.0)) ** 2, 0.01), 0.05])
    np.testing.assert_allclose(found.sigma_origin, [0.2, 0.0])
    np.testing.assert_allclose(found.far, scene.views.far)
    assert found.sensor.tolist() == [0, 1]


def test_destinations_are_half_the_sensors_extent_away_or_ten_seconds():
    assert max_destination_distance(Scene(cameras=(camera("a", 0.0, 0.0, 0.0),)), speed=1.0) == 10.0
    wide = Scene(cameras=(camera("a", 0.0, 0.0, 0.0), camera("b", 98.0, 0.0, 180.0)))
    assert max_destination_distance(wide, speed=1.0) == pytest.approx(0.5 * np.hypot(98.0 + 2 * 10.8, 2 * 10.8))
