"""Likelihoods in space and in planes against slow forms; motion and resampling of clouds against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.core.bounds import in_space as bounds3d
from occlog.core.geometry import projected_planes
from occlog.core.geometry.camera import array_rotation, wrap_angle
from occlog.core.numerics.special_functions import fast_atan2
from occlog.filtering.kernel_density import moments, resample_with_kernel, silverman_bandwidth, update_weights
from occlog.filtering.motion.coordinated_turn import acceleration_root, turn_matrix
from occlog.filtering.motion.white_acceleration import AccelerationModel, known_jump, moved, turn_jump
from occlog.filtering.particles import effective_sample_size, normalise_log_weights
from occlog.track.methods.in_space.kernels.likelihood import (
    UNIFORM,
    UNIFORM_AZIMUTH,
    ReportProbabilities,
    ScanDirectionSet,
    log_cone,
    log_in_plane,
    log_product,
    scan_log_likelihood,
)

POSES = [np.eye(3), array_rotation(0.4, 0.7, -0.3), array_rotation(-2.5, -1.2, 1.9)]
SIGMA_THETA, SIGMA_PHI = 0.07, 0.05


def sights(theta, phi, rotation, position=(1.0, -2.0, 0.5), reach=math.inf) -> ScanDirectionSet:
    """One labelled sensor with a row for each measured direction in its own frame."""
    theta, phi = np.atleast_1d(theta), np.atleast_1d(phi)
    n = len(theta)
    frame = []
    for t in theta:
        own = np.array([[math.cos(t), math.sin(t), 0], [-math.sin(t), math.cos(t), 0], [0, 0, 1]])
        frame.append(own @ rotation.T)
    return ScanDirectionSet(
        np.arange(n + 1),
        np.ones(n, dtype=bool),
        np.tile(position, (n, 1)).astype(float),
        np.array(frame),
        phi,
        np.full(n, SIGMA_THETA),
        np.full(n, SIGMA_PHI),
        np.full(n, reach),
        np.ones(n),
    )


def gauss(x, sigma):
    return math.exp(-0.5 * (x / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)


def slow_product(point, theta, phi, rotation, position=(1.0, -2.0, 0.5)):
    """Density of folded angles: every way over a pole that comes into question is summed."""
    true_theta, true_phi = bounds3d.sight_angles(point[None], np.array(position), rotation)
    direct = gauss(float(wrap_angle(theta - true_theta[0])), SIGMA_THETA)
    over = gauss(float(wrap_angle(theta + math.pi - true_theta[0])), SIGMA_THETA)
    p = float(true_phi[0])
    fold = gauss(-phi - p, SIGMA_PHI) + gauss(2.0 * math.pi - phi - p, SIGMA_PHI)
    return direct * gauss(phi - p, SIGMA_PHI) + over * fold


def test_fast_arctangent_is_that_of_numpy_to_the_last_digits() -> None:
    rng = np.random.default_rng(0)
    y, x = rng.standard_normal((2, 5000)) * 10.0 ** rng.uniform(-6, 6, (2, 5000))
    y[:8], x[:8] = [0, 0, 0, 1, -1, 1, 1, -1], [0, 1, -1, 0, 0, 1, -1, -1]
    ours = np.array([fast_atan2(float(a), float(b)) for a, b in zip(y, x, strict=True)])
    np.testing.assert_allclose(ours, np.arctan2(y, x), rtol=0, atol=1e-15)


@pytest.mark.parametrize("pose", range(3))
@pytest.mark.parametrize("seed", range(3))
def test_product_is_the_slow_form(pose: int, seed: int) -> None:
    rng = np.random.default_rng([pose, seed])
    points = rng.uniform(-6, 6, (3, 40))
    theta, phi = rng.uniform(-math.pi, math.pi, 6), np.append(rng.uniform(0, math.pi, 4), [0.03, math.pi - 0.02])
    got = np.exp(log_product(points, sights(theta, phi, POSES[pose]), 1.0))
    expected = [[slow_product(p, t, f, POSES[pose]) for p in points.T] for t, f in zip(theta, phi, strict=True)]
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("polar", [1e-6, 0.02, 0.1, 1.3, math.pi - 0.04])
def test_product_is_a_density_of_the_measured_angles_near_the_poles_too(polar: float) -> None:
    """Sum over all measurements for one place; the grid is fine enough for 1e-6."""
    n = 250
    theta, phi = np.meshgrid((np.arange(n) + 0.5) * 2 * math.pi / n, (np.arange(n) + 0.5) * math.pi / n)
    d = projected_planes.direction(np.array(0.7), np.array(polar))
    point = (np.array([1.0, -2.0, 0.5]) + 3.0 * d)[:, None]
    s = sights(np.zeros(1), np.zeros(1), np.eye(3))
    t, f = theta.ravel(), phi.ravel()
    frame = np.zeros((n * n, 3, 3))
    frame[:, 0, 0], frame[:, 0, 1] = np.cos(t), np.sin(t)
    frame[:, 1, 0], frame[:, 1, 1], frame[:, 2, 2] = -np.sin(t), np.cos(t), 1.0
    many = s._replace(
        position=np.tile(s.position, (n * n, 1)),
        frame=frame,
        phi=f,
        sigma_theta=np.full(n * n, SIGMA_THETA),
        sigma_phi=np.full(n * n, SIGMA_PHI),
        reach=np.full(n * n, np.inf),
    )
    total = np.exp(log_product(point, many, 1.0)).sum() * 2 * math.pi**2 / n**2
    assert total == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("pose", range(3))
def test_cone_is_gaussian_in_the_angle_from_the_sight_line(pose: int) -> None:
    rng = np.random.default_rng(pose)
    points, position = rng.uniform(-6, 6, (3, 30)), np.array([1.0, -2.0, 0.5])
    theta, phi = 0.8, 1.1
    line = POSES[pose] @ projected_planes.direction(np.array(theta), np.array(phi))
    to = (points.T - position) / np.linalg.norm(points.T - position, axis=1)[:, None]
    angle = np.arccos(np.clip(to @ line, -1, 1))
    spread2 = math.sin(phi) ** 2 + (math.cos(phi) * SIGMA_PHI) ** 2
    variance = 0.5 * (spread2 * SIGMA_THETA**2 + SIGMA_PHI**2)
    expected = -0.5 * angle**2 / variance - math.log(2 * math.pi * variance) + 0.5 * math.log(spread2)
    got = log_cone(points, sights(theta, phi, POSES[pose]), 1.0)[0]
    np.testing.assert_allclose(got, expected, rtol=1e-7)


def test_densities_of_false_reports_are_even_over_all_angles() -> None:
    assert UNIFORM * 2.0 * math.pi * math.pi == pytest.approx(1.0)
    assert UNIFORM_AZIMUTH * 2.0 * math.pi == pytest.approx(1.0)


def test_an_azimuth_alone_says_nothing_of_the_height() -> None:
    s = sights(0.3, np.nan, np.eye(3))
    column = np.array([[4.0] * 5, [1.0] * 5, [-3.0, 0.0, 1.0, 2.0, 9.0]])
    for likelihood in (log_product, log_cone):
        got = likelihood(column, s, 1.0)[0]
        np.testing.assert_allclose(got, math.log(gauss(math.atan2(3.0, 3.0) - 0.3, SIGMA_THETA)), rtol=1e-12)


def test_out_of_range_is_softened() -> None:
    points = np.array([[3.0, 30.0], [-2.0, -2.0], [0.5, 0.5]])
    for likelihood in (log_product, log_cone):
        near, far = likelihood(points, sights(0.0, math.pi / 2, np.eye(3), reach=5.0), 0.01)[0]
        assert near - far == pytest.approx(-math.log(0.01))
    near, far = log_in_plane(points[:2], np.array([[1.0, -2.0]]), np.zeros(1), np.ones(1), np.array([5.0]), 0.01)[0]
    assert near - far == pytest.approx(-math.log(0.01))


@pytest.mark.parametrize("plane", range(3))
def test_planes_density_is_that_of_the_projected_angle(plane: int) -> None:
    rng = np.random.default_rng(plane)
    points, position, angle = rng.uniform(-5, 5, (3, 50)), np.array([1.0, -2.0, 0.5]), 3.0
    axes = list(projected_planes.AXES[plane])
    off = wrap_angle(projected_planes.projected_angles(points.T - position)[:, plane] - angle)
    got = log_in_plane(points[axes], position[axes][None], np.array([angle]), np.array([0.2]), np.array([np.inf]), 1.0)
    np.testing.assert_allclose(got[0], [math.log(gauss(x, 0.2)) if abs(x) < 6 else 0 for x in off], rtol=1e-9)


def test_scan_is_the_better_of_target_and_nothing_or_a_mixture_of_candidates() -> None:
    rng = np.random.default_rng(1)
    each, share = rng.normal(0.0, 3.0, (4, 10)), np.array([1.0, 0.5, 0.9, 0.2])
    uniform, chances = np.array([0.05, 0.05, 0.16, 0.16]), ReportProbabilities(0.1, 1.0, 0.8, 2.0)
    got = scan_log_likelihood(each, np.array([0, 1, 1, 4]), np.array([True, True, False]), share, uniform, chances)
    for k in range(10):
        labelled = max(0.9 * math.exp(each[0, k]), 0.1 * 0.05)
        mixed = 0.2 + sum(0.8 / 2.0 * share[r] * math.exp(each[r, k]) / uniform[r] for r in (1, 2, 3))
        assert got[k] == pytest.approx(math.log(labelled) + math.log(mixed))


def test_known_acceleration_moves_as_the_path_of_the_bound() -> None:
    state, a, rng = np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3]), np.array([0.5, -0.1, 0.2]), np.random.default_rng(0)
    got = moved(state[:, None], AccelerationModel(a, np.zeros(3)), 0.7, rng)
    np.testing.assert_allclose(got[:, 0], bounds3d.accelerated_path(state, a[None], np.array([0.7]))[0])
    again = moved(
        moved(state[:, None], AccelerationModel(a, np.zeros(3)), 0.3, rng), AccelerationModel(a, np.zeros(3)), 0.4, rng
    )
    np.testing.assert_allclose(again, got)
    assert known_jump(a, 2.0).tolist() == [1.0, -0.2, 0.4, 1.0, -0.2, 0.4]


@pytest.mark.parametrize("axes", projected_planes.AXES)
def test_turn_is_that_of_the_plane_and_leaves_the_third_axis_alone(axes: tuple[int, int]) -> None:
    state, rng = np.array([1.0, 2.0, 3.0, 0.6, -0.2, 0.8]), np.random.default_rng(0)
    i, j = axes
    rate = -0.3 / math.hypot(state[3 + i], state[3 + j])
    got = moved(state[:, None], AccelerationModel(np.zeros(3), np.zeros(3), -0.3, axes), 1.7, rng)[:, 0]
    rows = [i, i + 3, j, j + 3]
    np.testing.assert_allclose(got[rows], turn_matrix(rate, 1.7) @ state[rows], rtol=1e-12)
    k = 3 - i - j
    np.testing.assert_allclose(got[[k, k + 3]], [state[k] + 1.7 * state[k + 3], state[k + 3]])
    change = turn_jump(state[[3 + i, 3 + j]], -0.3, 1.7)
    straight = state + np.append(1.7 * state[3:], np.zeros(3))
    np.testing.assert_allclose(change, (got - straight)[[i, j, i + 3, j + 3]], atol=1e-12)


@pytest.mark.jit
def test_noise_has_the_covariance_of_white_acceleration() -> None:
    rng, n, q, dt = np.random.default_rng(4), 200_000, np.array([0.5, 0.0, 2.0]), 0.8
    cloud = moved(np.zeros((6, n)), AccelerationModel(np.zeros(3), q), dt, rng)
    root = acceleration_root(1.0, dt)
    for k in range(3):
        pair = cloud[[k, k + 3]]
        # Each draw serves two: relative standard error of a variance sqrt(4 / n) = 0.45 %; five of them
        np.testing.assert_allclose(pair @ pair.T / n, q[k] * root @ root.T, rtol=0.023)
        np.testing.assert_allclose(pair.mean(axis=1), 0.0, atol=1e-12)


@pytest.mark.parametrize("d", [4, 6])
def test_drawing_again_keeps_mean_and_covariance_and_no_two_particles_alike(d: int) -> None:
    rng = np.random.default_rng(d)
    mix = rng.standard_normal((d, d))
    cloud = mix @ rng.standard_normal((d, 4000)) + 3.0
    weights = rng.random(4000) ** 4
    weights /= weights.sum()
    mean, covariance = moments(cloud, weights)
    h = silverman_bandwidth(20_000, d)
    new = resample_with_kernel(cloud, weights, mean, covariance, 20_000, h, rng)
    after, spread = moments(new, np.full(20_000, 1 / 20_000))
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(after, mean, atol=5 * sd.max() / math.sqrt(20_000))
    # Each draw serves two, so elements of a covariance have a standard error of at most sqrt(4 / n) sd sd; five of them
    assert np.all(np.abs(spread - covariance) <= 5 * math.sqrt(4 / 20_000) * np.outer(sd, sd))
    assert len(np.unique(new[0])) == 20_000
    copies = resample_with_kernel(cloud, weights, mean, covariance, 500, 0.0, rng)
    assert np.isin(copies[0], cloud[0]).all()


def test_a_cloud_of_one_place_stays_there() -> None:
    cloud, rng = np.full((4, 10), 2.0), np.random.default_rng(0)
    mean, covariance = moments(cloud, np.full(10, 0.1))
    np.testing.assert_allclose(resample_with_kernel(cloud, np.full(10, 0.1), mean, covariance, 10, 0.5, rng), 2.0)


def test_a_scan_that_hardly_a_particle_agrees_with_leaves_some_of_them() -> None:
    prior, x = np.full(1000, -math.log(1000)), np.linspace(0.0, 10.0, 1000)
    mild, sharp = -0.5 * (x - 5.0) ** 2, -0.5 * ((x - 30.0) / 0.01) ** 2
    for reported in (mild, sharp):
        weights, log_sum = update_weights(prior, reported, 12.0)
        expected, total = normalise_log_weights(prior + reported)
        assert log_sum == total
        if reported is mild:
            np.testing.assert_array_equal(weights, expected)
        else:
            assert effective_sample_size(expected) < 1.001
            assert effective_sample_size(weights) == pytest.approx(12.0, rel=1e-3)
            assert weights @ x > 9.8  # at the side where the scan is
    assert update_weights(prior, np.full(1000, -math.inf), 12.0)[1] == -math.inf
    some = np.where(x > 5, 0.0, -math.inf)
    assert update_weights(prior, some, 900.0)[0].sum() == pytest.approx(1.0)
