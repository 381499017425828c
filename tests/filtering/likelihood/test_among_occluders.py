"""Likelihoods among people with normal priors against plain NumPy, and their limits; see also `..._union`."""

from __future__ import annotations

from dataclasses import replace

import apf_reference as ref_step
import numpy as np
import occlusion_reference as ref
import pytest
from tracker_scenes import PILLAR, ROOM, room100, scan, true_u, with_array

from occlog.core.geometry.visibility import seen_from
from occlog.core.occlusion.occlusion_probability import IMPROVED, PRINTED, QUADRATURE, make_grid, unhidden_over
from occlog.core.occlusion.priors import gaussian_priors, no_priors
from occlog.filtering.likelihood.directions import (
    EXACT,
    INDEPENDENT,
    RECURSION,
    DetectionModel,
    Occlusion,
    factors,
    log_likelihood,
    log_likelihood_among,
)
from occlog.track.methods.apf.model import pack_noise, pack_scan, pack_sensors, read_noise

FLOOR = 1e-4
TARGET = np.array([28.0, 66.0])


def detection(scene, rng=None):
    """Probabilities that differ from camera to camera, or those of the paper."""
    S = len(scene.cameras) + len(scene.arrays)
    if rng is None:
        hit, false = np.ones(S), np.full(S, 1e-4)
    else:
        hit, false = rng.uniform(0.7, 1.0, S), rng.uniform(1e-3, 0.1, S)
    return DetectionModel(hit, 1.0 - hit, false, 0.01, np.full(S, 0.9), np.full(S, 1.3))


def reference_scene(scene):
    cameras = [
        ref_step.RefCamera(c.ground, c.yaw, c.focal_px[0], c.fov, c.range, c.sigma_position, c.sigma_yaw)
        for c in scene.cameras
    ]
    return ref_step.RefScene(ROOM, [PILLAR], cameras)


def looks_of(scene, rng, cameras):
    """Readings near the target; every third observation is empty, one reads nonsense."""
    u = np.array(true_u(scene, TARGET))[:cameras] + rng.normal(0, 3, cameras)
    u[np.abs(u) > 70] = np.nan
    u[rng.random(cameras) < 0.3] = np.nan
    if cameras > 4:
        u[4] = 44.0
    return pack_scan(scan(0, [(i, None if np.isnan(v) else v) for i, v in enumerate(u)]), read_noise(scene), True)


def people(rng, M, kind="general"):
    mean = rng.uniform(0, 100, (M, 2))
    if kind == "isotropic":
        return mean, np.tile(rng.uniform(9, 50) * np.eye(2), (M, 1, 1))
    half = rng.standard_normal((M, 2, 2))
    return mean, 6.0 * np.eye(2) + 12.0 * half @ half.transpose(0, 2, 1)


def near(seed, spread, L=400):
    return TARGET + spread * np.random.default_rng(seed + 7).standard_normal((L, 2))


def parts_of(scene, observations, xy, model):
    """a (L, n), b (n,) and assigned (L, n) of every observation."""
    sensors, noise = pack_sensors(scene), pack_noise(scene)
    a, b, assigned = [], [], []
    for k, i in enumerate(observations.sensor):
        seen = seen_from(xy, i, sensors)
        values, hidden = factors(xy, k, observations, sensors, noise, model, seen)
        a.append(values)
        b.append(hidden)
        assigned.append(seen & (sensors.cos2[i] >= 0))
    return np.column_stack(a), np.array(b), np.column_stack(assigned)


def among(scene, observations, xy, model, priors, probability, form=IMPROVED, floor=FLOOR):
    packed = pack_sensors(scene), pack_noise(scene), model
    free = np.ones(len(xy), dtype=np.bool_)
    return log_likelihood_among(xy, observations, *packed, free, priors, Occlusion(probability, form, floor, 5.5))


def assert_alike(found, want):
    """Within 1e-6 of the largest likelihood."""
    scale = want.max()
    assert scale > 0
    np.testing.assert_allclose(np.exp(found - np.log(scale)), want / scale, rtol=0, atol=1e-6)


@pytest.mark.parametrize("form", [PRINTED, IMPROVED])
@pytest.mark.parametrize("kind", ["isotropic", "general"])
@pytest.mark.parametrize(("cameras", "M", "spread"), [(1, 5, 10.0), (4, 20, 1.0), (8, 40, 2.0), (8, 0, 2.0)])
@pytest.mark.parametrize("seed", range(3))
def test_independent_cameras_are_those_of_the_plain_form(seed, cameras, M, spread, kind, form):
    rng, scene = np.random.default_rng(seed), room100()
    model, packed, xy = detection(scene, rng if seed else None), looks_of(scene, rng, cameras), near(seed, spread)
    mean, covariance = people(rng, M, kind)
    given = ref.RefPriors(mean, covariance, 3.33, improved=form == IMPROVED)
    a, b, assigned = parts_of(scene, packed, xy, model)
    share = np.column_stack([ref.clear(xy, scene.cameras[i].ground, given) for i in packed.sensor])
    want = ref.independent(a, b, assigned, share, FLOOR)
    assert_alike(among(scene, packed, xy, model, gaussian_priors(mean, covariance, 3.33), INDEPENDENT, form), want)


