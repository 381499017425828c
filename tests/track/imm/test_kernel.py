from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.core.geometry.camera import wrap_angle
from occlog.filtering.motion.coordinated_turn import acceleration_root, move, three_models
from occlog.track.methods.imm import kernel as imm
from occlog.track.methods.imm.kernel import ImmParticles, MotionModels

SENSOR = np.array([25.0, 22.0])


class Heard(NamedTuple):
    """Bearings of one sensor, in the order in which `update_weights` takes them."""

    bearing: Floats  # (N,) [rad]
    sigma: Floats  # (N,) [rad]
    position: Floats  # (2,)


def bearings(*degrees, sigma=3.0, sensor=SENSOR):
    angle = np.radians(np.array(degrees, dtype=float))
    return Heard(angle, np.full(len(degrees), math.radians(sigma)), np.asarray(sensor, dtype=float))


def particles(rng, J, L, centre=(18.0, 31.0), extent=4.0):
    x = rng.normal(size=(J, L, 4))
    x[..., 0] = centre[0] + extent * x[..., 0]
    x[..., 2] = centre[1] + extent * x[..., 2]
    return x


def equal(J, L):
    return np.full((J, L), 1.0 / (J * L))


def cloud(rng, L, J=3):
    return ImmParticles(particles(rng, 1, L)[0], rng.integers(J, size=L))


def by_triple_loop(x, prior, heard):
    """Eqs. 3.4-3.6 letter by letter; the wrapped difference by the angle of a product of unit vectors."""
    N, (J, L) = len(heard.bearing), prior.shape
    w = np.zeros((N, J, L))
    for i in range(N):
        for m in range(J):
            for j in range(L):
                dx, dy = x[m, j, 0] - heard.position[0], x[m, j, 2] - heard.position[1]
                turned = complex(math.cos(heard.bearing[i]), math.sin(heard.bearing[i])) * complex(dx, -dy)
                off, s = math.atan2(turned.imag, turned.real), heard.sigma[i]
                w[i, m, j] = prior[m, j] * math.exp(-0.5 * (off / s) ** 2) / (s * math.sqrt(2 * math.pi))
    return w / w.sum(), math.log(w.sum())


def by_numpy(x, prior, heard):
    """The plain vectorised form."""
    angle = np.arctan2(x[..., 2] - heard.position[1], x[..., 0] - heard.position[0])
    off = wrap_angle(heard.bearing[:, None, None] - angle) / heard.sigma[:, None, None]
    log_w = np.log(prior) - 0.5 * off**2 - np.log(heard.sigma)[:, None, None]
    top = log_w.max()
    w = np.exp(log_w - top)
    return w / w.sum(), top + math.log(w.sum()) - 0.5 * math.log(2 * math.pi)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("shape", [(1, 1, 40), (2, 3, 60), (5, 2, 30)])
def test_weights_are_those_of_a_triple_loop(seed, shape):
    N, J, L = shape
    rng = np.random.default_rng(seed)
    x, prior = particles(rng, J, L, centre=SENSOR), rng.dirichlet(np.ones(J * L)).reshape(J, L)
    heard = Heard(rng.uniform(-9.0, 9.0, N), rng.uniform(0.3, 1.0, N), SENSOR)
    got = imm.update_weights(x, prior, *heard)
    for wanted, log_evidence in (by_triple_loop(x, prior, heard), by_numpy(x, prior, heard)):
        np.testing.assert_allclose(got.each, wanted, rtol=1e-9, atol=1e-15)
        assert got.log_evidence == pytest.approx(log_evidence, rel=1e-9)
    np.testing.assert_allclose(got.total, got.each.sum(axis=0), rtol=1e-12)
    assert got.total.sum() == pytest.approx(1.0, abs=1e-12)


