from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from heard_scenes import NS, ROOM, room

from occlog.scans.grouping import Scan, concat, empty_scan
from occlog.track.methods.imm import kernel as imm
from occlog.track.methods.imm.association import bearing_fit
from occlog.track.methods.imm.config import ImmConfig
from occlog.track.methods.imm.filter import init, step
from occlog.track.methods.imm.tracks import (
    TENTATIVE,
    UNLABELLED_TRACK,
    make_world,
    move_track,
    switching,
    track_on_bearing,
    update_existence,
)

SCENE = room(ROOM.replace("position: [2, 2, 1], sigma_deg: 2", "position: [2, 2, 1], sigma_deg: 2, range: 9"))
STILL = replace(
    ImmConfig.in_unit("m"),
    particles=60_000,
    turn_acceleration=0.0,
    process_noise_velocity=0.0,
    birth_probability=0.0,
    clutter_rate=1e-9,
    walls=False,
    termination_threshold=0.0,
    mean_sound_s=1e12,
    mean_silence_s=1e-9,
)
"""A target that stands still and always sounds: its cloud can be compared with a grid."""
SIGMA = math.radians(2.0)


def observation(*degrees, array=0):
    """What one array hears; no bearings: it listens in vain."""
    sensor = len(SCENE.cameras) + array
    if not degrees:
        return empty_scan(0, [sensor])
    n = len(degrees)
    return Scan.of(0, [sensor] * n, bearing=np.radians(degrees), sigma=np.full(n, SIGMA))


def at(t_ns, *observations):
    """A scan of observations of several arrays."""
    return concat(observations)._replace(t_ns=t_ns)


def by_grid(x, y, s, observations, detection, reach):
    """Mean and covariance of a target that stands still, by a fine grid over the plane."""
    u = np.linspace(-6, 6, 1201) * s
    X, Y = np.meshgrid(x + u, y + u, indexing="ij")
    p = np.exp(-0.5 * ((X - x) ** 2 + (Y - y) ** 2) / s**2)
    for k in observations:
        array = int(k.sensor[0]) - len(SCENE.cameras)
        dx, dy = X - SCENE.arrays[array].position[0], Y - SCENE.arrays[array].position[1]
        heard = detection * (np.hypot(dx, dy) <= reach[array])
        if k.seen.any():
            p = p * heard * np.exp(-0.5 * ((np.arctan2(dy, dx) - k.bearing[0]) / SIGMA) ** 2)
        else:
            p = p * (1.0 - heard)
    p /= p.sum()
    mean = np.array([(p * X).sum(), (p * Y).sum()])
    return mean, np.array([(p * (X - mean[0]) ** 2).sum(), (p * (Y - mean[1]) ** 2).sum()])


@pytest.mark.jit
@pytest.mark.parametrize(
    "observations",
    [
        [observation(38.0), observation(40.0)],
        [observation(40.0), observation(155.0, array=1)],
        [observation(), observation(), observation(38.0)],
        [observation()],
    ],
    ids=["one array", "two arrays", "silence, then a bearing", "silence: out of range"],
)
@pytest.mark.parametrize("seed", [0])
def test_one_target_is_where_a_grid_has_it(observations, seed):
    x, y, s = 8.5, 7.5, 1.0
    config = replace(STILL, start=(x, y, s, 0.0, 0.0, 0.0), detection_probability=0.8)
    rng = np.random.default_rng(seed)
    state = init(SCENE, config, rng)
    for n, heard in enumerate(observations):
        state, report = step(state, at(n * NS, heard), rng)
    mean, variance = by_grid(x, y, s, observations, 0.8, [9.0, np.inf])
    estimate = report.beliefs[0].estimate
    # 60,000 particles drawn again at every step: standard errors are below 0.006 m and 0.012 of a variance.
    np.testing.assert_allclose(estimate.mean[::2], mean, atol=0.03)
    np.testing.assert_allclose(np.diag(estimate.covariance)[::2], variance, rtol=0.06)


@pytest.mark.jit
@pytest.mark.parametrize("seed", [0, 1])
def test_arrays_in_one_scan_are_as_good_as_one_after_the_other(seed):
    config = replace(STILL, start=(8.0, 8.0, 1.0, 0.0, 0.0, 0.0))
    found = []
    for observations in (
        [(observation(45.0), observation(150.0, array=1))],
        [(observation(45.0),), (observation(150.0, array=1),)],
    ):
        rng = np.random.default_rng(seed)
        state = init(SCENE, config, rng)
        for heard in observations:
            state, report = step(state, at(0, *heard), rng)
        found.append(report.beliefs[0].estimate.mean[::2])
    np.testing.assert_allclose(found[0], found[1], atol=0.03)


