"""Places in space from centres in images: against a brute-force search, Monte Carlo, wrong views, degenerate rays."""

import numpy as np
import pytest
from epipolar_rigs import looking
from place_scenes import covariances, rig_of, room, room_rig, seen
from scipy.optimize import minimize

from occlog.track.methods.images.ground.triangulation import (
    BEHIND,
    DISAGREEING,
    MET,
    NEAR_PARALLEL,
    TOO_FEW,
    CentresInViews,
    TargetHeightPrior,
    triangulate_in_space,
)

HEIGHT = TargetHeightPrior(0.9, 0.1)


def nees(met, points):
    good = met.status == MET
    e = (met.xyz - points)[good]
    return np.einsum("ni,nij,nj->n", e, np.linalg.inv(met.covariance[good]), e)


@pytest.mark.parametrize("views", [1, 2, 3, 5])
def test_places_are_those_of_a_search(views):
    """The minimum of the same cost, written out with the cameras' own projection."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        cameras, points = room_rig(rng, views), room(rng, 1) * [1, 1, 0.5]
        sights = seen(rng, cameras, points, covariances(rng, 1, views))
        met = triangulate_in_space(sights, rig_of(cameras), HEIGHT, gate=1e-9)

        def cost(x, sights=sights, cameras=cameras):
            total = ((x[2] - HEIGHT.mean) / HEIGHT.sigma) ** 2 if len(cameras) == 1 else 0.0
            for k, camera in enumerate(cameras):
                r = sights.pixels[0, k] - camera.project(x[None])[0]
                total += r @ np.linalg.solve(sights.covariance[0, k], r)
            return total

        start = met.xyz[0] + rng.normal(0, 0.05, 3)
        best = minimize(cost, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxfev": 4000})
        assert met.xyz[0] == pytest.approx(best.x, abs=1e-5)
        assert met.misfit[0] == pytest.approx(best.fun, abs=1e-7)


@pytest.mark.parametrize("views", [1, 2, 3])
def test_covariances_are_those_of_many_draws(views):
    """One point, 4000 draws of the noise: variances have a standard error of 2.2 %, the limit is 12 %."""
    rng = np.random.default_rng(10 + views)
    cameras, n = room_rig(rng, views), 4000
    points = np.tile(room(rng, 1), (n, 1))
    if views == 1:
        points[:, 2] = rng.normal(HEIGHT.mean, HEIGHT.sigma, n)
        points[:, :2] = 0.5
    cov = np.tile(covariances(rng, 1, views), (n, 1, 1, 1))
    met = triangulate_in_space(seen(rng, cameras, points, cov), rig_of(cameras), HEIGHT, gate=1e-9)
    e = met.xyz - points
    drawn, stated = np.cov(e.T), met.covariance.mean(axis=0)
    size = np.sqrt(np.diag(stated))
    assert np.abs((drawn - stated) / np.outer(size, size)).max() < 0.12
    # 3 degrees of freedom: sqrt(6 / 4000) = 0.04
    assert nees(met, points).mean() == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize("views", [2, 3, 4])
def test_misfits_are_chi_square(views):
    rng = np.random.default_rng(views)
    cameras, points = room_rig(rng, views), room(rng, 4000)
    met = triangulate_in_space(seen(rng, cameras, points, covariances(rng, 4000, views)), rig_of(cameras), gate=1e-12)
    free = 2 * views - 3
    assert met.misfit.mean() == pytest.approx(free, abs=5 * np.sqrt(2 * free / 4000))
    strict = triangulate_in_space(seen(rng, cameras, points, covariances(rng, 4000, views)), rig_of(cameras), gate=0.05)
    doubted = (strict.status == DISAGREEING) | (strict.used.sum(axis=1) < views)
    assert doubted.mean() == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize("views", [3, 4])
def test_a_view_that_is_on_something_else_is_left_out(views):
    rng = np.random.default_rng(views)
    cameras, points = room_rig(rng, views), room(rng, 1000)
    sights = seen(rng, cameras, points, np.broadcast_to(4.0 * np.eye(2), (1000, views, 2, 2)))
    sights.pixels[:, 1] = cameras[1].project(points + rng.choice([-1, 1], (1000, 3)) * [0.8, 0.8, 0.0])
    met = triangulate_in_space(sights, rig_of(cameras))
    good = met.status == MET
    assert good.mean() > 0.97
    # Of three views a wrong one can agree with one of the others by chance: it stands on the line of it.
    assert (~met.used[good, 1]).mean() > (0.9 if views == 3 else 0.97)
    assert np.median(np.linalg.norm(met.xyz - points, axis=1)[good]) < 0.06


def test_two_views_that_contradict_each_other_give_no_place():
    rng = np.random.default_rng(0)
    cameras, points = room_rig(rng, 2), room(rng, 200)
    sights = seen(rng, cameras, points, np.broadcast_to(4.0 * np.eye(2), (200, 2, 2, 2)))
    sights.pixels[:, 1, 1] += 60.0
    met = triangulate_in_space(sights, rig_of(cameras))
    assert (met.status == DISAGREEING).mean() > 0.95
    assert np.isnan(met.xyz[met.status == DISAGREEING]).all()
    assert np.isnan(met.covariance[met.status == DISAGREEING]).all()


def test_views_without_the_point_do_not_count():
    rng = np.random.default_rng(3)
    cameras, points = room_rig(rng, 4), room(rng, 50)
    sights = seen(rng, cameras, points, covariances(rng, 50, 4))
    there = np.broadcast_to([True, False, True, False], (50, 4)).copy()
    filled = sights._replace(there=there, pixels=np.where(there[:, :, None], sights.pixels, 1e5))
    two = CentresInViews(np.ones((50, 2), dtype=bool), sights.pixels[:, ::2], sights.covariance[:, ::2])
    some, same = triangulate_in_space(filled, rig_of(cameras)), triangulate_in_space(two, rig_of(cameras[::2]))
    assert np.allclose(some.xyz, same.xyz, atol=1e-9, equal_nan=True)
    assert np.array_equal(some.used, there)


def test_sight_lines_that_tell_no_place():
    ahead = [looking("a", np.array([-8.0, y, 1.5]), (100.0, y, 1.5), 600.0) for y in (0.0, 0.5)]
    behind = [looking("b", np.array([8.0, 0.3, 1.5]), (100.0, 30.0, 1.5), 600.0)]
    pixels = np.full((1, 3, 2), [319.5, 239.5])
    cov = np.broadcast_to(np.eye(2), (1, 3, 2, 2))
    rig = rig_of([*ahead, *behind])

    def status(*views, height=None):
        there = np.zeros((1, 3), dtype=bool)
        there[0, list(views)] = True
        met = triangulate_in_space(CentresInViews(there, pixels, cov), rig, height)
        assert met.status[0] == MET or np.isnan(met.xyz).all()
        return met.status[0]

    assert status(0, 1) == NEAR_PARALLEL  # two level, parallel lines
    assert status(0) == TOO_FEW
    assert status() == TOO_FEW
    assert status(0, height=HEIGHT) == NEAR_PARALLEL  # a level line never comes down to 0.9
    assert status(0, 2) == BEHIND  # they cross at the back of camera b


def test_a_height_above_the_camera_of_a_line_that_looks_down_is_behind():
    camera = looking("a", np.array([-8.0, 0.0, 2.5]), (0, 0, 0), 600.0)
    sights = CentresInViews(np.ones((1, 1), dtype=bool), np.full((1, 1, 2), [319.5, 239.5]), np.eye(2)[None, None])
    assert triangulate_in_space(sights, rig_of([camera]), TargetHeightPrior(3.5, 0.1)).status[0] == BEHIND
    met = triangulate_in_space(sights, rig_of([camera]), TargetHeightPrior(0.0, 0.1))
    assert met.xyz[0] == pytest.approx([0, 0, 0], abs=1e-9)


def test_cameras_far_away_lose_nothing():
    """Where rays are parallel and places a millionth of the distance, as in the scene of the balls."""
    rng = np.random.default_rng(0)
    cameras = [
        looking(n, np.array(p), (0, 0, 120.0), 1e6) for n, p in (("a", [-1e6, 0, 120.0]), ("b", [0, -1e6, 120.0]))
    ]
    points = rng.uniform([-150, -150, 0], [150, 150, 240], (500, 3))
    cov = np.broadcast_to(4.0 * np.eye(2), (500, 2, 2, 2))
    exact = np.stack([camera.project(points) for camera in cameras], axis=1)
    met = triangulate_in_space(CentresInViews(np.ones((500, 2), dtype=bool), exact, cov), rig_of(cameras))
    assert np.abs(met.xyz - points).max() < 1e-5
    assert np.allclose(met.covariance, np.diag([4.0, 4.0, 2.0]), atol=0.01)


def test_rows_do_not_depend_on_each_other():
    rng = np.random.default_rng(5)
    cameras, points = room_rig(rng, 3), room(rng, 20)
    sights = seen(rng, cameras, points, covariances(rng, 20, 3))
    sights.there[:7, 0] = False
    sights.pixels[3, 1] += 90.0
    rig = rig_of(cameras)
    together = triangulate_in_space(sights, rig)
    for row in range(20):
        alone = triangulate_in_space(sights.take(np.array([row])), rig)
        assert np.allclose(alone.xyz[0], together.xyz[row], rtol=1e-12, equal_nan=True)
        assert alone.status[0] == together.status[row]
