"""Projected planes: angles by trigonometry, gradients by differences, variances by Monte Carlo, selection by search."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from space_reference import measured_angle_gradients, pair_covariance

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry import projected_planes
from occlog.core.geometry.camera import rotation_from_angles, wrap_angle
from occlog.core.geometry.projected_planes import XY, YZ, ZX

POSES = [np.eye(3), rotation_from_angles(0.4, 0.7, -0.3), rotation_from_angles(-2.5, -1.2, 1.9)]


def sphere(seed: int, n: int) -> tuple[Floats, Floats, Floats]:
    """Evenly spread unit vectors (n, 3), their theta and phi."""
    u = np.random.default_rng(seed).standard_normal((n, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    return u, *projected_planes.direction_angles(u)


def test_directions_and_their_angles_are_inverse_and_elevation_counts_from_the_ground() -> None:
    u, theta, phi = sphere(0, 500)
    np.testing.assert_allclose(projected_planes.direction(theta, phi), u, atol=1e-14)
    np.testing.assert_allclose(projected_planes.direction(np.array(0.0), np.array(0.0)), [0, 0, 1])
    np.testing.assert_allclose(
        projected_planes.direction(np.array(np.pi / 2), np.array(np.pi / 2)), [0, 1, 0], atol=1e-15
    )
    np.testing.assert_allclose(projected_planes.polar_from_elevation(np.arcsin(u[:, 2])), phi, atol=1e-7)


def test_projected_angles_are_those_of_plain_trigonometry_on_the_whole_sphere() -> None:
    u, _, _ = sphere(1, 2000)
    angles = projected_planes.projected_angles(3.7 * u)
    assert np.all((angles >= -np.pi) & (angles < np.pi))
    for plane, (a, b) in enumerate(projected_planes.AXES):
        flat = np.hypot(u[:, a], u[:, b])
        # Angle from the first axis by the arc cosine, its sign by the second axis
        expected = np.arccos(np.clip(u[:, a] / flat, -1, 1)) * np.sign(u[:, b])
        # near 0 and pi the arc cosine is right to the root of the rounding only
        np.testing.assert_allclose(wrap_angle(angles[:, plane] - expected), 0, atol=1e-7)
    assert projected_planes.PLANES == ("xy", "yz", "zx")
    x, y, z = np.array([[1.0, 2.0, 3.0]]).T
    expected = np.column_stack([np.arctan2(y, x), np.arctan2(z, y), np.arctan2(x, z)])
    np.testing.assert_allclose(projected_planes.projected_angles(np.array([[1.0, 2.0, 3.0]])), expected)


@pytest.mark.parametrize("pose", range(3))
def test_gradients_are_those_of_numerical_differentiation(pose: int) -> None:
    R, h = POSES[pose], 1e-6

    def angles(theta: Floats, phi: Floats) -> Floats:
        return projected_planes.projected_angles(projected_planes.direction(theta, phi) @ R.T)

    _, theta, phi = sphere(4, 300)
    by_theta = wrap_angle(angles(theta + h, phi) - angles(theta - h, phi)) / (2 * h)
    by_phi = wrap_angle(angles(theta, phi + h) - angles(theta, phi - h)) / (2 * h)
    gradients = measured_angle_gradients(theta, phi, R)
    np.testing.assert_allclose(gradients, np.stack([by_theta, by_phi], axis=-1), rtol=1e-5, atol=1e-6)
    v = 4.0 * projected_planes.direction(theta, phi)
    for axis, step in enumerate(np.eye(3) * h):
        slope = wrap_angle(
            projected_planes.projected_angles(v + step) - projected_planes.projected_angles(v - step)
        ) / (2 * h)
        np.testing.assert_allclose(
            projected_planes.projected_angle_gradients(v)[..., axis], slope, rtol=1e-5, atol=1e-6
        )


def test_gradients_and_variances_of_an_upright_sensor_are_the_written_out_formulas() -> None:
    _, theta, phi = sphere(5, 300)
    s, c, ct, sn = np.sin(phi), np.cos(phi), np.cos(theta), np.sin(theta)
    yz = np.column_stack([-s * c * ct, -sn]) / (1 - s**2 * ct**2)[:, None]
    zx = np.column_stack([-s * c * sn, ct]) / (1 - s**2 * sn**2)[:, None]
    G = measured_angle_gradients(theta, phi, np.eye(3))
    np.testing.assert_allclose(G[:, XY], np.tile([1.0, 0.0], (300, 1)), atol=1e-9)
    np.testing.assert_allclose(G[:, YZ], yz, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(G[:, ZX], zx, rtol=1e-9, atol=1e-12)
    covariance = projected_planes.projected_covariance(theta, phi, 0.05, 0.05, np.eye(3))
    variance = np.diagonal(covariance, axis1=1, axis2=2) / 0.05**2
    by_hand = [
        np.ones(300),
        (s**2 * c**2 * ct**2 + sn**2) / (1 - s**2 * ct**2) ** 2,
        (s**2 * c**2 * sn**2 + ct**2) / (1 - s**2 * sn**2) ** 2,
    ]
    np.testing.assert_allclose(variance, np.column_stack(by_hand), rtol=1e-9)
    pair = pair_covariance(covariance, (ZX, YZ))
    np.testing.assert_allclose(pair[:, 0, 1], 0.05**2 * np.sum(yz * zx, axis=1), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(pair[:, 0, 0], 0.05**2 * by_hand[ZX], rtol=1e-9)


def scatter(theta: float, phi: float, sigmas: tuple[float, float], R: Floats) -> Floats:
    """(3,) variances of the projected angles of noisy measurements, by Gauss-Hermite quadrature over the noise."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    weight = np.outer(weights, weights).ravel() / weights.sum() ** 2
    off_theta, off_phi = (g.ravel() for g in np.meshgrid(sigmas[0] * nodes, sigmas[1] * nodes, indexing="ij"))
    true = projected_planes.projected_angles(R @ projected_planes.direction(np.array(theta), np.array(phi)))
    noisy = projected_planes.projected_angles(projected_planes.direction(theta + off_theta, phi + off_phi) @ R.T)
    off = wrap_angle(noisy - true)
    return weight @ off**2 - (weight @ off) ** 2