def test_association_any_is_the_filter_of_the_kernel():
    """[Lee] Eq. 3.6 for one target and two bearings, step for step with the same random numbers."""
    config = replace(
        STILL,
        particles=300,
        turn_acceleration=0.3,
        process_noise_velocity=0.2,
        association="any",
        start=(8.0, 8.0, 1.0, 0.5, 0.0, 0.2),
    )
    state = init(SCENE, config, np.random.default_rng(3))
    heard, cloud = observation(40.0, 60.0), state.tracks[0].cloud
    state, _ = step(state, Scan.of(0, []), np.random.default_rng(1))
    cloud = state.tracks[0].cloud
    _, report = step(state, at(NS, heard), np.random.default_rng(2))
    world = make_world(SCENE, config)
    moved = move_track(world, state.tracks[0], 1.0, np.random.default_rng(2))
    prior = imm.prior_weights(cloud.models, 3, None)
    weights = imm.update_weights(moved.predicted, prior, heard.bearing, heard.sigma, world.positions[0])
    expected = imm.moments(moved.predicted, weights.total)
    np.testing.assert_allclose(report.beliefs[0].estimate.mean, expected.mean, rtol=1e-12)


@pytest.mark.parametrize("unheard", [0.0, 0.3, 1.0])
def test_existence_and_sound_follow_bayes(unheard):
    """States: not there; there and silent; there, sounding and missed; there and heard."""
    world = make_world(SCENE, replace(STILL, particles=100, initial_particle_factor=10))
    rng = np.random.default_rng(0)
    track = track_on_bearing(world, 0, 0.7, 0.05, 0, UNLABELLED_TRACK, rng)._replace(exists=0.6, sounds=0.7)
    states = track.cloud.states[None]
    none = np.empty(0)
    silent = bearing_fit(
        states, np.full((1, 1000), 1e-3), bearing=none, sigma=none, position=world.positions[0], reach=9.0
    )
    d = 0.9 * silent.reached
    states = {"none": 0.4, "silent": 0.6 * 0.3, "missed": 0.6 * 0.7 * (1 - d)}
    total = sum(states.values())
    exists = 1.0 - unheard + unheard * (states["silent"] + states["missed"]) / total
    sounds = (1.0 - unheard + unheard * states["missed"] / total) / exists
    got = update_existence(track, silent.reached, 0.9, unheard)
    assert got.exists == pytest.approx(exists, rel=1e-12)
    assert got.sounds == pytest.approx(sounds, rel=1e-12)


def test_births_are_on_the_sight_line_in_range_and_room():
    config = ImmConfig.in_unit("m")
    world = make_world(SCENE, config)
    track = track_on_bearing(
        world, 0, math.radians(30.0), math.radians(1.0), 5, UNLABELLED_TRACK, np.random.default_rng(0)
    )
    xy = track.cloud.states[:, ::2] - world.positions[0]
    assert len(xy) == 6000
    np.testing.assert_allclose(np.degrees(np.arctan2(xy[:, 1], xy[:, 0])), 30.0, atol=5.0)
    far = np.hypot(*xy.T)
    assert far.max() <= 9.0
    assert np.mean(far) == pytest.approx(4.5, abs=0.15)  # uniform in the distance; standard error 0.04
    assert (track.number, track.exists, track.met_ns) == (TENTATIVE, config.birth_probability, 5)
    out = track_on_bearing(world, 0, math.radians(-135.0), 0.01, 5, 4, np.random.default_rng(0))
    inside = (out.cloud.states[:, [0, 2]] >= 0).all()
    assert inside  # the array is 2.8 m from the corner
    assert (out.number, out.exists) == (4, 1.0)


def test_no_two_tracks_have_a_number():
    config = replace(ImmConfig.in_unit("m"), start=(9.0, 2.0, 0.5, 0.0, 0.0, 0.1))
    rng = np.random.default_rng(1)
    state = init(SCENE, config, rng)  # the known target has number 0, and is heard with label 5
    for k in range(5):
        heard = observation(0.0, math.degrees(1.0))._replace(target_id=np.array([5, 0], dtype=np.int32))
        state, report = step(state, at(int(k * 1e9), heard._replace(sigma=np.array([0.02, 0.02]))), rng)
        numbers = [belief.number for belief in report.beliefs]
        assert len(set(numbers)) == len(numbers)
    assert {t.label: t.number for t in state.tracks} == {5: 0, 0: 1}


def test_no_one_leaves_the_room():
    config = replace(ImmConfig.in_unit("m"), particles=500, start=(19.5, 7.0, 0.1, 2.0, 0.0, 0.1))
    rng = np.random.default_rng(0)
    state = init(SCENE, config, rng)
    for n in range(6):
        state, report = step(state, at(n * NS // 5, observation(array=1)), rng)
    assert report.beliefs[0].estimate.mean[0] < 20.0


def test_switching_keeps_a_model_for_its_time():
    P = switching(3, 2.0, 5.0)
    stay = math.exp(-0.4)
    np.testing.assert_allclose(P.sum(axis=1), 1.0)
    assert P[0, 0] == pytest.approx(stay + (1 - stay) / 3)
    np.testing.assert_allclose(P @ P, switching(3, 4.0, 5.0))
    assert switching(3, 2.0, None) is None


def test_settings_fit_the_unit():
    metres, feet = ImmConfig.in_unit("m"), ImmConfig.in_unit("ft")
    for name in ("turn_acceleration", "process_noise_velocity", "sigma_initial_velocity", "request_sigma"):
        assert getattr(feet, name) == pytest.approx(getattr(metres, name) / 0.3048)
    assert ImmConfig.in_unit("unit") == ImmConfig()
