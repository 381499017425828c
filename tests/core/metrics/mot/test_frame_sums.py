"""Sums over frames give the figures of the whole."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.metrics.mot.clear_mot import CHALLENGE, CLASSIC, ClearRule, clear_mot, match
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, of_points
from occlog.core.metrics.mot.frame_sums import FIGURES, PLACE, frame_sums, hota_of, idf1
from occlog.core.metrics.mot.hota import hota, identity


def scene(seed: int, frames: int = 40, people: int = 5) -> MatchedFrames:
    """People on a floor, tracks that miss, invent and exchange."""
    rng = np.random.default_rng(seed)
    cell, label = np.repeat(np.arange(frames), people), np.tile(np.arange(people), frames)
    position = np.column_stack([label * 2.0, 0.1 * cell]) + rng.normal(0, 0.1, (len(cell), 2))
    there = rng.random(len(cell)) < 0.9
    names = np.where(cell > 20, np.array([1, 0, 7, 3, 4])[label], label)
    kept = rng.random(len(cell)) < 0.85
    found = position + rng.normal(0, 0.4, position.shape)
    truth = Objects(cell[there], label[there], position[there])
    return of_points(truth, Objects(cell[kept], names[kept] + 10, found[kept]), 1.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rule", [CLASSIC, CHALLENGE])
def test_sums_over_all_frames_give_the_figures_of_the_whole(seed: int, rule: ClearRule) -> None:
    frames = scene(seed)
    sums = frame_sums(frames, 50, rule)
    assert sums.shape[0] == 50
    assert not sums[40:].any()
    total = sums.sum(axis=0)
    got = clear_mot(frames, rule)
    assert FIGURES["mota"](total) == pytest.approx(got.mota)
    assert FIGURES["recall"](total) == pytest.approx(got.recall)
    assert FIGURES["precision"](total) == pytest.approx(got.precision)
    assert idf1(total) == pytest.approx(identity(frames).idf1)
    assert hota_of(total) == pytest.approx(hota(frames).means()["hota"])
    pairs = match(frames, ClearRule(memory=0))
    assert FIGURES["matched_rmse"](total) == pytest.approx(np.sqrt(np.mean(pairs.distance**2)))
    assert total[PLACE["switches"]] == got.switches


def test_figures_of_many_sums_are_those_of_each() -> None:
    sums = frame_sums(scene(0), 40)
    parts = sums.reshape(8, 5, -1).sum(axis=1)
    for figure in FIGURES.values():
        np.testing.assert_allclose(figure(parts), [figure(part) for part in parts])


def test_nothing_at_all_is_not_a_number() -> None:
    nothing = Objects(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    total = frame_sums(of_points(nothing, nothing, 1.0), 3).sum(axis=0)
    assert all(np.isnan(figure(total)) for figure in FIGURES.values())
