"""The pieces of the JIPDA update, and all of it, against their equations (`jipda_reference`) on random scenes."""

from __future__ import annotations

from itertools import product

import jipda_reference as textbook
import numpy as np
import pytest
from random_frames import Scene, plain, random_scene

from occlog.array_types import Floats, Ints
from occlog.track.methods.jipda.kernels import joint_association as joint
from occlog.track.methods.jipda.kernels.detections import PackedDetections
from occlog.track.methods.jipda.kernels.likelihood import association_likelihood_ratios
from occlog.track.methods.jipda.kernels.merged_detections import overlapping_pairs, pair_likelihoods

NEW, GATE = 0.1, 30.0
SEEDS = range(5)


class Frame:
    """Camera 0 of a scene: what the kernels and the equations predict of it."""

    def __init__(self, scene: Scene) -> None:
        N = len(scene.mean)
        self.scene, self.detector = scene, scene.detectors[0]
        self.predicted = joint.PredictedBoxes(
            mean=scene.mean, covariance=scene.covariance, existence=scene.existence, outline=np.empty((N, 4)),
            slope=np.zeros((N, 4, 6)), box=np.empty((N, 4)), spread=np.empty((N, 4, 4)), noise=np.empty((N, 4, 4)),
            update_noise=np.empty((N, 4, 4)), depth=np.empty(N), across=np.zeros(N), deep=np.ones(N),
            covered=np.zeros(N),
        )  # fmt: skip
        self.visible, self.detection = np.empty(N), np.empty(N)
        _, delay, self.box, self.use, self.clutter, self.features = scene.frames()[0]
        plain(joint.predict_boxes)(scene.views, 0, delay, scene.rates, self.predicted)
        plain(joint.detection_probabilities)(scene.views, 0, scene.rates, self.predicted, self.visible, self.detection)
        self.seen = [
            textbook.predicted(scene.cameras[0], scene.mean[i], scene.covariance[i], delay, self.detector)
            for i in range(N)
        ]
        self.pairs = textbook.who_touch(self.seen, scene.existence)
        self.pair = np.array(self.pairs, dtype=np.int64).reshape(-1, 2)
        self.m = len(self.box)


@pytest.fixture(params=SEEDS)
def frame(request: pytest.FixtureRequest) -> Frame:
    """One of the random frames."""
    return Frame(random_scene(request.param))


def test_predicted_boxes_are_projected_quadrics_with_the_covariance_of_the_state(frame: Frame) -> None:
    p = frame.predicted
    for i, seen in enumerate(frame.seen):
        assert (seen is None) == (p.depth[i] < 0.0)
        if seen is not None:
            got = (
                p.outline[i],
                p.slope[i],
                p.box[i],
                p.spread[i],
                p.noise[i],
                p.update_noise[i],
                p.depth[i],
                p.across[i],
            )
            for value, wanted in zip((*got, p.deep[i]), seen, strict=True):
                np.testing.assert_allclose(value, wanted, rtol=1e-6, atol=1e-5)


def test_detection_follows_the_visible_share(frame: Frame) -> None:
    for i, seen in enumerate(frame.seen):
        if seen is None:
            assert np.isnan(frame.visible[i])
            assert frame.detection[i] == frame.predicted.covered[i] == 0.0
            continue
        cells = textbook.visible_cells(frame.scene.cameras[0], i, frame.seen, frame.scene.existence)
        assert frame.visible[i] == pytest.approx(cells.mean(), abs=1e-8)
        assert frame.predicted.covered[i] == pytest.approx(1.0 - cells[-1].mean(), abs=1e-8)
        wanted = frame.detector.detection * textbook.curve_at(frame.detector.curve, cells.mean())
        assert frame.detection[i] == pytest.approx(wanted, abs=1e-8)


def test_pairs_touch_in_the_image(frame: Frame) -> None:
    p = frame.predicted
    assert overlapping_pairs(p.outline, p.depth, p.across, p.existence).tolist() == frame.pair.tolist()


