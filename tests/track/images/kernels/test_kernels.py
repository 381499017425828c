"""Parts of trackers in images: motion, means, repulsion, bands, lines and the loop check."""

import numpy as np
import pytest
from ellipse_reference import pixels_inside

from occlog.core.geometry import fundamental
from occlog.core.image import N_BINS, support_radius
from occlog.track.methods.images.kernels.appearance import WIDTH, colour_similarity, colours_in
from occlog.track.methods.images.kernels.collaboration import (
    AT_REST,
    Interaction,
    add_inertia,
    neighbours,
    repel_into,
)
from occlog.track.methods.images.kernels.epipolar_lines import (
    APART,
    TOGETHER,
    UNKNOWN,
    add_band,
    anchor,
    drawn_on_lines,
    hysteresis,
    line_of,
    loop_check,
    reach_across,
)
from occlog.track.methods.images.kernels.motion import (
    EllipseMotion,
    boxes_of,
    covariance_and_ess,
    moved,
    resampled,
    weights_and_means,
)

SAME = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
MOTION = EllipseMotion(3.0, 0.9, 0.3, 0.15, 0.05, 0.8)
MODEL = Interaction(1.2, 0.6, 4, 5.0, 0.6, 2.0)


def ellipses(rng, *shape):
    out = rng.uniform([20, 20, 8, 5, -1.5], [80, 60, 14, 9, 1.5], (*shape, 5))
    return np.ascontiguousarray(out)


@pytest.mark.parametrize("gap", [1.0, 4.0])
def test_moments_of_the_motion(gap):
    rng, n = np.random.default_rng(1), 4000
    start = np.tile([50.0, 40.0, 11.0, 6.0, 0.3], (1, n, 1))
    velocity, axes = np.array([[2.0, -1.0]]), np.array([[10.0, 6.5, 0.1]])
    out = moved(start, velocity, axes, np.array([gap]), rng.standard_normal((1, n, 5)), MOTION)[0]
    back = axes[0] + [0.9**gap, 0.9**gap, 0.8**gap] * (start[0, 0, 2:] - axes[0])
    want = np.concatenate([start[0, 0, :2] + gap * velocity[0], back])
    sd = np.sqrt(gap) * np.array([3.0, 3.0, 0.3, 0.3, 0.05])
    # The half axes are cut at 15 %, here 2.5 to 3.3 standard deviations of one gap away: a few tails move the mean.
    assert (np.abs(out.mean(axis=0) - want) < 5 * sd / np.sqrt(n) + [0, 0, 0.02, 0.02, 0]).all()
    np.testing.assert_allclose(out.std(axis=0)[[0, 1, 4]], sd[[0, 1, 4]], rtol=5 / np.sqrt(2 * n))
    assert (np.abs(out[:, 2:4] / axes[0, :2] - 1.0) <= 0.15 + 1e-12).all()


def test_angles_are_averaged_as_axes():
    particles = np.zeros((1, 2, 5))
    particles[0, :, 2:4], particles[0, :, 4] = [8.0, 4.0], [-np.pi / 2 + 0.1, np.pi / 2 - 0.3]
    weights, mean = weights_and_means(particles, np.zeros((1, 2)))
    np.testing.assert_allclose(weights, 0.5)
    assert mean[0, 4] == pytest.approx(np.pi / 2 - 0.1)


def test_weights_without_any_likelihood_are_equal():
    particles = ellipses(np.random.default_rng(2), 1, 4)
    weights, mean = weights_and_means(particles, np.full((1, 4), -np.inf))
    np.testing.assert_allclose(weights, 0.25)
    np.testing.assert_allclose(mean[0, :4], particles[0, :, :4].mean(axis=0))


@pytest.mark.parametrize("level", [-1000.0, 0.0, 1000.0])
def test_weights_do_not_depend_on_the_level_of_their_logarithms(level):
    rng = np.random.default_rng(11)
    particles, log_weights = ellipses(rng, 2, 5), rng.standard_normal((2, 5))
    weights, _ = weights_and_means(particles, log_weights + level)
    np.testing.assert_allclose(weights, np.exp(log_weights) / np.exp(log_weights).sum(axis=1, keepdims=True))


