"""Laplace approximations of particles' posteriors: against a plain form, closed forms and numerical integration."""

from __future__ import annotations

import apf_reference as ref
import numpy as np
import pytest
from apf_scenes import reference_scene
from scipy.stats import multivariate_normal, norm
from tracker_scenes import SECOND, room100, scan, true_u, with_array

from occlog.filtering.likelihood import distances
from occlog.filtering.likelihood.directions import factors
from occlog.filtering.likelihood.distances import log_density
from occlog.scans.grouping import Scan
from occlog.track.methods.apf.config import ApfConfig
from occlog.track.methods.apf.kernels import importance
from occlog.track.methods.apf.kernels.importance import linearise
from occlog.track.methods.apf.model import make_model, pack_scan

PLACE = np.array([31.0, 46.0])


def looks_of(scene, rows, config=None, labelled=True):
    """Model, packed scan and rows of `measurements` for rows (sensor, u_px, ...)."""
    model = make_model(scene, config or ApfConfig())
    packed = pack_scan(scan(1.0, rows, labelled), model.read_px, True)
    return model, packed, importance.measurements(packed, model.sensors, model.noise, model.detection)


def heard(scene, bearing, sigma=0.02):
    """The same for one bearing of the scene's array, which has no pixels."""
    model = make_model(scene, ApfConfig())
    columns = {"target_id": 0, "seen": True, "bearing": bearing, "sigma": sigma}
    columns |= {"u_px": np.nan, "sigma_px": np.nan, "score": np.nan}
    packed = Scan.of(SECOND, [len(scene.cameras)], **{name: np.array([value]) for name, value in columns.items()})
    detections_of_step = pack_scan(packed, model.read_px, True)
    return (
        model,
        detections_of_step,
        importance.measurements(detections_of_step, model.sensors, model.noise, model.detection),
    )


def noisy_rows(scene, rng, sigma=2.0, place=PLACE):
    """One labelled value of each camera that has the place in its field of view."""
    u = np.array(true_u(scene, place)) + sigma * rng.standard_normal(len(scene.cameras))
    half = [c.focal_px[0] * np.tan(c.fov / 2) for c in scene.cameras]
    return [(i, value) for i, value in enumerate(u) if abs(value) < half[i]]


def values_of(rows, n=8):
    z = np.full(n, np.nan)
    for i, u in rows:
        z[i] = -u
    return z


def approximate(observations, rows, mean, p0):
    mean = np.atleast_2d(np.asarray(mean, dtype=float))
    p0 = np.full(len(mean), p0) if np.ndim(p0) == 0 else p0
    return importance.adapt(mean, p0, np.ones(len(mean), dtype=np.bool_), observations.first, rows)


def covariances(root):
    a, b, c = root.T
    return np.array([[a * a + b * b, b * c], [b * c, c * c]]).transpose(2, 0, 1)


def tilted(scene_or_array, kind, rng):
    if kind == "pixel":
        return looks_of(scene_or_array, noisy_rows(scene_or_array, rng))
    return heard(scene_or_array, float(rng.uniform(-np.pi, np.pi)))


@pytest.mark.parametrize("kind", ["pixel", "bearing"])
@pytest.mark.parametrize("seed", range(4))
def test_derivatives_are_those_of_the_residual(seed, kind):
    rng = np.random.default_rng(seed)
    scene = with_array(room100(sigma_position=0.7, sigma_yaw=0.02), (60.0, 30.0))
    _, _, rows = tilted(scene, kind, rng)
    x, y, eps = *(PLACE + rng.normal(0, 3, 2)), 1e-5
    for row in rows:
        residual, hx, hy, variance = linearise(x, y, row)
        assert variance > 0
        right, left = linearise(x + eps, y, row)[0], linearise(x - eps, y, row)[0]
        above, below = linearise(x, y + eps, row)[0], linearise(x, y - eps, row)[0]
        # The residual is measured minus expected: its derivative is minus that of what is expected
        np.testing.assert_allclose([(left - right) / (2 * eps), (below - above) / (2 * eps)], [hx, hy], rtol=1e-6)
        assert np.isfinite(residual)


