"""Parts of a step of the filter: labels, association, confirmation, deletion and estimates of tracks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from heard_scenes import NS, ROOM, room
from scipy.stats import norm

from occlog.scans.grouping import Scan
from occlog.track.methods.imm import filter as method
from occlog.track.methods.imm import kernel as imm
from occlog.track.methods.imm.association import Direction, direction, merged_bearing_density
from occlog.track.methods.imm.config import ImmConfig, _good_start
from occlog.track.methods.imm.tracks import TENTATIVE, UNLABELLED_TRACK, Moved, Track, make_world, move_track

SCENE = room(ROOM.replace("position: [2, 2, 1], sigma_deg: 2", "position: [2, 2, 1], sigma_deg: 2, range: 9"))
CONFIG = replace(ImmConfig.in_unit("m"), detection_probability=0.8, clutter_rate=0.2)
WORLD = make_world(SCENE, CONFIG)


def track(number=0, label=UNLABELLED_TRACK, exists=0.9, sounds=0.7, hits=5, met_ns=0):
    cloud = imm.ImmParticles(np.zeros((4, 4)), np.zeros(4, dtype=np.int64))
    return Track(number, label, cloud, exists, sounds, hits, met_ns)


def moved(degrees, rng=None, far=5.0, **given):
    """A track with particles about a bearing of array 0, with unequal weights."""
    rng = np.random.default_rng(round(abs(degrees))) if rng is None else rng
    at, predicted = math.radians(degrees) + 0.03 * rng.standard_normal((3, 4)), rng.normal(size=(3, 4, 4))
    predicted[..., 0], predicted[..., 2] = 2.0 + far * np.cos(at), 2.0 + far * np.sin(at)
    weights = rng.dirichlet(np.ones(12)).reshape(3, 4)
    return Moved(track(**given), predicted, weights, weights)


def heard(*degrees, labels=None):
    n = len(degrees)
    scan = Scan.of(0, [len(SCENE.cameras)] * n, bearing=np.radians(degrees), sigma=np.linspace(0.03, 0.05, n))
    return scan if labels is None else scan._replace(target_id=np.array(labels, dtype=np.int32))


def test_known_targets_begin_as_confirmed_tracks_by_number():
    starts = (3.0, 4.0, 0.5, 1.0, -1.0, 0.2, 9.0, 8.0, 0.1, 0.0, 0.5, 0.4)
    state = method.init(SCENE, replace(CONFIG, start=starts, particles=20_000), np.random.default_rng(0))
    assert ([t.number for t in state.tracks], state.free, state.t_ns) == ([0, 1], 2, None)
    for one, (x, y, s, vx, vy, sv) in zip(state.tracks, np.reshape(starts, (2, 6)), strict=True):
        np.testing.assert_allclose(one.cloud.states.mean(axis=0), [x, vx, y, vy], atol=0.02)
        np.testing.assert_allclose(one.cloud.states.std(axis=0), [s, sv, s, sv], rtol=0.03)
        assert (one.exists, one.sounds, one.hits) == (1.0, 1.0, CONFIG.confirmation_hits)


def test_a_start_has_six_values_for_each_target_of_which_deviations_are_not_below_0():
    starts = [-3.0, -4.0, 0.0, -1.0, -1.0, 0.2, -9.0, 8.0, 0.1, 0.0, -0.5, 0.0]
    assert _good_start(None)
    assert _good_start(tuple(starts))
    for entry in range(12):
        changed = tuple(np.where(np.arange(12) == entry, -0.1, starts))
        assert _good_start(changed) == (entry not in (2, 5, 8, 11))
    assert not _good_start(tuple(starts[:7]))
    assert not _good_start(())


def test_a_step_adds_the_stated_noise_of_the_velocity_under_every_model():
    """At rest there are no turns; the standard error of a deviation of 3,000 particles is 1.3 %."""
    world = make_world(SCENE, replace(CONFIG, process_noise_velocity=0.3))
    cloud = imm.ImmParticles(np.tile([8.0, 0.0, 6.0, 0.0], (3_000, 1)), np.zeros(3_000, dtype=np.int64))
    after = move_track(world, track()._replace(cloud=cloud), 1.7, np.random.default_rng(0))
    np.testing.assert_allclose(after.predicted[..., 1::2].std(axis=1), 0.3 * math.sqrt(1.7), rtol=0.06)
    np.testing.assert_allclose(after.predicted[..., ::2].std(axis=1), 0.3 * math.sqrt(1.7**3 / 3.0), rtol=0.06)


def test_tracks_go_on_down_to_the_threshold_and_up_to_the_longest_coasting():
    config = replace(CONFIG, termination_threshold=0.1, max_coasting_s=2.0)
    for exists, seconds, goes_on in ((0.1, 2.0, True), (np.nextafter(0.1, 0.0), 2.0, False), (0.1, 2.001, False)):
        one = track(exists=exists, met_ns=3 * NS)
        assert method._is_kept(one, 3 * NS + round(seconds * NS), config) == goes_on


def test_a_tentative_track_is_confirmed_by_its_existence_and_hits():
    config = replace(CONFIG, confirmation_threshold=0.8, confirmation_hits=3)
    given = [
        track(number=TENTATIVE, exists=0.79, hits=9),
        track(number=TENTATIVE, exists=0.8, hits=3),
        track(number=7),
        track(number=TENTATIVE, exists=1.0, hits=2),
        track(number=TENTATIVE, exists=1.0, hits=4),
    ]
    out, free = method._confirmed([moved(0.0)._replace(track=t) for t in given], 5, config)
    assert [m.track.number for m in out] == [5, 7, 8, TENTATIVE, TENTATIVE]
    assert [m.track.hits for m in out] == [3, 5, 4, 9, 2]
    assert free == 9


def test_a_hit_counts_unless_the_track_is_new():
    for was_heard, initiated, hits, met in ((True, False, 6, 9), (True, True, 5, 9), (False, False, 5, 0)):
        one = method._with_hit(moved(0.0)._replace(heard=was_heard, initiated=initiated), 9)
        assert (one.hits, one.met_ns) == (hits, met)


def test_a_new_label_is_given_to_the_unlabelled_track_that_its_bearing_fits_best():
    tracks = [moved(40.0), moved(20.0), moved(20.5, label=3), moved(60.0)]
    scan = heard(20.0, 40.0, 60.0, 200.0, 20.0, labels=[8, UNLABELLED_TRACK, 9, 5, 3])
    out = method._labelled(WORLD, list(tracks), 0, scan)
    assert [m.track.label for m in out] == [UNLABELLED_TRACK, 8, 3, 9]
    # Its own bearing is that of a label; other bearings of labels are of no other track
    wanted = np.zeros((4, 5), dtype=bool)
    wanted[0, 1] = wanted[1, 0] = wanted[2, 4] = wanted[3, 2] = True
    np.testing.assert_array_equal(method._allowed(out, scan), wanted)
    assert method._allowed(out, heard(20.0, 40.0)).all()
    # With the step itself: one labelled bearing among others suffices
    config = replace(CONFIG, association="any")
    found = method._update_by_array(WORLD._replace(config=config), list(tracks), 0, scan)
    assert [m.track.label for m in found[0]] == [UNLABELLED_TRACK, 8, 3, 9]
    assert found[1].tolist() == [3]


def test_with_any_association_bearings_are_of_a_track_in_proportion_to_their_mean_density():
    one, scan = moved(40.0, exists=0.9, sounds=0.7), heard(41.0, 38.0, 200.0)
    world = WORLD._replace(config=replace(CONFIG, association="any"))
    found, (after,) = method._associate_any(world, [one], 0, scan, np.array([[True, True, False]]))
    at = np.arctan2(one.predicted[..., 2] - 2.0, one.predicted[..., 0] - 2.0)
    density = [norm.pdf(at, b, s) for b, s in zip(scan.bearing[:2], scan.sigma[:2], strict=True)]
    chance, clutter = 0.9 * 0.7 * 0.8, 0.2 / (2.0 * math.pi)
    fit = chance * np.array([np.vdot(one.weights, d) for d in density]) / clutter
    total = 1.0 - chance + fit.sum()
    np.testing.assert_allclose(found.alone, [[*(fit / total), 0.0]], rtol=1e-9)
    np.testing.assert_allclose(found.unheard, [(1.0 - chance) / total], rtol=1e-9)
    assert not found.shared.any()
    weights = one.weights * sum(density)
    np.testing.assert_allclose(after.weights, weights / weights.sum(), rtol=1e-9)
    assert found.log_evidence == pytest.approx(math.log(weights.sum()))
    assert (after.heard, after.arrays) == (True, (0,))


def test_the_density_of_two_targets_heard_as_one_is_the_mean_of_those_at_the_particles_of_either():
    tracks, scan = [moved(40.0), moved(44.0), moved(150.0)], heard(42.0, 39.0)
    world, given = WORLD._replace(resolution=np.full(2, 0.15)), {"bearing": scan.bearing, "sigma": scan.sigma}
    fits = method._fits(world, tracks, 0, scan)
    shared, separate, pairs = method._merged_densities(world, tracks, 0, scan, fits)
    at = [direction(f, m.weights) for f, m in zip(fits, tracks, strict=True)]
    means = []
    for k, b in ((0, 1), (1, 0)):
        each = merged_bearing_density(fits[k], at[k], at[b], **given, resolution=0.15)
        np.testing.assert_array_equal(pairs[k, b], each)
        means.append([np.vdot(tracks[k].weights, one) for one in each])
    np.testing.assert_allclose(shared[0, 1], np.mean(means, axis=0))
    np.testing.assert_array_equal(shared[1, 0], shared[0, 1])
    assert separate[0, 1] == separate[1, 0] == method._resolution_probability(at[0], at[1], 0.15) < 1.0
    assert sorted(pairs) == [(0, 1), (1, 0)]
    assert not shared[2].any()
    assert (separate[2] == 1.0).all()


def test_two_targets_are_resolved_with_the_probability_of_a_difference_beyond_the_resolution():
    """Differences are normal about that of the means, here -0.1 rad around the back of the array."""
    one, other = Direction(-math.pi + 0.04, 0.06), Direction(math.pi - 0.06, 0.08)
    for a, b in ((one, other), (other, one)):
        wanted = norm.sf(0.15, 0.1, 0.1) + norm.cdf(-0.15, 0.1, 0.1)
        assert method._resolution_probability(a, b, 0.15) == pytest.approx(wanted)


@pytest.mark.parametrize(("far", "inside"), [(8.9, True), (9.1, False)])
def test_the_mean_position_decides_on_the_range(far, inside):
    one = moved(30.0, far=far)
    one = one._replace(predicted=one.predicted.mean(axis=(0, 1), keepdims=True) + 0.0 * one.predicted)
    at = one.predicted[0, 0, ::2] - 2.0
    one.predicted[..., ::2] = 2.0 + far * at / np.hypot(*at)
    assert method._in_range(WORLD, one, 0) == inside
    assert method._in_range(WORLD, one, 1)


@pytest.mark.parametrize(("ess", "fallback"), [(9.99, "depleted"), (10.0, "")])
def test_an_estimate_has_positions_velocities_and_what_was_heard(ess, fallback):
    half = np.random.default_rng(0).normal(size=(4, 4))
    whole = imm.ModelEstimates(np.array([1.0, 0.1, 2.0, 0.2]), half @ half.T, np.ones(1), np.ones((1, 4)), half[None])
    one = moved(0.0)._replace(heard=True, arrays=(1, 0))
    counts = tuple(method.Count(a, 1, 1, np.empty(0, dtype=np.int64)) for a in range(2))
    for evidence, wanted in ((-3.5, -3.5), (-math.inf, math.nan)):
        report = method.ImmStepResult((method.TrackPosterior(4, one, whole, ess),), counts, heard(0.0), evidence)
        ((number, got),) = method.estimates(report, SCENE)
        assert number == 4
        np.testing.assert_array_equal(got.xy, [1.0, 2.0])
        np.testing.assert_array_equal(got.velocity, [0.1, 0.2])
        np.testing.assert_array_equal(got.covariance, (half @ half.T)[np.ix_([0, 2], [0, 2])])
        assert got.log_likelihood == pytest.approx(wanted, nan_ok=True)
        cameras = len(SCENE.cameras)
        assert (got.ess, got.n_observing, got.n_detected, got.used) == (ess, 2, 1, (cameras + 1, cameras))
        assert got.fallback == fallback
