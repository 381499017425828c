"""The bound in space and with tilted arrays: which bearings count, with what information, and what must hold."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from evaluate_scenes import array, both, camera, directions, heard, heights, pixels, scene, tracks, truth

from occlog.core.bounds import in_plane as crlb
from occlog.core.bounds import in_space as bounds3d
from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.scene import MicrophoneArray, Scene
from occlog.records.tables import UNLABELLED, Bearings, Bound

EAST = camera("east", 0.0, 10.0, 0.0, sigma_position=0.05, sigma_yaw=0.01)
CEILING = array("ceiling", 10.0, 10.0, 3.0, sigma=0.03)
WALL = array("wall", 0.5, 9.0, 1.5, sigma=0.05, pitch=0.7, roll=-0.4, yaw=0.3)
EARS = (CEILING, WALL, array("floor", 18.0, 3.0, 0.0, sigma=0.02))
PLACE = scene(EAST, arrays=EARS, room_height=3.0)
STEPS = 12
TIMES = np.cumsum(np.linspace(0.1, 0.5, STEPS))
PATH = np.column_stack([6 + TIMES, 12 - 0.5 * TIMES, 1.0 + 0.3 * np.sin(TIMES)])
TRUE = truth(TIMES, PATH[:, :2], z=PATH[:, 2])


def seen_by_camera(rows: slice = slice(None)) -> Bearings:
    u = -100.0 * (PATH[:, 1] - 10) / PATH[:, 0]
    return pixels(EAST, TIMES[rows], u[rows])


def everything() -> Bearings:
    parts = [heard(ear, TIMES[n::2], PATH[n::2]) for n, ear in enumerate(EARS[:2])]
    return both(seen_by_camera(slice(1, None, 3)), *parts, heard(EARS[2], TIMES, PATH, sigma_up=0.1))


def bound_of(bearings: Bearings, made_scene: Scene = PLACE, bound_dimension: str = "space", **options: object) -> Bound:
    return evaluate(None, TRUE, bearings, made_scene, EvaluateConfig(bound_dimension=bound_dimension, **options)).bound  # type: ignore[arg-type]


def covariances(bound: Bound) -> np.ndarray:
    xx, xy, yy = bound.bound_xx, bound.bound_xy, bound.bound_yy
    xz, yz, zz = bound.bound_xz, bound.bound_yz, bound.bound_zz
    return np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), 2, 0)


def own_angles(ear: MicrophoneArray, xyz: np.ndarray) -> np.ndarray:
    x, y, z = ear.rotation.T @ (xyz - ear.position)
    return np.array([math.atan2(y, x), math.atan2(z, math.hypot(x, y))])


def slow_information(bearings: Bearings, t_ns: int, xyz: np.ndarray) -> np.ndarray:
    """Row by row, by numerical differences of what each sensor reports."""
    J, step = np.zeros((3, 3)), 1e-5
    ears = {ear.name: ear for ear in EARS}
    for row in np.flatnonzero((bearings.t_ns == t_ns) & bearings.seen):
        name = str(bearings.sensor[row])
        if name in ears:
            shifted = [
                (own_angles(ears[name], xyz + e) - own_angles(ears[name], xyz - e)) / (2 * step)
                for e in step * np.eye(3)
            ]
            sigmas = np.array([bearings.sigma[row], bearings.sigma_elevation[row]])
            H = np.array(shifted).T / sigmas[:, None]
            J += H.T @ H
        else:
            read = bearings.sigma_px[row : row + 1]
            J[:2, :2] += crlb.camera_information(xyz[None, :2], EAST.ground, 0.0, 100.0, 0.05, 0.01, read)[0]
    return J


@pytest.mark.parametrize("motion", ["waypoint", "cv"])
def test_bound_is_that_of_an_independent_slow_recursion(motion: str) -> None:
    bearings = everything()
    bound = bound_of(
        bearings, motion=motion, process_noise_position=0.2, process_noise_density=0.3, sigma_initial_velocity=0.8
    )
    start = crlb.polygon_covariance(PLACE.region)
    P = np.zeros((6, 6))
    P[:2, :2], P[2, 2], P[3:, 3:] = start, 9.0 / 12.0, 0.64 * np.eye(3)
    expected = []
    for k, t_ns in enumerate(bound.t_ns.tolist()):
        dt = TIMES[k] - TIMES[k - 1] if k else 0.0
        F, Q = np.eye(6), np.zeros((6, 6))
        if motion == "waypoint":
            Q[:3, :3] = 0.04 * dt * np.eye(3)
        else:
            F[:3, 3:] = dt * np.eye(3)
            Q = 0.3 * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(3))
        J = np.zeros((6, 6))
        J[:3, :3] = slow_information(bearings, t_ns, PATH[k])
        P = np.linalg.inv(np.linalg.inv(F @ P @ F.T + Q) + J)
        expected.append(P[:3, :3])
    np.testing.assert_allclose(covariances(bound), expected, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(bound.bound_space, np.sqrt(np.trace(expected, axis1=1, axis2=2)), rtol=1e-5)
    np.testing.assert_allclose(bound.bound**2, bound.bound_xx + bound.bound_yy)


def test_one_array_overhead_by_hand() -> None:
    # 2 m to the side and 2 m below: lines of sight 45 degrees down.  Across: r sin(phi) sigma = 2 * 0.03; upwards:
    # r sigma_up = sqrt(8) * 0.02, half of it seen along x and half along z.
    xyz = np.array([12.0, 10.0, 1.0])
    rows = heard(CEILING, [0.0], xyz)
    true = truth([0.0], xyz[:2], z=1.0)
    config = EvaluateConfig(bound_dimension="space", prior_covariance=(1.0, 0.0, 1.0), prior_variance_z=1.0)
    bound = evaluate(None, true, rows, PLACE, config).bound
    J = np.diag([1.0, 1.0 + 1 / 0.06**2, 1.0])
    n = np.array([1.0, 0.0, 1.0]) / math.sqrt(2)  # normal of the sight line in the vertical plane
    J += np.outer(n, n) / (8 * 0.02**2)
    np.testing.assert_allclose(covariances(bound)[0], np.linalg.inv(J), rtol=1e-9, atol=1e-12)
    assert bound.n_detected[0] == 1


def test_a_camera_tells_nothing_of_the_height() -> None:
    bound = bound_of(seen_by_camera(), prior_variance_z=0.5, process_noise_position=0.1)
    np.testing.assert_allclose(bound.bound_zz, 0.5 + 0.01 * (TIMES - TIMES[0]))
    ground = bound_of(seen_by_camera(), bound_dimension="ground", process_noise_position=0.1)
    np.testing.assert_allclose(bound.bound, ground.bound, rtol=1e-9)
    assert np.isnan(ground.bound_space).all()


def test_planar_arrays_tell_an_azimuth_only() -> None:
    ear = EARS[2]
    to = PATH - ear.position
    flat = directions(ear.name, TIMES, np.arctan2(to[:, 1], to[:, 0]), 0.02)
    space, ground = bound_of(flat), bound_of(flat, bound_dimension="ground")
    np.testing.assert_allclose(space.bound_xx, ground.bound_xx, rtol=1e-9)
    np.testing.assert_allclose(space.bound, ground.bound, rtol=1e-9)


def test_upright_arrays_on_the_ground_are_as_without_elevations() -> None:
    with_elevations = heard(CEILING, TIMES, PATH)
    columns = {c.name: getattr(with_elevations, c.name) for c in Bearings.columns() if not c.optional}
    np.testing.assert_array_equal(
        bound_of(with_elevations, bound_dimension="ground").bound,
        bound_of(Bearings.of(**columns), bound_dimension="ground").bound,
    )


def test_azimuth_of_a_tilted_array_has_the_variance_that_it_has() -> None:
    """Against 200,000 noisy directions turned into the world: the variance to within 4 standard errors."""
    xyz, n, sigma, sigma_up = PATH[3], 200_000, 0.004, 0.002
    theta, elevation = own_angles(WALL, xyz)
    rng = np.random.default_rng(1)
    theta, elevation = theta + sigma * rng.standard_normal(n), elevation + sigma_up * rng.standard_normal(n)
    lines = np.column_stack([np.cos(elevation) * np.cos(theta), np.cos(elevation) * np.sin(theta), np.sin(elevation)])
    east, north, _ = (lines @ WALL.rotation.T).T
    variance = np.var(np.arctan2(north, east))
    ear = replace(WALL, sigma=sigma)
    made_scene = scene(EAST, arrays=(ear,))
    true = truth([0.0], xyz[:2], z=xyz[2])
    rows = heard(ear, [0.0], xyz, sigma_up=sigma_up)
    config = EvaluateConfig(prior_covariance=(1.0, 0.0, 1.0))
    bound = evaluate(None, true, rows, made_scene, config).bound
    J = np.eye(2) + crlb.bearing_information(xyz[None, :2], WALL.position[:2], np.sqrt([variance]))[0]
    P = np.array([[bound.bound_xx[0], bound.bound_xy[0]], [bound.bound_xy[0], bound.bound_yy[0]]])
    across = np.array([-(xyz[1] - WALL.position[1]), xyz[0] - WALL.position[0]])
    across /= np.linalg.norm(across)
    assert across @ P @ across == pytest.approx(across @ np.linalg.inv(J) @ across, rel=4 * math.sqrt(2 / n))
    assert abs(variance / sigma**2 - 1) > 0.1  # it is not that of the array's own azimuth


def test_tilted_arrays_without_true_height_are_taken_at_the_reported_elevation() -> None:
    rows = heard(WALL, TIMES, PATH)
    known = bound_of(rows, bound_dimension="ground")
    unknown = evaluate(None, truth(TIMES, PATH[:, :2]), rows, PLACE, EvaluateConfig()).bound
    np.testing.assert_allclose(unknown.bound, known.bound, rtol=1e-9)


def test_a_sensor_more_never_raises_the_bound_and_their_order_does_not_matter() -> None:
    few = both(heard(CEILING, TIMES[::2], PATH[::2]), seen_by_camera())
    more = both(few, heard(WALL, TIMES, PATH))
    P_few, P_more = covariances(bound_of(few)), covariances(bound_of(more))
    difference = P_few - P_more[np.isin(bound_of(more).t_ns, bound_of(few).t_ns)]
    assert np.linalg.eigvalsh(difference).min() > -1e-9
    assert np.trace(P_more[-1]) < 0.9 * np.trace(P_few[-1])
    turned = scene(EAST, arrays=EARS[::-1], room_height=3.0)
    np.testing.assert_allclose(bound_of(more, turned).bound_space, bound_of(more).bound_space, rtol=1e-12)


def test_bound_in_space_is_below_that_of_each_plane() -> None:
    """Direct bound cut to the axes of a plane, against the bound of that plane's projected angle alone."""
    rows = both(heard(CEILING, TIMES, PATH), heard(EARS[2], TIMES, PATH, sigma_up=0.03))
    options = {
        "motion": "cv",
        "process_noise_density": 0.1,
        "sigma_initial_velocity": 0.8,
        "prior_covariance": (4.0, 0.0, 4.0),
    }
    P = covariances(bound_of(rows, prior_variance_z=1.0, **options))
    dt = np.diff(TIMES, prepend=TIMES[0])
    for plane, axes in enumerate(((0, 1), (1, 2), (2, 0))):
        J = sum(
            bounds3d.plane_information(
                PATH,
                ear.position,
                plane,
                bounds3d.plane_variance(PATH, ear.position, ear.rotation, ear.sigma, up, plane),
            )
            for ear, up in ((CEILING, 0.02), (EARS[2], 0.03))
        )
        P0 = np.diag([*np.array([4.0, 4.0, 1.0])[list(axes)], 0.64, 0.64])
        own = bounds3d.motion_bound(np.asarray(J), dt, P0, 0.1)[:, :2, :2]
        assert np.linalg.eigvalsh(own - P[:, axes][:, :, axes]).min() > -1e-9