@pytest.mark.parametrize("sigma_deg", [1.0, 3.0**0.5, 3.0])
def test_first_order_variances_hold_within_5_percent_for_equal_sigmas(sigma_deg: float) -> None:
    sigma = np.deg2rad(sigma_deg)
    _, theta, phi = sphere(7, 60)
    for t, p in zip(theta, phi, strict=True):
        if min(p, np.pi - p) < 5 * sigma:
            continue
        measured = scatter(t, p, (sigma, sigma), np.eye(3))
        blind = projected_planes.blind_planes(t, p, sigma, sigma, np.eye(3))
        formula = np.diagonal(projected_planes.projected_covariance(t, p, sigma, sigma, np.eye(3)))
        np.testing.assert_allclose(formula[~blind], measured[~blind], rtol=0.05)


@pytest.mark.parametrize("pose", range(3))
@pytest.mark.parametrize("sigmas", [(0.03, 0.03), (0.04, 0.015), (0.015, 0.04)])
def test_first_order_variances_hold_for_any_pose_and_sigmas_a_little_farther_off(
    pose: int, sigmas: tuple[float, float]
) -> None:
    """Across the longer axis of the scatter the error at k sigma is 3/k^2 and higher orders: 6.3 % at 8 sigma."""
    R, far = POSES[pose], 8 / 5
    _, theta, phi = sphere(9, 30)
    for t, p in zip(theta, phi, strict=True):
        if min(p, np.pi - p) < 8 * max(sigmas):
            continue
        near = projected_planes.blind_planes(t, p, far * sigmas[0], far * sigmas[1], R)
        formula = np.diagonal(projected_planes.projected_covariance(t, p, *sigmas, R))
        np.testing.assert_allclose(formula[~near], scatter(t, p, sigmas, R)[~near], rtol=0.063)


