"""[Lee] 5.2.3, readers: printed numbers, and errors of an independent implementation."""

from __future__ import annotations

import pytest

from occlog.papers import verdicts as v
from occlog.papers.lee.readers import READER_EXPERIMENTS, SETTINGS, name_of
from occlog.papers.verdicts import Size

COUNTS, ERRORS = READER_EXPERIMENTS


def test_printed_numbers_of_virtual_sensors_come_out() -> None:
    found = {x.id: x for x in COUNTS.judge(COUNTS.compute(Size(1, 1), lambda _: []))}
    assert found["virtual-three"].measured == 7
    assert found["virtual-twelve"].measured == 78
    assert found["virtual-bound"].verdict == "reproduced"


def test_errors_of_coarse_positions_are_those_of_an_independent_implementation() -> None:
    table = ERRORS.compute(Size(3, 500), lambda _: [])
    for (readers, reach), rms in zip(SETTINGS, (0.90, 0.63, 0.61, 0.46), strict=True):
        row = v.find(table, name_of("coarse RMS", reach), float(readers))
        assert row is not None
        assert row.mean == pytest.approx(rms, abs=3.0 * row.error + 0.01)
    found = {x.id: x.verdict for x in ERRORS.judge(table)}
    assert found["readers-closer"] == "reproduced"
    assert found["refine-5.39"] == "reproduced"
    assert found["refine-readers"] == "not reproduced"
