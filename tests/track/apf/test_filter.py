"""The auxiliary particle filter over several scans: exact posteriors, known answers, fallbacks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tracker_scenes import PILLAR, camera, observe, room100, scan, true_u, walk, with_array

from occlog.core.plane import on_floor
from occlog.errors import InputError
from occlog.records.scene import Occluder, Scene
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.apf import filter as apf
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.model import likelihood, pack_scan


def run(scene, scans, config, seed=0):
    rng = np.random.default_rng(seed)
    state, out = apf.init(scene, config, rng), []
    for given in scans:
        state, estimate = apf.step(state, given, rng)
        out.append(estimate)
    return state, out


def seen_from_everywhere(scene, xy, t_s, noise=None):
    u = true_u(scene, xy)
    noise = np.zeros(len(u)) if noise is None else noise
    return scan(t_s, [(i, u[i] + noise[i] if abs(u[i]) < 69 else None) for i in range(len(u))])


@pytest.mark.jit
@pytest.mark.parametrize("proposal", ["adapted", "bootstrap"])
def test_the_posterior_is_that_of_a_grid_filter(proposal):
    """A target that only diffuses (always MTD at speed 0) has a posterior that can be computed on a grid."""
    scene = room100(cameras=4)
    steps, sigma = 5, 1.5
    config = ApfConfig(
        particles=20_000,
        start=(20.0, 50.0, 3.0),
        initial_particle_factor=2,
        initial_speed=0.0,
        sigma_initial_speed=0.0,
        velocity_memory=0.0,
        process_noise_position=sigma,
        beta1=1.0,
        lambda1=0.0,
        beta2=1.0,
        lambda2=0.0,
        track_loss_count=0,
        defensive_fraction=0.1,
        proposal=proposal,
    )
    rng = np.random.default_rng(1)
    path = np.array([20.0, 50.0]) + np.cumsum(sigma * rng.standard_normal((steps, 2)), axis=0)
    scans = [seen_from_everywhere(scene, xy, t, rng.normal(0, 2.5, 4)) for t, xy in enumerate(path)]
    estimates = [run(scene, scans, config, seed)[1] for seed in range(4)]

    # The grid: prior, likelihood by the kernel (tested elsewhere), motion by convolution
    axis = np.arange(0.5, 60, 0.25)
    x, y = np.meshgrid(axis, axis + 20, indexing="ij")
    positions = np.column_stack([x.ravel(), y.ravel()])
    model = apf.init(scene, config, rng).model
    density = np.exp(-0.5 * ((x - 20) ** 2 + (y - 50) ** 2) / 3.0**2)
    reach = np.arange(-40, 41) * 0.25
    kernel = np.exp(-0.5 * (reach / sigma) ** 2)
    log_evidence = []
    for t, given in enumerate(scans):
        if t:
            density = np.apply_along_axis(np.convolve, 0, density, kernel, mode="same")
            density = np.apply_along_axis(np.convolve, 1, density, kernel, mode="same")
        density /= density.sum()
        loglik = likelihood(model, positions, pack_scan(given, model.read_px, True)).reshape(x.shape)
        density = density * np.exp(loglik)
        log_evidence.append(math.log(density.sum()))
        density /= density.sum()
        mean = np.array([np.sum(density * x), np.sum(density * y)])
        var = np.array([np.sum(density * (x - mean[0]) ** 2), np.sum(density * (y - mean[1]) ** 2)])
        found = np.array([run_[t].xy for run_ in estimates])
        # 80000 particles in all, an effective share of at least a quarter, correlated over time: 5 standard errors
        np.testing.assert_allclose(found.mean(axis=0), mean, atol=5 * np.sqrt(var.max() / 20_000))
        spread = np.mean([np.diag(run_[t].covariance) for run_ in estimates], axis=0)
        np.testing.assert_allclose(spread, var, rtol=0.06)
        found_evidence = np.mean([run_[t].log_likelihood for run_ in estimates])
        assert found_evidence == pytest.approx(log_evidence[t], abs=0.03)


@pytest.mark.jit
def test_sight_lines_without_noise_meet_at_the_estimate():
    scene = room100(sigma_position=0.0, sigma_yaw=0.0, sigma_read_px=0.2)
    truth = np.array([23.0, 71.0])
    scans = [seen_from_everywhere(scene, truth, 0.1 * t) for t in range(30)]
    config = ApfConfig(particles=1500, process_noise_position=0.1, initial_speed=0.1, sigma_initial_speed=0.1)
    _, estimates = run(scene, scans, config)
    assert np.hypot(*(estimates[-1].xy - truth)) < 0.1
    assert np.sqrt(np.trace(estimates[-1].covariance)) < 0.3
    assert np.hypot(*estimates[-1].velocity) < 0.5


@pytest.mark.jit
def test_a_walker_is_followed_with_a_consistent_covariance():
    scene = room100(pillar=False)
    rng = np.random.default_rng(0)
    path = walk(150, rng)
    rows = track([observe(scene, path, rng)], scene, TrackingTask(ApfConfig(particles=1000), 0))
    tracks = next(rows).tracks
    error = np.column_stack([tracks.x, tracks.y])[20:] - path[20:]
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 1.2
    cov = np.stack([tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy], axis=1).reshape(-1, 2, 2)[20:]
    nees = np.einsum("ti,ti->t", error, np.linalg.solve(cov, error[..., None])[..., 0])
    assert 1.2 < nees.mean() < 3.2  # 2 if consistent; correlated over time
    moved = np.gradient(path, axis=0)[20:]
    velocity = np.column_stack([tracks.vx, tracks.vy])[20:]
    assert np.median(np.hypot(*(velocity - moved).T)) < 0.7


@pytest.mark.jit
def test_a_target_that_no_one_sees_is_where_no_one_can_see_it():
    """With a detection model, silence is evidence."""
    scene = room100(cameras=1)  # sees all of the room but what is behind the pillar
    config = ApfConfig(particles=3000, detection_probability=0.95, track_loss_count=0)
    state, _ = run(scene, [scan(0.1 * t, [(0, None)]) for t in range(4)], config)
    xy = state.particles.xy
    azimuth = np.arctan2(xy[:, 1], xy[:, 0])
    shadow = (np.abs(azimuth - np.pi / 4) < np.arctan(1.5) - np.pi / 4 + 0.02) & (xy.sum(axis=1) > 99)
    assert state.weights[shadow].sum() > 0.99


@pytest.mark.jit
def test_particles_stay_on_the_floor():
    scene = room100()
    state, _ = run(scene, [scan(t, [(i, None) for i in range(8)]) for t in range(10)], ApfConfig(particles=2000))
    alive = state.weights > 0
    assert on_floor(state.particles.xy[alive], *state.model.floor).all()


@pytest.mark.jit
def test_a_particle_behind_the_pillar_cannot_be_what_a_camera_sees():
    """[Ercan] Fig. 4: without softening, a seen target is not behind the pillar."""
    scene = room100(cameras=1)
    config = ApfConfig(particles=3000, false_alarm_probability=0.0, out_of_view_likelihood=0.0, track_loss_count=0)
    state, estimates = run(scene, [scan(0, [(0, 0.0)]), scan(1, [(0, 0.0)])], config)
    xy = state.particles.xy[state.weights > 0]
    assert len(xy) > 100
    assert (xy.sum(axis=1) < 100.0).all()  # in front of the pillar as seen from (0, 0)
    assert estimates[1].fallback == ""


def test_stage_one_is_skipped_when_no_expected_position_can_be():
    """All particles head at full speed into a wall: kappa is outside the room, but not all of them get there."""
    scene = room100(pillar=False)
    config = ApfConfig(
        particles=500,
        start=(99.0, 50.0, 0.1),
        initial_speed=0.0,
        sigma_initial_speed=0.0,
        velocity_memory=0.0,
        process_noise_position=1.0,
        beta1=1.0,
        lambda1=0.0,
        beta2=1.0,
        lambda2=0.0,
        proposal="bootstrap",
        track_loss_count=0,
    )
    rng = np.random.default_rng(0)
    state = apf.init(scene, config, rng)
    state, _ = apf.step(state, scan(0, [(0, None)]), rng)
    p = state.particles
    outwards = p._replace(destination=np.tile([200.0, 50.0], (500, 1)), speed=np.full(500, 2.0))
    after, estimate = apf.step(state._replace(particles=outwards), scan(1, [(0, None)]), rng)
    assert estimate.fallback == "sir"
    assert math.isfinite(estimate.log_likelihood)
    assert after.weights[after.particles.xy[:, 0] > 100].sum() == 0.0


def test_particles_are_drawn_again_when_none_can_be():
    """Literal zeros, as in the paper: a camera sees the target where no particle is."""
    scene = room100()
    config = ApfConfig(
        particles=500,
        start=(75.0, 75.0, 0.5),
        false_alarm_probability=0.0,
        out_of_view_likelihood=0.0,
        track_loss_count=0,
    )
    u = true_u(scene, (30.0, 20.0))
    seen = [(0, u[0]), (2, u[2])]
    scans = [scan(0, [(0, None)]), scan(1, seen), scan(2, seen)]
    _, estimates = run(scene, scans, config)
    assert [e.fallback for e in estimates] == ["", "restart", ""]
    assert np.hypot(*(estimates[-1].xy - [30.0, 20.0])) < 2.0
    assert np.isfinite(estimates[1].log_likelihood)


def test_a_scan_that_nothing_can_explain_is_reported_by_nan():
    scene = room100(cameras=2, sigma_position=0.1, sigma_yaw=0.001, sigma_read_px=0.5)
    config = ApfConfig(particles=300, false_alarm_probability=0.0, out_of_view_likelihood=0.0, track_loss_count=0)
    # Cameras at (0, 0) and (50, 0) whose sight lines part
    _, estimates = run(scene, [scan(0, [(0, 0.0)]), scan(1, [(0, -60.0), (1, 60.0)])], config)
    assert estimates[1].fallback == "restart"
    assert math.isnan(estimates[1].log_likelihood)
    assert np.all(np.isfinite(estimates[1].xy))


@pytest.mark.jit
def test_a_filter_that_most_sensors_contradict_is_restarted_after_a_while():
    scene = room100(pillar=False)
    elsewhere = np.array([80.0, 20.0])
    scans = [seen_from_everywhere(scene, elsewhere, t) for t in range(5)]
    config = ApfConfig(particles=1000, start=(20.0, 80.0, 1.0), track_loss_count=6)
    _, estimates = run(scene, scans, config)
    assert [e.fallback for e in estimates] == ["", "", "restart", "", ""]
    assert np.hypot(*(estimates[2].xy - elsewhere)) < 2.0
    assert {e.fallback for e in run(scene, scans, ApfConfig(start=(20.0, 80.0, 1.0), track_loss_count=0))[1]} == {""}


@pytest.mark.jit
def test_one_false_bearing_among_many_neither_restarts_nor_misleads():
    scene = room100(pillar=False)
    truth = np.array([30.0, 60.0])
    config = ApfConfig(particles=1000)
    scans = [seen_from_everywhere(scene, truth, t) for t in range(10)]
    wrong = scans[9].u_px.copy()
    first_seen = int(np.flatnonzero(scans[9].seen)[0])
    wrong[first_seen] = -wrong[first_seen] + 25.0
    scans[9] = scans[9]._replace(u_px=wrong)
    _, estimates = run(scene, scans, config)
    assert all(e.fallback == "" for e in estimates)
    assert np.hypot(*(estimates[9].xy - truth)) < 1.5


@pytest.mark.jit
def test_a_gap_is_predicted_through_up_to_the_limit_and_no_further():
    scene = room100(pillar=False)
    config = ApfConfig(particles=2000, max_gap_s=20.0)
    before = [seen_from_everywhere(scene, (30.0 + 0.5 * t, 50.0), t) for t in range(20)]
    _, long = run(scene, [*before, scan(19 + 20.0, [(0, None)])], config)
    _, longer = run(scene, [*before, scan(19 + 20.1, [(0, None)])], config)
    assert long[-1].fallback == ""
    assert longer[-1].fallback == "gap"
    spread = [np.sqrt(np.trace(e.covariance)) for e in (long[-2], long[-1], longer[-1])]
    assert 3 * spread[0] < spread[1] < spread[2]
    assert spread[2] == pytest.approx(100 * np.sqrt(2 / 12), rel=0.1)  # anywhere in the room


@pytest.mark.jit
@pytest.mark.parametrize("rate", [1.0, 15.0])
def test_tracking_does_not_depend_on_the_frame_rate(rate):
    """The same information a second, in more and worse frames."""
    scene = room100(pillar=False, sigma_position=0.0, sigma_yaw=0.0, sigma_read_px=2.0 * np.sqrt(rate))
    rng = np.random.default_rng(3)
    seconds = 20
    path = np.column_stack([20 + np.arange(0, seconds, 1 / rate), np.full(int(seconds * rate), 40.0)])
    bearings = observe(scene, path, rng, step_s=1 / rate)
    tracks = next(iter(track([bearings], scene, TrackingTask(ApfConfig(particles=500), 0)))).tracks
    late = tracks.t_ns >= 8e9
    error = np.hypot(tracks.x - path[:, 0], tracks.y - path[:, 1])[late]
    assert np.sqrt(np.mean(error**2)) < 1.0
    assert np.median(tracks.vx[late]) == pytest.approx(1.0, abs=0.35)


@pytest.mark.jit
def test_cameras_that_take_turns_are_as_good_as_cameras_at_once():
    scene = room100(pillar=False)
    rng = np.random.default_rng(4)
    path = np.column_stack([20 + 0.5 * np.arange(40), np.full(40, 40.0)])
    rows = []
    for k in range(40):
        at = int(k % 8)
        u = true_u(scene, path[k])[at]
        rows.append(scan(k * 0.5, [(at, u + rng.normal(0, 2.0) if abs(u) < 69 else None)]))
    _, estimates = run(scene, rows, ApfConfig(particles=2000))
    error = np.array([e.xy for e in estimates]) - path
    assert np.sqrt(np.mean(np.sum(error[16:] ** 2, axis=1))) < 3.0


@pytest.mark.jit
def test_microphones_and_cameras_work_together():
    scene = with_array(room100(pillar=False, cameras=1), (100.0, 0.0), sigma=0.03)
    truth = np.array([40.0, 45.0])
    azimuth = np.arctan2(truth[1], truth[0] - 100.0)
    both = []
    for t, stray in enumerate(np.random.default_rng(1).uniform(1.6, 3.1, 8)):
        given = scan(t, [(0, true_u(scene, truth)[0]), (1, np.nan), (1, np.nan)])
        both.append(
            given._replace(
                target_id=np.array([0, -1, -1], dtype=np.int32),
                bearing=np.array([0.0, azimuth, stray]),
                sigma=np.array([1.0, 0.03, 0.03]),
            )
        )
    _, estimates = run(scene, both, ApfConfig(particles=3000, clutter_rate=2.0))
    assert np.hypot(*(estimates[-1].xy - truth)) < 3.0
    assert estimates[-1].n_observing == 2
    assert estimates[-1].n_detected == 2


@pytest.mark.jit
def test_one_of_several_people_is_followed_among_unlabelled_candidates():
    scene = room100(pillar=False)
    rng = np.random.default_rng(5)
    steps = 80
    mine = np.column_stack([20 + 0.7 * np.arange(steps), 30 + 0.2 * np.arange(steps)])
    other = np.column_stack([80 - 0.7 * np.arange(steps), 70 - 0.3 * np.arange(steps)])
    scans = []
    for t in range(steps):
        rows = []
        for i in range(8):
            found = [u for u in (true_u(scene, mine[t])[i], true_u(scene, other[t])[i]) if abs(u) < 69]
            found = [u + rng.normal(0, 2.0) for u in found if rng.random() < 0.85]
            if rng.random() < 0.2:
                found.append(rng.uniform(-70, 70))
            rows += [(i, u, np.nan, 0.8) for u in found] or [(i, None)]
        scans.append(scan(t, rows, labelled=False))
    for start, path in (((20.0, 30.0, 2.0), mine), ((80.0, 70.0, 2.0), other)):
        _, estimates = run(scene, scans, ApfConfig(particles=700, start=start, clutter_rate=1.0))
        error = np.hypot(*(np.array([e.xy for e in estimates]) - path).T)
        assert error.max() < 6.0
        assert np.sqrt(np.mean(error**2)) < 2.0
        assert all(e.n_observing == 8 for e in estimates)
        assert 3 < np.mean([e.n_detected for e in estimates]) < 8


def test_a_scene_without_floor_is_refused():
    scene = room100()
    walled = Scene(scene.cameras, (), (Occluder("all", 10 * PILLAR - 450.0),), room=scene.room)
    with pytest.raises(InputError, match="static occluders fill the room"):
        apf.init(walled, ApfConfig(particles=10), np.random.default_rng(0))


def test_a_camera_with_a_wide_view_sees_ahead_only():
    scene = Scene((camera("wide", (50, 50), 0, fov=2 * np.pi),), room=room100().room)
    state, _ = run(
        scene, [scan(0, [(0, 0.0)])], ApfConfig(particles=500, out_of_view_likelihood=0.0, false_alarm_probability=0.0)
    )
    assert (state.particles.xy[:, 0] > 50).all()
