"""Figures for many targets on scenes that are worked by hand, and at the edges."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from occlog.core.metrics.mot.clear_mot import CHALLENGE, CLASSIC, ClearRule, clear_mot, match
from occlog.core.metrics.mot.failure_rates import NO_TARGET, failures
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_boxes, of_points, reaches
from occlog.core.metrics.mot.gospa import gospa
from occlog.core.metrics.mot.hota import hota, identity


def rows(*values: tuple[float, ...]) -> Objects:
    """Objects from rows frame, label, place."""
    table = np.array(values, dtype=np.float64)
    return Objects(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:])


def nothing(width: int = 2) -> Objects:
    return Objects(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, width)))


def compared(frames: MatchedFrames) -> np.ndarray:
    """(2, T) distance and similarity of the one pair of each frame."""
    return np.array([[part.item() for part in frames.compare(t)] for t in frames.meeting()]).T


def line(label: int, frames: range, y: float = 0.0) -> list[tuple[float, ...]]:
    return [(frame, label, 0.0, y) for frame in frames]


def test_boxes_that_overlap_by_a_third_and_by_a_half() -> None:
    truth = rows((1, 1, 0, 0, 10, 10), (2, 1, 0, 0, 10, 10), (3, 1, 0, 0, 10, 10))
    tracks = rows((1, 7, 5, 0, 10, 10), (2, 7, 0, 0, 10, 5), (3, 7, 20, 0, 10, 10))
    frames = of_boxes(truth, tracks)
    np.testing.assert_allclose(compared(frames), [[2 / 3, 0.5, 1.0], [1 / 3, 0.5, 0.0]])
    got = clear_mot(frames)
    assert (got.tp, got.fp, got.fn) == (1, 2, 2)  # an overlap of exactly one half counts
    assert got.mota == pytest.approx(1 - 4 / 3)
    assert clear_mot(frames, ClearRule(threshold=1 / 3)).tp == 2


def test_equal_boxes_are_no_distance_apart_whatever_their_corners_round_to() -> None:
    position = np.random.default_rng(1).uniform(0.1, 300.0, (500, 4))
    boxes = Objects(np.arange(500), np.ones(500, dtype=np.int64), position)
    got = gospa(of_boxes(boxes, boxes), cutoff=0.5, p=1.5)
    assert (got.localisation >= 0).all()
    np.testing.assert_allclose(got.gospa, 0.0, atol=1e-8)


def test_similarity_of_points_is_one_half_at_the_limit_and_zero_at_twice_the_limit() -> None:
    truth = rows(*[(frame, 1, 0, 0) for frame in range(5)])
    tracks = rows((0, 1, 0, 0), (1, 1, 0.35, 0), (2, 1, 0, 0.7), (3, 1, 1.4, 0), (4, 1, 9, 0))
    frames = of_points(truth, tracks, 0.7)
    np.testing.assert_allclose(compared(frames)[1], [1.0, 0.75, 0.5, 0.0, 0.0], atol=1e-15)
    got = clear_mot(frames)
    assert got.tp == 3  # a distance of exactly the limit counts
    assert got.motp == pytest.approx((0 + 0.35 + 0.7) / 3)
    assert got.motp_similarity == pytest.approx(0.75)


def test_tracks_that_change_hands_once() -> None:
    """Two targets for ten frames; the tracks swap after six."""
    truth = rows(*line(1, range(10)), *line(2, range(10), 5.0))
    tracks = rows(*line(7, range(6)), *line(7, range(6, 10), 5.0), *line(8, range(6), 5.0), *line(8, range(6, 10)))
    frames = of_points(truth, tracks, 1.0)
    for rule in (CLASSIC, CHALLENGE):
        got = clear_mot(frames, rule)
        assert (got.tp, got.fp, got.fn, got.switches, got.fragmentations) == (20, 0, 0, 2, 0)
        assert got.mota == pytest.approx(0.9)
    who = identity(frames)
    assert (who.idtp, who.idfp, who.idfn) == (12, 8, 8)
    assert who.idf1 == who.idp == who.idr == pytest.approx(0.6)
    assert who.track.tolist() == [0, 1]
    # A pair of 6 frames of 10 and 10 has 6 / 14, one of 4 has 4 / 16.
    means = hota(frames).means()
    assert means["det_a"] == means["loc_a"] == 1.0
    assert means["ass_a"] == pytest.approx(0.6 * 6 / 14 + 0.4 * 4 / 16)
    assert means["hota"] == pytest.approx(math.sqrt(0.6 * 6 / 14 + 0.4 * 4 / 16))
    made = match(frames)
    assert frames.frame[made.frame[made.switch]].tolist() == [6, 6]


def test_a_gap_fragments_a_track_and_a_target_that_is_away_is_not_fragmented() -> None:
    truth = rows(*line(1, range(9)), *line(2, range(3), 5.0), *line(2, range(6, 9), 5.0))
    tracks = rows(*line(7, range(3)), *line(7, range(5, 9)), *line(8, range(9), 5.0))
    got = clear_mot(of_points(truth, tracks, 1.0))
    assert (got.fragmentations, got.switches, got.fn, got.fp) == (1, 0, 2, 3)
    assert got.tracked.tolist() == [7 / 9, 1.0]
    assert (got.mostly_tracked, got.partly_tracked, got.mostly_lost) == (1, 1, 0)


def test_four_frames_of_five_are_mostly_tracked_and_one_of_five_is_not_mostly_lost() -> None:
    truth = rows(*line(1, range(5)), *line(2, range(5), 5.0), *line(3, range(6), 9.0))
    tracks = rows(*line(1, range(4)), *line(2, range(1), 5.0), *line(3, range(1), 9.0))
    got = clear_mot(of_points(truth, tracks, 1.0))
    assert (got.mostly_tracked, got.partly_tracked, got.mostly_lost) == (1, 1, 1)


def test_how_long_a_pair_is_remembered_decides_who_keeps_the_track() -> None:
    """Track 7 is lost for a frame and comes back next to track 8, which then is nearer."""
    truth = rows(*line(1, range(4)))
    tracks = rows((0, 7, 0, 0), (1, 7, 0, 0), (3, 7, 0, 0.6), (3, 8, 0, 0.1))
    frames = of_points(truth, tracks, 1.0)
    assert clear_mot(frames, CLASSIC).switches == 0
    assert clear_mot(frames, CHALLENGE).switches == 1
    assert clear_mot(frames, ClearRule(memory=2)).switches == 0


def test_most_pairs_or_most_similarity() -> None:
    """Three pairs of similarity 0.55, or two of similarity 1 with one target and one track left over."""
    truth = rows((0, 1, 0, 0), (0, 2, 0, 0.9), (0, 3, 0, 1.8))
    tracks = rows((0, 1, 0, 0.9), (0, 2, 0, 1.8), (0, 3, 0, 2.7))
    frames = of_points(truth, tracks, 1.0)
    most, similar = clear_mot(frames, ClearRule(most=True)), clear_mot(frames, ClearRule(most=False))
    assert (most.tp, similar.tp) == (3, 2)
    assert most.motp_similarity == pytest.approx(0.55)
    assert similar.motp_similarity == pytest.approx(1.0)


def test_gospa_of_one_pair_one_missed_and_one_false() -> None:
    truth = rows((0, 1, 0, 0), (0, 2, 10, 0), (1, 1, 0, 0))
    tracks = rows((0, 5, 3, 4), (0, 6, 50, 0), (0, 7, 60, 0), (2, 5, 0, 0))
    got = gospa(of_points(truth, tracks, 1.0), cutoff=8.0)
    assert got.frame.tolist() == [0, 1, 2]
    assert got.localisation.tolist() == [25.0, 0.0, 0.0]
    assert (got.n_missed.tolist(), got.n_false.tolist()) == ([1, 1, 0], [2, 0, 1])
    np.testing.assert_allclose(got.gospa**2, [25 + 3 * 32, 32, 32])
    means = got.means()
    assert means["missed"] == pytest.approx(64 / 3)
    assert means["power_mean"] == pytest.approx(math.sqrt((25 + 5 * 32) / 3))
    assert got.means(frames=6)["false"] == pytest.approx(96 / 6)


def test_failures_by_the_stated_rule() -> None:
    """Own target first, else the nearest; several on one; extra trackers; hidden targets count."""
    truth = rows((0, 1, 0, 0), (0, 2, 5, 0), (0, 3, 50, 0), (1, 1, 0, 0), (1, 2, 5, 0), (1, 3, 50, 0))
    trackers = rows(
        (0, 1, 3, 0),  # within tau of 1 and of 2, nearer to 2: on its own
        (0, 2, 4, 0),
        (0, 3, 2, 0),  # its own is far: on 1
        (1, 1, 5, 0),  # on 2
        (1, 2, 5, 4),  # at tau exactly: on its own
        (1, 3, np.nan, 0),  # no estimate
    )
    got = failures(truth, trackers, 4.0)
    table = list(zip(got.frame.tolist(), got.target.tolist(), got.other.tolist(), got.causes(), strict=True))
    assert table == [
        (0, 3, NO_TARGET, "its tracker is on target 1"),
        (0, 3, 1, "tracker on target 1"),
        (1, 1, NO_TARGET, "its tracker is on target 2"),
        (1, 1, 2, "tracker on target 2"),
        (1, 3, NO_TARGET, "no tracker"),
    ]
    assert (got.total, got.fr_p, got.fr_l) == (6, 3 / 6, 2 / 6)


def test_trackers_may_have_other_numbers_than_their_targets() -> None:
    """Two trackers of target 1, one of target 2 that strays, and one without a target that is on 2."""
    truth = rows((0, 1, 0, 0), (0, 2, 5, 0))
    trackers = rows((0, 7, 0.5, 0), (0, 8, 5, 0), (0, 9, 2.5, 0), (0, 10, 5, 0))
    got = failures(truth, trackers, 1.0, np.array([1, 1, 2, NO_TARGET]))
    assert (got.target.tolist(), got.other.tolist()) == ([NO_TARGET, 1], [2, 2])
    assert got.causes() == ["tracker on target 2"] * 2
    assert (got.fr_p, got.fr_l) == (0.0, 1.0)
    got = failures(truth, Objects(*(column[[0, 2]] for column in trackers[:3])), 1.0, np.array([1, 2]))
    assert (got.target.tolist(), got.causes("m"), got.fr_p, got.fr_l) == ([2], ["its tracker is 2.5 m away"], 0.5, 0.0)
    with pytest.raises(ValueError, match="label 7 comes twice"):
        failures(truth, trackers._replace(label=np.array([7, 7, 9, 10])), 1.0, np.array([1, 1, 2, NO_TARGET]))


def test_failures_tell_views_apart_and_take_a_tau_for_each_target() -> None:
    truth = rows((0, 1, 0, 0), (0, 1, 0, 0))._replace(view=np.array([4, 9]))
    trackers = rows((0, 1, 2, 0), (0, 1, 2, 0))._replace(view=np.array([9, 4]))
    got = failures(truth, trackers, np.array([3.0, 1.0]))
    assert (got.view.tolist(), got.target.tolist(), got.fr_p, got.fr_l) == ([9], [1], 0.5, 0.0)


def test_one_side_or_both_are_empty() -> None:
    some = rows(*line(1, range(4)))
    lost, false, none = (of_points(*s, 1.0) for s in ((some, nothing()), (nothing(), some), (nothing(), nothing())))
    assert clear_mot(lost)[:8] == (4, 0, 0, 0, 4, 0, 0, 0.0)
    assert clear_mot(lost).mostly_lost == 1
    assert clear_mot(false)[:7] == (0, 4, 0, 4, 0, 0, 0)
    assert math.isnan(clear_mot(false).mota)
    assert math.isnan(clear_mot(lost).precision)
    assert clear_mot(none)[:7] == (0,) * 7
    assert identity(lost)[:3] == (0, 0, 4)
    assert identity(false)[:3] == (0, 4, 0)
    assert math.isnan(identity(none).idf1)
    for frames in (lost, false, none):
        means = hota(frames).means()
        assert (means["hota"], means["det_a"], means["ass_a"], means["loc_a"]) == (0.0, 0.0, 0.0, 1.0)
    assert gospa(lost, 2.0).means()["missed"] == 2.0
    assert gospa(false, 2.0).means()["false"] == 2.0
    assert gospa(none, 2.0).means()["gospa"] == 0.0
    assert (failures(some, nothing(), 1.0).fr_p, failures(some, nothing(), 1.0).fr_l) == (1.0, 0.0)
    assert math.isnan(failures(nothing(), some, 1.0).fr_p)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: of_points(rows((0, 1, 0, 0), (0, 1, 1, 1)), nothing(), 1.0), "label 1 comes twice in frame 0"),
        (lambda: of_points(rows((0, 1, np.nan, 0)), nothing(), 1.0), "finite"),
        (lambda: of_points(nothing(), nothing(), 0.0), "limit"),
        (lambda: of_points(rows((0, 1, 0, 0, 0)), rows((0, 1, 0, 0)), 1.0), "equally many columns"),
        (lambda: of_points(rows((0, 1, 0))._replace(view=np.zeros(1)), rows((0, 1, 0)), 1.0), "views"),
        (lambda: of_boxes(rows((0, 1, 0, 0, 0, 5)), nothing(4)), "sizes above 0"),
        (lambda: of_boxes(rows((0, 1, 0, 0)), nothing(4)), "left, top, width, height"),
        (lambda: gospa(of_points(nothing(), nothing(), 1.0), 1.0, 0.5), "p 0.5"),
        (lambda: gospa(of_points(nothing(), nothing(), 1.0), -1.0), "cutoff -1"),
        (lambda: failures(nothing(), nothing(), -1.0), "tau"),
    ],
)
def test_what_cannot_be_is_refused(call: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()  # type: ignore[operator]


def test_the_order_of_rows_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    n, k = 40, 5
    frame, label = np.repeat(np.arange(n), k), np.tile(np.arange(k), n)
    position = rng.uniform(0, 3, (n * k, 2))
    near = position + rng.normal(0, 0.4, position.shape)
    order = rng.permutation(n * k)
    one = of_points(Objects(frame, label, position), Objects(frame, label, near), 1.0)
    other = of_points(
        Objects(frame[order], label[order], position[order]), Objects(frame[order], label[order], near[order]), 1.0
    )
    assert clear_mot(one)[:-1] == clear_mot(other)[:-1]
    assert identity(one)[:-1] == identity(other)[:-1]
    assert hota(one).means() == hota(other).means()
    np.testing.assert_array_equal(order[other.truth_row], one.truth_row)


@pytest.mark.slow
def test_a_thousand_frames_of_twenty_targets_take_less_than_a_second() -> None:
    """Processor time, so that other programs matter little; about 0.3 s on a quiet machine."""
    rng = np.random.default_rng(0)
    n, k = 1000, 20
    frame, label = np.repeat(np.arange(n), k), np.tile(np.arange(k), n)
    position = rng.uniform(0, 20, (1, k, 2)) + np.cumsum(rng.normal(0, 0.3, (n, k, 2)), axis=0)
    truth = Objects(frame, label, position.reshape(-1, 2))
    tracks = truth._replace(position=truth.position + rng.normal(0, 0.3, truth.position.shape))
    took = []
    for _ in range(5):
        start = time.process_time()
        frames = of_points(truth, tracks, 1.0)
        clear_mot(frames), identity(frames), hota(frames), gospa(frames, 1.0), failures(truth, tracks, 1.0)
        took.append(time.process_time() - start)
    assert min(took) < 1.0


def test_the_classic_rule_makes_as_many_pairs_as_can_be() -> None:
    """Track 1 is target 2 and overlaps target 1 by a third, as track 2 does target 2."""
    crowded = of_boxes(
        rows((0, 1, 0, 0, 10, 10), (0, 2, 5, 0, 10, 10)), rows((0, 1, 5, 0, 10, 10), (0, 2, 10, 0, 10, 10))
    )
    assert clear_mot(crowded, CLASSIC._replace(threshold=0.3)).tp == 2
    assert clear_mot(crowded, CHALLENGE._replace(threshold=0.3)).tp == 1


def test_a_similarity_at_the_threshold_counts_and_one_of_rounding_never_does() -> None:
    eps = float(np.finfo(np.float64).eps)
    similarity = np.array([0.5, 0.5 - eps, 0.5 - 3 * eps, 2 * eps, eps, 0.0])
    assert reaches(similarity, 0.5).tolist() == [True, True, False, False, False, False]
    assert reaches(similarity, 0.0).tolist() == [True, True, True, True, False, False]


@pytest.mark.parametrize("away", [0.0, 8.3, 77.7, 1000.3, 500000.1])
def test_points_at_the_limit_meet_wherever_the_origin_is(away: float) -> None:
    apart = [round(0.1 * k, 1) for k in range(1, 8)]
    truth = rows(*((k, 1, round(away + 0.3, 1), 0.0) for k in range(7)))
    tracks = rows(*((k, 1, round(away + 0.3 + d, 1), 0.0) for k, d in enumerate(apart)))
    frames, near = of_points(truth, tracks, 0.5), of_points(rows((0, 1, 0.0, 0.0)), rows((0, 1, 0.5, 0.0)), 0.5)
    assert clear_mot(frames).tp == identity(frames).idtp == 5
    assert failures(truth, tracks, 0.5).fr_p == 2 / 7
    assert hota(frames).tp.tolist() == [sum(d <= round(1 - k / 20, 2) for d in apart) for k in range(1, 20)]
    assert clear_mot(near).tp == 1


def test_hota_counts_a_pair_whose_similarity_is_the_threshold() -> None:
    # At 0.1 of a limit of 1 the similarity is 0.95
    got = hota(of_points(rows((0, 1, 0.0, 0.0)), rows((0, 1, 0.1, 0.0)), 1.0), np.array([0.9, 0.95, 0.96]))
    assert got.tp.tolist() == [1, 1, 0]
    assert got.loc_a[:2].tolist() == pytest.approx([0.95, 0.95])
    assert got.loc_a[2] == 1.0
    assert got.det_re.tolist() == got.det_pr.tolist() == got.ass_re.tolist() == [1.0, 1.0, 0.0]


def test_the_thresholds_of_hota_are_those_of_every_twentieth() -> None:
    assert hota(of_points(nothing(), nothing(), 1.0)).alpha.tolist() == pytest.approx([k / 20 for k in range(1, 20)])


def test_each_target_is_given_the_track_that_meets_it_most_and_none_if_none_does() -> None:
    truth = rows(*line(4, range(5)), *line(5, range(5), 100.0), *line(6, range(2), 200.0))
    tracks = rows(*line(1, range(2)), *[(f, 2, 0.0, 0.0) for f in range(2, 5)], *line(3, range(5), 100.0))
    found = identity(of_points(truth, tracks, 1.0))
    assert found.track.tolist() == [1, 2, -1]
    one = identity(of_points(rows((0, 1, 0.0, 0.0)), rows((0, 9, 0.0, 0.0)), 1.0))
    assert one.track.tolist() == [0]


def test_means_of_gospa_over_a_single_frame_are_its_figures() -> None:
    found = gospa(of_points(rows((0, 1, 0.0, 0.0)), rows((0, 1, 3.0, 4.0)), 1.0), cutoff=10.0)
    means = found.means()
    assert (means["gospa"], means["localisation"], means["power_mean"]) == (5.0, 25.0, 5.0)
    assert (means["missed"], means["false"]) == (0.0, 0.0)
    assert found.means(2)["gospa"] == 2.5


@pytest.mark.parametrize("options", [(0.0, 2.0, 2.0), (math.inf, 2.0, 2.0), (1.0, 0.99, 2.0), (1.0, math.inf, 2.0)])
def test_gospa_refuses_options_at_the_ends_of_their_ranges(options: tuple[float, float, float]) -> None:
    frames = of_points(rows((0, 1, 0.0, 0.0)), rows((0, 1, 0.0, 0.0)), 1.0)
    with pytest.raises(ValueError, match="must be above 0"):
        gospa(frames, *options)
    with pytest.raises(ValueError, match=r"alpha 0 in"):
        gospa(frames, 1.0, 1.0, 0.0)
    assert gospa(frames, 1.0, 1.0, 2.0).gospa.tolist() == [0.0]


def test_a_box_needs_a_width_and_a_height() -> None:
    for bad in ((0, 1, 0, 0, 5, 0), (0, 1, 0, 0, 0, 5)):
        with pytest.raises(ValueError, match="sizes above 0"):
            of_boxes(rows(bad), rows((0, 1, 0, 0, 5, 5)))
