"""The stand-in for the building of [Rahimi] Sec. 7: what the paper tells of it holds, and how it is judged."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from occlog.papers import verdicts as v
from occlog.papers.rahimi import walk
from occlog.papers.verdicts import PaperRow
from occlog.records.tables import Bearings
from occlog.simulate.config import ObserveConfig
from occlog.simulate.sensors.cameras import observe


def test_a_walk_is_as_the_paper_tells() -> None:
    xy, part = walk.walk(np.random.default_rng(1))
    assert np.hypot(*(xy[-1] - xy[0])) < 0.5  # it begins and ends at the same place
    assert 50.0 < len(xy) * walk.STEP_S < 65.0  # and takes about a minute
    legs = (part == len(walk.LOOP) + 2) | (part == len(walk.LOOP) + 3)
    assert np.median(np.abs(xy[legs, 0] - walk.CAMERAS[2][0])) < 1e-6  # along one bearing of camera 3
    truth = walk.truth_of(xy, walk.STEP_S)
    table = Bearings.concat(observe(walk.building(known=True), [truth], ObserveConfig(diameter=0.0), 0))
    _, times = np.unique(table.t_ns[table.seen], return_counts=True)
    assert times.max() == 1  # views do not overlap
    assert set(table.sensor[table.seen].tolist()) == {"cam1", "cam2", "cam3", "cam4"}
    wall = np.array(walk.WALL)
    assert not any(walk.line_of_sight_blocked(a, b[None], wall)[0] for a, b in pairwise(xy))
    assert walk.line_of_sight_blocked(np.array([12.5, 5.0]), np.array([[15.0, 5.0]]), wall)[0]


@pytest.mark.jit
def test_a_walk_is_estimated_with_its_loop_the_right_way_round() -> None:
    found = walk.walk_trial({"seed": 0, "run": 0, "walls": False})
    assert set(found) == set(walk.FIGURES)
    assert found["order"] == 1.0
    assert 0.05 < found["loop"] < 4.0


def test_statements_follow_from_the_figures() -> None:
    def rows(name: str, loop: float, legs: float, order: float, through: float) -> list[PaperRow]:
        noise = 0.01 * np.sin(np.arange(50.0))
        values = (loop + noise, legs + 2.0 * noise, np.full(50, order), np.full(50, through))
        return [PaperRow(f"{name}, {k}", 0.0, tuple(x.tolist())) for k, x in zip(walk.FIGURES, values, strict=True)]

    good = [*rows(walk.FREE, 0.5, 2.0, 1.0, 1.0), *rows(walk.WALLED, 0.5, 1.0, 1.0, 0.0)]
    assert {x.verdict for x in walk.judge7(good)} == {v.REPRODUCED}
    bad = [*rows(walk.FREE, 3.0, 2.0, 0.0, 0.0), *rows(walk.WALLED, 3.0, 2.5, 0.0, 0.0)]
    assert {x.id: x.verdict for x in walk.judge7(bad)} == {
        "fig7-depths": v.NOT,
        "fig7-loop": v.NOT,
        "fig7-legs": v.NOT,
        "fig7-walls": v.NOT,
        "fig7-through": v.UNDECIDED,  # none of 50 walks may still be 5 % of them
    }
