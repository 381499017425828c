"""The metric of camera selection against loops over the paper's equations, Monte Carlo and closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import occlusion_reference as ref
import pytest
from tracker_scenes import room100

from occlog.core.occlusion.priors import gaussian_priors, no_priors
from occlog.track.methods.apf.kernels.selection_metric import (
    CameraMoments,
    joint_visibility,
    mean_square_errors,
    perspective_moments,
    views,
    weak_moments,
)
from occlog.track.methods.apf.model import pack_noise, pack_sensors, read_noise

SCENE = room100()
SENSORS, NOISE, READ = pack_sensors(SCENE), pack_noise(SCENE), read_noise(SCENE)
ALL = tuple(range(8))
PLACE = np.array([28.0, 62.0])


def cloud(seed, L=400, spread=3.0):
    rng = np.random.default_rng(seed)
    return PLACE + spread * rng.standard_normal((L, 2)), rng.dirichlet(np.full(L, 2.0))


def people(seed, M=20):
    rng = np.random.default_rng(seed + 9)
    return rng.uniform(0, 100, (M, 2)), np.tile(rng.uniform(9, 40) * np.eye(2), (M, 1, 1))


def moments(model, xy, weights, priors=None, hit=None, cameras=ALL):
    inside = views(xy, cameras, SENSORS)
    hit = np.ones(len(cameras)) if hit is None else hit
    together = joint_visibility(xy, weights, cameras, SENSORS, inside, priors or no_priors(), hit)
    if model == "weak":
        return weak_moments(xy, weights, cameras, SENSORS, NOISE, READ, together)
    return perspective_moments(xy, weights, cameras, SENSORS, NOISE, READ, inside, together)


def subsets(k, N=8):
    return np.array(list(itertools.combinations(range(N), k)), dtype=np.int64).reshape(-1, k)


def geometry(i, x):
    """h and d of camera i for one place."""
    camera = SCENE.cameras[i]
    away, c, s = x - camera.ground, np.cos(camera.yaw), np.sin(camera.yaw)
    return c * away[1] - s * away[0], c * away[0] + s * away[1]


def variance_of(i, x):
    h, d = geometry(i, x)
    camera = SCENE.cameras[i]
    f = camera.focal_px[0]
    return (
        f**2 * (1 + h**2 / d**2) ** 2 * camera.sigma_yaw**2
        + f**2 * (h**2 + d**2) / d**4 * camera.sigma_position**2
        + camera.sigma_read_px**2
    )


@pytest.mark.parametrize("seed", range(3))
def test_probabilities_of_seeing_together_are_sums_over_the_particles(seed):
    xy, weights = cloud(seed, 60, 8.0)
    mean, covariance = people(seed)
    hit = np.random.default_rng(seed).uniform(0.8, 1.0, 8)
    inside = views(xy, ALL, SENSORS)
    found = joint_visibility(xy, weights, ALL, SENSORS, inside, gaussian_priors(mean, covariance, 3.33), hit)
    given = ref.RefPriors(mean, covariance, 3.33)
    q = np.stack([ref.hiding(xy, SCENE.cameras[i].ground, given) for i in ALL], axis=1)
    for i, j in itertools.product(ALL, ALL):
        either = q[:, i] if i == j else q[:, i] + q[:, j]
        both = inside[i] & inside[j]
        want = np.sum(weights * both * np.prod(np.maximum(1 - either, 0), axis=1))
        want *= hit[i] if i == j else hit[i] * hit[j]
        assert found[i, j] == pytest.approx(want, abs=2e-4)  # tails beyond 3.5 sigma are left out


@pytest.mark.parametrize("seed", range(3))
def test_perspective_moments_by_loops(seed):
    """Eqs. 10-13, particle by particle."""
    xy, weights = cloud(seed, 50, 6.0)
    priors = gaussian_priors(*people(seed), 3.33)
    found = moments("perspective", xy, weights, priors)
    inside = views(xy, ALL, SENSORS)
    together = joint_visibility(xy, weights, ALL, SENSORS, inside, priors, np.ones(8))
    mean = weights @ xy
    z, v = np.zeros((8, 50)), np.zeros((8, 50))
    for i, p in itertools.product(ALL, range(50)):
        if inside[i, p]:
            h, d = geometry(i, xy[p])
            z[i, p], v[i, p] = SCENE.cameras[i].focal_px[0] * h / d, variance_of(i, xy[p])
    expected = [np.average(z[i], weights=weights * inside[i]) if inside[i].any() else 0.0 for i in ALL]
    for i in ALL:
        if not inside[i].any():
            assert found.seen[i] == 0.0
            continue
        own = weights * inside[i] / np.sum(weights * inside[i])
        want = sum(own[p] * (z[i, p] - expected[i]) * (xy[p] - mean) for p in range(50)) * together[i, i]
        np.testing.assert_allclose(found.zx[i], want, atol=1e-9)
        for j in ALL:
            both = weights * inside[i] * inside[j]
            if both.sum() == 0:
                continue
            product = np.sum(both * (z[i] - expected[i]) * (z[j] - expected[j])) / both.sum()
            noise = np.sum(own * v[i]) if i == j else 0.0
            assert found.z[i, j] == pytest.approx(together[i, j] * (product + noise), abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_weak_perspective_is_the_kalman_update(seed):
    """Without occlusion every camera is a linear measurement; its metric is the trace of the posterior covariance."""
    xy, weights = cloud(seed, 300, 2.0)
    seeing = tuple(i for i in ALL if views(xy, [i], SENSORS).all())
    assert len(seeing) >= 4
    found = mean_square_errors(moments("weak", xy, weights, cameras=seeing), subsets(3, len(seeing)))
    mean = weights @ xy
    spread = (xy - mean).T @ ((xy - mean) * weights[:, None])
    for value, rows in zip(found, subsets(3, len(seeing)), strict=True):
        information = np.linalg.inv(spread)
        for n in rows:
            camera = SCENE.cameras[seeing[n]]
            across = np.array([-np.sin(camera.yaw), np.cos(camera.yaw)])
            d, f = geometry(seeing[n], mean)[1], camera.focal_px[0]
            v = (camera.sigma_yaw**2 + (camera.sigma_read_px / f) ** 2) * d**2 + camera.sigma_position**2
            information += np.outer(across, across) / v
        assert value == pytest.approx(np.trace(np.linalg.inv(information)), rel=1e-9)


@pytest.mark.parametrize("rows", [(0,), (0, 2), (1, 3, 5), (0, 4, 6, 7)])
def test_perspective_is_the_best_linear_estimate_of_simulated_measurements(rows):
    """Measurements of cameras that see the target or not are simulated, a linear estimate is fitted to them."""
    rng = np.random.default_rng(len(rows))
    centres, weights = cloud(1, 200, 3.0)
    hit = np.full(8, 0.8)
    values = moments("perspective", centres, weights, hit=hit)
    found = mean_square_errors(values, np.array([rows]))[0]
    n = 20_000
    x = centres[rng.choice(200, n, p=weights)]
    columns = []
    for i in rows:
        inside = views(x, [i], SENSORS)[0]
        z = np.zeros(n)
        if inside.any():
            h, d = np.array([geometry(i, p) for p in x[inside]]).T
            spread = np.sqrt([variance_of(i, p) for p in x[inside]])
            z[inside] = SCENE.cameras[i].focal_px[0] * h / d + spread * rng.standard_normal(inside.sum())
            seen = inside & (rng.random(n) < hit[i])
            z = np.where(seen, z - z[inside].mean(), 0.0)  # not seen: the expected value
        columns.append(z)
    design, away = np.column_stack(columns), x - x.mean(axis=0)
    left = away - design @ np.linalg.lstsq(design, away, rcond=None)[0]
    squares = (left**2).sum(axis=1)
    error = squares.std() / np.sqrt(n)
    assert abs(found - squares.mean()) < 4 * error + 0.01 * found  # 4 standard errors, and 1 % for cut views


def test_two_cameras_by_hand():
    """Tr(Sigma_x - Sigma_Zx' Sigma_Z^-1 Sigma_Zx) with numbers."""
    given = CameraMoments(
        np.diag([4.0, 1.0]), np.array([[2.0, 0.0], [0.0, 1.0], [0.0, 0.0]]), np.diag([2.0, 4.0, 1.0]), np.ones(3)
    )
    found = mean_square_errors(given, np.array([[0, 1], [0, 2], [1, 2]]))
    np.testing.assert_allclose(found, [5 - 2 - 0.25, 3.0, 4.75])
    np.testing.assert_allclose(mean_square_errors(given, np.zeros((1, 0), dtype=np.int64)), [5.0])


@pytest.mark.parametrize("model", ["perspective", "weak"])
@pytest.mark.parametrize("seed", range(4))
def test_it_is_between_nothing_and_the_spread_and_order_does_not_matter(seed, model):
    xy, weights = cloud(seed, 200, 10.0)
    values = moments(model, xy, weights, gaussian_priors(*people(seed), 3.33))
    whole = np.trace(values.x)
    for k in (1, 2, 4, 8):
        found = mean_square_errors(values, subsets(k))
        assert np.all((found >= 0) & (found <= whole * (1 + 1e-12)))
        np.testing.assert_allclose(mean_square_errors(values, subsets(k)[:, ::-1]), found, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_without_occlusion_a_further_camera_never_hurts(seed):
    xy, weights = cloud(seed, 200, 2.0)
    values = moments("weak", xy, weights)
    for rows in subsets(3):
        before = mean_square_errors(values, rows[None])[0]
        for n in set(ALL) - set(rows.tolist()):
            assert mean_square_errors(values, np.array([[*rows, n]]))[0] <= before * (1 + 1e-9)


def test_a_camera_that_sees_nothing_adds_nothing():
    xy, weights = cloud(0, 100, 1.0)
    blind = [i for i in ALL if not views(xy, [i], SENSORS).any()]
    assert blind
    for model in ("perspective", "weak"):
        values = moments(model, xy, weights)
        alone, both = mean_square_errors(values, np.array([[0, 1]]))[0], None
        both = mean_square_errors(values, np.array([[0, 1, blind[0]]]))[0]
        assert both == pytest.approx(alone, rel=1e-9)
        assert mean_square_errors(values, np.array([[blind[0]]]))[0] == pytest.approx(np.trace(values.x))


def test_a_camera_that_the_mean_of_the_cloud_is_behind_does_not_count_in_weak_perspective():
    xy = np.array([[50.0, 1.0], [50.0, 2.0], [51.0, 1.5]])
    sensors = SENSORS._replace(axis=-SENSORS.axis)
    together = np.ones((8, 8))
    values = weak_moments(xy, np.full(3, 1 / 3), ALL, sensors, NOISE, READ, together)
    assert values.seen[1] == 0.0
    assert mean_square_errors(values, np.array([[1]]))[0] == pytest.approx(np.trace(values.x))