def test_weights_survive_bearings_far_from_all_particles():
    """Here the plain exponentials are all 0."""
    x = particles(np.random.default_rng(1), 2, 50, centre=(60.0, 25.0), extent=1.0)
    heard = bearings(170.0, sigma=0.5)
    got = imm.update_weights(x, equal(2, 50), *heard)
    wanted, log_evidence = by_numpy(x, equal(2, 50), heard)
    np.testing.assert_allclose(got.each, wanted, rtol=1e-9, atol=1e-300)
    assert got.log_evidence == pytest.approx(log_evidence, rel=1e-12)
    assert got.log_evidence < -1000.0


def test_particles_that_cannot_be_do_not_drown_the_others():
    """The one of prior 0 fits by more than the range of floating point numbers better."""
    x = np.zeros((1, 3, 4))
    x[0, :, 0], x[0, :, 2] = SENSOR[0] + 10.0, SENSOR[1] + np.array([0.0, 1.0, 1.1])
    got = imm.update_weights(x, np.array([[0.0, 0.5, 0.5]]), *bearings(0.0, sigma=0.05))
    offs = np.degrees(np.arctan([0.1, 0.11])) / 0.05
    ratio = math.exp(0.5 * (offs[0] ** 2 - offs[1] ** 2))
    np.testing.assert_allclose(got.total[0], [0.0, 1.0 / (1.0 + ratio), ratio / (1.0 + ratio)], rtol=1e-9)
    assert got.log_evidence < -5000.0


@pytest.mark.parametrize("turns", [-2, 0, 1])
def test_bearings_wrap_at_the_back_of_the_sensor(turns):
    """Particles at 182, 180 and 178 degrees; 179 and 181 (as -179) are 3, 1, 1 and 1, 1, 3 degrees off."""
    x = np.zeros((1, 3, 4))
    at = np.radians([182.0, 180.0, 178.0])
    x[0, :, 0], x[0, :, 2] = SENSOR[0] + 10.0 * np.cos(at), SENSOR[1] + 10.0 * np.sin(at)
    for degrees, offs in ((179.0, [3.0, 1.0, 1.0]), (-179.0, [1.0, 1.0, 3.0])):
        got = imm.update_weights(x, equal(1, 3), *bearings(degrees + 360.0 * turns)).total[0]
        wanted = np.exp(-0.5 * (np.array(offs) / 3.0) ** 2)
        np.testing.assert_allclose(got, wanted / wanted.sum(), rtol=1e-9)


def test_the_order_of_bearings_does_not_matter():
    rng = np.random.default_rng(2)
    start, motion = cloud(rng, 200), MotionModels(three_models(0.05), acceleration_root(0.01, 1.0))
    draws = imm.draw(rng, 3, 200)
    one = imm.step(start, motion, 1.0, draws, **bearings(130.0, 150.0, -20.0)._asdict())
    other = imm.step(start, motion, 1.0, draws, **bearings(-20.0, 130.0, 150.0)._asdict())
    np.testing.assert_allclose(one.estimate.mean, other.estimate.mean, rtol=1e-12)
    np.testing.assert_allclose(one.estimate.covariance, other.estimate.covariance, rtol=1e-9)
    np.testing.assert_array_equal(one.cloud.states, other.cloud.states)
    np.testing.assert_allclose(one.weights.each.sum(axis=2)[[2, 0, 1]], other.weights.each.sum(axis=2), rtol=1e-12)


