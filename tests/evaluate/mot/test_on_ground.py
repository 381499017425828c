"""Tracks of many targets on the ground against the truth, on scenes that are worked by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.on_ground import evaluate_ground
from occlog.records.tables import Tracks, Truth

NS = 1_000_000_000


def positions(kind: type[Any], rows: list[tuple[float, int, float, float]]) -> Any:
    t, label, x, y = (np.array(column) for column in zip(*sorted(rows), strict=True))
    n = len(rows)
    if kind is Truth:
        extra: dict[str, Any] = {"role": np.full(n, "target"), "z": np.full(n, np.nan)}
    else:
        extra = {name: np.full(n, np.nan) for name in ("vx", "vy")}
        extra |= {"cov_xx": np.ones(n), "cov_xy": np.zeros(n), "cov_yy": np.ones(n)}
    return kind.of(t_ns=np.round(t * NS).astype(np.int64), target_id=label.astype(np.int32), x=x, y=y, **extra)


def test_points_on_the_ground() -> None:
    """Two walkers 5 m apart, seen every half second; the tracks change hands after 3 s, one is lost after 4 s."""
    true = [(float(t), k, float(t), 5.0 * k) for t in range(7) for k in (0, 1)]
    half = np.arange(0, 6.1, 0.5)
    rows = [(t, k if t < 3 else 1 - k, t, 5.0 * k + 0.3) for t in half.tolist() for k in (0, 1) if t <= 4 or k == 0]
    config = MultiTargetConfig(match_distance=1.0)
    got = evaluate_ground(positions(Tracks, rows), positions(Truth, true), config, NS)
    wanted = {
        "frames": 7,
        "objects": 14,
        "tp": 12,
        "fn": 2,
        "fp": 0,
        "id_switches": 2,
        "mota": 1 - 4 / 14,
        "motp_m": 0.3,
        "position_failures": 2,
        "label_failures": 2 + 2 + 2,
        "fr_p": 2 / 14,
        "idtp": 6,
        "recall": 12 / 14,
        "gospa_missed_m2": 2 * 0.5 / 7,
        "gospa_localisation_m2": 12 * 0.09 / 7,
    }
    assert {name: got.metrics[name] for name in wanted} == pytest.approx(wanted)
    assert got.failures.sensor.tolist() == [""] * 8
    assert got.failures.frame.tolist() == [3, 3, 4, 4, 5, 5, 6, 6]
    assert got.failures.cause.tolist()[4:6] == ["tracker on target 0", "its tracker is on target 0"]


def test_tracks_on_the_ground_are_interpolated_only_so_far() -> None:
    true = [(float(t), 0, float(t), 0.0) for t in range(5)]
    rows = [(t, 0, t, 0.0) for t in (0.5, 1.5, 3.5)]
    sides = positions(Tracks, rows), positions(Truth, true)
    far = evaluate_ground(*sides, MultiTargetConfig(match_distance=1.0), 2 * NS).metrics
    near = evaluate_ground(*sides, MultiTargetConfig(match_distance=1.0, track_gap_s=1.0), 2 * NS).metrics
    assert (far["tp"], near["tp"]) == (3, 1)
    with pytest.raises(InputError, match="distance"):
        evaluate_ground(*sides, MultiTargetConfig(), NS)


def test_a_metre_in_other_units() -> None:
    assert MultiTargetConfig.in_unit("m").match_distance == 1.0
    assert MultiTargetConfig.in_unit("ft").match_distance == pytest.approx(3.2808, abs=1e-4)
    assert MultiTargetConfig.in_unit("px").match_distance is None


def test_tracks_are_interpolated_over_gaps_up_to_their_limit() -> None:
    """Estimates at 0 and 2 s, a true place at 1 s."""
    sides = positions(Tracks, [(0.0, 0, 0.0, 0.0), (2.0, 0, 2.0, 0.0)]), positions(Truth, [(1.0, 0, 1.0, 0.0)])
    for gap_s, tp in ((2.0, 1), (1.999, 0)):
        assert evaluate_ground(*sides, MultiTargetConfig(match_distance=1.0, track_gap_s=gap_s), NS).metrics["tp"] == tp


def test_the_truth_is_interpolated_over_gaps_up_to_its_limit() -> None:
    """Target 0 is known at 0 and 2 s, target 1 at 1 s, which makes that a frame."""
    true = positions(Truth, [(0.0, 0, 0.0, 0.0), (1.0, 1, 9.0, 9.0), (2.0, 0, 2.0, 0.0)])
    for limit_ns, objects in ((2 * NS, 4), (2 * NS - 1, 3)):
        found = evaluate_ground(
            positions(Tracks, [(1.0, 0, 1.0, 0.0)]), true, MultiTargetConfig(match_distance=1.0), limit_ns
        )
        assert found.metrics["objects"] == objects


def test_a_true_row_that_is_missing_is_not_made_up_at_two_frames_a_second_and_is_counted_where_it_is() -> None:
    """Two people at 2 frames/s; no one annotated the second one at 1 s."""
    true = [(0.5 * k, label, 0.5 * k, 5.0 * label) for k in range(9) for label in (0, 1) if (k, label) != (2, 1)]
    sides = positions(Tracks, true), positions(Truth, true)
    config = MultiTargetConfig(match_distance=1.0)
    usual, second = (evaluate_ground(*sides, config, limit).metrics for limit in (None, NS))
    assert (usual["objects"], usual["objects_interpolated"]) == (17, 0)
    assert (second["objects"], second["objects_interpolated"]) == (18, 1)
    # Tracks are bridged over a second where nothing is given
    assert usual["fp"] == 1


def walkers(seconds: int) -> list[tuple[float, int, float, float]]:
    """Two people 5 m apart who walk next to each other at 1 m/s, one row a second."""
    return [(float(t), k, float(t), 5.0 * k) for t in range(seconds) for k in (0, 1)]


def test_detection_counts_no_one_twice_and_knows_no_identities() -> None:
    """Ten frames; one track is 0.2 m off and changes its name each second, the other ends after six."""
    true = walkers(10)
    rows = [(t, 10 + int(t), x + 0.2, y) for t, k, x, y in true if k == 0]
    rows += [(t, 50, x, y) for t, k, x, y in true if k == 1 and t < 6]
    rows += [(0.0, 60, 100.0, 100.0)]
    sides = positions(Tracks, rows), positions(Truth, true)
    got = evaluate_ground(*sides, MultiTargetConfig(match_distance=1.0, moda_distance=0.5), NS).metrics
    assert (got["moda_missed"], got["moda_false"]) == (4, 1)
    assert got["moda"] == pytest.approx(1 - 5 / 20)
    assert got["modp"] == pytest.approx(1 - (10 * 0.2 / 16) / 0.5)
    # 0.2 m is beyond 0.1 m: ten people are missed and ten tracks false
    near = evaluate_ground(*sides, MultiTargetConfig(match_distance=1.0, moda_distance=0.1), NS).metrics
    assert near["moda"] == pytest.approx(1 - (14 + 11) / 20)
    # Without a distance of its own it is that of the tracks
    assert evaluate_ground(*sides, MultiTargetConfig(match_distance=0.1), NS).metrics["moda"] == near["moda"]


def test_trajectories_that_change_hands() -> None:
    """The tracks change hands after six of ten frames."""
    true = walkers(10)
    rows = [(t, k if t < 6 else 1 - k, x, y) for t, k, x, y in true]
    config = MultiTargetConfig(match_distance=1.0, ospa_window=2)
    got = evaluate_ground(positions(Tracks, rows), positions(Truth, true), config, NS).metrics
    assert got["ospa2_m"] == got["ospa2_localisation_m"] == pytest.approx(0.4)
    assert got["ospa2_cardinality_m"] == 0.0
    # Windows of two frames: the one that ends with frame 6 is half wrong; the later ones are right with other names
    assert got["ospa2_window_m"] == pytest.approx(0.5 / 10)
    assert got["tgospa_switch_m2"] == pytest.approx(2.0 / 10)
    assert got["tgospa_m"] == pytest.approx(math.sqrt(2.0 / 10))
    cheap = MultiTargetConfig(match_distance=1.0, gospa_switch_penalty=0.5)
    got = evaluate_ground(positions(Tracks, rows), positions(Truth, true), cheap, NS).metrics
    assert got["tgospa_switch_m2"] == pytest.approx(0.5 / 10)
    dear = MultiTargetConfig(match_distance=1.0, ospa_cutoff=3.0)
    assert evaluate_ground(positions(Tracks, rows), positions(Truth, true), dear, NS).metrics[
        "ospa2_m"
    ] == pytest.approx(1.2)


def test_errors_of_pairs_are_those_of_whom_the_track_is_on() -> None:
    """Covariances are unit matrices; errors of 0.6 m give a NEES of 0.36 whoever the track was before."""
    true = walkers(10)
    rows = [(t, 7 if (k == 0) == (t < 6) else 8, x, y + 0.6) for t, k, x, y in true]
    got = evaluate_ground(
        positions(Tracks, rows), positions(Truth, true), MultiTargetConfig(match_distance=1.0), NS
    ).metrics
    assert (got["matched_rmse_m"], got["matched_error_median_m"]) == pytest.approx((0.6, 0.6))
    assert (got["matched_nees_mean"], got["matched_nees_compared"]) == pytest.approx((0.36, 20))
    assert got["matched_nees_share_95"] == 1.0


def test_the_covariance_of_an_interpolated_row_is_not_judged() -> None:
    true = [(float(t), 0, float(t), 0.0) for t in range(5)]
    tracks = positions(Tracks, [(t, 0, t, 0.0) for t in (0.0, 1.0, 1.5, 2.5, 3.0, 4.0)])
    got = evaluate_ground(tracks, positions(Truth, true), MultiTargetConfig(match_distance=1.0), NS).metrics
    assert (got["tp"], got["matched_nees_compared"]) == (5, 4)


def test_people_are_counted_over_time() -> None:
    """Two people; no one is found at first, then one, then both and a track of no one."""
    true = walkers(3)
    rows = [(1.0, 5, 1.0, 0.0), (2.0, 6, 2.0, 0.0), (2.0, 7, 2.0, 5.0), (2.0, 8, 50.0, 50.0)]
    got = evaluate_ground(positions(Tracks, rows), positions(Truth, true), MultiTargetConfig(match_distance=1.0), NS)
    counts = got.counts
    assert counts.targets.tolist() == [2, 2, 2]
    assert counts.tracks.tolist() == [0, 1, 3]
    assert counts.paired.tolist() == [0, 1, 2]
    assert counts.missed.tolist() == [2, 1, 0]
    assert counts.false.tolist() == [0, 0, 1]
    assert counts.switches.tolist() == [0, 0, 1]
    wanted = {
        "count_targets_mean": 2.0,
        "count_tracks_mean": 4 / 3,
        "count_error_mean": -2 / 3,
        "count_error_rms": math.sqrt((4 + 1 + 1) / 3),
        "count_error_max": 2.0,
    }
    assert {name: got.metrics[name] for name in wanted} == pytest.approx(wanted)


def test_a_track_that_goes_over_to_a_neighbour_is_judged_by_the_neighbour() -> None:
    """Two people 0.8 m apart; the one track is on the first, then on the second."""
    true = [(float(t), k, float(t), 0.8 * k) for t in range(10) for k in (0, 1)]
    rows = [(float(t), 5, float(t), 0.0 if t < 5 else 0.8) for t in range(10)]
    got = evaluate_ground(
        positions(Tracks, rows), positions(Truth, true), MultiTargetConfig(match_distance=1.0), NS
    ).metrics
    assert got["matched_rmse_m"] == pytest.approx(0.0)
    assert got["motp_m"] == pytest.approx(0.4)  # CLEAR-MOT keeps the first target's track
