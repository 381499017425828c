"""Bounds in space: information by differences, the recursion written out, planes against the direct bound."""

from __future__ import annotations

import numpy as np
import pytest
from space_reference import pair_information

from occlog.array_types import Floats
from occlog.core.bounds import in_space as bounds3d
from occlog.core.bounds.in_plane import bearing_information
from occlog.core.geometry import projected_planes
from occlog.core.geometry.camera import rotation_from_angles, wrap_angle
from occlog.core.geometry.projected_planes import XY, YZ, ZX

POSES = [np.eye(3), rotation_from_angles(0.4, 0.7, -0.3), rotation_from_angles(-2.5, -1.2, 1.9)]
POSITION, SIGMAS = np.array([1.0, -2.0, 0.5]), (0.03, 0.02)
DT = np.full(50, 0.1)
PRIOR = np.diag([1.0, 1.0, 1.0, 0.25, 0.25, 0.25])
Sensors = tuple[Floats, Floats]


def scenario(number: int) -> Floats:
    """(50, 6) states of scenarios 1 to 3 of [Lee] Sec. 2.4: constant speed in x, 0.1 and 0.5 m/s^2 in y and z."""
    start, speed = {1: ([3, 3, 1], 1.0), 2: ([1, 1, 3], 1.0), 3: ([2, 1, 2], 0.3)}[number]
    state = np.array([*start, speed, speed, speed], dtype=float)
    later = bounds3d.accelerated_path(state, np.tile([0.0, 0.1, 0.5], (49, 1)), DT[1:])
    return np.vstack([state, later])


def one_sensor(pose: int = 0) -> Sensors:
    return np.zeros((1, 3)), POSES[pose][None]


def many_positions(n: int = 200) -> Floats:
    return np.random.default_rng(0).uniform(-10, 10, (n, 3))


def smallest_eigenvalue(matrices: Floats) -> Floats:
    """Of each matrix, relative to its size."""
    return np.asarray(np.linalg.eigvalsh(matrices)[:, 0] / np.abs(matrices).max(axis=(1, 2)))


def test_accelerated_path_is_the_motion_under_constant_acceleration() -> None:
    t = np.cumsum(np.linspace(0.05, 0.2, 50))
    state, a = np.array([2.0, 1.0, 2.0, 0.3, 0.3, 0.3]), np.array([0.0, 0.1, 0.5])
    path = bounds3d.accelerated_path(state, np.tile(a, (50, 1)), np.diff(t, prepend=0.0))
    np.testing.assert_allclose(path[:, :3], state[:3] + state[3:] * t[:, None] + 0.5 * a * t[:, None] ** 2)
    np.testing.assert_allclose(path[:, 3:], state[3:] + a * t[:, None])


@pytest.mark.parametrize(
    ("number", "polar", "azimuth"),
    [(1, (45.36, 76.74), (45.00, 49.04)), (2, (25.24, 36.26), (45.00, 50.28)), (3, (28.07, 48.24), None)],
)
def test_scenarios_have_the_printed_ranges_of_angles(
    number: int, polar: tuple[float, float], azimuth: tuple[float, float] | None
) -> None:
    """50 instants, the first at the initial state, give every printed digit."""
    theta, phi = np.rad2deg(bounds3d.sight_angles(scenario(number)[:, :3], np.zeros(3), np.eye(3)))
    assert (phi.min(), phi.max()) == pytest.approx(polar, abs=0.0051)
    if azimuth is not None:
        assert (theta.min(), theta.max()) == pytest.approx(azimuth, abs=0.0051)


def test_scenario_3_changes_planes_by_the_printed_rule_after_13_of_50_instants() -> None:
    _, phi = bounds3d.sight_angles(scenario(3)[:, :3], np.zeros(3), np.eye(3))
    chosen = projected_planes.select_as_printed(phi[:, None])[:, 0, 1]
    assert chosen.tolist() == [YZ] * 13 + [ZX] * 37


@pytest.mark.parametrize("pose", range(3))
def test_direction_information_is_that_of_numerical_gradients(pose: int) -> None:
    R, xyz, h = POSES[pose], many_positions(), 1e-6
    expected = np.zeros((len(xyz), 3, 3))
    for which, sigma in enumerate(SIGMAS):
        columns = [
            wrap_angle(
                bounds3d.sight_angles(xyz + e, POSITION, R)[which] - bounds3d.sight_angles(xyz - e, POSITION, R)[which]
            )
            for e in np.eye(3) * h
        ]
        g = np.column_stack(columns) / (2 * h)
        expected += g[:, :, None] * g[:, None, :] / sigma**2
    information = bounds3d.direction_information(xyz, POSITION, R, *SIGMAS)
    np.testing.assert_allclose(information, expected, rtol=1e-5, atol=1e-6 * expected.max())
    # nothing is stated about the range
    along = np.einsum("nij,nj->ni", information, xyz - POSITION)
    np.testing.assert_allclose(along / np.abs(information).max(axis=(1, 2))[:, None], 0, atol=1e-11)


