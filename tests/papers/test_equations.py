"""The printed equations of three papers: what is computed agrees with what is known, and the verdicts follow."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.papers.catalogue import SOURCES
from occlog.papers.ercan.formulas import equations as ercan
from occlog.papers.ercan.formulas.blocking import independent
from occlog.papers.lee import equations as lee
from occlog.papers.rahimi import equations as rahimi
from occlog.papers.verdicts import Experiment, Size, find, source_of

NOT, DONE = "not reproduced", "reproduced"


def words(experiment: Experiment, size: Size) -> dict[str, str]:
    """Verdict of each statement."""
    return {x.id: x.verdict for x in experiment.judge(experiment.compute(size, lambda specs: [{} for _ in specs]))}


def test_lee_slips_are_found_and_right_equations_hold() -> None:
    found = words(lee.EQUATIONS, Size(1, 1))
    assert set(found) == set(lee.STATEMENTS)
    right = {"eq3.12", "eq2.15", "eq2.36", "eq4.4", "sec2.2.2-phi", "sec2.2.2-theta"}
    assert {key for key, word in found.items() if word == DONE} == right
    assert {word for key, word in found.items() if key not in right} == {NOT}


def test_lee_information_from_nothing_has_an_inverse_with_the_right_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    assert lee._least_information() < 1e-13
    monkeypatch.setattr(lee, "_propagator", lambda a, velocity, step: np.array([[1.0, step], [0.0, 1.0]]))
    assert lee._least_information() > 1e-7


def test_rahimi_bearings_leave_what_the_paper_says() -> None:
    found = words(rahimi.EQUATIONS, Size(1, 50))
    assert found == dict.fromkeys(rahimi.STATEMENTS, DONE) | {"eq1": NOT, "eq3": NOT, "sec5-sparse": NOT}


@pytest.mark.parametrize(("speed", "cameras", "left"), [(False, 1, 1), (True, 1, 0), (False, 2, 0), (True, 2, 0)])
def test_rahimi_open_dimensions(speed: bool, cameras: int, left: int) -> None:
    positions = np.array([[0.0, 0.0], [6.0, 0.0]])[:cameras]
    assert rahimi.open_dimensions(positions, np.array([1.0, 3.0]), np.array([0.2, 0.05]), speed=speed) == left
    # Along one bearing neither place nor velocity is known but in direction
    assert rahimi.open_dimensions(positions[:1], np.array([1.0, 3.0]), np.array([0.1, 0.3]), speed=False) == 2


@pytest.fixture(scope="module")
def ercan_table() -> list[ercan.PaperRow]:
    return ercan.equations(Size(4, 12), lambda specs: [{} for _ in specs])


def test_every_statement_has_its_place(ercan_table: list[ercan.PaperRow]) -> None:
    ids = {"lee": lee.STATEMENTS, "rahimi": rahimi.STATEMENTS, "ercan": [x.id for x in ercan.judge(ercan_table)]}
    for paper, keys in ids.items():
        assert [key for key in keys if source_of(key, SOURCES[paper]) is None] == []


def test_ercan_noise_and_cameras(ercan_table: list[ercan.PaperRow]) -> None:
    found = {x.id: x for x in ercan.judge(ercan_table)}
    assert (found["eq2"].verdict, found["appendix-b"].verdict) == (DONE, NOT)
    assert found["sec6.1-vertices"].verdict == DONE
    vertices, edges = find(ercan_table, ercan.VERTICES), find(ercan_table, ercan.EDGES)
    assert vertices is not None
    assert edges is not None
    assert vertices.mean == 1.0
    assert edges.mean == pytest.approx(0.75, abs=0.2)  # four edges with half a square less two corners


def test_ercan_probabilities_are_probabilities() -> None:
    q = np.random.default_rng(0).uniform(0.0, 0.2, (5, 3, 4))
    together = independent(q)
    np.testing.assert_allclose(together.sum(axis=1), 1.0)
    np.testing.assert_allclose(together[:, 7], np.prod(1.0 - q, axis=(1, 2)))
    np.testing.assert_allclose(together[:, 0], np.prod(1.0 - np.prod(1.0 - q, axis=2), axis=1))
