"""Tracks against the meeting points of lines of sight."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evaluate_scenes import array, both, camera, directions, pixels, scene, seconds, tracks

from occlog.core.geometry import triangulate
from occlog.evaluate.bearings.noise import scan_starts
from occlog.evaluate.bearings.residuals import triangulated_points
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.stage import evaluate
from occlog.records.tables import Bearings

T5 = [0.0, 1.0, 2.0, 3.0, 4.0]
NAN = math.nan
EAST, NORTH, WEST = camera("east", 0, 10, 0), camera("north", 10, 0, 90), camera("west", 20, 10, 180)
PLACE = scene(EAST, NORTH, WEST)


def rows_to(x: list[float], y: list[float], t: list[float] = T5) -> Bearings:
    """Bearings of `east` and `north` with lines that meet at (x, y)."""
    u_east = [-100 * (b - 10) / a for a, b in zip(x, y, strict=True)]
    u_north = [100 * (a - 10) / b for a, b in zip(x, y, strict=True)]
    return both(pixels(EAST, t, u_east), pixels(NORTH, t, u_north))


def test_five_scans_by_hand() -> None:
    bearings = rows_to([10, 11, 12, 13, 14], [10] * 5)
    found = tracks(T5, [[10, 10], [11, 10.3], [12, 10], [13.4, 10], [14, 9.5]])
    m = evaluate(found, None, bearings, PLACE, EvaluateConfig(triangulation_tolerance=0.35)).metrics
    # distances 0, 0.3, 0, 0.4, 0.5
    assert m["triangulation_distance_max_m"] == pytest.approx(0.5)
    assert m["triangulation_distance_median_m"] == pytest.approx(0.3)
    assert m["triangulation_distance_p95_m"] == pytest.approx(0.4 + 0.8 * 0.1)
    assert m["triangulation_distance_rms_m"] == pytest.approx(math.sqrt((0.09 + 0.16 + 0.25) / 5))
    assert m["triangulation_share_within"] == 3 / 5
    assert (m["triangulation_scans"], m["triangulation_refused"], m["triangulation_compared"]) == (5, 0, 5)
    assert math.isnan(m["triangulation_residual_rms_mrad"])  # two lines always meet exactly


def test_scans_need_lines_that_cross_and_enough_sensors() -> None:
    # east and west point at each other along y = 10: parallel there; alone at 3 s; three sensors at 4 s
    bearings = both(
        pixels(EAST, [2.0, 3.0, 4.0], [0, 0, 0]), pixels(WEST, [2.0, 4.0], [0, 0]), pixels(NORTH, [4.0], [0])
    )
    m = evaluate(tracks(T5, [10, 10]), None, bearings, PLACE).metrics
    assert (m["triangulation_scans"], m["triangulation_refused"], m["triangulation_compared"]) == (2, 1, 1)
    m = evaluate(tracks(T5, [10, 10]), None, bearings, PLACE, EvaluateConfig(triangulation_min_sensors=3)).metrics
    assert (m["triangulation_scans"], m["triangulation_refused"]) == (1, 0)
    assert m["triangulation_residual_rms_mrad"] == pytest.approx(0.0, abs=1e-6)


def test_residual_tells_how_well_three_lines_meet() -> None:
    bearings = both(pixels(EAST, [0.0], [2]), pixels(WEST, [0.0], [2]), pixels(NORTH, [0.0], [0]))
    # east says 10 mrad x 2 below, west the same above: they cancel, each 20 mrad off
    m = evaluate(tracks(T5, [10, 10]), None, bearings, PLACE, EvaluateConfig(triangulation_loss="gauss")).metrics
    assert m["triangulation_residual_rms_mrad"] == pytest.approx(1e3 * math.atan(0.02) * math.sqrt(2 / 3), rel=1e-3)
    assert m["triangulation_distance_max_m"] == pytest.approx(0.0, abs=1e-6)


def test_unlabelled_not_seen_and_held_out_rows_do_not_take_part() -> None:
    good = rows_to([10] * 5, [10] * 5)
    bad = both(pixels(WEST, T5, [50] * 5), pixels(EAST, T5, [30] * 5, target=-1), pixels(NORTH, [4.5], [NAN]))
    m = evaluate(tracks(T5, [10, 10]), None, both(good, bad), PLACE, EvaluateConfig(held_out=("west",))).metrics
    assert m["triangulation_distance_max_m"] == pytest.approx(0.0, abs=1e-9)
    assert (m["triangulation_scans"], m["triangulation_compared"]) == (5, 5)


def test_only_tracks_near_in_time_of_the_same_identity_are_compared() -> None:
    bearings = both(rows_to([10] * 5, [10] * 5))
    late = evaluate(tracks([3.0, 4.0], [10, 11]), None, bearings, PLACE).metrics
    assert late["triangulation_compared"] == 2
    other = evaluate(tracks(T5, [10, 11], target=3), None, bearings, PLACE).metrics
    assert other["triangulation_compared"] == 0
    assert math.isnan(other["triangulation_distance_max_m"])


def test_nothing_to_meet_gives_no_figures() -> None:
    alone = evaluate(tracks(T5, [10, 10]), None, pixels(EAST, T5, [0] * 5), PLACE)
    assert alone.metrics == {"tracks": 1.0, "estimates_without_truth": 5.0}
    assert "come from 2 sensors within" in alone.notes[0]


def test_bearings_of_no_person_in_particular_compare_with_nothing_and_a_line_says_so() -> None:
    nameless = both(pixels(EAST, T5, [0] * 5, target=-1), pixels(NORTH, T5, [0] * 5, target=-1))
    assert "no bearing has a target label" in evaluate(tracks(T5, [10, 10]), None, nameless, PLACE).notes[0]
    assert not evaluate(tracks(T5, [10, 10]), None, rows_to([10] * 5, [10] * 5), PLACE).notes


def test_scans_within_a_window_hold_each_sensor_once() -> None:
    a, b = pixels(EAST, [0.0, 0.1, 0.2, 1.0], [0] * 4), pixels(NORTH, [0.05, 1.03], [0] * 2)
    rows = both(a, b)  # 0 east, 0.05 north, 0.1 east, 0.2 east, 1.0 east, 1.03 north
    assert scan_starts(rows, 0).tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert scan_starts(rows, 60_000_000).tolist() == [0, 2, 3, 4, 6]
    assert scan_starts(rows.take(slice(0, 0)), 0).tolist() == [0]
    found = triangulated_points(rows, PLACE, EvaluateConfig(triangulation_window_s=0.06))[0]
    assert found.t_ns.tolist() == seconds([0.025, 1.015]).tolist()
    np.testing.assert_allclose(found.xy, [[10, 10], [10, 10]])
    assert found.n_lines.tolist() == [2, 2]
    assert (found.status == triangulate.TRIANGULATED).all()


def test_directions_of_arrays_meet_lines_of_cameras_across_the_cut() -> None:
    made_scene = scene(EAST, arrays=(array("ear", 20.0, 10.5),))
    bearings = both(pixels(EAST, [0.0], [-10.0]), directions("ear", [0.0], [-math.pi + 0.01], 0.01))
    found = triangulated_points(bearings, made_scene, EvaluateConfig())[0]
    # y = 10 + x / 10 and y = 10.5 - (20 - x) tan 0.01
    slope = math.tan(0.01)
    x = (0.5 - 20 * slope) / (0.1 - slope)
    np.testing.assert_allclose(found.xy[0], [x, 10 + x / 10], rtol=1e-6)


def test_covariance_of_the_meeting_point() -> None:
    m = evaluate(tracks(T5, [10, 10]), None, rows_to([10] * 5, [10] * 5), PLACE).metrics
    # 1 px at f = 100 px and 10 m: 0.1 m along each axis
    assert m["triangulation_sigma_median_m"] == pytest.approx(math.sqrt(0.01 + 0.01))


def test_a_scan_lasts_exactly_as_long_as_the_window() -> None:
    rows = both(pixels(EAST, [0.0], [0]), pixels(NORTH, [0.05], [0]))
    assert scan_starts(rows, 50_000_000).tolist() == [0, 2]
    assert scan_starts(rows, 49_999_999).tolist() == [0, 1, 2]


def test_scans_with_as_many_lines_as_asked_for_are_used() -> None:
    rows = rows_to([10] * 5, [10] * 5)
    assert len(triangulated_points(rows, PLACE, EvaluateConfig(triangulation_min_sensors=2))[0].t_ns) == 5
    assert len(triangulated_points(rows, PLACE, EvaluateConfig(triangulation_min_sensors=3))[0].t_ns) == 0
