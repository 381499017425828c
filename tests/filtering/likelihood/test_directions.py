"""Likelihood kernels against SciPy's normal distribution and probabilities worked by hand."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import shapely
from scipy import stats
from tracker_scenes import room100, scan, true_u, with_array, wrap

from occlog.core.geometry.visibility import seen_from
from occlog.filtering.likelihood.directions import DetectionModel, factors, likely_inliers, log_likelihood
from occlog.track.methods.apf.model import pack_noise, pack_scan, pack_sensors, read_noise

PAPER = DetectionModel(hit=1.0, miss=1.0, false=0.0, soften=0.0, candidate=0.9, clutter=1.0)
SCENE = room100()
EVERYWHERE = np.random.default_rng(0).uniform(1, 99, (400, 2))


@functools.cache
def packed_scene(scene):
    return pack_sensors(scene), pack_noise(scene)


def factors_of(scene, given, xy, model=PAPER, use_score=True):
    packed = pack_scan(given, read_noise(scene), use_score)
    xy, (sensors, noise) = np.atleast_2d(xy), packed_scene(scene)
    columns = []
    for k, i in enumerate(packed.sensor):
        columns.append(factors(xy, k, packed, sensors, noise, spread(model, scene), seen_from(xy, i, sensors))[0])
    return np.column_stack(columns)


def spread(model, scene):
    """The same probabilities for every sensor."""
    S = len(scene.cameras) + len(scene.arrays)
    return DetectionModel(*(v if name == "soften" else np.full(S, v) for name, v in model._asdict().items()))


def loglik_of(scene, given, xy, model=PAPER, free=None):
    detections_of_step = pack_scan(given, read_noise(scene), True)
    free = np.ones(len(xy), dtype=np.bool_) if free is None else free
    packed = pack_sensors(scene), pack_noise(scene), spread(model, scene)
    return log_likelihood(xy, detections_of_step, *packed, free)


def density(camera, xy, u, sigma_read):
    """[Ercan] Eqs. 1 and 2 as printed, with theta = yaw + pi; NaN behind the camera."""
    theta = camera.yaw + np.pi
    x = xy - camera.ground
    h = np.sin(theta) * x[:, 0] - np.cos(theta) * x[:, 1]
    d = -np.cos(theta) * x[:, 0] - np.sin(theta) * x[:, 1]
    d = np.where(d > 0, d, np.nan)
    f = camera.focal_px[0]
    variance = (
        f**2 * (1 + h**2 / d**2) ** 2 * camera.sigma_yaw**2
        + f**2 * (h**2 + d**2) / d**4 * camera.sigma_position**2
        + sigma_read**2
    )
    return stats.norm.pdf(-u, f * h / d, np.sqrt(variance))


def sees(camera, xy):
    azimuth = np.arctan2(*(xy - camera.ground).T[::-1])
    in_view = np.abs(wrap(azimuth - camera.yaw)) <= camera.fov / 2
    pillar = shapely.Polygon(SCENE.occluders[0].polygon)
    lines = shapely.linestrings(np.stack([np.broadcast_to(camera.ground, xy.shape), xy], axis=1))
    hidden = shapely.length(shapely.intersection(lines, pillar)) > 1e-9
    return in_view & ~hidden


@pytest.mark.parametrize("seed", range(5))
def test_seen_cameras_have_the_textbook_density_and_others_nothing(seed):
    rng = np.random.default_rng(seed)
    u = rng.uniform(-60, 60, 8)
    sigma = np.where(rng.random(8) < 0.5, np.nan, rng.uniform(1, 5, 8))
    found = factors_of(SCENE, scan(0, [(i, u[i], sigma[i], np.nan) for i in range(8)]), EVERYWHERE)
    for i, camera in enumerate(SCENE.cameras):
        read = camera.sigma_read_px if np.isnan(sigma[i]) else sigma[i]
        expected = np.where(sees(camera, EVERYWHERE), density(camera, EVERYWHERE, u[i], read), 0.0)
        np.testing.assert_allclose(found[:, i], expected, rtol=1e-9)


def test_the_readings_of_a_place_are_most_likely_there():
    xy = np.array([[20.0, 72.0]])
    u = true_u(SCENE, xy[0])
    given = scan(0, [(i, u[i]) for i in range(8) if sees(SCENE.cameras[i], xy)[0]])
    values = loglik_of(SCENE, given, np.add(xy, [[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]]))
    assert values[0] > values[1]
    assert values[0] > values[2]


def test_not_seen_says_nothing_without_a_detection_model_and_how_likely_a_miss_is_with_one():
    given = scan(0, [(i, None) for i in range(8)])
    np.testing.assert_array_equal(factors_of(SCENE, given, EVERYWHERE), 1.0)
    model = PAPER._replace(hit=0.8, miss=0.2)
    visible = np.column_stack([sees(c, EVERYWHERE) for c in SCENE.cameras])
    np.testing.assert_allclose(factors_of(SCENE, given, EVERYWHERE, model), np.where(visible, 0.2, 1.0), rtol=1e-12)


@pytest.mark.parametrize(("detected", "false"), [(0.9, 0.05), (1.0, 0.0), (0.6, 0.3)])
def test_the_detection_model_is_a_probability_over_readings(detected, false):
    """Seen somewhere in the image or not seen: probabilities sum to 1 (up to the constant 1 - P_F of unseen)."""
    model = DetectionModel(detected, 1.0 - detected, false, 0.0, 0.9, 1.0)
    xy = np.array([[30.0, 30.0], [50.0, 70.0]])  # in view of camera 1, and behind the pillar
    u = np.linspace(-70, 70, 401)
    seen = np.array([factors_of(SCENE, scan(0, [(0, value)]), xy, model)[:, 0] for value in u])
    unseen = factors_of(SCENE, scan(0, [(0, None)]), xy, model)[:, 0] * (1.0 - false)
    # Trapezoid rule over the image of 140 px; nearly all of the Gaussian is inside.
    np.testing.assert_allclose(np.trapezoid(seen, u, axis=0) + unseen, 1.0, atol=1e-6)


def test_a_camera_that_sees_what_it_cannot_see_is_forgiven_by_the_softening():
    hidden = np.array([[70.0, 70.0]])  # behind the pillar for camera 1
    beside = np.array([[30.0, -20.0]])  # out of its field of view, but in front
    behind = np.array([[-5.0, -5.0]])
    model = PAPER._replace(soften=0.01, false=0.0)
    for xy in (hidden, beside):
        assert factors_of(SCENE, scan(0, [(0, 1.0)]), xy)[0, 0] == 0.0
        expected = 0.01 * density(SCENE.cameras[0], xy, 1.0, 2.0)[0]
        assert factors_of(SCENE, scan(0, [(0, 1.0)]), xy, model)[0, 0] == pytest.approx(expected, rel=1e-9)
    assert factors_of(SCENE, scan(0, [(0, 1.0)]), behind, model)[0, 0] == 0.0
    floor = factors_of(SCENE, scan(0, [(0, 1.0)]), behind, model._replace(false=1e-3))[0, 0]
    assert floor == pytest.approx(1e-3 / 140.0)


@pytest.mark.filterwarnings("ignore:overflow")  # stated by plain numpy only, with the JIT off
def test_nothing_is_divided_by_zero_at_or_next_to_a_camera():
    camera = SCENE.cameras[1]  # at (50, 0), looking along +y
    xy = np.array([[50.0, 0.0], [55.0, 0.0], [45.0, 1e-12], [50.0, 1e-300], [50.0, -1.0]])
    found = factors_of(SCENE, scan(0, [(1, 0.0)]), xy, PAPER._replace(soften=0.01, false=1e-4))
    assert np.all(np.isfinite(found))
    assert np.all(found > 0)
    assert camera.ground.tolist() == [50.0, 0.0]


def test_bearings_without_pixels_are_wrapped_gaussians_of_the_azimuth():
    scene = with_array(SCENE, (50.0, 50.0), range=30.0)
    xy = np.array([[20.1, 49.0], [20.1, 51.0], [70.0, 50.0], [10.0, 50.0]])
    given = scan(0, [(8, np.nan)])._replace(bearing=np.array([-3.1]), sigma=np.array([0.2]))
    found = factors_of(scene, given, xy)[:, 0]
    azimuth = np.arctan2(xy[:, 1] - 50.0, xy[:, 0] - 50.0)
    expected = stats.norm.pdf(wrap(-3.1 - azimuth), 0.0, 0.2)
    expected[3] = 0.0  # out of range
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    # Across the cut at pi
    assert found[1] == pytest.approx(stats.norm.pdf((np.pi - 3.1) + np.arctan(1.0 / 29.9), 0, 0.2), rel=1e-9)


def test_sound_goes_past_walls_and_a_bearing_of_a_camera_does_not():
    scene = with_array(SCENE, (0.0, 0.0))
    behind_pillar = np.array([[70.0, 70.0]])
    towards = {"bearing": np.array([np.pi / 4]), "sigma": np.array([0.1])}
    assert factors_of(scene, scan(0, [(8, np.nan)])._replace(**towards), behind_pillar)[0, 0] > 3.9
    assert factors_of(scene, scan(0, [(0, np.nan)])._replace(**towards), behind_pillar)[0, 0] == 0.0


def test_candidates_are_weighed_as_in_probabilistic_data_association():
    xy = np.array([[30.0, 30.0], [70.0, 70.0]])  # in view of camera 1, and behind the pillar
    given = scan(0, [(0, -3.0, 4.0, 0.9), (0, 2.0, 3.0, 0.5), (0, 40.0, 2.0, np.nan)], labelled=False)
    model = PAPER._replace(candidate=0.8, clutter=2.0)
    camera = SCENE.cameras[0]
    total = sum(w * density(camera, xy, u, s) for w, u, s in ((0.9, -3.0, 4.0), (0.5, 2.0, 3.0), (1.0, 40.0, 2.0)))
    clutter_density = 2.0 / 140.0
    found = factors_of(SCENE, given, xy, model)[:, 0]
    np.testing.assert_allclose(found, [0.2 + 0.8 * total[0] / clutter_density, 1.0], rtol=1e-9)
    unweighted = factors_of(SCENE, given, xy, model, use_score=False)[0, 0]
    total = sum(density(camera, xy, u, s) for u, s in ((-3.0, 4.0), (2.0, 3.0), (40.0, 2.0)))
    assert unweighted == pytest.approx(0.2 + 0.8 * total[0] / clutter_density, rel=1e-9)
    none = scan(0, [(0, None)], labelled=False)
    np.testing.assert_allclose(factors_of(SCENE, none, xy, model)[:, 0], [0.2, 1.0])


def test_factors_of_a_scan_multiply_and_impossible_places_have_none():
    u = true_u(SCENE, (31.0, 20.0))
    given = scan(0, [(0, u[0]), (2, None), (6, u[6] + 1.0), (7, u[7])])
    model = PAPER._replace(false=1e-4, soften=1e-2)
    free = np.ones(len(EVERYWHERE), dtype=np.bool_)
    free[::3] = False
    found = loglik_of(SCENE, given, EVERYWHERE, model, free)
    expected = np.log(factors_of(SCENE, given, EVERYWHERE, model)).sum(axis=1)
    np.testing.assert_allclose(found[free], expected[free], rtol=1e-12)
    assert np.all(found[~free] == -np.inf)


def test_many_cameras_neither_underflow_nor_overflow():
    scene = room100(pillar=False)
    many = type(scene)(cameras=scene.cameras * 50, room=scene.room)
    rows = [(i, None if np.isnan(u) else 60.0) for i, u in enumerate(true_u(scene, (31.0, 20.0)) * 50)]
    model = PAPER._replace(false=1e-6)
    xy = EVERYWHERE[:20]
    expected = np.log(factors_of(many, scan(0, rows), xy, model)).sum(axis=1)
    found = loglik_of(many, scan(0, rows), xy, model)
    assert expected.min() < -2000
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    sharp = room100(pillar=False, sigma_position=0.0, sigma_yaw=0.0, sigma_read_px=1e-3)
    many = type(sharp)(cameras=sharp.cameras * 50, room=sharp.room)
    u = true_u(sharp, (31.0, 20.0)) * 50
    rows = [(i, u[i]) for i in range(400) if not np.isnan(u[i])]
    high = loglik_of(many, scan(0, rows), np.array([[31.0, 20.0]]))
    assert high[0] > 700.0  # more than a product of densities can hold
    assert np.isfinite(high[0])


def test_a_scan_without_looks_changes_nothing():
    empty = scan(0, [(0, None)])._replace(sensor=np.zeros(0, dtype=np.int64))
    columns = {name: column for name, column in empty._asdict().items() if isinstance(column, np.ndarray)}
    empty = empty._replace(**{name: column[:0] for name, column in columns.items()})
    np.testing.assert_array_equal(loglik_of(SCENE, empty, EVERYWHERE), 0.0)


def test_agreement_tells_which_looks_support_a_place():
    xy = np.array([[30.0, 30.0]])
    u = true_u(SCENE, xy[0])
    detections_of_step = pack_scan(scan(0, [(0, u[0] + 2.0), (2, u[2] + 60.0), (6, None)]), read_noise(SCENE), True)
    packed = pack_sensors(SCENE), pack_noise(SCENE), spread(PAPER._replace(false=1e-4), SCENE)
    assert likely_inliers(xy, detections_of_step, *packed).tolist() == [True, False, False]
    candidates = scan(0, [(0, u[0] + 2.0), (0, 50.0), (2, u[2] + 60.0)], labelled=False)
    assert likely_inliers(xy, pack_scan(candidates, read_noise(SCENE), True), *packed).tolist() == [True, False]


@pytest.mark.parametrize(("labelled", "more"), [(True, 1e-6), (True, -1e-6), (False, 1e-6), (False, -1e-6)])
def test_a_look_agrees_when_the_target_is_more_likely_than_anything_else(labelled, more):
    """At equality hit N W = miss P_F of a labelled reading, and P N W = (1 - P) lambda W of a candidate."""
    xy = np.array([[30.0, 30.0]])
    sensors, noise = packed_scene(SCENE)
    u = true_u(SCENE, xy[0])[0] + 2.0
    packed = pack_scan(scan(0, [(0, u)], labelled=labelled), read_noise(SCENE), True)
    odds = density(SCENE.cameras[0], xy, u, np.sqrt(packed.variance[0]))[0] * noise.width_px[0] * (1.0 + more)
    if labelled:
        model = PAPER._replace(hit=0.01 / odds, miss=0.5, false=0.02)
    else:
        model = PAPER._replace(candidate=0.75, clutter=odds * 0.75 / 0.25)
    assert likely_inliers(xy, packed, sensors, noise, spread(model, SCENE)).tolist() == [more < 0]
