"""Ranges that meet only with a common factor, or with a station elsewhere, are named; right ones are not."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.consistency.range_readings import RangeReadings
from occlog.filtering.likelihood.distances import RANGE, RangeMeasurements
from occlog.records.verdicts import findings
from occlog.scans.grouping import ScanMeasurements

NS = 1_000_000_000
CORNERS = np.array([[0.0, 0.0], [20.0, 0.0], [18.0, 16.0], [2.0, 15.0]])
NAMES = ("s0", "s1", "s2", "s3")


def read(change: Floats | None = None, factor: float = 1.0, stations: int = 4, sigma: float = 0.1) -> RangeReadings:
    """Ranges of a walk on an ellipse, with offsets of the stated positions (S, 2) and ranges times a factor."""
    rng = np.random.default_rng(11)
    out = RangeReadings(NAMES)
    stated = CORNERS[:stations] + (0.0 if change is None else change[:stations])
    for n in range(150):
        xy = np.array([10.0, 8.0]) + np.array([6.0, 5.0]) * [np.cos(0.05 * n), np.sin(0.05 * n)]
        z = factor * (np.hypot(*(xy - CORNERS[:stations]).T) + sigma * rng.standard_normal(stations))
        zero, own = np.zeros(stations), np.arange(stations)
        rows = RangeMeasurements(np.full(stations, RANGE), z, np.full(stations, sigma), stated, zero, stated, zero, own)
        out.add([(n * NS // 2, ScanMeasurements(np.zeros(stations, dtype=np.int32), rows))])
    return out


@pytest.mark.parametrize(("factor", "words"), [(2.0, "0.5, as round trips"), (1000.0, "mm"), (0.5, "multiplied by 2")])
@pytest.mark.parametrize("stations", [3, 4])
def test_a_common_factor_is_named(factor: float, words: str, stations: int) -> None:
    (found,) = findings(read(factor=factor, stations=stations).checks("m"))
    assert found.id == "ranges-fit-if"
    assert words in found.text


def test_a_station_at_another_position_is_named() -> None:
    (found,) = findings(read(np.array([[0.0, 0.0], [0.0, 0.0], [-1.0, 3.0], [0.0, 0.0]])).checks("m"))
    x, y = (float(each.strip("(,) m")) for each in found.text.split("s2 is moved by ")[1].split(" m;")[0].split())
    assert np.hypot(x - 1.0, y + 3.0) < 0.1


def test_right_ranges_and_those_of_large_noise_are_not_named() -> None:
    for sigma in (0.01, 0.1, 1.0):
        assert findings(read(sigma=sigma).checks("m")) == ()
        assert read(sigma=sigma).one_station() is None
    assert findings(read(factor=1.1).checks("m")) == ()
    # Two stations always meet
    assert [check.status for check in read(factor=2.0, stations=2).checks("m")] == ["not applicable"]