def test_auto_is_in_space_for_targets_whose_errors_are() -> None:
    true = both(TRUE, truth(TIMES, PATH[:, :2], 1, z=1.0))
    rows = both(everything(), heard(CEILING, TIMES, PATH, target=1))
    found = both(heights(tracks(TIMES, PATH[:, :2] + 0.1), PATH[:, 2] + 0.1), tracks(TIMES, PATH[:, :2], 1))
    result = evaluate(found, true, rows, PLACE)
    high = np.isfinite(result.bound.bound_space)
    assert high[result.bound.target_id == 0].all()
    assert not high[result.bound.target_id == 1].any()
    m, least = result.metrics, result.bound.bound_space[high]
    assert m["bound_rmse_space_m"] == pytest.approx(math.sqrt(np.mean(least**2)))
    assert m["bound_rmse_z_m"] == pytest.approx(math.sqrt(np.mean(result.bound.bound_zz[high])))
    assert m["bound_ratio_space"] == pytest.approx(math.sqrt(0.03) / m["bound_rmse_space_m"])
    assert m["bound_ratio_space_target_0"] == m["bound_ratio_space"]
    assert "bound_ratio_space_target_1" not in m
    assert not np.isfinite(bound_of(everything(), bound_dimension="auto").bound_space).any()  # no tracks: on the ground


