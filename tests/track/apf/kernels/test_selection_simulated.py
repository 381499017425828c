"""The metric of camera selection from end to end: plain matrices, and simulated cameras and people.

The simulations draw what the model says (Eqs. 10 and 14), fit the best linear estimate to the
draws by least squares and compare its mean square error.  Error bars are those of a mean of n
squared errors; tests allow 4 of them (about 1 in 16,000 by chance, with fixed seeds).
"""

from __future__ import annotations

import itertools

import numpy as np
import occlusion_reference as ref
import pytest
from tracker_scenes import room100

from occlog.core.occlusion.priors import gaussian_priors, no_priors
from occlog.track.methods.apf.kernels.selection_metric import (
    joint_visibility,
    mean_square_errors,
    perspective_moments,
    views,
    weak_moments,
)
from occlog.track.methods.apf.model import pack_noise, pack_sensors, read_noise

pytestmark = pytest.mark.jit
SCENE = room100()
SENSORS, NOISE, READ = pack_sensors(SCENE), pack_noise(SCENE), read_noise(SCENE)
ALL = tuple(range(8))
IN_VIEW = (0, 2, 3, 6)
"""Cameras that have the whole of `cloud` in view."""
N = 60_000
DIAMETER = 3.33


def cloud(seed, L=150, spread=2.0, place=(30.0, 25.0)):
    rng = np.random.default_rng(seed)
    away = rng.standard_normal((L, 2)) @ np.array([[1.0, 0.4], [0.0, 0.7]])
    return np.array(place) + spread * np.clip(away, -2.5, 2.5), rng.dirichlet(np.full(L, 2.0))


def moments(model, xy, weights, priors=None, hit=None, cameras=ALL):
    inside = views(xy, cameras, SENSORS)
    hit = np.ones(len(cameras)) if hit is None else hit
    together = joint_visibility(xy, weights, cameras, SENSORS, inside, priors or no_priors(), hit)
    if model == "weak":
        return weak_moments(xy, weights, cameras, SENSORS, NOISE, READ, together)
    return perspective_moments(xy, weights, cameras, SENSORS, NOISE, READ, inside, together)


def metric(values, rows):
    return float(mean_square_errors(values, np.array([rows], dtype=np.int64))[0])


def along_and_across(i, x):
    """d and h of camera i for places (n, 2), from its angle as the paper has it (theta = yaw + pi)."""
    camera = SCENE.cameras[i]
    theta, (dx, dy) = camera.yaw + np.pi, (x - camera.ground).T
    return -np.cos(theta) * dx - np.sin(theta) * dy, np.sin(theta) * dx - np.cos(theta) * dy


def variance(i, x):
    """Eq. 2."""
    camera, (d, h) = SCENE.cameras[i], along_and_across(i, x)
    f = camera.focal_px[0]
    ratio = 1 + h**2 / d**2
    return f**2 * (ratio**2 * camera.sigma_yaw**2 + ratio / d**2 * camera.sigma_position**2) + camera.sigma_read_px**2