@pytest.mark.parametrize("plane", [XY, YZ, ZX])
def test_plane_information_is_that_of_the_numerical_gradient(plane: int) -> None:
    xyz, h = many_positions(), 1e-6
    variance = np.random.default_rng(1).uniform(0.001, 0.01, len(xyz))
    variance[0] = np.inf
    columns = []
    for axis in projected_planes.AXES[plane]:
        e = np.eye(3)[axis] * h
        high, low = (projected_planes.projected_angles(xyz + d - POSITION)[:, plane] for d in (e, -e))
        columns.append(wrap_angle(high - low) / (2 * h))
    g = np.column_stack(columns)
    expected = g[:, :, None] * g[:, None, :] / variance[:, None, None]
    information = bounds3d.plane_information(xyz, POSITION, plane, variance)
    np.testing.assert_allclose(information, expected, rtol=1e-5, atol=1e-6)
    assert not information[0].any()


def test_nothing_is_reported_on_the_sensors_axis_and_in_a_blind_plane() -> None:
    overhead = (POSITION + np.array([0.0, 0.0, 2.0]))[None]
    assert not bounds3d.direction_information(overhead, POSITION, np.eye(3), *SIGMAS).any()
    for plane in (XY, YZ, ZX):
        assert np.isinf(bounds3d.plane_variance(overhead, POSITION, np.eye(3), *SIGMAS, plane)).all()
    beside = (POSITION + np.array([2.0, 0.05, 0.05]))[None]
    variances = [bounds3d.plane_variance(beside, POSITION, np.eye(3), *SIGMAS, p)[0] for p in (XY, YZ, ZX)]
    assert np.isinf(variances).tolist() == [False, True, False]


@pytest.mark.parametrize("pose", range(3))
@pytest.mark.parametrize("pair", [(XY, YZ), (YZ, ZX), (ZX, XY), (YZ, XY)])
def test_two_planes_with_their_covariance_are_the_direct_information(pose: int, pair: tuple[int, int]) -> None:
    xyz = many_positions(500)
    args = (xyz, POSITION, POSES[pose], *SIGMAS)
    direct, two = bounds3d.direction_information(*args), pair_information(*args, pair)
    scale = np.abs(direct).max(axis=(1, 2))[:, None, None]
    np.testing.assert_allclose(two / scale, direct / scale, rtol=0, atol=1e-9)


@pytest.mark.parametrize("pose", range(3))
def test_with_the_height_left_free_the_azimuth_with_its_own_variance_remains(pose: int) -> None:
    xyz = many_positions()
    theta, phi = bounds3d.sight_angles(xyz, POSITION, POSES[pose])
    variance = projected_planes.projected_covariance(theta, phi, *SIGMAS, POSES[pose])[:, XY, XY]
    expected = bearing_information(xyz[:, :2], POSITION[:2], np.sqrt(variance))
    left = bounds3d.ground_information(bounds3d.direction_information(xyz, POSITION, POSES[pose], *SIGMAS))
    scale = np.abs(expected).max(axis=(1, 2))[:, None, None]
    np.testing.assert_allclose(left / scale, expected / scale, rtol=0, atol=1e-8)


def test_with_the_height_left_free_nothing_else_is_lost() -> None:
    """By inverting the whole with a prior so weak that it does not count; and where nothing is reported the height."""
    rng = np.random.default_rng(5)
    root = rng.standard_normal((50, 3, 3))
    J = root @ np.swapaxes(root, 1, 2)
    np.testing.assert_allclose(bounds3d.ground_information(J), np.linalg.inv(np.linalg.inv(J)[:, :2, :2]), rtol=1e-6)
    J[:, 2] = J[:, :, 2] = 0.0
    np.testing.assert_array_equal(bounds3d.ground_information(J), J[:, :2, :2])


def test_each_row_has_its_own_noise_and_an_infinite_one_is_no_measurement() -> None:
    xyz, R = many_positions(4), POSES[2]
    theta, phi = np.array([0.01, 0.02, np.inf, np.inf]), np.array([0.03, np.inf, 0.04, np.inf])
    rows = bounds3d.direction_information(xyz, POSITION, R, theta, phi)
    for n in range(4):
        alone = bounds3d.direction_information(xyz[n : n + 1], POSITION, R, float(theta[n]), float(phi[n]))[0]
        np.testing.assert_allclose(rows[n], alone, rtol=1e-9, atol=1e-9)
    assert np.linalg.matrix_rank(rows).tolist() == [2, 1, 1, 0]