def test_bound_in_space_needs_true_heights() -> None:
    with pytest.raises(InputError, match=r"target 0 has no height .*bound-dimension"):
        evaluate(None, truth(TIMES, PATH[:, :2]), everything(), PLACE, EvaluateConfig(bound_dimension="space"))


def test_candidates_are_distinguished_by_their_elevations() -> None:
    """Two people behind one another, one on a gallery: only the elevation says who was heard."""
    low, high = truth(TIMES, [12.0, 10.5], 0, z=1.0), truth(TIMES, [14.0, 11.0], 1, z=4.0)
    rows = heard(CEILING, TIMES, [14.0, 11.0, 4.0], target=UNLABELLED)
    bound = evaluate(None, both(low, high), rows, PLACE, EvaluateConfig(bound_dimension="space")).bound
    assert not bound.n_detected[bound.target_id == 0].any()
    assert bound.n_detected[bound.target_id == 1].all()


@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_noise_of_elevations_is_reported_about_the_arrays_own_axes(turn: float) -> None:
    """3000 noisy directions of an array of any pose: both mean squares are 1 to within 4 standard errors."""
    rng, n = np.random.default_rng(3), 3000
    ear = array("ear", 3.0, 3.0, 2.0, sigma=0.03, pitch=turn, roll=-turn)
    t = np.arange(n) * 0.1
    xyz = np.column_stack([10 + 5 * np.sin(t), 10 + 5 * np.cos(0.7 * t), 1 + 0.5 * np.sin(2 * t)])
    angles = np.array([own_angles(ear, p) for p in xyz]) + rng.standard_normal((n, 2)) * [0.03, 0.02]
    theta, up = angles.T
    lines = np.column_stack([np.cos(up) * np.cos(theta), np.cos(up) * np.sin(theta), np.sin(up)]) @ ear.rotation.T
    rows = heard(ear, t, ear.position + lines, target=UNLABELLED, sigma_up=0.02)
    config = EvaluateConfig(gate_sigma=7.0)
    m = evaluate(None, truth(t, xyz[:, :2], z=xyz[:, 2]), rows, scene(arrays=(ear,)), config).metrics
    assert m["detected"] == n
    assert m["bearing_nis"] == pytest.approx(1.0, abs=4 * math.sqrt(2 / n))
    assert m["elevation_nis"] == pytest.approx(1.0, abs=4 * math.sqrt(2 / n))
    assert m["elevation_rms_mrad"] == pytest.approx(20.0, rel=0.06)


