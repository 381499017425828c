"""Labels that two targets exchange: every method says so, and is as good as with right labels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.track._metric_rooms import record
from occlog.records.tables import Bearings, Diagnostics, Tracks
from occlog.records.verdicts import findings
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.run import TrackSummary

pytestmark = pytest.mark.jit
NS = 1_000_000_000


@pytest.mark.parametrize(
    "method", ["apf", "ekf", *(pytest.param(name, marks=pytest.mark.statistics) for name in ("map", "fix", "joint"))]
)
def test_exchanged_labels_are_reported_flagged_and_repaired(method: str) -> None:
    one, other = (record("walk", 4, seed=s) for s in (304, 1304))
    second = replace(other.bearings, target_id=np.ones(len(other.bearings), dtype=np.int32))
    bearings = Bearings.merge([one.bearings, second])
    begin = int(bearings.t_ns[0]) + 10 * NS
    rows = (bearings.t_ns >= begin) & (bearings.t_ns < begin + 3 * NS)
    given = Bearings.merge([replace(bearings, target_id=np.where(rows, 1 - bearings.target_id, bearings.target_id))])
    config = configure(settings_of(method).in_unit("m"), {})
    rmse = {}
    for repair in (True, False) if method == "ekf" else (True,):
        task = TrackingTask(config, 0, method=method, repair_labels=repair)
        parts = list(track([given], one.scene, task))
        tracks, notes = Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)
        summary = TrackSummary(one.scene, joint=False)
        for part in parts:
            summary.add(part)
        reported = next(check for check in findings(summary.checks()) if check.id == "labels-exchanged")
        assert reported.targets == (0, 1)
        assert reported.figures["begin_s"] == pytest.approx(10.0)
        flagged = np.char.find(notes.quality_flags, "exchanged_labels") >= 0
        np.testing.assert_array_equal(flagged, (notes.t_ns >= begin) & (notes.t_ns < begin + 3 * NS))
        truth = np.array([one.xy, other.xy])[tracks.target_id, np.searchsorted(one.t_ns, tracks.t_ns)]
        off = np.hypot(*(np.column_stack([tracks.x, tracks.y]) - truth).T)
        rmse[repair] = float(np.sqrt(np.mean(off**2)))
    assert rmse[True] < 0.3
    assert method != "ekf" or rmse[False] > 3.0 * rmse[True]
