"""Errors of tracks on five-frame scenes worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evaluate_scenes import both, scene, seconds, tracks, truth

from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.tables import Tracks

T5 = [0.0, 1.0, 2.0, 3.0, 4.0]


def test_five_frames_by_hand() -> None:
    true = truth(T5, [[0, 0], [1, 0], [2, 0], [3, 0], [4, 0]])
    found = tracks(T5, [[3, 4], [1, 0], [3, -1], [1, 0], [4, 3]], var=4.0)
    m = evaluate(found, true, None, scene()).metrics
    # errors (3,4) (0,0) (1,-1) (-2,0) (0,3): lengths 5 0 sqrt2 2 3
    assert m["rmse_m"] == pytest.approx(math.sqrt((25 + 0 + 2 + 4 + 9) / 5))
    assert m["rmse_x_m"] == pytest.approx(math.sqrt((9 + 0 + 1 + 4 + 0) / 5))
    assert m["rmse_y_m"] == pytest.approx(math.sqrt((16 + 0 + 1 + 0 + 9) / 5))
    assert m["error_mean_m"] == pytest.approx((5 + 0 + math.sqrt(2) + 2 + 3) / 5)
    assert m["error_median_m"] == 2.0
    assert m["error_max_m"] == 5.0
    assert m["error_p95_m"] == pytest.approx(3 + 0.8 * 2)  # rank 0.95 * 4 = 3.8 between 3 and 5
    assert m["bias_x_m"] == pytest.approx((3 + 0 + 1 - 2 + 0) / 5)
    assert m["bias_y_m"] == pytest.approx((4 + 0 - 1 + 0 + 3) / 5)
    assert m["nees_mean"] == pytest.approx((25 + 0 + 2 + 4 + 9) / 4 / 5)
    assert m["nees_share_95"] == 4 / 5  # only 25/4 = 6.25 is above 5.991
    assert m["estimates"] == 5
    assert m["time_coverage"] == 1.0
    assert m["rmse_target_0_m"] == m["rmse_m"]


def test_errors_table_keeps_estimate_truth_and_difference() -> None:
    errors = evaluate(tracks([0.5], [[2.0, 1.0]]), truth([0, 1], [[0, 0], [1, 2]]), None, scene()).errors
    assert errors.t_ns.tolist() == seconds([0.5]).tolist()
    row = [float(getattr(errors, c)[0]) for c in ("x", "y", "truth_x", "truth_y", "error_x", "error_y", "error")]
    assert row == [2.0, 1.0, 0.5, 1.0, 1.5, 0.0, 1.5]


def test_unit_of_the_scene_ends_the_names() -> None:
    m = evaluate(tracks(T5, [1, 1]), truth(T5, [0, 0]), None, scene(unit="unit")).metrics
    assert m["rmse_unit"] == pytest.approx(math.sqrt(2))
    assert "rmse_m" not in m


def test_time_limits_of_the_truth() -> None:
    true = truth([0.0, 1.0, 2.5, 3.0], [[0, 0], [1, 0], [2.5, 0], [3, 0]])
    # before the truth; in a gap of 1 s (the limit); in a gap of 1.5 s; on its edges; after the truth
    t = [-0.1, 0.5, 1.0, 1.7, 2.5, 3.0, 3.1]
    result = evaluate(tracks(t, np.column_stack([t, np.zeros(7)])), true, None, scene())
    assert result.errors.t_ns.tolist() == seconds([0.5, 1.0, 2.5, 3.0]).tolist()
    np.testing.assert_allclose(result.errors.error, 0.0, atol=1e-9)
    assert result.metrics["estimates"] == 4
    assert result.metrics["estimates_without_truth"] == 3
    wider = evaluate(tracks(t, [0, 0]), true, None, scene(), EvaluateConfig(max_gap_s=1.5)).metrics
    assert wider["estimates_without_truth"] == 2


@pytest.mark.parametrize(("step_s", "bridged"), [(0.01, 0.2), (0.1, 0.2), (0.5, 0.75), (0.66, 0.99), (2.0, 1.0)])
def test_a_gap_of_the_truth_is_bridged_up_to_one_and_a_half_usual_steps(step_s: float, bridged: float) -> None:
    """At least 0.2 s, at most 1 s."""
    for gap, good in ((bridged, True), (bridged + 0.001, False)):
        before = step_s * np.arange(9)
        times = np.concatenate([before, before[-1] + gap + before])
        found = tracks([before[-1] + 0.5 * gap, times[-1]], [0, 0])
        m = evaluate(found, truth(times.tolist(), [0, 0]), None, scene()).metrics
        assert m["estimates_without_truth"] == (0 if good else 1)
        assert m["estimates_interpolated_truth"] == (1 if good else 0)


def test_estimates_at_the_times_of_the_truth_need_no_interpolation() -> None:
    assert evaluate(tracks(T5, [0, 0]), truth(T5, [0, 0]), None, scene()).metrics["estimates_interpolated_truth"] == 0


def test_a_line_says_that_most_estimates_are_in_gaps_of_the_truth() -> None:
    """The truth holds still from 4 s to 20 s, and no one has written that down."""
    sampled = truth([*T5, 20.0, 21.0], [0, 0])
    found = tracks([3.0, 4.0, 6.0, 7.0, 8.0, 30.0], [0, 0])
    result = evaluate(found, sampled, None, scene())
    assert [note.split(" that")[0] for note in result.notes] == [
        "warning: 3 of 5 estimates fall into gaps of the truth"
    ]
    assert "wider than 1 s" in result.notes[0]
    assert not evaluate(found.take(found.t_ns < seconds([8.0])[0]), sampled, None, scene()).notes
    assert not evaluate(found, sampled, None, scene(), EvaluateConfig(max_gap_s=16.0)).notes


def test_truth_that_covers_no_estimate_is_an_error() -> None:
    with pytest.raises(InputError, match=r"covers the time of no estimate.*max-gap"):
        evaluate(tracks([100, 101], [0, 0]), truth(T5, [0, 0]), None, scene())


def test_tracks_that_have_the_numbers_of_others_are_called_so() -> None:
    """Each track is there while the other one's target is."""
    early, late = T5, [t + 10.0 for t in T5]
    true = both(truth(early, [0, 0], 0), truth(late, [10, 10], 1))
    found = both(tracks(early, [0, 0], 1), tracks(late, [10, 10], 0))
    with pytest.raises(InputError, match=r"no track overlaps in time .*match optimal"):
        evaluate(found, true, None, scene())
    assert evaluate(found, true, None, scene(), EvaluateConfig(match="optimal")).metrics["rmse_m"] == 0.0


