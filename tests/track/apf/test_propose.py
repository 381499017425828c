"""One step with a point at the scan: against the plain form, and against the step that does not look."""

from __future__ import annotations

import apf_reference as ref
import numpy as np
import pytest
from apf_scenes import L, readings, reference_scene, state_with
from tracker_scenes import room100, scan

from occlog.core.plane import sample_floor
from occlog.filtering.motion import waypoint
from occlog.filtering.particles import effective_sample_size, mean_and_covariance
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.model import pack_scan
from occlog.track.methods.apf.proposal import auxiliary_step

PEOPLE = {"process_noise_velocity": 0.5, "process_noise_waiting": 0.1, "velocity_memory": 0.0}
STAND = {**PEOPLE, "mean_wait_s": 4.0, "process_noise_creep": 0.3}
TURN = {"change_time": "uniform"}


def rows_of(scene, seed=0):
    return [(i, None if np.isnan(v) else v) for i, v in enumerate(readings(scene, seed))]


def likelihoods(state, observations, dt, runs=60):
    """Mean of the likelihood over runs of a step, over that of the first, its standard error, and the first's log."""
    logs = [
        auxiliary_step(
            state.model, state.particles, state.weights, observations, dt, np.random.default_rng(seed)
        ).log_likelihood
        for seed in range(runs)
    ]
    relative = np.exp(np.array(logs) - logs[0])
    return relative.mean(), relative.std() / np.sqrt(runs), logs[0]


@pytest.mark.parametrize("noises", [{}, PEOPLE, STAND, TURN, {**STAND, **TURN}])
@pytest.mark.parametrize(
    ("seed", "seen", "dt"), [(0, True, 1.0), (1, True, 0.3), (2, True, 0.3), (3, True, 1.0), (0, False, 0.3)]
)
def test_a_step_is_that_of_the_plain_form(seed, seen, dt, noises):
    scene = room100(pillar=bool(seed % 2))
    options = {
        "defensive_fraction": 0.1 * (seed % 2),
        "out_of_view_likelihood": 0.02,
        "false_alarm_probability": 1e-3,
        "velocity_memory": 0.3,
        **noises,
    }
    config = ApfConfig(particles=L, track_loss_count=0, **options)
    state, u = state_with(scene, config, seed), readings(scene, seed)
    u = u if seen else np.full_like(u, np.nan)
    packed = pack_scan(scan(dt, [(i, None if np.isnan(v) else v) for i, v in enumerate(u)]), state.model.read_px, True)
    rng = np.random.default_rng(seed + 100)
    draw = auxiliary_step(state.model, state.particles, state.weights, packed, dt, rng)
    # The same numbers again, in the order in which the step draws them
    rng = np.random.default_rng(seed + 100)
    draws = ref.ScanDraws(
        sample_floor(L, state.model.floor, rng),
        rng.random(L) if config.change_time == "uniform" else np.zeros(L),
        rng.random(),
        rng.random(L),
        rng.standard_normal((L, 2)),
        rng.standard_normal((L, 2)),
    )
    p = state.particles
    expected, log_sum = ref.scan_step(
        ref.RefParticles(p.xy, p.destination, p.speed, p.regime, state.weights),
        -u,
        np.full(8, 2.0),
        reference_scene(scene),
        ref.RefConfig(**options),
        dt,
        draws,
    )
    # Where rounding decides whether a value is believed a particle may differ
    same = np.abs(draw.particles.xy - expected.xy).max(axis=1) < 1e-6
    assert same.mean() > 0.98
    np.testing.assert_array_equal(draw.particles.regime[same], expected.regime[same])
    np.testing.assert_allclose(draw.particles.speed[same], expected.speed[same], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(draw.particles.destination[same], expected.destination[same], rtol=1e-4, atol=1e-4)
    weights, wanted = (w[same] / w[same].sum() for w in (draw.weights, expected.weights))
    np.testing.assert_allclose(weights, wanted, rtol=1e-3, atol=1e-9)
    assert draw.log_likelihood == pytest.approx(log_sum, abs=0.02)
    assert draw.fallback == ""


@pytest.mark.jit
@pytest.mark.parametrize(
    ("dt", "focal", "noises"),
    [(1.0, 70.0, {}), (0.3, 300.0, {}), (0.3, 300.0, PEOPLE), (0.3, 70.0, {**PEOPLE, **TURN})],
)
def test_the_log_likelihood_is_that_of_the_motion_alone(dt, focal, noises):
    """Importance sampling estimates the likelihood without bias, whatever the density."""
    scene = room100(focal=focal)
    rows = rows_of(room100())
    rows = [(i, None if u is None else u * focal / 70.0) for i, u in rows]
    found = []
    for proposal, many in (("adapted", L), ("bootstrap", 30 * L)):
        config = ApfConfig(particles=many, proposal=proposal, track_loss_count=0, **noises)
        state = state_with(scene, config, 1)
        found.append(likelihoods(state, pack_scan(scan(dt, rows), state.model.read_px, True), dt))
    (a, da, la), (b, db, lb) = found
    assert abs(np.log(a) + la - np.log(b) - lb) < 4 * np.hypot(da / a, db / b)  # 4 standard errors


@pytest.mark.jit
@pytest.mark.parametrize("noises", [{}, PEOPLE])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.statistics)])
def test_the_moments_are_those_of_many_particles_that_do_not_look(seed, noises):
    scene, dt = room100(focal=200.0), 0.5
    rows = [(i, None if u is None else u * 200.0 / 70.0) for i, u in rows_of(room100(), 2 * seed)]
    state = state_with(scene, ApfConfig(particles=L, track_loss_count=0, **noises), seed)
    packed = pack_scan(scan(dt, rows), state.model.read_px, True)
    blind = state.model._replace(
        config=ApfConfig(particles=200_000, proposal="bootstrap", defensive_fraction=1.0, track_loss_count=0, **noises)
    )
    wide = auxiliary_step(blind, state.particles, state.weights, packed, dt, np.random.default_rng(9))
    mean, covariance = mean_and_covariance(wide.weights, wide.particles.xy)
    velocity = wide.weights @ waypoint.velocities(wide.particles)
    runs = []
    for run in range(80):
        draw = auxiliary_step(
            state.model, state.particles, state.weights, packed, dt, np.random.default_rng([seed, run])
        )
        # A mean over runs is one of importance sampling if each counts by its likelihood
        runs.append((np.exp(draw.log_likelihood - wide.log_likelihood), draw))
    share = np.array([weight for weight, _ in runs])
    share /= share.sum()
    xy = np.array([draw.weights @ draw.particles.xy for _, draw in runs])
    square = np.array([draw.weights @ (draw.particles.xy - mean) ** 2 for _, draw in runs])
    moved = np.array([draw.weights @ waypoint.velocities(draw.particles) for _, draw in runs])
    few = effective_sample_size(wide.weights)
    spread = np.sqrt(np.diag(covariance))
    error = 5 * (spread / np.sqrt(few) + xy.std(axis=0) / np.sqrt(80))
    np.testing.assert_allclose(share @ xy, mean, atol=error.max())
    limit = 5 * (np.sqrt(2 / few) + (square.std(axis=0) / spread**2).max() / np.sqrt(80))
    np.testing.assert_allclose(share @ square, spread**2, rtol=limit)
    deviation = np.sqrt(np.trace(np.cov(waypoint.velocities(wide.particles).T, aweights=wide.weights)))
    error = 5 * (deviation / np.sqrt(few) + moved.std(axis=0).max() / np.sqrt(80))
    np.testing.assert_allclose(share @ moved, velocity, atol=error)


