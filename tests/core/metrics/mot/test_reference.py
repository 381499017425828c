"""All figures for many targets against enumeration from the definitions, on small random scenes."""

from __future__ import annotations

import math

import mot_reference as plain
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.core.metrics.mot.clear_mot import CHALLENGE, CLASSIC, ClearRule, clear_mot
from occlog.core.metrics.mot.failure_rates import failures
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_boxes, of_points
from occlog.core.metrics.mot.gospa import gospa
from occlog.core.metrics.mot.hota import ALPHAS, hota, identity

LIMIT = 0.8
KINDS = [(seed, boxes) for seed in range(12) for boxes in (False, True)]


def overlap_distance(a: plain.Place, b: plain.Place) -> float:
    return 1.0 - plain.iou(a, b)


def measures(boxes: bool) -> tuple[plain.Measure, plain.Measure]:
    """Similarity and distance."""
    return (plain.iou, overlap_distance) if boxes else (plain.closeness(LIMIT), math.dist)


def laid(scene: plain.Scene, boxes: bool, seed: int = 1) -> MatchedFrames:
    sides = plain.objects(scene, 0, seed=seed), plain.objects(scene, 1, seed=seed + 1)
    return of_boxes(*sides) if boxes else of_points(*sides, LIMIT)


@pytest.mark.parametrize("rule", [CLASSIC, CHALLENGE, ClearRule(memory=3), ClearRule(most=False)])
@pytest.mark.parametrize(("seed", "boxes"), KINDS)
def test_clear_mot_is_that_of_enumeration(seed: int, boxes: bool, rule: ClearRule) -> None:
    scene = plain.random_scene(seed, boxes)
    similar, distance = measures(boxes)
    want = plain.clear(scene, similar, distance, rule.memory, rule.most)
    got = clear_mot(laid(scene, boxes), rule)
    for name in ("tp", "fp", "fn", "switches", "fragmentations", "mostly_tracked", "mostly_lost"):
        assert getattr(got, name) == want[name], name
    assert got.motp * got.tp == pytest.approx(want["distance"], rel=1e-12)
    assert got.motp_similarity * got.tp == pytest.approx(want["similarity"], rel=1e-12)
    assert got.mota == pytest.approx(1 - (want["fp"] + want["fn"] + want["switches"]) / got.objects, rel=1e-12)
    assert got.recall == got.tp / (got.tp + got.fn)
    assert got.precision == got.tp / (got.tp + got.fp)


def test_the_scenes_have_what_is_counted() -> None:
    parts = [clear_mot(laid(plain.random_scene(seed, boxes), boxes)) for seed, boxes in KINDS]
    assert sum(part.switches for part in parts) > 100
    assert sum(part.fragmentations for part in parts) > 100
    assert sum(part.mostly_tracked for part in parts) > 10
    rules = [clear_mot(laid(plain.random_scene(seed, boxes), boxes), CHALLENGE) for seed, boxes in KINDS]
    assert any(a.switches != b.switches for a, b in zip(parts, rules, strict=True))


@pytest.mark.parametrize(("seed", "boxes"), KINDS[:16])
def test_identity_is_that_of_enumeration(seed: int, boxes: bool) -> None:
    scene = plain.random_scene(seed, boxes)
    got = identity(laid(scene, boxes))
    want = plain.idtp(scene, measures(boxes)[0])
    n, m = (sum(len(sides[k]) for sides in scene.values()) for k in range(2))
    assert (got.idtp, got.idfn, got.idfp) == (want, n - want, m - want)
    assert got.idf1 == pytest.approx(2 * want / (n + m), rel=1e-12)
    assert (got.idp, got.idr) == (want / m, want / n)


@pytest.mark.parametrize(("seed", "boxes"), KINDS)
def test_hota_is_that_of_enumeration(seed: int, boxes: bool) -> None:
    scene = plain.random_scene(seed, boxes)
    got = hota(laid(scene, boxes))
    for a in range(0, len(ALPHAS), 3):
        want = plain.hota(scene, measures(boxes)[0], float(ALPHAS[a]))
        for name, value in want.items():
            assert getattr(got, name)[a] == pytest.approx(value, rel=1e-12, abs=1e-15), name


@pytest.mark.parametrize(("p", "alpha"), [(2.0, 2.0), (1.0, 2.0), (2.0, 1.0), (3.0, 0.5)])
@pytest.mark.parametrize(("seed", "boxes"), KINDS[:12])
def test_gospa_is_that_of_enumeration(seed: int, boxes: bool, p: float, alpha: float) -> None:
    scene = plain.random_scene(seed, boxes)
    distance = measures(boxes)[1]
    cutoff = 0.7
    got = gospa(laid(scene, boxes), cutoff, p, alpha)
    for t, frame in enumerate(got.frame.tolist()):
        sides = [list(side.values()) for side in scene[frame]]
        assert got.gospa[t] == pytest.approx(plain.gospa(*sides, distance, cutoff, p, alpha), rel=1e-12)
        if alpha == 2.0:
            assert got.gospa[t] ** p == pytest.approx(plain.gospa_parts(*sides, distance, cutoff, p), rel=1e-12)
    parts = got.localisation + got.missed + got.false
    np.testing.assert_allclose(got.gospa**p, parts, rtol=1e-12)
    np.testing.assert_allclose(got.missed, cutoff**p / alpha * got.n_missed)


