"""Errors of whole tracks that are far from those of whom the tracks are on."""

from __future__ import annotations

import math

import pytest

from occlog.evaluate.mot.apart import errors_apart, line_of_errors_apart
from occlog.evaluate.text import summary_lines


def figures(whole: float, recall: float = 0.98) -> dict[str, float]:
    return {"rmse_m": whole, "pairs_rmse_m": 0.5, "recall": recall, "id_switches": 3.0}


@pytest.mark.parametrize(("whole", "said"), [(1.0, False), (1.01, True), (math.nan, False)])
def test_it_is_said_from_twice_the_error_of_the_pairs_on(whole: float, said: bool) -> None:
    assert errors_apart(figures(whole), "m") is said
    assert bool(line_of_errors_apart(figures(whole), "m", "id")) is said
    assert (summary_lines(figures(whole), "m")[0] == "errors") is not said


def test_without_pairs_nothing_is_said() -> None:
    assert not line_of_errors_apart({"rmse_m": 3.0}, "m", "id")


def test_pairs_are_to_be_read_where_most_true_positions_are_met() -> None:
    (line,) = line_of_errors_apart(figures(1.5), "m", "optimal")
    assert "RMSE of 1.5 m holds each track to one target for all its time (match optimal)" in line
    assert "98% of the true positions are met: read the pairs" in line
    assert "identity switches (3)" in line
    (line,) = line_of_errors_apart(figures(1.5, recall=0.49), "m", "optimal")
    assert line.endswith("only 49% of the true positions are met: read the first")
    assert summary_lines(figures(1.5), "m")[0] == "errors, each track held to one target for all its time"