def test_a_direction_reported_from_beyond_the_pole_is_of_the_target() -> None:
    """Half a standard deviation off in elevation, just below an array: the azimuth comes out half a turn off."""
    true = truth([0.0], [10.05, 10.0], z=0.0)
    down = math.atan2(-3.0, 0.05)
    rows = heard(CEILING, [0.0], [10.05, 10.0, 0.0], target=UNLABELLED, sigma_up=0.1)
    columns = {c.name: getattr(rows, c.name) for c in Bearings.columns()}
    past = -math.pi - (down - 0.05)  # 0.05 rad further down, seen from the other side
    beyond = Bearings.of(**columns | {"bearing": np.array([-math.pi]), "elevation": np.array([past])})
    config = EvaluateConfig(bound_dimension="space", gate_sigma=1.0)
    result = evaluate(None, true, beyond, PLACE, config)
    assert result.metrics["detected"] == 1
    assert result.metrics["elevation_rms_mrad"] == pytest.approx(50.0)
    assert result.bound.n_detected[0] == 1


@pytest.mark.parametrize("kind", ["camera", "tilted", "mixed"])
def test_information_is_the_covariance_of_the_score(kind: str) -> None:
    """Score by numerical differences of the log-likelihood at 40,000 draws: each entry within 5 standard errors."""
    rng, n, xyz = np.random.default_rng(7), 40_000, PATH[4]

    def camera_log(u: np.ndarray, p: np.ndarray) -> np.ndarray:
        h, d = p[1] - 10.0, p[0]
        v = 100.0**2 * (1 + (h / d) ** 2) * (0.01**2 * (1 + (h / d) ** 2) + 0.05**2 / d**2) + 1.0
        return np.asarray(-0.5 * (u + 100.0 * h / d) ** 2 / v - 0.5 * np.log(v))

    def array_log(angles: np.ndarray, p: np.ndarray) -> np.ndarray:
        return np.asarray(-0.5 * np.sum(((angles - own_angles(WALL, p)) / [0.05, 0.02]) ** 2, axis=1))

    h, d = xyz[1] - 10.0, xyz[0]
    v = 100.0**2 * (1 + (h / d) ** 2) * (0.01**2 * (1 + (h / d) ** 2) + 0.05**2 / d**2) + 1.0
    u = -100.0 * h / d + math.sqrt(v) * rng.standard_normal(n)
    angles = own_angles(WALL, xyz) + rng.standard_normal((n, 2)) * [0.05, 0.02]
    rows = [pixels(EAST, [0.0], [-100.0 * h / d]), heard(WALL, [0.0], xyz)]
    logs = [lambda p: camera_log(u, p), lambda p: array_log(angles, p)]
    use = {"camera": [0], "tilted": [1], "mixed": [0, 1]}[kind]
    score = np.array([sum((logs[i](xyz + e) - logs[i](xyz - e)) / 2e-4 for i in use) for e in 1e-4 * np.eye(3)])
    products = score[:, None] * score[None, :]
    config = EvaluateConfig(bound_dimension="space", prior_covariance=(1.0, 0.0, 1.0), prior_variance_z=1.0)
    bound = evaluate(None, truth([0.0], xyz[:2], z=xyz[2]), both(*(rows[i] for i in use)), PLACE, config).bound
    information = np.linalg.inv(covariances(bound)[0]) - np.eye(3)
    error = products.std(axis=2) / math.sqrt(n)
    assert np.all(np.abs(products.mean(axis=2) - information) <= 5 * error + 1e-6)