def test_one_model_and_one_bearing_are_a_plain_particle_filter():
    rng = np.random.default_rng(3)
    root, L = acceleration_root(0.02, 0.7), 400
    start, draws = cloud(rng, L, 1), imm.draw(rng, 1, L)
    heard = bearings(140.0)
    got = imm.step(start, MotionModels(np.zeros((1, 3)), root), 0.7, draws, **heard._asdict())
    x = start.states.copy()
    x[:, 0] += 0.7 * x[:, 1]
    x[:, 2] += 0.7 * x[:, 3]
    x += np.concatenate([draws.normals[0, :, :2] @ root.T, draws.normals[0, :, 2:] @ root.T], axis=1)
    off = heard.bearing[0] - np.arctan2(x[:, 2] - 22.0, x[:, 0] - 25.0)
    w = np.exp(-0.5 * (off / heard.sigma[0]) ** 2)
    w /= w.sum()
    ancestors = np.searchsorted(np.cumsum(w), (np.arange(L) + draws.u) / L, side="right")
    np.testing.assert_allclose(got.cloud.states, x[ancestors], rtol=1e-12)
    np.testing.assert_allclose(got.estimate.mean, w @ x, rtol=1e-10)
    np.testing.assert_allclose(got.estimate.covariance, np.cov(x.T, aweights=w, ddof=0), rtol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_far_targets_are_updated_as_by_a_kalman_filter(seed):
    """Mean and covariance within 5 Monte Carlo standard errors, and 0.5 % of a deviation for the curved bearing."""
    rng = np.random.default_rng(seed)
    L, dt, root = 50_000, 2.0, acceleration_root(0.05, 2.0)
    m0, P0 = np.array([1800.0, 0.3, 900.0, -0.5]), np.diag([4.0, 0.2, 9.0, 0.3])
    start = ImmParticles(rng.multivariate_normal(m0, P0, size=L), np.zeros(L, dtype=np.int64))
    F = np.kron(np.eye(2), [[1.0, dt], [0.0, 1.0]])
    m, P = F @ m0, F @ P0 @ F.T + np.kron(np.eye(2), root @ root.T)
    r2, sigma = m[0] ** 2 + m[2] ** 2, 1e-3
    H = np.array([-m[2], 0.0, m[0], 0.0]) / r2
    S = H @ P @ H + sigma**2
    innovation = math.sqrt(S) * [0.5, -1.0, 1.5, 0.0][seed]
    heard = Heard(np.array([math.atan2(m[2], m[0]) + innovation]), np.array([sigma]), np.zeros(2))
    got = imm.step(start, MotionModels(np.zeros((1, 3)), root), dt, imm.draw(rng, 1, L), **heard._asdict())
    K = P @ H / S
    mean, covariance = m + K * innovation, P - np.outer(K, K) * S
    sd, size = np.sqrt(np.diag(covariance)), 1.0 / np.sum(got.weights.total**2)
    assert np.all(np.abs(got.estimate.mean - mean) < (5.0 / math.sqrt(size) + 0.005) * sd)
    error = np.abs(got.estimate.covariance - covariance) / np.outer(sd, sd)
    assert np.all(error < 5.0 * math.sqrt(2.0 / size) + 0.01)
    # The particles drawn again say the same, with the error of their own number in addition.
    assert np.all(np.abs(got.cloud.states.mean(axis=0) - got.estimate.mean) < 5.0 / math.sqrt(L) * sd)
    # The evidence is the innovation's density.
    wanted = -0.5 * (innovation**2 / S + math.log(2 * math.pi * S))
    assert got.weights.log_evidence == pytest.approx(wanted, abs=5.0 * math.sqrt((L / size - 1.0) / L) + 0.005)


def test_moments_are_weighted_sums():
    rng = np.random.default_rng(5)
    x, w = particles(rng, 3, 70), rng.dirichlet(np.ones(210)).reshape(3, 70)
    got = imm.moments(x, w)
    np.testing.assert_allclose(got.mean, w.ravel() @ x.reshape(-1, 4), rtol=1e-12)
    np.testing.assert_allclose(got.covariance, np.cov(x.reshape(-1, 4).T, aweights=w.ravel(), ddof=0), rtol=1e-10)
    for m in range(3):
        assert got.mu[m] == pytest.approx(w[m].sum(), rel=1e-12)
        np.testing.assert_allclose(got.means[m], np.average(x[m], axis=0, weights=w[m]), rtol=1e-12)
        np.testing.assert_allclose(got.covariances[m], np.cov(x[m].T, aweights=w[m], ddof=0), rtol=1e-10)


def test_a_model_without_weight_has_no_moments():
    x = particles(np.random.default_rng(6), 2, 20)
    w = np.stack([np.full(20, 0.05), np.zeros(20)])
    got = imm.moments(x, w)
    assert np.isnan(got.means[1]).all()
    assert np.isnan(got.covariances[1]).all()
    np.testing.assert_allclose(got.mean, x[0].mean(axis=0))
    np.testing.assert_allclose(got.covariance, np.cov(x[0].T, ddof=0), rtol=1e-10)


@pytest.mark.parametrize("L", [300, 500])
def test_silence_moves_the_particles_and_keeps_every_one_of_them(L):
    rng = np.random.default_rng(7)
    start, draws = cloud(rng, L), imm.draw(rng, 3, L)
    motion = MotionModels(three_models(0.2), acceleration_root(0.01, 1.0))
    got = imm.step(start, motion, 1.0, draws, **bearings()._asdict())
    np.testing.assert_array_equal(got.weights.total, np.full((3, L), 1 / (3 * L)))
    assert got.weights.each.shape == (0, 3, L)
    assert got.weights.log_evidence == 0.0
    np.testing.assert_allclose(got.estimate.mu, 1 / 3, rtol=1e-12)
    moved = np.stack(
        [move(start.states, a, 1.0, motion.root, n) for a, n in zip(motion.models, draws.normals, strict=True)]
    )
    np.testing.assert_array_equal(got.cloud.states, moved[got.cloud.models, np.arange(L)])
    # L independent thirds: standard deviation sqrt(L 2/9).
    counts = np.bincount(got.cloud.models, minlength=3)
    assert np.all(np.abs(counts - L / 3) < 4.0 * math.sqrt(L * 2 / 9))


def test_switching_probabilities_weigh_the_models():
    matrix = np.array([[0.9, 0.1], [0.0, 1.0]])
    prior = imm.prior_weights(np.array([0, 1, 1, 0]), 2, matrix)
    np.testing.assert_allclose(prior, np.array([[0.9, 0.0, 0.0, 0.9], [0.1, 1.0, 1.0, 0.1]]) / 4)
    rng = np.random.default_rng(9)
    start = ImmParticles(particles(rng, 1, 100)[0], np.ones(100, dtype=np.int64))
    motion = MotionModels(three_models(0.1)[:2], np.zeros((2, 2)), matrix)
    for heard in (bearings(140.0), bearings()):
        got = imm.step(start, motion, 1.0, imm.draw(rng, 2, 100), **heard._asdict())
        assert np.all(got.cloud.models == 1)
        np.testing.assert_allclose(got.estimate.mu, [0.0, 1.0], atol=1e-12)


def test_resampling_is_unbiased_and_never_takes_what_has_no_weight():
    rng = np.random.default_rng(10)
    w = rng.dirichlet(np.ones(15)).reshape(3, 5)
    w[2, 1] = w[0, 3] = 0.0
    w[:, 4] = 0.0
    w /= w.sum()
    counts, runs, n = np.zeros((3, 5)), 4000, 7
    for _ in range(runs):
        rows, models = imm.resample(w, rng.random(), rng.random(n))
        np.add.at(counts, (models, rows), 1)
    # At most the variance of n independent draws, 5 standard errors.
    assert np.all(np.abs(counts / (runs * n) - w) <= 5.0 * np.sqrt(w * (1 - w) / (runs * n)))


@pytest.mark.parametrize("pick", [0.0, 1.0 - 2.0**-53])
@pytest.mark.parametrize("model", [0, 1, 2])
def test_the_ends_of_the_draws_take_models_with_weight(pick, model):
    for share in np.random.default_rng(11).random(50):
        w = np.zeros((3, 2))
        w[model] = share, 1.0 - share
        _, models = imm.resample(w, 0.5, np.full(6, pick))
        assert np.all(models == model)
    smallest = np.zeros((3, 1))
    smallest[model] = 5e-324  # a pick near 1 times this rounds to this
    assert np.all(imm.resample(smallest, 0.5, np.full(2, pick))[1] == model)


def test_count_trigger():
    assert [imm.count_differs(n, 2) for n in (0, 1, 2, 3)] == [True, True, False, True]


@pytest.mark.parametrize(
    ("degrees", "heard", "wanted"),
    [
        (45.0, (45.0,), False),
        (45.0, (38.9,), True),  # 6.1 degrees off, the range is 6
        (45.0, (39.1,), False),
        (45.0, (51.1, 38.9), True),
        (45.0, (51.1, 40.0), False),  # one is enough
        (179.0, (-176.0,), False),  # 5 degrees across the cut
        (179.0, (-174.0,), True),
        (-179.0, (176.0 + 360.0,), False),
        (45.0, (), True),
    ],
)
def test_range_trigger(degrees, heard, wanted):
    a = math.radians(degrees)
    mean = np.array([25.0 + 8.0 * math.cos(a), 0.4, 22.0 + 8.0 * math.sin(a), -0.1])
    assert imm.outside_ranges(mean, *bearings(*heard)) is wanted


def state_covariance(xx, xy, yy):
    C = np.diag([0.0, 1.0, 0.0, 1.0])
    C[0, 0], C[0, 2], C[2, 0], C[2, 2] = xx, xy, xy, yy
    return C


@pytest.mark.parametrize(
    ("xy", "models", "wanted"),
    [
        # Half axes sqrt(5.991 * 4) = 4.895 and sqrt(5.991) = 2.448 about (0, 0).
        ((4.89, 0.0), [((0, 0), (4, 0, 1))], False),
        ((4.90, 0.0), [((0, 0), (4, 0, 1))], True),
        ((0.0, 2.44), [((0, 0), (4, 0, 1))], False),
        ((0.0, 2.45), [((0, 0), (4, 0, 1))], True),
        # Between two models that are apart, and inside one of the two.
        ((5.0, 0.0), [((0, 0), (1, 0, 1)), ((10, 0), (1, 0, 1))], True),
        ((5.0, 0.0), [((0, 0), (1, 0, 1)), ((7, 0), (1, 0, 1))], False),
        # Axes at 45 degrees: variances 1.9 along (1, 1) and 0.1 along (1, -1).
        ((2.3, 2.3), [((0, 0), (1, 0.9, 1))], False),
        ((0.6, -0.6), [((0, 0), (1, 0.9, 1))], True),
        # A point and a line.
        ((3.0, 3.0), [((3, 3), (0, 0, 0))], False),
        ((3.0, 3.1), [((3, 3), (0, 0, 0))], True),
        ((2.0, 0.0), [((0, 0), (1, 0, 0))], False),
        ((2.5, 0.0), [((0, 0), (1, 0, 0))], True),
        ((2.0, 0.1), [((0, 0), (1, 0, 0))], True),
        # No ellipse at all.
        ((0.0, 0.0), [((math.nan, math.nan), (math.nan,) * 3)], True),
    ],
)
def test_ellipse_trigger(xy, models, wanted):
    means = np.array([[m[0][0], 0.2, m[0][1], 0.3] for m in models], dtype=float)
    covariances = np.stack([state_covariance(*m[1]) for m in models])
    assert imm.outside_ellipses(np.array([xy[0], 9.0, xy[1], -9.0]), means, covariances) is wanted


def test_the_ellipse_holds_95_percent_of_a_gaussian():
    """Of 5,000 points; 4 standard errors are 1.2 %."""
    rng = np.random.default_rng(12)
    C = np.array([[2.0, -0.8], [-0.8, 1.0]])
    points = rng.multivariate_normal([1.0, 2.0], C, size=5_000)
    mean, full = np.array([[1.0, 0.0, 2.0, 0.0]]), state_covariance(2.0, -0.8, 1.0)[None]
    inside = np.mean([not imm.outside_ellipses(np.array([x, 0.0, y, 0.0]), mean, full) for x, y in points])
    assert abs(inside - 0.95) < 4.0 * math.sqrt(0.95 * 0.05 / 5_000)


def test_spread_trigger_looks_at_positions_only():
    C = state_covariance(9.0, 2.0, 16.0) + np.diag([0.0, 100.0, 0.0, 100.0])
    assert imm.position_sigma(C) == 5.0
    assert imm.position_sigma_exceeds(C, 4.99)
    assert not imm.position_sigma_exceeds(C, 5.0)