def ratios(frame: Frame) -> tuple[Floats, Floats, Ints]:
    """Likelihood ratios, probabilities that edges are whole, and outliers, by the equations."""
    N = len(frame.seen)
    ratio, whole, outlier = np.zeros((N, frame.m)), np.ones((N, frame.m)), np.full((N, frame.m), -1)
    for i, seen in enumerate(frame.seen):
        for j in range(frame.m if seen is not None and frame.detection[i] >= 1e-4 else 0):
            clutter = textbook.log_clutter(frame.box[j], frame.use[j], (1280, 720)) + frame.clutter[j]
            assert seen is not None
            ratio[i, j], whole[i, j], outlier[i, j] = textbook.likelihood(
                frame.box[j], frame.use[j], seen, frame.predicted.covered[i], frame.detector,
                clutter - frame.features[i, j], GATE,
            )  # fmt: skip
    return ratio, whole, outlier


def test_likelihoods_are_mixtures_of_whole_boxes_and_of_outlier_edges(frame: Frame) -> None:
    p, s = frame.predicted, frame.scene
    got = plain(association_likelihood_ratios)(
        p.box, p.noise, p.spread, p.covered, frame.detection, s.boxes, 0, frame.m, s.rates,
        1280.0, 720.0, s.features, GATE,
    )  # fmt: skip
    ratio, whole, outlier = ratios(frame)
    np.testing.assert_allclose(got.ratio, ratio, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(got.whole, whole, rtol=1e-5, atol=1e-12)
    np.testing.assert_array_equal(got.outlier, outlier)


def outlines(frame: Frame) -> tuple[Floats, list[Floats]]:
    """Likelihood ratios of outlines of two, and whose their edges are, by the equations."""
    ratio, own = np.zeros((len(frame.pairs), frame.m)), []
    for k, (a, b) in enumerate(frame.pairs):
        one, two = frame.seen[a], frame.seen[b]
        assert one is not None
        assert two is not None
        union = textbook.outline_of_two(one, two)
        own.append(union.own)
        seen = textbook.curve_at(frame.detector.curve, max(frame.visible[a], frame.visible[b]))
        for j in range(frame.m):
            off = frame.box[j] - union.box
            log, distance = textbook.log_density(off, frame.use[j], union.S)
            if distance < GATE and not (frame.use[j] & (off**2 > 2.0 * GATE * np.diag(union.S))).any():
                log -= textbook.log_clutter(frame.box[j], frame.use[j], (1280, 720)) + frame.clutter[j]
                ratio[k, j] = frame.detector.merge * frame.detector.detection * seen * np.exp(log) / (1.0 + NEW)
    return ratio, own


def test_likelihoods_of_two_are_those_of_their_outline(frame: Frame) -> None:
    p, s = frame.predicted, frame.scene
    got, own = plain(pair_likelihoods)(
        frame.pair, p.box, p.noise, p.spread, frame.visible, s.boxes, 0, frame.m, s.rates, 0, 1280.0, 720.0, NEW, GATE
    )  # fmt: skip
    ratio, owner = outlines(frame)
    np.testing.assert_allclose(got, ratio, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(own, np.array(owner).reshape(-1, 4), atol=1e-6)


def associated(frame: Frame) -> tuple[joint.BoxAssociation, textbook.Association]:
    """Both, from the likelihood ratios of the equations."""
    ratio, both = ratios(frame)[0], outlines(frame)[0]
    given = frame.scene.existence, frame.detection, ratio
    got = plain(joint.associate_frame)(*given, frame.pair, both, NEW)
    return got, textbook.associate(*given, frame.pairs, both, NEW)


def test_association_probabilities_are_those_of_belief_propagation_on_all_hypotheses(frame: Frame) -> None:
    if frame.m == 0:
        return
    got, wanted = associated(frame)
    # The kernel ends when messages change by less than 1e-5, which may be 1 % of a small one
    np.testing.assert_allclose(got.beta, wanted.beta, atol=2e-3)
    np.testing.assert_allclose(got.joint, wanted.joint, atol=2e-3)
    np.testing.assert_allclose(got.ratio, wanted.ratio, rtol=1e-2)


def test_a_pair_without_loops_is_associated_by_bayes_rule() -> None:
    # One box, two people: it is of no one, of either, or of both; sums over existence and detection
    r, d, ratio, both = np.array([0.7, 0.9]), np.array([0.8, 0.6]), np.array([[3.0], [0.0]]), np.array([[0.0]])
    got = plain(joint.associate_frame)(r, d, ratio, np.array([[0, 1]]), both, 0.25)
    evidence = 1.0 - r[0] * d[0] + r[0] * d[0] * 3.0 / 1.25
    assert got.beta[0, 0] * r[0] * got.ratio[0] / (1.0 - r[0] + r[0] * got.ratio[0]) == pytest.approx(
        r[0] * d[0] * 3.0 / 1.25 / evidence
    )
    assert got.ratio[0] == pytest.approx(1.0 - d[0] + d[0] * 3.0 / 1.25)
    assert got.ratio[1] == pytest.approx(1.0 - d[1])


def test_hypotheses_are_assigned_to_people_and_boxes(frame: Frame) -> None:
    if frame.m == 0:
        return
    found, _ = associated(frame)
    N, r = len(frame.seen), frame.scene.existence
    share, both, free, owner = (
        np.ones((N, frame.m)),
        np.ones((N, frame.m)),
        np.ones(frame.m),
        np.zeros(frame.m, dtype=int),
    )
    plain(joint.marginal_probabilities)(r, found, frame.pair, share, both, free, owner)
    posterior = (r * found.ratio / (1.0 - r + r * found.ratio))[:, None]
    wanted = np.zeros((N, frame.m))
    for k, pair in enumerate(frame.pairs):
        for side, i in enumerate(pair):
            wanted[i] += found.joint[k, side]
    np.testing.assert_array_equal(share, found.beta)
    np.testing.assert_allclose(both, wanted, atol=1e-15)
    left = 1.0 - (posterior * share).sum(axis=0) - 0.5 * (posterior * wanted).sum(axis=0)
    np.testing.assert_allclose(free, np.maximum(left, 0.0), atol=1e-12)
    largest = (posterior * share).max(axis=0)
    np.testing.assert_array_equal(owner, np.where(largest > 0.0, (posterior * share).argmax(axis=0), -1))
    best = plain(joint.map_hypothesis)(found.beta, frame.pair, found.joint)
    for i in range(N):
        every = [(found.beta[i, j], j, -1) for j in range(frame.m)]
        every += [(found.joint[k, s, j], j, k) for k, p in enumerate(frame.pairs) for s in range(2) if p[s] == i
                  for j in range(frame.m)]  # fmt: skip
        assert best.probability[i] == max(every)[0]
        if best.probability[i] > 1e-9:
            assert (best.probability[i], best.box[i], best.pair[i]) == max(every)
            assert best.pair[i] < 0 or frame.pairs[best.pair[i]][best.side[i]] == i


def test_the_site_of_boxes_has_the_moments_of_the_mixture_over_all_hypotheses(frame: Frame) -> None:
    p, rng = frame.predicted, np.random.default_rng(0)
    pair, members = np.array([[0, 1], [1, 2]]), [(0, 1), (1, 2)]
    for i, seen in enumerate(frame.seen[:3]):
        if seen is None:
            continue
        n = 3
        z = seen.box + rng.normal(0.0, 9.0, (n, 4))
        use, whole, outlier = rng.random((n, 4)) < 0.8, rng.uniform(size=n), rng.integers(4, size=n)
        own = rng.uniform(0.2, 1.0, (2, 4))
        chances = rng.dirichlet(np.ones(1 + 3 * n) * 0.7)
        beta, both = chances[:n], np.zeros((2, 2, n))
        hypotheses = [h for j in range(n) if beta[j] > textbook.LEAST
                      for h in textbook.alone(use[j], whole[j], outlier[j], beta[j], z[j])]  # fmt: skip
        for k in range(2):
            both[k] = chances[n * (1 + k) : n * (2 + k)]
            for s, j in product(range(2), range(n)):
                if members[k][s] == i and both[k, s, j] > textbook.LEAST:
                    mine = own[k] if s == 0 else 1.0 - own[k]
                    hypotheses.append(textbook.of_two(use[j], mine, both[k, s, j], z[j]))
        J, h = np.empty((6, 6)), np.empty(6)
        boxes = PackedDetections(
            np.zeros(1, dtype=np.int64), np.zeros(1), np.array([0, n]), z, use, np.zeros(n), np.full((0, 3), np.nan)
        )
        plain(joint.expectation_propagation_site)(p, i, boxes, 0, n, whole, outlier, beta, pair, both, own, J, h)
        m, P = textbook.mixture(p.mean[i], p.covariance[i], seen, hypotheses)
        wanted_J, wanted_h = textbook.quotient(m, P, p.mean[i], p.covariance[i])
        size = np.sqrt(np.outer(np.diag(p.covariance[i]), np.diag(p.covariance[i])))
        np.testing.assert_allclose(J * size, wanted_J * size, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(h * np.sqrt(np.diag(size)), wanted_h * np.sqrt(np.diag(size)), rtol=1e-5, atol=1e-4)
        assert np.linalg.eigvalsh(J * size)[0] > -1e-8


def test_information_that_a_mixture_takes_away_is_none() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6))
    P = root @ root.T
    values, axes = np.array([2.0, 1.0, 0.5, 0.0, -0.3, -0.7]), np.linalg.qr(rng.normal(size=(6, 6)))[0]
    back = np.linalg.inv(np.linalg.cholesky(P)).T @ axes
    J = (back * values) @ back.T
    plain(joint.without_negative)(J, P, np.linalg.inv(P))
    np.testing.assert_allclose(J, (back * np.maximum(values, 0.0)) @ back.T, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(("existence", "frames"), [([0.9, 0.4], 1), ([0.99] * 6, 1), ([0.99] * 6, 3)])
def test_a_frame_without_boxes_is_a_miss_of_all_or_blind(existence: list[float], frames: int) -> None:
    r, detection = np.array(existence), np.linspace(0.3, 0.98, len(existence))
    got = plain(joint.missed_detection_ratio)(r, detection, frames)
    blind = np.log(0.01) / (max(float(r @ detection), 1.0) * frames)
    np.testing.assert_allclose(got, np.maximum(np.log(1.0 - detection), blind))
    assert np.isclose(got, blind).any() == (len(existence) > 2)


@pytest.mark.parametrize("seed", range(5))
def test_the_update_is_expectation_propagation_by_its_equations(seed: int) -> None:
    s = random_scene(seed)
    agree(s)


def test_frames_without_any_boxes_are_blind_together() -> None:
    s = random_scene(0)
    none = s.boxes._replace(first=np.zeros(4, dtype=np.int64), box=np.zeros((0, 4)), clutter=np.zeros(0),
                            usable=np.zeros((0, 4), dtype=np.bool_))  # fmt: skip
    agree(s._replace(boxes=none, features=np.zeros((len(s.mean), 0)), existence=np.full(len(s.mean), 0.97)))


def agree(s: Scene) -> None:
    """All that the update gives is that of the equations."""
    hidden = np.random.default_rng(len(s.mean)).choice([0.0, 0.0, 0.1, 0.9], (len(s.mean), len(s.cameras)))
    got = joint.update_targets(
        s.mean, s.covariance, s.existence, s.views, s.boxes, s.rates, s.features, NEW, GATE, hidden
    )
    wanted = textbook.update(s.mean, s.covariance, s.existence, s.cameras, s.detectors, s.frames(), NEW, GATE, hidden)
    for name, value in wanted.items():
        if name not in ("information", "vector"):
            # Messages of slow loops stop 1e-5 short of each other, some 1e-3 of a probability from the limit
            np.testing.assert_allclose(getattr(got, name), value, rtol=2e-3, atol=5e-4, err_msg=name)
    # The sum of the sites leads from the prediction to the posterior
    for i in range(len(s.mean)):
        before = np.linalg.inv(s.covariance[i])
        after = np.linalg.inv(before + got.information[i])
        np.testing.assert_allclose(after, got.covariance[i], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(after @ (before @ s.mean[i] + got.vector[i]), got.mean[i], rtol=1e-6, atol=1e-8)