@pytest.mark.parametrize("kind", ["RANGE", "LOG_RANGE", "DIFFERENCE"])
def test_distances_have_the_residual_and_derivatives_of_their_formulas(kind):
    row, at = np.zeros(12), np.array([3.0, -1.0])
    row[importance.KIND], row[importance.VALUE], row[importance.READING_NOISE] = getattr(importance, kind), 0.8, 0.3
    row[[importance.X0, importance.Y0, importance.RISE2]] = 1.0, 0.5, 2.0
    row[[importance.X1, importance.Y1, importance.OTHER_RISE2]] = 4.0, 2.0, 1.5

    def expected(xy):
        d = np.sqrt(np.sum((xy - row[[importance.X0, importance.Y0]]) ** 2) + 2.0)
        e = np.sqrt(np.sum((xy - row[[importance.X1, importance.Y1]]) ** 2) + 1.5)
        return {"RANGE": d, "LOG_RANGE": np.log(d), "DIFFERENCE": d - e}[kind]

    slope = [(expected(at + h) - expected(at - h)) / 2e-5 for h in 1e-5 * np.eye(2)]
    np.testing.assert_allclose(linearise(*at, row), [0.8 - expected(at), *slope, 0.3], rtol=1e-8)
    # At the sensor itself there is no direction
    row[[importance.RISE2, importance.OTHER_RISE2]] = 0.0
    for place in (row[[importance.X0, importance.Y0]], row[[importance.X1, importance.Y1]]):
        assert np.isfinite(linearise(*place, row)).all()


@pytest.mark.parametrize("density", [1e-30, 1e30])
def test_many_factors_neither_vanish_nor_overflow(density):
    rows = np.zeros((25, 12))
    rows[:, importance.X0], rows[:, importance.READING_NOISE], rows[:, importance.CLUTTER] = 5.0, 1.0, density
    near = importance.adapt(PLACE[None], np.ones(1), np.ones(1, dtype=np.bool_), np.arange(26), rows)
    np.testing.assert_allclose(near.log_factors, 25.0 * np.log(density))


@pytest.mark.parametrize("kind", ["pixel", "bearing", "candidates"])
@pytest.mark.parametrize("seed", range(4))
def test_measurements_give_the_factors_of_the_likelihood(seed, kind):
    rng = np.random.default_rng(seed)
    scene = with_array(room100(pillar=False, sigma_position=0.7, sigma_yaw=0.02), (60.0, 30.0))
    if kind == "candidates":
        u = true_u(scene, PLACE)
        model, observations, rows = looks_of(
            scene, [(0, u[0] + 1.0, 2.0, 0.5), (0, u[0] - 9.0, 3.0, 0.9), (4, u[4], np.nan, np.nan)], labelled=False
        )
    else:
        model, observations, rows = tilted(scene, kind, rng)
    for place in PLACE + rng.normal(0, 1, (5, 2)):
        for k in range(len(observations.sensor)):
            mine = rows[observations.first[k], importance.CLUTTER]
            for row in rows[observations.first[k] : observations.first[k + 1]]:
                r, _, _, v = linearise(*place, row)
                mine += row[importance.SCALE] * norm.pdf(r, scale=np.sqrt(v))
            seen = np.ones(1, dtype=np.bool_)
            whole, _ = factors(place[None], k, observations, model.sensors, model.noise, model.detection, seen)
            assert mine == pytest.approx(whole[0], rel=1e-12)


def test_a_place_behind_a_camera_or_at_a_sensor_has_no_variance():
    scene = with_array(room100(), (60.0, 30.0))
    _, _, rows = looks_of(scene, [(0, 3.0)])  # at (0, 0), looking along the diagonal
    assert linearise(-1.0, -1.0, rows[0])[3] == -1.0
    assert linearise(1.0, -1.0, rows[0])[3] == -1.0  # next to it: d = 0
    assert linearise(1.0, 1.0, rows[0])[3] > 0.0
    _, _, rows = heard(scene, 0.3)
    assert linearise(60.0, 30.0, rows[0])[3] == -1.0
    assert linearise(60.0, 30.1, rows[0])[3] > 0.0


