"""One step of the fast filter against the plain NumPy form with the same random numbers."""

from __future__ import annotations

import apf_reference as ref
import numpy as np
import pytest
from apf_scenes import L, Recorder, readings, reference_scene, state_with
from tracker_scenes import room100, scan

from occlog.filtering.motion.waypoint import CHANGE
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig


@pytest.mark.parametrize("pillar", [True, False])
@pytest.mark.parametrize("dt", [1.0, 0.3, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_a_step_is_that_of_the_plain_form(seed, dt, pillar):
    scene = room100(pillar)
    options = {"defensive_fraction": 0.1 * (seed % 2), "out_of_view_likelihood": 0.02, "false_alarm_probability": 1e-3}
    config = ApfConfig(
        particles=L, velocity_memory=0.3, resampling_threshold=1.0, track_loss_count=0, proposal="bootstrap", **options
    )
    state, u = state_with(scene, config, seed), readings(scene, seed)
    rows = [(i, None if np.isnan(u[i]) else u[i]) for i in range(8)]
    rng = Recorder(seed + 100)
    after, estimate = apf.step(state, scan(dt, rows), rng)
    draws = ref.Draws(
        rng.single[0],
        rng.uniform[0],
        rng.normal[0][:, :2],
        after.particles.destination[after.particles.regime == CHANGE],
    )
    p = state.particles
    expected, log_sum = ref.step(
        ref.RefParticles(p.xy, p.destination, p.speed, p.regime, state.weights),
        -u,
        np.full(8, 2.0),
        reference_scene(scene),
        ref.RefConfig(velocity_memory=0.3, **options),
        dt,
        draws,
    )
    assert draws.used > 0 or dt < 0.1
    np.testing.assert_array_equal(after.particles.regime, expected.regime)
    np.testing.assert_allclose(after.particles.xy, expected.xy, rtol=1e-12)
    np.testing.assert_allclose(after.particles.speed, expected.speed, rtol=1e-12)
    np.testing.assert_allclose(after.weights, expected.weights, rtol=1e-9, atol=1e-15)
    assert estimate.log_likelihood == pytest.approx(log_sum, rel=1e-9)
    np.testing.assert_allclose(estimate.xy, expected.weights @ expected.xy, rtol=1e-9)
    assert estimate.fallback == ""
    assert estimate.n_observing == 8
    assert estimate.n_detected == np.sum(~np.isnan(u))


@pytest.mark.jit
@pytest.mark.parametrize("seed", range(1))
def test_the_log_likelihood_does_not_depend_on_the_proposal(seed):
    """Importance sampling with any share of defensive weights estimates the same number."""
    scene = room100()
    rows = [(i, None if np.isnan(v) else v) for i, v in enumerate(readings(scene, 0))]
    values = []
    for defensive in (0.0, 0.5, 1.0):
        config = ApfConfig(particles=L, defensive_fraction=defensive, track_loss_count=0)
        state = state_with(scene, config, seed)
        runs = [apf.step(state, scan(1.0, rows), np.random.default_rng(r))[1].log_likelihood for r in range(60)]
        mean = np.mean(np.exp(np.array(runs) - runs[0]))
        error = np.std(np.exp(np.array(runs) - runs[0])) / np.sqrt(60)
        values.append((np.log(mean) + runs[0], error / mean))
    for value, error in values[1:]:
        assert abs(value - values[0][0]) < 4 * np.hypot(error, values[0][1])  # 4 standard errors


def test_a_step_does_not_change_the_state_it_starts_from():
    scene = room100()
    state = state_with(scene, ApfConfig(particles=L), 1)
    before = [np.copy(a) for a in (*state.particles, state.weights)]
    apf.step(state, scan(2.7, [(0, 1.0), (2, None)]), np.random.default_rng(0))
    for old, new in zip(before, (*state.particles, state.weights), strict=True):
        np.testing.assert_array_equal(old, new)


def test_a_scan_from_the_past_is_refused():
    state = state_with(room100(), ApfConfig(particles=L), 1)
    with pytest.raises(ValueError, match="earlier than the last"):
        apf.step(state, scan(-0.1, [(0, 1.0)]), np.random.default_rng(0))
