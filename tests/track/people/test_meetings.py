"""Doubts where two people met: their probability, against a plain form, and known scenes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from occlog.array_types import NS, Floats
from occlog.track.methods.jipda.config import JipdaConfig
from occlog.track.methods.jipda.interface import NO_ID, BoxAssociations, Event, TrackSnapshot, no_associations
from occlog.track.people import close_encounters
from occlog.track.people.close_encounters import MIN_SWITCH_PROBABILITY, CloseEncounters, log_ratio, switch_probability

STEP_S = 0.1
CLEAR = 0.4
"""Distance from which a camera has a box of each."""


@pytest.mark.parametrize("seed", range(4))
def test_the_ratio_is_that_of_normal_densities(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, after = rng.normal(size=(2, 2, 6))
    roots = rng.normal(size=(2, 2, 6, 6))
    cov_before, cov_after = roots @ roots.transpose(0, 1, 3, 2) + 0.1 * np.eye(6)
    passed, manoeuvre = rng.uniform(0.05, 2), rng.uniform(0.1, 2)
    F, Q = np.eye(6), np.zeros((6, 6))
    F[0, 2] = F[1, 3] = passed
    Q[np.ix_([0, 2], [0, 2])] = Q[np.ix_([1, 3], [1, 3])] = manoeuvre * np.array(
        [[passed**3 / 3, passed**2 / 2], [passed**2 / 2, passed]]
    )
    log = [
        [
            multivariate_normal.logpdf(after[j], F @ before[i], F @ cov_before[i] @ F.T + Q + cov_after[j])
            for j in (0, 1)
        ]
        for i in (0, 1)
    ]
    expected = log[0][0] + log[1][1] - log[0][1] - log[1][0]
    assert log_ratio(before, cov_before, after, cov_after, passed, manoeuvre) == pytest.approx(expected, rel=1e-9)


def test_who_came_near_and_is_distinguished_badly_is_exchanged_more_probably() -> None:
    distances, ratios = [0.0, 0.3, 1.0, 4.0], [-5.0, 0.0, 3.0, 100.0]
    found = np.array([[switch_probability(d, r, 0.5) for r in ratios] for d in distances])
    assert (np.diff(found, axis=0) <= 0).all()
    assert (np.diff(found, axis=1) <= 0).all()
    # Limits of both are where they are stated to be
    assert (found[0] == found[1]).all()
    assert (found[:, 0] == found[:, 1]).all()
    assert switch_probability(1.0, 1e9, 0.5) == found[2, 3]
    odds = np.exp(2.25) * 0.3**-1.3 * 0.6**-1.1
    assert found[0, 0] == pytest.approx(odds / (1 + odds))
    odds = np.exp(2.25) * 2.0**-1.3 * 4.0**-0.9 * 1.3**-1.1
    assert switch_probability(2.0, 3.0, 1.2) == pytest.approx(odds / (1 + odds))


def crossing(gap: float, sd: float, unit: float = 1.0, blind: bool = True) -> list[TrackSnapshot]:
    """Two people who walk towards each other at 1 m/s and pass; cameras tell them apart from `CLEAR` on."""
    moments = []
    for k in range(41):
        t = k * STEP_S
        mean = np.array([[t - 2, 0, 1, 0, 1.7, 0.5], [2 - t, gap, -1, 0, 1.7, 0.5]])
        apart = float(np.hypot(*(mean[0] - mean[1])[:2]))
        seen = not blind or apart > CLEAR
        moments.append(moment(k, mean * unit, sd * unit, seen))
    return moments


def moment(number: int, mean: Floats, sd: float, seen: bool) -> TrackSnapshot:
    n = len(mean)
    cov = np.tile(np.diag([sd**2, sd**2, (3 * sd) ** 2, (3 * sd) ** 2, sd**2, sd**2]), (n, 1, 1))
    boxes = (
        BoxAssociations(np.arange(n), np.zeros(n, int), np.arange(n), np.ones(n), np.zeros(n))
        if seen
        else no_associations()
    )
    none = np.full((n, 1), np.nan)
    return TrackSnapshot(round(number * STEP_S * NS), np.arange(n) + 7, mean, cov, np.ones(n), none, boxes, ())


def doubts(moments: list[TrackSnapshot], unit: float = 1.0) -> list[tuple[int, Event]]:
    encounters = CloseEncounters(JipdaConfig(person_width=0.55 * unit, manoeuvre_noise_density=unit**2))
    return [(k, event) for k, each in enumerate(moments) for event in encounters.add(each)]


def test_two_who_pass_closely_unseen_are_doubted_once_when_they_part() -> None:
    found = doubts(crossing(0.05, 0.2))
    assert [(e.kind, e.id, e.other) for _, e in found] == [("possible_switch", 7, 8), ("possible_switch", 8, 7)]
    (when, one), (_, other) = found
    assert one.probability == other.probability >= MIN_SWITCH_PROBABILITY
    # 2.2 widths apart again, 1.21 m at 2 m/s after the middle
    assert when == 27


def test_the_time_without_separate_boxes_is_that_of_the_crossing(monkeypatch) -> None:
    times = []
    monkeypatch.setattr(close_encounters, "switch_probability", lambda *given: times.append(given[2]) or 0.0)
    assert doubts(crossing(0.05, 0.2)) == []
    # Closer than 0.4 m at 1.9, 2.0 and 2.1 s; separate boxes at 1.8 s
    assert times == pytest.approx([0.3])


def test_two_who_are_seen_apart_all_the_time_are_not() -> None:
    assert doubts(crossing(0.45, 0.03, blind=False)) == []


def test_two_who_never_come_near_are_not() -> None:
    assert doubts(crossing(0.9, 0.5)) == []


@pytest.mark.parametrize("unit", [100.0, 0.001])
def test_the_unit_of_length_does_not_matter(unit: float) -> None:
    metres, others = doubts(crossing(0.05, 0.2)), doubts(crossing(0.05, 0.2, unit), unit)
    assert [k for k, _ in metres] == [k for k, _ in others]
    assert others[0][1].probability == pytest.approx(metres[0][1].probability, rel=1e-6)


def test_what_the_method_itself_doubts_is_not_stated_again() -> None:
    moments = crossing(0.05, 0.2)
    moments[21] = moments[21]._replace(events=(Event("possible_switch", 8, 7, 0.4), Event("initiated", 9, NO_ID, 0.9)))
    assert doubts(moments) == []


def test_of_one_who_has_gone_nothing_is_stated() -> None:
    moments = crossing(0.05, 0.2)
    gone = [
        each._replace(
            ids=each.ids[:1],
            mean=each.mean[:1],
            covariance=each.covariance[:1],
            visibility=each.visibility[:1],
            support=no_associations(),
        )
        for each in moments[21:]
    ]
    assert doubts(moments[:21] + gone) == []