def test_unequal_lengths_add_up_as_sums() -> None:
    true = both(truth(T5, [0, 0], 0), truth(T5, [10, 10], 1))
    found = both(tracks(T5, [1, 0], 0), tracks([2.0], [10, 14], 1))
    m = evaluate(found, true, None, scene()).metrics
    assert m["rmse_target_0_m"] == 1.0
    assert m["rmse_target_1_m"] == 4.0
    assert m["rmse_m"] == pytest.approx(math.sqrt((5 * 1 + 16) / 6))
    assert m["estimates_target_1"] == 1
    assert m["time_coverage"] == (5 + 1) / 10


def test_identities_that_agree_are_matched_and_the_rest_counted() -> None:
    true = both(truth(T5, [0, 0], 0), truth(T5, [5, 5], 1), truth(T5, [9, 9], 7, "occluder"))
    found = both(tracks(T5, [0, 0], 0), tracks(T5[:3], [5, 5], 7), tracks(T5[:2], [5, 5], 9))
    m = evaluate(found, true, None, scene()).metrics
    assert m["rmse_m"] == 0.0
    assert (m["tracks"], m["tracks_unmatched"]) == (3, 2)  # 7 is an occluder, 9 is unknown
    assert (m["targets"], m["targets_unmatched"]) == (2, 1)
    assert m["estimates_unmatched"] == 3 + 2
    assert m["time_coverage"] == 5 / 10