@pytest.mark.jit
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.statistics)])
def test_an_extended_kalman_filter_in_space_reaches_the_bound_and_not_less(seed: int) -> None:
    """Walks of known drift, two arrays, one of them tilted, and a camera: mean squared error over mean bound."""
    rng, runs, steps, sigma_v = np.random.default_rng(seed), 40, 25, 0.1
    ears = [array("ceiling", 10.0, 10.0, 3.0, sigma=0.02), array("wall", 1.0, 9.0, 1.5, sigma=0.03, pitch=0.7)]
    made_scene = scene(camera("eye", 0.0, 10.0, 0.0), arrays=tuple(ears), room_height=3.0)
    t, P0 = np.arange(steps), np.diag([0.25, 0.25, 0.04])
    config = EvaluateConfig(
        bound_dimension="space",
        prior_covariance=(0.25, 0.0, 0.25),
        prior_variance_z=0.04,
        process_noise_position=sigma_v,
    )
    sigmas = np.array([1.0, 0.02, 0.02, 0.03, 0.02])
    squared, bounds = np.empty((runs, steps)), np.empty((runs, steps))

    def measure(p: np.ndarray) -> np.ndarray:
        return np.array([-100.0 * (p[1] - 10.0) / p[0], *own_angles(ears[0], p), *own_angles(ears[1], p)])

    for run in range(runs):
        noise = sigma_v * rng.standard_normal((steps, 3)) * (t > 0)[:, None]
        x = np.array([6.0, 12.0, 1.0]) + np.sqrt(np.diag(P0)) * rng.standard_normal(3) + np.cumsum(noise, axis=0)
        z = np.array([measure(p) for p in x]) + sigmas * rng.standard_normal((steps, 5))
        guess, P = np.array([6.0, 12.0, 1.0]), P0
        for k in range(steps):
            P = P + (sigma_v**2 * np.eye(3) if k else 0.0)
            H = np.array([(measure(guess + e) - measure(guess - e)) / 2e-5 for e in 1e-5 * np.eye(3)]).T
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(sigmas**2))
            guess, P = guess + K @ (z[k] - measure(guess)), P - K @ H @ P
            squared[run, k] = np.sum((guess - x[k]) ** 2)
        heard_rows = [heard(ear, t, x) for ear in ears]
        u = -100.0 * (x[:, 1] - 10.0) / x[:, 0]
        rows = both(pixels(camera("eye", 0.0, 10.0, 0.0), t, u), *heard_rows)
        bounds[run] = evaluate(None, truth(t, x[:, :2], z=x[:, 2]), rows, made_scene, config).bound.bound_space ** 2
    per_run = squared.mean(axis=1) / bounds.mean()
    error_bar = per_run.std() / math.sqrt(runs)
    assert 1 - 3 * error_bar < per_run.mean() < 1.1 + 3 * error_bar