def test_spreads_are_those_of_weighted_samples():
    rng = np.random.default_rng(3)
    particles, log_weights = ellipses(rng, 2, 30), rng.standard_normal((2, 30))
    weights, mean = weights_and_means(particles, log_weights)
    covariance, ess = covariance_and_ess(particles, weights, mean)
    for i in range(2):
        want = np.cov(particles[i, :, :2].T, aweights=weights[i], ddof=0)
        np.testing.assert_allclose(covariance[i], want[[0, 0, 1], [0, 1, 1]])
        assert ess[i] == pytest.approx(1 / (weights[i] ** 2).sum())


def test_particles_are_drawn_as_often_as_their_weights_say():
    particles = ellipses(np.random.default_rng(4), 1, 4)
    out = resampled(particles, np.array([[0.5, 0.0, 0.25, 0.25]]), np.array([0.4]))
    np.testing.assert_array_equal(out[0], particles[0, [0, 0, 2, 3]])


def test_boxes_hold_all_pixels():
    particles = ellipses(np.random.default_rng(5), 2, 6)
    for box, some in zip(boxes_of(particles), particles, strict=True):
        pixels = np.concatenate([pixels_inside(e) for e in some])
        assert (pixels >= box[:2]).all()
        assert (pixels < box[2:]).all()


def test_bottom_is_the_lowest_point():
    e = np.array([30.0, 20.0, 12.0, 5.0, 0.7])
    angle = np.linspace(0, 2 * np.pi, 20001)
    u, v, c, s = 12 * np.cos(angle), 5 * np.sin(angle), np.cos(0.7), np.sin(0.7)
    x, y = 30 + c * u - s * v, 20 + s * u + c * v
    np.testing.assert_allclose(anchor(e, SAME, True), [x[y.argmax()], y.max()], atol=1e-2)
    assert anchor(e, SAME, False) == (30.0, 20.0)


def rig(seed):
    """A fundamental matrix of two cameras that point at the same place, as (2, 2, 3, 3)."""
    rng = np.random.default_rng(seed)
    f = fundamental.scaled(np.array([[0, 0, 0.2], [0, 0, -1.0], [-0.1, 1.1, 3.0]]) + 1e-4 * rng.standard_normal((3, 3)))
    u, s, v = np.linalg.svd(f)
    f = u @ np.diag([s[0], s[1], 0.0]) @ v
    out = np.full((2, 2, 3, 3), np.nan)
    out[0, 1], out[1, 0] = f, f.T
    return out


def test_band_weights_are_those_of_point_line_distances():
    rng, f = np.random.default_rng(6), rig(6)
    particles, other = ellipses(rng, 9), np.array([33.0, 44.0])
    line = line_of(f[0, 1], *other)
    log_w = np.zeros(9)
    add_band(log_w, particles, SAME, False, line, 2.5)
    d = fundamental.line_distances(fundamental.epipolar_lines(f[0, 1], other), particles[:, :2])
    np.testing.assert_allclose(np.exp(log_w), np.exp(-(d**2) / (2 * 2.5**2)))
    # With distortion: the distance is that of the point without it.
    affine = np.array([[1.1, 0.1, -3.0], [-0.05, 0.9, 4.0]])
    log_w[:] = 0.0
    add_band(log_w, particles, affine, False, line, 2.5)
    d = np.append(particles[:, :2] @ affine[:, :2].T + affine[:, 2], np.ones((9, 1)), axis=1) @ line
    np.testing.assert_allclose(log_w, -(d**2) / (2 * 2.5**2))


def test_reach_across_is_the_support_radius():
    e = np.array([0.0, 0.0, 9.0, 4.0, 0.4])
    assert reach_across(e, np.cos(1.3), np.sin(1.3)) == pytest.approx(float(support_radius(e, 1.3)))


