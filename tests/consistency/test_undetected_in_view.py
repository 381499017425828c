"""A target that no camera detects in plain view is doubtful, for every method; chance misses are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.track._metric_rooms import Recording, record
from occlog.records.tables import Bearings, Diagnostics
from occlog.records.verdicts import findings
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.run import TrackSummary

pytestmark = pytest.mark.jit
NS = 1_000_000_000


def followed(made: Recording, bearings: Bearings, method: str) -> tuple[Diagnostics, set[str]]:
    """Diagnostics, and what was found."""
    config = configure(settings_of(method).in_unit("m"), {})
    parts = list(track([bearings], made.scene, TrackingTask(config, 0, method=method)))
    summary = TrackSummary(made.scene, joint=False)
    for part in parts:
        summary.add(part)
    return Diagnostics.concat(p.diagnostics for p in parts), {check.id for check in findings(summary.checks())}


def unseen(bearings: Bearings, begin_s: float, end_s: float) -> Bearings:
    """All cameras look and do not detect for a while."""
    late = (bearings.t_ns - bearings.t_ns[0]) / NS
    seen = bearings.seen & ~((late >= begin_s) & (late < end_s))
    columns = {
        name: np.where(seen, getattr(bearings, name), np.nan) for name in ("bearing", "sigma", "u_px", "sigma_px")
    }
    return replace(bearings, seen=seen, **columns)


@pytest.mark.parametrize("method", ["apf", "ekf", pytest.param("joint", marks=pytest.mark.statistics)])
def test_four_seconds_without_a_detection_in_plain_view_are_reported(method: str) -> None:
    made = record("walk", 4, seed=500)
    notes, reported = followed(made, unseen(made.bearings, 20.0, 24.0), method)
    assert "undetected-in-view" in reported
    flagged = np.char.find(notes.quality_flags, "undetected_in_view") >= 0
    late = (notes.t_ns - notes.t_ns[0]) / NS
    assert flagged[(late >= 22.0) & (late < 24.0)].mean() > 0.9
    assert not flagged[(late < 20.0) | (late >= 25.0)].any()


@pytest.mark.parametrize("recordings", [4, pytest.param(20, marks=pytest.mark.statistics)])
def test_misses_by_chance_are_not(recordings: int) -> None:
    """Half of all frames, two or four cameras: no recording has so improbable a row."""
    for seed in range(recordings):
        made = record("walk", 2 if seed % 2 else 4, miss=0.5, seed=600 + seed)
        notes, reported = followed(made, made.bearings, "ekf")
        assert not (np.char.find(notes.quality_flags, "undetected_in_view") >= 0).any()
        assert "undetected-in-view" not in reported
