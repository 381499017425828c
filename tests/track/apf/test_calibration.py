"""Filters that estimate fixed errors of the cameras' poses."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tracker_scenes import room100, scan, true_u, with_array

from occlog.core.geometry.visibility import seen_from
from occlog.core.numerics.seeds import RandomStream, generator
from occlog.errors import InputError
from occlog.records.scene import Occluder, Scene
from occlog.records.tables import Bearings, Truth
from occlog.scans.grouping import BearingRows, scans_of
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.calibration import begin, corrected, corrected_sensors
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.model import pack_noise, pack_sensors, read_noise


def recorded(scene, noise, seed, steps):
    """Bearings, scans and true places of one target."""
    truth = Truth.concat(simulate_truth(scene, WorldConfig(steps=steps), seed))
    bearings = Bearings.concat(observe(scene, [truth], ObserveConfig(pose_noise=noise), seed))
    found = scans_of([bearings], scene, BearingRows({c.name for c in scene.cameras}))
    return bearings, [g.of_target(0) for g in found], np.column_stack([truth.x, truth.y])


def true_errors(scene, seed):
    return np.array(
        [
            generator(seed, RandomStream.CAMERA_CALIBRATION, i).standard_normal(3)
            * [c.sigma_position, c.sigma_position, c.sigma_yaw]
            for i, c in enumerate(scene.cameras)
        ]
    )


def run(scene, scans, seed=0, **settings):
    rng = np.random.default_rng(seed)
    state, out = apf.init(scene, ApfConfig(particles=500, **settings), rng), []
    for given in scans:
        state, estimate = apf.step(state, given, rng)
        out.append(estimate)
    return state, out


def rmse(estimates, xy, skip):
    miss = np.array([e.xy for e in estimates])[skip:] - xy[skip:]
    return np.sqrt(np.mean(np.sum(miss**2, axis=1)))


def calibrated(scene, mode="joint"):
    sensors, noise = pack_sensors(scene), pack_noise(scene)
    found = begin(scene, noise, read_noise(scene), sensors, mode)
    assert found is not None
    return found, sensors, noise


@cache
def walked(seed):
    """A recording of 220 steps with fixed errors, and what a filter that knows nothing of them estimates."""
    scene = room100(cameras=6)
    _, scans, xy = recorded(scene, "calibration", seed, 220)
    return scene, scans, xy, run(scene, scans)[1]


@pytest.mark.jit
@pytest.mark.statistics
@pytest.mark.parametrize("mode", ["joint", "initial"])
def test_fixed_errors_are_found_and_make_the_track_better(mode):
    """Three recordings; over ten longer ones `python -m benchmarks calibration` measures 0.80 and 0.85, +- 0.04."""
    ratios, squares = [], []
    for seed in range(3):
        scene, scans, xy, plain = walked(seed)
        state, found = run(scene, scans, calibrate=mode, calibration_s=80.0)
        ratios.append(rmse(found, xy, 100) / rmse(plain, xy, 100))
        belief = state.calibration.belief
        miss = (belief.mean - true_errors(scene, seed)).ravel()
        squares.append(miss @ np.linalg.solve(belief.covariance, miss) / miss.size)
        assert state.calibration.converged
        assert found[-1].calibration.mean == pytest.approx(belief.mean)
    assert np.mean(ratios) < 0.97
    # 54 squares of normal deviates: their mean is 1 +- 0.19.
    assert 0.43 < np.mean(squares) < 1.57


@pytest.mark.jit
def test_white_noise_is_not_taken_for_errors_that_stay():
    scene = room100(cameras=6)
    _, scans, xy = recorded(scene, "white", 1, 120)
    plain = run(scene, scans)[1]
    state, found = run(scene, scans, calibrate="joint")
    assert not state.calibration.converged
    assert state.calibration.belief.log_odds < 0.0
    assert rmse(found, xy, 20) < 1.05 * rmse(plain, xy, 20)


def test_nothing_is_estimated_unless_asked_for():
    scene = room100(cameras=4)
    state, found = run(scene, [scan(0.0, [(0, 3.0), (1, None)])])
    assert state.calibration is None
    assert found[0].calibration is None


@pytest.mark.jit
def test_the_initial_phase_ends_and_what_it_found_stays():
    scene = room100(cameras=6)
    _, scans, _ = recorded(scene, "calibration", 0, 40)
    _, found = run(scene, scans, calibrate="initial", calibration_s=30.0)
    means = np.array([e.calibration.mean for e in found])
    assert np.all(means[:30] == 0.0)
    assert np.any(means[30] != 0.0)
    assert np.all(means[30:] == means[30])


def test_corrected_sensors_are_those_of_a_scene_with_moved_cameras():
    scene = room100(cameras=4)
    rng = np.random.default_rng(0)
    errors = rng.normal(0, 1, (4, 3)) * [1.0, 1.0, 0.02]
    found = corrected_sensors(scene, errors)
    np.testing.assert_allclose(found.xy, pack_sensors(scene).xy + errors[:, :2])
    yaw = np.arctan2(found.axis[:, 1], found.axis[:, 0])
    np.testing.assert_allclose(np.exp(1j * yaw), np.exp(1j * (np.radians([45, 90, 135, 180]) + errors[:, 2])))
    positions = rng.uniform(0, 100, (500, 2))
    same = np.mean(seen_from(positions, 0, found) == seen_from(positions, 0, pack_sensors(scene)))
    assert 0.9 < same <= 1.0


def test_a_camera_is_not_blinded_by_the_wall_it_is_moved_into():
    base = room100(cameras=2)
    wall = np.array([[-5.0, -5.0], [-0.5, -5.0], [-0.5, 5.0], [-5.0, 5.0]])
    scene = Scene(base.cameras, (), (Occluder("wall", wall),), (), None, length_unit="unit")
    found = corrected_sensors(scene, np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    assert seen_from(np.array([[30.0, 30.0]]), 0, found)[0]


def test_a_cloud_far_apart_gets_eq_2_with_what_is_left():
    scene = room100(cameras=3)
    calibration, _, _ = calibrated(scene)
    belief = calibration.belief._replace(covariance=0.25 * calibration.belief.covariance, log_odds=10.0)
    calibration = calibration._replace(belief=belief)
    rng = np.random.default_rng(1)
    weights = np.full(400, 1 / 400)
    _, wide = corrected(calibration, rng.uniform(0, 100, (400, 2)), weights)
    np.testing.assert_allclose(wide.sigma_position, 0.5)
    np.testing.assert_allclose(wide.sigma_yaw, 0.005)
    _, narrow = corrected(calibration, [50.0, 80.0] + 0.1 * rng.standard_normal((400, 2)), weights)
    away = np.hypot(*(np.array([50.0, 80.0]) - pack_sensors(scene).xy).T)
    np.testing.assert_allclose(narrow.sigma_position, 0.0)
    np.testing.assert_allclose(narrow.sigma_yaw, np.sqrt((0.5 / away) ** 2 + 0.005**2), rtol=1e-3)


@pytest.mark.jit
def test_what_cannot_be_observed_is_in_the_covariance_of_the_estimate():
    """Cameras that agree perfectly still do not know where all of them are."""
    scene = room100(cameras=6, sigma_read_px=0.2)
    _, scans, _ = recorded(scene, "calibration", 3, 60)
    state, found = run(scene, scans, calibrate="joint")
    _, plain = run(scene, scans)
    shift = np.tile([1.0, 0.0, 0.0], 6) / 6
    together = np.sqrt(shift @ state.calibration.belief.covariance @ shift)
    assert together > 0.3  # 1 / sqrt(6) before
    assert np.sqrt(found[-1].covariance[0, 0]) > 0.8 * together
    assert np.isfinite(plain[-1].covariance).all()


def test_directions_of_arrays_count_and_arrays_have_no_errors():
    scene = with_array(room100(cameras=4), (50.0, 0.0))
    xy = np.array([30.0, 70.0])
    u = true_u(room100(cameras=4), xy)
    given = scan(0.0, [(i, u[i]) for i in range(4) if abs(u[i]) < 69] + [(4, np.nan)])
    sees = given.sensor == 4
    given = given._replace(
        seen=given.seen | sees,
        bearing=np.where(sees, np.arctan2(70.0, -20.0), given.bearing),
        sigma=np.where(sees, 0.02, given.sigma),
    )
    state, found = run(scene, [given], calibrate="joint")
    assert np.all(found[0].calibration.deviation[4] == 0.0)
    assert state.calibration.belief.counted > 0


def test_the_table_has_every_sensor_at_every_time_and_target():
    scene = room100(cameras=4)
    bearings, _, _ = recorded(scene, "calibration", 0, 10)
    parts = list(track([bearings], scene, TrackingTask(ApfConfig(particles=100, calibrate="joint"), 1)))
    table = parts[0].calibration
    assert len(table) == 4 * len(parts[0].tracks)
    assert table.sensor[:4].tolist() == ["cam1", "cam2", "cam3", "cam4"]
    np.testing.assert_allclose(table.sd_dyaw[:4], 0.01, rtol=0.2)
    again = list(track([bearings], scene, TrackingTask(ApfConfig(particles=100, calibrate="joint"), 1)))
    np.testing.assert_array_equal(again[0].calibration.dx, table.dx)
    assert not len(next(iter(track([bearings], scene, TrackingTask(ApfConfig(particles=100), 1)))).calibration)


def test_an_unknown_mode_is_refused():
    with pytest.raises(InputError, match="calibrate is sometimes, must be one of none, joint, initial"):
        ApfConfig(calibrate="sometimes")