def test_two_planes_with_their_covariance_give_the_direct_bound() -> None:
    xyz = scenario(3)[:, :3]
    args = (xyz, np.zeros(3), POSES[1], *SIGMAS)
    direct = bounds3d.direct_bound(xyz, DT, one_sensor(1), SIGMAS, PRIOR)
    for pair in ((XY, YZ), (YZ, ZX), (ZX, XY)):
        two = bounds3d.motion_bound(pair_information(*args, pair), DT, PRIOR)
        np.testing.assert_allclose(two, direct, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("pair", [(XY, YZ), (YZ, ZX), (ZX, XY)])
def test_two_planes_as_if_independent_are_not_a_bound(pair: tuple[int, int]) -> None:
    """They claim more than the sensor measured, in some direction nearly everywhere: less than the direct bound."""
    xyz = many_positions()
    direct = bounds3d.direction_information(xyz, POSITION, np.eye(3), *SIGMAS)
    claimed = np.zeros_like(direct)
    for plane in pair:
        axes = np.ix_(range(len(xyz)), projected_planes.AXES[plane], projected_planes.AXES[plane])
        variance = bounds3d.plane_variance(xyz, POSITION, np.eye(3), *SIGMAS, plane)
        claimed[axes] += bounds3d.plane_information(xyz, POSITION, plane, variance)
    assert np.mean(smallest_eigenvalue(direct - claimed) < -0.01) > 0.8
    below = bounds3d.motion_bound(claimed, np.full(len(xyz), 0.1), PRIOR)
    true = bounds3d.motion_bound(direct, np.full(len(xyz), 0.1), PRIOR)
    assert smallest_eigenvalue(below - true).min() < -0.01


@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("pose", range(3))
def test_direct_bound_is_never_above_a_planes_bound(number: int, pose: int) -> None:
    xyz = scenario(number)[:, :3]
    rng = np.random.default_rng(number)
    root = rng.standard_normal((6, 6))
    for P0 in (PRIOR, root @ root.T + 0.1 * np.eye(6)):
        for sensors in (one_sensor(pose), (np.array([[0.0, 0, 0], [10.0, 10, 10]]), np.array(POSES[:2]))):
            direct = bounds3d.direct_bound(xyz, DT, sensors, SIGMAS, P0)
            for plane in (XY, YZ, ZX):
                axes = bounds3d.plane_axes(plane)
                own = bounds3d.plane_bound(xyz, DT, sensors, SIGMAS, P0[np.ix_(axes, axes)], plane)
                assert smallest_eigenvalue(own - direct[:, axes][:, :, axes]).min() > -1e-9


@pytest.mark.parametrize("seed", range(8))
def test_direct_bound_is_never_above_a_planes_bound_in_random_scenes(seed: int) -> None:
    """Random walks, one to four sensors of random poses, noises and silences, noise of the motion."""
    rng = np.random.default_rng(seed)
    steps, count = 40, int(rng.integers(1, 5))
    xyz = np.cumsum(rng.normal(scale=0.3, size=(steps, 3)), axis=0)
    where = rng.uniform(-6, 6, (count, 3))
    poses = np.array([rotation_from_angles(*rng.uniform(-3, 3, 3)) for _ in range(count)])
    sigmas, q = tuple(rng.uniform(0.005, 0.1, 2).tolist()), float(rng.uniform(0, 1))
    used = rng.uniform(size=(steps, count)) < 0.7
    root = rng.standard_normal((6, 6))
    P0, dt = root @ root.T + 0.1 * np.eye(6), rng.uniform(0, 0.5, steps)
    direct = bounds3d.direct_bound(xyz, dt, (where, poses), sigmas, P0, used, q)
    for plane in (XY, YZ, ZX):
        axes = bounds3d.plane_axes(plane)
        own = bounds3d.plane_bound(xyz, dt, (where, poses), sigmas, P0[np.ix_(axes, axes)], plane, used, q)
        least = np.linalg.eigvalsh(own - direct[:, axes][:, :, axes])[:, 0]
        assert (least > -1e-8 * np.abs(own).max(axis=(1, 2))).all()


@pytest.mark.parametrize("seed", range(4))
def test_order_of_the_sensors_does_not_matter(seed: int) -> None:
    rng, xyz = np.random.default_rng(seed), scenario(1)[:, :3]
    where, poses, turn = rng.uniform(-6, 6, (3, 3)), np.array(POSES), rng.permutation(3)
    a = bounds3d.direct_bound(xyz, DT, (where, poses), SIGMAS, PRIOR)
    b = bounds3d.direct_bound(xyz, DT, (where[turn], poses[turn]), SIGMAS, PRIOR)
    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-14)


