"""Evidence that is gathered in stretches of time is that of whole tables."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import pytest
from bearing_scenes import CASES, Case

from occlog.consistency.sight import whole
from occlog.consistency.verdict import Evidence
from occlog.errors import InputError
from occlog.evaluate.stretches.evidence import SightStreams, in_rows_of
from occlog.evaluate.verdict import Made, used
from occlog.records.columns import Table
from occlog.records.pieces import Side, in_step
from occlog.records.tables import Bearings, Diagnostics, Tracks

T = TypeVar("T", bound=Table)


def chunks(table: T, rows: int) -> list[T]:
    return [table.take(slice(start, start + rows)) for start in range(0, len(table), rows)]


def streamed(case: Case, made: Made, rows: int, *, fared: bool) -> Evidence:
    """Evidence of chunks of so many rows."""
    evidence = Evidence(rows=len(case.tracks))
    streams = SightStreams(evidence, case.place, made, (), in_memory=10)
    tracks, bearings = Side(chunks(case.tracks, rows), Tracks), Side(chunks(case.bearings, rows + 1), Bearings)
    said = Side(in_rows_of(chunks(case.tracks, rows), chunks(case.diagnostics, 5)), Diagnostics) if fared else None
    sides = (tracks, bearings, *(() if said is None else (said,)))
    for limits in in_step(sides, [streams.margin_ns] * len(sides)):
        streams.add(limits, tracks, bearings, said)
    streams.finish()
    return evidence


@pytest.mark.parametrize("what", CASES)
@pytest.mark.parametrize("rows", [1, 13, 10**6])
@pytest.mark.parametrize("window_ns", [0, 40_000_000, 700_000_000])
@pytest.mark.parametrize("fared", [False, True])
def test_evidence_is_that_of_whole_tables(what: str, rows: int, window_ns: int, fared: bool) -> None:
    case, made = CASES[what](6), Made(window_ns=window_ns, sensors=frozenset({"a", "b", "c", "ear"}))
    one = Evidence(rows=len(case.tracks))
    mine = used(case.bearings, made, ())
    compared = whole(case.tracks, mine, case.place, case.diagnostics if fared else None, window_ns)
    one.saw(case.tracks, compared, case.place)
    many = streamed(case, made, rows, fared=fared)
    assert one.alone.bearings > 20
    assert many.alone == one.alone
    assert many.crowd == one.crowd
    assert many.places == one.places
    assert set(many.agreements.sensors) == set(one.agreements.sensors)
    for name, own in one.agreements.sensors.items():
        again = many.agreements.sensors[name]
        assert (again.bearings, again.believed) == (own.bearings, own.believed)
        assert tuple(again.nis) == pytest.approx(tuple(own.nis), rel=1e-9, nan_ok=True)
        assert again.pose == pytest.approx(own.pose, rel=1e-9)
    if what == "simulated":
        assert any(own.pose > 0.0 for own in one.agreements.sensors.values())
        assert one.crowd.frames == 0 or np.isfinite(one.crowd.unexplained)


def test_fewer_diagnostics_than_tracks_are_refused() -> None:
    case = CASES["simulated"](1)
    with pytest.raises(InputError, match="fewer rows"):
        list(in_rows_of([case.tracks], [case.diagnostics.take(slice(1, None))]))
