"""False bearings: covariances hold them, and `fix` is given none that contradict the motion if it is asked for."""

from __future__ import annotations

from functools import cache

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
SEEDS = range(700, 703)


@cache
def followed(
    method: str, seed: int, false: float, *, reject: bool, **settings: float
) -> tuple[float, float, set[str], Tracks]:
    """Mean NEES, RMSE, what was found, and the tracks."""
    made = record("walk", 4, false=false, seed=seed)
    config = configure(settings_of(method).in_unit("m"), settings)
    task = TrackingTask(config, 0, method=method, reject_outliers=reject)
    parts, summary = list(track([made.bearings], made.scene, task)), TrackSummary(made.scene, joint=False)
    for part in parts:
        summary.add(part)
    tracks = Tracks.concat(p.tracks for p in parts)
    away = np.column_stack([tracks.x, tracks.y]) - made.xy[np.searchsorted(made.t_ns, tracks.t_ns)]
    nees = normalised_squared_errors(away, covariances(tracks))
    return (
        float(nees.mean()),
        float(np.sqrt(np.mean(away**2) * 2.0)),
        {f.id for f in findings(summary.checks())},
        tracks,
    )


def test_ten_percent_false_bearings_are_left_out_and_stated() -> None:
    found = [followed("fix", seed, 0.1, reject=True) for seed in SEEDS]
    errors = [error for _, error, _, _ in found]
    given = [followed("fix", seed, 0.1, reject=False)[1] for seed in SEEDS]
    assert all("outliers" in reported for _, _, reported, _ in found)
    assert np.median(errors) < 0.6 * np.median(given)


@pytest.mark.parametrize(
    "method", ["ekf", *(pytest.param(name, marks=pytest.mark.statistics) for name in ("ukf", "iekf")), "fix"]
)
def test_covariances_hold_ten_percent_of_false_bearings(method: str) -> None:
    """Medians of 3 recordings; of 15 others they are 1.7 to 2.4, and single ones of `fix` in the hundreds."""
    nees = [followed(method, seed, 0.1, reject=False)[0] for seed in SEEDS]
    assert 1.0 < np.median(nees) < (6.0 if method == "fix" else 2.6)


@pytest.mark.parametrize("method", ["ekf", pytest.param("ukf", marks=pytest.mark.statistics)])
def test_hypotheses_halve_the_error_of_a_filter_with_a_gate_alone(method: str) -> None:
    """Ratios of other recordings are 0.2 to 0.4, and NEES of a gate alone 20 and more."""
    mixed, gated = (
        [followed(method, seed, 0.1, reject=False, false_bearing_probability=p) for seed in SEEDS] for p in (0.01, 0.0)
    )
    assert np.median([error for _, error, _, _ in mixed]) < 0.6 * np.median([error for _, error, _, _ in gated])
    assert np.median([nees for nees, _, _, _ in gated]) > 4.0


@pytest.mark.parametrize("method", ["ekf", "fix"])
def test_nothing_is_left_out_or_stated_of_true_bearings(method: str) -> None:
    for seed in SEEDS if method == "fix" else SEEDS[:1]:
        _, _, reported, tracks = followed(method, seed, 0.0, reject=True)
        _, _, _, same = followed(method, seed, 0.0, reject=False)
        assert "outliers" not in reported
        # A bearing in 10,000 is beyond the gate by chance
        assert np.mean((tracks.x == same.x[: len(tracks)]) if len(tracks) == len(same) else 0.0) > 0.9
