"""Detections, misses and false alarms of bearings on five-frame scenes worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evaluate_scenes import array, both, box, camera, directions, pixels, scene, truth

from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.scene import Scene

T5 = [0.0, 1.0, 2.0, 3.0, 4.0]
NAN = math.nan
EAST = camera("east", 0.0, 10.0, 0.0)  # points along +x: true u is -100 (y - 10) / x


def figures(bearings, true, made_scene: Scene, **options) -> dict[str, float]:
    return evaluate(None, true, bearings, made_scene, EvaluateConfig(**options)).metrics


def test_five_frames_by_hand() -> None:
    true = truth(T5, [[10, 10], [10, 12], [10, 12], [10, 5], [10, 25]])  # true u 0 -20 -20 50, then out of view
    m = figures(pixels(EAST, T5, [2, -17, NAN, 30, NAN]), true, scene(EAST))
    assert (m["visible"], m["detected"], m["missed"]) == (4, 2, 2)
    assert (m["false_alarms"], m["correct_rejections"]) == (1, 1)
    assert m["detection_rate"] == 2 / 4
    assert m["false_alarms_per_frame"] == 1 / 5
    assert m["detection_frames"] == m["detection_opportunities"] == 5
    assert m["bearing_rms_px"] == pytest.approx(math.sqrt((2**2 + 3**2) / 2))
    assert m["bearing_bias_px"] == pytest.approx((2 + 3) / 2)
    assert m["bearing_nis"] == pytest.approx((4 + 9) / 2)
    angles = [math.atan(0.02), math.atan(0.20) - math.atan(0.17)]
    assert m["bearing_rms_mrad"] == pytest.approx(1e3 * math.sqrt((angles[0] ** 2 + angles[1] ** 2) / 2))
    assert m["detection_rate_sensor_east"] == m["detection_rate"]


def test_gate_in_pixels_and_in_standard_deviations() -> None:
    true = truth(T5, [10, 10])
    bearings = pixels(EAST, T5, [0, 4, 4.01, -8, -8.01])
    assert figures(bearings, true, scene(EAST))["detected"] == 2
    assert figures(bearings, true, scene(EAST), gate_sigma=5.0)["detected"] == 3
    assert figures(bearings, true, scene(EAST), gate_px=8.0)["detected"] == 4


def test_gate_grows_with_the_calibration_noise_of_eq_2() -> None:
    shaky = camera("east", 0.0, 10.0, 0.0, sigma_yaw=0.02)  # 2 px on the axis: sqrt(1 + 4) in all
    bearings = pixels(shaky, T5, [8.9, 9.0, 0, 0, 0])  # 4 sqrt(5) = 8.944
    assert figures(bearings, truth(T5, [10, 10]), scene(shaky))["detected"] == 4


def test_sensors_add_up_as_counts_not_as_rates() -> None:
    north = camera("north", 10.0, 0.0, 90.0)
    true = truth(T5, [10, 10])
    bearings = both(pixels(EAST, T5, [0, 0, 0, 0, NAN]), pixels(north, T5[:1], [NAN]))
    m = figures(bearings, true, scene(EAST, north))
    assert (m["detection_rate_sensor_east"], m["detection_rate_sensor_north"]) == (4 / 5, 0.0)
    assert m["detection_rate"] == 4 / 6
    assert m["detection_frames"] == 6


def test_static_occluder_hides() -> None:
    made_scene = scene(EAST, occluders=(box("pillar", 4, 9, 6, 11),))
    true = truth(T5, [[10, 10], [10, 10], [3, 10], [10, 15], [10, 10]])
    m = figures(pixels(EAST, T5, [NAN, NAN, NAN, NAN, 1.0]), true, made_scene)
    assert m["visible"] == 2  # in front of the pillar, and next to it
    assert m["correct_rejections"] == 2
    assert m["detected_hidden"] == 1  # a bearing that is right although the target should be hidden
    assert m["false_alarms"] == 0


def test_range_limits_the_view() -> None:
    near = camera("east", 0.0, 10.0, 0.0, range=8.0)
    m = figures(pixels(near, T5, [NAN] * 5), truth(T5, [10, 10]), scene(near))
    assert (m["visible"], m["correct_rejections"]) == (0, 5)
    assert math.isnan(m["detection_rate"])


def test_moving_occluder_hides_only_with_a_diameter_and_from_in_between() -> None:
    true = both(truth(T5, [10, 10]), truth(T5, [[5, 10], [5, 10.4], [5, 10.6], [12, 10], [5, 14]], 1, "occluder"))
    bearings = pixels(EAST, T5, [NAN] * 5)
    assert figures(bearings, true, scene(EAST))["visible"] == 5
    m = figures(bearings, true, scene(EAST), occluder_diameter=1.0)
    assert m["visible"] == 3
    assert m["correct_rejections"] == 2


def test_looks_without_truth_are_in_no_other_count() -> None:
    true = truth([0.0, 1.0, 4.0], [10, 10])
    m = figures(pixels(EAST, T5, [0, 0, 50, 0, 0]), true, scene(EAST))
    assert m["detection_opportunities_without_truth"] == 2  # 2 s and 3 s, in a gap of 3 s
    assert (m["visible"], m["detected"], m["false_alarms"], m["detection_frames"]) == (3, 3, 0, 3)


def test_bearing_reported_of_a_target_behind_the_camera_is_a_false_alarm() -> None:
    west = camera("west", 10.0, 10.0, 180.0)
    m = figures(pixels(west, T5, [0] * 5), truth(T5, [15, 10]), scene(west))
    assert (m["visible"], m["false_alarms"]) == (0, 5)
    assert math.isnan(m["bearing_rms_px"])


def test_candidates_are_paired_one_to_one_and_strays_counted() -> None:
    # Target 0 at u = 0, occluder 5 at u = -50: candidates of people in the scene are no false alarms
    true = both(truth(T5, [10, 10], 0), truth(T5, [10, 15], 5, "occluder"))
    candidates = [[1.0, -49.0], [-50.0], [2.0, 2.5], [30.0], [NAN]]
    parts = [pixels(EAST, [t] * len(u), u, target=-1) for t, u in zip(T5, candidates, strict=True)]
    m = figures(both(*parts), true, scene(EAST))
    assert (m["visible"], m["detected"], m["missed"]) == (5, 2, 3)
    assert m["false_alarms"] == 2  # the second candidate next to the target, and the one at 30
    assert m["detection_frames"] == 5
    assert m["bearing_rms_px"] == pytest.approx(math.sqrt((1 + 4) / 2))


def test_candidates_go_to_visible_objects_before_hidden_ones() -> None:
    # The occluder at u = -2 is behind a pillar; the candidate at -2 is the target's at 0, not the occluder's
    made_scene = scene(EAST, occluders=(box("pillar", 14, 10.15, 16, 11),))
    true = both(truth([0.0], [10, 10]), truth([0.0], [18, 10.36], 5, "occluder"))
    m = figures(pixels(EAST, [0.0], [-2.0], target=-1), true, made_scene)
    assert (m["detected"], m["missed"], m["false_alarms"]) == (1, 0, 0)
    # Without the pillar it is the nearer object's
    m = figures(pixels(EAST, [0.0], [-2.0], target=-1), true, scene(EAST))
    assert (m["detected"], m["missed"], m["false_alarms"]) == (0, 1, 0)
    # A second candidate may still be of the hidden one
    m = figures(pixels(EAST, [0.0, 0.0], [-2.0, -3.0], target=-1), true, made_scene)
    assert (m["detected"], m["false_alarms"]) == (1, 0)


def test_one_candidate_between_two_targets_is_of_one_of_them() -> None:
    true = both(truth([0.0], [10, 10], 0), truth([0.0], [10, 10.3], 1))
    m = figures(pixels(EAST, [0.0], [-1.0], target=-1), true, scene(EAST))
    assert (m["visible"], m["detected"], m["missed"], m["false_alarms"]) == (2, 1, 1, 0)
    assert m["bearing_rms_px"] == pytest.approx(1.0)  # the nearer


def test_labelled_row_takes_precedence_over_candidates_of_its_frame() -> None:
    true = truth([0.0], [10, 10])
    bearings = both(pixels(EAST, [0.0], [NAN], target=0), pixels(EAST, [0.0], [0.5], target=-1))
    m = figures(bearings, true, scene(EAST))
    assert (m["detection_opportunities"], m["detected"], m["missed"], m["false_alarms"]) == (1, 0, 1, 0)


def test_array_directions_wrap_around_and_go_through_walls() -> None:
    made_scene = scene(arrays=(array("ear", 15.0, 10.0),), occluders=(box("wall", 9, 0, 11, 20),))
    true = truth(T5, [[5, 10.001], [5, 9.999], [5, 10.001], [5, 9.999], [5, 10]])
    reported = [-math.pi + 0.01, math.pi - 0.01, math.pi - 0.3, NAN, math.pi]
    m = figures(directions("ear", T5, reported, 0.02), true, made_scene)
    assert (m["visible"], m["detected"], m["false_alarms"], m["missed"]) == (5, 3, 1, 2)
    errors = np.array([0.01 + 1e-4, 0.01 + 1e-4, 0.0])
    assert m["bearing_rms_mrad"] == pytest.approx(1e3 * math.sqrt(np.mean(errors**2)), rel=1e-6)
    assert math.isnan(m["bearing_rms_px"])


def test_camera_looking_along_the_cut_of_the_angles() -> None:
    west = camera("west", 15.0, 10.0, 180.0)
    true = truth(T5, [[5, 10.1], [5, 9.9], [5, 10], [5, 10.1], [5, 9.9]])  # true u +1 -1 0 +1 -1
    m = figures(pixels(west, T5, [-1, 1, 0, 1, -1]), true, scene(west))
    assert m["detected"] == 5
    assert m["bearing_rms_px"] == pytest.approx(math.sqrt((4 + 4) / 5))
    assert m["bearing_rms_mrad"] < 15


def test_unknown_sensor_and_camera_without_pose() -> None:
    bearings = pixels(EAST, T5, [0] * 5)
    with pytest.raises(InputError, match=r"sensor 'east' is not in the scene.*has: north"):
        figures(bearings, truth(T5, [10, 10]), scene(camera("north", 0, 0, 90)))
    with pytest.raises(InputError, match="no pose"):
        figures(bearings, truth(T5, [10, 10]), scene(camera("east", 0, 0, 0, placed=False)))


def test_rows_of_unknown_identities_are_counted_not_used() -> None:
    bearings = both(pixels(EAST, T5, [0] * 5), pixels(EAST, T5, [40] * 5, target=3))
    m = figures(bearings, truth(T5, [10, 10]), scene(EAST))
    assert m["bearings_unmatched"] == 5
    assert (m["detection_opportunities"], m["false_alarms"]) == (5, 0)
