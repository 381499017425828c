"""Motions that `map` does not expect: covariances hold, or the verdict says that the motion is livelier than stated."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.track._metric_rooms import Recording, record
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


def followed(made: Recording, **settings: float) -> tuple[float, set[str]]:
    """Mean NEES of `map`, and what its verdict warns of."""
    config = configure(settings_of("map").in_unit("m"), settings)
    parts = list(track([made.bearings], made.scene, TrackingTask(config, 0, method="map")))
    tracks, summary = Tracks.concat(p.tracks for p in parts), TrackSummary(made.scene, joint=False)
    for part in parts:
        summary.add(part)
    away = np.column_stack([tracks.x, tracks.y]) - made.xy[np.searchsorted(made.t_ns, tracks.t_ns)]
    nees = normalised_squared_errors(away, covariances(tracks))
    return float(nees.mean()), {f.id for f in findings(summary.checks()) if f.severity == "warning"}


@pytest.mark.parametrize("false", [0.0, pytest.param(0.1, marks=pytest.mark.statistics)])
def test_a_zig_zag_that_one_camera_at_a_time_sees_is_reported_to_be_livelier_than_stated(false: float) -> None:
    """Covariances are too small by a factor of up to three there, and more with false bearings."""
    made = record("zig-zag", 4, false=false, miss=0.0, asynchronous=True, seed=101)
    nees, reported = followed(made)
    assert nees < 6.0
    assert "process-noise-small" in reported


@pytest.mark.statistics
@pytest.mark.parametrize("motion", ["walk", "zig-zag"])
def test_an_acceleration_that_is_stated_too_small_is_found_out_or_stated(motion: str) -> None:
    nees, reported = followed(record(motion, 4, seed=100), process_noise_velocity=0.3)
    assert nees < 3.0 or "process-noise-small" in reported


def test_walking_as_expected_is_plausible() -> None:
    nees, reported = followed(record("walk", 4, seed=100))
    assert nees < 3.0
    assert not reported