@pytest.mark.parametrize("seed", range(12))
def test_failures_are_those_of_plain_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tau = {label: float(rng.uniform(0.3, 1.2)) for label in range(10, 14)}
    scene: plain.Scene = {}
    for frame, (truth, _) in plain.random_scene(seed, False, frames=30).items():
        where = {k: tuple(np.add(at, rng.normal(0.0, 0.7, 2))) for k, at in truth.items() if rng.random() < 0.9}
        scene[frame] = truth, {**where, 99: tuple(rng.uniform(0.0, 4.0, 2))}
    truth = plain.objects(scene, 0, seed=3)
    got = failures(truth, plain.objects(scene, 1, seed=4), np.array([tau[k] for k in truth.label.tolist()]))
    rows = sorted(zip(got.frame.tolist(), got.target.tolist(), got.causes(), strict=True))
    want = plain.failures(scene, tau)
    assert rows == want
    assert 5 < np.count_nonzero(got.label) < len(want) - 5
    assert got.fr_p == sum(not cause.startswith("tracker") for *_, cause in want) / got.total
    assert got.fr_l == sum(cause.startswith("tracker") for *_, cause in want) / got.total


@pytest.mark.parametrize("boxes", [False, True])
def test_views_are_pooled(boxes: bool) -> None:
    """Figures of several views are those of one long recording in which nothing has the same label."""
    scenes = [plain.random_scene(seed, boxes) for seed in (5, 6, 7)]
    sides, long = [], []
    for k in range(2):
        parts = [plain.objects(scene, k, view) for view, scene in enumerate(scenes)]
        whole = Objects(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        sides.append(whole)
        long.append(Objects(whole.frame + 100 * whole.view, whole.label + 1000 * whole.view, whole.position))
    one, other = (of_boxes(*s) if boxes else of_points(*s, LIMIT) for s in (sides, long))
    for rule in (CLASSIC, CHALLENGE):
        a, b = clear_mot(one, rule), clear_mot(other, rule)
        assert a[:-1] == b[:-1]
        assert a.tp == sum(clear_mot(laid(scene, boxes), rule).tp for scene in scenes)
        assert a.switches == sum(clear_mot(laid(scene, boxes), rule).switches for scene in scenes)
    assert identity(one)[:-1] == identity(other)[:-1]
    assert identity(one).idtp == sum(identity(laid(scene, boxes)).idtp for scene in scenes)
    assert hota(one).means() == hota(other).means()
    assert gospa(one, 0.7).means() == gospa(other, 0.7).means()


@pytest.mark.parametrize(("seed", "boxes"), KINDS)
def test_what_does_not_tell_truth_from_tracks_stays_when_they_are_swapped(seed: int, boxes: bool) -> None:
    scene = plain.random_scene(seed, boxes)
    frames = laid(scene, boxes)
    swapped = laid({t: (tracks, truth) for t, (truth, tracks) in scene.items()}, boxes)
    one, other = hota(frames), hota(swapped)
    for a, b in (("hota", "hota"), ("ass_a", "ass_a"), ("ass_re", "ass_pr"), ("det_re", "det_pr"), ("loc_a", "loc_a")):
        np.testing.assert_allclose(getattr(one, a), getattr(other, b), rtol=1e-12)
    assert (identity(frames).idtp, identity(frames).idfp) == (identity(swapped).idtp, identity(swapped).idfn)
    np.testing.assert_allclose(gospa(frames, 0.7).gospa, gospa(swapped, 0.7).gospa, rtol=1e-12)
    np.testing.assert_allclose(gospa(frames, 0.7).missed, gospa(swapped, 0.7).false, rtol=1e-12)


@given(st.integers(0, 10**6), st.floats(1.0, 4.0), st.floats(0.05, 2.0), st.floats(0.1, 3.0))
def test_gospa_keeps_the_triangle_inequality(seed: int, p: float, alpha: float, cutoff: float) -> None:
    rng = np.random.default_rng(seed)
    sets = []
    for n in rng.integers(0, 5, 3):
        sets.append(Objects(np.zeros(n, dtype=np.int64), np.arange(n), rng.uniform(0.0, 2.0, (n, 2))))
    a, b, c = (
        float(np.sum(gospa(of_points(sets[i], sets[j], 1.0), cutoff, p, alpha).gospa))
        for i, j in ((0, 1), (1, 2), (0, 2))
    )
    assert c <= (a + b) * (1 + 1e-12) + 1e-12