def test_no_identity_agrees() -> None:
    with pytest.raises(InputError, match=r"no target_id of a track \(4\).*truth \(0\).*match optimal"):
        evaluate(tracks(T5, [0, 0], 4), truth(T5, [0, 0]), None, scene())


def test_optimal_match_swaps_exchanged_names() -> None:
    true = both(truth(T5, [0, 0], 0), truth(T5, [10, 0], 1), truth(T5, [0, 10], 2))
    found = both(tracks(T5, [9, 0], 0), tracks(T5, [1, 0], 1), tracks(T5[1:], [0, 11], 12))
    config = EvaluateConfig(match="optimal")
    result = evaluate(found, true, None, scene(), config)
    assert result.metrics["rmse_m"] == 1.0
    assert sorted(set(result.errors.target_id.tolist())) == [0, 1, 2]
    swapped = evaluate(found, true, None, scene()).metrics
    assert swapped["rmse_m"] == 9.0


def test_no_target_in_the_truth() -> None:
    with pytest.raises(InputError, match="no rows of role target"):
        evaluate(tracks(T5, [0, 0]), truth(T5, [0, 0], 0, "occluder"), None, scene())


def test_empty_tracks_give_no_number_but_no_error() -> None:
    m = evaluate(Tracks.empty(), truth(T5, [0, 0]), None, scene()).metrics
    assert math.isnan(m["rmse_m"])
    assert m["time_coverage"] == 0.0
    assert m["estimates"] == 0


def test_transient_is_left_out_after_each_first_estimate() -> None:
    true = both(truth(range(10), [0, 0], 0), truth(range(10), [5, 5], 1))
    found = both(
        tracks(range(6), [[9, 0], [9, 0], [1, 0], [1, 0], [1, 0], [1, 0]], 0),
        tracks([4, 5, 6], [[5, 25], [5, 25], [5, 8]], 1),
    )
    m = evaluate(found, true, None, scene(), EvaluateConfig(settling_s=2.0)).metrics
    assert m["settled_rmse_m"] == pytest.approx(math.sqrt((4 * 1 + 9) / 5))
    assert m["settled_estimates"] == 5
    assert m["rmse_m"] == pytest.approx(math.sqrt((2 * 81 + 4 * 1 + 2 * 400 + 9) / 9))


def test_from_a_time_on() -> None:
    config = EvaluateConfig(from_ns=int(seconds([2.0])[0]))
    m = evaluate(tracks(T5, [[9, 0], [9, 0], [1, 0], [1, 0], [1, 0]]), truth(T5, [0, 0]), None, scene(), config)
    assert m.metrics["settled_rmse_m"] == 1.0
    assert m.metrics["settled_estimates"] == 3


def test_nothing_is_settled_without_being_asked_for() -> None:
    m = evaluate(tracks(T5, [0, 0]), truth(T5, [0, 0]), None, scene()).metrics
    assert not [name for name in m if name.startswith("settled")]


def test_singular_covariances_are_counted_not_averaged() -> None:
    found = both(tracks([0.0, 1.0], [1, 0], var=0.0), tracks([2.0, 3.0], [1, 1], var=1.0))
    m = evaluate(found, truth(T5, [0, 0]), None, scene()).metrics
    assert m["nees_singular"] == 2
    assert m["nees_mean"] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"max_gap_s": -1.0}, "max_gap_s"),
        ({"max_gap_s": math.nan}, "max_gap_s"),
        ({"match": "nearest"}, "match"),
        ({"motion": "ca"}, "motion"),
        ({"gate_sigma": 0.0}, "gate_sigma"),
        ({"gate_px": -3.0}, "gate_px"),
        ({"prior_covariance": (1.0, 2.0, 1.0)}, "prior_covariance"),
        ({"triangulation_min_sensors": 1}, "triangulation_min_sensors"),
        ({"iou_threshold": 1.5}, "iou_threshold"),
        ({"triangulation_loss": "l1"}, "triangulation_loss"),
    ],
)
def test_options_out_of_range(options: dict, name: str) -> None:
    with pytest.raises(InputError, match=f"evaluate: {name} is"):
        EvaluateConfig(**options)
