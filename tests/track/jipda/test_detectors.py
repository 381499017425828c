"""What is learned of detectors: from points at people who are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.detector_model import (
    HIDDEN_S,
    MAX_PERSISTENT_CLUTTER,
    Clutter,
    DetectorStatistics,
    blind_frames,
    clutter_rate,
    detector_model,
    hiding_rate,
    manoeuvre_rate,
    no_clutter,
    persistent_clutter_density,
    persistent_clutter_probability,
    posture_change_rate,
    predict_hidden,
    prior_edge_errors,
    prior_statistics,
    target_death_rate,
    update_hidden,
    update_statistics,
)
from occlog.track.methods.jipda.kernels.detections import DetectorModel, PackedDetections
from occlog.track.methods.jipda.kernels.joint_association import BLIND_FRAME_PROBABILITY, JipdaResult
from occlog.track.methods.jipda.target_set import TargetSet, tentative_targets

N = 6


def rates(counts: DetectorStatistics, config: JipdaConfig | None = None) -> DetectorModel:
    config = config or JipdaConfig()
    return detector_model(
        counts, prior_edge_errors(len(counts.detected), 1.0, config), config, np.ones(len(counts.detected))
    )


def people_tracks() -> TargetSet:
    """Six people who surely exist and walk on."""
    return tentative_targets(
        np.zeros((N, 6)), np.tile(np.eye(6), (N, 1, 1)), np.full(N, 0.99), np.full(N, 4.0), 0, 0, cameras=1
    )


def look_at(count: int) -> PackedDetections:
    """One look with so many boxes."""
    return PackedDetections(
        camera=np.zeros(1, dtype=np.int64), delay=np.zeros(1), first=np.array([0, count]), box=np.zeros((count, 4)),
        usable=np.ones((count, 4), dtype=bool), clutter=np.zeros(count),
    )  # fmt: skip


def seen(visible: float, found: int) -> JipdaResult:
    """Everybody visible to a share, the first of them detected."""
    zero = np.zeros((N, 6))
    share = np.eye(N)[:, :found]
    return JipdaResult(
        mean=zero, covariance=np.zeros((N, 6, 6)), information=np.zeros((N, 6, 6)), vector=zero,
        existence=np.full(N, 0.99), missed=np.zeros(N), visible=np.full((1, N), visible),
        detection=np.full((1, N), 0.8), beta=share,
        joint=np.zeros_like(share), free=1.0 - share.sum(axis=0), owner=np.arange(found), cuts=np.array([1.0, 1.0]),
        odd=np.zeros(found), wrong=np.array([0.0, found]), merges=np.zeros((1, 2)),
    )  # fmt: skip


def after(observations: int, visible: float, found: int) -> DetectorStatistics:
    counts = prior_statistics(1, JipdaConfig())
    for _ in range(observations):
        now = rates(counts)
        counts = update_statistics(
            counts,
            people_tracks(),
            people_tracks().existence,
            dt=0.5,
            config=JipdaConfig(),
            boxes=look_at(found),
            rates=now,
            result=seen(visible, found),
            interval=np.array([0.5]),
        )
    return counts


def test_at_first_the_settings_hold() -> None:
    config = JipdaConfig(
        detection_probability=0.7,
        clutter_rate=1.5,
        mean_dwell_s=30.0,
        manoeuvre_interval_s=10.0,
        posture_change_interval_s=40.0,
    )
    counts = prior_statistics(2, config)
    np.testing.assert_allclose(rates(counts, config).detection, 0.7)
    np.testing.assert_allclose(clutter_rate(counts), 1.5)
    assert target_death_rate(counts) == pytest.approx(1.0 / 30.0)
    assert manoeuvre_rate(counts) == pytest.approx(0.1)
    assert posture_change_rate(counts) == pytest.approx(0.025)


@pytest.mark.jit
def test_the_rate_of_detection_is_that_of_people_in_plain_view() -> None:
    assert rates(after(200, 1.0, 3)).detection[0] == pytest.approx(0.5, abs=0.02)
    assert rates(after(200, 0.5, 3)).detection[0] == pytest.approx(JipdaConfig().detection_probability)


@pytest.mark.jit
def test_the_curve_rises_and_is_learned_where_people_are_visible_in_part() -> None:
    curve = rates(after(200, 0.4, 1)).curve
    assert (np.diff(curve) >= 0.0).all()
    assert curve[-1] == 1.0
    # One of six is detected, in plain view four of five would be
    assert curve[2] == pytest.approx(1.0 / 6.0 / 0.8, abs=0.03)
    assert (rates(prior_statistics(1, JipdaConfig()), JipdaConfig(use_visibility=False)).curve == 1.0).all()


@pytest.mark.jit
def test_the_rate_of_detection_has_bounds() -> None:
    assert rates(after(400, 1.0, N)).detection[0] == pytest.approx(0.98)


def test_a_look_at_no_one_of_many_is_blind_and_teaches_nothing() -> None:
    first, then = prior_statistics(1, JipdaConfig()), after(10, 1.0, 0)
    np.testing.assert_array_equal(then.detected, first.detected)
    np.testing.assert_array_equal(then.curve, first.curve)


def test_a_look_is_blind_if_that_is_more_probable_than_that_everybody_was_missed() -> None:
    few = int(np.log(BLIND_FRAME_PROBABILITY) / np.log(0.5))
    for people, blind in ((few, False), (few + 1, True)):
        assert blind_frames(look_at(0), np.ones(people), np.full((1, people), 0.5)).tolist() == [blind]
    assert not blind_frames(look_at(1), np.ones(9), np.full((1, 9), 0.5)).any()
    assert not blind_frames(look_at(0), np.ones(9), np.zeros((1, 9))).any()


def test_a_box_of_no_person_is_expected_where_it_was() -> None:
    old = np.array([[100.0, 50.0, 130.0, 120.0]])
    boxes = look_at(2)._replace(box=np.concatenate([old + 1.0, old + 60.0]))
    again, noise, size = np.array([0.5]), rates(prior_statistics(1, JipdaConfig())).noise, np.array([[480.0, 360.0]])
    there, elsewhere = persistent_clutter_density(
        boxes, [Clutter(old, np.array([0.8]), *np.zeros((3, 1)))], again, noise, size
    )
    # Against one box anywhere in the image, of any size
    assert there > 1e3
    assert elsewhere < 1e-3
    half = persistent_clutter_density(boxes, [Clutter(old, np.array([0.4]), *np.zeros((3, 1)))], again, noise, size)
    assert half[0] == pytest.approx(0.5 * there)
    np.testing.assert_array_equal(persistent_clutter_density(boxes, [no_clutter()], again, noise, size), [0.0, 0.0])


def test_boxes_of_no_person_are_never_sure_to_be_there_again() -> None:
    counts = prior_statistics(1, JipdaConfig())
    assert persistent_clutter_probability(counts) == pytest.approx(0.25)
    assert persistent_clutter_probability(replace(counts, again=np.array([[99.0, 100.0]]))) == MAX_PERSISTENT_CLUTTER


@pytest.mark.jit
def test_people_who_never_bend_are_expected_to_bend_more_seldom() -> None:
    seconds = 100 * 0.5 * N
    assert posture_change_rate(after(100, 1.0, 3)) == pytest.approx(
        2.0 / (2.0 * JipdaConfig().posture_change_interval_s + seconds)
    )


def test_the_probability_of_being_hidden_follows_a_two_state_chain_and_bayes_rule() -> None:
    counts = prior_statistics(1, JipdaConfig())
    rate, interval = float(hiding_rate(counts)[0]), np.array([0.3])
    stationary = rate * HIDDEN_S / (1.0 + rate * HIDDEN_S)
    prior = predict_hidden(np.full((N, 1), 0.4), interval, counts)
    expected = stationary + (0.4 - stationary) * np.exp(-0.3 * (rate + 1.0 / HIDDEN_S))
    np.testing.assert_allclose(prior, expected)
    np.testing.assert_array_equal(predict_hidden(prior, np.array([np.inf]), counts), prior)
    # Of those who are shown 0.8 are detected; the first three are
    update = seen(1.0, 3)._replace(detection=np.full((1, N), 0.8 * (1.0 - expected)))
    after = update_hidden(prior, look_at(3), update)
    np.testing.assert_allclose(after[:3], 0.0)
    np.testing.assert_allclose(after[3:], expected / (expected + 0.2 * (1.0 - expected)))
    # A camera outside of whose image they are, and one that is blind, say nothing
    outside = update._replace(detection=np.zeros((1, N)))
    np.testing.assert_array_equal(update_hidden(prior, look_at(3), outside), prior)
    np.testing.assert_array_equal(update_hidden(prior, look_at(0), seen(1.0, 0)), prior)


def test_people_who_are_hidden_do_not_lower_the_rate_of_detection() -> None:
    shown, counts = people_tracks(), prior_statistics(1, JipdaConfig())
    hidden = replace(shown, hidden=np.where(np.arange(N) < 3, 0.0, 1.0)[:, None])
    both = [
        update_statistics(
            counts, people, people.existence, dt=0.5, config=JipdaConfig(), boxes=look_at(3), rates=rates(counts),
            result=seen(1.0, 3), interval=np.array([0.5]),
        )
        for people in (shown, hidden)
    ]  # fmt: skip
    np.testing.assert_allclose(both[0].detected - counts.detected, [[3.0, N]])
    np.testing.assert_allclose(both[1].detected - counts.detected, [[3.0, 3.0]])
    np.testing.assert_allclose(both[1].hidden - counts.hidden, [[(N - 3) * 0.5 / HIDDEN_S, 1.5]])
