"""Method `map`: known answers, blocks, and what is hard to see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from map_scenes import FOCAL, joined, place, record, scans_of
from numpy.testing import assert_allclose

from occlog.errors import InputError
from occlog.track.interface import SmoothedTrajectory
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.windows import StatePrior
from occlog.track.methods.map.method import advance, begin

pytestmark = pytest.mark.jit

STEADY = MapConfig(process_noise_velocity=1e-3)  # as good as constant velocity
TWO_APART = ((-4, -3, 90), (4, -3, 90))  # side by side, looking the same way: the views meet only behind the room


def solve(scene, config, made) -> SmoothedTrajectory:
    return advance(begin(scene, config), scans_of(made), last=True)[1]


def line(t, start, velocity):
    return np.asarray(start) + np.asarray(t)[:, None] * np.asarray(velocity)


def crossing():
    """Across the views of two cameras that do not overlap."""
    t = np.arange(0.0, 16.0, 0.25)
    return t, line(t, (-7.0, 1.0), (0.9, 0.05))


def check_sane(out: SmoothedTrajectory, T: int) -> None:
    """Finite numbers, covariances with positive eigenvalues, a row for each state."""
    assert len(out.t_ns) == len(out.fallback) == len(out.used) == T
    for values in (out.xy, out.velocity, out.covariance):
        assert np.isfinite(values).all()
    assert_allclose(out.covariance, out.covariance.swapaxes(1, 2), rtol=1e-12)
    assert (np.linalg.eigvalsh(out.covariance) > 0).all()
    used = (out.n_detected > 0) & (np.array(out.fallback) != "infeasible_constraints")
    assert np.array_equal(np.isfinite(out.log_likelihood), used)


def test_unknown_speed_with_two_cameras_that_do_not_overlap() -> None:
    """[Rahimi] Fig. 1b: the time between the views gives the speed, the speed the distance."""
    scene = place(*TWO_APART)
    t, xy = crossing()
    made = record(scene, t, xy)
    count = np.bincount(made.rows.sensor[made.rows.seen])
    assert (count > 8).all()
    assert np.bincount(made.state[made.rows.seen]).max() == 1  # never seen by both
    out = solve(scene, STEADY, made)
    assert out.converged
    assert set(out.fallback) == {""}
    assert_allclose(out.xy, xy, rtol=0, atol=0.02)
    assert_allclose(out.velocity, np.tile([0.9, 0.05], (len(t), 1)), rtol=0, atol=0.005)
    check_sane(out, len(t))


def test_known_velocity_with_one_camera() -> None:
    """[Rahimi] Fig. 1a: without it the distance is not known, with it the track is."""
    scene = place((0, -3, 90))
    t = np.arange(0.0, 4.0, 0.25)
    xy = line(t, (-1.7, 1.0), (0.9, 0.0))
    made = record(scene, t, xy)
    assert made.rows.seen.sum() > 10
    pending = begin(scene, STEADY)
    known = StatePrior(np.array([0.0, 0.9, 0.0, 0.0]), np.diag([800.0, 1e-8, 800.0, 1e-8]))
    out = advance(pending._replace(before=known), scans_of(made), last=True)[1]
    assert set(out.fallback) == {""}
    assert_allclose(out.xy, xy, rtol=0, atol=0.02)
    vague = solve(scene, STEADY, made)
    assert set(vague.fallback) == {"unobservable"}
    sigma = np.sqrt(np.linalg.eigvalsh(vague.covariance[:, :2, :2])[:, 1])
    assert (sigma > 1.0).all()
    check_sane(vague, len(t))


def test_two_overlapping_cameras_meet_at_the_target() -> None:
    scene = place((-5, -5, 45), (5, -5, 135))
    t = np.array([0.0, 0.3, 0.31, 1.7, 2.0])
    xy = line(t, (0.2, -0.5), (0.3, 0.6))
    out = solve(scene, MapConfig(), record(scene, t, xy))
    assert_allclose(out.xy, xy, rtol=0, atol=0.005)
    assert out.n_detected.tolist() == out.n_observing.tolist() == [2] * 5
    assert out.used == ((0, 1),) * 5


def test_directions_of_arrays() -> None:
    scene = place(arrays=((-5, -5, 30), (5, -5, 200), (0, 8, -90)))
    t = np.arange(0.0, 12.0, 0.5)
    xy = line(t, (-3.0, 2.0), (0.5, -0.2))
    out = solve(scene, STEADY, record(scene, t, xy))
    assert_allclose(out.xy, xy, rtol=0, atol=0.01)
    mixed = place(*TWO_APART, arrays=((0, 8, 10),))
    t, xy = crossing()
    out = solve(mixed, STEADY, record(mixed, t, xy))
    assert_allclose(out.xy, xy, rtol=0, atol=0.02)
    assert set(out.fallback) == {""}


def test_covariance_is_that_of_the_errors() -> None:
    """Walks drawn from the model itself: squared errors in units of the covariance are chi-square with 4 degrees."""
    scene = place((-5, -5, 45), (5, -5, 135), half=40.0)
    config = MapConfig(process_noise_velocity=0.1, sigma_initial_velocity=0.3, wall_constraints=False)
    rng = np.random.default_rng(1)
    t, dt, n, total = np.arange(0.0, 8.0, 0.4), 0.4, 40, np.zeros(3)
    L = np.linalg.cholesky(0.01 * np.kron(np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), np.eye(2)))
    F = np.kron([[1.0, dt], [0.0, 1.0]], np.eye(2))
    for _ in range(n):
        X = np.empty((len(t), 4))
        X[0] = np.concatenate([rng.uniform(-0.5, 0.5, 2), 0.3 * rng.standard_normal(2)])
        for i in range(1, len(t)):
            X[i] = F @ X[i - 1] + L @ rng.standard_normal(4)
        out = solve(scene, config, record(scene, t, X[:, :2], noise=rng))
        e = np.hstack([out.xy, out.velocity]) - X
        total += [e[i] @ np.linalg.solve(out.covariance[i], e[i]) for i in (0, 10, len(t) - 1)]
    # Four standard errors of the mean of n chi-squares
    assert_allclose(total / n, 4.0, rtol=0, atol=4.0 * np.sqrt(8.0 / n))


def blocks(scene, config, made, size):
    pending, parts = begin(scene, config), []
    scans, T = scans_of(made), len(made.t_ns)
    for first in range(0, T, size):
        pending, out = advance(pending, scans[first : first + size], last=first + size >= T)
        parts.append(out)
    return parts


@pytest.mark.parametrize("size", [7, 40])
def test_fixed_lag_gives_every_row_once_in_order_and_nearly_the_whole(size: int) -> None:
    scene = place((-5, -5, 45), (5, -5, 135), half=20.0)
    t = np.arange(0.0, 30.0, 0.5)
    xy = np.column_stack([np.sin(t / 3.0), np.cos(t / 4.0)])
    made = record(scene, t, xy, noise=np.random.default_rng(0))
    config = replace(MapConfig(), lag_s=5.0)
    whole = solve(scene, MapConfig(), made)
    parts = blocks(scene, config, made, size)
    out = joined(parts)
    assert np.array_equal(out.t_ns, made.t_ns)
    assert out.n_detected.tolist() == whole.n_detected.tolist()
    assert out.used == whole.used
    seen = 0
    for k, p in enumerate(parts[:-1]):
        seen += len(p.t_ns)
        latest = t[min((k + 1) * size, len(t)) - 1]
        # All that has five seconds after it and none else; the last state always waits
        assert seen == min(int((t <= latest - 5.0).sum()), (k + 1) * size - 1)
    sigma = np.sqrt(np.linalg.eigvalsh(whole.covariance[:, :2, :2])[:, 1])
    assert (np.hypot(*(out.xy - whole.xy).T) < 0.05 * sigma).all()
    check_sane(out, len(t))


def test_a_lag_longer_than_the_record_is_the_whole() -> None:
    scene = place(*TWO_APART)
    t, xy = crossing()
    made = record(scene, t, xy, noise=np.random.default_rng(3))
    config = MapConfig(process_noise_velocity=0.05)
    whole = solve(scene, config, made)
    parts = blocks(scene, replace(config, lag_s=100.0), made, 16)
    assert [len(p.t_ns) for p in parts] == [0, 0, 0, 64]
    assert_allclose(joined(parts).xy, whole.xy, rtol=0, atol=1e-4)
    assert_allclose(joined(parts).covariance, whole.covariance, rtol=1e-2, atol=1e-6)


@pytest.mark.parametrize("window", [16, 50])
def test_long_records_started_in_windows_are_the_same(window: int) -> None:
    scene = place(*TWO_APART, (0, 8, -90))
    t = np.arange(0.0, 60.0, 0.25)
    xy = np.column_stack([6.0 * np.sin(t / 7.0), 1.0 + np.sin(t / 5.0)])
    made = record(scene, t, xy, noise=np.random.default_rng(4))
    whole = solve(scene, MapConfig(window_states=1000), made)
    windows = solve(scene, MapConfig(window_states=window), made)
    assert whole.converged
    assert windows.converged
    assert_allclose(windows.xy, whole.xy, rtol=0, atol=1e-3)


def test_motion_along_the_bearing_is_flagged() -> None:
    scene = place((0, -8, 90))
    t = np.arange(0.0, 10.0, 0.5)
    out = solve(scene, MapConfig(), record(scene, t, line(t, (0.0, -5.0), (0.0, 0.8))))
    assert set(out.fallback) == {"unobservable"}
    assert np.abs(out.xy[:, 0]).max() < 0.05  # across the bearing all is known
    sigma = np.sqrt(out.covariance[:, [0, 1], [0, 1]])
    assert (sigma[:, 0] < 0.1).all()
    assert (sigma[:, 1] > 1.0).all()
    check_sane(out, len(t))


def test_no_row_that_saw_the_target() -> None:
    scene = place(*TWO_APART)
    t = np.arange(0.0, 3.0, 0.5)
    out = solve(scene, MapConfig(), record(scene, t, np.tile([0.0, -9.0], (6, 1))))
    assert out.n_detected.tolist() == [0] * 6
    assert out.n_observing.tolist() == [2] * 6
    assert set(out.fallback) == {"unobservable"}
    assert_allclose(out.xy, 0.0, atol=1e-3)  # the centre of the room
    assert np.isnan(out.log_likelihood).all()
    check_sane(out, 6)


@pytest.mark.parametrize("initial", ["axes", "linear"])
def test_one_observation(initial: str) -> None:
    scene = place(*TWO_APART)
    config = MapConfig(initialisation=initial)
    out = solve(scene, config, record(scene, [2.0], [(-4.5, 1.0)]))
    check_sane(out, 1)
    assert out.fallback == ("unobservable",)
    along = np.array([-0.5, 4.0]) / np.hypot(0.5, 4.0)
    away = out.xy[0] - [-4.0, -3.0]
    assert away @ along > 0.01
    assert abs(away @ [along[1], -along[0]]) < 0.05  # on the sight line
    amid = solve(scene, config, record(scene, [0.0, 1.0, 2.0], [(0.0, -9.0), (-4.5, 1.0), (0.0, -9.0)]))
    check_sane(amid, 3)
    assert amid.n_detected.tolist() == [0, 1, 0]
    assert np.isfinite(amid.log_likelihood[1])


@pytest.mark.parametrize("initial", ["axes", "linear"])
def test_all_on_one_bearing(initial: str) -> None:
    scene = place((0, -8, 90))
    t = np.arange(0.0, 100.0, 1.0)
    out = solve(scene, MapConfig(initialisation=initial), record(scene, t, np.tile([0.4, -4.0], (100, 1))))
    check_sane(out, 100)
    assert set(out.fallback) <= {"unobservable"}
    assert out.converged
    assert_allclose(out.xy[:, 0] / (out.xy[:, 1] + 8.0), 0.1, atol=2e-3)


def test_a_target_that_walks_over_a_camera() -> None:
    scene = place((0, 0, 90), (-6, 0, 0), (0, -6, 90))
    t = np.arange(0.0, 12.0, 0.5)
    xy = line(t, (-0.002, -3.0), (0.0, 0.5))  # over the first camera, at 6 s
    out = solve(scene, MapConfig(), record(scene, t, xy))
    check_sane(out, len(t))
    assert_allclose(out.xy, xy, rtol=0, atol=0.2)
    on = solve(place((0, 0, 90)), MapConfig(), record(place((0, 0, 90)), t[:5], np.tile([0.0, 1e-9], (5, 1))))
    check_sane(on, 5)


def test_cameras_back_to_back_that_both_see_it_contradict_each_other() -> None:
    scene = place((0, 1, 90), (0, -1, -90), (-6, 0, 0))
    t = np.arange(0.0, 5.0, 0.5)
    xy = line(t, (-1.0, 0.0), (0.3, 0.0))
    made = record(scene, t, xy)
    lying, rows = (made.state == 4) & (made.rows.sensor < 2), made.rows
    rows.seen[lying], rows.u_px[lying], rows.sigma[lying], rows.sigma_px[lying] = True, 0.0, 0.001, 0.5
    rows.bearing[lying] = np.radians([90.0, -90.0])
    out = solve(scene, MapConfig(loss="square"), made)
    check_sane(out, len(t))
    assert out.fallback[4] == "infeasible_constraints"
    assert "infeasible_constraints" not in out.fallback[:4] + out.fallback[5:]
    robust = solve(scene, MapConfig(), made)
    assert "infeasible_constraints" not in robust.fallback
    at_4 = robust.fit.row == 4
    assert (robust.fit.inlier_probability[at_4] >= 0.5).sum() < at_4.sum()  # one of the two is not believed


def wild(seed: int):
    """Few cameras in random directions, a tenth of whose bearings are of something else."""
    rng = np.random.default_rng(seed)
    poses = [(*rng.uniform(-8, 8, 2), rng.uniform(-180, 180)) for _ in range(rng.integers(1, 6))]
    ears = [(*rng.uniform(-8, 8, 2), rng.uniform(-180, 180)) for _ in range(rng.integers(0, 3))]
    scene = place(*poses, half=8.0, arrays=ears, sigma_position=float(rng.choice([0.0, 0.05])), range=6.0)
    T = int(rng.integers(20, 100))
    t = np.cumsum(rng.choice([0.02, 0.1, 0.5, 2.0], T))
    dt = np.diff(t, prepend=t[0])[:, None]
    velocity = 0.4 * rng.normal(size=2) + np.cumsum(0.2 * np.sqrt(dt) * rng.normal(size=(T, 2)), axis=0)
    xy = rng.uniform(-5, 5, 2) + np.cumsum(velocity * dt, axis=0)
    xy = 7.9 - np.abs((xy + 7.9) % 31.6 - 15.8)  # reflected by the walls
    made = record(scene, t, xy, noise=rng)
    wrong = made.rows.seen & (rng.uniform(size=len(made.state)) < 0.1)
    u, bearing = made.rows.u_px, made.rows.bearing
    pixel = wrong & np.isfinite(u)
    u[pixel] = rng.uniform(-280, 280, pixel.sum())
    yaw = np.array([c.yaw for c in scene.cameras] + [0.0] * len(ears))[made.rows.sensor[pixel]]
    bearing[pixel] = (yaw - np.arctan(u[pixel] / FOCAL) + np.pi) % (2 * np.pi) - np.pi
    bearing[wrong & ~pixel] = rng.uniform(-np.pi, np.pi, (wrong & ~pixel).sum())
    config = MapConfig(
        loss=str(rng.choice(["square", "huber", "cauchy"])),
        initialisation=str(rng.choice(["axes", "linear"])),
        process_noise_velocity=0.2,
        window_states=int(rng.choice([16, 512])),
        lag_s=float(rng.choice([1.0, 10.0])),
    )
    return scene, made, config


@pytest.mark.statistics
def test_wild_measurements_give_finite_numbers_and_nearly_always_a_minimum() -> None:
    n, converged, contradictions = 30, 0, 0
    for seed in range(n):
        scene, made, config = wild(seed)
        parts = [solve(scene, replace(config, lag_s=None), made)] if seed % 2 else blocks(scene, config, made, 13)
        out = joined(parts)
        assert np.array_equal(out.t_ns, made.t_ns)
        check_sane(out, len(made.t_ns))
        converged += all(p.converged for p in parts)
        assert not any(p.converged and "not_converged" in p.fallback for p in parts)
        contradictions += "infeasible_constraints" in out.fallback
    assert converged >= 28
    assert contradictions >= 1


@pytest.mark.parametrize("at", [(500_000.0, 4_600_000.0), (-3e6, 7.0)])
def test_a_scene_far_from_the_origin_gives_the_same_track(at) -> None:
    t, xy = crossing()
    near = place(*TWO_APART)
    far = place(*TWO_APART, at=at)
    config = MapConfig(process_noise_velocity=0.05)
    made = record(near, t, xy, noise=np.random.default_rng(5))
    a, b = solve(near, config, made), solve(far, config, made)
    assert_allclose(b.xy - at, a.xy, rtol=0, atol=1e-6)
    assert_allclose(b.covariance, a.covariance, rtol=1e-5, atol=1e-9)
    assert b.fallback == a.fallback


def test_states_stay_in_the_room_and_within_range() -> None:
    scene = place((0, -3, 90), half=4.0, range=5.0)
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 20.0, 0.5)
    xy = np.column_stack([1.0 * np.sin(t), 1.9 + 0.0 * t])
    out = solve(scene, MapConfig(), record(scene, t, xy, noise=rng))
    assert (np.abs(out.xy) < 4.0).all()
    seen = out.n_detected > 0
    assert (out.xy[seen, 1] + 3.0 < 5.0).all()
    assert (out.xy[seen, 1] + 3.0 > 0.01).all()


def test_times_are_added_where_there_is_none() -> None:
    scene = place((-5, -5, 45), (5, -5, 135))
    t = np.array([0.0, 0.5, 4.5, 5.0])
    xy = line(t, (-1.0, 0.0), (0.4, 0.1))
    made = record(scene, t, xy)
    plain = solve(scene, STEADY, made)
    filled = solve(scene, replace(STEADY, max_state_gap_s=1.0), made)
    assert_allclose(filled.t_ns / 1e9, [0.0, 0.5, 1.5, 2.5, 3.5, 4.5, 5.0])
    assert_allclose(filled.xy, line(filled.t_ns / 1e9, (-1.0, 0.0), (0.4, 0.1)), rtol=0, atol=0.01)
    there = np.isin(filled.t_ns, plain.t_ns)
    assert_allclose(filled.xy[there], plain.xy, rtol=0, atol=1e-5)  # states in between change nothing
    assert_allclose(filled.covariance[there], plain.covariance, rtol=1e-4, atol=1e-9)
    assert filled.used[2:5] == ((), (), ())


def test_the_given_start_is_used_and_a_motion_that_does_not_fit_is_refused() -> None:
    scene = place(*TWO_APART)
    t = np.arange(0.0, 3.0, 0.5)
    nothing = record(scene, t, np.tile([0.0, -9.0], (6, 1)))
    out = solve(scene, MapConfig(start=(2.0, -1.0, 0.1)), nothing)
    assert_allclose(out.xy[0], [2.0, -1.0], atol=1e-3)
    assert_allclose(out.covariance[0, [0, 1], [0, 1]], 0.01, rtol=1e-6)
    singular = MapConfig(A=tuple(np.eye(4).ravel()), Sigma=(0.0,) * 16, model_step_s=0.5)
    with pytest.raises(InputError, match="the motion model does not fit"):
        solve(scene, singular, nothing)
    flipped = MapConfig(
        A=tuple(np.diag([1.0, -1.0, 1.0, 1.0]).ravel()), Sigma=tuple(np.eye(4).ravel()), model_step_s=1.0
    )
    with pytest.raises(InputError, match="no real logarithm"):
        solve(scene, flipped, nothing)
