"""A target that moves more irregularly than the motion of a method states is reported; walking and standing is not."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.track._metric_rooms import Recording, record
from occlog.consistency.estimates import covariances
from occlog.consistency.labels import MAX_MOTION_FACTOR
from occlog.core.metrics.errors import normalised_squared_errors
from occlog.records.tables import Tracks
from occlog.records.verdicts import Check, findings
from occlog.scans.label_continuity import LabelContinuity
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import label_continuity, track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.run import TrackSummary

pytestmark = pytest.mark.jit


def followed(made: Recording, method: str, **settings: float) -> tuple[float, Check | None]:
    """Mean NEES, and what is found of the motion."""
    config = configure(settings_of(method).in_unit("m"), settings)
    parts = list(track([made.bearings], made.scene, TrackingTask(config, 0, method=method)))
    tracks, summary = Tracks.concat(p.tracks for p in parts), TrackSummary(made.scene, joint=False)
    for part in parts:
        summary.add(part)
    away = np.column_stack([tracks.x, tracks.y]) - made.xy[np.searchsorted(made.t_ns, tracks.t_ns)]
    reported = [check for check in findings(summary.checks()) if check.id == "process-noise-small"]
    return float(normalised_squared_errors(away, covariances(tracks)).mean()), reported[0] if reported else None


@pytest.mark.parametrize(
    ("method", "cameras"),
    [
        ("ekf", 2),
        *(
            pytest.param(*case, marks=pytest.mark.statistics)
            for case in (("ekf", 4), ("ukf", 4), ("iekf", 2), ("joint", 2))
        ),
    ],
)
def test_a_zig_zag_makes_the_verdict_of_gaussian_filters_fail(method: str, cameras: int) -> None:
    _, reported = followed(record("zig-zag", cameras, seed=810), method)
    assert reported is not None
    assert reported.severity == "warning"
    assert "rms_speed" in reported.text


@pytest.mark.statistics
def test_it_is_a_note_of_apf_and_a_warning_of_smoothed_tracks_and_the_remedy_helps() -> None:
    made = record("zig-zag", 2, seed=812)
    nees, reported = followed(made, "apf")
    assert nees < 4.0
    assert reported is not None
    assert reported.severity == "note"
    _, smoothed = followed(made, "apf", smooth=True)
    assert smoothed is not None
    assert smoothed.severity == "warning"
    nees, reported = followed(made, "apf", smooth=True, process_noise_velocity=2.0)
    assert nees < 3.0
    assert reported is None


@pytest.mark.statistics
def test_clean_motions_are_far_below_the_limit() -> None:
    """15 recordings; over 600 others (docs/explanation/believe.md) the largest factor is 1.19."""
    config = configure(settings_of("ekf").in_unit("m"), {})
    for seed in range(5):
        for motion in ("walk", "stop-and-go", "still"):
            made = record(motion, 2 + seed % 4, miss=(0.05, 0.15, 0.3)[seed % 3], seed=820 + seed)
            labels: LabelContinuity = label_continuity(made.scene, TrackingTask(config, 0, method="ekf"), repair=True)
            list(labels.watch([made.bearings]))
            assert labels.events.motion[0] < 0.9 * MAX_MOTION_FACTOR
