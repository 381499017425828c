"""New people: log odds by the equations (`jipda_reference`), box by box, and the best first."""

from __future__ import annotations

import math

import jipda_reference as textbook
import numpy as np
import pytest
from random_frames import Scene, random_scene

from occlog.array_types import Floats
from occlog.track.methods.jipda.kernels.track_initiation import (
    BirthIntensity,
    initiate_targets,
    predicted_targets,
    propose_track,
    state_from_box,
)

BODY = np.array([1.7, 0.12, 0.55, 0.12, 0.9])
ARRIVAL = BirthIntensity(0.02, 2.0, np.array([[3.0, 3.0]]), np.array([0.05]), 1.5)
GATE, SPREAD = 30.0, np.array([0.1, 0.2])
SEEDS = range(6)


def tracked_in(s: Scene, c: int) -> list[textbook.Seen | None]:
    """Two people who are tracked already, as camera c is expected to show them; the position is all that is unsure."""
    out = []
    for k in range(len(SPREAD)):
        seen = textbook.predicted(s.cameras[c], s.mean[k], np.eye(6), 0.0, s.detectors[c])
        if seen is not None:
            across = SPREAD[k] * s.cameras[c].focal_px[0] / seen.depth
            seen = seen._replace(across=across, deep=SPREAD[k] + 0.1 * s.mean[k, 5])
        out.append(seen)
    return out


def proposed(s: Scene, frame: int, seed: int, free: Floats) -> tuple[float, Floats, Floats, Floats]:
    """Log odds, mean, covariance and associated boxes of the person whom box `seed` proposes, by the equations."""
    mean, P, used = np.empty(6), np.empty((6, 6)), np.zeros(len(s.boxes.box))
    total = state_from_box(s.views, s.boxes, s.rates, BODY, ARRIVAL, frame, seed, mean, P)
    if not (math.isfinite(total) and BODY[0] - 5.0 * BODY[1] <= mean[4] <= BODY[0] + 4.0 * BODY[1]):
        return -math.inf, mean, P, used
    size, boxes = (1280, 720), s.boxes
    total += math.log(free[seed]) - boxes.clutter[seed]
    total -= textbook.log_clutter(boxes.box[seed], boxes.usable[seed], size)
    used[seed] = 1.0
    for c, camera in enumerate(s.cameras):
        seen = textbook.predicted(camera, mean, P, 0.0, s.detectors[c])
        if seen is None:
            continue
        seen = seen._replace(deep=math.sqrt(0.5 * (P[0, 0] + P[1, 1])) + 0.1 * mean[5])
        cells = textbook.visible_cells(camera, 2, [*tracked_in(s, c), seen], np.append(s.existence[:2], 1.0))
        detection = s.detectors[c].detection * textbook.curve_at(s.detectors[c].curve, cells.mean())
        if c == frame:
            total += math.log(detection)
            continue
        R, ratio = textbook.edge_covariance(seen.box, s.detectors[c], 1.0), {}
        for j in range(boxes.first[c], boxes.first[c + 1]):
            log, distance = textbook.log_density(boxes.box[j] - seen.box, boxes.usable[j], seen.spread + R)
            if free[j] >= 0.05 and distance <= GATE:
                log -= textbook.log_clutter(boxes.box[j], boxes.usable[j], size) + boxes.clutter[j]
                ratio[j] = free[j] * math.exp(log)
        evidence = 1.0 - detection + detection * sum(ratio.values())
        total += math.log(evidence)
        if ratio:
            best = max(ratio, key=ratio.__getitem__)
            p = used[best] = detection * ratio[best] / evidence
            edges = np.flatnonzero(boxes.usable[best])
            if p > 0.5:
                off = boxes.box[best] - seen.box
                mean, P = textbook.kalman(mean, P, seen.H[edges], off[edges], R[np.ix_(edges, edges)] / p)
    return total, mean, P, used


@pytest.mark.parametrize("seed", SEEDS)
def test_odds_of_a_new_person_are_those_of_all_cameras_boxes(seed: int) -> None:
    s = random_scene(seed)
    free = np.random.default_rng(seed).choice([0.04, 0.05, 0.5, 1.0], len(s.boxes.box))
    frame = np.repeat(np.arange(len(s.cameras)), np.diff(s.boxes.first))
    tracked = predicted_targets(s.views, s.boxes, s.mean[:2], SPREAD, s.existence[:2])
    finite = 0
    for j in range(len(free)):
        mean, P, used = np.empty(6), np.empty((6, 6)), np.empty(len(free))
        got = propose_track(s.views, s.boxes, s.rates, BODY, ARRIVAL, tracked, free, frame[j], j, GATE, mean, P, used)
        wanted, wanted_mean, wanted_P, wanted_used = proposed(s, frame[j], j, free)
        assert got == pytest.approx(wanted, rel=1e-5, abs=1e-4)
        np.testing.assert_allclose(used, wanted_used, rtol=1e-4, atol=1e-6)
        if math.isfinite(wanted):
            finite += 1
            np.testing.assert_allclose(mean, wanted_mean, rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(P, wanted_P, rtol=1e-4, atol=1e-7)
    assert finite >= 2


@pytest.mark.parametrize("seed", SEEDS)
def test_the_best_proposal_takes_its_boxes_from_the_others(seed: int) -> None:
    """As if every box proposed again after each new person."""
    s = random_scene(seed)
    M = len(s.boxes.box)
    frame = np.repeat(np.arange(len(s.cameras)), np.diff(s.boxes.first))
    free, taken, rows = np.random.default_rng(seed).choice([0.2, 0.25, 1.0], M), [], []
    none = np.zeros((0, 6)), np.zeros(0), np.zeros(0)
    found = initiate_targets(s.views, s.boxes, s.rates, BODY, ARRIVAL, *none, free, GATE, -2.0)
    tracked = predicted_targets(s.views, s.boxes, *none)
    left = free.copy()
    while True:
        best = (-math.inf, -1, *(np.zeros(n) for n in (6, 36, M)))
        for j in range(M):
            mean, P, used = np.empty(6), np.empty((6, 6)), np.empty(M)
            if j not in taken and left[j] > 0.2:
                odds = propose_track(
                    s.views, s.boxes, s.rates, BODY, ARRIVAL, tracked, left, frame[j], j, GATE, mean, P, used
                )
                best = max(best, (odds, j, mean, P, used), key=lambda each: each[0])
        if best[0] < -2.0:
            break
        rows.append(best)
        taken.append(best[1])
        left = np.maximum(left - best[4] / (1.0 + math.exp(-best[0])), 0.0)
    assert len(found[2]) == len(rows)
    for k, (odds, _, mean, P, used) in enumerate(rows):
        # Boxes that a proposal hardly shares with one that was taken are not proposed again
        assert found[2][k] == pytest.approx(odds, abs=0.02)
        np.testing.assert_allclose(found[0][k], mean, atol=1e-3)
        np.testing.assert_allclose(found[1][k], P, rtol=0.02, atol=1e-5)
        np.testing.assert_allclose(found[3][k], used, atol=0.01)