@pytest.mark.parametrize(("cameras", "M", "spread"), [(2, 5, 10.0), (4, 12, 2.0), (6, 20, 4.0)])
@pytest.mark.parametrize("seed", range(2))
def test_recursion_is_the_sum_over_all_patterns(seed, cameras, M, spread):
    rng, scene = np.random.default_rng(seed), room100()
    model, packed, xy = detection(scene, rng if seed else None), looks_of(scene, rng, cameras), near(seed, spread, 60)
    mean, covariance = people(rng, M)
    given = ref.RefPriors(mean, covariance, 3.33)
    a, b, assigned = parts_of(scene, packed, xy, model)
    q = np.stack([ref.hiding(xy, scene.cameras[i].ground, given) for i in packed.sensor], axis=1)
    chances = lambda rows, use: ref.patterns_disjoint(q[np.ix_(rows, use)])  # noqa: E731
    want = ref.over_patterns(a, b, assigned, chances, FLOOR)
    assert_alike(among(scene, packed, xy, model, gaussian_priors(mean, covariance, 3.33), RECURSION), want)


@pytest.mark.parametrize("probability", [INDEPENDENT, RECURSION, EXACT])
def test_without_anybody_it_is_the_plain_likelihood(probability):
    rng, scene = np.random.default_rng(3), with_array(room100(), (50, 5))
    model, packed, xy = detection(scene, rng), looks_of(scene, rng, 8), near(3, 20.0)
    free = np.ones(len(xy), dtype=np.bool_)
    plain = log_likelihood(xy, packed, pack_sensors(scene), pack_noise(scene), model, free)
    found = among(scene, packed, xy, model, no_priors(), probability, floor=0.0)
    np.testing.assert_allclose(found, plain, atol=1e-9)


@pytest.mark.parametrize("probability", [INDEPENDENT, RECURSION, EXACT])
def test_places_off_the_floor_are_impossible_and_others_as_before(probability):
    rng, scene = np.random.default_rng(4), room100()
    model, detections_of_step, xy = detection(scene), looks_of(scene, rng, 3), near(4, 3.0, 40)
    priors, free = gaussian_priors(*people(rng, 6), 3.33), rng.random(40) < 0.7
    packed = pack_sensors(scene), pack_noise(scene), model
    occlusion = Occlusion(probability, QUADRATURE, FLOOR, 5.5)
    found = log_likelihood_among(xy, detections_of_step, *packed, free, priors, occlusion)
    everywhere = among(scene, detections_of_step, xy, model, priors, probability, QUADRATURE)
    assert np.all(found[~free] == -np.inf)
    np.testing.assert_allclose(found[free], everywhere[free], atol=1e-6)


def test_who_certainly_hides_the_target_leaves_the_floor():
    """A known person between the only camera and the place: the reading has the weight `floor` of its density."""
    scene, model = room100(), detection(room100())
    camera = scene.cameras[0].ground
    xy = TARGET[None]
    packed = pack_scan(scan(0, [(0, true_u(scene, TARGET)[0])]), read_noise(scene), True)
    a, b, assigned = parts_of(scene, packed, xy, model)
    assert assigned[0, 0]
    priors = gaussian_priors((camera + 0.5 * (TARGET - camera))[None], np.zeros((1, 2, 2)), 3.33)
    for probability, want in ((INDEPENDENT, FLOOR * a[0, 0] + b[0]), (RECURSION, max(b[0], FLOOR * a[0, 0]))):
        found = among(scene, packed, xy, model, priors, probability)
        assert found[0] == pytest.approx(np.log(want), abs=1e-9)
    aside = gaussian_priors((camera + 1.5 * (TARGET - camera))[None], np.zeros((1, 2, 2)), 3.33)
    assert among(scene, packed, xy, model, aside, RECURSION)[0] == pytest.approx(np.log(a[0, 0]), abs=1e-9)


@pytest.mark.parametrize("temper", [0.0, 0.3, 1.0])
def test_tempered_probabilities_are_powers_of_those_of_independent_cameras(temper):
    rng, scene = np.random.default_rng(11), room100()
    model, xy = detection(scene, rng), near(11, 3.0, 80)
    true = true_u(scene, TARGET)
    packed = pack_scan(scan(0, [(0, true[0]), (3, None), (5, true[5] + 1.0)]), read_noise(scene), True)
    priors = gaussian_priors(*people(rng, 30), 3.33)
    a, b, assigned = parts_of(scene, packed, xy, model)
    sensors, free = pack_sensors(scene), np.ones(len(xy), dtype=np.bool_)
    want = np.ones(len(xy))
    for k, i in enumerate(packed.sensor):
        rows = np.flatnonzero(assigned[:, k])
        grid = make_grid(xy, free, priors, 5.5)
        share = np.ones(len(xy))
        share[rows] = unhidden_over(grid, xy, rows, *sensors.xy[i], priors, IMPROVED, 5.5)
        clear, blocked = np.maximum(share, FLOOR) ** temper, np.maximum(1.0 - share, FLOOR) ** temper
        want *= np.where(assigned[:, k], clear * a[:, k] + blocked * b[k], a[:, k])
    occlusion = Occlusion(INDEPENDENT, IMPROVED, FLOOR, far=5.5, temper=temper)
    found = log_likelihood_among(xy, packed, sensors, pack_noise(scene), model, free, priors, occlusion)
    assert assigned.any(axis=0).all()
    assert_alike(found, want)


