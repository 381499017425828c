"""[Lee] Sec. 5.2.1: trials on cases that are known, and tables that the verdicts must tell apart."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.papers.lee.appearance.coefficient import BINS, COEFFICIENT, coefficient_trial
from occlog.papers.lee.appearance.faces import FACES, KNOWN, equal_error, faces_trial, similarities
from occlog.papers.lee.appearance.motion import DIRECTIONS, MOTION, camera_of, seen_motion
from occlog.papers.verdicts import IN_PART, NOT, REPRODUCED, UNDECIDED, PaperRow, Size


def run(experiment, runs, steps):
    """Table and verdicts by their id, of a small size."""
    table = experiment.compute(Size(runs, steps, quick=True), lambda specs: [experiment.trial(s) for s in specs])
    return table, {v.id: v for v in experiment.judge(table)}


def test_the_coefficient_is_blind_to_layout_and_its_bias_has_a_closed_form_for_few_bins():
    _, found = run(COEFFICIENT, 60, 2000)
    for key in ("range", "layout", "order", "width", "ends", "corrected", "bias-many-32"):
        assert found[key].verdict == REPRODUCED, key
    # The closed form does not hold where bins have two values each
    assert found["bias-few-256"].verdict == NOT
    assert found["bias-few-256"].paper == pytest.approx(255 / 8 * 2 / 500)
    assert found["bias-few-256"].measured == pytest.approx(0.201, abs=0.005)
    assert "500 values" in found["bias-few-256"].statement


def test_equal_seeds_give_equal_coefficients():
    spec = {"kind": "lee-coefficient", "values": 100, "seed": 3, "run": 1}
    assert coefficient_trial(spec) == coefficient_trial(spec)
    assert coefficient_trial(spec) != coefficient_trial(spec | {"run": 2})
    assert {f"same-{m}" for m in BINS} <= set(coefficient_trial(spec))


def test_who_walks_north_moves_left_seen_from_the_west():
    start = np.zeros((1, 2))
    across, growth = seen_motion(camera_of(1), start, math.radians(DIRECTIONS["N"]))
    assert across[0] < 0 < seen_motion(camera_of(4), start, math.radians(DIRECTIONS["N"]))[0][0]
    assert abs(growth[0]) < 0.05
    assert seen_motion(camera_of(3), start, math.radians(DIRECTIONS["N"]))[1][0] < 0
    assert seen_motion(camera_of(5), start, math.radians(DIRECTIONS["N"]))[1][0] > 0


def test_all_printed_signs_of_motion_hold():
    table, found = run(MOTION, 2, 10)
    assert len(found) == 12
    assert {v.verdict for v in found.values()} == {REPRODUCED}
    lost = [PaperRow(r.series, r.x, tuple(0.4 for _ in r.values)) for r in table if r.series != "moves N"]
    judged = {v.id: v.verdict for v in MOTION.judge(lost)}
    assert (judged["motion-N-1"], judged["motion-NE-1"]) == (UNDECIDED, NOT)


def test_candidates_are_compared_at_their_own_angle():
    gallery = np.array([[[9.0, 0.0], [0.0, 9.0]], [[0.0, 9.0], [9.0, 0.0]]])  # two people, two angles
    like = similarities(gallery, np.array([[5.0, 0.0], [5.0, 0.0]]), np.array([0, 1]))
    assert like.argmax(axis=1).tolist() == [0, 1]


def test_threshold_of_equal_errors():
    like = np.array([[0.9, 0.2], [0.3, 0.8], [0.7, 0.6]])
    same = np.array([[True, False], [False, True], [True, False]])
    assert 0.6 < equal_error(like, same) <= 0.7


def judged(item, **series):
    """Verdicts of an experiment on rows of two runs with these values at each x."""
    experiment = next(e for e in FACES if e.item == item)
    rows = [PaperRow(name, float(x), (y, y)) for name, points in series.items() for x, y in points]
    return {v.id: v.verdict for v in experiment.judge(rows)}


def test_suspending_must_lower_the_share_of_false_decisions_everywhere():
    low, high = [(k, 0.1) for k in KNOWN], [(k, 0.2) for k in KNOWN]
    mixed = [(KNOWN[0], 0.3), *low[1:]]
    names = {"other skin and hair, suspended": low, "other skin and hair, decided anyway": high}
    assert judged("suspended", **names)["suspend-different"] == REPRODUCED
    assert judged("suspended", **names | {"other skin and hair, suspended": mixed})["suspend-different"] == IN_PART
    assert judged("suspended", **names)["suspend-alike"] == UNDECIDED


def test_people_must_be_separable_and_alike_ones_harder():
    names = {
        "other skin and hair, AUC": [(72, 0.96)],
        "same skin and hair, AUC": [(72, 0.97)],
        "other skin and hair, rank-1": [(72, 0.9)],
        "same skin and hair, rank-1": [(72, 0.2)],
    }
    found = judged("faces", **names)
    assert found == {"race-rank-1": REPRODUCED, "race-AUC": NOT, "separable": REPRODUCED}


@pytest.mark.statistics
def test_heads_of_different_people_are_distinguished_from_all_sides():
    found = faces_trial({"kind": "lee-faces", "probes": 1, "seed": 0, "run": 0})
    assert found["auc-different-bins-72"] > 0.9 > found["auc-alike-bins-72"]
    assert found["rank1-different-angles-7"] > found["rank1-different-angles-1"] + 0.1
    assert found["left-different-1"] == pytest.approx(6 / 7)
