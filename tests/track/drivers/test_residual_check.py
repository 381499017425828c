"""What residuals contradict, at the limits and just beyond."""

from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.records.tables import Residuals
from occlog.track.drivers.residual_check import LARGE, LEAST, LIVELY, MANY, SMALL, Agreement, ResidualCheck
from occlog.track.drivers.rows import Solve
from occlog.track.interface import Noise


def rows(n: int, doubted: int = 0, residual: float = 1.0, sensor: str = "cam1") -> Residuals:
    believed = np.ones(n)
    believed[:doubted] = 0.0
    return Residuals.of(
        t_ns=np.arange(n),
        target_id=np.zeros(n, dtype=np.int32),
        sensor=np.full(n, sensor),
        residual=np.where(believed > 0.5, residual, 50.0),
        expected=np.ones(n),
        believed=believed,
    )


def check(*parts: Residuals, solves=()) -> ResidualCheck:
    made = ResidualCheck()
    for part in parts:
        made.add(part, solves)
    return made


def test_no_residuals_say_nothing() -> None:
    made = ResidualCheck()
    made.add(None)
    assert made.figures() == {}
    assert made.contradictions() == []
    assert math.isnan(Agreement().doubted)
    assert math.isnan(Agreement().nis)


def test_figures_add_up_over_parts_and_sensors() -> None:
    made = check(rows(10, 2), rows(10, 0, 2.0, "cam2"), rows(5, 1))
    assert made.figures() == {"bearings": 25, "bearings_not_believed": 3, "nis": pytest.approx((12 + 40) / 22)}
    assert made.sensors["cam1"] == Agreement(15, 12, 12.0, 12.0)


def test_more_than_a_quarter_not_believed_is_said_of_the_sensor() -> None:
    n = 40
    most = round(MANY * n)
    assert check(rows(n, most)).contradictions() == []
    (said,) = check(rows(n, most + 1), rows(n, 0, sensor="cam2")).contradictions()
    assert said.startswith("cam1: 28% of 40 bearings are not believed")
    assert check(rows(LEAST - 1, LEAST - 1)).contradictions() == []
    assert check(rows(LEAST, LEAST)).contradictions()


@pytest.mark.parametrize(("nis", "factor"), [(LARGE, 1 + 1e-6), (SMALL, 1 - 1e-6)])
def test_squared_residuals_that_are_not_as_stated_are_said(nis: float, factor: float) -> None:
    assert check(rows(100, residual=math.sqrt(nis) / factor**0.5)).contradictions() == []
    (said,) = check(rows(100, residual=math.sqrt(nis * factor))).contradictions()
    assert said.startswith("residuals of all bearings: NIS")
    assert check(rows(LEAST - 1, residual=9.0)).contradictions() == []


def test_one_sensor_whose_residuals_are_too_large_is_named() -> None:
    (said,) = check(rows(300), rows(30, residual=2.0, sensor="cam7")).contradictions()
    assert said.startswith("residuals of cam7: NIS 4, so that bearings are 2.0 times as far off as stated")


def test_motion_that_is_livelier_than_stated_is_said_of_the_target() -> None:
    at = Solve(3, 5, True, Noise(1.0, LIVELY))
    beyond = Solve(4, 5, True, Noise(1.0, LIVELY * 2.25))
    (said,) = check(rows(50), solves=(at, beyond)).contradictions()
    assert said.startswith("target 4: moves 3.0 times as irregularly")
