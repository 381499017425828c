"""Trajectories drawn backwards: against the exact smoother, and what they are for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tracker_scenes import ROOM, camera, room100, scan, true_u

from benchmarks.track._metric_rooms import record
from benchmarks.track.false_bearings import ELLIPSE, follow
from occlog.records.scene import Scene
from occlog.records.tables import Tracks
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig

pytestmark = pytest.mark.jit

BACK = apf.METHOD.smoothing.back
DIFFUSING = {
    "initial_speed": 0.0,
    "sigma_initial_speed": 0.0,
    "velocity_memory": 0.0,
    "beta1": 1.0,
    "lambda1": 0.0,
    "beta2": 1.0,
    "lambda2": 0.0,
    "track_loss_count": 0,
}
"""Settings of a target that always goes on, at speed 0: noise alone moves it."""
SHARP = {"focal": 20_000.0, "sigma_position": 0.0, "sigma_yaw": 0.0, "sigma_read_px": 60.0}


def traces_of(scene, scans, config, seed=0):
    """What each step left for the way back, and the filtered estimates."""
    rng = np.random.default_rng(seed)
    state, traces, estimates = apf.init(scene, config, rng), [], []
    for given in scans:
        state, estimate = apf.step(state, given, rng)
        traces.append(state.trace)
        estimates.append(estimate)
    return traces, estimates


def smoothed(traces, config, seed=0):
    return BACK(traces, config, np.random.default_rng([seed, 1]))


def everywhere(scene, xy, t_s, noise):
    return scan(t_s, [(i, u + noise[i]) for i, u in enumerate(true_u(scene, xy))])


def rauch_tung_striebel(m0, P0, Q, H, R, z):
    """Means and covariances of a place that diffuses and is measured linearly, filtered and smoothed."""
    m, P, filtered = m0, P0, []
    for k in range(len(z)):
        if k:
            P = P + Q
        S = H[k] @ P @ H[k].T + R
        K = P @ H[k].T @ np.linalg.inv(S)
        m, P = m + K @ (z[k] - H[k] @ m), P - K @ H[k] @ P
        filtered.append((m, P))
    out = [filtered[-1]]
    for m, P in filtered[-2::-1]:
        G = P @ np.linalg.inv(P + Q)
        out.append((m + G @ (out[-1][0] - m), P + G @ (out[-1][1] - P - Q) @ G.T))
    return filtered, out[::-1]


def from_afar():
    """Four cameras half a kilometre away, over whose sight lines a place of a few metres is a linear function."""
    middle, far = np.array([20.0, 50.0]), 500.0
    cameras = [
        camera(f"c{k}", middle - far * np.array([np.cos(a), np.sin(a)]), np.degrees(a), **SHARP)
        for k, a in enumerate(np.radians([10.0, 60.0, 130.0, 200.0]))
    ]
    return Scene(cameras=tuple(cameras), room=ROOM)


@pytest.mark.parametrize(
    ("dt", "proposal"), [(0.4, "bootstrap"), pytest.param(2.5, "adapted", marks=pytest.mark.statistics)]
)
def test_the_smoothed_posterior_is_that_of_the_exact_smoother(dt, proposal):
    sigma, start, steps, runs, read = 1.2, 3.0, 9, 6, SHARP["sigma_read_px"]
    scene = from_afar()
    config = ApfConfig(
        particles=2000,
        start=(20.0, 50.0, start),
        process_noise_position=sigma,
        smooth=True,
        smoothing_trajectories=1000,
        proposal=proposal,
        false_alarm_probability=0.0,
        **DIFFUSING,
    )
    rng = np.random.default_rng(3)
    path = np.array([20.0, 50.0]) + np.cumsum(sigma * np.sqrt(dt) * rng.standard_normal((steps, 2)), axis=0)
    noise = read * rng.standard_normal((steps, 4))
    scans = [everywhere(scene, xy, k * dt, noise[k]) for k, xy in enumerate(path)]
    # Linear measurements: derivatives at the true place
    eps = 1e-4
    H = np.array([
        np.column_stack([
            (np.array(true_u(scene, xy + eps * e)) - np.array(true_u(scene, xy - eps * e))) / (2 * eps)
            for e in np.eye(2)
        ])
        for xy in path
    ])  # fmt: skip
    z = [H[k] @ path[k] + noise[k] for k in range(steps)]
    filtered, exact = rauch_tung_striebel(
        np.array([20.0, 50.0]), start**2 * np.eye(2), sigma**2 * dt * np.eye(2), H, read**2 * np.eye(4), z
    )
    found = [smoothed(traces_of(scene, scans, config, seed)[0], config, seed) for seed in range(runs)]
    means = np.array([[past.xy for past in run] for run in found])  # (runs, steps, 2)
    spreads = np.array([[past.covariance for past in run] for run in found])
    for k, (mean, P) in enumerate(exact):
        deviation = np.sqrt(np.diag(P))
        # Trajectories of a run share particles: the error is that which the runs show, at least a share of sigma
        error = 5 * np.maximum(means[:, k].std(axis=0, ddof=1), 0.05 * deviation) / np.sqrt(runs)
        np.testing.assert_allclose(means[:, k].mean(axis=0), mean, atol=(error + 0.02 * deviation).max())
        np.testing.assert_allclose(spreads[:, k].mean(axis=0), P, atol=0.15 * np.trace(P) / 2)
    # The future says something here, and the last state has none
    assert np.trace(exact[4][1]) < 0.95 * np.trace(filtered[4][1])


def walking(steps=12, seed=0, **options):
    """Scans of a walker in the room of 100, and settings that keep traces."""
    scene, rng = room100(pillar=False), np.random.default_rng(seed)
    path = np.column_stack([30.0 + np.arange(steps), np.full(steps, 40.0)])
    scans = []
    for k, xy in enumerate(path):
        u = np.array(true_u(scene, xy)) + rng.normal(0, 3, 8)
        scans.append(scan(float(k), [(i, v if abs(v) < 69 else None) for i, v in enumerate(u)]))
    return scene, scans, ApfConfig(particles=300, initial_particle_factor=3, smooth=True, **options)


def test_there_is_a_state_for_each_scan_and_the_last_is_the_filters():
    scene, scans, config = walking(smoothing_trajectories=2000)
    traces, estimates = traces_of(scene, scans, config)
    found = smoothed(traces, config)
    assert len(found) == len(scans)
    deviation = np.sqrt(np.diag(estimates[-1].covariance))
    np.testing.assert_allclose(found[-1].xy, estimates[-1].xy, atol=0.05 * deviation.max())
    np.testing.assert_allclose(found[-1].velocity, estimates[-1].velocity, atol=0.05)
    np.testing.assert_allclose(found[-1].covariance, estimates[-1].covariance, atol=0.2 * deviation.max() ** 2)


def test_the_same_seed_gives_the_same_states():
    scene, scans, config = walking()
    traces, _ = traces_of(scene, scans, config)
    a, b, other = smoothed(traces, config, 1), smoothed(traces, config, 1), smoothed(traces, config, 2)
    for one, two in zip(a, b, strict=True):
        np.testing.assert_array_equal(one.xy, two.xy)
        np.testing.assert_array_equal(one.covariance, two.covariance)
    assert not np.array_equal(a[0].xy, other[0].xy)


def moved(trace, by):
    return tuple(one._replace(states=one.states + np.array([by, by, 0.0, 0.0, 0.0])) for one in trace)


def test_what_came_before_particles_that_were_drawn_again_does_not_know_of_them():
    scene, scans, config = walking()
    traces, _ = traces_of(scene, scans, config)
    cut = [*traces[:6], tuple(one._replace(parents=None, dt=0.0) for one in traces[6]), *traces[7:]]
    # Wherever the later particles are, the earlier states are the same
    far = [*cut[:6], *(moved(trace, 1000.0) for trace in cut[6:])]
    for one, two in zip(smoothed(cut, config)[:6], smoothed(far, config)[:6], strict=True):
        np.testing.assert_array_equal(one.xy, two.xy)
    # and the last of them is the filter's
    alone = smoothed(cut[:6], config)[-1].xy
    assert np.hypot(*(smoothed(cut, config)[5].xy - alone)) < 0.5


def test_a_restart_leaves_a_link_to_nothing():
    scene, scans, config = walking(track_loss_count=3)
    # The target jumps across the room: the filter is lost and begins again
    there = [
        scan(12.0 + k, [(i, u) for i, u in enumerate(true_u(scene, (80.0, 85.0))) if abs(u) < 69]) for k in range(5)
    ]
    traces, estimates = traces_of(scene, scans + there, config)
    restarts = [k for k, estimate in enumerate(estimates) if estimate.fallback == "restart"]
    assert restarts
    assert [k for k, trace in enumerate(traces) if trace[-1].dt == 0.0] == [0, *restarts]
    found = smoothed(traces, config)
    assert np.hypot(*(found[11].xy - [41.0, 40.0])) < 3.0
    assert np.hypot(*(found[-1].xy - [80.0, 85.0])) < 3.0


def test_a_long_step_leaves_links_of_its_parts_and_one_state():
    scene, scans, config = walking(4)
    late = [*scans, scan(6.5, [(i, u) for i, u in enumerate(true_u(scene, (36.5, 40.0))) if abs(u) < 69])]
    traces, _ = traces_of(scene, late, config)
    assert [len(trace) for trace in traces] == [1, 1, 1, 1, 4]
    np.testing.assert_allclose([one.dt for one in traces[-1]], 3.5 / 4)
    found = smoothed(traces, config)
    assert len(found) == 5
    assert all(np.isfinite(past.covariance).all() for past in found)


@pytest.mark.parametrize("noises", [{}, {"process_noise_velocity": 0.5, "process_noise_waiting": 0.05}])
def test_two_scans_at_one_time_do_not_cut_the_record(noises):
    scene, scans, config = walking(6, **noises)
    twice = [*scans[:4], scans[3], *scans[4:]]
    traces, estimates = traces_of(scene, twice, config)
    assert [estimate.fallback for estimate in estimates] == [""] * 7
    found = smoothed(traces, config)
    np.testing.assert_allclose(found[3].xy, found[4].xy, atol=1e-9)
    # The future of both is known at either
    assert np.trace(found[3].covariance) < np.trace(estimates[3].covariance)


def test_without_smoothing_nothing_is_kept_for_the_way_back():
    scene, scans, config = walking(3)
    traces, _ = traces_of(scene, scans, ApfConfig(particles=300, initial_particle_factor=3))
    assert traces == [()] * 3
    assert all(traces_of(scene, scans, config)[0])


def test_smoothing_leaves_the_filter_as_it_is_and_a_lag_over_the_record_is_smoothing():
    made = record("walk", seed=3)
    bearings = made.bearings.take(made.bearings.t_ns < made.bearings.t_ns[0] + 8 * 10**9)
    tracked = {
        name: Tracks.concat(
            part.tracks
            for part in track([bearings], made.scene, TrackingTask(replace(ApfConfig.in_unit("m"), **options), 4))
        )
        for name, options in {"smooth": {"smooth": True}, "lag": {"lag_s": 1000.0}, "again": {"smooth": True}}.items()
    }
    for name in ("x", "y", "vx", "vy", "cov_xx", "cov_xy", "cov_yy"):
        for other in ("lag", "again"):
            np.testing.assert_array_equal(getattr(tracked["smooth"], name), getattr(tracked[other], name))


@pytest.mark.statistics
@pytest.mark.parametrize("motion", ["walk", "zig-zag", "still"])
def test_smoothed_estimates_are_better_than_filtered_ones_and_their_covariances_hold(motion):
    made = record(motion, seed=1)
    filtered, late, whole = (
        follow(made, "apf", options, skip_s=2.0) for options in ({}, {"lag_s": 2.0}, {"smooth": True})
    )
    assert whole.rmse < 0.9 * filtered.rmse
    assert late.rmse < 0.95 * filtered.rmse
    for found in (late, whole):
        assert 0.5 < found.nees.mean() < 3.0
        assert np.mean(found.nees > ELLIPSE) < 0.1
