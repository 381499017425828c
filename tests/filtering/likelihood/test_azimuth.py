"""Bearing with range: closed forms of the model, and the Kalman filters on targets of their own motion model."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from occlog.array_types import NS, Floats
from occlog.filtering.gaussian import Gaussian
from occlog.filtering.likelihood.azimuth import azimuth
from occlog.filtering.likelihood.distances import PLAIN, RANGE, RangeMeasurements, linearise
from occlog.filtering.likelihood.measurement_model import StationPositions
from occlog.filtering.motion.ornstein_uhlenbeck import OrnsteinUhlenbeck
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Scene, TagReader
from occlog.records.tables import Bearings, Tracks
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import DistanceMeasurementFeed
from occlog.settings import configure
from occlog.track.catalogue import settings_of
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.kalman.stations import extended

TARGETS, STEPS, DT = 50, 14, 0.5
SIGMA_RANGE, SIGMA_BEARING = 0.2, math.radians(1.0)


def polar(xy: tuple[float, float], far: float, angle: float) -> RangeMeasurements:
    """A range and a bearing of a station at a place."""
    position, none = np.tile(np.array(xy), (2, 1)), np.zeros(2)
    kind, sigma = np.array([RANGE, PLAIN["bearing"]]), np.array([SIGMA_RANGE, SIGMA_BEARING])
    return RangeMeasurements(
        kind, np.array([far, angle]), sigma, position, none, position, none, np.zeros(2, dtype=np.int64)
    )


def test_the_gradient_is_that_of_the_azimuth() -> None:
    rng = np.random.default_rng(0)
    place, xy = rng.normal(size=(3, 2)), rng.normal(0.0, 5.0, (4, 2))
    at = StationPositions(place, np.zeros(3), place, np.zeros(3))
    angle, gradient = azimuth(xy[:, None, :], at)
    for i in range(4):
        for m in range(3):
            away = xy[i] - place[m]
            assert angle[i, m] == pytest.approx(math.atan2(away[1], away[0]))

            def own(x: Floats, m: int = m) -> float:
                return math.atan2(x[1] - place[m, 1], x[0] - place[m, 0])

            np.testing.assert_allclose(gradient[i, m], approx_fprime(xy[i], own, 1e-7), atol=1e-5)


def test_residuals_are_wrapped() -> None:
    rows = polar((0.0, 0.0), 10.0, math.pi - 0.01)
    residual = linearise(rows, np.array([[-10.0 * math.cos(0.01), -10.0 * math.sin(0.01)]])).residual[0]
    np.testing.assert_allclose(residual, [0.0, -0.02 / SIGMA_BEARING], atol=1e-9)


def test_one_measurement_has_the_covariance_of_polar_coordinates() -> None:
    """With next to no prior: sigma_r^2 along the line of sight, r^2 sigma_theta^2 across (Bar-Shalom et al., 10.4)."""
    far, angle = 20.0, 0.7
    line = np.array([math.cos(angle), math.sin(angle)])
    prior = Gaussian(np.array([*(far * line), 0.0, 0.0]), np.diag([1e8, 1e8, 1.0, 1.0]))
    after, _ = extended(prior, polar((0.0, 0.0), far, angle))
    R = np.column_stack([line, [-line[1], line[0]]])
    expected = R @ np.diag([SIGMA_RANGE**2, (far * SIGMA_BEARING) ** 2]) @ R.T
    np.testing.assert_allclose(after.covariance[:2, :2], expected, rtol=1e-5)


@pytest.fixture(scope="module")
def simulated() -> tuple[Scene, Measurements, Floats]:
    """A scene with two radars, what they measure of targets of an Ornstein-Uhlenbeck motion, and (N, T, 2) truth."""
    rng = np.random.default_rng(5)
    F, Q = OrnsteinUhlenbeck(speed=1.2, turn_s=1.0, sigma_v=0.1).transition(DT)
    states = np.column_stack([rng.uniform(8.0, 22.0, (TARGETS, 2)), rng.normal(0.0, math.sqrt(0.72), (TARGETS, 2))])
    truth = np.empty((TARGETS, STEPS, 2))
    for k in range(STEPS):
        if k:
            states = states @ F.T + rng.multivariate_normal(np.zeros(4), Q, TARGETS)
        truth[:, k] = states[:, :2]
    places = {"east": (32.0, 10.0), "south": (14.0, -2.0)}
    room = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 30.0], [0.0, 30.0]])
    readers = tuple(TagReader(name=name, position=np.array([*xy, 0.0])) for name, xy in places.items())
    columns: dict[str, list[Floats]] = {"t_ns": [], "sensor": [], "target_id": [], "range": [], "bearing": []}
    for k in range(STEPS):
        for name, xy in places.items():
            away = truth[:, k] - np.array(xy)
            columns["t_ns"].append(np.full(TARGETS, round(k * DT * NS)))
            columns["sensor"].append(np.full(TARGETS, name))
            columns["target_id"].append(np.arange(TARGETS))
            columns["range"].append(np.hypot(*away.T) + SIGMA_RANGE * rng.standard_normal(TARGETS))
            columns["bearing"].append(np.arctan2(away[:, 1], away[:, 0]) + SIGMA_BEARING * rng.standard_normal(TARGETS))
    n = TARGETS * STEPS * 2
    table = Measurements.of(
        **{name: np.concatenate(parts) for name, parts in columns.items()},
        sigma_range=np.full(n, SIGMA_RANGE),
        sigma_bearing=np.full(n, SIGMA_BEARING),
        rssi=np.full(n, np.nan),
        sigma_rssi=np.full(n, np.nan),
    )
    return Scene(length_unit="m", room=room, readers=readers), table.sorted(), truth


@pytest.mark.jit
@pytest.mark.parametrize(
    ("method", "settings", "targets", "bias"),
    [
        ("ekf", {}, 50, 0.0),
        ("ekf", {"smooth": True}, 50, 0.0),
        pytest.param("ukf", {}, 40, 0.0, marks=pytest.mark.statistics),
        ("ukf", {"smooth": True}, 40, 0.0),
        pytest.param("apf", {"particles": 500}, 30, 1.0, marks=pytest.mark.statistics),
        ("apf", {"particles": 500, "smooth": True}, 12, 1.0),
    ],
)
def test_covariances_are_those_of_the_errors(
    simulated: tuple[Scene, Measurements, Floats], method: str, settings: dict[str, object], targets: int, bias: float
) -> None:
    """Mean NEES at one time of independent targets: chi-square of 2 N degrees, within four standard errors.

    The motion model of `apf` is a walk by waypoints and not that of the targets, which may bias its NEES by `bias`.
    """
    scene, table, truth = simulated
    config = configure(settings_of(method).in_unit("m"), settings)
    feed = DistanceMeasurementFeed([table], scene, DistanceMeasurementConfig.in_unit("m"))
    tracking = TrackingTask(
        config, 0, method=method, sensors=frozenset({"east", "south"}), targets=tuple(range(targets))
    )
    found = Tracks.concat(part.tracks for part in track([Bearings.empty()], scene, tracking, measured=feed))
    at = found.take(found.t_ns == round(12 * DT * NS))
    assert len(at) == targets
    off = np.column_stack([at.x, at.y]) - truth[at.target_id, 12]
    P = np.stack([np.stack([at.cov_xx, at.cov_xy], -1), np.stack([at.cov_xy, at.cov_yy], -1)], 1)
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(P), off)
    error = 2.0 / math.sqrt(targets)
    assert abs(nees.mean() - 2.0) < 4.0 * error + bias
    # Better than a single bearing with range of each radar, 0.14 m per axis at best
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.25