@pytest.mark.parametrize("phi_in_sigmas", [0.0, 0.5, 1.0, 3.0])
def test_pole_term_holds_on_the_sensors_axis_where_the_first_order_is_too_small(phi_in_sigmas: float) -> None:
    sigma = 0.03
    for t in (0.0, 0.3, 2.0):
        p = phi_in_sigmas * sigma
        measured = scatter(t, p, (sigma, sigma), np.eye(3))[1:]
        mended = projected_planes.projected_covariance(t, p, sigma, sigma, np.eye(3), pole_term=True)
        plain = projected_planes.projected_covariance(t, p, sigma, sigma, np.eye(3))
        np.testing.assert_allclose(np.diagonal(mended)[1:], measured, rtol=0.05)
        assert np.all(np.diagonal(plain) <= np.diagonal(mended))
    overhead = projected_planes.projected_covariance(0.0, 0.0, sigma, sigma, np.eye(3))
    assert overhead[YZ, YZ] == 0.0


def test_planes_are_blind_along_their_normals_in_the_world() -> None:
    sigma = 0.02
    for R, (normal, plane) in itertools.product(POSES, ((2, XY), (0, YZ), (1, ZX))):
        axis, side = np.eye(3)[normal], np.eye(3)[(normal + 1) % 3]
        for sign, (angle, expected) in itertools.product((1, -1), ((4.9 * sigma, True), (8 * sigma, False))):
            u = sign * np.cos(angle) * axis + np.sin(angle) * side
            theta, phi = projected_planes.direction_angles(u @ R)
            blind = projected_planes.blind_planes(theta, phi, sigma, sigma, R)
            assert blind[plane] == expected
            assert blind.sum() == expected


def best_pair(variance: Floats, blind: Bools) -> list[tuple[int, int]]:
    """The rule by search, for one time."""
    free = [(variance[s, p], s, p) for s in range(len(variance)) for p in range(3) if not blind[s, p]]
    chosen: list[tuple[int, int]] = []
    for _, s, p in sorted(free):
        if len(chosen) < 2 and p not in [plane for _, plane in chosen]:
            chosen.append((s, p))
    return chosen + [(-1, -1)] * (2 - len(chosen))


@given(st.integers(1, 5), st.integers(0, 10_000), st.floats(0.0, 1.0))
def test_selection_by_variance_is_the_search_and_never_takes_a_blind_plane(
    sensors: int, seed: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    variance, blind = rng.uniform(0.1, 5.0, (4, sensors, 3)), rng.uniform(size=(4, sensors, 3)) < share
    chosen = projected_planes.select_by_variance(variance, blind)
    for k in range(4):
        assert [tuple(row) for row in chosen[k]] == best_pair(variance[k], blind[k])
    unmeasured = np.where(blind, np.nan, variance)
    np.testing.assert_array_equal(projected_planes.select_by_variance(unmeasured, np.zeros_like(blind)), chosen)


def degrees(*phi: float) -> Ints:
    return projected_planes.select_as_printed(np.deg2rad(np.array(phi)))


def test_printed_rule() -> None:
    for phi, plane in ((10, ZX), (44.9, ZX), (45.1, YZ), (90, YZ), (134.9, YZ), (135.1, ZX)):
        assert degrees(phi).tolist() == [[0, plane], [0, XY]]
    # Scenario 4 before and after the 13th instant
    assert degrees(47.0, 100.0).tolist() == [[0, YZ], [0, XY]]
    assert degrees(30.0, 100.0).tolist() == [[0, ZX], [1, YZ]]
    both = projected_planes.select_as_printed(np.deg2rad([[47.0, 100.0], [30.0, 100.0]]))
    np.testing.assert_array_equal(both, [degrees(47.0, 100.0), degrees(30.0, 100.0)])


def test_several_sensors_and_times_in_one_call_are_the_single_calls() -> None:
    rng = np.random.default_rng(11)
    R = np.array(POSES)
    theta, phi = rng.uniform(-3, 3, (5, 3)), rng.uniform(0.1, 3, (5, 3))
    covariance = projected_planes.projected_covariance(theta, phi, 0.03, 0.02, R)
    blind = projected_planes.blind_planes(theta, phi, 0.03, 0.02, R)
    for k, s in itertools.product(range(5), range(3)):
        one = projected_planes.projected_covariance(theta[k, s], phi[k, s], 0.03, 0.02, R[s])
        np.testing.assert_allclose(covariance[k, s], one, rtol=1e-12, atol=1e-18)
        np.testing.assert_array_equal(
            blind[k, s], projected_planes.blind_planes(theta[k, s], phi[k, s], 0.03, 0.02, R[s])
        )
