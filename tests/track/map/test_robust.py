"""False bearings: the trajectory, its covariance, and which bearings are believed."""

from __future__ import annotations

import numpy as np
import pytest
from map_scenes import joined, place, record, scans_of

from occlog.track.interface import SmoothedTrajectory
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.method import advance, begin
from occlog.track.methods.map.record import TargetRecord

pytestmark = pytest.mark.jit

CORNERS = ((-5, -4, 45), (5, -4, 135), (5, 4, 225), (-5, 4, -45))
ROOM = {"half": 6.0, "fov": np.radians(100.0), "sigma_read_px": 3.0}


def walk(seconds: float = 30.0, rate: float = 5.0):
    """Turns of a person at 1.2 m/s."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    return t, np.column_stack([3.0 * np.sin(0.4 * t), 2.0 * np.cos(0.3 * t)])


def spoil(made: TargetRecord, scene, share: float, rng) -> np.ndarray:
    """Replace bearings by ones uniform in the image; (N,) which of those seen are false, beyond the noise."""
    rows = made.rows
    false = rows.seen & (rng.random(len(rows.seen)) < share)
    for n in np.flatnonzero(false):
        camera = scene.cameras[rows.sensor[n]]
        f = camera.focal_px[0]
        u = f * np.tan(0.5 * camera.fov) * rng.uniform(-1.0, 1.0)
        false[n] = abs(u - rows.u_px[n]) > 6.0 * camera.sigma_read_px
        rows.u_px[n], rows.bearing[n] = u, camera.yaw - np.arctan(u / f)
    return false[rows.seen]


def observed(cameras: int, share: float, seed: int, **options):
    scene = place(*CORNERS[:cameras], **(ROOM | options))
    rng = np.random.default_rng(seed)
    t, xy = walk()
    blind = set(zip(*np.nonzero(rng.random((len(t), cameras)) < 0.3), strict=True))
    made = record(scene, t, xy, noise=rng, blind=blind)
    return scene, made, spoil(made, scene, share, rng), xy


def solve(scene, made: TargetRecord, **settings) -> SmoothedTrajectory:
    return advance(begin(scene, MapConfig(**settings), False), scans_of(made), True)[1]


def errors(out: SmoothedTrajectory, xy):
    away = out.xy - xy
    nees = np.einsum("ti,tij,tj->t", away, np.linalg.inv(out.covariance[:, :2, :2]), away)
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1)))), nees


@pytest.mark.parametrize(("cameras", "share"), [(4, 0.05), (4, 0.2), (3, 0.1), (2, 0.1)])
def test_false_bearings_are_found_and_cost_little(cameras: int, share: float) -> None:
    for seed in (0, 1):
        scene, clean, _, xy = observed(cameras, 0.0, seed)
        best, _ = errors(solve(scene, clean, loss="square"), xy)
        scene, made, false, _ = observed(cameras, share, seed)
        out = solve(scene, made)
        rmse, nees = errors(out, xy)
        assert rmse < 1.7 * best
        assert 0.5 < nees.mean() < 5.0
        assert np.mean(nees > 5.991) < 0.15
        doubted = out.fit.inlier_probability < 0.5
        assert (doubted & false).sum() >= 0.9 * false.sum()
        assert (doubted & false).sum() >= 0.9 * doubted.sum()
        # The paper's cost believes them all, and is lost.
        assert errors(solve(scene, made, loss="square"), xy)[0] > 2.0 * rmse


def test_without_false_bearings_the_estimate_is_next_to_that_of_squares() -> None:
    scene, made, _, xy = observed(4, 0.0, 3)
    square, mixture = solve(scene, made, loss="square"), solve(scene, made)
    assert np.abs(square.xy - mixture.xy).max() < 0.3 * np.sqrt(square.covariance[:, 0, 0]).max()
    assert np.mean(mixture.fit.inlier_probability > 0.5) > 0.995
    assert errors(mixture, xy)[1].mean() == pytest.approx(errors(square, xy)[1].mean(), rel=0.3)


def test_squares_from_consensus_have_the_minimum_of_the_papers_start() -> None:
    scene, made, _, _ = observed(4, 0.0, 4)
    axes = solve(scene, made, loss="square", initialisation="axes")
    np.testing.assert_allclose(solve(scene, made, loss="square", initialisation="consensus").xy, axes.xy, atol=1e-5)
    np.testing.assert_array_equal(solve(scene, made, loss="square").xy, axes.xy)


@pytest.mark.parametrize("lag", [4.0, 10.0])
def test_false_bearings_are_found_with_a_lag(lag: float) -> None:
    scene, made, false, xy = observed(4, 0.1, 5)
    config, scans = MapConfig(lag_s=lag), scans_of(made)
    pending, parts = begin(scene, config, False), []
    for k in range(0, len(scans), 10):
        pending, part = advance(pending, scans[k : k + 10], k + 10 >= len(scans))
        parts.append(part)
    out = joined(parts)
    assert errors(out, xy)[0] < 0.1
    believed = np.concatenate([p.fit.inlier_probability for p in parts])
    assert len(believed) == len(false)
    assert ((believed < 0.5) == false).mean() > 0.99


def test_a_false_bearing_from_a_camera_that_looks_away_demands_nothing() -> None:
    """The last camera has its back to the target: with its bearings believed there is no place for the target."""
    scene = place((-5, -4, 45), (5, -4, 135), (5, 4, 225), (0, 5, 90), **ROOM)
    t, xy = walk()
    made = record(scene, t, xy)
    rows = made.rows
    liar = np.flatnonzero((rows.sensor == 3) & np.isin(made.state, (20, 60, 61)))
    for column, value in (("seen", True), ("u_px", 5.0), ("sigma_px", 3.0), ("sigma", 0.006), ("bearing", 1.56)):
        getattr(rows, column)[liar] = value
    out = solve(scene, made)
    assert errors(out, xy)[0] < 0.05
    assert set(out.fallback) == {""}
    of_liar = out.fit.sensor == 3
    assert (out.fit.inlier_probability[of_liar] == 0.0).all()
    assert (out.fit.inlier_probability[~of_liar] > 0.5).all()
    assert (np.abs(out.fit.residual[of_liar]) > 100.0).all()  # an angle, where there is no reading


def test_motion_that_is_livelier_than_stated_does_not_make_true_bearings_false() -> None:
    scene = place(*CORNERS, **ROOM)
    rng = np.random.default_rng(0)
    legs = np.cumsum(np.repeat(rng.choice([-1.0, 1.0], (40, 2)), 5, axis=0) * 0.35, axis=0)
    xy = np.abs((legs + 3.0) % 12.0 - 6.0) - 3.0  # zig-zag at 2.5 m/s between walls
    t = np.arange(len(xy)) / 5.0
    made = record(scene, t, xy, noise=rng)
    out = solve(scene, made)
    assert out.noise.motion > 4.0
    assert np.mean(out.fit.inlier_probability > 0.5) > 0.98
    rmse, nees = errors(out, xy)
    stated = solve(scene, made, loss="square")
    assert rmse < errors(stated, xy)[0]
    assert nees.mean() < 4.0 < errors(stated, xy)[1].mean()


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_bearings_that_are_not_as_noisy_as_stated_give_honest_covariances(factor: float) -> None:
    nees = []
    for seed in range(3):
        scene, made, _, xy = observed(4, 0.0, seed)
        made.rows.sigma_px[:] /= factor
        made.rows.sigma[:] /= factor
        out = solve(scene, made)
        assert out.noise.bearings == pytest.approx(factor**2, rel=0.35)
        nees.append(errors(out, xy)[1].mean())
    assert 0.7 < np.mean(nees) < 3.0


def test_rows_most_of_whose_bearings_are_not_believed_are_flagged() -> None:
    scene, made, _, _ = observed(4, 0.0, 6)
    made.rows.u_px[made.state == 50] += 300.0
    out = solve(scene, made)
    assert out.fallback[50] == "doubted"
    assert set(out.fallback) == {"", "doubted"}


def test_one_camera_at_a_time_still_leads_to_the_minimum_of_the_papers_start() -> None:
    """Where no sight lines cross, the paper's start is tried, too."""
    scene = place((-4, -3, 90), (4, -3, 90), half=10.0)
    t = np.arange(0.0, 16.0, 0.25)
    xy = np.array([-7.0, 1.0]) + t[:, None] * np.array([0.9, 0.05])
    made = record(scene, t, xy)
    out = solve(scene, made, process_noise_velocity=1e-3)
    np.testing.assert_allclose(out.xy, xy, atol=0.03)
    assert (out.fit.inlier_probability > 0.5).all()


@pytest.mark.parametrize("lively", [False, True])
def test_cameras_that_look_in_turn_agree_over_neighbouring_times(lively: bool) -> None:
    scene, t = place(*CORNERS, **ROOM), np.arange(0.0, 30.0, 0.1)
    rate = 2.5 if lively else 1.0
    xy = np.column_stack([3.0 * np.sin(0.4 * rate * t), 2.0 * np.cos(0.3 * rate * t)])
    rng = np.random.default_rng(7)
    blind = {(k, s) for k in range(len(t)) for s in range(4) if s != k % 4}
    made = record(scene, t, xy, noise=rng, blind=blind)
    false = spoil(made, scene, 0.1, rng)
    out = solve(scene, made)
    rmse, nees = errors(out, xy)
    assert rmse < 0.15
    assert nees.mean() < 4.0
    assert ((out.fit.inlier_probability < 0.5) & false).sum() >= 0.9 * false.sum()
