"""The experiments of [Lee] Sec. 5.2.2, small: what they compute and how it is judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from occlog.papers.catalogue import PAPERS
from occlog.papers.lee.navigation.escapes import ESCAPE_EXPERIMENTS
from occlog.papers.lee.navigation.forces import FORCE_EXPERIMENTS, always
from occlog.papers.verdicts import Experiment, PaperRow, Size, StatementVerdict, find

EXPERIMENTS = {e.item: e for e in (*FORCE_EXPERIMENTS, *ESCAPE_EXPERIMENTS)}
SMALL = Size(2, 40, quick=True)
Trial = Callable[[Mapping[str, Any]], dict[str, float]]


def judged(item: str, size: Size = SMALL) -> dict[str, StatementVerdict]:
    experiment: Experiment = EXPERIMENTS[item]
    table = experiment.compute(size, lambda specs: [experiment.trial(s) for s in specs])
    return {v.id: v for v in experiment.judge(table)}


def test_the_experiments_are_those_of_the_section_and_come_last():
    assert list(EXPERIMENTS) == ["fig5.26", "fig5.27", "fig5.29", "near-aligned"]
    assert [e.item for e in PAPERS["lee"] if e.item in EXPERIMENTS] == list(EXPERIMENTS)


def test_the_numbers_of_the_printed_example_come_out():
    found = judged("fig5.26")
    assert found["fig5.26-zero"].measured == pytest.approx(8.9082418, abs=1e-7)
    assert found["fig5.26-delta"].measured == pytest.approx(1.2844478, abs=1e-7)
    assert {v.verdict for v in found.values()} == {"reproduced"}


def test_the_prevention_holds_in_line_but_equality_seldom_does():
    found = judged("fig5.27")
    assert found["fig5.27-equality"].verdict == "not reproduced"
    assert {v.verdict for k, v in found.items() if k != "fig5.27-equality"} == {"reproduced"}


@pytest.mark.statistics
def test_escapes_are_judged_by_goal_and_clearance():
    found = judged("fig5.29")
    distances = {k: found[f"fig5.29-outside-{k}"].measured for k in ("0.2", "0.5")}
    assert distances == {"0.2": pytest.approx(0.5079, abs=1e-4), "0.5": pytest.approx(0.6396, abs=1e-4)}
    verdicts = {k.removeprefix("fig5."): v.verdict == "reproduced" for k, v in found.items()}
    assert verdicts == {
        "29-inside-0": True,
        "29-inside-0.2": True,
        "29-inside-0.5": True,
        "29-outside-0": False,
        "29-outside-0.2": True,
        "29-outside-0.5": False,
        "29-inside-safe": verdicts["29-inside-safe"],  # about 2 of 100 collide: the small form may miss them
        "29-inside-shortest": True,
        "29-outside-safe": False,
        "29-outside-shortest": True,
        "30-distances": True,
        "30-ranges": True,
        "30-csc": False,
        "30-maximum": False,
    }


@pytest.mark.statistics
def test_robots_nearly_in_line_collide_by_equalities_as_often_as_without_prevention():
    found = judged("near-aligned", Size(2, 60, quick=True))
    assert found["near-equal"].verdict != "reproduced"
    assert found["near-gain"].measured == pytest.approx(0.0, abs=0.02)
    assert found["near-tolerances-inside"].verdict != "not reproduced"


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ((0.0, 0.0, 0.0), "reproduced"),
        ((0.0, 0.0, 0.1), "not decided"),  # the mean is one standard error above 0
        ((0.1, 0.1, 0.1), "not reproduced"),
        ((), "not decided"),
    ],
)
def test_what_never_happens_is_reproduced_without_exception_and_refuted_beyond_two_standard_errors(
    values: tuple[float, ...], verdict: str
):
    assert always("x", "never", PaperRow("x", math.nan, values), 0.0).verdict == verdict


def test_rows_beyond_the_obstacle_are_curves_of_their_own():
    experiment = EXPERIMENTS["fig5.26"]
    table = experiment.compute(Size(1, 5), lambda specs: [experiment.trial(s) for s in specs])
    assert find(table, "total force", 9.0) is not None
    assert find(table, "total force", 7.0) is None
    assert find(table, "total force, beyond the obstacle", 7.0) is not None
