"""Experiments in small: they run, repeat, and show what they must."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.errors import UsageError
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.papers import catalogue
from occlog.papers.ercan import selection as selection_period
from occlog.papers.ercan.formulas.accuracy import fig17, judge17
from occlog.papers.ercan.formulas.blocking import FORMS
from occlog.papers.ercan.square import fig6
from occlog.papers.ercan.trial import (
    KNOWN,
    L_ORDER,
    LAB_ORDER,
    LAB_SIZE,
    NONE,
    PRIOR,
    SQUARE_ORDER,
    WORST,
    l_room,
    lab,
    square_room,
)
from occlog.papers.verdicts import Experiment, Size, find
from occlog.pipeline.sweep.engine import run_all

ERCAN = ["equations", "baselines", "joint", "selection-period", "fig6", "fig7", "fig8", "fig9", "fig10", "fig12"]
ERCAN += ["fig14", "fig15", "fig17"]


@pytest.mark.parametrize(
    ("text", "cameras", "order"),
    [(square_room(pillar=True), 8, SQUARE_ORDER), (l_room(), 12, L_ORDER), (lab(), 16, LAB_ORDER)],
)
def test_rooms_are_scenes_and_orders_name_their_cameras(text: str, cameras: int, order: tuple[int, ...]) -> None:
    scene = scene_from_yaml(text, "scene")
    assert [c.name for c in scene.cameras] == [f"cam{n}" for n in range(1, cameras + 1)]
    assert len(set(order)) == len(order)
    assert set(order) <= set(range(1, cameras + 1))


def test_rooms_are_those_of_the_examples(repository_examples: dict[str, str]) -> None:
    for name, text in (("room100", square_room(pillar=True)), ("lroom", l_room())):
        ours, theirs = scene_from_yaml(text, "ours"), scene_from_yaml(repository_examples[name], "theirs")
        np.testing.assert_allclose(ours.region, theirs.region)
        assert len(ours.occluders) == len(theirs.occluders)
        for a, b in zip(ours.cameras, theirs.cameras, strict=True):
            assert (a.name, a.fov, a.sigma_position, a.sigma_yaw) == (b.name, b.fov, b.sigma_position, b.sigma_yaw)
            np.testing.assert_allclose(a.ground, b.ground)
            assert a.yaw == pytest.approx(b.yaw)


def test_lab_cameras_look_inwards() -> None:
    scene = scene_from_yaml(lab(), "scene")
    middle = 0.5 * np.array(LAB_SIZE)
    for c in scene.cameras:
        towards = middle - np.asarray(c.ground)
        assert np.array([math.cos(c.yaw), math.sin(c.yaw)]) @ towards == pytest.approx(np.hypot(*towards), rel=1e-6)


def test_every_experiment_is_listed_once() -> None:
    assert [e.item for e in catalogue.PAPERS["ercan"]] == ERCAN
    assert [e.item for e in catalogue.choose("ercan", ["fig17", "fig6"], everything=False)] == ["fig6", "fig17"]
    assert len(catalogue.choose("ercan", [], everything=True)) == len(ERCAN)


@pytest.mark.parametrize(
    ("paper", "items", "expected"),
    [("erkan", [], "erkan"), ("ercan", ["fig66"], "fig6")],
)
def test_unknown_names_are_refused(paper: str, items: list[str], expected: str) -> None:
    with pytest.raises(UsageError, match=expected):
        catalogue.choose(paper, items, everything=False)


def test_size_is_that_of_the_paper_unless_stated() -> None:
    e: Experiment = catalogue.choose("ercan", ["fig6"], everything=False)[0]
    assert catalogue.size_of(e, quick=False, runs=None, steps=None, seed=3) == Size(5, 4000, False, 1000, 3)
    assert catalogue.size_of(e, quick=True, runs=4, steps=None, seed=0)[:2] == (4, e.quick[1])


@pytest.mark.statistics
def test_small_fig6() -> None:
    """Two camera counts: the same rows at every call, known below none at four cameras."""
    size = Size(2, 40, True, 300)
    table = fig6(size, run_all, counts=(2, 4))
    assert [(r.series, r.x) for r in table[:-1]] == [(s, n) for n in (2, 4) for s in (NONE, PRIOR, KNOWN)]
    assert table[-1].series == WORST
    assert all(r.runs == 2 and all(math.isfinite(x) for x in r.values) for r in table)
    known, none, prior = (find(table, s, 4) for s in (KNOWN, NONE, PRIOR))
    assert known is not None
    assert none is not None
    assert prior is not None
    assert known.mean < none.mean
    assert known.extra["rmse_occ"] == 0.0
    assert 4.0 < prior.extra["rmse_occ"] < 9.0
    again = fig6(size, run_all, counts=(2,))
    assert [r.values for r in again[:3]] == [r.values for r in table[:3]]


@pytest.mark.statistics
def test_small_fig17() -> None:
    """Quadrature is within k sigma as often as a normal variable; the forms rank as their errors do."""
    table = fig17(Size(2, 300), run_all)
    share = {(r.series, r.x): r.mean for r in table}
    # 600 places: standard error of a share is at most 0.02
    for k, wanted in ((1.0, 0.683), (2.0, 0.954), (3.0, 0.997)):
        assert share["quadrature", k] == pytest.approx(wanted, abs=0.05)
    assert share["printed", 3.0] < share["improved", 3.0] <= share["quadrature", 3.0]
    errors = [next(r.extra["largest_error"] for r in table if r.series == name) for name in FORMS]
    assert errors[0] < 0.07
    assert errors[1] < 0.025
    assert {x.verdict for x in judge17(table)} == {"reproduced"}


@pytest.mark.parametrize(("slope", "word"), [(0.01, "reproduced"), (0.0, "not reproduced"), (-0.01, "not reproduced")])
def test_selections_are_compared_by_the_time_between_them(slope: float, word: str) -> None:
    def trials(specs):
        assert {s["select"]["n_cameras"] for s in specs} == {selection_period.COUNT}
        return [{"rmse": 3.0 + slope * s["select"]["selection_interval"] + 0.001 * (s["run"] % 3)} for s in specs]

    table = selection_period.by_period(Size(10, 40), trials)
    assert [r.x for r in table] == list(selection_period.PERIODS)
    (found,) = selection_period.judge(table)
    assert (found.verdict, found.measured) == (word, pytest.approx(12.0 * slope))
