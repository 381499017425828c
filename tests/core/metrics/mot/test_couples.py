"""Sums of couples as a matrix and without one, against a dictionary."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from occlog.core.metrics.mot import frame_pairs as couples
from occlog.core.metrics.mot.frame_pairs import Objects, TargetTrackSums, of_points
from occlog.core.metrics.mot.gospa import Ospa2Windows, ospa2
from occlog.core.metrics.mot.hota import hota, identity


@pytest.mark.parametrize("dense", [0, couples.DENSE])
@pytest.mark.parametrize("seed", range(3))
def test_sums_are_those_of_a_dictionary(seed: int, dense: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(couples, "DENSE", dense)
    monkeypatch.setattr(couples, "PENDING", 50)
    rng, found = np.random.default_rng(seed), TargetTrackSums(7, 9, sums=2)
    reported: dict[tuple[int, int], list[float]] = defaultdict(lambda: [0.0, 0.0])
    for _ in range(60):
        target, track = np.divmod(rng.choice(40, rng.integers(0, 12), replace=False), 9)
        values = rng.normal(size=(2, len(target)))
        found.add(target, track, values)
        for n, couple in enumerate(zip(target.tolist(), track.tolist(), strict=True)):
            reported[couple] = [reported[couple][s] + values[s, n] for s in (0, 1)]
    every = np.divmod(np.arange(63), 9)
    expected = np.array([reported.get((i, j), [0.0, 0.0]) for i, j in zip(*every, strict=True)]).T
    assert np.array_equal(found.at(*every), expected)
    target, track, values = found.all()
    assert list(zip(target.tolist(), track.tolist(), strict=True)) == sorted(reported)
    assert np.array_equal(values, np.array([reported[each] for each in sorted(reported)]).T)


@pytest.mark.parametrize("dense", [0, couples.DENSE])
def test_what_is_taken_away_again_is_gone(dense: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(couples, "DENSE", dense)
    found, one = TargetTrackSums(3, 3), np.ones((1, 2))
    for sign in (1, -1):
        found.add(np.array([0, 2]), np.array([1, 1]), sign * one)
    found.add(np.array([2]), np.array([2]), np.array([[5.0]]))
    assert [each.tolist() for each in found.all()] == [[2], [2], [[5.0]]]


def test_nothing_and_no_one(monkeypatch: pytest.MonkeyPatch) -> None:
    for dense in (-1, couples.DENSE):
        monkeypatch.setattr(couples, "DENSE", dense)
        for shape in ((0, 0), (0, 4), (4, 0), (4, 4)):
            assert not TargetTrackSums(*shape).all()[0].size
        assert TargetTrackSums(4, 4).at(np.array([0, 3]), np.array([3, 0])).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("seed", range(4))
def test_figures_are_the_same_without_a_matrix(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(seed)
    sides = []
    for n in (12, 15):
        frame, label = np.nonzero(rng.random((40, n)) < 0.6)
        sides.append(Objects(frame, label, rng.uniform(0.0, 4.0, (len(frame), 2))))
    figures = []
    for dense in (0, couples.DENSE):
        monkeypatch.setattr(couples, "DENSE", dense)
        frames = of_points(*sides, limit=1.0)
        means, found = hota(frames).means(), identity(frames)
        sizes = len(frames.truth_key), len(frames.track_key)
        windows = list(Ospa2Windows(*sizes, 1.0, 2.0, 10).update(frames, range(0, 40, 3)))
        figures.append((means, found.idf1, found.track.tolist(), ospa2(frames, 1.0, 2.0), windows))
    for without, with_ in zip(*figures, strict=True):
        assert without == with_