@pytest.mark.parametrize("seed", range(4))
def test_loop_check_is_that_of_epipolar_geometry(seed):
    rng, f = np.random.default_rng(seed), rig(seed)
    outcomes = []
    for _ in range(30):
        pair = ellipses(rng, 2)
        pair[:, 2:4] = 12.0  # circles, of which the reach is the same in all directions
        found = loop_check(pair, np.stack([SAME, SAME]), np.array([0, 1]), np.array([[-1, 1], [0, -1]]), f, False)
        want = (fundamental.epipolar_distances(f[0, 1], pair[:1, :2], pair[1:, :2]) <= 12.0).all()
        assert found.tolist() == [[UNKNOWN, int(want)], [int(want), UNKNOWN]]
        outcomes.append(bool(want))
    assert set(outcomes) == {True, False}


def test_loop_check_without_matrix_says_nothing():
    pair = ellipses(np.random.default_rng(1), 2)
    unknown = np.full((2, 2, 3, 3), np.nan)
    found = loop_check(pair, np.stack([SAME, SAME]), np.array([0, 1]), np.array([[-1, 1], [0, -1]]), unknown, False)
    assert (found == UNKNOWN).all()


def test_hysteresis_by_hand():
    good, run = np.array([True]), np.array([0])
    reported = []
    for outcome in [APART] * 3 + [TOGETHER] + [APART] * 2 + [UNKNOWN] * 4 + [APART] * 2 + [TOGETHER] * 2:
        good, run = hysteresis(np.array([outcome]), good, run, 4, 2)
        reported.append(bool(good[0]))
    # Three in a row are not enough, one that holds starts the count again, unknown ones do not count.
    assert reported == [True] * 11 + [False, False, True]


def test_repulsion_by_the_printed_formula():
    rng = np.random.default_rng(8)
    particles, log_w = ellipses(rng, 3, 20), rng.standard_normal((3, 20))
    base, mean = weights_and_means(particles, log_w)
    touching = np.array([[False, True, True], [True, False, False], [True, False, False]])
    weights, estimate = base.copy(), mean.copy()
    repel_into(weights, estimate, particles, np.arange(3), touching, MODEL)
    now = mean
    for _ in range(MODEL.iterations):
        phi = np.ones((3, 20))
        for i, j in zip(*np.nonzero(touching), strict=True):
            theta = np.arctan2(now[j, 1] - now[i, 1], now[j, 0] - now[i, 0])
            sigma = 0.6 * (support_radius(now[i], theta) + support_radius(now[j], theta)) / 2
            d2 = ((particles[i, :, :2] - now[j, :2]) ** 2).sum(axis=1)
            phi[i] *= 1 - np.exp(-d2 / sigma**2) / 1.2
        want, now = weights_and_means(particles, np.log(base * phi))
    np.testing.assert_allclose(weights, want)
    np.testing.assert_allclose(estimate, now)


def test_neighbours_are_within_a_view():
    e = np.array([[0.0, 0, 5, 5, 0], [9.0, 0, 5, 5, 0], [21.0, 0, 5, 5, 0], [9.0, 0, 5, 5, 0]])
    near = neighbours(e, np.array([0, 0, 0, 1]), 1.0, 1.5)
    assert np.argwhere(near.touching).tolist() == [[0, 1], [1, 0]]
    assert near.busy.tolist() == [True, True, True, False]
    np.testing.assert_allclose(near.ratio, [0.9, 0.9, 1.2, np.inf])


