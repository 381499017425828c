"""What the truth says of two runs: who followed whom, errors over time, and the figures of `evaluate`."""

from __future__ import annotations

import numpy as np
import pytest
from two_runs import STEP, exchanged_at, lost, moved, tracks, truth

from occlog.evaluate.mot.config import MultiTargetConfig
from occlog.evaluate.mot.on_ground import evaluate_ground
from occlog.records.tables import PeopleTracks
from occlog.report.comparison.matching.pairs import Piece, TrackChange
from occlog.report.comparison.stage import matched_by_truth


def noisy(seed: int, spread: float) -> PeopleTracks:
    table = tracks()
    rng = np.random.default_rng(seed)
    table.x[:] += rng.normal(0, spread, len(table))
    table.y[:] += rng.normal(0, spread, len(table))
    return table.take(rng.random(len(table)) > 0.15)


def test_a_known_exchange_is_found_in_its_run_and_its_frame() -> None:
    a, b, switches, _ = matched_by_truth(tracks(), tracks(60, exchanged_at(25)), truth(), 1.0, "m", 10**9)
    assert a.changes == ()
    assert b.changes == (TrackChange(25 * STEP, 0, 10, 11), TrackChange(25 * STEP, 1, 11, 10))
    assert b.of(0) == (Piece(0, 10, 0, 24 * STEP), Piece(0, 11, 25 * STEP, 59 * STEP))
    assert a.of(0) == (Piece(0, 10, 0, 59 * STEP),)
    assert switches == (0, 2)


def test_errors_are_of_targets_that_both_have_found_and_the_others_are_counted() -> None:
    a, b = tracks(60, moved(0, 10, 19, 0.3)), tracks(60, lost(1, 15, 49))
    found = matched_by_truth(a, b, truth(), 1.0, "m", 0)[3]
    # Of three targets in frames before 15, of two where B has lost one: gaps of 1 s at most are bridged, this is longer
    wanted = np.where(
        (found.t_ns >= 10 * STEP) & (found.t_ns < 20 * STEP), 0.3 / np.sqrt(np.where(found.t_ns < 15 * STEP, 3, 2)), 0.0
    )
    np.testing.assert_allclose(found.a, wanted, atol=1e-12)
    np.testing.assert_allclose(found.b, 0.0, atol=1e-12)
    assert found.missed_b.tolist() == [int(15 <= k < 50) for k in range(60)]
    assert found.missed_a.sum() == found.false_a.sum() == found.false_b.sum() == 0
    assert found.both == 60


def test_a_frame_in_which_they_found_no_one_in_common_has_no_error() -> None:
    def only(person: int, table: PeopleTracks) -> PeopleTracks:
        return table.take(table.target_id == person + 10)

    found = matched_by_truth(only(0, tracks()), only(1, tracks()), truth(), 1.0, "m", 0)[3]
    assert np.isnan(found.a).all()
    assert np.isnan(found.b).all()
    assert found.both == 0
    assert found.missed_a.tolist() == found.missed_b.tolist() == [2] * 60


def test_counts_and_switches_are_those_of_evaluate() -> None:
    a, b = noisy(1, 0.2), noisy(2, 0.6)
    _, _, switches, errors = matched_by_truth(a, b, truth(), 1.0, "m", 10**9)
    for k, (run, missed, false) in enumerate(
        ((a, errors.missed_a, errors.false_a), (b, errors.missed_b, errors.false_b))
    ):
        figures = evaluate_ground(run, truth(), MultiTargetConfig(match_distance=1.0), None).metrics
        assert figures["id_switches"] == switches[k]
        # Pairs of each frame alone are as many as MODA's at the same distance
        alone = evaluate_ground(run, truth(), MultiTargetConfig(match_distance=1.0, moda_distance=1.0), None).metrics
        assert alone["moda_missed"] == missed.sum()
        assert alone["moda_false"] == false.sum()
    assert (errors.missed_b.sum(), errors.false_b.sum()) > (0, 0)


def test_the_other_way_round_is_the_same() -> None:
    a, b = noisy(3, 0.2), noisy(4, 0.4)
    first, second = (matched_by_truth(*pair, truth(), 1.0, "m", 10**9) for pair in ((a, b), (b, a)))
    assert first[0] == second[1]
    assert first[2] == second[2][::-1]
    np.testing.assert_array_equal(first[3].a, second[3].b)
    assert float(np.nanmean(first[3].b)) == pytest.approx(0.4 * np.sqrt(2), rel=0.25)