@pytest.mark.parametrize("probability", [INDEPENDENT, RECURSION])
def test_candidates_count_as_a_mixture_too(probability):
    """Unlabelled candidates with scores: a hidden target leaves all of them to others, a factor of 1."""
    rng, scene = np.random.default_rng(6), room100()
    model, xy = detection(scene, rng), near(6, 3.0, 60)
    true = true_u(scene, TARGET)
    rows = [(0, true[0], np.nan, 0.7), (0, 12.0, np.nan, 0.2), (5, true[5], np.nan, 0.9), (7, None)]
    packed = pack_scan(scan(0, rows, labelled=False), read_noise(scene), True)
    mean, covariance = people(rng, 20)
    a, assigned = np.ones((60, 3)), np.zeros((60, 3), dtype=bool)
    plain = reference_scene(scene)
    for k, (i, candidates) in enumerate(((0, [(true[0], 0.7), (12.0, 0.2)]), (5, [(true[5], 0.9)]), (7, []))):
        c = plain.cameras[i]
        _, _, assigned[:, [k]] = ref_step.factors(
            xy, [np.nan], [2.0], replace(plain, cameras=[c]), ref_step.RefConfig()
        )
        other = 1.3 / (2 * c.focal * np.tan(c.fov / 2))  # density of other candidates
        total = sum((w * ref_step.density(*ref_step.offsets(xy, c), -u, 2.0, c) for u, w in candidates), np.zeros(60))
        a[:, k] = np.where(assigned[:, k], 0.1 + 0.9 * total / other, 1.0)
    cameras = np.array([plain.cameras[i].xy for i in (0, 5, 7)])
    given = ref.RefPriors(mean, covariance, 3.33, floor=FLOOR, recursion=probability == RECURSION)
    want = ref.among(xy, cameras, a, np.ones(3), assigned, given)
    assert assigned.any(axis=0).all()
    assert_alike(among(scene, packed, xy, model, gaussian_priors(mean, covariance, 3.33), probability), want)


@pytest.mark.parametrize("probability", [RECURSION, EXACT])
def test_too_many_cameras_for_subsets_are_refused(probability):
    scene = room100()
    many = type(scene)(scene.cameras[:1] * 17, (), (), (), scene.room, length_unit="unit")
    packed = pack_scan(scan(0, [(i, None) for i in range(17)]), read_noise(many), True)
    priors = gaussian_priors(np.array([[10.0, 10.0]]), 4.0 * np.eye(2)[None], 3.33)
    with pytest.raises(ValueError, match="likelihood=independent"):
        among(many, packed, TARGET[None], detection(many), priors, probability)


def test_sixteen_cameras_are_summed_over_their_subsets():
    """The limit: `test_too_many_cameras_for_subsets_are_refused` has one more."""
    scene = replace(room100(), cameras=tuple(replace(room100().cameras[0], name=f"c{k}") for k in range(16)))
    given = pack_scan(scan(0, [(k, true_u(scene, TARGET)[0]) for k in range(16)]), read_noise(scene), True)
    model, sensors, noise = detection(scene), pack_sensors(scene), pack_noise(scene)
    occlusion = Occlusion(RECURSION, PRINTED, FLOOR, 5.5)
    xy, priors = TARGET[None], gaussian_priors(np.array([[40.0, 40.0]]), 4.0 * np.eye(2)[None], 3.0)
    got = log_likelihood_among(xy, given, sensors, noise, model, np.ones(1, dtype=bool), priors, occlusion)
    assert np.isfinite(got).all()


@pytest.mark.parametrize("fov_deg", [179.0, 180.0, 200.0, 360.0])
@pytest.mark.parametrize("probability", [INDEPENDENT, RECURSION])
def test_people_hide_a_target_from_cameras_of_any_field_of_view(probability, fov_deg):
    scene = replace(room100(), cameras=(replace(room100().cameras[0], fov=np.radians(fov_deg)),))
    packed = pack_scan(scan(0, [(0, None)]), read_noise(scene), True)
    middle = 0.5 * (scene.cameras[0].ground + TARGET)
    priors = gaussian_priors(middle[None], 0.01 * np.eye(2)[None], 3.0)
    model = detection(scene)._replace(miss=np.full(1, 1e-3))
    free = among(scene, packed, TARGET[None], model, no_priors(), probability)
    hidden = among(scene, packed, TARGET[None], model, priors, probability)
    assert free[0] == pytest.approx(np.log(1e-3), abs=0.2)
    assert hidden[0] > -0.01
