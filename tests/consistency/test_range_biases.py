"""Stations with ranges that are too long are named with the size of their error; right ones are not."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.track.ranges import Recording, record
from occlog.array_types import Floats
from occlog.consistency.range_biases import RangeBiases
from occlog.filtering.likelihood.distances import RANGE, RangeMeasurements
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Scene
from occlog.records.tables import Tracks
from occlog.records.verdicts import Check, findings
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import DistanceMeasurementFeed
from occlog.scans.grouping import ScanMeasurements
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.run import TrackSummary

NS = 1_000_000_000
SIGMA = 0.1
CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])
NAMES = ("s0", "s1", "s2", "s3")


def collected(seed: int, bias: Floats, stations: int = 4, radius: float = 2.5) -> RangeBiases:
    """Ranges of 40 s at 5 Hz on a circle, 30 % missed, at estimates with an error that changes slowly."""
    rng = np.random.default_rng([8300, seed])
    seconds = np.arange(200) / 5.0
    angle = 2.0 * np.pi * seconds / 25.0
    centre = np.array([5.0, 4.0]) if radius else np.array([3.0, 2.6])
    path = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    estimates = path + np.cumsum(rng.standard_normal((200, 2)), axis=0) * 0.005
    t_ns, nothing = np.round(seconds * NS).astype(np.int64), np.full(200, 0.01)
    tracks = Tracks.of(
        t_ns=t_ns, target_id=np.zeros(200, dtype=np.int32), x=estimates[:, 0], y=estimates[:, 1],
        vx=nothing, vy=nothing, cov_xx=nothing, cov_xy=0.0 * nothing, cov_yy=nothing,
    )  # fmt: skip
    measured = []
    for t, xy in zip(t_ns.tolist(), path, strict=True):
        own = np.flatnonzero(rng.random(stations) > 0.3)
        if not len(own):
            continue
        at, zero = CORNERS[own], np.zeros(len(own))
        z = np.hypot(*(xy - at).T) + bias[own] + SIGMA * rng.standard_normal(len(own))
        kind, sigma = np.full(len(own), RANGE), np.full(len(own), SIGMA)
        rows = RangeMeasurements(kind, z, sigma, at, zero, at, zero, own)
        measured.append((t, ScanMeasurements(np.zeros(len(own), dtype=np.int32), rows)))
    found = RangeBiases(Scene(), NAMES)
    found.add(tracks, (), measured)
    return found


def test_sizes_are_right_within_their_errors() -> None:
    """10 recordings each of one station and of all with an error: the mean is within 4 of its standard errors."""
    for bias in (np.array([0.0, 0.5, 0.0, 0.0]), np.full(4, 0.6)):
        away = []
        for seed in range(10):
            found = collected(seed, bias).found()
            assert [one.station for one in found] == [NAMES[s] for s in np.flatnonzero(bias)]
            away += [(one.size - bias[NAMES.index(one.station)]) / one.error for one in found]
        assert abs(np.mean(away)) < 4.0 / np.sqrt(10)
        assert 0.5 < np.std(away) < 1.6


def test_a_target_that_stands_does_not_hide_the_station() -> None:
    """The errors of all four are not determined then, but one that is too long explains all residuals."""
    for seed in range(5):
        found = collected(seed, np.array([0.0, 0.3, 0.0, 0.0]), radius=0.0).found()
        assert len(found) == 1
        assert "s1" in (found[0].station, *found[0].rivals)
        assert found[0].station != "s1" or abs(found[0].size - 0.3) < 5.0 * found[0].error


@pytest.mark.statistics
@pytest.mark.parametrize("radius", [0.0, 2.5])
def test_ranges_without_an_error_are_not_named(radius: float) -> None:
    """20 recordings of four stations."""
    assert not any(collected(seed, np.zeros(4), radius=radius).found() for seed in range(20))


def test_two_stations_leave_nothing_to_be_found() -> None:
    """Two circles always meet."""
    for radius in (0.0, 2.5):
        assert not any(collected(seed, np.full(4, 0.5), stations=2, radius=radius).found() for seed in range(10))


def said_of(made: Recording, table: Measurements, method: str, range_bias: float = 0.0) -> list[Check]:
    """Findings of errors of ranges."""
    config = configure(settings_of(method).in_unit("m"), {})
    feed = DistanceMeasurementFeed([table], made.scene, DistanceMeasurementConfig(range_bias=range_bias))
    summary = TrackSummary(made.scene, joint=False, measured=feed)
    for part in track([], made.scene, TrackingTask(config, 0, method=method), None, feed):
        summary.add(part)
    if range_bias:
        own = summary.figures()["range_biases"]["0"]["s1"]
        assert abs(own["bias"] - 0.8) < 4.0 * own["standard_error"]
    return [check for check in findings(summary.checks()) if check.id == "range-bias"]


@pytest.mark.jit
@pytest.mark.parametrize(
    "method", ["ekf", *(pytest.param(name, marks=pytest.mark.statistics) for name in ("apf", "fix", "map"))]
)
def test_every_method_names_the_station(method: str) -> None:
    made = record("range", 0.1, seed=8301)
    assert not said_of(made, made.table, method)
    columns = {c.name: getattr(made.table, c.name) for c in Measurements.columns()}
    columns["range"] = columns["range"] + np.where(made.table.sensor == "s1", 0.8, 0.0)
    (message,) = said_of(made, Measurements(**columns), method)
    assert message.sensors == ("s1",)
    assert abs(message.figures["size"] - 0.8) < 0.25
    if method == "map":
        assert not said_of(made, Measurements(**columns), method, range_bias=2.0)
