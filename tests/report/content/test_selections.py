"""Selections of cameras, in pieces and as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import run

from occlog.records.tables import Diagnostics, Errors, TableBuffer, Tracks, in_step
from occlog.report.content.coverage import SelectionStreams
from occlog.report.content.model import ReportInput


def made() -> ReportInput:
    """Two targets for which other cameras are selected now and then, a third without."""
    data, random = run(steps=300, targets=3), np.random.default_rng(9)
    assert data.diagnostics is not None
    n = len(data.diagnostics)
    now = (random.random(n) < 0.1) & (data.diagnostics.target_id < 2)
    names = random.choice(["camera 1", "camera 2,camera 4", "camera 1,camera 3"], n)
    table = replace(data.diagnostics, predicted_mse=np.where(now, random.uniform(1, 4, n), np.nan), selected=names)
    return replace(data, diagnostics=table)


@pytest.mark.parametrize("rows", [1, 31, 10**6])
@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize("kind", [Errors, Tracks])
def test_selections_are_the_same_in_chunks_of_any_length(
    rows: int, every: int, kind: type[Errors] | type[Tracks]
) -> None:
    data = made()
    table, beside = data.diagnostics, data.errors if kind is Errors else data.tracks
    assert table is not None
    assert beside is not None
    chunks = [table.take(slice(s, s + rows)) for s in range(0, len(table), rows)]
    streams = SelectionStreams(every)
    for chunk in chunks:
        streams.add(chunk)
    assert streams.any
    ours, its = TableBuffer(chunks, Diagnostics), TableBuffer[Errors | Tracks]([beside], kind)
    for limits in in_step((ours, its), (0, 0)):
        streams.came_out(limits.of(ours), limits.of(its))
    found = streams.finish()
    assert list(found) == [0, 1]
    for target, own in found.items():
        mine = table.take(table.target_id == target)
        now = np.isfinite(mine.predicted_mse)
        times, chosen = np.append(mine.t_ns[now], mine.t_ns[-1]), [set(c.split(",")) for c in mine.selected[now]]
        expected = np.sqrt(mine.predicted_mse[now])
        its = beside.take((beside.target_id == target) & np.isin(beside.t_ns, mine.t_ns[now]))
        came = np.mean(its.error**2) if isinstance(its, Errors) else np.mean(its.cov_xx + its.cov_yy)
        assert own.count == len(chosen)
        assert own.expected == pytest.approx(np.sqrt(np.mean(expected**2)), rel=1e-12)
        np.testing.assert_array_equal(own.times, [*times[:-1:every], times[-1]])
        assert own.chosen == tuple(chosen[::every])
        assert own.what == ("error" if kind is Errors else "stated spread")
        assert own.found == pytest.approx(np.sqrt(came), rel=1e-12)
        for name in ("camera 1", "camera 2", "camera 3", "camera 4"):
            on = np.array([name in cameras for cameras in chosen])
            assert own.shares[name] == pytest.approx(np.diff(times)[on].sum() / (times[-1] - times[0]), rel=1e-12)
