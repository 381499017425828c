"""Methods that cannot reject false bearings themselves: those against the motion are left out, and reported."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.track._metric_rooms import record
from occlog.consistency.estimates import covariances
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.records.tables import Tracks
from occlog.records.verdicts import findings
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.run import TrackSummary

pytestmark = pytest.mark.jit
SEEDS = range(700, 708)


def followed(method: str, seed: int, false: float, *, reject: bool) -> tuple[float, set[str], Tracks]:
    """Mean NEES, what was found, and the tracks."""
    made = record("walk", 4, false=false, seed=seed)
    config = configure(settings_of(method).in_unit("m"), {})
    task = TrackingTask(config, 0, method=method, reject_outliers=reject)
    parts, summary = list(track([made.bearings], made.scene, task)), TrackSummary(made.scene, joint=False)
    for part in parts:
        summary.add(part)
    tracks = Tracks.concat(p.tracks for p in parts)
    away = np.column_stack([tracks.x, tracks.y]) - made.xy[np.searchsorted(made.t_ns, tracks.t_ns)]
    nees = normalised_squared_errors(away, covariances(tracks))
    return float(nees.mean()), {f.id for f in findings(summary.checks())}, tracks


@pytest.mark.parametrize("method", ["ekf", "fix"])
def test_ten_percent_false_bearings_are_left_out_and_said(method: str) -> None:
    found = [followed(method, seed, 0.1, reject=True) for seed in SEEDS]
    given = [followed(method, seed, 0.1, reject=False)[0] for seed in SEEDS]
    nees = [square for square, _, _ in found]
    assert all("outliers" in said for _, said, _ in found)
    assert np.median(nees) < (0.3 if method == "fix" else 1.0) * np.median(given)


@pytest.mark.parametrize("method", ["ekf", "fix"])
def test_nothing_is_left_out_or_said_of_true_bearings(method: str) -> None:
    for seed in SEEDS:
        _, said, tracks = followed(method, seed, 0.0, reject=True)
        _, _, same = followed(method, seed, 0.0, reject=False)
        assert "outliers" not in said
        # A bearing in 10,000 is beyond the gate by chance
        assert np.mean((tracks.x == same.x[: len(tracks)]) if len(tracks) == len(same) else 0.0) > 0.9