def plain(model, xy, weights, people, rows):
    """The metric in plain form: sums over the particles in view, and the inverse of Sigma_Z; NaN if not positive."""
    mean, n = weights @ xy, len(rows)
    sigma_x = sum(w * np.outer(p - mean, p - mean) for w, p in zip(weights, xy, strict=True))
    inside = [views(xy, [i], SENSORS)[0] for i in rows]
    q = [ref.hiding(xy, SCENE.cameras[i].ground, people) for i in rows]
    zx, z = np.zeros((n, 2)), np.zeros((n, n))
    image, expected, noise = [], [], []
    for a, i in enumerate(rows):
        camera, own = SCENE.cameras[i], weights * inside[a]
        d, h = along_and_across(i, np.where(inside[a][:, None], xy, mean))
        image.append(camera.focal_px[0] * h / d)
        expected.append(own @ image[a] / own.sum())
        noise.append(own @ variance(i, np.where(inside[a][:, None], xy, mean)) / own.sum())
    for a, i in enumerate(rows):
        axis = np.array([np.sin(SCENE.cameras[i].yaw + np.pi), -np.cos(SCENE.cameras[i].yaw + np.pi)])
        own = weights * inside[a]
        seen = own @ np.prod(1 - q[a], axis=1)
        if model == "weak":
            zx[a] = seen * axis @ sigma_x
        else:
            zx[a] = seen * (own / own.sum() * (image[a] - expected[a])) @ (xy - mean)
        for b, j in enumerate(rows):
            both = weights * inside[a] * inside[b]
            blocked = q[a] if a == b else q[a] + q[b]
            p = both @ np.prod(np.maximum(1 - blocked, 0), axis=1)
            other = np.array([np.sin(SCENE.cameras[j].yaw + np.pi), -np.cos(SCENE.cameras[j].yaw + np.pi)])
            if model == "weak":
                camera, depth = SCENE.cameras[i], along_and_across(i, mean[None])[0][0]
                v = (camera.sigma_yaw**2 + (camera.sigma_read_px / camera.focal_px[0]) ** 2) * depth**2
                z[a, b] = p * (axis @ sigma_x @ other + (v + camera.sigma_position**2 if a == b else 0.0))
            elif both.sum() > 0:
                product = both @ ((image[a] - expected[a]) * (image[b] - expected[b])) / both.sum()
                z[a, b] = p * (product + (noise[a] if a == b else 0.0))
    if np.linalg.eigvalsh(z / np.sqrt(np.outer(np.diag(z), np.diag(z)))).min() < 1e-6:
        return np.nan
    return float(np.trace(sigma_x - zx.T @ np.linalg.inv(z) @ zx))


@pytest.mark.parametrize("model", ["perspective", "weak"])
@pytest.mark.parametrize("seed", range(3))
def test_it_is_that_of_the_plain_form(seed, model):
    """Among 20 people and behind the pillar; kernels leave out tails beyond 3.5 sigma: a few 1e-4 of the spread."""
    rng = np.random.default_rng([7, seed])
    xy, weights = cloud(seed, 40, 5.0, rng.uniform(15, 85, 2))
    mean, covariance = rng.uniform(0, 100, (20, 2)), np.tile(rng.uniform(9, 40) * np.eye(2), (20, 1, 1))
    values = moments(model, xy, weights, gaussian_priors(mean, covariance, DIAMETER))
    people = ref.RefPriors(mean, covariance, DIAMETER)
    sees = [i for i in ALL if views(xy, [i], SENSORS)[0].mean() > 0.2 and along_and_across(i, xy)[0].min() > 0]
    compared = 0
    for k in (1, 2, 3):
        for rows in itertools.combinations(sees, k):
            want = plain(model, xy, weights, people, rows)
            if want > 0:
                compared += 1
                assert metric(values, rows) == pytest.approx(want, abs=5e-4 * np.trace(values.x))
    assert compared >= 10


def fitted(x, columns):
    """Mean square error of the best linear estimate fitted to draws, and its standard error."""
    design = np.column_stack(columns)
    design, away = design - design.mean(axis=0), x - x.mean(axis=0)
    left = away - design @ np.linalg.lstsq(design, away, rcond=None)[0]
    squares = (left**2).sum(axis=1)
    return squares.mean(), squares.std() / np.sqrt(len(squares))