def test_where_no_one_sees_the_target_every_motion_keeps_particles():
    """A fifth of 1000 goes to three motions alike, so that the next scan can choose one that is rare."""
    config = ApfConfig(particles=1000, track_loss_count=0, **STAND)
    state = state_with(room100(), config, 0)
    blind = pack_scan(scan(0.2, [(i, None) for i in range(8)]), state.model.read_px, True)
    draw = auxiliary_step(state.model, state.particles, state.weights, blind, 0.2, np.random.default_rng(0))
    counts = np.bincount(draw.particles.regime, minlength=3)
    assert counts.min() >= 60
    assert effective_sample_size(draw.weights) > 850


@pytest.mark.jit
@pytest.mark.parametrize(("focal", "factor"), [(300.0, 3.0), (1000.0, 8.0)])
def test_sharp_bearings_leave_more_particles_than_without_a_look(focal, factor):
    scene = room100(focal=focal, sigma_position=0.0, sigma_yaw=0.0)
    rows = [(i, None if u is None else u * focal / 70.0) for i, u in rows_of(room100())]
    sizes = {}
    for proposal in ("adapted", "bootstrap"):
        state = state_with(scene, ApfConfig(particles=1000, proposal=proposal, track_loss_count=0), 0, spread=1.0)
        packed = pack_scan(scan(0.5, rows), state.model.read_px, True)
        draw = auxiliary_step(state.model, state.particles, state.weights, packed, 0.5, np.random.default_rng(0))
        sizes[proposal] = effective_sample_size(draw.weights)
    assert sizes["adapted"] > 800
    assert sizes["adapted"] > factor * sizes["bootstrap"]


def test_parents_are_those_that_the_particles_came_from():
    """Who goes on keeps the destination of its parent."""
    scene = room100()
    state = state_with(scene, ApfConfig(particles=L, track_loss_count=0), 3)
    packed = pack_scan(scan(0.5, rows_of(scene)), state.model.read_px, True)
    draw = auxiliary_step(state.model, state.particles, state.weights, packed, 0.5, np.random.default_rng(0))
    kept = draw.particles.regime != waypoint.CHANGE
    assert kept.any()
    np.testing.assert_array_equal(draw.particles.destination[kept], state.particles.destination[draw.parents][kept])