def test_inertia_by_the_printed_formula():
    rng, previous, before = np.random.default_rng(12), np.array([50.0, 40.0]), np.array([3.0, -1.5])
    particles, log_w = ellipses(rng, 20), rng.standard_normal(20)
    steps = rng.normal(0.0, 4.0, (20, 2))
    steps[:3] = [0.3, 0.1], -before, before
    particles[:, :2] = previous + steps
    for reference in (before, 0.1 * before):
        got, usual = log_w.copy(), np.hypot(*reference)
        add_inertia(got, particles, previous, reference, MODEL)
        for p, step in enumerate(steps):
            speed = np.hypot(*step)
            turn = np.arccos(np.clip(step @ reference / (speed * usual), -1.0, 1.0))
            turn = turn if min(speed, usual) > AT_REST else 0.0
            gain = 5.0 * np.exp(-((turn / 0.6) ** 2)) * np.exp(-(((speed - usual) / 2.0) ** 2))
            assert got[p] == pytest.approx(log_w[p] + np.log(1.0 + gain))


def test_particles_on_lines():
    """Each at the distances from the lines and along them that its numbers state, of the targets' points."""
    rng, n = np.random.default_rng(9), 12
    f, trio = rng.normal(size=(3, 3, 3, 3)), ellipses(rng, 3)
    particles = np.repeat(trio[:, None], n, axis=1) + rng.normal(0.0, 2.0, (3, n, 5)) * [1.0, 1.0, 0.0, 0.0, 0.0]
    affine = np.stack([np.array([[1.1, 0.2, -3.0], [-0.1, 0.9, 4.0]]), SAME, SAME])
    counterpart, normals = np.array([[-1, 1, 2], [0, -1, -1], [-1, -1, -1]]), rng.standard_normal((3, n, 2))
    args = affine, np.arange(3), counterpart, f, False
    out = drawn_on_lines(particles, trio, *args, np.array([n - 2, 0, n]), 15.0, 0.5, normals)
    # The last has no counterpart
    np.testing.assert_array_equal(out[1:], particles[1:])
    np.testing.assert_array_equal(out[0, n - 2 :], particles[0, n - 2 :])
    np.testing.assert_array_equal(out[0, :, 2:], particles[0, :, 2:])
    lines = np.array([line_of(f[k, 0], *anchor(trio[k], affine[k], False)) for k in (1, 2)])
    middle = np.array(anchor(trio[0], affine[0], False))
    for p in range(n - 2):
        line = lines[p % 2]
        x, along = affine[0, :, :2] @ out[0, p, :2] + affine[0, :, 2], np.array([-line[1], line[0]])
        sigma = 0.5 * reach_across(trio[0], line[0], line[1])
        assert x @ line[:2] + line[2] == pytest.approx(sigma * normals[0, p, 1])
        assert (x - middle) @ along == pytest.approx(15.0 * normals[0, p, 0])


def test_halves_of_an_ellipse():
    rng = np.random.default_rng(10)
    bins = rng.integers(0, 5, (60, 80)).astype(np.uint8)
    some = ellipses(rng, 12) - [15.0, 12.0, 0, 0, 0]  # some reach over the edge
    halves, whole = (colours_in(bins, some, np.full(12, split), 2) for split in (True, False))
    np.testing.assert_allclose(halves[:, :N_BINS] + halves[:, N_BINS:], whole[:, :N_BINS], atol=1e-12)
    for e, found in zip(some, halves, strict=True):
        want, mass = np.zeros(WIDTH), 0.0
        for x, y in pixels_inside(e, step=2):
            c, s, dx, dy = np.cos(e[4]), np.sin(e[4]), x - e[0], y - e[1]
            weight = 1 - ((c * dx + s * dy) / e[2]) ** 2 - ((c * dy - s * dx) / e[3]) ** 2
            mass += weight
            if 0 <= x < 80 and 0 <= y < 60:
                want[bins[y, x] + (N_BINS if dy >= 0 else 0)] += weight
        np.testing.assert_allclose(found, want / mass, atol=1e-12)
    models, owner = np.stack([whole[0], halves[1]]), rng.integers(0, 2, 12)
    got = colour_similarity(bins, some, owner, models, np.array([False, True]), 2)
    want = np.where(owner == 0, np.sqrt(whole * models[0]).sum(axis=1), np.sqrt(halves * models[1]).sum(axis=1))
    np.testing.assert_allclose(got, want, atol=1e-12)