@pytest.mark.parametrize("rows", [(0,), (2, 3), (0, 2, 6), IN_VIEW])
@pytest.mark.parametrize("model", ["perspective", "weak"])
def test_cameras_that_miss_at_random_have_the_error_of_simulated_ones(model, rows):
    """All particles in view: the model is exact, nothing but the draws' error is allowed."""
    rng = np.random.default_rng([3, len(rows)])
    xy, weights = cloud(1)
    assert views(xy, rows, SENSORS).all()
    hit = rng.uniform(0.6, 1.0, 8)
    x = xy[rng.choice(len(xy), N, p=weights)]
    mean, columns = weights @ xy, []
    for i in rows:
        camera, (d, h) = SCENE.cameras[i], along_and_across(i, x)
        f = camera.focal_px[0]
        if model == "perspective":
            d0, h0 = along_and_across(i, xy)
            expected = f * weights @ (h0 / d0)
            z = f * h / d + np.sqrt(variance(i, x)) * rng.standard_normal(N)
        else:
            d0, expected = (v[0] for v in along_and_across(i, mean[None]))
            v = (camera.sigma_yaw**2 + (camera.sigma_read_px / f) ** 2) * d0**2 + camera.sigma_position**2
            z = h + np.sqrt(v) * rng.standard_normal(N)
        columns.append(np.where(rng.random(N) < hit[i], z, expected))
    want, error = fitted(x, columns)
    assert error < 0.02 * want
    assert abs(metric(moments(model, xy, weights, hit=hit), rows) - want) < 4 * error


def hidden(x, people, camera):
    """(n,) whether any of (n, M, 2) people covers the sight line: within D / 2 of it, between camera and target."""
    away = x - camera
    r = np.hypot(*away.T)
    u = away / r[:, None]
    rel = people - camera
    along = rel @ u[:, :, None]
    across = rel[:, :, 0] * -u[:, 1, None] + rel[:, :, 1] * u[:, 0, None]
    return np.any((np.abs(across) < DIAMETER / 2) & (along[:, :, 0] > 0) & (along[:, :, 0] < r[:, None]), axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_people_who_walk_about_hide_the_target_as_simulated_people_do(seed):
    """Shares to 4 standard errors (at most 0.0082); pairs of cameras and the metric to 1 % more.

    Eq. 8 leaves out that one person can hide the target from two cameras, and Eqs. 12-13 take
    what is seen as independent of the place; this is what they cost.
    """
    rng = np.random.default_rng([5, seed])
    xy, weights = cloud(seed)
    means, covariance = rng.uniform(0, 100, (12, 2)), np.tile(36.0 * np.eye(2), (12, 1, 1))
    priors = gaussian_priors(means, covariance, DIAMETER)
    inside = views(xy, IN_VIEW, SENSORS)
    assert inside.all()
    together = joint_visibility(xy, weights, IN_VIEW, SENSORS, inside, priors, np.ones(4))
    x = xy[rng.choice(len(xy), N, p=weights)]
    people = means + 6.0 * rng.standard_normal((N, 12, 2))
    seen = np.array([~hidden(x, people, SCENE.cameras[i].ground) for i in IN_VIEW])
    shares = (seen[:, None] & seen[None]).mean(axis=2)
    assert np.diag(shares).min() < 0.9  # people do matter
    np.testing.assert_allclose(np.diag(together), np.diag(shares), atol=0.0082)
    np.testing.assert_allclose(together, shares, atol=0.0182)
    columns = []
    for n, i in enumerate(IN_VIEW):
        d, h = along_and_across(i, x)
        z = 70.0 * h / d
        columns.append(np.where(seen[n], z + np.sqrt(variance(i, x)) * rng.standard_normal(N), z.mean()))
    values = moments("perspective", xy, weights, priors)
    for rows in ((0,), (1, 2), (0, 1, 3), (0, 1, 2, 3)):
        want, error = fitted(x, [columns[n] for n in rows])
        assert abs(metric(values, [IN_VIEW[n] for n in rows]) - want) < 4 * error + 0.01 * want


@pytest.mark.parametrize("model", ["perspective", "weak"])
def test_the_order_in_which_cameras_are_given_does_not_matter(model):
    xy, weights = cloud(4, spread=6.0)
    priors = gaussian_priors(np.array([[40.0, 20.0], [15.0, 30.0]]), np.tile(16.0 * np.eye(2), (2, 1, 1)), DIAMETER)
    shuffled = tuple(np.random.default_rng(0).permutation(8).tolist())
    given, other = moments(model, xy, weights, priors), moments(model, xy, weights, priors, cameras=shuffled)
    for rows in itertools.combinations(ALL, 3):
        same = [shuffled.index(i) for i in rows]
        assert metric(other, same) == pytest.approx(metric(given, rows), rel=1e-9)