def test_recursion_is_that_of_the_thesis_written_out() -> None:
    """(2.30), J' = F^-T J F^-1 + H^T R^-1 H, with the Jacobian of the constant velocity."""
    xyz = scenario(1)[:, :3]
    sensors = (np.array([[0.0, 0, 0], [10.0, 10, 10]]), np.array(POSES[:2]))
    used = np.random.default_rng(2).uniform(size=(50, 2)) < 0.6
    bounds = bounds3d.direct_bound(xyz, DT, sensors, SIGMAS, PRIOR, used)
    J = np.linalg.inv(PRIOR)
    back = np.eye(6)
    back[:3, 3:] = -0.1 * np.eye(3)
    for k in range(50):
        J = back.T @ J @ back
        for s in np.flatnonzero(used[k]):
            one = xyz[k : k + 1]
            J[:3, :3] += bounds3d.direction_information(one, sensors[0][s], sensors[1][s], *SIGMAS)[0]
        np.testing.assert_allclose(bounds[k], np.linalg.inv(J), rtol=1e-7, atol=1e-10)


def test_noise_of_the_motion_raises_the_bound_and_measurements_lower_it() -> None:
    xyz = scenario(2)[:, :3]
    quiet = bounds3d.direct_bound(xyz, DT, one_sensor(), SIGMAS, PRIOR)
    noisy = bounds3d.direct_bound(xyz, DT, one_sensor(), SIGMAS, PRIOR, acceleration_density=0.5)
    assert smallest_eigenvalue(noisy - quiet).min() > -1e-9
    blind = bounds3d.direct_bound(xyz, DT, one_sensor(), SIGMAS, PRIOR, np.zeros((50, 1), dtype=bool))
    assert smallest_eigenvalue(blind - quiet).min() > -1e-9
    t = DT.sum()
    np.testing.assert_allclose(blind[-1, :3, :3], (1.0 + 0.25 * t**2) * np.eye(3), rtol=1e-9)


@pytest.mark.parametrize("pose", [1, 2])
def test_turning_the_whole_world_turns_the_direct_bound(pose: int) -> None:
    xyz, R = scenario(3)[:, :3], POSES[pose]
    turn = np.kron(np.eye(2), R)
    upright = bounds3d.direct_bound(xyz, DT, one_sensor(), SIGMAS, PRIOR)
    turned = bounds3d.direct_bound(xyz @ R.T, DT, one_sensor(pose), SIGMAS, turn @ PRIOR @ turn.T)
    np.testing.assert_allclose(turned, turn @ upright @ turn.T, rtol=1e-7, atol=1e-10)


def test_a_linearised_estimator_stated_the_acceleration_reaches_the_direct_bound() -> None:
    """Kalman updates linearised at the truth, with errors so small that this is fair.

    4000 runs: each variance within 5 standard errors of sqrt(2/4000) = 2.2 %.
    """
    path, sigmas, rng, runs = scenario(3), (3e-4, 2e-4), np.random.default_rng(3), 4000
    P0, sensor = 1e-4 * PRIOR, (np.zeros(3), POSES[2])
    bounds = bounds3d.direct_bound(path[:, :3], DT, one_sensor(2), sigmas, P0)
    error = rng.multivariate_normal(np.zeros(6), P0, runs)
    F = np.eye(6)
    F[:3, 3:] = 0.1 * np.eye(3)
    P = P0
    for k in range(50):
        error, P = error @ F.T, F @ P @ F.T
        true = path[k, :3]
        local = (true - sensor[0]) @ sensor[1]
        G = projected_planes.projected_angle_gradients(local[None])[0, XY]
        flat = np.hypot(local[0], local[1])
        g = np.array([local[0] * local[2] / flat, local[1] * local[2] / flat, -flat]) / (local @ local)
        H = np.column_stack([np.stack([G, g]) @ sensor[1].T, np.zeros((2, 3))])
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(np.square(sigmas)))
        angles = np.column_stack(bounds3d.sight_angles(true[None], *sensor)) + rng.normal(0, sigmas, (runs, 2))
        guess = np.column_stack(bounds3d.sight_angles(true + error[:, :3], *sensor))
        error = error + wrap_angle(angles - guess) @ K.T
        P = P - K @ H @ P
    np.testing.assert_allclose(np.mean(error**2, axis=0), np.diag(bounds[-1]), rtol=5 * np.sqrt(2 / runs))