@pytest.mark.parametrize("p0", [1e-2, 1.0, 30.0])
@pytest.mark.parametrize("focal", [70.0, 600.0])
@pytest.mark.parametrize("seed", range(3))
def test_an_approximation_is_that_of_the_plain_form(seed, focal, p0):
    rng = np.random.default_rng(seed)
    scene = room100(focal=focal, sigma_position=0.1, sigma_yaw=0.002)
    rows = noisy_rows(scene, rng)
    rows[1] = (rows[1][0], rows[1][1] + 30.0 * (seed % 2))
    config = ApfConfig(false_alarm_probability=1e-3, detection_probability=0.9)
    _, detections_of_step, packed = looks_of(scene, rows, config)
    mean = rng.multivariate_normal(PLACE, p0 * np.eye(2), 12)
    near = approximate(detections_of_step, packed, mean, p0)
    plain = ref.laplace(
        mean,
        np.full(12, p0),
        values_of(rows),
        np.full(8, 2.0),
        reference_scene(scene),
        ref.RefConfig(hit=0.9, miss=0.1, false_alarm_probability=1e-3),
    )
    # At the limits of what counts as believed or settled rounding decides
    same = np.abs(near.mode - plain.mode).max(axis=1) < 1e-6 * np.sqrt(p0)
    assert same.sum() > 10
    np.testing.assert_allclose(covariances(near.root)[same], plain.covariance[same], rtol=1e-5, atol=1e-9 * p0)
    np.testing.assert_allclose(near.log_volume[same], plain.log_volume[same], atol=1e-4)
    np.testing.assert_allclose(near.log_factors[same], plain.log_factors[same], atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_far_cameras_give_the_posterior_of_a_linear_sensor_and_its_evidence(seed):
    """From 10 km away a reading is linear over a few metres: Kalman's update is exact."""
    rng = np.random.default_rng(seed)
    scene = room100(pillar=False, focal=1e4, sigma_position=0.0, sigma_yaw=0.0)
    m0, p0, sigma = PLACE + rng.normal(0, 1, 2), 2.0, 1.0
    rows = looks_of(scene, [(i, 0.0) for i in (0, 2, 4)])[2]
    for row, xy in zip(rows, [(-5e3, -5e3), (1e4, -5e3), (1e4, 1e4)], strict=True):
        row[importance.X0], row[importance.Y0] = xy
        row[importance.COS], row[importance.SIN] = (PLACE - xy) / np.hypot(*(PLACE - xy))
        row[importance.READING_NOISE], row[importance.CLUTTER] = sigma**2, 1e-30
        row[importance.VALUE] -= linearise(*PLACE, row)[0] - sigma * rng.normal()
    near = importance.adapt(m0[None], np.array([p0]), np.ones(1, dtype=np.bool_), np.arange(4), rows)
    P = p0 * np.eye(2)
    H = np.array([linearise(*m0, row)[1:3] for row in rows])
    r = np.array([linearise(*m0, row)[0] for row in rows])
    S = H @ P @ H.T + sigma**2 * np.eye(3)
    gain = P @ H.T @ np.linalg.inv(S)
    mean, P = m0 + gain @ r, P - gain @ H @ P
    log_evidence = multivariate_normal.logpdf(r, np.zeros(3), S)
    np.testing.assert_allclose(near.mode[0], mean, atol=1e-3)
    np.testing.assert_allclose(covariances(near.root)[0], P, rtol=1e-3, atol=1e-6)
    assert near.log_volume[0] + near.log_factors[0] == pytest.approx(log_evidence, abs=2e-3)


@pytest.mark.jit
@pytest.mark.parametrize(("focal", "tolerance"), [(1000.0, 0.02), (300.0, 0.03), (70.0, 0.12)])
@pytest.mark.parametrize("p0", [0.05, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_predictive_likelihood_is_the_integral_of_prior_times_factors(seed, focal, tolerance, p0):
    rng = np.random.default_rng(seed)
    scene = room100(pillar=False, focal=focal, sigma_position=0.0, sigma_yaw=0.0)
    model, packed, rows = looks_of(scene, noisy_rows(scene, rng))
    m0 = PLACE + np.sqrt(p0) * rng.standard_normal(2)
    near = approximate(packed, rows, m0, p0)
    # Over 7 standard deviations of the posterior about its mode
    P = covariances(near.root)[0]
    axis = np.linspace(-7, 7, 201)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    root = np.linalg.cholesky(P)
    xy = near.mode[0] + grid @ root.T
    value = multivariate_normal.logpdf(xy, m0, p0 * np.eye(2))
    seen = np.ones(len(xy), dtype=np.bool_)
    for k in range(len(packed.sensor)):
        value += np.log(factors(xy, k, packed, model.sensors, model.noise, model.detection, seen)[0])
    evidence = np.exp(value).sum() * np.linalg.det(root) * (axis[1] - axis[0]) ** 2
    assert near.log_volume[0] + near.log_factors[0] == pytest.approx(np.log(evidence), abs=tolerance)


@pytest.mark.parametrize("wrong", range(4))
@pytest.mark.parametrize("shift", [40.0, -150.0, 400.0])
def test_a_false_bearing_is_not_believed(wrong, shift):
    scene = room100(pillar=False, focal=600.0, sigma_position=0.0, sigma_yaw=0.0)
    rows = noisy_rows(scene, np.random.default_rng(1))[:4]
    others = [row for n, row in enumerate(rows) if n != wrong]
    rows[wrong] = (rows[wrong][0], rows[wrong][1] + shift)
    config = ApfConfig(false_alarm_probability=1e-2, detection_probability=0.9)
    _, detections_of_step, packed = looks_of(scene, rows, config)
    _, fewer, without = looks_of(scene, others, config)
    m0, p0 = PLACE + 0.4, 0.25
    near, better = approximate(detections_of_step, packed, m0, p0), approximate(fewer, without, m0, p0)
    deviation = np.sqrt(np.linalg.eigvalsh(covariances(better.root)[0]).max())
    np.testing.assert_allclose(near.mode, better.mode, atol=0.3 * deviation)
    np.testing.assert_allclose(covariances(near.root), covariances(better.root), rtol=1e-2, atol=1e-9)
    # It counts as a false report: by no more than its density over the image
    floor = np.log(packed[wrong, importance.CLUTTER])
    assert near.log_factors[0] == pytest.approx(better.log_factors[0] + floor, abs=0.2)


def test_a_value_of_a_camera_that_a_particle_is_behind_counts_as_false():
    scene = room100(pillar=False, focal=600.0)
    rows = noisy_rows(scene, np.random.default_rng(1))[:3]
    _, packed, values = looks_of(scene, rows)
    behind = values.copy()
    behind[1, [importance.COS, importance.SIN]] *= -1.0
    near = approximate(packed, behind, PLACE + 0.4, 0.25)
    better = importance.adapt(
        PLACE[None] + 0.4, np.full(1, 0.25), np.ones(1, dtype=np.bool_), np.arange(3), values[[0, 2]]
    )
    np.testing.assert_allclose(near.mode, better.mode, rtol=1e-12)
    np.testing.assert_allclose(near.root, better.root, rtol=1e-12)
    np.testing.assert_allclose(near.log_factors, better.log_factors + np.log(values[1, importance.CLUTTER]))


def test_of_a_looks_candidates_the_one_that_fits_is_believed():
    scene = room100(pillar=False, focal=600.0, sigma_position=0.0, sigma_yaw=0.0)
    u = true_u(scene, PLACE)
    alone = [(i, u[i]) for i in (0, 2, 4)]
    crowd = [*alone, (0, u[0] + 90.0), (0, u[0] - 200.0), (2, u[2] + 55.0)]
    m0, p0 = PLACE + 0.3, 0.25
    _, packed, rows = looks_of(scene, crowd, labelled=False)
    _, fewer, without = looks_of(scene, alone, labelled=False)
    near, single = approximate(packed, rows, m0, p0), approximate(fewer, without, m0, p0)
    np.testing.assert_allclose(near.mode, single.mode, atol=1e-3)
    np.testing.assert_allclose(near.root, single.root, rtol=1e-2, atol=1e-9)


@pytest.mark.parametrize("sigma_px", [1e-6, 1e-3, 1.0])
@pytest.mark.parametrize("p0", [1e-4, 0.1, 9.0])
def test_nearly_exact_bearings_are_met(sigma_px, p0):
    scene = room100(pillar=False, focal=70.0, sigma_position=0.0, sigma_yaw=0.0)
    rows = [(i, u, sigma_px, np.nan) for i, u in enumerate(true_u(scene, PLACE)) if i in (0, 1, 3, 5)]
    _, detections_of_step, packed = looks_of(scene, rows)
    mean = PLACE + np.sqrt(p0) * np.random.default_rng(0).standard_normal((100, 2))
    near = approximate(detections_of_step, packed, mean, p0)
    away = np.hypot(*(near.mode - PLACE).T)
    stated = np.sqrt(np.trace(covariances(near.root), axis1=1, axis2=2))
    # Prior and bearings pull by what they weigh: by no more than three standard deviations of the posterior, here
    assert (away < 3.0 * stated + 1e-9).all()
    if sigma_px < 1e-2 * np.sqrt(p0):
        assert np.median(away / stated) < 0.1
    assert np.isfinite(near.log_volume).all()
    assert np.isfinite(near.log_factors).all()


def test_what_is_not_wanted_keeps_its_prior():
    scene = room100()
    _, packed, rows = looks_of(scene, noisy_rows(scene, np.random.default_rng(0)))
    mean, p0 = PLACE + np.zeros((2, 2)), np.array([4.0, 4.0])
    near = importance.adapt(mean, p0, np.array([True, False]), packed.first, rows)
    np.testing.assert_array_equal(near.mode[1], PLACE)
    np.testing.assert_array_equal(near.root[1], [2.0, 0.0, 2.0])
    assert (near.log_volume[1], near.log_factors[1]) == (0.0, 0.0)
    assert near.root[0, 0] < 2.0


def test_without_measurements_the_posterior_is_the_prior():
    scene = room100()
    _, packed, rows = looks_of(scene, [(0, None), (3, None)])
    near = approximate(packed, rows, [[20.0, 30.0]], 4.0)
    np.testing.assert_allclose(near.mode, [[20.0, 30.0]])
    np.testing.assert_allclose(near.root, [[2.0, 0.0, 2.0]])
    np.testing.assert_allclose([near.log_volume[0], near.log_factors[0]], 0.0, atol=1e-12)


@pytest.mark.parametrize("defensive", [0.0, 0.05, 0.5, 1.0])
def test_positions_are_drawn_from_either_part_and_their_ratio_is_that_of_the_densities(defensive):
    n, rng = 50, np.random.default_rng(3)
    m0, p0, mode = rng.normal(size=(n, 2)), rng.uniform(0.5, 4.0, n), rng.normal(size=(n, 2))
    root = np.column_stack([rng.uniform(0.2, 1.0, n), rng.normal(size=n), rng.uniform(0.2, 1.0, n)])
    u, noise = rng.random(n), rng.standard_normal((n, 2))
    u[0] = defensive
    xy, ratio = importance.draw(m0, p0, mode, root, defensive, u, noise)
    for i, (a, b, c) in enumerate(root):
        near = mode[i] + np.array([[a, b], [0.0, c]]) @ noise[i]
        np.testing.assert_allclose(xy[i], m0[i] + np.sqrt(p0[i]) * noise[i] if u[i] < defensive else near)
        prior = multivariate_normal(m0[i], p0[i] * np.eye(2))
        q = (1 - defensive) * multivariate_normal(mode[i], covariances(root[[i]])[0]).pdf(xy[i])
        q += defensive * prior.pdf(xy[i])
        assert ratio[i] == pytest.approx(prior.logpdf(xy[i]) - np.log(q), abs=1e-9)


def test_late_signals_share_the_factor_of_a_distance_with_false_ones():
    """The tail counts as if it were flat: exact where it begins, and above the likelihood elsewhere."""
    blank, place = np.zeros(3), np.zeros((3, 2))
    kinds = np.array([distances.RANGE, distances.LOGARITHM, distances.DIFFERENCE])
    rows = distances.RangeMeasurements(
        kinds, blank, np.full(3, 0.5), place, blank, place, blank, np.arange(3), late=0.1
    )
    first, packed = importance.with_distances(np.zeros(1, dtype=np.int64), np.empty((0, 12)), rows)
    assert first.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(packed[:, importance.SCALE], [0.9, 1.0, 0.81])
    u = np.array([3.0, 0.0, 3.0])  # a residual that only a detour or a false value explains
    whole = np.exp(log_density(u, rows.errors)) / np.sqrt(2.0 * np.pi) / 0.5
    reported = packed[:, importance.SCALE] * norm.pdf(u) / 0.5 + packed[:, importance.CLUTTER]
    assert (reported >= whole * 0.999).all()
    assert (reported <= 2.5 * whole).all()
