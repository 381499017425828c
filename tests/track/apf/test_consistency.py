"""Stated covariances of `apf` hold among sharp cameras, and nearly exact bearings do not lose the target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tracker_scenes import observe, room100, walk

from benchmarks.track._metric_rooms import MOTIONS, record
from benchmarks.track.false_bearings import ELLIPSE, follow
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.tables import Diagnostics, Tracks, Truth
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf.config import ApfConfig

pytestmark = [pytest.mark.jit]
SKIP_S = 2.0


def tracked(bearings, scene, config, seed=0):
    parts = list(track([bearings], scene, TrackingTask(config, seed)))
    return Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("motion", "focal_px", "sigma_px"), [*((motion, 1000.0, 0.5) for motion in MOTIONS), ("stop-and-go", 70.0, 5.0)]
)
def test_normalised_errors_are_those_of_a_consistent_estimate(motion, focal_px, sigma_px):
    """A target that stands is known better than a filter that expects it to walk can say."""
    found = follow(record(motion, focal_px=focal_px, sigma_px=sigma_px, seed=0), "apf", {}, skip_s=SKIP_S)
    assert 0.5 < found.nees.mean() < 3.0
    assert np.mean(found.nees > ELLIPSE) < 0.1
    assert found.given == pytest.approx(1.0, abs=0.06)


@pytest.mark.statistics
@pytest.mark.parametrize("motion", ["walk"])
def test_the_motion_alone_is_inconsistent_where_the_scan_is_not(motion):
    """What [Ercan]'s importance density does among sharp cameras: few particles, taken for certainty."""
    made = record(motion, focal_px=1000.0, sigma_px=0.5, seed=1)
    blind = follow(
        made, "apf", {"proposal": "bootstrap", "process_noise_waiting": 0.0, "mean_wait_s": 0.0}, skip_s=SKIP_S
    )
    looking = follow(made, "apf", {}, skip_s=SKIP_S)
    assert not blind.nees.mean() < 5.0  # NaN where a covariance is singular
    assert looking.nees.mean() < 3.0


def exact(sigma_px, seed, steps):
    """A walk in the room of 100, seen by cameras that are nearly exact."""
    scene = room100(pillar=False, sigma_position=0.0, sigma_yaw=0.0, sigma_read_px=sigma_px)
    rng = np.random.default_rng(seed)
    path = walk(steps, rng)
    return scene, path, observe(scene, path, rng)


@pytest.mark.parametrize(
    ("sigma_px", "seed"),
    [(1e-6, 0), *(pytest.param(*case, marks=pytest.mark.statistics) for case in ((1e-3, 1), (1e-1, 0)))],
)
def test_nearly_exact_bearings_keep_the_target(sigma_px, seed):
    scene, path, bearings = exact(sigma_px, seed, 40)
    tracks, diagnostics = tracked(bearings, scene, ApfConfig(), seed)
    t = bearings.t_ns[:: len(scene.cameras)]
    nothing = np.zeros(len(path))
    truth = Truth.of(
        t_ns=np.unique(t),
        target_id=nothing.astype(np.int32),
        role=np.full(len(path), "target"),
        x=path[:, 0],
        y=path[:, 1],
        z=nothing,
    )
    result = evaluate(tracks, truth, bearings, scene, EvaluateConfig(process_noise_position=0.33))
    late = result.errors.t_ns > truth.t_ns[1]
    rmse = np.sqrt(np.mean(result.errors.error[late] ** 2))
    bound = np.sqrt(np.mean(result.bound.bound[np.isin(result.bound.t_ns, result.errors.t_ns[late])] ** 2))
    assert rmse < 2.0 * bound
    assert "restart" not in diagnostics.fallback.tolist()


def test_rows_with_few_effective_particles_are_depleted_and_say_so():
    """20 particles that do not point at sharp bearings."""
    made = record("zig-zag", seed=2)
    config = replace(
        ApfConfig.in_unit("m"), particles=20, proposal="bootstrap", initial_particle_factor=50, track_loss_count=0
    )
    tracks, diagnostics = tracked(made.bearings, made.scene, config)
    few = diagnostics.ess < 10.0
    assert few.any()
    assert (diagnostics.fallback[few] != "").all()
    assert "depleted" in diagnostics.fallback.tolist()
    assert not (diagnostics.fallback[~few] == "depleted").any()
    # The others' covariances are not degenerate, but for that of the start
    determinant = tracks.cov_xx * tracks.cov_yy - tracks.cov_xy**2
    assert (determinant[1:][~few[1:]] > 0).all()
