"""One step of the fast filter among people with priors against the plain NumPy form with the same random numbers."""

from __future__ import annotations

import apf_reference as ref
import numpy as np
import occlusion_reference as occlusion
import pytest
from apf_scenes import L, Recorder, readings, reference_scene, state_with
from tracker_scenes import room100, scan

from occlog.core.occlusion.priors import gaussian_priors
from occlog.filtering.motion.waypoint import CHANGE
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf import proposal as propose
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.model import OCCLUDER_SUPPORT_SIGMAS


def people(seed, isotropic):
    rng = np.random.default_rng(seed + 50)
    mean = rng.uniform(0, 100, (40, 2))
    if isotropic:
        return mean, np.full((40, 1, 1), rng.uniform(3, 8) ** 2) * np.eye(2)
    axis = rng.standard_normal((40, 2, 1))
    return mean, 9.0 * np.eye(2) + 20.0 * axis @ axis.transpose(0, 2, 1)


@pytest.mark.jit
@pytest.mark.parametrize("likelihood", ["independent", "recursion"])
@pytest.mark.parametrize("isotropic", [True, False])
@pytest.mark.parametrize("spread", [1.0, 8.0])
@pytest.mark.parametrize("seed", range(1))
def test_a_step_is_that_of_the_plain_form(seed, spread, isotropic, likelihood, monkeypatch):
    monkeypatch.setattr(
        propose, "OCCLUDER_SUPPORT_SIGMAS_STAGE1", OCCLUDER_SUPPORT_SIGMAS
    )  # stage 1 as near as stage 2, so that parents are the same
    scene = room100()
    options = {"defensive_fraction": 0.1, "out_of_view_likelihood": 0.02, "false_alarm_probability": 1e-3}
    config = ApfConfig(
        particles=L,
        velocity_memory=0.3,
        resampling_threshold=1.0,
        track_loss_count=0,
        proposal="bootstrap",
        own_prior_gate=0.0,
        likelihood=likelihood,
        occlusion_tempering=1.0,
        **options,
    )
    state, u = state_with(scene, config, seed, spread), readings(scene, seed)
    rows = [(i, None if np.isnan(u[i]) else u[i]) for i in range(8)]
    mean, covariance = people(seed, isotropic)
    rng = Recorder(seed + 100)
    given = scan(1.0, rows)._replace(occluders=gaussian_priors(mean, covariance, 3.33))
    after, estimate = apf.step(state, given, rng)
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
        ref.RefConfig(velocity_memory=0.3, miss=0.0, **options),
        1.0,
        draws,
        occlusion.RefPriors(mean, covariance, 3.33, recursion=likelihood == "recursion"),
    )
    np.testing.assert_allclose(after.particles.xy, expected.xy, rtol=1e-12)
    np.testing.assert_allclose(after.weights, expected.weights, rtol=0, atol=2e-6 * expected.weights.max())
    assert estimate.log_likelihood == pytest.approx(log_sum, abs=1e-5)
    assert estimate.fallback == ""
    # The people matter: without them the weights are others.
    without, _ = apf.step(state, given._replace(occluders=None), Recorder(seed + 100))
    assert np.abs(without.weights - after.weights).max() > 1e-3 * after.weights.max()
