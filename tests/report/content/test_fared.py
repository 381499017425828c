"""How the filter fared, in pieces and as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import run

from occlog.records.tables import Diagnostics
from occlog.report.content.accuracy import MARKS, FilterDiagnosticsStreams


def made() -> Diagnostics:
    table, random = run(steps=900, targets=2).diagnostics, np.random.default_rng(2)
    assert table is not None
    flags = random.choice(["", "sir", "restart", "gap"], len(table), p=[0.3, 0.65, 0.04, 0.01])
    doubts = random.choice(["", "walls", "walls,late"], len(table), p=[0.9, 0.05, 0.05])
    return replace(table, fallback=flags, quality_flags=doubts)


@pytest.mark.parametrize("rows", [1, 50, 10**6])
@pytest.mark.parametrize("in_memory", [0, 10**5])
def test_figures_are_the_same_in_chunks_of_any_length(rows: int, in_memory: int) -> None:
    table = made()
    streams = FilterDiagnosticsStreams(in_memory)
    for start in range(0, len(table), rows):
        streams.add(table.take(slice(start, start + rows)))
    found = streams.finish()
    assert (found.rows, found.lowest) == (len(table), table.ess.min())
    assert found.particles
    assert found.doubtful == np.count_nonzero(table.quality_flags != "")
    assert found.doubts == ("late", "walls")
    assert list(found.fallbacks) == ["gap", "restart", "sir"]
    for kind, own in found.fallbacks.items():
        times = table.t_ns[table.fallback == kind]
        assert own.rows == len(times)
        np.testing.assert_array_equal(own.t_ns, times[:: -(-len(times) // MARKS)])
    assert found.fallbacks["sir"].rows > MARKS


def test_nothing_says_nothing() -> None:
    found = FilterDiagnosticsStreams().finish()
    assert (found.rows, found.particles, dict(found.fallbacks), found.doubtful) == (0, False, {}, 0)
